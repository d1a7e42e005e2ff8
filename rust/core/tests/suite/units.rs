//! Units of states, in which defects are measured.

use phugoid::nlp::Nlp;
use phugoid::solver::state_units;
use phugoid::{Estimation, Experiment, Model, Parameter, Sigma};

/// x' = v, v' = −k x; x is measured. N samples.
fn oscillator(n: usize) -> (Model, Experiment) {
    let mut m = Model::new("oscillator");
    let (x, v) = (m.state("x", "m").unwrap(), m.state("v", "m/s").unwrap());
    let k = m.parameter(Parameter::new("k", 4.0)).unwrap();
    m.equation("x", v).unwrap();
    m.equation("v", -k * x.clone()).unwrap();
    m.output("y", x, "m").unwrap();
    let t: Vec<f64> = (0..n).map(|i| 0.01 * i as f64).collect();
    let y = t.iter().map(|t| 3.0 * (2.0 * t).cos()).collect();
    let record = Experiment::new(&m, "run", t, [("y", y)]).unwrap();
    (m, record)
}

/// The mean of a constant over many points has rounding errors, which are no motion.
#[test]
fn a_path_that_stands_still_has_its_size_for_unit() {
    let (m, record) = oscillator(20_000);
    let records = [record];
    let (problem, mut xi) = Estimation::new(&m, &records).noise("y", Sigma::Known(0.1)).transcribe().unwrap();
    let border = problem.chains().unwrap().border;
    for constant in [0.1, 0.3, 0.7, 1.0 / 3.0, 1e-20] {
        xi[border..].fill(constant);
        assert_eq!(state_units(&problem, &xi), [constant, constant]);
    }
}

/// A state that nothing measures starts at zero. Its unit is what the motion of the measured one asks for.
#[test]
fn a_path_of_zeros_has_a_unit_from_the_equations() {
    let (m, record) = oscillator(500);
    let records = [record];
    let (problem, xi) = Estimation::new(&m, &records).noise("y", Sigma::Known(0.1)).transcribe().unwrap();
    let units = state_units(&problem, &xi);
    // The mean of |x'| = |6 sin 2t|, within a factor.
    assert!((1.0..12.0).contains(&units[1]), "{units:?}");
}
