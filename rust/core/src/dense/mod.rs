//! Dense matrices in slices, row by row: products, orthogonal elimination, Cholesky's factorisation and its solutions.
//!
//! Most are small, the states of a point or the parameters of a model, and there are many. Up to 8 rows a factorisation by loops
//! takes two thirds to all of the time that faer needs, and no memory. From [`LARGE`] rows on faer takes half the time, and a tenth
//! for 512 (`benches/dense.rs`). Solutions by faer take half to all of the time of the loops, which are kept for small matrices since
//! they need no change of layout.
//!
//! What is done of large matrices is in [`large`]: by faer, unless the crate is built without the feature `faer`. Loops do the same
//! then, and the crate takes much less time to compile. The matrices of a vehicle's model are mostly small.

#[cfg(feature = "faer")]
pub mod large_by_faer;
#[cfg(any(not(feature = "faer"), test))]
pub mod large_by_loops;
mod loops;

use crate::interrupt::current;

#[cfg(feature = "faer")]
pub use large_by_faer as large;
#[cfg(not(feature = "faer"))]
pub use large_by_loops as large;
pub use loops::*;

/// Rows from which a matrix is large.
const LARGE: usize = 24;

/// Cholesky's factor L of a symmetric matrix, in its lower triangle; the index at which a pivot falls to the least that is
/// allowed for this diagonal entry, or below, or at which the interrupt in force stops it.
pub fn cholesky(a: &mut [f64], n: usize, least: impl Fn(f64) -> f64) -> Result<(), usize> {
    if n >= LARGE {
        return if current().stops() { Err(0) } else { large::cholesky(a, n, least) };
    }
    by_loops(a, n, least)
}

/// The inverse (k, k) of L Lᵀ, with L the first k rows and columns of the lower triangle of a matrix of m.
pub fn inverse_of_first(factor: &[f64], m: usize, k: usize) -> Vec<f64> {
    let mut inverse = vec![0.0; k * k];
    if k >= LARGE {
        large::inverse_of_first(factor, m, &mut inverse, k);
    } else {
        inverse_by_loops(factor, m, &mut inverse, k);
    }
    inverse
}

/// The inverse of C Cᵀ.
pub fn inverse(c: &[f64], n: usize) -> Vec<f64> {
    inverse_of_first(c, n, n)
}

#[cfg(all(test, feature = "faer"))]
mod tests {
    use super::{large_by_faer as by_faer, large_by_loops as by_loops};

    /// Numbers without a pattern, between −1 and 1.
    fn numbers(count: usize) -> Vec<f64> {
        (0..count).map(|i| ((i * i % 101 + 7 * i) % 97) as f64 / 48.5 - 1.0).collect()
    }

    fn assert_near(a: &[f64], b: &[f64]) {
        assert_eq!(a.len(), b.len());
        for (i, (a, b)) in a.iter().zip(b).enumerate() {
            assert!((a - b).abs() <= 1e-11 * (1.0 + b.abs()), "{i}: {a} and {b}");
        }
    }

    /// A symmetric matrix, with `shift` added to its diagonal.
    fn symmetric(n: usize, shift: f64) -> Vec<f64> {
        let a = numbers(n * n);
        let entry = |i: usize, j: usize| a[i * n + j] + a[j * n + i] + if i == j { shift } else { 0.0 };
        (0..n * n).map(|at| entry(at / n, at % n)).collect()
    }

    #[test]
    fn products_are_the_same() {
        for [m, k, n] in [[1, 1, 1], [3, 50, 4], [33, 7, 20]] {
            let (a, b, start) = (numbers(m * k), numbers(k * n), numbers(m * n));
            let (mut one, mut other) = (start.clone(), start);
            by_faer::add_product(&mut one, &a, &b, [m, k, n]);
            by_loops::add_product(&mut other, &a, &b, [m, k, n]);
            assert_near(&other, &one);
            by_faer::transposed_product(&mut one, &a, &b, [m, k, n]);
            by_loops::transposed_product(&mut other, &a, &b, [m, k, n]);
            assert_near(&other, &one);
        }
    }

