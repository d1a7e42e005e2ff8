//! Independent noise: a scale and a density an output.

use super::{Density, Reported, SIGMA, Sample};
use crate::error::Error;
use crate::expr::graph::{Graph, Id};
use crate::expr::{Expr, Op};
use crate::nlp::Reach;
use crate::parameter::Parameter;
use crate::tape::{Loss, Terms};

/// Scale of the noise of one output: the standard deviation, where it is Gaussian.
#[derive(Clone, Debug, PartialEq)]
pub enum Sigma {
    /// A scale to be estimated.
    Unknown {
        /// Starting value.
        start: f64,
        /// Lower bound; 0 for none.
        lower: f64,
        /// Upper bound.
        upper: f64,
    },
    /// Given.
    Known(f64),
    /// Given by an expression in the model's states, inputs, parameters and quantities, positive at all samples.
    Expression(Expr),
}

impl Sigma {
    pub(super) fn is_unknown(&self) -> bool {
        matches!(self, Sigma::Unknown { .. })
    }

    pub(super) fn check(&self, output: &str) -> Result<(), Error> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let wrong = match *self {
            Sigma::Known(value) if !positive(value) => {
                format!("the standard deviation of '{output}' is a positive number, not {value}")
            }
            Sigma::Unknown { start, .. } if !positive(start) => {
                format!("the start of sigma_{output} is a positive number, not {start}")
            }
            Sigma::Unknown { start, lower, upper } if !(0.0 <= lower && lower <= start && start <= upper) => {
                format!("the start {start} of sigma_{output} lies outside its bounds ({lower}, {upper})")
            }
            _ => return Ok(()),
        };
        Err(Error::model(wrong))
    }

    /// The precision root as a parameter, where it is unknown.
    pub(super) fn parameter(&self, name: &str) -> Option<Parameter> {
        let Sigma::Unknown { start, lower, upper } = *self else { return None };
        Some(Parameter {
            lower: Some(1.0 / upper),
            upper: (lower > 0.0).then_some(1.0 / lower),
            ..Parameter::new(name, 1.0 / start)
        })
    }

    /// Bounds of σ.
    pub(super) fn bounds(&self) -> (f64, f64) {
        match *self {
            Sigma::Known(value) => (value, value),
            Sigma::Expression(_) => (0.0, f64::INFINITY),
            Sigma::Unknown { lower, upper, .. } => (lower, upper),
        }
    }
}

/// The noise of one output.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Its scale.
    pub sigma: Sigma,
    /// Its density.
    pub density: Density,
}

impl Channel {
    pub(super) fn check(&self, output: &str) -> Result<(), Error> {
        self.sigma.check(output)?;
        self.density.check(output)
    }
}

/// Unknown scales, then the parameters of densities.
pub(super) fn parameters(channels: &[Channel], outputs: &[&str]) -> Vec<Parameter> {
    let pairs = || channels.iter().zip(outputs);
    let scales = pairs().filter_map(|(c, name)| c.sigma.parameter(&format!("{SIGMA}{name}")));
    scales.chain(pairs().flat_map(|(c, name)| c.density.parameters(name))).collect()
}

pub(super) fn variable_names(channels: &[Channel], outputs: &[&str]) -> Vec<String> {
    let pairs = || channels.iter().zip(outputs);
    let scales = pairs().filter(|(c, _)| c.sigma.is_unknown()).map(|(_, name)| format!("1/{SIGMA}{name}"));
    scales.chain(pairs().flat_map(|(c, name)| c.density.variable_names(name))).collect()
}

pub(super) fn report(channels: &[Channel], outputs: &[&str], values: &[f64]) -> Vec<Reported> {
    let mut found = Vec::new();
    for (c, (channel, name)) in channels.iter().zip(outputs).enumerate() {
        if channel.sigma.is_unknown() {
            let name = format!("{SIGMA}{name}");
            found.push(Reported::inverse(name, Some(c), found.len(), values, channel.sigma.bounds()));
        }
    }
    for (channel, name) in channels.iter().zip(outputs) {
        let first = found.len();
        found.extend(channel.density.report(name, first, values));
    }
    found
}

