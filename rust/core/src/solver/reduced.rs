//! The program with its states eliminated: gradient and Hessian in parameters and free initial states, and a trust region.

use nalgebra::{DMatrix, DVector, SymmetricEigen};

use super::iterate::Iterate;
use super::program::Program;
use super::restoration::Restoration;
use crate::index::VariableId;
use crate::linalg::Entries;
use crate::nlp::Structure;
use crate::simd::kernel;

/// Most free variables.
const MOST: usize = 300;
/// Bisections for the radius of a step.
const HALVINGS: usize = 60;

/// Gradient and Hessian along paths that satisfy the equations.
pub(super) struct Reduced {
    /// The free variables.
    pub free: Vec<usize>,
    /// Sizes of steps of theirs that are alike.
    sizes: Vec<f64>,
    /// Derivatives of all variables by the free ones, row-major.
    z: Vec<f64>,
    product: Vec<f64>,
    pub gradient: Vec<f64>,
    hessian: Vec<f64>,
    held: Vec<bool>,
}

/// A step of the free variables, what the quadratic model promises of it, and its length in units of sizes.
pub(super) struct Trial {
    pub d: Vec<f64>,
    pub promise: f64,
    pub length: f64,
}

impl Reduced {
    /// For the free variables of a program at a point; `None` where there are none, or too many.
    pub fn new(program: &Program<'_>, restoration: &Restoration, xi: &[f64]) -> Option<Reduced> {
        let nlp = program.nlp;
        let mut is_free = vec![true; nlp.n()];
        restoration.determined().for_each(|i| is_free[i] = false);
        nlp.profiled().for_each(|i| is_free[i] = false);
        let free: Vec<usize> =
            (0..nlp.n()).filter(|&i| is_free[i] && program.lower[i] < program.upper[i]).collect();
        let border = program.border();
        let units = &program.units.states;
        let size = |&i: &usize| {
            let (range, unit) =
                (program.upper[i] - program.lower[i], units[i.saturating_sub(border) % units.len()]);
            match nlp.longest_step(VariableId(i)) {
                most if most.is_finite() => most,
                _ if i >= border => unit.max(0.3 * xi[i].abs()),
                _ if xi[i] != 0.0 => xi[i].abs(),
                _ if range.is_finite() => 0.1 * range,
                _ => 1.0,
            }
        };
        let (p, n) = (free.len(), nlp.n());
        (1..=MOST).contains(&p).then(|| Reduced {
            sizes: free.iter().map(size).collect(),
            z: vec![0.0; n * p],
            product: vec![0.0; n * p],
            gradient: vec![0.0; p],
            hessian: vec![0.0; p * p],
            held: vec![false; p],
            free,
        })
    }

    /// Evaluates both at an iterate that satisfies the equations; whether they are defined.
    pub fn evaluate(
        &mut self,
        program: &Program<'_>,
        restoration: &mut Restoration,
        iterate: &mut Iterate,
        exact: bool,
    ) -> bool {
        if iterate.evaluate(program).is_err() {
            return false;
        }
        let Iterate { jacobian, gradient, multipliers, .. } = iterate;
        if !restoration.factorise(jacobian) || !restoration.multipliers(gradient, multipliers) {
            return false;
        }
        let finite =
            (exact && iterate.exact_hessian(program).is_ok()) || iterate.gauss_newton(program).is_ok();
        let p = self.free.len();
        self.z.fill(0.0);
        for (k, &i) in self.free.iter().enumerate() {
            self.z[i * p + k] = 1.0;
        }
        if !finite || !restoration.sensitivities(&mut self.z, p) {
            return false;
        }
        self.gradient.fill(0.0);
        for (g, z) in iterate.gradient.iter().zip(self.z.chunks_exact(p)) {
            self.gradient.iter_mut().zip(z).for_each(|(sum, z)| *sum += g * z);
        }
        self.project(program, iterate.entries());
        self.gradient.iter().chain(&self.hessian).all(|v| v.is_finite())
    }

    /// Moves all variables by what a step of the free ones does to them.
    pub fn move_along(&self, d: &[f64], xi: &mut [f64]) {
        for (x, z) in xi.iter_mut().zip(self.z.chunks_exact(d.len())) {
            *x += z.iter().zip(d).map(|(z, d)| z * d).sum::<f64>();
        }
    }

    /// ZᵀHZ.
    fn project(&mut self, program: &Program<'_>, entries: Entries<'_>) {
        let s = program.nlp.hessian_structure();
        multiply(self.free.len(), s, entries.hessian, &self.z, &mut self.product);
        multiply_transposed(self.free.len(), &self.z, &self.product, &mut self.hessian);
    }

