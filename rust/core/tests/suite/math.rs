//! The elementary functions: accuracy against std and against correctly
//! rounded results of mpmath, and the same bits in every form.

use phugoid::internals::math;
use proptest::prelude::*;

/// The functions of one argument: their three forms, std's, and the greatest
/// distance from it allowed. Where both err by less than 1 ulp it is 1 or,
/// across a power of two, 2; glibc's hyperbolic functions err by 2.
struct Unary {
    name: &'static str,
    scalar: fn(f64) -> f64,
    lanes: [Lanes; 3],
    std: fn(f64) -> f64,
    ulps: u64,
}

struct Binary {
    name: &'static str,
    scalar: fn(f64, f64) -> f64,
    lanes: [BinaryLanes; 3],
    std: fn(f64, f64) -> f64,
    ulps: u64,
}

type Lanes = fn(&mut [f64], &[f64]);
type BinaryLanes = fn(&mut [f64], &[f64], &[f64]);

/// A lane function compiled for three instruction sets; where the machine has
/// not got one, for the plainest.
macro_rules! compiled {
    ($lanes:ident($($a:ident),*)) => {{
        fn plain(out: &mut [f64], $($a: &[f64]),*) {
            math::$lanes(out, $($a),*);
        }
        #[cfg(target_arch = "x86_64")]
        mod wide {
            #[target_feature(enable = "avx2,fma")]
            pub fn avx2(out: &mut [f64], $($a: &[f64]),*) {
                phugoid::internals::math::$lanes(out, $($a),*);
            }
            #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx2,fma")]
            pub fn avx512(out: &mut [f64], $($a: &[f64]),*) {
                phugoid::internals::math::$lanes(out, $($a),*);
            }
        }
        fn avx2(out: &mut [f64], $($a: &[f64]),*) {
            #[cfg(target_arch = "x86_64")]
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                // Safety: the features are there.
                return unsafe { wide::avx2(out, $($a),*) };
            }
            plain(out, $($a),*);
        }
        fn avx512(out: &mut [f64], $($a: &[f64]),*) {
            #[cfg(target_arch = "x86_64")]
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("fma")
            {
                // Safety: the features are there.
                return unsafe { wide::avx512(out, $($a),*) };
            }
            plain(out, $($a),*);
        }
        [plain, avx2, avx512]
    }};
}

macro_rules! unary {
    ($scalar:ident, $lanes:ident, $std:expr, $ulps:expr) => {
        Unary {
            name: stringify!($scalar),
            scalar: math::$scalar,
            lanes: compiled!($lanes(a)),
            std: $std,
            ulps: $ulps,
        }
    };
}

macro_rules! binary {
    ($scalar:ident, $lanes:ident, $std:expr, $ulps:expr) => {
        Binary {
            name: stringify!($scalar),
            scalar: math::$scalar,
            lanes: compiled!($lanes(a, b)),
            std: $std,
            ulps: $ulps,
        }
    };
}

fn unary_functions() -> Vec<Unary> {
    vec![
        unary!(sin, sin_lanes, f64::sin, 1),
        unary!(cos, cos_lanes, f64::cos, 1),
        unary!(tan, tan_lanes, f64::tan, 2),
        unary!(asin, asin_lanes, f64::asin, 1),
        unary!(acos, acos_lanes, f64::acos, 1),
        unary!(atan, atan_lanes, f64::atan, 1),
        unary!(exp, exp_lanes, f64::exp, 1),
        unary!(log, log_lanes, f64::ln, 1),
        unary!(sinh, sinh_lanes, f64::sinh, 3),
        unary!(cosh, cosh_lanes, f64::cosh, 3),
        unary!(tanh, tanh_lanes, f64::tanh, 3),
        unary!(asinh, asinh_lanes, libm_asinh, 3),
        unary!(sqrt, sqrt_lanes, f64::sqrt, 0),
        unary!(abs, abs_lanes, f64::abs, 0),
        unary!(sign, sign_lanes, sign_of, 0),
    ]
}

fn binary_functions() -> Vec<Binary> {
    vec![
        binary!(pow, pow_lanes, f64::powf, 1),
        binary!(atan2, atan2_lanes, f64::atan2, 1),
        binary!(min, min_lanes, |x, y| nan_or(x, y, x.min(y)), 0),
        binary!(max, max_lanes, |x, y| nan_or(x, y, x.max(y)), 0),
    ]
}

