//! Elementary functions that vectorise over lanes.
//!
//! Each function comes as a scalar, `sin(x)`, and over slices,
//! `sin_lanes(out, a)`; both give the same bits, NaN's aside, with every
//! instruction set.
//! Three rules make it so:
//!
//! - No branches: each case is computed and the right one selected, so that
//!   the compiler turns a plain loop into vector code.
//! - Products and sums are fused only where `mul_add` says so. With FMA in the
//!   instruction set it is one instruction; without, a library call that rounds
//!   alike but takes ten times as long.
//! - The lane forms are plain loops, inlined, so that they take the
//!   instruction set of their caller, which is where to write
//!   `#[multiversion]`.
//!
//! The polynomials are minimax fits (Remez in mpmath, weighted for relative
//! error, the coefficients rounded one by one and the rest refitted). The
//! accuracies stated are the largest seen over tens of millions of arguments,
//! against the same functions with 64-bit fractions (glibc's `sinl` and so on).

mod exponential;
mod hyperbolic;
mod inverse;
mod trigonometric;

pub use exponential::{
    exp, exp_lanes, expm1, expm1_lanes, hypot, hypot_lanes, log, log_lanes, log1p, log1p_lanes, pow,
    pow_lanes,
};
pub use hyperbolic::{asinh, asinh_lanes, cosh, cosh_lanes, sinh, sinh_lanes, tanh, tanh_lanes};
pub use inverse::{acos, acos_lanes, asin, asin_lanes, atan, atan_lanes, atan2, atan2_lanes};
pub use trigonometric::{cos, cos_lanes, sin, sin_cos, sin_cos_lanes, sin_lanes, tan, tan_lanes};

/// Defines `$lanes(out, a)`, the loop of the scalar `$f` over a slice.
macro_rules! unary_lanes {
    ($($lanes:ident = $f:ident),* $(,)?) => {$(
        #[doc = concat!("`out[l] = ", stringify!($f), "(a[l])`; equal lengths.")]
        #[inline(always)]
        pub fn $lanes(out: &mut [f64], a: &[f64]) {
            debug_assert_eq!(out.len(), a.len());
            for (o, &x) in out.iter_mut().zip(a) {
                *o = $f(x);
            }
        }
    )*};
}

/// Defines `$lanes(out, a, b)`, the loop of the scalar `$f` over two slices.
macro_rules! binary_lanes {
    ($($lanes:ident = $f:ident),* $(,)?) => {$(
        #[doc = concat!("`out[l] = ", stringify!($f), "(a[l], b[l])`; equal lengths.")]
        #[inline(always)]
        pub fn $lanes(out: &mut [f64], a: &[f64], b: &[f64]) {
            debug_assert!(out.len() == a.len() && out.len() == b.len());
            for ((o, &x), &y) in out.iter_mut().zip(a).zip(b) {
                *o = $f(x, y);
            }
        }
    )*};
}

use {binary_lanes, unary_lanes};

/// The sign bit of an `f64`.
const SIGN: u64 = 1 << 63;

/// 1.5·2⁵². Added to a number below 2⁵¹ it rounds it to an integer, which
/// then stands in the low bits of the sum. A conversion to `i64` would do the
/// same, but vectorises with AVX-512 only.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// π/2 in three parts of 53 bits each.
const HALF_PI: [f64; 3] = [std::f64::consts::FRAC_PI_2, 6.123233995736766e-17, -1.4973849048591698e-33];

/// The polynomial with coefficients `c`, lowest first, at `x`. The even powers
/// and the odd ones are summed apart, by Horner's rule in x²: two short chains
/// of dependent operations take less time than one long.
#[inline(always)]
fn polynomial<const N: usize>(x: f64, c: [f64; N]) -> f64 {
    let square = x * x;
    let mut sums = [c[N - 2], c[N - 1]];
    for i in (0..N - 2).rev() {
        let chain = (N - i) % 2;
        sums[chain] = sums[chain].mul_add(square, c[i]);
    }
    let [even, odd] = if N.is_multiple_of(2) { sums } else { [sums[1], sums[0]] };
    odd.mul_add(x, even)
}

/// `big + small` and its rounding error, where |big| ≥ |small| or big = 0.
#[inline(always)]
fn two_sum(big: f64, small: f64) -> (f64, f64) {
    let sum = big + small;
    (sum, (big - sum) + small)
}

/// The quotient of two numbers each given as a sum, rounded and remainder.
#[inline(always)]
fn divide(n: (f64, f64), d: (f64, f64)) -> (f64, f64) {
    let reciprocal = 1.0 / d.0;
    let q = n.0 * reciprocal;
    let rest = (-q).mul_add(d.0, n.0) + (-q).mul_add(d.1, n.1);
    (q, rest * reciprocal)
}

/// `v`, negated where the top bit of `signs` is set.
#[inline(always)]
fn flip(v: f64, signs: u64) -> f64 {
    f64::from_bits(v.to_bits() ^ (signs & SIGN))
}

/// The square root, correctly rounded.
#[inline(always)]
pub fn sqrt(x: f64) -> f64 {
    x.sqrt()
}

/// The absolute value.
#[inline(always)]
pub fn abs(x: f64) -> f64 {
    x.abs()
}

/// −1, 0 or 1 as `x` is negative, zero or positive; NaN for NaN.
#[inline(always)]
pub fn sign(x: f64) -> f64 {
    if x > 0.0 {
        1.0
    } else if x < 0.0 {
        -1.0
    } else {
        x
    }
}

/// The lesser; NaN if either is NaN, so that a failure is not hidden.
#[inline(always)]
pub fn min(x: f64, y: f64) -> f64 {
    if x.is_nan() || x < y { x } else { y }
}

/// The greater; NaN if either is NaN, so that a failure is not hidden.
#[inline(always)]
pub fn max(x: f64, y: f64) -> f64 {
    if x.is_nan() || x > y { x } else { y }
}

unary_lanes!(sqrt_lanes = sqrt, abs_lanes = abs, sign_lanes = sign);
binary_lanes!(min_lanes = min, max_lanes = max);

/// `x` to the integer power `n`, by repeated squaring; a negative power is
/// the reciprocal of the positive one. The error stays below |`n`| ulp. Where the positive power overflows, the negative one is 0.
#[inline(always)]
pub fn powi(x: f64, n: i32) -> f64 {
    powi_block([x], n)[0]
}

/// `out[l] = powi(a[l], n)`; equal lengths.
#[inline(always)]
pub fn powi_lanes(out: &mut [f64], a: &[f64], n: i32) {
    debug_assert_eq!(out.len(), a.len());
    let (out_blocks, out_rest) = out.as_chunks_mut::<8>();
    let (a_blocks, a_rest) = a.as_chunks::<8>();
    for (o, &x) in out_blocks.iter_mut().zip(a_blocks) {
        *o = powi_block(x, n);
    }
    for (o, &x) in out_rest.iter_mut().zip(a_rest) {
        *o = powi(x, n);
    }
}

/// Blocks put the loop over the lanes inside that over the bits of `n`, the
/// order that vectorises.
#[inline(always)]
fn powi_block<const N: usize>(x: [f64; N], n: i32) -> [f64; N] {
    let mut power = [1.0; N];
    let mut square = x;
    let mut bits = n.unsigned_abs();
    while bits != 0 {
        if bits & 1 == 1 {
            for l in 0..N {
                power[l] *= square[l];
            }
        }
        for s in &mut square {
            *s *= *s;
        }
        bits >>= 1;
    }
    if n < 0 {
        for p in &mut power {
            *p = 1.0 / *p;
        }
    }
    power
}
