//! exp, log and pow: x = r + k·ln 2, and x = 2ᵏ·m, by the bits of k.

use super::{ROUND, SIGN, binary_lanes, divide, flip, polynomial, two_sum, unary_lanes};

/// ln 2 in two parts; the first has 42 bits, so that k times it is exact.
const LN_2: [f64; 2] = [0.6931471805598903, 5.497923018708371e-14];

/// (exp(r) − 1 − r) / r² for |r| ≤ ln(2)/2.
const EXP: [f64; 11] = [
    0.5,
    0.16666666666666685,
    0.04166666666666673,
    0.008333333333316685,
    0.0013888888888858265,
    0.0001984126989719416,
    2.4801587374001578e-05,
    2.7557234099797353e-06,
    2.7557233181243415e-07,
    2.511228821856107e-08,
    2.092698951699441e-09,
];

/// (2·atanh(s)/s − 2) / z in z = s².
const LOG: [f64; 7] = [
    0.6666666666666735,
    0.3999999999940929,
    0.2857142874371094,
    0.2222219842559731,
    0.181835726249413,
    0.15313821317683945,
    0.14798419593241052,
];

/// The series without its first term, which is 2/3.
const POW_LOG: [f64; 8] = [
    0.3999999999999998,
    0.2857142857144387,
    0.2222222221777866,
    0.1818181884571948,
    0.15384558292462286,
    0.13336270266477454,
    0.11675655279694067,
    0.11982852845126644,
];

/// 2/3 in two parts.
const TWO_THIRDS: [f64; 2] = [0.6666666666666666, 3.700743415417188e-17];

/// The bits of 1 and of √½, and the mask of the fraction.
const ONE: u64 = 1f64.to_bits();
const SQRT_HALF: u64 = 0x3fe6_a09e_667f_3bcd;
const FRACTION: u64 = (1 << 52) - 1;

/// r and k with x = r + k·ln 2, |r| ≤ ln(2)/2; k modulo 2⁶⁴.
#[inline(always)]
pub(super) fn reduce_by_ln2(x: f64) -> (f64, u64) {
    let shifted = x.mul_add(std::f64::consts::LOG2_E, ROUND);
    let k = shifted - ROUND;
    let r = (-k).mul_add(LN_2[1], (-k).mul_add(LN_2[0], x));
    (r, shifted.to_bits().wrapping_sub(ROUND.to_bits()))
}

/// Reduces `x` + `low`, with r as a sum of two.
#[inline(always)]
fn reduce_pair_by_ln2(x: f64, low: f64) -> ((f64, f64), u64) {
    let shifted = x.mul_add(std::f64::consts::LOG2_E, ROUND);
    let k = shifted - ROUND;
    let r = two_sum((-k).mul_add(LN_2[0], x), (-k).mul_add(LN_2[1], low));
    (r, shifted.to_bits().wrapping_sub(ROUND.to_bits()))
}

/// exp(r) − 1 − r for |r| ≤ ln(2)/2.
#[inline(always)]
pub(super) fn exp_tail(r: f64) -> f64 {
    r * r * polynomial(r, EXP)
}

/// `v`·2ᵏ for −2044 < k < 2048: in two steps, lest 2ᵏ overflow where `v`·2ᵏ
/// does not, and rounded once where the result is subnormal.
#[inline(always)]
fn scale(v: f64, k: u64) -> f64 {
    let n = k.wrapping_add(2 * 1023);
    let half = n >> 1;
    let (first, second) = (half << 52, n.wrapping_sub(half) << 52);
    v * f64::from_bits(first) * f64::from_bits(second)
}

/// The exponential; 1 ulp.
#[inline(always)]
pub fn exp(x: f64) -> f64 {
    // Beyond these bounds the result is ∞ or 0; NaN passes.
    let (r, k) = reduce_by_ln2(x.clamp(-750.0, 750.0));
    scale(1.0 + (r + exp_tail(r)), k)
}

/// m and k with x = 2ᵏ·m and √½ ≤ m < √2, for positive finite x.
#[inline(always)]
fn split(x: f64) -> (f64, f64) {
    let subnormal = x < f64::MIN_POSITIVE;
    let up = x * 18_014_398_509_481_984.0; // 2⁵⁴
    let x = if subnormal { up } else { x };
    let bias = if subnormal { 1023.0 + 54.0 } else { 1023.0 };
    let bits = x.to_bits().wrapping_add(ONE - SQRT_HALF);
    let m = f64::from_bits((bits & FRACTION) + SQRT_HALF);
    // The exponent as the low bits of 2⁵² + k, which is a conversion to f64.
    let two_52 = 4_503_599_627_370_496.0;
    let k = f64::from_bits((bits >> 52) | f64::to_bits(two_52)) - (two_52 + bias);
    (m, k)
}

/// log(x·(1 + c)) + j·ln 2 for positive finite x and small c.
#[inline(always)]
pub(super) fn log_sum(x: f64, c: f64, j: f64) -> f64 {
    let (m, k) = split(x);
    let k = k + j;
    let f = m - 1.0;
    let s = f / (2.0 + f);
    let z = s * s;
    // log(1 + f) = f − f²/2 + s·(f²/2 + R(s²)), where the large terms are exact
    // or small.
    let half = 0.5 * f * f;
    let low = s.mul_add(z.mul_add(polynomial(z, LOG), half), k.mul_add(LN_2[1], c));
    k.mul_add(LN_2[0], f - (half - low))
}

