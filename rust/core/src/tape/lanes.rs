//! Loops over lanes outside the tape: to be called from functions compiled for each instruction
//! set, into which they are inlined.

use super::LANE_MULTIPLE;
use super::eval::Values;

/// Whether all are finite. Without a branch a lane, so that it vectorises.
#[inline(always)]
pub(crate) fn all_finite(v: &[f64]) -> bool {
    const EXPONENT: u64 = 0x7ff << 52;
    v.iter().fold(0, |bad, x| bad | u64::from(x.to_bits() & EXPONENT == EXPONENT)) == 0
}

/// The sum in a fixed order: 32 partial sums, so that it vectorises without waiting for one
/// addition after the other, and yet never depends on the machine or the number of threads.
#[inline(always)]
pub(crate) fn sum(v: &[f64]) -> f64 {
    let (chunks, rest) = v.as_chunks::<32>();
    let mut partial = [0.0; 32];
    for chunk in chunks {
        for l in 0..32 {
            partial[l] += chunk[l];
        }
    }
    let mut eight: [f64; 8] =
        std::array::from_fn(|l| (partial[l] + partial[l + 8]) + (partial[l + 16] + partial[l + 24]));
    let (chunks, rest) = rest.as_chunks::<8>();
    for chunk in chunks {
        for l in 0..8 {
            eight[l] += chunk[l];
        }
    }
    let [a, b, c, d, e, f, g, h] = eight;
    ((a + e) + (b + f)) + ((c + g) + (d + h)) + rest.iter().sum::<f64>()
}

/// `LANE_MULTIPLE` values from a place.
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
        for l in 0..W {
            sum[l] = c.mul_add(v[l], sum[l]);
        }
    }
    sum
}

/// out[s] = factor · v[lane + s]
#[inline(always)]
pub(crate) fn scaled(out: &mut [f64], factor: f64, v: Values<'_>, lane: usize) {
    match v {
        Values::Uniform(u) => out.fill(factor * u),
        Values::Lanes(v) => {
            let v = &v[lane..lane + out.len()];
            let ((out, out_rest), (v, v_rest)) =
                (out.as_chunks_mut::<LANE_MULTIPLE>(), v.as_chunks::<LANE_MULTIPLE>());
            for (o, &v) in out.iter_mut().zip(v) {
                *o = std::array::from_fn(|l| factor * v[l]);
            }
            for (o, v) in out_rest.iter_mut().zip(v_rest) {
                *o = factor * v;
            }
        }
    }
}
