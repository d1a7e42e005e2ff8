//! Results are the same to the bit for any number of threads.

use crate::common::models::{guess, mixed_noise, nonlinear, record};
use phugoid::Grid;
use phugoid::collocation::{Collocation, Settings};
use phugoid::nlp::Nlp;

/// Everything that the problem computes at a point, as bits.
fn evaluate(order: usize, grid: Grid, threads: usize) -> Vec<Vec<u64>> {
    let model = nonlinear();
    // Enough blocks of samples, in two records, that the work is divided.
    let records = [record(&model, "one", 3500, true, 1), record(&model, "two", 900, false, 2)];
    let settings = Settings::default().order(order).grid(vec![grid]).threads(threads);
    let p = Collocation::new(&model, &records, mixed_noise(&model), &settings).unwrap();
    let xi = guess(&p, 3);
    let lambda: Vec<f64> = (0..p.m()).map(|i| (0.37 * i as f64).sin()).collect();
    let mut gradient = vec![0.0; p.n()];
    let mut constraints = vec![0.0; p.m()];
    let mut jacobian = vec![0.0; p.jacobian_structure().len()];
    let mut hessian = vec![0.0; p.hessian_structure().len()];
    p.gradient(&xi, &mut gradient).unwrap();
    p.constraints(&xi, &mut constraints).unwrap();
    p.jacobian(&xi, &mut jacobian).unwrap();
    p.hessian(&xi, 0.7, &lambda, &mut hessian).unwrap();
    let objective = vec![p.objective(&xi).unwrap()];
    let bits = |v: Vec<f64>| v.into_iter().map(f64::to_bits).collect();
    [objective, gradient, constraints, jacobian, hessian].map(bits).into()
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    for (order, grid) in [(2, Grid::Samples(1)), (4, Grid::Samples(1)), (4, Grid::Uniform(1500))] {
        let one = evaluate(order, grid.clone(), 1);
        for threads in [2, 4, 7, 0] {
            let many = evaluate(order, grid.clone(), threads);
            for (what, (a, b)) in ["objective", "gradient", "constraints", "Jacobian", "Hessian"]
                .iter()
                .zip(one.iter().zip(&many))
            {
                let different = a.iter().zip(b).filter(|(a, b)| a != b).count();
                assert_eq!(different, 0, "{what} of order {order}, {grid:?} on {threads} threads");
            }
        }
    }
}

/// A problem evaluated by several threads at once does not mix them up.
#[test]
fn callers_on_several_threads_do_not_disturb_each_other() {
    let model = nonlinear();
    let records = [record(&model, "one", 300, true, 1)];
    let p = Collocation::new(&model, &records, mixed_noise(&model), &Settings::default()).unwrap();
    let points: Vec<Vec<f64>> = (0..4).map(|i| guess(&p, 10 + i)).collect();
    let constraints = |xi: &[f64]| {
        let mut out = vec![0.0; p.m()];
        p.constraints(xi, &mut out).unwrap();
        out
    };
    let alone: Vec<Vec<f64>> = points.iter().map(|xi| constraints(xi)).collect();
    std::thread::scope(|scope| {
        for (xi, expected) in points.iter().zip(&alone) {
            scope.spawn(|| (0..50).for_each(|_| assert_eq!(constraints(xi), *expected)));
        }
    });
}
