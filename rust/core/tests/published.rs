//! The published optima on the records they belong to, from all derivatives 0. The records do not ship with the
//! project: where they are absent, simulated twins are fitted instead.

#[path = "../examples/common/mod.rs"]
mod common;
#[path = "../examples/hfb320.rs"]
#[allow(dead_code)] // its main
mod hfb320;
#[path = "../examples/unstable_aircraft.rs"]
#[allow(dead_code)]
mod unstable_aircraft;

use phugoid::solver::Status;
use phugoid::{Estimation, Experiment, Fit, Model};

fn fit(model: &Model, record: Experiment, order: usize) -> Fit {
    let fit = Estimation::new(model, &[record]).order(order).solve().unwrap();
    assert_eq!(fit.status, Status::Converged);
    assert!(fit.warnings.is_empty(), "{:?}", fit.warnings);
    fit
}

#[track_caller]
fn assert_repeats(fit: &Fit, published: &[(&str, f64)], tolerance: f64) {
    for (name, value) in published {
        let error = (fit[*name].value - value).abs();
        assert!(error <= tolerance * value.abs(), "{name} = {}, published {value}", fit[*name].value);
    }
}

/// A twin's truth within five standard errors.
#[track_caller]
fn assert_near(fit: &Fit, truth: &[(&str, f64)]) {
    for (name, value) in truth {
        let found = &fit[*name];
        assert!((found.value - value).abs() < 5.0 * found.std_error, "{found:?}, in truth {value}");
    }
}

#[test]
fn hfb320() {
    let model = hfb320::model().unwrap();
    let Some(path) = common::find(hfb320::RECORD) else {
        println!(
            "{} is neither in $PHUGOID_DATA nor in ../shared/data: only the twin is fitted",
            hfb320::RECORD
        );
        return;
    };
    let fit = fit(&model, hfb320::experiment(&model, &path).unwrap(), 2);
    assert_repeats(&fit, &hfb320::PUBLISHED, 1e-8);
    assert!((fit.log_likelihood - hfb320::LOG_LIKELIHOOD).abs() < 1e-8, "{:.12}", fit.log_likelihood);
}

#[test]
fn twin_of_hfb320() {
    let model = hfb320::model().unwrap();
    assert_near(&fit(&model, hfb320::twin(&model, 601, 0).unwrap(), 4), &hfb320::PUBLISHED);
}

#[test]
fn unstable_aircraft() {
    let model = unstable_aircraft::model().unwrap();
    let Some(path) = common::find(unstable_aircraft::RECORD) else {
        println!("{} is neither in $PHUGOID_DATA nor in ../shared/data", unstable_aircraft::RECORD);
        return;
    };
    let fit = fit(&model, unstable_aircraft::experiment(&model, &path).unwrap(), 2);
    assert_repeats(&fit, &unstable_aircraft::PUBLISHED, 1e-8);
}

#[test]
fn twin_of_the_unstable_aircraft() {
    let model = unstable_aircraft::model().unwrap();
    assert_near(&fit(&model, unstable_aircraft::twin(&model, 0).unwrap(), 4), &unstable_aircraft::PUBLISHED);
}
