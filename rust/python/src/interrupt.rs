//! Long work without the interpreter lock, which Ctrl-C ends.

use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

use phugoid::interrupt::Interrupt;
use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;

use crate::worker::beside;

/// Signals are looked for so often.
const POLL: Duration = Duration::from_millis(10);

type Job<'a> = Box<dyn FnOnce(Python<'_>) -> PyResult<()> + Send + 'a>;

/// Asks the thread that waits, or tells it of the end. One type serves whatever the work returns: the code of a channel is long.
enum Message<'a> {
    /// To be done on the thread that waits, which then tells whether to go on.
    Do(Job<'a>, Sender<bool>),
    Done(thread::Result<()>),
}

type Work<'w, 'a> = Box<dyn FnOnce(&Caller<'a>) + Send + 'w>;

/// What the work can have done on the thread that waits for it: Python's own, where its callbacks belong.
pub struct Caller<'a>(Sender<Message<'a>>);

impl<'a> Caller<'a> {
    /// Calls a function there; whether to go on: not after an error.
    pub fn call(&self, job: impl FnOnce(Python<'_>) -> PyResult<()> + Send + 'a) -> bool {
        let (reply, answer) = channel();
        self.0.send(Message::Do(Box::new(job), reply)).is_ok() && answer.recv().unwrap_or(false)
    }
}

/// Does work on another thread while this one looks for signals. `stop` is asked now and then. The result, and the
/// error that ended the work: a KeyboardInterrupt where `stop` said so.
pub fn watched<'a, R: Send>(
    py: Python<'_>,
    stop: Option<&Py<PyAny>>,
    work: impl FnOnce(&Caller<'a>) -> R + Send,
) -> (R, Option<PyErr>) {
    watched_twice(py, stop, &Interrupt::default(), work)
}

/// The same, where `stop` tells how often an end was asked for: the second time stops `second`, too. Errors count alike.
pub fn watched_twice<'a, R: Send>(
    py: Python<'_>,
    stop: Option<&Py<PyAny>>,
    second: &Interrupt,
    work: impl FnOnce(&Caller<'a>) -> R + Send,
) -> (R, Option<PyErr>) {
    let mut result = None;
    let (ended, error) = watch(py, stop, second, Box::new(|caller| result = Some(work(caller))));
    match (ended, result) {
        (Ok(()), Some(result)) => (result, error),
        (Ok(()), None) => unreachable!("work that ended has a result"),
        (Err(panic), _) => std::panic::resume_unwind(panic),
    }
}

/// Does the work, and returns how it ended and the error that ended it.
fn watch<'a>(
    py: Python<'_>,
    stop: Option<&Py<PyAny>>,
    second: &Interrupt,
    work: Work<'_, 'a>,
) -> (thread::Result<()>, Option<PyErr>) {
    let interrupt = Interrupt::within(None);
    let (mut error, mut raised): (Option<PyErr>, u32) = (None, 0);
    let ask = |py: Python<'_>| -> PyResult<u32> {
        py.check_signals()?;
        stop.map_or(Ok(0), |s| s.call0(py)?.extract(py))
    };
    // Whether to go on.
    let mut note = |said: PyResult<u32>| -> bool {
        let asked = said.unwrap_or_else(|e| {
            raised += 1;
            error.get_or_insert(e);
            raised
        });
        if asked > 0 {
            interrupt.stop();
            error.get_or_insert_with(|| PyKeyboardInterrupt::new_err("stopped"));
        }
        if asked > 1 {
            second.stop();
        }
        error.is_none()
    };
    // What was pressed before counts, however quick the work is.
    note(ask(py));
    let ended = py.detach(|| {
        let (sender, receiver) = channel::<Message<'a>>();
        let inner = interrupt.clone();
        let body = || {
            let caller = Caller(sender);
            let run = std::panic::AssertUnwindSafe(|| inner.run(|| work(&caller)));
            let ended = std::panic::catch_unwind(run);
            let _ = caller.0.send(Message::Done(ended));
        };
        let wait = || loop {
            match receiver.recv_timeout(POLL) {
                Ok(Message::Done(ended)) => break ended,
                Ok(Message::Do(job, reply)) => {
                    let said =
                        Python::attach(|py| note(ask(py)) && note(job(py).map(|()| 0)) && note(ask(py)));
                    let _ = reply.send(said);
                }
                Err(RecvTimeoutError::Timeout) => {
                    note(Python::attach(ask));
                }
                Err(RecvTimeoutError::Disconnected) => unreachable!("the work sends its end"),
            }
        };
        beside(body, wait).unwrap_or_else(|e| std::panic::resume_unwind(Box::new(e.to_string())))
    });
    (ended, error)
}

/// The same for work that is worth nothing unless it is finished.
pub fn interruptible<R: Send>(
    py: Python<'_>,
    stop: Option<&Py<PyAny>>,
    work: impl FnOnce() -> R + Send,
) -> PyResult<R> {
    let (result, error) = watched(py, stop, |_| work());
    error.map_or(Ok(result), Err)
}

/// Seconds from Python: nothing, or what a clock cannot tell, is no limit.
pub fn seconds(limit: Option<f64>) -> Option<Duration> {
    limit.and_then(|s| Duration::try_from_secs_f64(s.max(0.0)).ok())
}
