//! asin, acos, atan and atan2: a base angle, known to two parts, and a
//! polynomial in an argument between it and the point.

use super::{HALF_PI, SIGN, binary_lanes, divide, flip, polynomial, two_sum, unary_lanes};

/// (asin(s)/s − 1) / z in z = s² ≤ ¼.
const ASIN: [f64; 13] = [
    0.16666666666666763,
    0.07499999999970118,
    0.04464285717527077,
    0.030381942676063416,
    0.02237221587747438,
    0.01735159618243565,
    0.013981008000142566,
    0.011397397784767666,
    0.010788652104140073,
    0.0036748711736469806,
    0.02178425357684898,
    -0.021108826382572082,
    0.03269865053070887,
];

/// (atan(u)/u − 1) / z in z = u² ≤ tan²(π/8).
const ATAN: [f64; 11] = [
    -0.333333333333332,
    0.1999999999995377,
    -0.14285714280212433,
    0.1111111078416287,
    -0.09090897775671057,
    0.07692060496207806,
    -0.06663106542271958,
    0.058478982375305265,
    -0.050392799263295915,
    0.03806165137023278,
    -0.017900879865663827,
];

const TAN_PI_8: f64 = 0.41421356237309503;

/// π/4 in two parts.
const EIGHTH: [f64; 2] = [0.5 * HALF_PI[0], 0.5 * HALF_PI[1]];

/// Whether |x| is near 1, s = |x| or there √((1 − |x|)/2), the sine of half
/// the angle from x to 1, in two parts, and z = s².
struct HalfAngle {
    near_one: bool,
    s: f64,
    s_low: f64,
    z: f64,
}

#[inline(always)]
fn half_angle(x: f64) -> HalfAngle {
    let x = x.abs();
    let near_one = x > 0.5;
    let z = if near_one { 0.5 - 0.5 * x } else { x * x };
    let root = z.sqrt();
    // What the root was rounded by; the addend spares a division 0/0.
    let root_low = (-root).mul_add(root, z) / (root + root + f64::MIN_POSITIVE);
    let (s, s_low) = if near_one { (root, root_low) } else { (x, 0.0) };
    HalfAngle { near_one, s, s_low, z }
}

/// `base` + `factor`·asin(s + `s_low`) with z = s².
#[inline(always)]
fn from_base(base: (f64, f64), factor: f64, s: f64, s_low: f64, z: f64) -> f64 {
    let (sum, rest) = two_sum(base.0, factor * s);
    let tail = (s * z).mul_add(polynomial(z, ASIN), s_low);
    sum + factor.mul_add(tail, rest + base.1)
}

/// The arcsine; 0.7 ulp.
#[inline(always)]
pub fn asin(x: f64) -> f64 {
    let HalfAngle { near_one, s, s_low, z } = half_angle(x);
    let base = if near_one { (HALF_PI[0], HALF_PI[1]) } else { (0.0, 0.0) };
    let factor = if near_one { -2.0 } else { 1.0 };
    flip(from_base(base, factor, s, s_low, z), x.to_bits())
}

/// The arccosine; 0.7 ulp.
#[inline(always)]
pub fn acos(x: f64) -> f64 {
    let HalfAngle { near_one, s, s_low, z } = half_angle(x);
    // π/2 − asin(x); near 1, 2·asin(s); near −1, π − 2·asin(s).
    let turns = if !near_one {
        1.0
    } else if x < 0.0 {
        2.0
    } else {
        0.0
    };
    let factor = if near_one { 2.0 } else { -1.0 };
    let base = (turns * HALF_PI[0], turns * HALF_PI[1]);
    from_base(base, flip(factor, x.to_bits()), s, s_low, z)
}

/// The angle in [0, π/2] of the point (`x`, `y`) of the first quadrant; if
/// `mirror`, π less that.
#[inline(always)]
fn angle(y: f64, x: f64, mirror: bool) -> f64 {
    let steep = y > x;
    let (large, small) = if steep { (y, x) } else { (x, y) };
    // Next to the axis or next to the diagonal: the base angle in eighths of
    // the circle, and the coordinates along it and across.
    let diagonal = small > TAN_PI_8 * large;
    let (along, across) = (two_sum(large, small), two_sum(large, -small));
    let d = if diagonal { along } else { (large, 0.0) };
    let n = if diagonal { (-across.0, -across.1) } else { (small, 0.0) };
    let (u, u_low) = divide(n, d);
    let eighths = if diagonal { 1.0 } else { 0.0 };

    let eighths = if steep { 2.0 - eighths } else { eighths };
    let eighths = if mirror { 4.0 - eighths } else { eighths };
    let sign = if steep != mirror { SIGN } else { 0 };
    let (u, u_low) = (flip(u, sign), flip(u_low, sign));
    let base = eighths * EIGHTH[0];
    let base_low = eighths.mul_add(EIGHTH[1], eighths.mul_add(EIGHTH[0], -base));

    let z = u * u;
    let (sum, rest) = two_sum(base, u);
    sum + (u * z).mul_add(polynomial(z, ATAN), u_low + (rest + base_low))
}

/// The arctangent; 0.9 ulp.
#[inline(always)]
pub fn atan(x: f64) -> f64 {
    // Beyond the bound the angle is π/2 to all digits; NaN passes.
    let y = if x.abs() > 1e30 { 1e30 } else { x.abs() };
    flip(angle(y, 1.0, false), x.to_bits())
}

/// The angle of the point (`x`, `y`); 0.9 ulp. Zeros and infinities as in
/// `f64::atan2`.
#[inline(always)]
pub fn atan2(y: f64, x: f64) -> f64 {
    let (mut along, mut across) = (x.abs(), y.abs());
    // Only directions matter where a coordinate is infinite.
    if along == f64::INFINITY || across == f64::INFINITY {
        along = if along == f64::INFINITY { 1.0 } else { 0.0 };
        across = if across == f64::INFINITY { 1.0 } else { 0.0 };
    }
    // Keeps the sum of the coordinates and the reciprocal of the larger one
    // representable.
    let large = if along > across { along } else { across };
    const LARGE: f64 = f64::from_bits((1023 + 100) << 52); // 2¹⁰⁰
    let scale = if large > 1e300 {
        1.0 / LARGE
    } else if large < 1e-270 {
        LARGE
    } else {
        1.0
    };
    // Spares the division 0/0.
    let origin = if large == 0.0 { 1.0 } else { along * scale };
    let v = angle(across * scale, origin, x.is_sign_negative());
    let v = flip(v, y.to_bits());
    if x.is_nan() || y.is_nan() { f64::NAN } else { v }
}

unary_lanes!(asin_lanes = asin, acos_lanes = acos, atan_lanes = atan);
binary_lanes!(atan2_lanes = atan2);
