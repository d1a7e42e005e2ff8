//! Unstable aircraft, short period: output error without any stabilisation, in Rust alone.
//!
//! The data are simulated and almost free of noise, so standard deviations end eight orders of magnitude
//! below the signals; single shooting diverges on such a system. Estimated from all derivatives 0.
//!
//!     cargo run --release --example unstable_aircraft [unStabAC_sim.asc]

pub mod common;

use std::error::Error;
use std::path::Path;

use phugoid::{Estimation, Experiment, Interpolation, Model, Parameter};

pub const RECORD: &str = "unStabAC_sim.asc";

/// The optimum published with the paper, in the order of the model.
pub const PUBLISHED: [(&str, f64); 6] = [
    ("Zw", -1.4266610873826133),
    ("Zq", -1.5450850965346954),
    ("Zde", -6.263202600623347),
    ("Mw", 0.21660638419854875),
    ("Mq", -3.7017914082981997),
    ("Mde", -12.768768280554982),
];

/// The paper's model (section Simulated unstable aircraft short period).
pub fn model() -> Result<Model, phugoid::Error> {
    let u0 = 44.5695; // m/s
    let mut m = Model::new("unstable aircraft, short period");
    let (w, q, de) = (m.state("w", "m/s")?, m.state("q", "rad/s")?, m.input("de", "rad")?);
    let mut p = |name, unit: &str| m.parameter(Parameter::new(name, 0.0).unit(unit));
    let (zw, zq, zde) = (p("Zw", "1/s")?, p("Zq", "m/s")?, p("Zde", "m/s²")?);
    let (mw, mq, mde) = (p("Mw", "1/(m s)")?, p("Mq", "1/s")?, p("Mde", "1/s²")?);

    m.equation("w", &zw * &w + (u0 + &zq) * &q + &zde * &de)?;
    m.equation("q", mw * &w + mq * &q + mde * &de)?;
    m.output("w", w.clone(), "")?;
    m.output("q", q.clone(), "")?;
    m.output("az", zw * w + zq * q + zde * de, "m/s²")?;
    Ok(m)
}

/// The simulated record of the book.
pub fn experiment(model: &Model, path: &Path) -> Result<Experiment, Box<dyn Error>> {
    let columns = common::columns(path)?;
    let t = (0..columns[0].len()).map(|k| 0.05 * k as f64).collect();
    let channels = [("w", 2), ("q", 3), ("de", 4), ("az", 5)].map(|(name, c)| (name, columns[c].clone()));
    Ok(Experiment::new(model, "unstable aircraft", t, channels)?)
}

/// A record of the same kind: a pilot's oscillation with feedback that keeps the aircraft in the air.
pub fn twin(model: &Model, seed: u64) -> Result<Experiment, phugoid::Error> {
    let t: Vec<f64> = (0..251).map(|k| 0.05 * k as f64).collect();
    let end = t[250];
    let elevator = |t: f64, x: &[f64]| {
        let pilot = 0.05 * (1.3 * t).sin() * (std::f64::consts::PI * t / end).sin().powi(2);
        vec![pilot + 0.04 * x[0] + 0.3 * x[1]]
    };
    let parameters = PUBLISHED.map(|p| p.1);
    let states = common::simulate(model, &parameters, &t, &[0.0, 0.0], 20, elevator)?;
    let de = t.iter().enumerate().map(|(k, t)| elevator(*t, &[states[0][k], states[1][k]])[0]).collect();
    let inputs = vec![de];
    let outputs = common::measure(model, &parameters, &t, &inputs, &states, &[0.02, 0.0005, 0.01], seed)?;
    let name = "unstable aircraft, twin".into();
    Ok(Experiment { name, t, inputs, outputs, interpolation: Interpolation::Cubic, signals: Vec::new() })
}

fn main() -> Result<(), Box<dyn Error>> {
    let model = model()?;
    // The book's data were made with the trapezoid at the sample times: order 2 repeats them to nine digits.
    let (record, order) = match common::argument_or_find(RECORD) {
        Some(path) => (experiment(&model, &path)?, 2),
        None => (twin(&model, 0)?, 4),
    };
    let fit = Estimation::new(&model, &[record]).order(order).solve()?;
    println!("{fit}");
    common::compare(&fit, &PUBLISHED);
    Ok(())
}
