//! Densities of the noise of one output, for measurements with outliers and other departures from the Gaussian.

use std::collections::HashMap;
use std::sync::Arc;

use super::Reported;
use crate::error::{Error, did_you_mean};
use crate::expr::graph::{Graph, Id};
use crate::expr::{Expr, Op};
use crate::parameter::Parameter;

/// Degrees of freedom of Student's t.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dof {
    /// Given.
    Known(f64),
    /// A parameter to be estimated, with start and bounds, positive.
    Unknown {
        /// Starting value.
        start: f64,
        /// Lower bound.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
}

/// The density of the noise of one output; e = r/σ is the residual over the scale σ.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Density {
    /// −½e² − ln σ.
    Gaussian,
    /// Student's t, −½(ν+1) ln(1 + e²/ν) − ln σ + ...; its standard deviation is σ √(ν/(ν − 2)), for ν > 2.
    StudentT(Dof),
    /// Gaussian up to |e| = k, exponential beyond: −½e² or −k|e| + ½k² (Huber, 1964).
    Huber(f64),
    /// −√(e² + s²): for a small smoothing s that of Laplace, −|e|, whose standard deviation is √2 σ.
    Laplace(f64),
    /// The user's.
    Custom(Custom),
}

/// A log-density written by the user.
#[derive(Clone, Debug, PartialEq)]
pub struct Custom {
    /// The log-density in the symbols [`RESIDUAL`], [`SCALE`] and the parameters' names. Its normalisation is up to
    /// the user: where scale or parameters are unknown it must be normalised, but for a constant.
    pub log_density: Expr,
    /// The parameters of the density, with start and bounds: each output has its own.
    pub parameters: Vec<Parameter>,
}

/// Name of the residual z − y in a log-density of the user's.
pub const RESIDUAL: &str = "residual";
/// Name of the scale σ in a log-density of the user's.
pub const SCALE: &str = "sigma";

/// A residual below this part of the scale is near 0 where ρ'(r)/r is taken for a weight.
const NEAR: f64 = 1e-2;

impl Density {
    pub(super) fn check(&self, output: &str) -> Result<(), Error> {
        let positive = |x: f64| x > 0.0 && x.is_finite();
        let fail =
            |text: String| Err(Error::option(format!("noise of output '{output}': {text}")).about(output));
        match self {
            Density::StudentT(Dof::Known(dof)) if !positive(*dof) => {
                fail(format!("{dof} degrees of freedom; give a positive number"))
            }
            Density::StudentT(Dof::Unknown { start, lower, upper })
                if !(positive(*lower) && lower <= start && start <= upper && upper.is_finite()) =>
            {
                fail(format!(
                    "the start value {start} of the degrees of freedom does not lie within positive bounds ({lower}, {upper})"
                ))
            }
            Density::Huber(k) if !positive(*k) => fail(format!("Huber's k is {k}; give a positive number")),
            Density::Laplace(s) if !positive(*s) => {
                fail(format!("the smoothing is {s}; give a positive number"))
            }
            Density::Custom(custom) => custom.check().or_else(fail),
            _ => Ok(()),
        }
    }

    pub(super) fn n_parameters(&self) -> usize {
        match self {
            Density::StudentT(Dof::Unknown { .. }) => 1,
            Density::Custom(custom) => custom.parameters.len(),
            _ => 0,
        }
    }

    /// Parameters beside the scale. For degrees of freedom it is 1/ν: 0 is the Gaussian, and near it the
    /// likelihood is far from quadratic in ν.
    pub(super) fn parameters(&self, output: &str) -> Vec<Parameter> {
        match self {
            Density::StudentT(Dof::Unknown { start, lower, upper }) => vec![Parameter {
                lower: Some(1.0 / upper),
                upper: Some(1.0 / lower),
                ..Parameter::new(&format!("dof_{output}"), 1.0 / start)
            }],
            Density::Custom(custom) => {
                let named = |p: &Parameter| Parameter { name: format!("{}_{output}", p.name), ..p.clone() };
                custom.parameters.iter().map(named).collect()
            }
            _ => Vec::new(),
        }
    }

    pub(super) fn variable_names(&self, output: &str) -> Vec<String> {
        let inverse = matches!(self, Density::StudentT(_));
        let name = |p: Parameter| if inverse { format!("1/{}", p.name) } else { p.name };
        self.parameters(output).into_iter().map(name).collect()
    }

