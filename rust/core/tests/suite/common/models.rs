//! Models and records that several tests share.

use std::sync::Arc;

use phugoid::Experiment;
use phugoid::Interpolation;
use phugoid::Table;
use phugoid::collocation::Collocation;
use phugoid::expr::{Expr, Lookup, gt, select};
use phugoid::model::{Model, Parameter};
use phugoid::noise::{Noise, Sigma};

use super::Random;

/// Short period of an unstable aircraft, linear in its states.
pub fn linear() -> Model {
    let mut m = Model::new("short period");
    let (w, q) = (m.state("w", "m/s").unwrap(), m.state("q", "rad/s").unwrap());
    let de = m.input("de", "rad").unwrap();
    let [zw, zq, zde, mw, mq, mde] =
        [("Zw", -1.4), ("Zq", -1.5), ("Zde", -6.3), ("Mw", 0.2), ("Mq", -3.7), ("Mde", -12.8)]
            .map(|(name, start)| m.parameter(Parameter::new(name, start)).unwrap());
    m.equation("w", &zw * &w + (44.57 + &zq) * &q + &zde * &de).unwrap();
    m.written_at(Some("aircraft.py:12".into())).equation("q", &mw * &w + &mq * &q + &mde * &de).unwrap();
    m.output("w", w.clone(), "").unwrap();
    m.output("q", q.clone(), "").unwrap();
    m.output("az", &zw * &w + &zq * &q + &zde * &de, "m/s^2").unwrap();
    m
}

pub fn lift_table() -> Arc<Table> {
    Arc::new(Table::new_1d("CLtab", &[-1.0, -0.4, 0.1, 0.6, 1.2], &[-0.7, -0.3, 0.2, 0.5, 0.4]).unwrap())
}

pub fn moment_table() -> Arc<Table> {
    let values = [0.1, -0.2, 0.3, 0.05, 0.4, -0.1, 0.2, 0.15, -0.3, 0.1, 0.0, 0.25];
    Arc::new(Table::new_2d("Cmtab", &[-1.0, 0.0, 0.5, 1.5], &[0.5, 1.2, 2.0], &values).unwrap())
}

pub fn lookup(table: &Arc<Table>, args: &[&Expr]) -> Expr {
    let args = args.iter().map(|a| (*a).clone()).collect();
    Expr::lookup(Lookup { table: table.clone(), order: [0, 0] }, args)
}

/// Three states with products, sines, quotients, a switch, tables, time and quantities; a
/// parameter with a prior, a fixed one, bounds.
pub fn nonlinear() -> Model {
    let mut m = Model::new("stall");
    let v = m.state("V", "m/s").unwrap();
    let (alpha, q) = (m.state("alpha", "rad").unwrap(), m.state("q", "rad/s").unwrap());
    let (de, thrust) = (m.input("de", "rad").unwrap(), m.input("thrust", "N").unwrap());
    let cl0 = m.parameter(Parameter::new("CL0", 0.3).prior((0.2, 0.05))).unwrap();
    let cla = m.parameter(Parameter::new("CLa", 1.7).lower(0.0).upper(9.0)).unwrap();
    let k = m.parameter(Parameter::new("k", 0.4).fixed(true)).unwrap();
    let cma = m.parameter(Parameter::new("Cma", -0.6).prior((-0.5, 0.3))).unwrap();
    let cmq = m.parameter(Parameter::new("Cmq", -0.9)).unwrap();
    let bias = m.parameter(Parameter::new("bias", 0.01)).unwrap();
    let cl = &cl0 + &cla * &alpha + lookup(&lift_table(), &[&alpha]);
    let cl = m.written_at(Some("stall.py:8".into())).quantity("CL", cl).unwrap();
    let cd = select(gt(&alpha, 0.25), &k * &alpha * &alpha * &cl, &k * (&alpha - 0.1) / (1.0 + &cl * &cl));
    let cd = m.quantity("CD", cd).unwrap();
    let time = m.time();
    m.equation("alpha", &q - &cl * &v / (1.0 + &v * &v) + 0.1 * time.sin()).unwrap();
    m.equation("V", &thrust / &v - &cd * &v * &v - (&alpha - &k).sin()).unwrap();
    let cm =
        &cma * &alpha + &cmq * &q * (0.3 * &alpha).exp() + lookup(&moment_table(), &[&alpha, &v]) + &de * &v;
    m.equation("q", cm).unwrap();
    m.output("V", v.clone(), "").unwrap();
    m.output("alpha", &alpha + &bias * &v, "rad").unwrap();
    m.output("q", q.clone(), "").unwrap();
    m.output("az", &cl * &v * &v * alpha.cos() + &cd * alpha.sin() + &de, "m/s^2").unwrap();
    m
}

/// ẋ = a·x + sin(x)·u, one state and one output.
pub fn scalar() -> Model {
    let mut m = Model::new("scalar");
    let (x, u) = (m.state("x", "").unwrap(), m.input("u", "").unwrap());
    let a = m.parameter(Parameter::new("a", -0.8)).unwrap();
    m.equation("x", &a * &x * &x + x.sin() * &u).unwrap();
    m.output("y", &x * &x + &a, "").unwrap();
    m
}

/// A record with made-up samples at irregular times, every fifth or so missing where wanted.
pub fn record(model: &Model, name: &str, n: usize, missing: bool, seed: u64) -> Experiment {
    let mut random = Random(seed);
    let mut t = vec![0.3];
    for _ in 1..n {
        t.push(t[t.len() - 1] + random.between(0.04, 0.11));
    }
    let mut channel = || -> Vec<f64> { (0..n).map(|_| random.between(0.4, 1.2)).collect() };
    let inputs = model.inputs.iter().map(|_| channel()).collect();
    let mut outputs: Vec<Vec<f64>> = model.outputs.iter().map(|_| channel()).collect();
    if missing {
        for (c, output) in outputs.iter_mut().enumerate().skip(1) {
            output.iter_mut().skip(c).step_by(5).for_each(|v| *v = f64::NAN);
        }
    }
    Experiment {
        name: name.to_owned(),
        t,
        inputs,
        outputs,
        interpolation: Interpolation::Linear,
        signals: Vec::new(),
    }
}

/// Known and unknown standard deviations in turn.
pub fn mixed_noise(model: &Model) -> Noise {
    let sigma = |c: usize| match c % 2 {
        0 => Sigma::Unknown { start: 0.5 + 0.1 * c as f64, lower: 1e-3, upper: 1e3 },
        _ => Sigma::Known(0.7),
    };
    Noise::Gaussian((0..model.outputs.len()).map(sigma).collect())
}

pub fn known_noise(model: &Model) -> Noise {
    Noise::Gaussian(vec![Sigma::Known(0.5); model.outputs.len()])
}

/// Parameters at their starts, states random about 0.8 or so.
pub fn guess(problem: &Collocation, seed: u64) -> Vec<f64> {
    let mut random = Random(seed);
    let mut xi: Vec<f64> = problem.posed.parameters.iter().map(|p| p.start).collect();
    xi.resize_with(problem.layout.n(), || random.between(0.5, 1.1));
    xi
}
