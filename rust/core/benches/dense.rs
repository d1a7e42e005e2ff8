//! The loops of the dense module against faer, both in turn in one process: nanoseconds of a factorisation and of a solution.
//!
//!     cargo bench --bench dense

use std::hint::black_box;
use std::time::{Duration, Instant};

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt;
use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::prelude::{ReborrowMut, default};
use faer::{MatMut, MatRef, Par};
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
}
