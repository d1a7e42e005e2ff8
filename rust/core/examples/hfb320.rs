//! HFB-320 Hansa Jet: longitudinal motion from an elevator 3-2-1-1 and pulse, in Rust alone.
//!
//! The example of the paper: 4 states, 2 inputs, 7 measurements; 11 derivatives, 4 biases, 7 standard
//! deviations and 4 initial states are estimated, from all derivatives and biases 0.
//!
//!     cargo run --release --example hfb320 [hfb320_1_10.asc]

pub mod common;

use std::error::Error;
use std::path::Path;

use phugoid::{Estimation, Experiment, Model, Parameter};

pub const RECORD: &str = "hfb320_1_10.asc";

/// The optimum published with the paper (trapezoid, mesh = sample times), in the order of the model.
pub const PUBLISHED: [(&str, f64); 22] = [
    ("CD0", 0.05802198227121576),
    ("CDV", -0.031609345096558036),
    ("CDa", 0.2453480135927723),
    ("CL0", 0.18081496655016374),
    ("CLV", 0.20117806265996505),
    ("CLa", 3.090429255239013),
    ("Cm0", 0.11836017813192333),
    ("CmV", 0.013661249826858497),
    ("Cma", -0.9940542701262957),
    ("Cmq", -28.651655181649204),
    ("Cmde", -1.471386926974763),
    ("b_q", -0.00010091594526686652),
    ("b_aq", -4.9217064663231145e-06),
    ("b_ax", -0.12084522355941345),
    ("b_az", -0.010969637096449545),
    ("sigma_V", 0.8685280159552249),
    ("sigma_alpha", 0.0022700468575119655),
    ("sigma_theta", 0.002042851155865991),
    ("sigma_q", 0.002463907639197214),
    ("sigma_aq", 0.007884887575017764),
    ("sigma_ax", 0.024723104791353933),
    ("sigma_az", 0.20590254560216117),
];

/// There, without the constant −N n_y/2 ln 2π.
pub const LOG_LIKELIHOOD: f64 = 15055.952975804;

/// The paper's model (section HFB-320 Hansa Jet longitudinal motion).
pub fn model() -> Result<Model, phugoid::Error> {
    let (g0, rho, mass) = (9.80665, 0.792, 7472.0); // m/s², kg/m³, kg
    let (s_m, sc_iy) = (4.028e-3, 8.0027e-4); // wing area over mass, m²/kg; area × chord over inertia, m/kg
    let lt_iy = -7.0153e-6; // thrust arm over inertia, 1/(kg m)
    let (v_ref, half_chord, eps_t) = (104.67, 1.215, 0.0524_f64); // m/s, m, rad

    let mut m = Model::new("HFB-320 longitudinal");
    let (speed, alpha) = (m.state("V", "m/s")?, m.state("alpha", "rad")?);
    let (theta, q) = (m.state("theta", "rad")?, m.state("q", "rad/s")?);
    let (de, thrust) = (m.input("de", "rad")?, m.input("T", "N")?);
    let mut p = |name| m.parameter(Parameter::new(name, 0.0));
    let (cd0, cdv, cda, cl0, clv, cla) = (p("CD0")?, p("CDV")?, p("CDa")?, p("CL0")?, p("CLV")?, p("CLa")?);
    let (cm0, cmv, cma, cmq, cmde) = (p("Cm0")?, p("CmV")?, p("Cma")?, p("Cmq")?, p("Cmde")?);
    let (b_q, b_aq, b_ax, b_az) = (p("b_q")?, p("b_aq")?, p("b_ax")?, p("b_az")?);

    let dv = &speed / v_ref - 1.0;
    let cd = m.quantity("CD", cd0 + cdv * &dv + cda * &alpha)?;
    let cl = m.quantity("CL", cl0 + clv * &dv + cla * &alpha)?;
    // The paper prints the pitch rate as q c/(2 V); its published optimum was found with q c/(2 Vref).
    let cm = cm0 + cmv * &dv + cma * &alpha + cmq * (half_chord / v_ref) * &q + cmde * de;
    let cm = m.quantity("Cm", cm)?;

    let pressure = 0.5 * rho * speed.pow(2.0);
    let lift = s_m * &pressure * cl;
    let drag = s_m * &pressure * cd;
    let gamma = &theta - &alpha;
    let pull = &thrust / mass;
    let q_dot = sc_iy * pressure * cm + lt_iy * &thrust;
    m.equation("V", &pull * (&alpha + eps_t).cos() - &drag - g0 * gamma.sin())?;
    m.equation("alpha", (g0 * gamma.cos() - &lift - &pull * (&alpha + eps_t).sin()) / &speed + &q)?;
    m.equation("theta", q.clone())?;
    m.equation("q", q_dot.clone())?;

    let (sin, cos) = (alpha.sin(), alpha.cos());
    m.output("V", speed, "")?;
    m.output("alpha", alpha, "")?;
    m.output("theta", theta, "")?;
    m.output("q", q + b_q, "rad/s")?;
    m.output("aq", q_dot + b_aq, "rad/s²")?;
    m.output("ax", &lift * &sin - &drag * &cos + &pull * eps_t.cos() + b_ax, "m/s²")?;
    m.output("az", -(lift * cos + drag * sin) - pull * eps_t.sin() + b_az, "m/s²")?;
    Ok(m)
}