/// The C library's; std has one of its own, less accurate.
fn libm_asinh(x: f64) -> f64 {
    unsafe extern "C" {
        safe fn asinh(x: f64) -> f64;
    }
    asinh(x)
}

fn sign_of(x: f64) -> f64 {
    if x == 0.0 { x } else { x.signum() }
}

fn nan_or(x: f64, y: f64, v: f64) -> f64 {
    if x.is_nan() || y.is_nan() { f64::NAN } else { v }
}

/// How many doubles `a` is from `b`; NaN is next to NaN only.
fn ulps(a: f64, b: f64) -> u64 {
    if a.is_nan() || b.is_nan() {
        return if a.is_nan() && b.is_nan() { 0 } else { u64::MAX };
    }
    let order = |v: f64| {
        let size = v.abs().to_bits() as i64;
        if v.is_sign_negative() { -size } else { size }
    };
    order(a).abs_diff(order(b))
}

/// Bits, but one NaN is as good as another.
fn bits(v: f64) -> u64 {
    if v.is_nan() { f64::NAN.to_bits() } else { v.to_bits() }
}

/// Zeros, infinities and NaN, the ends of the range and the marks at which
/// the functions pass from one case to another.
fn special() -> Vec<f64> {
    let positive = [
        0.0,
        f64::from_bits(1),
        f64::MIN_POSITIVE / 3.0,
        f64::MIN_POSITIVE,
        1e-300,
        1e-20,
        0.25,
        std::f64::consts::LN_2 / 2.0,
        0.41421356237309503,
        0.5,
        std::f64::consts::FRAC_1_SQRT_2,
        std::f64::consts::FRAC_PI_4,
        1.0,
        std::f64::consts::FRAC_PI_2,
        2.0,
        2.414213562373095,
        3.0,
        17.5,
        20.0,
        709.782712893384,
        710.4758600739439,
        745.1332191019411,
        1e9,
        1_073_741_824.0,
        4_503_599_627_370_497.0,
        9_007_199_254_740_991.0,
        9_007_199_254_740_992.0,
        1e30,
        1e300,
        f64::MAX,
        f64::INFINITY,
    ];
    let neighbours = positive.iter().flat_map(|&v| [v, v.next_up(), v.next_down()]);
    let mut all: Vec<f64> = neighbours.flat_map(|v| [v, -v]).collect();
    all.push(f64::NAN);
    all
}

/// Evenly spaced near zero, all magnitudes, next to the poles, the special
/// ones: a multiple of 8.
fn sweep() -> Vec<f64> {
    let mut all = special();
    all.extend((-20_000..=20_000).map(|i| f64::from(i) * 1.000_123e-3));
    all.extend((-4000..=4000).map(|i| f64::from(i) * 0.187_513));
    for exponent in -1074..=1023 {
        for fraction in [1.0, 1.234_567_89, 1.654_321_01, 1.987_654_321] {
            // In two steps, for 2⁻¹⁰⁷⁴ is not the reciprocal of a double.
            let half = exponent / 2;
            let v = fraction * 2f64.powi(half) * 2f64.powi(exponent - half);
            all.extend([v, -v]);
        }
    }
    for exponent in 1..=53 {
        let small = 2f64.powi(-exponent);
        all.extend([1.0 - small, 1.0 + small, small - 1.0, -1.0 - small]);
    }
    let mut multiple = 1.0;
    while multiple < 1e9 {
        for eighths in [1.0, 2.0, 4.0] {
            let v = multiple * std::f64::consts::FRAC_PI_4 * eighths;
            all.extend([v, v.next_up(), v.next_down(), -v]);
        }
        multiple = (multiple * 1.01 + 1.0).floor();
    }
    all.resize(all.len().next_multiple_of(8), 0.5);
    all
}

/// The pairs of the special ones and many others, a multiple of 8.
fn pairs() -> (Vec<f64>, Vec<f64>) {
    let special = special();
    let mut pairs: Vec<(f64, f64)> = Vec::new();
    for &x in &special {
        pairs.extend(special.iter().map(|&y| (x, y)));
    }
    let some: Vec<f64> = sweep().into_iter().step_by(37).collect();
    for &x in &some {
        pairs.extend(some.iter().step_by(11).map(|&y| (x, y)));
        // Powers that neither overflow nor vanish, and points on all slopes.
        for i in -7..=7 {
            let p = 100.0 * f64::from(i) / x.abs().ln();
            pairs.extend([(x, p), (x, 0.37 * f64::from(i) * x)]);
        }
    }
    pairs.resize(pairs.len().next_multiple_of(8), (0.5, 0.5));
    pairs.into_iter().unzip()
}

