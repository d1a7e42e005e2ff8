//! Each callback, the Newton system and a whole estimation timed apart, on the simulated twin of the
//! HFB-320 record with 601 samples and, 100 times as dense, 60,001.
//!
//!     cargo bench -p phugoid --bench hfb320 [-- 'callbacks/601']

#[path = "../examples/hfb320.rs"]
#[allow(dead_code)] // its main
mod hfb320;

use std::hint::black_box;

use criterion::{
    BenchmarkGroup, BenchmarkId, Criterion, criterion_group, criterion_main, measurement::WallTime,
};
use phugoid::collocation::Collocation;
use phugoid::linalg::{Effort, Entries, kkt_for};
use phugoid::nlp::Nlp;
use phugoid::solver::{Status, state_units};
use phugoid::{Estimation, Experiment, Model};

type Group<'a> = BenchmarkGroup<'a, WallTime>;

const SIZES: [usize; 2] = [601, 60_001];
/// Order 2: as many mesh points as samples.
const ORDER: usize = 2;

fn case(n: usize) -> (Model, Vec<Experiment>) {
    let model = hfb320::model().unwrap();
    let records = vec![hfb320::twin(&model, n, 0).unwrap()];
    (model, records)
}

/// The problem at the published optimum, states as measured: what a late iteration sees.
fn problem(n: usize) -> (Collocation, Vec<f64>) {
    let (model, records) = case(n);
    let mut estimation = Estimation::new(&model, &records).order(ORDER);
    for (name, value) in hfb320::PUBLISHED {
        estimation = estimation.start(name, value);
    }
    estimation.transcribe().unwrap()
}

fn groups(c: &mut Criterion, name: &str, mut each: impl FnMut(&mut Group<'_>, usize)) {
    let mut group = c.benchmark_group(name);
    for n in SIZES {
        group.sample_size(if n > 10_000 { 10 } else { 50 });
        each(&mut group, n);
    }
    group.finish();
}

fn callbacks(c: &mut Criterion) {
    groups(c, "callbacks", |group, n| {
        let (p, xi) = problem(n);
        let x = || black_box(&xi[..]);
        let (mut g, mut r) = (vec![0.0; p.n()], vec![0.0; p.m()]);
        let (mut j, mut h) =
            (vec![0.0; p.jacobian_structure().len()], vec![0.0; p.hessian_structure().len()]);
        let lambda = vec![1e-3; p.m()];
        let mut time = |what: &str, call: &mut dyn FnMut()| {
            group.bench_function(BenchmarkId::new(n.to_string(), what), |b| b.iter(&mut *call));
        };
        time("objective", &mut || _ = black_box(p.objective(x()).unwrap()));
        time("gradient", &mut || p.gradient(x(), &mut g).unwrap());
        time("constraints", &mut || p.constraints(x(), &mut r).unwrap());
        time("jacobian", &mut || p.jacobian(x(), &mut j).unwrap());
        time("hessian", &mut || p.hessian(x(), 1.0, &lambda, &mut h).unwrap());
        time("gauss_newton", &mut || p.gauss_newton(x(), 1.0, &mut h).unwrap());
    });
}

/// The arrow factorisation of the Gauss-Newton system with its completion, and solutions of it.
fn kkt(c: &mut Criterion) {
    groups(c, "kkt", |group, n| {
        let (p, xi) = problem(n);
        let (mut gradient, mut residual) = (vec![0.0; p.n()], vec![0.0; p.m()]);
        let (mut jacobian, mut hessian) =
            (vec![0.0; p.jacobian_structure().len()], vec![0.0; p.hessian_structure().len()]);
        p.gradient(&xi, &mut gradient).unwrap();
        p.constraints(&xi, &mut residual).unwrap();
        p.jacobian(&xi, &mut jacobian).unwrap();
        p.gauss_newton(&xi, 1.0, &mut hessian).unwrap();
        let held = vec![false; p.n()];
        let entries = Entries { hessian: &hessian, jacobian: &jacobian };
        let mut kkt = kkt_for(&p, &state_units(&p, &xi));
        group.bench_function(BenchmarkId::new(n.to_string(), "factorize"), |b| {
            b.iter(|| {
                let factor = kkt.factorize(&entries, Effort::FULL).unwrap();
                assert!(factor.finish(&held, 0.0).is_positive());
            })
        });
        let (mut d, mut lambda) = (vec![0.0; p.n()], vec![0.0; p.m()]);
        for (what, refine) in [("solve", false), ("solve_refined", true)] {
            let factor = kkt.factorize(&entries, Effort { refine, hurry: false }).unwrap();
            assert!(factor.finish(&held, 0.0).is_positive());
            group.bench_function(BenchmarkId::new(n.to_string(), what), |b| {
                b.iter(|| factor.solve(&gradient, &residual, &mut d, &mut lambda))
            });
        }
    });
}

/// From all derivatives 0 to the fit with its standard errors, transcription included.
fn estimate(c: &mut Criterion) {
    groups(c, "estimate", |group, n| {
        let (model, records) = case(n);
        group.bench_function(n.to_string(), |b| {
            b.iter(|| {
                let fit = Estimation::new(&model, &records).order(ORDER).solve().unwrap();
                assert_eq!(fit.status, Status::Converged);
            })
        });
    });
}

criterion_group!(benches, callbacks, kkt, estimate);
criterion_main!(benches);
