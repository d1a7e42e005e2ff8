//! The order of elimination of the constraints.

use super::rows::Rows;
use crate::dense::large;

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
    large::minimum_degree(&start, &index)
}
