//! Time for a sample of the estimator on board, in the median and at worst, for models of 2, 4 and 12 states.
//!
//!     cargo run --release --example online_timing [samples]

use std::error::Error;
use std::time::Instant;

use phugoid::online::{Online, Settings};
use phugoid::{Model, Parameter};

/// Oscillators that are driven one by the other: two states, two parameters each.
fn chain(states: usize) -> Result<Model, phugoid::Error> {
    let mut m = Model::new("chain of oscillators");
    let mut force = m.input("u", "")?;
    for k in 0..states / 2 {
        let (x, v) = (m.state(&format!("x{k}"), "")?, m.state(&format!("v{k}"), "")?);
        let stiffness = m.parameter(Parameter::new(&format!("k{k}"), 4.0 + k as f64))?;
        let damping = m.parameter(Parameter::new(&format!("c{k}"), 0.8))?;
        m.equation(&format!("x{k}"), v.clone())?;
        m.equation(&format!("v{k}"), force - stiffness * &x - damping * &v)?;
        m.output(&format!("y{k}"), x.clone(), "")?;
        force = x;
    }
    Ok(m)
}

fn main() -> Result<(), Box<dyn Error>> {
    let samples: usize = std::env::args().nth(1).map_or(Ok(100_000), |n| n.parse())?;
    println!(
        "{:>7} {:>11} {:>7} {:>12} {:>11} {:>11} {:>11}",
        "states", "parameters", "window", "operations", "median, µs", "99.9 %, µs", "worst, µs"
    );
    for states in [2, 4, 12] {
        let model = chain(states)?;
        for window in [1, 20] {
            let mut settings = Settings::default().window(window).iterations(1);
            for output in &model.outputs {
                settings = settings.sigma(&output.name, 0.01);
            }
            for parameter in &model.parameters {
                settings = settings.parameter(&parameter.name, 0.5);
            }
            let mut online = Online::new(&model, settings)?;
            // The response of the last oscillators is small beside the noise, which does not matter to the time.
            let (mut x, mut v, mut noise) = (0.0, 0.0, 1_u64);
            let mut outputs = vec![0.0; states / 2];
            let mut times = Vec::with_capacity(samples);
            for k in 0..samples {
                let t = 0.02 * k as f64;
                let u = (1.7 * t).sin() + (0.6 * t).cos();
                for (c, y) in outputs.iter_mut().enumerate() {
                    noise = noise.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    let uniform = (noise >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
                    *y = 0.03 * uniform + if c == 0 { x } else { 0.0 };
                }
                let began = Instant::now();
                online.push(t, &[u], &outputs)?;
                times.push(began.elapsed().as_secs_f64() * 1e6);
                v += 0.02 * (u - 4.0 * x - 0.8 * v);
                x += 0.02 * v;
            }
            times.sort_by(f64::total_cmp);
            let (median, rare, worst) =
                (times[samples / 2], times[samples - 1 - samples / 1000], times[samples - 1]);
            println!(
                "{states:>7} {:>11} {window:>7} {:>12} {median:>11.1} {rare:>11.1} {worst:>11.1}",
                model.parameters.len(),
                online.work()
            );
        }
    }
    Ok(())
}
