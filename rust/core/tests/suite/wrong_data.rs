//! Data and options that do not fit the model are named, never a panic.

use crate::common::models::{known_noise, linear, record};
use phugoid::collocation::{Collocation, Settings};
use phugoid::noise::{Noise, Sigma};
use phugoid::{Error, ErrorKind, Experiment, Grid};

fn build(records: &[Experiment], noise: Noise, settings: &Settings) -> Result<Collocation, Error> {
    Collocation::new(&linear(), records, noise, settings)
}

/// The text of the error for a record spoilt in some way.
fn spoilt(spoil: impl FnOnce(&mut Experiment)) -> String {
    let model = linear();
    let mut r = record(&model, "flight 7", 20, false, 1);
    spoil(&mut r);
    match build(&[record(&model, "good", 20, false, 2), r], known_noise(&model), &Settings::default()) {
        Err(error) if error.kind() == ErrorKind::Data => error.to_string(),
        other => panic!("{:?}", other.map(|_| ())),
    }
}

fn names(text: &str, words: &[&str]) {
    for word in ["flight 7"].iter().chain(words) {
        assert!(text.contains(word), "'{word}' is not in: {text}");
    }
}

#[test]
fn records_that_do_not_fit() {
    names(&spoilt(|r| r.outputs[1][3] = f64::INFINITY), &["'q'", "inf", "sample 3"]);
    names(&spoilt(|r| r.inputs[0][5] = f64::NAN), &["'de'", "NaN", "sample 5"]);
    names(&spoilt(|r| r.t[4] = r.t[3]), &["time", "sample 3"]);
    names(&spoilt(|r| r.t.swap(8, 9)), &["time", "sample 8"]);
    names(&spoilt(|r| r.t[2] = f64::NAN), &["time 2"]);
    names(&spoilt(|r| r.outputs[2].truncate(19)), &["'az'", "19", "20"]);
    names(&spoilt(|r| r.inputs.clear()), &["0 inputs", "1 and 3"]);
    names(&spoilt(|r| drop(r.outputs.pop())), &["2 outputs"]);
    names(
        &spoilt(|r| {
            r.t.truncate(1);
            r.inputs.iter_mut().chain(&mut r.outputs).for_each(|c| c.truncate(1));
        }),
        &["1 samples"],
    );
}

#[test]
fn an_output_may_be_measured_by_one_record_alone() {
    let model = linear();
    let mut records = [record(&model, "one", 20, false, 1), record(&model, "two", 20, false, 2)];
    records[1].outputs[0].fill(f64::NAN);
    assert!(build(&records, known_noise(&model), &Settings::default()).is_ok());
    for unmeasured in [&records[1..], &[records[1].clone(), records[1].clone()]] {
        match build(unmeasured, known_noise(&model), &Settings::default()) {
            Err(error) if error.kind() == ErrorKind::Data => {
                let text = error.to_string();
                assert!(text.contains("'w'") && text.contains("no samples"), "{text}");
                assert!(error.names().contains(&"w".to_owned()), "{error:?}");
            }
            other => panic!("{:?}", other.map(|_| ())),
        }
    }
}

#[test]
fn no_experiments() {
    let result = build(&[], known_noise(&linear()), &Settings::default());
    assert!(
        matches!(result, Err(e) if e.kind() == ErrorKind::Data && e.to_string().contains("no experiment"))
    );
}

#[test]
fn options_out_of_range() {
    let model = linear();
    let records = [record(&model, "one", 20, false, 1), record(&model, "two", 20, false, 2)];
    let of = |settings: Settings| match build(&records, known_noise(&model), &settings) {
        Err(error) if error.kind() == ErrorKind::Option => error.to_string(),
        other => panic!("{:?}", other.map(|_| ())),
    };
    assert!(of(Settings::default().order(1)).contains("order 1"));
    let grid = vec![Grid::Samples(1); 3];
    assert!(of(Settings::default().grid(grid)).contains("3 grids for 2 experiments"));
    assert!(of(Settings::default().grid(vec![])).contains("0 grids"));
}

#[test]
fn noise_that_does_not_fit_the_outputs() {
    let records = [record(&linear(), "one", 20, false, 1)];
    let of = |sigmas: Vec<Sigma>| match build(&records, Noise::Gaussian(sigmas), &Settings::default()) {
        Err(error) if [ErrorKind::Option, ErrorKind::Model].contains(&error.kind()) => error.to_string(),
        other => panic!("{:?}", other.map(|_| ())),
    };
    let known = Sigma::Known(0.5);
    assert!(of(vec![known.clone(); 2]).contains("3 outputs"));
    assert!(of(vec![known.clone(); 4]).contains("3 outputs"));
    for wrong in [
        Sigma::Known(0.0),
        Sigma::Known(-1.0),
        Sigma::Known(f64::NAN),
        Sigma::Known(f64::INFINITY),
        Sigma::Unknown { start: 0.0, lower: 1e-3, upper: 1e3 },
        Sigma::Unknown { start: 1.0, lower: -1.0, upper: 1e3 },
        Sigma::Unknown { start: 1.0, lower: 2.0, upper: 1e3 },
        Sigma::Unknown { start: 1.0, lower: 1e-3, upper: 0.5 },
        Sigma::Unknown { start: f64::NAN, lower: 1e-3, upper: 1e3 },
    ] {
        let text = of(vec![known.clone(), wrong.clone(), known.clone()]);
        assert!(text.contains("'q'") || text.contains("sigma_q"), "{wrong:?}: {text}");
    }
}
