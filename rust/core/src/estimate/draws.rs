//! Random draws of parameters, from which restarts begin.

use std::f64::consts::PI;

use fastrand::Rng;

use super::motion::Values;
use crate::model::Parameter;
use crate::transform::Transform;

/// The part of the parameters that is drawn anew, and of those of which the data say nothing.
const SHARE: f64 = 0.3;
const MOST_OF_THEM: f64 = 0.8;
/// In decades: how far parameters without bounds go, and how far all move.
const DECADES: f64 = 3.0;
const MOVE: f64 = 0.5;

/// Random numbers that are the same for the same start, and others for another.
fn seeded(values: &Values) -> Rng {
    let mut ordered: Vec<&(String, f64)> = values.iter().collect();
    ordered.sort_by(|a, b| a.0.cmp(&b.0));
    let bytes = ordered.iter().flat_map(|(name, v)| name.bytes().chain(v.to_bits().to_le_bytes()));
    // Fowler, Noll and Vo's hash.
    let seed = bytes.fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    Rng::with_seed(seed)
}

/// Draws of other parameters.
pub(super) struct Draws<'a> {
    parameters: &'a [Parameter],
    /// Numbers of those that are drawn.
    free: Vec<usize>,
    random: Rng,
}

impl<'a> Draws<'a> {
    /// For parameters whose search begins at these values.
    pub fn new(parameters: &'a [Parameter], start: &Values) -> Self {
        let free = (0..parameters.len()).filter(|&i| !parameters[i].fixed && !parameters[i].local).collect();
        Draws { parameters, free, random: seeded(start) }
    }

    /// Draws all parameters anew.
    pub fn all(&mut self, at: &Values) -> Values {
        let shares = vec![1.0; self.free.len()];
        self.redrawn(at, &shares)
    }

    /// Multiplies all parameters by factors of up to ten; those that are 0 are drawn anew, and those that would leave their
    /// bounds stay.
    pub fn multiplied(&mut self, at: &Values) -> Values {
        let mut found = at.clone();
        for &i in &self.free {
            let (x, value, p) = (2.0 * self.random.f64() - 1.0, at[i].1, &self.parameters[i]);
            let other = if value == 0.0 { 3.0 * x } else { value * 10f64.powf(x) };
            if p.lower.is_none_or(|low| low < other) && p.upper.is_none_or(|high| other < high) {
                found[i].1 = other;
            }
        }
        found
    }

    /// Returns whether the draw of this number moves all parameters.
    pub fn moves(number: usize) -> bool {
        number % 3 == 2
    }

    /// Draws other parameters, in one of three ways in turn: some of them anew; most of the undetermined ones anew, which
    /// where they are have no influence, and few others; all of them moved.
    pub fn others(&mut self, number: usize, at: &Values, undetermined: &dyn Fn(&str) -> bool) -> Values {
        if Self::moves(number) {
            return self.moved(at);
        }
        let any = self.free.iter().any(|&i| undetermined(&self.parameters[i].name));
        let (others, of_those) =
            if number.is_multiple_of(3) || !any { (SHARE, SHARE) } else { (0.5 * SHARE, MOST_OF_THEM) };
        let share = |i: &usize| if undetermined(&self.parameters[*i].name) { of_those } else { others };
        let shares: Vec<f64> = self.free.iter().map(share).collect();
        self.redrawn(at, &shares)
    }

    /// Draws parameters anew within their bounds, each with its probability; one at least.
    fn redrawn(&mut self, at: &Values, shares: &[f64]) -> Values {
        let mut found = at.clone();
        let one = self.random.usize(..self.free.len());
        for (k, share) in shares.iter().enumerate() {
            let (chosen, x) = (self.random.f64() < *share, self.random.f64());
            if chosen || k == one {
                let i = self.free[k];
                let scale = Scale::of(&self.parameters[i], at[i].1);
                found[i].1 = scale.value(scale.range.0 + (scale.range.1 - scale.range.0) * x);
            }
        }
        found
    }

    /// Moves all parameters, most of them a little and some of them far: by a Cauchy distribution.
    fn moved(&mut self, at: &Values) -> Values {
        let mut found = at.clone();
        for &i in &self.free {
            let scale = Scale::of(&self.parameters[i], at[i].1);
            let cauchy = (PI * (self.random.f64() - 0.5)).tan();
            found[i].1 = scale.value(scale.at + scale.unit * cauchy);
        }
        found
    }
}

/// The scale on which a parameter is drawn, logarithmic where that is declared: value, range, and the unit of its moves.
struct Scale {
    logarithmic: bool,
    at: f64,
    range: (f64, f64),
    unit: f64,
}

impl Scale {
    fn of(parameter: &Parameter, value: f64) -> Scale {
        let (low, high) = (parameter.lower, parameter.upper);
        if parameter.transform == Transform::Log && value > 0.0 {
            let at = value.log10();
            let low = low.filter(|low| *low > 0.0).map_or(at - DECADES, f64::log10);
            let high = high.map_or(at + DECADES, f64::log10);
            return Scale { logarithmic: true, at, range: (low, high), unit: MOVE };
        }
        let size = if value == 0.0 { 1.0 } else { value.abs() };
        let unit = if let (Some(low), Some(high)) = (low, high) { 0.1 * (high - low) } else { size };
        let range = (low.unwrap_or(value - 3.0 * size), high.unwrap_or(value + 3.0 * size));
        Scale { logarithmic: false, at: value, range, unit }
    }

    /// Returns the value of the parameter at x, which is reflected into the range.
    fn value(&self, x: f64) -> f64 {
        let (low, high) = self.range;
        let span = high - low;
        let x = if low < high {
            let x = (x - low).rem_euclid(2.0 * span);
            low + x.min(2.0 * span - x)
        } else {
            self.at
        };
        if self.logarithmic { 10f64.powf(x) } else { x }
    }
}
