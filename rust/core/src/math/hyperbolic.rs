//! sinh, cosh, tanh and asinh.

use super::exponential::{exp_tail, log_sum, reduce_by_ln2};
use super::{divide, flip, polynomial, two_sum, unary_lanes};

/// (sinh(r)/r − 1) / z in z = r², |r| ≤ 1.02.
const SINH: [f64; 7] = [
    0.16666666666666669,
    0.008333333333332913,
    0.00019841269841590716,
    2.755731910812266e-06,
    2.5052130697019647e-08,
    1.605668927103777e-10,
    7.775489482863444e-13,
];

/// (cosh(r) − 1 − z/2) / z² in z = r², |r| ≤ ln(2)/2.
const COSH: [f64; 4] =
    [0.04166666666660264, 0.0013888888927337038, 2.480150799920947e-05, 2.762545802405095e-07];

/// 2ᵏ for −1022 ≤ k ≤ 1023.
#[inline(always)]
fn power_of_2(k: u64) -> f64 {
    f64::from_bits(k.wrapping_add(1023) << 52)
}

/// sinh(r), cosh(r) − 1, and a quarter of 2ᵏ − 2⁻ᵏ and 2ᵏ + 2⁻ᵏ.
struct Parts {
    s: f64,
    c: f64,
    difference: f64,
    sum: f64,
}

/// The parts of x = r + k·ln 2. With them there is no need for the quotient 1/exp(x).
#[inline(always)]
fn parts(r: f64, k: u64) -> Parts {
    let z = r * r;
    let sinh = (r * z).mul_add(polynomial(z, SINH), r);
    let cosh_less_1 = (z * z).mul_add(polynomial(z, COSH), 0.5 * z);
    // Quarters, lest 2ᵏ overflow where the result does not.
    let up = power_of_2(k.wrapping_sub(2));
    // 2⁻ᵏ no longer counts long before it would be subnormal.
    let down = power_of_2(0u64.wrapping_sub(if k > 100 { 100 } else { k }).wrapping_sub(2));
    Parts { s: sinh, c: cosh_less_1, difference: up - down, sum: up + down }
}

/// |x|, or a number whose sinh and cosh overflow just as those of x.
#[inline(always)]
fn bounded(x: f64) -> f64 {
    if x.abs() > 710.6 { 710.6 } else { x.abs() }
}

/// The hyperbolic sine; 1.8 ulp.
#[inline(always)]
pub fn sinh(x: f64) -> f64 {
    let large = bounded(x);
    let (r, k) = reduce_by_ln2(large);
    // Below 1 the parts would cancel, and the polynomial serves alone.
    let alone = large < 1.0;
    let Parts { s, c, difference, sum } = parts(if alone { large } else { r }, k);
    let quarters = difference + sum.mul_add(s, difference * c);
    flip(if alone { s } else { quarters + quarters }, x.to_bits())
}

/// The hyperbolic cosine; 1.6 ulp.
#[inline(always)]
pub fn cosh(x: f64) -> f64 {
    let (r, k) = reduce_by_ln2(bounded(x));
    let Parts { s, c, difference, sum } = parts(r, k);
    2.0 * (sum + difference.mul_add(s, sum * c))
}

/// The hyperbolic tangent; 1.3 ulp.
#[inline(always)]
pub fn tanh(x: f64) -> f64 {
    // With e = exp(2|x|) − 1 it is e / (e + 2). From the bound on it rounds
    // to 1; NaN passes.
    let double = 2.0 * x.abs();
    let (r, k) = reduce_by_ln2(if double > 40.0 { 40.0 } else { double });
    let power = power_of_2(k);
    let tail = power * exp_tail(r);
    let (sum, rest) = two_sum(power, power * r);
    let (e, e_low) = two_sum(sum, -1.0);
    let (d, d_low) = two_sum(sum, 1.0);
    let low = rest + tail;
    let (tanh, tanh_low) = divide(two_sum(e, e_low + low), two_sum(d, d_low + low));
    flip(tanh + tanh_low, x.to_bits())
}

/// The inverse hyperbolic sine; 1.8 ulp.
#[inline(always)]
pub fn asinh(x: f64) -> f64 {
    let y = x.abs();
    // log(2y) where the square no longer counts, else log(1 + g).
    let far = y > 1e9;
    let square = y * y;
    let g = y + square / (1.0 + (1.0 + square).sqrt());
    let sum = 1.0 + g;
    let rest = if g > 1.0 { (g - sum) + 1.0 } else { (1.0 - sum) + g };
    let (argument, c, twos) = if far { (y, 0.0, 1.0) } else { (sum, rest / sum, 0.0) };
    let v = log_sum(argument, c, twos);
    flip(if y < f64::INFINITY { v } else { y }, x.to_bits())
}

unary_lanes!(sinh_lanes = sinh, cosh_lanes = cosh, tanh_lanes = tanh, asinh_lanes = asinh);
