//! What follows a signal and remembers its past: play, a limited rate, a hysteresis, a lag. Each starts at rest.

/// Returns what follows `u` with play of the half width `size`: it stays until it is pushed (Tao and Kokotovic 1996,
/// section 2.2).
pub fn play(u: &[f64], size: f64) -> Vec<f64> {
    let mut now = u.first().copied().unwrap_or(0.0);
    u.iter()
        .map(|u| {
            now = now.max(u - size).min(u + size);
            now
        })
        .collect()
}

/// Returns what follows `u` no faster than `rate`.
pub fn rate_limited(t: &[f64], u: &[f64], rate: f64) -> Vec<f64> {
    let (mut now, mut last) = (u.first().copied().unwrap_or(0.0), t.first().copied().unwrap_or(0.0));
    t.iter()
        .zip(u)
        .map(|(t, u)| {
            let most = rate * (t - last);
            now += (u - now).max(-most).min(most);
            last = *t;
            now
        })
        .collect()
}

/// Returns z of d z' = x' - (|x'| z + s x' |z|) / 2 with the displacement d = `size` and s = `turn`, z = 0 at first
/// (Bouc 1967, Wen 1976, with exponent 1); exact for a motion that turns at no other than its points.
pub fn bouc_wen(x: &[f64], size: f64, turn: f64) -> Vec<f64> {
    let (onward, back) = (0.5 * (1.0 + turn), 0.5 * (1.0 - turn));
    let (mut now, mut last) = (0.0_f64, x.first().copied().unwrap_or(0.0));
    x.iter()
        .map(|x| {
            let step = (x - last) / size;
            last = *x;
            let (side, mut left) = (if step > 0.0 { 1.0 } else { -1.0 }, step.abs());
            if now * side < 0.0 {
                // It unloads: |z| decreases at the rate 1 + back |z|.
                let loaded = -now * side;
                let whole = if back != 0.0 { (back * loaded).ln_1p() / back } else { loaded };
                let part = left.min(whole);
                let rest = if back != 0.0 {
                    ((1.0 + back * loaded) * (-back * part).exp() - 1.0) / back
                } else {
                    whole - part
                };
                now = -side * rest.max(0.0);
                left -= part;
            }
            if left > 0.0 {
                // |z| increases at the rate 1 - onward |z|.
                let growth = if onward != 0.0 { -(-onward * left).exp_m1() / onward } else { left };
                now = side * (now.abs() * (-onward * left).exp() + growth);
            }
            now
        })
        .collect()
}

/// Returns the solution z of tau z' + z = u, z = u at first; exact for `u` linear between the times, which increase:
/// within an interval z - u + tau u' decays as exp(-t / tau).
pub fn lagged(t: &[f64], u: &[f64], tau: f64) -> Vec<f64> {
    let mut z = Vec::with_capacity(u.len());
    z.extend(u.first());
    for (t, u) in t.windows(2).zip(u.windows(2)) {
        let x = (t[1] - t[0]) / tau;
        let (decay, share) = ((-x).exp(), -(-x).exp_m1() / x);
        z.push(u[1] + (z[z.len() - 1] - u[0]) * decay - (u[1] - u[0]) * share);
    }
    z
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: &[f64], expected: &[f64]) -> bool {
        found.len() == expected.len() && found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12)
    }

    #[test]
    fn play_and_rates_are_kept() {
        assert!(near(&play(&[0.0, 0.5, 2.0, 1.5, -1.0], 1.0), &[0.0, 0.0, 1.0, 1.0, 0.0]));
        assert!(near(
            &rate_limited(&[0.0, 1.0, 3.0, 4.0], &[0.0, 2.0, 2.0, -3.0], 0.5),
            &[0.0, 0.5, 1.5, 1.0]
        ));
        assert!(play(&[], 1.0).is_empty() && rate_limited(&[], &[], 1.0).is_empty());
    }

    #[test]
    fn a_lag_follows_a_ramp_at_its_time_constant() {
        let t = [0.0, 0.3, 0.5, 1.1];
        let expected: Vec<f64> = t.iter().map(|t| t - 0.4 * (1.0 - f64::exp(-t / 0.4))).collect();
        assert!(near(&lagged(&t, &t, 0.4), &expected));
    }

    #[test]
    fn a_hysteresis_yields_and_returns_as_its_equation_says() {
        for turn in [1.0, 0.0, -1.2] {
            let x = |t: f64| t.sin() + 0.2 * (3.0 * t).sin();
            let n = 400_000;
            let at = |k: usize| x(7.0 * k as f64 / n as f64);
            let all: Vec<f64> = (0..=n).map(at).collect();
            let mut z = 0.0_f64;
            for k in 0..n {
                let dx = all[k + 1] - all[k];
                z += (dx - 0.5 * (dx.abs() * z + turn * dx * z.abs())) / 0.3;
            }
            let found = bouc_wen(&all, 0.3, turn);
            assert!((found[n] - z).abs() < 1e-3, "{turn}: {} and {z}", found[n]);
        }
    }
}
