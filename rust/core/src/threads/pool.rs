//! A pool of threads that survives a fork.
//!
//! A process made by `fork` inherits a thread pool without its threads, and work given to that pool would never be done.
//! A pool is therefore used only in the process that made it. Another process makes one of its own, as large, the first
//! time that it needs one. Results do not depend on the pool.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::Error;

/// Most threads of a pool.
const MOST: usize = 1024;

/// The threads that the caller works on, a pool of rayon or its global one, unless [`Threads::new`] has started others. Clones
/// share a pool.
#[derive(Clone, Debug, Default)]
pub struct Threads(Option<Arc<Pool>>);

/// The threads of rayon's global pool, one a core unless the caller or `RAYON_NUM_THREADS` says otherwise.
static COMMON: Pool = Pool { own: None, process: OnceLock::new(), inherited: Mutex::new(None) };

/// The number of this thread among those of its pool.
pub(crate) fn thread_index() -> usize {
    rayon::current_thread_index().unwrap_or(0)
}

impl Threads {
    /// Starts so many threads; 0 for those that the caller works on.
    ///
    /// # Errors
    /// Where the system has not so many.
    pub fn new(number: usize) -> Result<Threads, Error> {
        if number == 0 {
            return Ok(Threads::default());
        }
        let (own, process) = (Some(start(number)?), std::process::id().into());
        Ok(Threads(Some(Arc::new(Pool { own, process, inherited: Mutex::new(None) }))))
    }

    fn pool(&self) -> &Pool {
        self.0.as_deref().unwrap_or(&COMMON)
    }

    /// Number of threads.
    pub fn number(&self) -> usize {
        self.pool().number()
    }

    /// Does work on these threads. Work that is done on rayon's threads already stays on those, unless this is a pool
    /// apart from the common one.
    pub fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        let pool = self.pool();
        // A process is forked from a thread of the caller, never from one of a pool: whoever is on one can use it.
        if pool.own.is_none() && rayon::current_thread_index().is_some() {
            return work();
        }
        match (pool.inherits(), &pool.own) {
            (Some(process), _) => pool.replacement(process).install(work),
            (None, Some(own)) => own.install(work),
            (None, None) => work(),
        }
    }
}

/// A thread pool, and the one that takes its place after a fork.
#[derive(Debug)]
struct Pool {
    /// `None` is rayon's global pool.
    own: Option<ThreadPool>,
    /// The process that the pool works in: the one that used it first.
    process: OnceLock<u32>,
    /// The pool of a process that inherited this one, with the identifier of that process.
    inherited: Mutex<Option<(u32, Arc<ThreadPool>)>>,
}

impl Pool {
    fn number(&self) -> usize {
        // What asks for the number starts rayon's pool.
        self.inherits();
        self.own.as_ref().map_or_else(rayon::current_num_threads, ThreadPool::current_num_threads)
    }

    /// This process, where the pool belongs to another.
    fn inherits(&self) -> Option<u32> {
        let here = std::process::id();
        (*self.process.get_or_init(|| here) != here).then_some(here)
    }

    fn replacement(&self, process: u32) -> Arc<ThreadPool> {
        let mut made = self.inherited.lock().unwrap_or_else(PoisonError::into_inner);
        match &*made {
            Some((maker, pool)) if *maker == process => Arc::clone(pool),
            _ => {
                // With fewer threads the results are the same.
                let pool = start(self.number()).or_else(|_| start(1));
                let pool = Arc::new(pool.expect("a process can start one thread"));
                if let Some((_, lost)) = made.replace((process, Arc::clone(&pool))) {
                    std::mem::forget(lost);
                }
                pool
            }
        }
    }
}

impl Drop for Pool {
    /// Does not join threads that no longer exist after a fork, which could wait forever.
    fn drop(&mut self) {
        let here = std::process::id();
        if self.inherits().is_some() {
            std::mem::forget(self.own.take());
        }
        let made = self.inherited.get_mut().unwrap_or_else(PoisonError::into_inner);
        if made.as_ref().is_some_and(|(maker, _)| *maker != here) {
            std::mem::forget(made.take());
        }
    }
}

fn start(number: usize) -> Result<ThreadPool, Error> {
    if number > MOST {
        return Err(Error::option(format!(
            "threads = {number} is more than {MOST}; more threads than cores are of no use, and 0 takes one for each core"
        )));
    }
    let pool = ThreadPoolBuilder::new().num_threads(number).build();
    pool.map_err(|e| Error::option(format!("{number} threads: {e}")))
}
