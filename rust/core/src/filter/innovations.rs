//! One-step predictions of every sample by a Kalman filter, from the samples before it.
//!
//! The filter is linearised about the most probable path (for a linear system it is the Kalman filter), and starts at
//! the initial state as estimated; one with a prior starts at the prior. Its innovations are white where the model is
//! right, which the residuals of a smoothed path are not.

use super::path::{At, Found, Lost};
use crate::dense::{cholesky, dot, product, product_transposed, rounding, solve, symmetrise};
use crate::interrupt::current;

/// Innovations, the states predicted with them, and the standard deviations of both.
#[derive(Clone, Debug, Default)]
pub struct Innovations {
    /// z_k minus its prediction: n_y columns of N, NaN where a sample is missing.
    pub values: Vec<Vec<f64>>,
    /// Standard deviations, n_y columns of N.
    pub deviations: Vec<Vec<f64>>,
    /// States predicted from the samples before, n columns of N.
    pub states: Vec<Vec<f64>>,
    /// Their standard deviations, n columns of N.
    pub state_deviations: Vec<Vec<f64>>,
}

pub(super) fn innovations(at: &At<'_>, found: &Found) -> Result<Innovations, Lost> {
    let (n, samples) = (at.initial.len(), at.run.samples());
    let slopes = at.samples.residual_slopes(at.theta, &at.run.data, &found.path.x, 0);
    let residuals = at.samples.residuals(at.theta, &at.run.data, &found.path.x);
    let n_y = residuals.len() / (2 * samples);
    let nn = n * n;
    // Deviation of the filter's state from the path, and its covariance.
    let (mut dx, mut p) = (vec![0.0; n], vec![0.0; nn]);
    for (i, prior) in at.initial.iter().enumerate() {
        if let Some((mean, std)) = prior.filter(|p| p.1.is_finite()) {
            dx[i] = mean - found.path.x[i];
            p[i * n + i] = std * std;
        }
    }
    let (of_outputs, of_states) =
        (vec![Vec::with_capacity(samples); n_y], vec![Vec::with_capacity(samples); n]);
    let mut out = Innovations {
        values: of_outputs.clone(),
        deviations: of_outputs,
        states: of_states.clone(),
        state_deviations: of_states,
    };
    let mut turns = current().turns((found.chain.width() + n_y).pow(3));
    for k in 0..samples {
        if turns.stop() {
            return Err(Lost::Stopped);
        }
        for i in 0..n {
            out.states[i].push(found.path.x[k * n + i] + dx[i]);
            out.state_deviations[i].push(p[i * n + i].max(0.0).sqrt());
        }
        // In units of σ: the residual r = (z − g)/σ has slope C = ∂r/∂x and unit noise; it is 0 where missing.
        let c = &slopes[k * n_y * n..(k + 1) * n_y * n];
        let (r, root) = residuals[2 * k * n_y..2 * (k + 1) * n_y].split_at(n_y);
        let mut pc = vec![0.0; n * n_y];
        product_transposed(&mut pc, &p, c, [n, n, n_y]);
        let mut s = vec![0.0; n_y * n_y];
        product(&mut s, c, &pc, [n_y, n, n_y]);
        let mut innovation: Vec<f64> = (0..n_y).map(|i| r[i] + dot(&c[i * n..(i + 1) * n], &dx)).collect();
        for i in 0..n_y {
            s[i * n_y + i] += 1.0;
            let there = root[i] > 0.0;
            out.values[i].push(if there { innovation[i] / root[i] } else { f64::NAN });
            out.deviations[i].push(if there { s[i * n_y + i].sqrt() / root[i] } else { f64::NAN });
        }
        if k + 1 == samples || cholesky(&mut s, n_y, rounding).is_err() {
            continue;
        }
        // Correction: K = −P Cᵀ S⁻¹ for r falls as x grows.
        let mut gain: Vec<f64> = (0..n_y * n).map(|i| pc[(i % n) * n_y + i / n]).collect();
        solve(&s, &mut gain, n_y, n);
        innovation.iter_mut().for_each(|v| *v = -*v);
        for i in 0..n {
            for j in 0..n_y {
                dx[i] += gain[j * n + i] * innovation[j];
                for l in 0..n {
                    p[i * n + l] -= pc[i * n_y + j] * gain[j * n + l];
                }
            }
        }
        // Prediction: the path's own noise G ε is part of the path, not of the prediction.
        let (m, width) = (found.chain.m, found.chain.width());
        let e = &found.path.e[k * m..(k + 1) * m];
        let z: Vec<f64> = dx.iter().copied().chain(e.iter().map(|e| -e)).collect();
        let b = &found.chain.b[k * n * width..(k + 1) * n * width];
        let next = (0..n).map(|i| dot(&b[i * width..(i + 1) * width], &z)).collect();
        let mut spread = vec![0.0; width * width];
        for i in 0..n {
            spread[i * width..i * width + n].copy_from_slice(&p[i * n..(i + 1) * n]);
        }
        (n..width).for_each(|i| spread[i * width + i] = 1.0);
        let mut bp = vec![0.0; n * width];
        product(&mut bp, b, &spread, [n, width, width]);
        product_transposed(&mut p, &bp, b, [n, width, n]);
        symmetrise(&mut p, n);
        dx = next;
    }
    Ok(out)
}