    /// Returns the parameters in the user's terms; they start at number `first` of those of the noise.
    pub(super) fn report(&self, output: &str, first: usize, values: &[f64]) -> Vec<Reported> {
        match self {
            Density::StudentT(Dof::Unknown { lower, upper, .. }) => {
                vec![Reported::inverse(format!("dof_{output}"), None, first, values, (*lower, *upper))]
            }
            Density::Custom(custom) => {
                let one = |(i, p): (usize, &Parameter)| {
                    let bounds = (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY));
                    Reported::plain(format!("{}_{output}", p.name), first + i, values, bounds)
                };
                custom.parameters.iter().enumerate().map(one).collect()
            }
            _ => Vec::new(),
        }
    }

    /// ρ = −ℓ_e of a residual r and the precision root w = 1/σ, and the weight ω(r) of iteratively
    /// reweighted least squares: ½ω r² is what takes the place of ρ in the Gauss-Newton Hessian. ω = ρ'(r)/r,
    /// for which the parabola lies above ρ and touches it at ±r.
    pub(super) fn loss(&self, g: &mut Graph, r: Id, w: Id, own: &[Id]) -> (Id, Id) {
        let one = g.one();
        let half = g.constant(0.5);
        let e = g.mul(w, r);
        let square = g.mul(e, e);
        let precision = g.mul(w, w);
        let log = g.unary(Op::Log, w);
        match self {
            Density::Gaussian => {
                let rho = g.mul(half, square);
                (g.sub(rho, log), precision)
            }
            Density::StudentT(dof) => {
                let inverse = match dof {
                    Dof::Known(dof) => g.constant(1.0 / dof),
                    Dof::Unknown { .. } => own[0],
                };
                let dof = g.recip(inverse);
                let more = g.add(dof, one);
                let part = g.mul(inverse, square);
                let sum = g.add(one, part);
                let power = g.mul(half, more);
                let tail = g.unary(Op::Log, sum);
                let rho = g.mul(power, tail);
                // ln Γ((ν+1)/2) − ln Γ(ν/2) − ½ ln(ν/2)
                let (low, high) = (g.mul(half, dof), g.mul(half, more));
                let (gamma_low, gamma_high) = (log_gamma(g, low), log_gamma(g, high));
                let gammas = g.sub(gamma_high, gamma_low);
                let root = g.unary(Op::Log, low);
                let root = g.mul(half, root);
                let constant = g.sub(gammas, root);
                let scale = g.add(log, constant);
                let value = g.sub(rho, scale);
                let top = g.mul(more, inverse);
                let top = g.mul(top, precision);
                (value, g.div(top, sum))
            }
            Density::Huber(k) => {
                // ∫ exp(−ρ) de = ∫_{−k}^{k} exp(−½e²) de + 2/k exp(−½k²)
                let body = integral(|e| (-0.5 * e * e).exp(), -k.min(40.0), k.min(40.0));
                let total = body + 2.0 / k * (-0.5 * k * k).exp();
                let constant = g.constant(log_ratio(total));
                let bend = g.constant(*k);
                let size = g.unary(Op::Abs, e);
                let inside = g.apply(Op::Le, &[size, bend]);
                let near = g.mul(half, square);
                let far = g.mul(bend, size);
                let offset = g.constant(0.5 * k * k);
                let far = g.sub(far, offset);
                let rho = g.select(inside, near, far);
                let steep = g.div(bend, size);
                let part = g.select(inside, one, steep);
                let scale = g.sub(log, constant);
                (g.sub(rho, scale), g.mul(precision, part))
            }
            Density::Laplace(s) => {
                // ∫ exp(s − √(e² + s²)) de, with e = s sinh t.
                let end = (1.0 + 745.0 / s).acosh();
                let total = integral(|t| (s * (1.0 - t.cosh())).exp() * s * t.cosh(), -end, end);
                let constant = g.constant(log_ratio(total));
                let smooth = g.constant(s * s);
                let sum = g.add(square, smooth);
                let root = g.unary(Op::Sqrt, sum);
                let offset = g.constant(*s);
                let rho = g.sub(root, offset);
                let scale = g.sub(log, constant);
                (g.sub(rho, scale), g.div(precision, root))
            }
            Density::Custom(custom) => custom.loss(g, r, w, own),
        }
    }
}

impl Custom {
    fn check(&self) -> Result<(), String> {
        let known: Vec<&str> =
            [RESIDUAL, SCALE].into_iter().chain(self.parameters.iter().map(|p| p.name.as_str())).collect();
        for (i, name) in known.iter().enumerate() {
            if known[..i].contains(name) {
                return Err(format!("the density has two symbols '{name}'"));
            }
        }
        let symbols = self.log_density.symbols();
        if let Some(name) = symbols.iter().find(|s| !known.contains(&&***s)) {
            let hint = did_you_mean(name, known.iter().copied());
            return Err(format!(
                "the log-density has the symbol '{name}', which is neither '{RESIDUAL}', nor '{SCALE}', nor one of \
                 its parameters.{hint}"
            ));
        }
        if !symbols.contains(RESIDUAL) {
            return Err(format!("the log-density does not depend on '{RESIDUAL}'"));
        }
        if let Some(p) = self.parameters.iter().find(|p| !symbols.contains(p.name.as_str())) {
            return Err(format!("the log-density does not depend on its parameter '{}'", p.name));
        }
        for p in &self.parameters {
            if let Some(wrong) = p.wrong() {
                return Err(format!("the parameter '{}' of the density: {wrong}", p.name));
            }
        }
        Ok(())
    }

