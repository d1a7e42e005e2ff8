//! Hundreds of parameters that act jointly in one equation: more pairs of them than 65,536.

use phugoid::collocation::{Collocation, Settings};
use phugoid::expr::Expr;
use phugoid::model::{Model, Parameter};
use phugoid::nlp::{Named, Nlp, VariableId};
use phugoid::noise::{Noise, Sigma};
use phugoid::{Error, ErrorKind, Experiment};

/// ẋ = −x or −x + sin Σ p_i cos(i t), y = x + exp(Σ p_i sin(i t)).
fn model(n: usize, in_dynamics: bool) -> Model {
    let mut m = Model::new("many");
    let x = m.state("x", "").unwrap();
    let time = m.time();
    let p: Vec<Expr> =
        (0..n).map(|i| m.parameter(Parameter::new(&format!("p{i}"), 0.3 / n as f64)).unwrap()).collect();
    let series = |wave: fn(&Expr) -> Expr| {
        let terms = (1..).zip(&p).map(|(i, p)| p * wave(&(i as f64 * &time)));
        terms.reduce(|a, b| a + b).unwrap()
    };
    let joint = series(Expr::cos).sin();
    m.equation("x", if in_dynamics { joint - &x } else { -&x }).unwrap();
    m.output("y", &x + series(Expr::sin).exp(), "").unwrap();
    m
}

fn problem(n: usize, in_dynamics: bool) -> Result<Collocation, Error> {
    let model = model(n, in_dynamics);
    let t: Vec<f64> = (0..5).map(|k| 0.3 * k as f64).collect();
    let y = t.iter().map(|t| 1.0 + t.cos()).collect();
    let run = Experiment::new(&model, "run", t, [("y", y)])?;
    let settings = Settings::default().order(2).threads(1);
    Collocation::new(&model, &[run], Noise::Gaussian(vec![Sigma::Known(0.5)]), &settings)
}

/// The Hessian times a direction in which all variables move, against the change of the Lagrangian's gradient.
fn agrees_with_differences(n: usize, in_dynamics: bool) {
    let p = problem(n, in_dynamics).unwrap();
    let mut random = crate::common::Random(n as u64);
    let mut draw = |k: usize, low, high| -> Vec<f64> { (0..k).map(|_| random.between(low, high)).collect() };
    let mut xi = draw(p.n(), -1.0, 1.0);
    xi[..n].iter_mut().for_each(|v| *v *= 2.0 / n as f64);
    let (direction, lambda) = (draw(p.n(), -1.0, 1.0), draw(p.m(), 0.5, 1.0));

    let mut entries = vec![0.0; p.hessian_structure().len()];
    p.hessian(&xi, 1.0, &lambda, &mut entries).unwrap();
    let mut product = vec![0.0; p.n()];
    let structure = p.hessian_structure();
    for ((&r, &c), h) in structure.rows.iter().zip(&structure.columns).zip(&entries) {
        let (r, c) = (r as usize, c as usize);
        product[r] += h * direction[c];
        if r != c {
            product[c] += h * direction[r];
        }
    }

    let gradient = |step: f64| {
        let at: Vec<f64> = xi.iter().zip(&direction).map(|(x, d)| x + step * d).collect();
        let mut found = vec![0.0; p.n()];
        p.gradient(&at, &mut found).unwrap();
        let mut jacobian = vec![0.0; p.jacobian_structure().len()];
        p.jacobian(&at, &mut jacobian).unwrap();
        let structure = p.jacobian_structure();
        for ((&r, &c), j) in structure.rows.iter().zip(&structure.columns).zip(&jacobian) {
            found[c as usize] += lambda[r as usize] * j;
        }
        found
    };
    let h = 1e-4;
    let [a, b, c, d] = [-2.0, -1.0, 1.0, 2.0].map(|k| gradient(k * h));
    let size = product.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    for i in 0..p.n() {
        let difference = (a[i] - 8.0 * b[i] + 8.0 * c[i] - d[i]) / (12.0 * h);
        let error = (product[i] - difference).abs();
        assert!(
            error < 1e-6 * size,
            "{}: {} by differences {difference}",
            p.variable_name(VariableId(i)),
            product[i]
        );
    }
}

#[test]
fn four_hundred_in_an_output() {
    agrees_with_differences(400, false);
}

#[test]
fn a_thousand_in_an_output() {
    agrees_with_differences(1000, false);
}

#[test]
fn four_hundred_in_a_state_equation_as_well() {
    agrees_with_differences(400, true);
}

#[test]
fn more_than_memory_holds_are_an_error_that_says_what_to_do() {
    let error = problem(3000, false).unwrap_err();
    let text = error.to_string();
    assert!(error.kind() == ErrorKind::Model && text.contains("model 'many'"), "{text}");
    assert!(text.contains("at most 2,047") && text.len() < 2000, "{text}");
}
