//! The loops of the dense module against faer, and what nalgebra does of matrices of few rows against faer, both in turn in one
//! process: nanoseconds of a factorisation and of a solution.
//!
//!     cargo bench --bench dense

// Parts of the crate that no one else may call.
#[allow(dead_code)]
#[path = "../src/linalg/arrow/lu.rs"]
mod lu;
#[allow(dead_code, unused_imports)]
#[path = "../src/linalg/arrow/vectors.rs"]
mod vectors;

use std::hint::black_box;
use std::time::{Duration, Instant};

use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt;
use faer::linalg::lu::partial_pivoting::factor::{lu_in_place, lu_in_place_scratch};
use faer::linalg::lu::partial_pivoting::solve::{solve_in_place, solve_in_place_scratch};
use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::prelude::{ReborrowMut, default};
use faer::{Mat, MatMut, MatRef, Par, Side};
use nalgebra::{DMatrix, DVector};
use phugoid::internals::dense::{backward, by_loops, forward};

/// Time for each size and method, and rounds in which they take turns.
const TIME: Duration = Duration::from_millis(20);
const ROUNDS: usize = 7;

fn time(work: &mut dyn FnMut()) -> f64 {
    let (began, mut count) = (Instant::now(), 0u32);
    while began.elapsed() < TIME {
        work();
        count += 1;
    }
    began.elapsed().as_secs_f64() / f64::from(count) * 1e9
}

fn main() {
    println!(
        "{:>4} {:>12} {:>12} {:>6}   {:>12} {:>12} {:>6}",
        "n", "factor", "faer", "ratio", "solve", "faer", "ratio"
    );
    for n in [2, 4, 8, 16, 24, 32, 48, 64, 96, 128, 256, 512] {
        let entry =
            |i: usize, j: usize| if i == j { 1.0 } else { 0.3 / (1.0 + i.abs_diff(j) as f64).powi(2) };
        let a: Vec<f64> = (0..n * n).map(|k| entry(k / n, k % n)).collect();
        let (mut l, mut c, mut x, mut y) = (a.clone(), a.clone(), vec![1.0; n], vec![1.0; n]);
        let scratch = llt::factor::cholesky_in_place_scratch::<f64>(n, Par::Seq, default());
        let mut memory = MemBuffer::new(scratch);
        let mut best = [f64::INFINITY; 4];
        for _ in 0..ROUNDS {
            let mut works: [&mut dyn FnMut(); 2] = [
                &mut || {
                    l.copy_from_slice(black_box(&a));
                    by_loops(&mut l, n, |_| 1e-13).unwrap();
                },
                &mut || {
                    c.copy_from_slice(black_box(&a));
                    let mut matrix = MatMut::from_column_major_slice_mut(&mut c, n, n);
                    let stack = MemStack::new(&mut memory);
                    llt::factor::cholesky_in_place(matrix.rb_mut(), default(), Par::Seq, stack, default())
                        .unwrap();
                },
            ];
            for (best, work) in best.iter_mut().zip(&mut works) {
                *best = best.min(time(work));
            }
            let mut works: [&mut dyn FnMut(); 2] = [
                &mut || {
                    x.fill(black_box(1.0));
                    forward(&l, n, &mut x);
                    backward(&l, n, &mut x);
                },
                &mut || {
                    y.fill(black_box(1.0));
                    let factor = MatRef::from_column_major_slice(&c, n, n);
                    let mut right = MatMut::from_column_major_slice_mut(&mut y, n, 1);
                    solve_lower_triangular_in_place(factor, right.rb_mut(), Par::Seq);
                    solve_upper_triangular_in_place(factor.transpose(), right.rb_mut(), Par::Seq);
                },
            ];
            for (best, work) in best[2..].iter_mut().zip(&mut works) {
                *best = best.min(time(work));
            }
        }
        let [a, b, c, d] = best;
        println!("{n:>4} {a:>12.0} {b:>12.0} {:>6.2}   {c:>12.0} {d:>12.0} {:>6.2}", b / a, d / c);
    }
    of_nalgebra();
    of_panels();
}

