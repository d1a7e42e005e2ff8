//! Models saved by Python, with their noise and delays, are estimated here to what Python estimates, in as many
//! iterations. The file is made by tools/saved_estimates.py; tests/test_saved_estimates.py repeats it in Python.

use phugoid::shooting::Shots;
use phugoid::solver::Status;
use phugoid::{Estimation, Experiment, Grid, Interpolation, Model};
use serde_json::Value;

fn numbers(list: &Value) -> Vec<f64> {
    list.as_array().unwrap().iter().map(|v| v.as_f64().unwrap_or(f64::NAN)).collect()
}

fn experiment(model: &Model, saved: &Value) -> Experiment {
    let (inputs, outputs) = (saved["inputs"].as_object().unwrap(), saved["outputs"].as_object().unwrap());
    let channels = inputs.iter().chain(outputs).map(|(name, v)| (name.as_str(), numbers(v)));
    let mut run =
        Experiment::new(model, saved["name"].as_str().unwrap(), numbers(&saved["t"]), channels).unwrap();
    if saved["cubic"] == Value::Bool(true) {
        run.interpolation = Interpolation::Cubic;
    }
    run
}

#[track_caller]
fn assert_close(what: &str, found: f64, expected: f64, relative: f64) {
    let difference = (found - expected).abs();
    assert!(difference <= relative * expected.abs() + 1e-12, "{what}: {found:e}, in Python {expected:e}");
}

#[test]
fn estimates_are_those_of_python() {
    let saved: Value = serde_json::from_str(include_str!("data/saved_estimates.json")).unwrap();
    let cases = saved["cases"].as_array().unwrap();
    assert!(cases.len() > 12);
    for case in cases {
        let name = case["name"].as_str().unwrap();
        let model = Model::from_json(&case["model"].to_string()).unwrap();
        assert_eq!(Model::from_json(&model.to_json()).unwrap(), model, "{name}");
        let records = saved["records"][case["records"].as_str().unwrap()].as_array().unwrap();
        let runs: Vec<Experiment> = records.iter().map(|r| experiment(&model, r)).collect();
        let mut estimation = Estimation::new(&model, &runs);
        let options = &case["options"];
        if let Some(order) = options["order"].as_u64() {
            estimation = estimation.order(order as usize);
        }
        if let Some(segments) = options["uniform"].as_u64() {
            estimation = estimation.grid(Grid::Uniform(segments as usize));
        }
        if let Some(segments) = options["shooting"].as_u64() {
            let grid = vec![Grid::Uniform(segments as usize)];
            estimation = estimation.shooting(Shots { grid, ..Shots::default() });
        }
        for (name, value) in options["start"].as_object().into_iter().flatten() {
            estimation = estimation.start(name, value.as_f64().unwrap());
        }
        let fit = estimation.solve().unwrap();
        assert_eq!(fit.status, Status::Converged, "{name}");
        assert_eq!(fit.iterations as u64, case["iterations"].as_u64().unwrap(), "{name}: iterations");
        assert_close(name, fit.log_likelihood, case["log_likelihood"].as_f64().unwrap(), 1e-10);
        let expected = case["estimates"].as_object().unwrap();
        assert_eq!(fit.parameters.len(), expected.len(), "{name}");
        for (p, pair) in expected {
            let what = format!("{name}: {p}");
            let found = fit.parameter(p).unwrap_or_else(|| panic!("{what} is missing"));
            assert_close(&what, found.value, pair[0].as_f64().unwrap(), 1e-9);
            match pair[1].as_f64() {
                Some(error) => assert_close(&format!("{what}, its error"), found.std_error, error, 1e-8),
                None => assert!(found.std_error.is_nan(), "{what}: {}", found.std_error),
            }
        }
        for record in &fit.records {
            for x in &record.initial {
                let expected = case["initial"][format!("{} {}", record.name, x.name)].as_f64().unwrap();
                assert_close(&format!("{name}: {} of {}", x.name, record.name), x.value, expected, 1e-8);
            }
        }
    }
}
