//! sin, cos and tan: reduction to |r| ≤ π/4, then one polynomial each for the
//! sine and the cosine of r, both always computed.

use super::{HALF_PI, ROUND, divide, flip, polynomial, two_sum, unary_lanes};

/// Beyond 2³⁰ the reduction with three parts of π/2 runs out of bits; such
/// arguments, infinities and NaN go to std.
const FAR: f64 = 1_073_741_824.0;

const SIN: [f64; 6] = [
    -0.16666666666666632,
    0.008333333333322488,
    -0.000198412698298556,
    2.755731370606096e-06,
    -2.5050760075095013e-08,
    1.5896898811571363e-10,
];

const COS: [f64; 6] = [
    0.0416666666666666,
    -0.0013888888888874472,
    2.48015872896693e-05,
    -2.755731440022266e-07,
    2.0875729160471973e-09,
    -1.1359927875340161e-11,
];

/// sin(r) and cos(r), each as a sum of two, for x = r + q·π/2; the low two
/// bits of q are those of the integer given.
struct Quarter {
    s: (f64, f64),
    c: (f64, f64),
    q: u64,
}

#[inline(always)]
fn quarter(x: f64) -> Quarter {
    let shifted = x.mul_add(std::f64::consts::FRAC_2_PI, ROUND);
    let q = shifted - ROUND;
    // The first step is exact, for it cancels; so is the product of the
    // second, split in two, and its difference. So r keeps its relative
    // accuracy even where x is next to a multiple of π/2.
    let near = (-q).mul_add(HALF_PI[0], x);
    let step = q * HALF_PI[1];
    let step_low = q.mul_add(HALF_PI[1], -step);
    let (r, rest) = two_sum(near, -step);
    let r_low = (-q).mul_add(HALF_PI[2], rest - step_low);

    let z = r * r;
    let (one, one_low) = two_sum(1.0, -0.5 * z);
    let sin_low = (r * z).mul_add(polynomial(z, SIN), r_low * one);
    let cos_low = (z * z).mul_add(polynomial(z, COS), (-r).mul_add(r_low, one_low));
    Quarter { s: (r, sin_low), c: (one, cos_low), q: shifted.to_bits() }
}

#[inline(always)]
fn sin_near(x: f64) -> f64 {
    sin_cos_near(x).0
}

#[inline(always)]
fn cos_near(x: f64) -> f64 {
    sin_cos_near(x).1
}

#[inline(always)]
fn sin_cos_near(x: f64) -> (f64, f64) {
    let Quarter { s, c, q } = quarter(x.abs());
    let (s, c) = (s.0 + s.1, c.0 + c.1);
    let (s, c) = if q & 1 == 0 { (s, c) } else { (c, s) };
    (flip(s, (q << 62) ^ x.to_bits()), flip(c, q.wrapping_add(1) << 62))
}

#[inline(always)]
fn tan_near(x: f64) -> f64 {
    let Quarter { s, c, q } = quarter(x.abs());
    let (s, c) = (two_sum(s.0, s.1), two_sum(c.0, c.1));
    let (n, d) = if q & 1 == 0 { (s, c) } else { (c, s) };
    let (tan, tan_low) = divide(n, d);
    flip(tan + tan_low, (q << 63) ^ x.to_bits())
}

/// The sine; 0.8 ulp up to 2³⁰, std beyond.
#[inline(always)]
pub fn sin(x: f64) -> f64 {
    if is_far(x) { x.sin() } else { sin_near(x) }
}

/// The cosine; 0.8 ulp up to 2³⁰, std beyond.
#[inline(always)]
pub fn cos(x: f64) -> f64 {
    if is_far(x) { x.cos() } else { cos_near(x) }
}

/// `(sin(x), cos(x))`, the same bits, for little more than the price of one.
#[inline(always)]
pub fn sin_cos(x: f64) -> (f64, f64) {
    if is_far(x) { x.sin_cos() } else { sin_cos_near(x) }
}

/// The tangent; 1.1 ulp up to 2³⁰, std beyond.
#[inline(always)]
pub fn tan(x: f64) -> f64 {
    if is_far(x) { x.tan() } else { tan_near(x) }
}

#[inline(always)]
fn is_far(x: f64) -> bool {
    x.abs() > FAR || x.is_nan()
}

#[inline(always)]
fn any_far(a: &[f64]) -> bool {
    let mut far = false;
    for &x in a {
        far |= is_far(x);
    }
    far
}

/// Writes `f` of those lanes the reduction does not serve.
#[cold]
#[inline(never)]
fn redo_far(out: &mut [f64], a: &[f64], f: fn(f64) -> f64) {
    for (o, &x) in out.iter_mut().zip(a) {
        if is_far(x) {
            *o = f(x);
        }
    }
}

unary_lanes!(sin_near_lanes = sin_near, cos_near_lanes = cos_near, tan_near_lanes = tan_near);

/// `out[l] = sin(a[l])`; equal lengths.
#[inline(always)]
pub fn sin_lanes(out: &mut [f64], a: &[f64]) {
    sin_near_lanes(out, a);
    if any_far(a) {
        redo_far(out, a, f64::sin);
    }
}

/// `out[l] = cos(a[l])`; equal lengths.
#[inline(always)]
pub fn cos_lanes(out: &mut [f64], a: &[f64]) {
    cos_near_lanes(out, a);
    if any_far(a) {
        redo_far(out, a, f64::cos);
    }
}

/// `out[l] = tan(a[l])`; equal lengths.
#[inline(always)]
pub fn tan_lanes(out: &mut [f64], a: &[f64]) {
    tan_near_lanes(out, a);
    if any_far(a) {
        redo_far(out, a, f64::tan);
    }
}

/// `(sin[l], cos[l]) = sin_cos(a[l])`; equal lengths.
#[inline(always)]
pub fn sin_cos_lanes(sin: &mut [f64], cos: &mut [f64], a: &[f64]) {
    debug_assert!(sin.len() == a.len() && cos.len() == a.len());
    for ((s, c), &x) in sin.iter_mut().zip(cos.iter_mut()).zip(a) {
        (*s, *c) = sin_cos_near(x);
    }
    if any_far(a) {
        redo_far(sin, a, f64::sin);
        redo_far(cos, a, f64::cos);
    }
}
