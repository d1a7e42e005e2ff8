//! Loops over lanes outside the tape: to be called from functions compiled for each instruction
//! set, into which they are inlined.

use super::LANE_MULTIPLE;

/// Values of an output over the lanes of a block.
#[derive(Clone, Copy, Debug)]
pub enum Values<'a> {
    /// The same value on all lanes.
    Uniform(f64),
    /// One a lane.
    Lanes(&'a [f64]),
}

impl Values<'_> {
    /// Value on a lane.
    #[inline(always)]
    pub fn at(&self, lane: usize) -> f64 {
        match self {
            Values::Uniform(u) => *u,
            Values::Lanes(v) => v[lane],
        }
    }
}

/// Whether all are finite. Without a branch a lane, so that it vectorises.
#[inline(always)]
pub(crate) fn all_finite(v: &[f64]) -> bool {
    const EXPONENT: u64 = 0x7ff << 52;
    v.iter().fold(0, |bad, x| bad | u64::from(x.to_bits() & EXPONENT == EXPONENT)) == 0
}

type Vector = [f64; LANE_MULTIPLE];

#[inline(always)]
fn plus(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|l| a[l] + b[l])
}

/// The sum in a fixed order: four vectors of partial sums, so that no addition waits for the one
/// before it, and yet the result never depends on the machine or the number of threads.
#[inline(always)]
pub(crate) fn sum(v: &[f64]) -> f64 {
    let (vectors, rest) = v.as_chunks::<LANE_MULTIPLE>();
    let (fours, single) = vectors.as_chunks::<4>();
    let mut partial = [[0.0; LANE_MULTIPLE]; 4];
    for &[a, b, c, d] in fours {
        partial = [plus(partial[0], a), plus(partial[1], b), plus(partial[2], c), plus(partial[3], d)];
    }
    for &a in single {
        partial[0] = plus(partial[0], a);
    }
    let [a, b, c, d, e, f, g, h] = plus(plus(partial[0], partial[1]), plus(partial[2], partial[3]));
    ((a + e) + (b + f)) + ((c + g) + (d + h)) + rest.iter().sum::<f64>()
}

/// W values from a place.
#[inline(always)]
pub(crate) fn load<const W: usize>(v: &[f64], at: usize) -> [f64; W] {
    *v[at..].first_chunk().expect("lanes enough")
}

/// Σ_j c_j v[lane_j + s], in registers: nothing is stored on the way.
#[inline(always)]
pub(crate) fn combination<const W: usize>(
    terms: impl Iterator<Item = (f64, usize)>,
    v: Values<'_>,
    s: usize,
) -> [f64; W] {
    let mut sum = [0.0; W];
    for (c, lane) in terms {
        let v: [f64; W] = match v {
            Values::Uniform(u) => [u; W],
            Values::Lanes(v) => load(v, lane + s),
        };
        sum = std::array::from_fn(|l| c.mul_add(v[l], sum[l]));
    }
    sum
}

/// out[s] = factor · v[lane + s]
#[inline(always)]
pub(crate) fn scaled(out: &mut [f64], factor: f64, v: Values<'_>, lane: usize) {
    match v {
        Values::Uniform(u) => out.fill(factor * u),
        Values::Lanes(v) => {
            for (o, v) in out.iter_mut().zip(&v[lane..]) {
                *o = factor * v;
            }
        }
    }
}