#[test]
fn unary_agree_with_std() {
    let arguments = sweep();
    for f in unary_functions() {
        let distance = |&x: &f64| ulps((f.scalar)(x), (f.std)(x));
        let worst = arguments.iter().copied().max_by_key(distance).unwrap();
        println!("{}: {} ulp from std at {worst:e}", f.name, distance(&worst));
        assert!(
            distance(&worst) <= f.ulps,
            "{}({worst:e}) = {:e}, std {:e}",
            f.name,
            (f.scalar)(worst),
            (f.std)(worst)
        );
        // Zeros keep the sign that std gives them.
        for x in special() {
            let (ours, std) = ((f.scalar)(x), (f.std)(x));
            assert!(
                ours.is_nan() || ours.is_sign_negative() == std.is_sign_negative(),
                "{}({x:e}) = {ours:e}, std {std:e}",
                f.name
            );
        }
    }
}

#[test]
fn binary_agree_with_std() {
    let (xs, ys) = pairs();
    for f in binary_functions() {
        let distance = |x, y| ulps((f.scalar)(x, y), (f.std)(x, y));
        let (worst, (&x, &y)) =
            xs.iter().zip(&ys).map(|(x, y)| (distance(*x, *y), (x, y))).max_by_key(|&(d, _)| d).unwrap();
        println!("{}: {worst} ulp from std at {x:e}, {y:e}", f.name);
        assert!(
            worst <= f.ulps,
            "{}({x:e}, {y:e}) = {:e}, std {:e}",
            f.name,
            (f.scalar)(x, y),
            (f.std)(x, y)
        );
        if f.name == "min" || f.name == "max" {
            continue; // Of 0 and −0 either will do.
        }
        for (&x, &y) in xs.iter().zip(&ys) {
            let (ours, std) = ((f.scalar)(x, y), (f.std)(x, y));
            assert!(
                ours.is_nan() || ours.is_sign_negative() == std.is_sign_negative(),
                "{}({x:e}, {y:e}) = {ours:e}, std {std:e}",
                f.name
            );
        }
    }
}

/// Against mpmath, see math/table.py: within 1 ulp of the correctly rounded
/// result, or 2 where so stated.
#[test]
fn agree_with_mpmath() {
    let unary = unary_functions();
    let binary = binary_functions();
    let number = |hex: &str| f64::from_bits(u64::from_str_radix(hex, 16).unwrap());
    let mut worst = std::collections::BTreeMap::new();
    for line in include_str!("math/table.txt").lines() {
        let [name, x, y, expected] = line.split(' ').collect::<Vec<_>>()[..] else {
            panic!("four columns: {line}");
        };
        let (x, y, expected) = (number(x), number(y), number(expected));
        let ours = match unary.iter().find(|f| f.name == name) {
            Some(f) => (f.scalar)(x),
            None => (binary.iter().find(|f| f.name == name).unwrap().scalar)(x, y),
        };
        let distance = ulps(ours, expected);
        let bound = if ["tan", "sinh", "cosh", "tanh", "asinh"].contains(&name) { 2 } else { 1 };
        assert!(distance <= bound, "{name}({x:e}, {y:e}) = {ours:e}, mpmath {expected:e}");
        let entry = worst.entry(name).or_insert((0, 0, 0));
        *entry = (entry.0.max(distance), entry.1 + u64::from(distance > 0), entry.2 + 1);
    }
    for (name, (worst, off, all)) in &worst {
        println!("{name}: {worst} ulp from mpmath; {off} of {all} not correctly rounded");
    }
    assert_eq!(worst.len(), 14);
}