    #[test]
    fn factors_and_solutions_are_the_same() {
        for n in [1, 5, 40] {
            let (mut one, mut other) = (symmetric(n, 3.0 * n as f64), symmetric(n, 3.0 * n as f64));
            by_faer::cholesky(&mut one, n, |_| 0.0).unwrap();
            by_loops::cholesky(&mut other, n, |_| 0.0).unwrap();
            let lower = |a: &[f64]| (0..n).flat_map(|i| a[i * n..=i * n + i].to_vec()).collect::<Vec<_>>();
            assert_near(&lower(&other), &lower(&one));
            // Of the first rows and columns; and the product with what it is the inverse of is the identity.
            let (k, a) = (n.div_ceil(2), symmetric(n, 3.0 * n as f64));
            let (mut of_one, mut of_other) = (vec![0.0; k * k], vec![0.0; k * k]);
            by_faer::inverse_of_first(&one, n, &mut of_one, k);
            by_loops::inverse_of_first(&one, n, &mut of_other, k);
            assert_near(&of_other, &of_one);
            let entry = |i: usize, j: usize| (0..k).map(|l| of_one[i * k + l] * a[l * n + j]).sum::<f64>();
            let product: Vec<f64> = (0..k * k).map(|at| entry(at / k, at % k)).collect();
            let identity: Vec<f64> = (0..k * k).map(|at| f64::from(at / k == at % k)).collect();
            assert_near(&product, &identity);
            assert_eq!(by_faer::cholesky(&mut symmetric(n, -9.0), n, |_| 0.0), Err(0));
            assert_eq!(by_loops::cholesky(&mut symmetric(n, -9.0), n, |_| 0.0), Err(0));

            let (mut one, mut other) = (symmetric(n, 3.0 * n as f64), symmetric(n, 3.0 * n as f64));
            let (mut by, mut plain) = (by_faer::Workspace::default(), by_loops::Workspace::default());
            by.reserve(n);
            plain.reserve(n);
            assert!(by.factorise(&mut one, n) && plain.factorise(&mut other, n));
            let (mut x, mut y) = (numbers(n), numbers(n));
            by_faer::solve(&one, n, &mut x);
            by_loops::solve(&other, n, &mut y);
            assert_near(&y, &x);
        }
    }

    #[test]
    fn eigenvalues_ascend_and_are_the_same() {
        for n in [1, 6, 30] {
            let a = symmetric(n, 0.0);
            let (mut one, mut other) = (vec![0.0; n], vec![0.0; n]);
            let (mut vectors, mut v) = (vec![0.0; n * n], vec![0.0; n * n]);
            let (mut by, mut plain) = (by_faer::Workspace::default(), by_loops::Workspace::default());
            by.reserve(n);
            plain.reserve(n);
            assert!(by.eigen(&a, &mut one, &mut vectors, n) && plain.eigen(&a, &mut other, &mut v, n));
            assert!(other.is_sorted());
            assert_near(&other, &one);
            for (value, v) in other.iter().zip(v.chunks_exact(n)) {
                let product: Vec<f64> =
                    (0..n).map(|i| a[i * n..(i + 1) * n].iter().zip(v).map(|(a, v)| a * v).sum()).collect();
                assert_near(&product, &v.iter().map(|v| value * v).collect::<Vec<_>>());
            }
        }
    }

    /// A star: eliminating its centre first would connect all others.
    #[test]
    fn what_fills_in_comes_last() {
        let n = 12;
        let (mut start, mut index) = (vec![0], Vec::new());
        for i in 0..n {
            index.extend(if i == 4 { (0..n).collect() } else { vec![i, 4] });
            start.push(index.len());
        }
        for order in [by_faer::minimum_degree(&start, &index), by_loops::minimum_degree(&start, &index)] {
            assert!(order[n - 2..].contains(&4), "{order:?}");
            let mut all = order.clone();
            all.sort_unstable();
            assert_eq!(all, (0..n as u32).collect::<Vec<_>>());
        }
    }
}
