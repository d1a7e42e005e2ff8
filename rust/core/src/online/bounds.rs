//! Parameters within their bounds: least squares with an active set, in the triangle of the parameters.

use super::triangle::Triangle;

/// Bounds of the estimated parameters, and memory.
#[derive(Clone, Debug)]
pub(super) struct Bounds {
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// The bound that each parameter lies at, as a step.
    active: Vec<Option<f64>>,
    rows: Vec<f64>,
    reduced: Triangle,
}

impl Bounds {
    pub(super) fn new(lower: Vec<f64>, upper: Vec<f64>) -> Bounds {
        let p = lower.len();
        Bounds {
            lower,
            upper,
            active: vec![None; p],
            rows: vec![0.0; p * (p + 1)],
            reduced: Triangle::new(p),
        }
    }

    fn any(&self) -> bool {
        self.lower.iter().any(|b| b.is_finite()) || self.upper.iter().any(|b| b.is_finite())
    }

    pub(super) fn flops(&self) -> u64 {
        self.reduced.flops
    }

    /// Rounds of the active set, at most: each of them adds a parameter or releases one.
    fn rounds(&self) -> usize {
        2 * self.lower.len()
    }

    /// Operations of a solution, at most.
    pub(super) fn bound(&self) -> u64 {
        let p = self.lower.len();
        if !self.any() {
            return 0;
        }
        let absorb: usize = (0..p).map(|j| 4 * (p + 1 - j) * (1 + p)).sum();
        (self.rounds() * (absorb + 3 * p * p)) as u64
    }

    /// Puts values back between their bounds, which rounding may leave.
    pub(super) fn project(&self, theta: &mut [f64]) {
        for (v, (low, high)) in theta.iter_mut().zip(self.lower.iter().zip(&self.upper)) {
            *v = v.max(*low).min(*high);
        }
    }

    /// Whether a parameter lies at a bound.
    pub(super) fn at(&self, i: usize, value: f64) -> bool {
        value <= self.lower[i] || value >= self.upper[i]
    }

    /// The step of the parameters, the last unknowns of `info`, into the end of `delta`: the least-squares solution within the
    /// bounds. One that ends before a solution is found, after as many rounds as there can be useful ones, lies within them, too.
    pub(super) fn solve(&mut self, info: &mut Triangle, theta: &[f64], delta: &mut [f64]) {
        let (p, m) = (theta.len(), info.m);
        let n = m - p;
        info.solve(n, m, delta);
        if !self.any() {
            return;
        }
        self.active.fill(None);
        let step = &mut delta[n..];
        for _ in 0..self.rounds() {
            if !self.add(theta, step) && !self.release(info, step, theta) {
                return;
            }
            self.resolve(info, step);
        }
        for (i, step) in step.iter_mut().enumerate() {
            *step = step.max(self.lower[i] - theta[i]).min(self.upper[i] - theta[i]);
        }
    }

    /// Takes the parameter that is farthest beyond its bound to it; whether there is one.
    fn add(&mut self, theta: &[f64], step: &[f64]) -> bool {
        let beyond = |i: usize| {
            let value = theta[i] + step[i];
            (self.lower[i] - value).max(value - self.upper[i]) / (1.0 + theta[i].abs())
        };
        let inactive = (0..step.len()).filter(|i| self.active[*i].is_none());
        let worst = inactive.max_by(|a, b| beyond(*a).total_cmp(&beyond(*b)));
        let Some(i) = worst.filter(|i| beyond(*i) > 0.0) else { return false };
        let bound = if theta[i] + step[i] < self.lower[i] { self.lower[i] } else { self.upper[i] };
        self.active[i] = Some(bound - theta[i]);
        true
    }

    /// Releases a parameter from a bound from which the cost decreases; whether there is one.
    fn release(&mut self, info: &Triangle, step: &[f64], theta: &[f64]) -> bool {
        let (p, w) = (step.len(), info.width());
        let n = info.m - p;
        for i in (0..p).filter(|i| self.active[*i].is_some()) {
            let mut slope = 0.0;
            for r in 0..=i {
                let row = &info.r[(n + r) * w + n..(n + r + 1) * w];
                let residual: f64 = (r..p).map(|j| row[j] * step[j]).sum::<f64>() - row[p];
                slope += row[i] * residual;
            }
            let at_lower = theta[i] + step[i] <= self.lower[i];
            if (at_lower && slope < 0.0) || (!at_lower && slope > 0.0) {
                self.active[i] = None;
                return true;
            }
        }
        false
    }

    /// The step with the active parameters at their bounds.
    fn resolve(&mut self, info: &Triangle, step: &mut [f64]) {
        let (p, w) = (step.len(), info.width());
        let n = info.m - p;
        for (r, row) in self.rows.chunks_exact_mut(p + 1).enumerate() {
            row.copy_from_slice(&info.r[(n + r) * w + n..(n + r + 1) * w]);
            for (i, active) in self.active.iter().enumerate() {
                if let Some(known) = active {
                    row[p] -= row[i] * known;
                    row[i] = 0.0;
                }
            }
        }
        self.reduced.r.fill(0.0);
        self.reduced.absorb(&mut self.rows);
        self.reduced.solve(0, p, step);
        for (step, active) in step.iter_mut().zip(&self.active) {
            *step = active.unwrap_or(*step);
        }
    }
}
