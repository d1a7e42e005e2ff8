//! The published optimum of the unstable aircraft from all derivatives 0, and its simulated twin.

#[path = "../../examples/unstable_aircraft.rs"]
#[allow(dead_code)] // its main
mod example;

use example::common;
use phugoid::solver::Status;
use phugoid::{Estimation, Experiment, Fit, Model};

fn fit(model: &Model, record: Experiment, order: usize) -> Fit {
    let fit = Estimation::new(model, &[record]).order(order).solve().unwrap();
    assert_eq!(fit.status, Status::Converged);
    // The data of the book were made with the trapezoid at the sample times, whose steps are wrong by far more than their noise.
    let coarse = |w: &String| order == 2 && w.starts_with("the mesh is coarse");
    assert!(fit.warnings.iter().all(coarse), "{:?}", fit.warnings);
    fit
}

/// The record does not ship with the project.
#[test]
fn its_published_optimum() {
    let model = example::model().unwrap();
    let Some(path) = common::find(example::RECORD) else {
        return println!("skipped: {} is neither in $PHUGOID_DATA nor in ../shared/data", example::RECORD);
    };
    let fit = fit(&model, example::experiment(&model, &path).unwrap(), 2);
    for (name, value) in example::PUBLISHED {
        let found = fit[name].value;
        assert!((found / value - 1.0).abs() < 1e-10, "{name} = {found}, published {value}");
    }
}

/// The truth within five standard errors.
#[test]
fn its_simulated_twin() {
    let model = example::model().unwrap();
    let fit = fit(&model, example::twin(&model, 0).unwrap(), 4);
    for (name, value) in example::PUBLISHED {
        assert!((fit[name].value - value).abs() < 5.0 * fit[name].std_error, "{:?}, not {value}", fit[name]);
    }
}
