//! The order of elimination of the constraints.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::sparse::SymbolicSparseColMatRef;
use faer::sparse::linalg::amd;

use super::rows::Rows;

/// Constraints by approximate minimum degree, where two are neighbours when they share a variable that
/// counts: little fills in then, whichever variables turn out to be pivots (George and Ng, 1985).
pub(super) fn minimum_degree(n: usize, a: &Rows, counts: impl Fn(usize) -> bool) -> Vec<u32> {
    let m = a.count();
    let mut of_variable = vec![Vec::new(); n];
    for i in 0..m {
        for &v in a.columns(i) {
            if counts(v as usize) {
                of_variable[v as usize].push(i);
            }
        }
    }
    let (mut start, mut index, mut mark) = (vec![0], Vec::new(), vec![usize::MAX; m]);
    for i in 0..m {
        for &v in a.columns(i) {
            for &other in &of_variable[v as usize] {
                if mark[other] != i {
                    mark[other] = i;
                    index.push(other);
                }
            }
        }
        start.push(index.len());
    }
    let mut scratch = MemBuffer::new(amd::order_maybe_unsorted_scratch::<usize>(m, index.len()));
    let (mut order, mut inverse) = (vec![0; m], vec![0; m]);
    let graph = SymbolicSparseColMatRef::new_unsorted_checked(m, m, &start, None, &index);
    let stack = MemStack::new(&mut scratch);
    match amd::order_maybe_unsorted(&mut order, &mut inverse, graph, amd::Control::default(), stack) {
        Ok(_) => order.into_iter().map(|i| i as u32).collect(),
        // Too many entries to count: any order is right.
        Err(_) => (0..m as u32).collect(),
    }
}
