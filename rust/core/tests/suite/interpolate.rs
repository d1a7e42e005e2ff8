//! Interpolation of inputs between their samples.

use phugoid::internals::interpolate::{Interpolation, interpolate};
use proptest::prelude::*;

const BOTH: [Interpolation; 2] = [Interpolation::Linear, Interpolation::Cubic];
const T: [f64; 8] = [0.0, 0.3, 0.4, 1.1, 1.15, 2.0, 3.5, 3.6];
const V: [f64; 8] = [1.0, -0.5, 0.25, 2.0, 1.75, -1.0, 0.5, 0.0];

fn close(found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len());
    for (f, e) in found.iter().zip(expected) {
        assert!((f - e).abs() <= tolerance, "{f} != {e}");
    }
}

/// Expected values by scipy 1.17.1, `CubicSpline(t, v)(at)`.
#[test]
fn cubic_agrees_with_scipy() {
    let at = [3.55, 0.1, 0.35, 0.7, 1.12, 1.6, 2.9, 0.001, 2.0];
    let expected = [
        0.2702999490811164,
        -0.5580484022828996,
        -0.13997210800041066,
        2.033999251795085,
        1.9038245443412949,
        -0.24669363646909384,
        0.8592888380228154,
        0.9770457320932079,
        -1.0,
    ];
    close(&interpolate(Interpolation::Cubic, &T, &V, &at), &expected, 1e-14);

    let t: Vec<f64> = (0..101).map(|i| i as f64 / 10.0).collect();
    let v: Vec<f64> = t.iter().map(|t| t.sin()).collect();
    close(
        &interpolate(Interpolation::Cubic, &t, &v, &[0.05, 3.333, 9.99]),
        &[0.0499794403372131, -0.1902406819546822, -0.5356040060596691],
        1e-14,
    );
}

/// scipy takes the line through 2 samples and the parabola through 3.
#[test]
fn cubic_of_few_samples() {
    let cubic = |t: &[f64], v: &[f64], at: &[f64]| interpolate(Interpolation::Cubic, t, v, at);
    close(&cubic(&[5.0], &[3.0], &[4.0, 5.0, 6.0]), &[3.0; 3], 0.0);
    close(&cubic(&[0.0, 2.0], &[1.0, 2.0], &[0.5, 1.5]), &[1.25, 1.75], 1e-15);
    close(
        &cubic(&[0.0, 1.0, 3.0], &[1.0, 2.0, -1.0], &[0.5, 2.0]),
        &[1.7083333333333335, 1.3333333333333333],
        1e-15,
    );
    close(
        &cubic(&[0.0, 1.0, 1.5, 4.0], &[1.0, 2.0, -1.0, 3.0], &[0.25, 1.2, 3.0]),
        &[2.546875, 0.9504, -7.8],
        5e-14,
    );
}

#[test]
fn linear_by_hand() {
    let found = interpolate(Interpolation::Linear, &T, &V, &[2.75, 0.15, 0.75]);
    close(&found, &[-0.25, 0.25, 1.125], 1e-15);
}

#[test]
fn samples_are_reproduced_bit_for_bit() {
    for kind in BOTH {
        assert_eq!(interpolate(kind, &T, &V, &T), V);
        let backwards: Vec<f64> = T.iter().rev().copied().collect();
        let expected: Vec<f64> = V.iter().rev().copied().collect();
        assert_eq!(interpolate(kind, &T, &V, &backwards), expected);
    }
}

#[test]
fn end_values_are_held_outside() {
    let at = [-1e9, -f64::EPSILON, 3.6 + 1e-15, 1e9, f64::INFINITY];
    for kind in BOTH {
        assert_eq!(interpolate(kind, &T, &V, &at), [1.0, 1.0, 0.0, 0.0, 0.0]);
    }
}

#[test]
fn nan_times_give_nan_and_no_times_nothing() {
    for kind in BOTH {
        assert!(interpolate(kind, &T, &V, &[f64::NAN])[0].is_nan());
        assert!(interpolate(kind, &T, &V, &[]).is_empty());
    }
}

#[cfg(feature = "serde")]
#[test]
fn kinds_are_named_in_lower_case() {
    let text = serde_json::to_string(&BOTH).unwrap();
    assert_eq!(text, r#"["linear","cubic"]"#);
    assert_eq!(serde_json::from_str::<[Interpolation; 2]>(&text).unwrap(), BOTH);
}

#[test]
#[should_panic(expected = "as many sample times as sample values")]
fn lengths_must_agree() {
    interpolate(Interpolation::Linear, &T, &V[1..], &[0.0]);
}

proptest! {
    /// The not-a-knot spline of a cubic is that cubic, at any spacing.
    #[test]
    fn cubics_are_reproduced(
        steps in prop::collection::vec(0.05..2.0_f64, 3..30),
        c in prop::array::uniform4(-1.0..1.0_f64),
        fraction in 0.0..1.0_f64,
    ) {
        let mut t = vec![0.0];
        steps.iter().for_each(|step| t.push(t[t.len() - 1] + step));
        let end = t[t.len() - 1];
        let cubic = |t: f64| {
            let s = t / end;
            c[0] + s * (c[1] + s * (c[2] + s * c[3]))
        };
        let v: Vec<f64> = t.iter().map(|&t| cubic(t)).collect();
        let found = interpolate(Interpolation::Cubic, &t, &v, &[fraction * end])[0];
        prop_assert!((found - cubic(fraction * end)).abs() < 1e-12);
    }

    /// Lines stay between their two samples.
    #[test]
    fn linear_stays_within_its_samples(fraction in 0.0..1.0_f64) {
        let at = fraction * 3.6;
        let i = T.partition_point(|&t| t <= at).min(7);
        let found = interpolate(Interpolation::Linear, &T, &V, &[at])[0];
        prop_assert!(found >= V[i - 1].min(V[i]) - 1e-15 && found <= V[i - 1].max(V[i]) + 1e-15);
    }
}