/// The natural logarithm; 0.9 ulp.
#[inline(always)]
pub fn log(x: f64) -> f64 {
    let v = log_sum(x, 0.0, 0.0);
    log_special(x, v)
}

/// `v`, or what log(x) is where `x` is not positive and finite.
#[inline(always)]
fn log_special(x: f64, v: f64) -> f64 {
    let v = if x < f64::INFINITY { v } else { x };
    let v = if x == 0.0 { f64::NEG_INFINITY } else { v };
    if x < 0.0 { f64::NAN } else { v }
}

/// log(x), x ≥ 0, as a sum of two, to some 2⁻⁶⁶ of itself.
#[inline(always)]
fn log_pair(x: f64) -> (f64, f64) {
    let (m, k) = split(x);
    let sum = m + 1.0;
    let (s, s_low) = divide((m - 1.0, 0.0), (sum, m - (sum - 1.0)));
    let z = s * s;
    let z_low = s.mul_add(s, -z) + 2.0 * s * s_low;
    // log(m) = 2s + s³·p(s²), p = 2/3 + z·q(z), in two parts each.
    let q = polynomial(z, POW_LOG);
    let p = z.mul_add(q, TWO_THIRDS[0]);
    let p_low = z.mul_add(q, TWO_THIRDS[0] - p) + z_low.mul_add(q, TWO_THIRDS[1]);
    let cube = z * s;
    let cube_low = z.mul_add(s, -cube) + z.mul_add(s_low, z_low * s);
    let v = cube * p;
    let v_low = cube.mul_add(p, -v) + cube.mul_add(p_low, cube_low * p);
    let (a, a_low) = two_sum(k * LN_2[0], 2.0 * s);
    let (b, b_low) = two_sum(a, v);
    let low = k.mul_add(LN_2[1], 2.0 * s_low + v_low) + (a_low + b_low);
    let (log, log_low) = two_sum(b, low);
    (log_special(x, log), log_low)
}

/// `x` to the real power `y`; 0.9 ulp. Special cases as in `f64::powf`: a
/// negative `x` has integer powers only, anything to the power 0 is 1, and so
/// is 1 to any power.
#[inline(always)]
pub fn pow(x: f64, y: f64) -> f64 {
    let base = x.abs();
    let (log, log_low) = log_pair(base);
    let p = y * log;
    let p_low = y.mul_add(log, -p) + y * log_low;
    // Where p is beyond the bounds the remainder does not matter, and may be
    // NaN.
    let p_low = if p.abs() < 750.0 { p_low } else { 0.0 };
    let (r, k) = reduce_pair_by_ln2(p.clamp(-750.0, 750.0), p_low);
    let power = scale(1.0 + (r.0 + r.0.mul_add(r.1, exp_tail(r.0) + r.1)), k);
    let power = if base == 1.0 && y.is_infinite() { 1.0 } else { power };

    let negative = x.to_bits() & SIGN;
    let integer = y.trunc() == y;
    // From 2⁵³ on, halves are integers too: such y are even.
    let odd = integer && (0.5 * y).trunc() != 0.5 * y;
    let power = flip(power, if odd { negative } else { 0 });
    let undefined = x < 0.0 && !integer && base < f64::INFINITY;
    let power = if undefined { f64::NAN } else { power };
    if x == 1.0 || y == 0.0 { 1.0 } else { power }
}

/// exp(x) − 1, accurate where x is small; 1.5 ulp.
#[inline(always)]
pub fn expm1(x: f64) -> f64 {
    // Within the bounds 2ᵏ (1 + r + tail) − 1 in two parts, as in tanh; below them it rounds to −1, above the 1 no
    // longer counts.
    let bounded = if x > 40.0 { 40.0 } else { x };
    let (r, k) = reduce_by_ln2(if bounded < -40.0 { -40.0 } else { bounded });
    let power = f64::from_bits(k.wrapping_add(1023) << 52);
    let (sum, rest) = two_sum(power, power * r);
    let (e, e_low) = two_sum(sum, -1.0);
    let near = e + (e_low + (rest + power * exp_tail(r)));
    let value = if x > 40.0 { exp(x) } else { near };
    if x == 0.0 { x } else { value }
}

/// log(1 + x), accurate where x is small; 1 ulp.
#[inline(always)]
pub fn log1p(x: f64) -> f64 {
    let sum = 1.0 + x;
    // What the sum has lost in rounding.
    let rest = if x.abs() > 1.0 { (x - sum) + 1.0 } else { (1.0 - sum) + x };
    let near = log_sum(sum, rest / sum, 0.0);
    let value = if x == 0.0 || x == f64::INFINITY { x } else { near };
    let below = if x == -1.0 { f64::NEG_INFINITY } else { f64::NAN };
    if x > -1.0 { value } else { below }
}

/// √(x² + y²), which does not overflow before its result does; 2 ulp.
#[inline(always)]
pub fn hypot(x: f64, y: f64) -> f64 {
    let (x, y) = (x.abs(), y.abs());
    let (large, small) = if x > y { (x, y) } else { (y, x) };
    let ratio = small / large;
    let value = large * ratio.mul_add(ratio, 1.0).sqrt();
    let value = if large == 0.0 { 0.0 } else { value };
    let value = if x == f64::INFINITY || y == f64::INFINITY { f64::INFINITY } else { value };
    if x.is_nan() || y.is_nan() { f64::NAN } else { value }
}

unary_lanes!(exp_lanes = exp, log_lanes = log, expm1_lanes = expm1, log1p_lanes = log1p);
binary_lanes!(pow_lanes = pow, hypot_lanes = hypot);
