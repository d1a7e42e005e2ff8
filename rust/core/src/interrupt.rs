//! Early ends of work: a time limit, and a flag that another thread sets.
//!
//! Long work asks [`current`] once, and the [`Interrupt`] that it gets between its parts: blocks of an evaluation,
//! groups of a factorisation, steps of an integration. Work that was stopped ends with an error of its own kind; its
//! results are invalid, and the caller asks [`Interrupt::cause`] for the reason.
//!
//! The interrupt in force belongs to the thread that called [`Interrupt::run`], as a user's program and its linear
//! algebra are called through interfaces that know nothing of limits. Parallel work takes its own copy along.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The reason why work was stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Somebody called [`Interrupt::stop`].
    Stopped,
    /// There was no time left.
    TimeLimit,
}

/// A limit on work. Clones share the flag.
///
/// ```
/// use phugoid::interrupt::{Cause, Interrupt, current};
/// use std::time::Duration;
///
/// let limit = Interrupt::within(Some(Duration::ZERO));
/// assert!(!current().stops());
/// limit.run(|| assert_eq!(current().cause(), Some(Cause::TimeLimit)));
/// ```
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Option<Arc<Limit>>);

#[derive(Debug)]
struct Limit {
    /// None where there is no end of time.
    deadline: Option<Instant>,
    stopped: AtomicBool,
    /// The limit within which this one was set.
    outer: Interrupt,
}

thread_local! {
    static CURRENT: RefCell<Interrupt> = const { RefCell::new(Interrupt(None)) };
}

/// The interrupt in force on this thread; one that never stops where there is none.
pub fn current() -> Interrupt {
    CURRENT.with_borrow(Interrupt::clone)
}

impl Interrupt {
    /// A limit of so much time from now, within the one in force. No time, or more than a clock can count, is no limit.
    pub fn within(time: Option<Duration>) -> Interrupt {
        let deadline = time.and_then(|time| Instant::now().checked_add(time));
        Interrupt(Some(Arc::new(Limit { deadline, stopped: AtomicBool::new(false), outer: current() })))
    }

    /// Does work under this interrupt.
    pub fn run<R>(&self, work: impl FnOnce() -> R) -> R {
        struct Back(Interrupt);
        impl Drop for Back {
            fn drop(&mut self) {
                CURRENT.replace(std::mem::take(&mut self.0));
            }
        }
        let _back = Back(CURRENT.replace(self.clone()));
        work()
    }

    /// Runs work that must be completed, without the limits in force.
    pub fn shielded<R>(work: impl FnOnce() -> R) -> R {
        Interrupt(None).run(work)
    }

    /// Whether it can never stop anything.
    pub fn is_none(&self) -> bool {
        self.0.is_none()
    }

    /// Stops the work, from any thread.
    pub fn stop(&self) {
        if let Some(limit) = &self.0 {
            limit.stopped.store(true, Ordering::Relaxed);
        }
    }

    /// Returns the reason why the work must end, if it must.
    pub fn cause(&self) -> Option<Cause> {
        let limit = self.0.as_ref()?;
        if limit.stopped.load(Ordering::Relaxed) {
            return Some(Cause::Stopped);
        }
        let outer = limit.outer.cause();
        let late = || limit.deadline.is_some_and(|end| Instant::now() >= end);
        outer.or_else(|| late().then_some(Cause::TimeLimit))
    }

    /// The time that is left; `None` where there is no limit.
    pub fn left(&self) -> Option<Duration> {
        let limit = self.0.as_ref()?;
        let own = limit.deadline.map(|end| end.saturating_duration_since(Instant::now()));
        match (own, limit.outer.left()) {
            (Some(own), Some(outer)) => Some(own.min(outer)),
            (own, outer) => own.or(outer),
        }
    }

    /// Whether the work must end.
    #[inline]
    pub fn stops(&self) -> bool {
        self.0.is_some() && self.cause().is_some()
    }

    /// Returns the check of a loop whose turns take about so many operations each: the interrupt is asked about once
    /// a millisecond.
    pub fn turns(&self, operations: usize) -> Turns {
        let every = (OPERATIONS / operations.max(1)).max(1);
        Turns { interrupt: self.clone(), every, left: every }
    }
}

/// Operations, about, between two looks at the interrupt.
const OPERATIONS: usize = 1 << 20;

/// Turns of a loop, each too short to look at the clock.
#[derive(Debug)]
pub struct Turns {
    interrupt: Interrupt,
    every: usize,
    left: usize,
}

impl Turns {
    /// Counts a turn; whether the work must end.
    #[inline]
    pub fn stop(&mut self) -> bool {
        self.left -= 1;
        if self.left > 0 {
            return false;
        }
        self.left = self.every;
        self.interrupt.stops()
    }
}
