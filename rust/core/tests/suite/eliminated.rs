//! Elimination with row exchanges: its factors solve systems of a matrix and of its transpose.

use phugoid::internals::dense::{factorise, solve_factorised, solve_factorised_transposed};
use proptest::prelude::*;

/// Returns A X, or Aᵀ X, of an n × n matrix and n × width ones.
fn times(a: &[f64], x: &[f64], n: usize, width: usize, transposed: bool) -> Vec<f64> {
    let at = |i: usize, k: usize| if transposed { a[k * n + i] } else { a[i * n + k] };
    let entry = |i: usize, j: usize| (0..n).map(|k| at(i, k) * x[k * width + j]).sum::<f64>();
    (0..n * width).map(|e| entry(e / width, e % width)).collect()
}

proptest! {
    #[test]
    fn factors_solve_both_ways(n in 1usize..9, width in 1usize..4, entries in prop::collection::vec(-1.0f64..1.0, 100)) {
        // Zeros on the diagonal need exchanges; the rest of the matrix is far from singular.
        let place = |i: usize, k: usize| if k == (i + 1) % n { 8.0 + entries[i] } else if i == k { 0.0 } else { entries[i * 9 + k] };
        let a: Vec<f64> = (0..n * n).map(|e| place(e / n, e % n)).collect();
        let b: Vec<f64> = entries[..n * width].to_vec();
        let (mut factor, mut pivots) = (a.clone(), vec![0; n]);
        prop_assert!(factorise(&mut factor, &mut pivots));
        let mut x = b.clone();
        prop_assert!(solve_factorised(&factor, &pivots, &mut x, width));
        for (found, wanted) in times(&a, &x, n, width, false).iter().zip(&b) {
            prop_assert!((found - wanted).abs() < 1e-12);
        }
        let mut x = b[..n].to_vec();
        prop_assert!(solve_factorised_transposed(&factor, &pivots, &mut x));
        for (found, wanted) in times(&a, &x, n, 1, true).iter().zip(&b) {
            prop_assert!((found - wanted).abs() < 1e-12);
        }
    }
}

#[test]
fn a_singular_matrix_has_no_factors() {
    assert!(!factorise(&mut [1.0, 2.0, 2.0, 4.0], &mut [0; 2]));
    assert!(!factorise(&mut [f64::NAN], &mut [0]));
}
