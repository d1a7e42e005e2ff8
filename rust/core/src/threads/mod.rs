//! The threads that work is done on.

#[cfg(feature = "parallel")]
mod pool;
#[cfg(not(feature = "parallel"))]
mod serial;

#[cfg(feature = "parallel")]
pub use pool::Threads;
#[cfg(feature = "parallel")]
pub(crate) use pool::thread_index;
#[cfg(feature = "parallel")]
pub(crate) use rayon::prelude;
#[cfg(not(feature = "parallel"))]
pub use serial::Threads;
#[cfg(not(feature = "parallel"))]
pub(crate) use serial::{prelude, thread_index};