    /// Returns the loss as [`Density::loss`]. Where ρ is no function of r² that grows ever slower, ρ'(r)/r may be
    /// negative or less than the curvature ρ''; the weight is the greater of the two and 0.
    fn loss(&self, g: &mut Graph, r: Id, w: Id, own: &[Id]) -> (Id, Id) {
        let sigma = g.recip(w);
        let mut symbols: HashMap<Arc<str>, Id> = HashMap::from([(RESIDUAL.into(), r), (SCALE.into(), sigma)]);
        symbols.extend(self.parameters.iter().zip(own).map(|(p, &id)| (p.name.as_str().into(), id)));
        let log_density = g.import(&self.log_density, &symbols);
        let value = g.neg(log_density);
        let zero = g.zero();
        let slope = g.gradient(value, &[r])[0].unwrap_or(zero);
        let curvature = g.gradient(slope, &[r])[0].unwrap_or(zero);
        let secant = g.div(slope, r);
        let e = g.mul(w, r);
        let size = g.unary(Op::Abs, e);
        let near = g.constant(NEAR);
        let is_near = g.apply(Op::Lt, &[size, near]);
        let secant = g.select(is_near, curvature, secant);
        let larger = g.apply(Op::Max, &[secant, curvature]);
        (value, g.apply(Op::Max, &[larger, zero]))
    }
}

/// ln Γ(x), x > 0: Stirling's series at x + 8, where six terms are good to 1e-14 (Abramowitz and Stegun,
/// 6.1.41), and back by Γ(x+1) = x Γ(x).
pub(super) fn log_gamma(g: &mut Graph, x: Id) -> Id {
    const SHIFT: usize = 8;
    const SERIES: [f64; 6] =
        [1.0 / 12.0, -1.0 / 360.0, 1.0 / 1260.0, -1.0 / 1680.0, 1.0 / 1188.0, -691.0 / 360_360.0];
    let (mut product, mut z) = (x, x);
    let one = g.one();
    for i in 0..SHIFT {
        z = g.add(z, one);
        if i + 1 < SHIFT {
            product = g.mul(product, z);
        }
    }
    let inverse = g.recip(z);
    let square = g.mul(inverse, inverse);
    let mut sum = g.zero();
    for c in SERIES.iter().rev() {
        let c = g.constant(*c);
        let more = g.mul(sum, square);
        sum = g.add(c, more);
    }
    let series = g.mul(sum, inverse);
    let half = g.constant(0.5);
    let power = g.sub(z, half);
    let log = g.unary(Op::Log, z);
    let main = g.mul(power, log);
    let main = g.sub(main, z);
    let constant = g.constant(0.5 * std::f64::consts::TAU.ln());
    let rest = g.add(series, constant);
    let sum = g.add(main, rest);
    let shift = g.unary(Op::Log, product);
    g.sub(sum, shift)
}

/// ln of a norm over that of the Gaussian, √2π.
fn log_ratio(norm: f64) -> f64 {
    norm.ln() - 0.5 * std::f64::consts::TAU.ln()
}

/// ∫ f over an interval, f smooth: the rule of Gauss and Legendre with 4 points on each of 512 parts.
fn integral(f: impl Fn(f64) -> f64, from: f64, to: f64) -> f64 {
    const PARTS: usize = 512;
    const RULE: [(f64, f64); 4] = [
        (-0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
        (-0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
        (0.339_981_043_584_856_26, 0.652_145_154_862_546_1),
        (0.861_136_311_594_052_6, 0.347_854_845_137_453_85),
    ];
    let h = 0.5 * (to - from) / PARTS as f64;
    let part = |i: usize| {
        let middle = from + (2 * i + 1) as f64 * h;
        RULE.iter().map(|(x, weight)| weight * f(middle + h * x)).sum::<f64>()
    };
    h * (0..PARTS).map(part).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_gamma_is_that_of_known_values() {
        let half_pi = 0.5 * std::f64::consts::PI.ln();
        // Γ(½) = √π, Γ(10) = 9!, Γ(100) = 99!
        let factorial = |n: u32| (2..=n).map(|k| f64::from(k).ln()).sum::<f64>();
        for (x, expected) in [
            (0.5, half_pi),
            (1.0, 0.0),
            (2.5, half_pi + 0.75_f64.ln()),
            (10.0, factorial(9)),
            (100.0, factorial(99)),
        ] {
            let mut g = Graph::new();
            let x = g.constant(x);
            let found = log_gamma(&mut g, x);
            assert!((g.as_constant(found).unwrap() - expected).abs() < 2e-14 * expected.abs().max(1.0));
        }
    }
}