#[test]
fn all_forms_give_the_same_bits() {
    let arguments = sweep();
    let mut out = vec![0.0; arguments.len()];
    for f in unary_functions() {
        for (lanes, set) in f.lanes.iter().zip(["plain", "avx2", "avx512"]) {
            lanes(&mut out, &arguments);
            for (&x, &o) in arguments.iter().zip(&out) {
                assert_eq!(bits(o), bits((f.scalar)(x)), "{} {set} of {x:e}", f.name);
            }
        }
    }
    let (xs, ys) = pairs();
    let mut out = vec![0.0; xs.len()];
    for f in binary_functions() {
        for (lanes, set) in f.lanes.iter().zip(["plain", "avx2", "avx512"]) {
            lanes(&mut out, &xs, &ys);
            for ((&x, &y), &o) in xs.iter().zip(&ys).zip(&out) {
                assert_eq!(bits(o), bits((f.scalar)(x, y)), "{} {set} of {x:e}, {y:e}", f.name);
            }
        }
    }
}

#[test]
fn sin_cos_is_sin_and_cos() {
    let arguments = sweep();
    let (mut sin, mut cos) = (vec![0.0; arguments.len()], vec![0.0; arguments.len()]);
    math::sin_cos_lanes(&mut sin, &mut cos, &arguments);
    for ((&x, &s), &c) in arguments.iter().zip(&sin).zip(&cos) {
        let expected = [math::sin(x), math::cos(x)].map(bits);
        assert_eq!([s, c].map(bits), expected, "lanes of {x:e}");
        let (s, c) = math::sin_cos(x);
        assert_eq!([s, c].map(bits), expected, "{x:e}");
    }
}

/// A far argument must neither be wrong nor disturb the lanes beside it.
#[test]
fn far_arguments_are_redone() {
    let arguments = [0.1, 1e22, -1e300, 2.0, f64::MAX, f64::NAN, f64::INFINITY, 1e9];
    for (lanes, std) in [
        (math::sin_lanes as Lanes, f64::sin as fn(f64) -> f64),
        (math::cos_lanes, f64::cos),
        (math::tan_lanes, f64::tan),
    ] {
        let mut out = [0.0; 8];
        lanes(&mut out, &arguments);
        for (&x, &o) in arguments.iter().zip(&out) {
            assert!(ulps(o, std(x)) <= 1, "{x:e}: {o:e}, std {:e}", std(x));
        }
    }
}

#[test]
fn powi_agrees_with_repeated_products() {
    let arguments: Vec<f64> = sweep().into_iter().step_by(8).collect();
    let arguments = &arguments[..arguments.len() / 8 * 8];
    let mut out = vec![0.0; arguments.len()];
    for n in (-40..=40).chain([i32::MIN, -1001, 1000, i32::MAX]) {
        math::powi_lanes(&mut out, arguments, n);
        for (&x, &o) in arguments.iter().zip(&out) {
            assert_eq!(bits(o), bits(math::powi(x, n)), "lanes of {x:e}^{n}");
            let std = x.powf(f64::from(n));
            if n.abs_diff(0) > 40 || std.is_subnormal() || (n < 0 && std.abs() < 1e-307) {
                continue; // There the positive power overflows, or errors pile up.
            }
            let bound = u64::from(n.unsigned_abs());
            assert!(ulps(o, std) <= bound, "{x:e}^{n} = {o:e}, std {std:e}");
        }
    }
    assert_eq!(math::powi(f64::NAN, 0), 1.0);
    assert_eq!(math::powi(-0.0, -3), f64::NEG_INFINITY);
    assert_eq!(math::powi(-2.0, 3), -8.0);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..Default::default() })]

    #[test]
    fn any_number(x in any::<f64>(), near in -50.0..50.0f64) {
        for f in unary_functions() {
            for x in [x, near] {
                let (ours, std) = ((f.scalar)(x), (f.std)(x));
                prop_assert!(
                    ulps(ours, std) <= f.ulps,
                    "{}({x:e}) = {ours:e}, std {std:e}", f.name
                );
            }
        }
    }

    #[test]
    fn any_two_numbers(
        x in any::<f64>(),
        y in any::<f64>(),
        near in (0.0..50.0f64, -50.0..50.0f64),
    ) {
        for f in binary_functions() {
            for (x, y) in [(x, y), near] {
                let (ours, std) = ((f.scalar)(x, y), (f.std)(x, y));
                prop_assert!(
                    ulps(ours, std) <= f.ulps,
                    "{}({x:e}, {y:e}) = {ours:e}, std {std:e}", f.name
                );
            }
        }
    }
}
