//! Threads that are kept between calls, so that work finds the buffers and the heap that it left there.
//!
//! A thread that starts anew for every fit allocates all its buffers again, from pages that the system must clear
//! first: on a record of 600 samples that is as long as an iteration of the solver.

use std::io;
use std::mem;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process;
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

/// The stack that Python's own thread has.
const STACK: usize = 8 << 20;
/// Most threads that wait for work. More are there only while as many calls run at a time.
const IDLE: usize = 4;

type Task = Box<dyn FnOnce() + Send>;

/// A thread, and the process that it runs in: after a fork it is not there.
struct Worker {
    tasks: Sender<(Task, Sender<()>)>,
    process: u32,
}

static WORKERS: Mutex<Vec<Worker>> = Mutex::new(Vec::new());

impl Worker {
    /// Returns one that waits for work, or a new one.
    fn get() -> io::Result<Worker> {
        let here = process::id();
        // A fork may have copied the lock while another thread held it: nobody would ever release it.
        if let Ok(mut workers) = WORKERS.try_lock() {
            while let Some(worker) = workers.pop() {
                if worker.process == here {
                    return Ok(worker);
                }
                // Its channel may be in use by a thread that was not copied.
                mem::forget(worker);
            }
        }
        let (tasks, received) = channel::<(Task, Sender<()>)>();
        thread::Builder::new().name("phugoid".into()).stack_size(STACK).spawn(move || {
            for (task, done) in received {
                let _ = catch_unwind(AssertUnwindSafe(task));
                let _ = done.send(());
            }
        })?;
        Ok(Worker { tasks, process: here })
    }

    /// Keeps it for the next call.
    fn keep(self) {
        if let Ok(mut workers) = WORKERS.try_lock()
            && workers.len() < IDLE
        {
            workers.push(self);
        }
    }
}

/// Waits for the end of the task, and then keeps the thread.
struct Running(Option<Worker>, Receiver<()>);

impl Drop for Running {
    fn drop(&mut self) {
        let finished = self.1.recv().is_ok();
        if let Some(worker) = self.0.take().filter(|_| finished) {
            worker.keep();
        }
    }
}

/// Does `work` on another thread and `meanwhile` on this one, and returns when both are done. A panic of `work` ends
/// there: whoever needs to know catches it within.
///
/// # Errors
/// Where the system has no thread.
pub fn beside<R>(work: impl FnOnce() + Send, meanwhile: impl FnOnce() -> R) -> io::Result<R> {
    let worker = Worker::get()?;
    let task: Box<dyn FnOnce() + Send + '_> = Box::new(work);
    // SAFETY: the task is called, and with that dropped, or dropped with the channel, before `Running` has received,
    // and this function does not return, nor unwind, before.
    let task = unsafe { mem::transmute::<Box<dyn FnOnce() + Send + '_>, Task>(task) };
    let (done, finished) = channel();
    let sent = worker.tasks.send((task, done));
    let _running = Running(Some(worker), finished);
    drop(sent);
    Ok(meanwhile())
}
