//! The calling thread in place of a pool, and sequential iterators in place of rayon's.

use crate::error::Error;

/// The calling thread.
#[derive(Clone, Debug, Default)]
pub struct Threads;

impl Threads {
    /// The calling thread, whatever the number.
    ///
    /// # Errors
    /// None; a pool of threads may have some.
    pub fn new(_number: usize) -> Result<Threads, Error> {
        Ok(Threads)
    }

    /// Number of threads.
    pub fn number(&self) -> usize {
        1
    }

    /// Does the work.
    pub fn install<R>(&self, work: impl FnOnce() -> R) -> R {
        work()
    }
}

/// The number of this thread among those of its pool.
pub(crate) fn thread_index() -> usize {
    0
}

pub(crate) mod prelude {
    use std::slice::{Chunks, ChunksExactMut, ChunksMut, Iter, IterMut};

    pub trait Slice<T> {
        fn par_iter(&self) -> Iter<'_, T>;
        fn par_iter_mut(&mut self) -> IterMut<'_, T>;
        fn par_chunks(&self, size: usize) -> Chunks<'_, T>;
        fn par_chunks_mut(&mut self, size: usize) -> ChunksMut<'_, T>;
        fn par_chunks_exact_mut(&mut self, size: usize) -> ChunksExactMut<'_, T>;
    }

    impl<T> Slice<T> for [T] {
        fn par_iter(&self) -> Iter<'_, T> {
            self.iter()
        }

        fn par_iter_mut(&mut self) -> IterMut<'_, T> {
            self.iter_mut()
        }

        fn par_chunks(&self, size: usize) -> Chunks<'_, T> {
            self.chunks(size)
        }

        fn par_chunks_mut(&mut self, size: usize) -> ChunksMut<'_, T> {
            self.chunks_mut(size)
        }

        fn par_chunks_exact_mut(&mut self, size: usize) -> ChunksExactMut<'_, T> {
            self.chunks_exact_mut(size)
        }
    }

    pub trait IntoSequence: IntoIterator + Sized {
        fn into_par_iter(self) -> Self::IntoIter {
            self.into_iter()
        }
    }

    impl<I: IntoIterator> IntoSequence for I {}

    pub trait Sequence: Iterator + Sized {
        fn with_min_len(self, _least: usize) -> Self {
            self
        }

        fn flat_map_iter<U: IntoIterator, F: FnMut(Self::Item) -> U>(
            self,
            f: F,
        ) -> impl Iterator<Item = U::Item> {
            self.flat_map(f)
        }

        fn find_first(mut self, wanted: impl FnMut(&Self::Item) -> bool) -> Option<Self::Item> {
            self.find(wanted)
        }

        fn map_init<T, R>(
            self,
            init: impl FnOnce() -> T,
            mut f: impl FnMut(&mut T, Self::Item) -> R,
        ) -> impl Iterator<Item = R> {
            let mut own = init();
            self.map(move |item| f(&mut own, item))
        }
    }

    impl<I: Iterator> Sequence for I {}
}