/// Profiles, as [`Noise::profile`](super::Noise::profile), scales with the number of their measurements.
pub(super) fn profile<'a>(
    sigmas: impl Iterator<Item = (&'a Sigma, &'a usize)>,
    at: &[f64],
    gradient: &[f64],
    reach: &Reach<'_>,
    out: &mut [f64],
) -> f64 {
    let mut change = 0.0_f64;
    for (i, (sigma, &n)) in sigmas.filter(|s| s.0.is_unknown()).enumerate() {
        // −ℓ = Σ ρ(w r) − N ln w. Its derivative S w − N/w gives the sum S of squares, each with the weight
        // ρ'(e)/e: 1 for the Gaussian.
        let n = n as f64;
        let squares = (gradient[i] + n / at[i]) / at[i];
        let best = if squares > 0.0 { (n / squares).sqrt() } else { f64::INFINITY };
        let (lower, upper) = sigma.bounds();
        let best = best.clamp(1.0 / upper, if lower > 0.0 { 1.0 / lower } else { f64::INFINITY });
        change = change.max((best / at[i] - 1.0).abs());
        out[i] = match *reach {
            Reach::Step { up, down } => best.clamp(at[i] / up, at[i] * down),
            Reach::Free { start, most } => {
                if best < most * start[i] {
                    best
                } else {
                    start[i]
                }
            }
        };
    }
    change
}

pub(super) fn log_density(
    channels: &[Channel],
    graph: &mut Graph,
    sample: &Sample<'_>,
    parameters: &[Id],
) -> Terms {
    let mut scales = parameters.iter().copied();
    let mut own = parameters[channels.iter().filter(|c| c.sigma.is_unknown()).count()..].iter().copied();
    let mut terms = Terms { squares: Vec::new(), losses: Vec::new(), rest: graph.zero(), logs: Vec::new() };
    for (c, channel) in channels.iter().enumerate() {
        if let Sigma::Expression(_) = channel.sigma {
            let shape: Vec<Id> = own.by_ref().take(channel.density.n_parameters()).collect();
            of_expression((c, &channel.density), graph, sample, shape, &mut terms);
            continue;
        }
        let (precision, scale) = match channel.sigma {
            Sigma::Known(value) => (graph.constant(1.0 / value), None),
            Sigma::Expression(_) => unreachable!("taken above"),
            Sigma::Unknown { .. } => {
                let root = scales.next().expect("one parameter an unknown");
                (root, Some(root))
            }
        };
        if channel.density == Density::Gaussian {
            let difference = graph.sub(sample.measured[c], sample.outputs[c]);
            let residual = graph.mul(precision, difference);
            let log = graph.apply(Op::Log, &[precision]);
            let square = sample.switched(graph, c, residual);
            let log = sample.switched(graph, c, log);
            terms.squares.push(square);
            terms.rest = graph.add(terms.rest, log);
            continue;
        }
        let argument = graph.symbol(&format!("residual of output {c}"));
        let shape: Vec<Id> = own.by_ref().take(channel.density.n_parameters()).collect();
        let (value, weight) = channel.density.loss(graph, argument, precision, &shape);
        let residual = sample.residual(graph, c);
        let own = scale.into_iter().chain(shape).collect();
        terms.losses.push(Loss { residual, argument, own, value, weight, present: sample.present[c] });
    }
    terms
}

/// Adds the terms of an output whose scale is an expression of the model: the density of (z − y)/σ, less ln σ.
fn of_expression(
    (output, density): (usize, &Density),
    graph: &mut Graph,
    sample: &Sample<'_>,
    own: Vec<Id>,
    terms: &mut Terms,
) {
    let sigma = sample.scales[output].expect("written with the model");
    let difference = graph.sub(sample.measured[output], sample.outputs[output]);
    let standardised = graph.div(difference, sigma);
    let residual = sample.switched(graph, output, standardised);
    let log = graph.unary(Op::Log, sigma);
    let log = sample.switched(graph, output, log);
    terms.logs.push(log);
    if *density == Density::Gaussian {
        terms.squares.push(residual);
        return;
    }
    let argument = graph.symbol(&format!("residual of output {output}"));
    let one = graph.one();
    let (value, weight) = density.loss(graph, argument, one, &own);
    terms.losses.push(Loss { residual, argument, own, value, weight, present: sample.present[output] });
}