    /// The step that minimises the quadratic model within bounds and a radius (Moré and Sorensen, 1983). Variables that the
    /// step would lead out of their bounds go as far as these, one after the other, and the rest is minimised anew.
    pub fn step(&mut self, program: &Program<'_>, xi: &[f64], radius: f64) -> Trial {
        let p = self.free.len();
        let room: Vec<(f64, f64)> = self
            .free
            .iter()
            .map(|&i| ((program.lower[i] - xi[i]).min(0.0), (program.upper[i] - xi[i]).max(0.0)))
            .collect();
        let (mut d, mut first) = (vec![0.0; p], None);
        self.held.fill(false);
        for _ in 0..=p {
            let own: Vec<usize> = (0..p).filter(|&k| !self.held[k]).collect();
            own.iter().for_each(|&k| d[k] = 0.0);
            let found = self.within(&own, &d, radius);
            own.iter().zip(found.iter()).for_each(|(&k, x)| d[k] = x * self.sizes[k]);
            // What stands at a bound and is pushed out of it is held first.
            let out = |k: &usize| d[*k] < room[*k].0 || d[*k] > room[*k].1;
            let leaving: Vec<usize> = own.into_iter().filter(out).collect();
            let stands = |k: &usize| if d[*k] < 0.0 { room[*k].0 == 0.0 } else { room[*k].1 == 0.0 };
            let standing: Vec<usize> = leaving.iter().copied().filter(stands).collect();
            if standing.is_empty() && first.is_none() {
                first = Some(d.clone());
            }
            let to_hold = if standing.is_empty() { leaving } else { standing };
            if to_hold.is_empty() {
                break;
            }
            for k in to_hold {
                d[k] = d[k].clamp(room[k].0, room[k].1);
                self.held[k] = true;
            }
        }
        let mut trial = self.trial(d);
        if let Some(first) = first {
            // As far as the first bound, which is always downhill.
            let part = |k: usize| match first[k] {
                d if d < room[k].0 => room[k].0 / d,
                d if d > room[k].1 => room[k].1 / d,
                _ => 1.0,
            };
            let part = (0..p).map(part).fold(1.0, f64::min);
            let shorter = self.trial(first.iter().map(|d| part * d).collect());
            if shorter.promise > trial.promise {
                trial = shorter;
            }
        }
        trial
    }

    /// What a step promises.
    fn trial(&self, d: Vec<f64>) -> Trial {
        let p = d.len();
        let row = |a: usize| self.hessian[a * p..][..p].iter().zip(&d).map(|(h, d)| h * d).sum::<f64>();
        let promise = -(0..p).map(|a| d[a] * (self.gradient[a] + 0.5 * row(a))).sum::<f64>();
        let length = d.iter().zip(&self.sizes).map(|(d, s)| (d / s).powi(2)).sum::<f64>().sqrt();
        Trial { d, promise, length }
    }

    /// The same for some of the variables, in units of their sizes, without bounds, given the steps `d` of the others.
    fn within(&self, own: &[usize], d: &[f64], radius: f64) -> DVector<f64> {
        let (p, n) = (self.free.len(), own.len());
        if n == 0 {
            return DVector::zeros(0);
        }
        let entry =
            |a: usize, b: usize| self.hessian[own[a] * p + own[b]] * self.sizes[own[a]] * self.sizes[own[b]];
        let eigen = SymmetricEigen::new(DMatrix::from_fn(n, n, |a, b| 0.5 * (entry(a, b) + entry(b, a))));
        let pulled = |a: usize| self.hessian[a * p..][..p].iter().zip(d).map(|(h, d)| h * d).sum::<f64>();
        let gradient =
            DVector::from_fn(n, |a, _| (self.gradient[own[a]] + pulled(own[a])) * self.sizes[own[a]]);
        let along = eigen.eigenvectors.tr_mul(&gradient);
        let least = eigen.eigenvalues.min();
        let most = eigen.eigenvalues.amax();
        let at = |shift: f64| along.zip_map(&eigen.eigenvalues, |g, l| -g / (l + shift));
        let floor = 1e-14 * most + f64::MIN_POSITIVE;
        let low = (-least).max(0.0) + floor;
        let mut found = at(low);
        if found.norm() > radius {
            let (mut below, mut above) = (low, low.max(most).max(along.norm() / radius));
            while at(above).norm() > radius {
                above *= 4.0;
            }
            for _ in 0..HALVINGS {
                let middle = (below * above).sqrt();
                if at(middle).norm() > radius { below = middle } else { above = middle }
            }
            found = at(above);
        }
        &eigen.eigenvectors * found
    }
}

kernel! {
    /// Sets `product` to HZ, both Z and HZ of p columns, from the structure and the values of one triangle of H.
    fn multiply(p: usize, s: &Structure, h: &[f64], z: &[f64], product: &mut [f64]) {
        product.fill(0.0);
        for ((&r, &c), h) in s.rows.iter().zip(&s.columns).zip(h) {
            let (r, c) = (r as usize, c as usize);
            if *h == 0.0 {
                continue;
            }
            let (to, from) = (&mut product[r * p..][..p], &z[c * p..][..p]);
            to.iter_mut().zip(from).for_each(|(to, z)| *to += h * z);
            if r != c {
                let (to, from) = (&mut product[c * p..][..p], &z[r * p..][..p]);
                to.iter_mut().zip(from).for_each(|(to, z)| *to += h * z);
            }
        }
    }
}

kernel! {
    /// Sets `hessian` to ZᵀV, both of p columns. Rows of V without entries, as those of states that nothing measures, are left out.
    fn multiply_transposed(p: usize, z: &[f64], v: &[f64], hessian: &mut [f64]) {
        hessian.fill(0.0);
        for (z, v) in z.chunks_exact(p).zip(v.chunks_exact(p)).filter(|(_, v)| v.iter().any(|v| *v != 0.0)) {
            for (a, z) in z.iter().enumerate().filter(|z| *z.1 != 0.0) {
                hessian[a * p..][..p].iter_mut().zip(v).for_each(|(h, v)| *h += z * v);
            }
        }
    }
}
