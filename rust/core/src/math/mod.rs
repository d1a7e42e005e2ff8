//! Elementary functions that vectorise over lanes.
//!
//! Each function comes as a scalar, `sin(x)`, and over a slice,
//! `sin_lanes(out, a)`; both give the same bits. The lane forms are plain
//! loops, inlined, so that they take the instruction set of their caller.

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

macro_rules! from_std {
    ($($f:ident = $std:ident),* $(,)?) => {$(
        #[doc = concat!("`", stringify!($f), "(x)`.")]
        #[inline(always)]
        pub fn $f(x: f64) -> f64 {
            x.$std()
        }
    )*};
}

from_std!(
    sin = sin,
    cos = cos,
    tan = tan,
    asin = asin,
    acos = acos,
    atan = atan,
    exp = exp,
    log = ln,
    sinh = sinh,
    cosh = cosh,
    tanh = tanh,
    asinh = asinh,
    sqrt = sqrt,
    abs = abs,
);

/// `(sin(x), cos(x))`.
#[inline(always)]
pub fn sin_cos(x: f64) -> (f64, f64) {
    (x.sin(), x.cos())
}

/// The angle of the point `(x, y)`.
#[inline(always)]
pub fn atan2(y: f64, x: f64) -> f64 {
    y.atan2(x)
}

/// `x` to the real power `y`.
#[inline(always)]
pub fn pow(x: f64, y: f64) -> f64 {
    x.powf(y)
}

/// `x` to the integer power `n`.
#[inline(always)]
pub fn powi(x: f64, n: i32) -> f64 {
    x.powi(n)
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

unary_lanes!(
    sin_lanes = sin,
    cos_lanes = cos,
    tan_lanes = tan,
    asin_lanes = asin,
    acos_lanes = acos,
    atan_lanes = atan,
    exp_lanes = exp,
    log_lanes = log,
    sinh_lanes = sinh,
    cosh_lanes = cosh,
    tanh_lanes = tanh,
    asinh_lanes = asinh,
    sqrt_lanes = sqrt,
    abs_lanes = abs,
    sign_lanes = sign,
);

binary_lanes!(atan2_lanes = atan2, pow_lanes = pow, min_lanes = min, max_lanes = max,);

/// `sin[l], cos[l] = sin_cos(a[l])`; equal lengths.
#[inline(always)]
pub fn sin_cos_lanes(sin: &mut [f64], cos: &mut [f64], a: &[f64]) {
    for ((s, c), &x) in sin.iter_mut().zip(cos.iter_mut()).zip(a) {
        (*s, *c) = sin_cos(x);
    }
}

/// `out[l] = powi(a[l], n)`; equal lengths.
#[inline(always)]
pub fn powi_lanes(out: &mut [f64], a: &[f64], n: i32) {
    for (o, &x) in out.iter_mut().zip(a) {
        *o = powi(x, n);
    }
}
