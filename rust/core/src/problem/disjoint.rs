//! One output array, written by many threads at places that do not overlap.

use std::marker::PhantomData;

/// A mutable slice that threads may write to at disjoint places.
pub(crate) struct Disjoint<'a> {
    start: *mut f64,
    len: usize,
    borrow: PhantomData<&'a mut [f64]>,
}

// SAFETY: all access is through `part`, whose caller promises disjoint ranges.
unsafe impl Sync for Disjoint<'_> {}

impl<'a> Disjoint<'a> {
    pub(crate) fn new(slice: &'a mut [f64]) -> Self {
        Disjoint { start: slice.as_mut_ptr(), len: slice.len(), borrow: PhantomData }
    }

    /// `len` entries from `at`.
    ///
    /// # Safety
    /// No two parts that are alive at one time may overlap.
    #[allow(clippy::mut_from_ref)]
    pub(crate) unsafe fn part(&self, at: usize, len: usize) -> &mut [f64] {
        assert!(at + len <= self.len);
        // SAFETY: in range by the assertion, disjoint by the caller's promise.
        unsafe { std::slice::from_raw_parts_mut(self.start.add(at), len) }
    }
}
