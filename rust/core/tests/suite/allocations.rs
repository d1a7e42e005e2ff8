//! Nothing is allocated inside an iteration.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use crate::common::flights::{self, problem};
use crate::common::models;
use phugoid::collocation::Settings;
use phugoid::online::{self, Detect, Forgetting, Online};
use phugoid::solver::{Control, Settings as Options, solve};

/// Counts allocations, and passes them on.
struct Counting;

thread_local! {
    // Of this thread alone: that of the test harness allocates when it likes.
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: everything is passed on to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, p: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(p, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn no_iteration_allocates_once_the_buffers_are_there() {
    for order in [2, 4] {
        let (p, xi) = problem(&models::linear(), 241, &Settings::default().order(order).threads(1));
        let options = Options::default().tolerance(1e-300).max_iterations(9);
        // Allocations so far, at each iteration.
        let mut counts: Vec<usize> = Vec::with_capacity(100);
        let solution = solve(&p, &xi, None, &options, &mut |_| {
            counts.push(COUNT.get());
            Control::Continue
        })
        .unwrap();
        let evaluations = solution.evaluations;
        assert!(evaluations.hessian >= 2 && evaluations.gauss_newton >= 3, "{evaluations:?}");
        // Only the first exact Hessian: the thread's workspace grows for its tape.
        let grown: Vec<usize> = counts.windows(2).map(|w| w[1] - w[0]).collect();
        let some: Vec<usize> = grown.iter().copied().filter(|g| *g > 0).collect();
        assert!(some.len() <= 1 && some.iter().all(|g| *g < 10), "order {order}: {grown:?}");
    }
}

#[test]
fn a_sample_that_is_pushed_takes_no_memory() {
    let model = models::linear();
    let flight = flights::record(300, 5);
    let detect = Detect::new(1e4).watch("Mde").watch("Zw").onsets(5);
    for window in [1, 8] {
        let mut settings = online::Settings::default()
            .window(window)
            .detect(detect.clone())
            .forgetting(Forgetting::Directional(10.0))
            .process_noise("q", 0.01)
            .estimate_noise(true);
        for (output, sigma) in ["w", "q", "az"].into_iter().zip(flights::SIGMA) {
            settings = settings.sigma(output, sigma);
        }
        let mut bounded = model.clone();
        bounded.parameters[0].upper = Some(0.0);
        let mut estimator = Online::new(&bounded, settings).unwrap();
        let before = COUNT.get();
        for k in 0..flight.t.len() {
            let mut outputs = [flight.outputs[0][k], flight.outputs[1][k], flight.outputs[2][k]];
            outputs[2] = if k % 3 == 0 { outputs[2] } else { f64::NAN };
            estimator.push(flight.t[k], &[flight.inputs[0][k]], &outputs).unwrap();
            if k > 3 && window > 1 {
                let late = [f64::NAN, flight.outputs[1][k], f64::NAN];
                estimator.push(flight.t[k] - 0.07, &[f64::NAN], &late).unwrap();
            }
            // Nor does one that is refused.
            estimator.push(f64::NAN, &[0.0], &outputs).unwrap_err();
            estimator.push(flight.t[k], &[f64::INFINITY], &outputs).unwrap_err();
        }
        estimator.restart();
        assert_eq!(COUNT.get() - before, 0, "window {window}");
    }
}
