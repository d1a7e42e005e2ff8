//! Gaps in the sampling of records: found where there are some, warned of by fits.

use phugoid::internals::gaps::{gap_warnings, gaps};
use phugoid::{Estimation, Experiment, Model, Parameter};

fn even(n: usize) -> Vec<f64> {
    (0..n).map(|k| 0.04 * k as f64).collect()
}

fn with_gap(mut t: Vec<f64>, after: usize, length: f64) -> Vec<f64> {
    t.iter_mut().skip(after + 1).for_each(|t| *t += length);
    t
}

#[test]
fn an_interval_far_longer_than_those_beside_it_is_a_gap() {
    assert!(gaps(&even(100)).is_empty());
    assert_eq!(gaps(&with_gap(even(100), 50, 30.0)), [50]);
    assert_eq!(gaps(&with_gap(even(100), 0, 30.0)), [0]);
    assert_eq!(gaps(&with_gap(with_gap(even(100), 50, 30.0), 55, 3.0)), [50, 55]);
    assert!(gaps(&with_gap(even(100), 50, 0.3)).is_empty());
    assert!(gaps(&with_gap(even(7), 3, 30.0)).is_empty());
    assert!(gaps(&[]).is_empty() && gaps(&[1.0]).is_empty());
}

#[test]
fn what_is_irregular_by_nature_has_none() {
    let geometric: Vec<f64> = (0..40).map(|k| 1.3f64.powi(k)).collect();
    let bursts: Vec<f64> = (0..60).map(|k| f64::from(k / 5) + 0.01 * f64::from(k % 5)).collect();
    let slower: Vec<f64> =
        (0..80).map(|k| if k < 40 { 0.01 * f64::from(k) } else { f64::from(k - 39) }).collect();
    for t in [geometric, bursts, slower] {
        assert!(gaps(&t).is_empty(), "{t:?}");
    }
}

#[test]
fn a_fit_warns_where_an_input_moves_over_a_gap() {
    let mut m = Model::new("lag");
    let (x, u) = (m.state("x", "").unwrap(), m.input("u", "").unwrap());
    let a = m.parameter(Parameter::new("a", 1.0)).unwrap();
    m.equation("x", a * (u - &x)).unwrap();
    m.output("x", x, "").unwrap();
    let t = with_gap(even(200), 99, 30.0);
    let u: Vec<f64> = t.iter().map(|t| (2.0 * t).sin()).collect();
    let x: Vec<f64> = t.iter().map(|t| (2.0 * t - 0.6).sin() + 1e-3 * (1e4 * t).sin()).collect();
    let run = Experiment::new(&m, "run", t, [("u", u), ("x", x)]).unwrap();
    let fit = Estimation::new(&m, std::slice::from_ref(&run)).solve().unwrap();
    let of_gap = |w: &&String| w.contains("gap");
    let warning = fit.warnings.iter().find(of_gap).expect("a warning");
    for part in ["experiment 'run'", "30.040 from t = 3.960 on (u)", "split the record there"] {
        assert!(warning.contains(part), "{warning}");
    }
    let mut still = run;
    still.inputs[0][80..120].fill(0.5);
    assert!(gap_warnings(&["u"], &[still]).is_empty());
}