/// Elimination with row exchanges and a solution, and eigenvalues with vectors of a symmetric matrix.
fn of_nalgebra() {
    println!(
        "\n{:>4} {:>12} {:>12} {:>6}   {:>12} {:>12} {:>6}",
        "n", "nalgebra LU", "faer", "ratio", "eigenvalues", "faer", "ratio"
    );
    for n in [2, 4, 8, 16, 24, 32, 64] {
        let entry = |i: usize, j: usize| f64::from(i == j) + 0.3 / (1.0 + i.abs_diff(j) as f64).powi(2);
        let own = DMatrix::from_fn(n, n, entry);
        let other = Mat::from_fn(n, n, entry);
        let (right, side) = (DVector::from_element(n, 1.0), Mat::<f64>::from_fn(n, 1, |_, _| 1.0));
        let mut best = [f64::INFINITY; 4];
        for _ in 0..ROUNDS {
            let mut works: [&mut dyn FnMut(); 4] = [
                &mut || _ = black_box(black_box(&own).clone().lu().solve(&right)),
                &mut || _ = black_box(black_box(&other).partial_piv_lu().solve(&side)),
                &mut || _ = black_box(black_box(&own).clone().symmetric_eigen()),
                &mut || _ = black_box(black_box(&other).self_adjoint_eigen(Side::Lower)),
            ];
            for (best, work) in best.iter_mut().zip(&mut works) {
                *best = best.min(time(work));
            }
        }
        let [a, b, c, d] = best;
        println!("{n:>4} {a:>12.0} {b:>12.0} {:>6.2}   {c:>12.0} {d:>12.0} {:>6.2}", b / a, d / c);
    }
}

/// Eliminates a panel, compiled for the instruction sets of the crate's kernels on machines of this kind.
#[cfg_attr(target_arch = "x86_64", target_feature(enable = "avx2,fma"))]
fn eliminate(panel: &mut [f64], d: usize, width: usize, lu: &mut [f64], pivots: &mut [u16]) {
    let length = d.next_multiple_of(8) + width;
    vectors::for_vectors!(length / 8, eliminated(panel, d, width, lu, pivots));
}

#[inline(always)]
fn eliminated<const V: usize>(panel: &mut [f64], d: usize, width: usize, lu: &mut [f64], pivots: &mut [u16]) {
    lu::eliminate::<V>(panel, d, width, lu, pivots).unwrap();
}

/// The elimination of a segment: d rows, solved for `width` columns.
fn of_panels() {
    #[cfg(target_arch = "x86_64")]
    if !(std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")) {
        return;
    }
    println!("\n{:>4} {:>6} {:>12} {:>12} {:>6}", "d", "width", "panel", "faer", "ratio");
    for (d, width) in [(2usize, 8usize), (4, 16), (8, 16), (12, 16), (12, 24), (24, 24)] {
        let entry = |i: usize, j: usize| f64::from(i == j) + 0.3 / (1.0 + i.abs_diff(j) as f64).powi(2);
        let first = d.next_multiple_of(8);
        let mut from = vec![0.0; d * (first + width)];
        for i in 0..d {
            (0..d).for_each(|j| from[i * (first + width) + j] = entry(i, j));
            (0..width).for_each(|j| from[i * (first + width) + first + j] = 1.0 / (1 + i + j) as f64);
        }
        let (mut panel, mut factors, mut pivots) = (from.clone(), vec![0.0; d * d], vec![0u16; d]);
        let matrix = Mat::from_fn(d, d, entry);
        let right = Mat::from_fn(d, width, |i, j| 1.0 / (1 + i + j) as f64);
        let (mut a, mut x) = (matrix.clone(), right.clone());
        let (mut permutation, mut inverse) = (vec![0usize; d], vec![0usize; d]);
        let of_solution = solve_in_place_scratch::<usize, f64>(d, width, Par::Seq);
        let of_factor = lu_in_place_scratch::<usize, f64>(d, d, Par::Seq, default());
        let mut memory = MemBuffer::new(StackReq::any_of(&[of_solution, of_factor]));
        let mut best = [f64::INFINITY; 2];
        for _ in 0..ROUNDS {
            let mut works: [&mut dyn FnMut(); 2] = [
                &mut || {
                    panel.copy_from_slice(black_box(&from));
                    // SAFETY: the machine has these instructions, as was asked above.
                    #[allow(unused_unsafe)]
                    unsafe {
                        eliminate(&mut panel, d, width, &mut factors, &mut pivots);
                    }
                },
                &mut || {
                    a.copy_from(black_box(&matrix));
                    x.copy_from(black_box(&right));
                    let stack = MemStack::new(&mut memory);
                    let (permutation, inverse) = (&mut permutation[..], &mut inverse[..]);
                    let (_, rows) = lu_in_place(a.as_mut(), permutation, inverse, Par::Seq, stack, default());
                    solve_in_place(a.as_ref(), a.as_ref(), rows, x.as_mut(), Par::Seq, stack);
                },
            ];
            for (best, work) in best.iter_mut().zip(&mut works) {
                *best = best.min(time(work));
            }
        }
        let [a, b] = best;
        println!("{d:>4} {width:>6} {a:>12.0} {b:>12.0} {:>6.2}", b / a);
    }
}