/// The flight record.
pub fn experiment(model: &Model, path: &Path) -> Result<Experiment, Box<dyn Error>> {
    let columns = common::columns(path)?;
    // The file rounds its last stamp to 60.00002 s; the sampling is 10 Hz throughout.
    let t = (0..columns[0].len()).map(|k| 0.1 * k as f64).collect();
    let names = [
        ("de", 1),
        ("T", 3),
        ("V", 4),
        ("alpha", 5),
        ("theta", 6),
        ("q", 7),
        ("aq", 8),
        ("ax", 9),
        ("az", 10),
    ];
    let channels = names.map(|(name, column)| (name, columns[column].clone()));
    Ok(Experiment::new(model, "HFB-320 flight", t, channels)?)
}

/// A simulated record of the same shape with n samples in 60 s: elevator 3-2-1-1 and pulse, constant
/// thrust, the published noise.
pub fn twin(model: &Model, n: usize, seed: u64) -> Result<Experiment, phugoid::Error> {
    let step = 60.0 / (n - 1) as f64;
    let t: Vec<f64> = (0..n).map(|k| step * k as f64).collect();
    let pulses = [(2.0, 5.0, 1.0), (5.0, 7.0, -1.0), (7.0, 8.0, 1.0), (8.0, 9.0, -1.0), (25.0, 27.0, 1.0)];
    let elevator = |t: f64| {
        let inside = pulses.iter().find(|p| p.0 <= t && t < p.1);
        -0.008 + 0.012 * inside.map_or(0.0, |p| p.2)
    };
    let de: Vec<f64> = t.iter().map(|t| elevator(*t)).collect();
    let at = |now: f64, _: &[f64]| {
        let k = ((now / step) as usize).min(n - 2);
        vec![de[k] + (de[k + 1] - de[k]) * (now / step - k as f64), 11500.0]
    };
    let values = PUBLISHED.map(|p| p.1);
    let (parameters, sigmas) = values.split_at(15);
    let steps = (6000 / n).max(1);
    let states = common::simulate(model, parameters, &t, &[106.0, 0.112, 0.104, -0.003], steps, at)?;
    let inputs = vec![de.clone(), vec![11500.0; n]];
    let outputs = common::measure(model, parameters, &t, &inputs, &states, sigmas, seed)?;
    let interpolation = phugoid::Interpolation::Linear;
    Ok(Experiment {
        name: "HFB-320 simulated twin".into(),
        t,
        inputs,
        outputs,
        interpolation,
        signals: Vec::new(),
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let model = model()?;
    let path = common::argument_or_find(RECORD);
    let record = match &path {
        Some(path) => experiment(&model, path)?,
        None => twin(&model, 601, 0)?,
    };
    let fit = Estimation::new(&model, &[record]).order(2).solve()?;
    println!("{fit}");
    common::compare(&fit, &PUBLISHED);
    if path.is_some() {
        println!("\nlog-likelihood {:.9}, published {LOG_LIKELIHOOD:.9}", fit.log_likelihood);
    }
    Ok(())
}
