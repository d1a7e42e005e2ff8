//! Records of the short period in `models::linear`, simulated, with noise.

use phugoid::Experiment;
use phugoid::Interpolation;
use phugoid::collocation::{Collocation, Settings};
use phugoid::model::Model;
use phugoid::nlp::ExperimentId;
use phugoid::noise::{Noise, Sigma};

use super::Random;

/// Zw, Zq, Zde, Mw, Mq, Mde: unstable.
pub const TRUTH: [f64; 6] = [-1.4, -1.5, -6.3, 0.2, -3.7, -12.8];
/// Standard deviations of the outputs w, q, az.
pub const SIGMA: [f64; 3] = [0.2, 0.01, 0.5];

fn slope(x: [f64; 2], de: f64) -> [f64; 2] {
    let [zw, zq, zde, mw, mq, mde] = TRUTH;
    [zw * x[0] + (44.57 + zq) * x[1] + zde * de, mw * x[0] + mq * x[1] + mde * de]
}

/// n samples at 0.05 s of a pilot who keeps it in the air: feedback, and an oscillation of his own.
pub fn record(n: usize, seed: u64) -> Experiment {
    let mut random = Random(seed);
    let mut normal = || (0..12).map(|_| random.between(0.0, 1.0)).sum::<f64>() - 6.0;
    let h = 0.05;
    let t: Vec<f64> = (0..n).map(|i| h * i as f64).collect();
    let (mut x, mut before) = ([0.0, 0.0], 0.0);
    let (mut de, mut w, mut q, mut az) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for time in &t {
        let now = 0.1 * (1.3 * time).sin() + 0.03 * (4.0 * time).sin() + 0.05 * x[0] + 0.2 * x[1];
        // The input of the interval before runs linearly to this one: integrate over it now.
        if *time > 0.0 {
            let steps = 20;
            let k = h / f64::from(steps);
            for s in 0..steps {
                let at = |f: f64| before + (now - before) * (f64::from(s) + f) / f64::from(steps);
                let add = |x: [f64; 2], f: f64, d: [f64; 2]| [x[0] + f * d[0], x[1] + f * d[1]];
                let k1 = slope(x, at(0.0));
                let k2 = slope(add(x, k / 2.0, k1), at(0.5));
                let k3 = slope(add(x, k / 2.0, k2), at(0.5));
                let k4 = slope(add(x, k, k3), at(1.0));
                for i in 0..2 {
                    x[i] += k / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
                }
            }
        }
        before = now;
        de.push(now);
        w.push(x[0] + SIGMA[0] * normal());
        q.push(x[1] + SIGMA[1] * normal());
        az.push(TRUTH[0] * x[0] + TRUTH[1] * x[1] + TRUTH[2] * now + SIGMA[2] * normal());
    }
    let (inputs, outputs) = (vec![de], vec![w, q, az]);
    Experiment {
        name: "flight".into(),
        t,
        inputs,
        outputs,
        interpolation: Interpolation::Linear,
        signals: Vec::new(),
    }
}

/// Unknown standard deviations that start at the spread of the measurements.
pub fn unknown_noise(e: &Experiment) -> Noise {
    let sigma = |z: &Vec<f64>| {
        let mean = z.iter().sum::<f64>() / z.len() as f64;
        let spread = (z.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / z.len() as f64).sqrt();
        Sigma::Unknown { start: spread, lower: 1e-9 * spread, upper: 1e6 * spread }
    };
    Noise::Gaussian(e.outputs.iter().map(sigma).collect())
}

/// The problem, and a start: parameters 0, states as measured.
pub fn problem(model: &Model, n: usize, settings: &Settings) -> (Collocation, Vec<f64>) {
    let e = record(n, 5);
    let noise = unknown_noise(&e);
    let problem = Collocation::new(model, std::slice::from_ref(&e), noise, settings).unwrap();
    let mut xi: Vec<f64> = problem.posed.parameters.iter().map(|p| p.start).collect();
    xi[..6].fill(0.0);
    for time in &problem.meshes[ExperimentId(0)].times {
        let at = (time / 0.05).clamp(0.0, (n - 1) as f64);
        let i = (at as usize).min(n - 2);
        let f = at - i as f64;
        xi.extend((0..2).map(|c| e.outputs[c][i] * (1.0 - f) + e.outputs[c][i + 1] * f));
    }
    (problem, xi)
}
