//! Whatever records and options are given, an estimation or a simulation ends with a result or an error that says what
//! is wrong: never a panic.

use std::time::Duration;

use phugoid::noise::{Joint, NoiseModel, Scale};
use phugoid::shooting::Shots;
use phugoid::shooting::{Integrator, Steps};
use phugoid::solver::Settings;
use phugoid::{
    Density, Dof, Estimation, Experiment, Grid, Interpolation, Model, Parameter, Sigma, Simulation,
};
use phugoid::{Error, Signal};
use proptest::prelude::*;

/// ẋ = a x + b u(t − τ) + √u, y = x (late), w = x².
fn model(delays: bool) -> Model {
    let mut m = Model::new("any");
    let (x, u) = (m.state("x", "m").unwrap(), m.input("u", "V").unwrap());
    let a = m.parameter(Parameter::new("a", -0.5).lower(-5.0).upper(1.0)).unwrap();
    let b = m.parameter(Parameter::new("b", 1.0).local(true)).unwrap();
    let tau = Parameter::new("tau", 0.1).lower(0.0).upper(0.5);
    let mut push = b * &u;
    if delays {
        let tau = m.parameter(tau).unwrap();
        push = push + m.delay(&u, &tau, "late").unwrap();
        m.equation("x", a * &x + push + (&u + 1.0).sqrt()).unwrap();
        m.output("y", x.clone(), "").unwrap();
        m.sensor_delay("y", &tau).unwrap();
    } else {
        m.equation("x", a * &x + push + (&u + 1.0).sqrt()).unwrap();
        m.output("y", x.clone(), "").unwrap();
    }
    m.output("w", &x * &x, "").unwrap();
    m
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        12 => -2.0..2.0f64,
        1 => Just(f64::NAN),
        1 => prop_oneof![Just(f64::INFINITY), Just(f64::NEG_INFINITY), Just(1e300), Just(0.0), Just(-0.0)],
    ]
}

/// Mostly what it should be, `n` long; now and then anything.
fn channel(n: usize) -> impl Strategy<Value = Vec<f64>> {
    prop_oneof![
        8 => prop::collection::vec(-1.0..1.0f64, n),
        2 => prop::collection::vec(number(), n),
        1 => prop::collection::vec(number(), 0..6),
        1 => Just(vec![f64::NAN; n]),
        1 => Just(vec![1.0; n]),
    ]
}

fn times(n: usize) -> impl Strategy<Value = Vec<f64>> {
    let even = move |h: f64| (0..n).map(|k| h * k as f64).collect::<Vec<f64>>();
    prop_oneof![
        8 => (1e-3..2.0f64).prop_map(even),
        1 => prop::collection::vec(number(), n),
        1 => prop::collection::vec(0.0..1.0f64, n).prop_map(|mut t| { t.sort_by(f64::total_cmp); t }),
        1 => Just(vec![0.0; n]),
    ]
}

fn interpolation() -> impl Strategy<Value = Interpolation> {
    prop::sample::select(vec![Interpolation::Linear, Interpolation::Cubic, Interpolation::Hold])
}

fn record() -> impl Strategy<Value = Experiment> {
    let signal = (times(5), channel(5), number(), 0..4usize, prop::option::of(interpolation()));
    let signal = signal.prop_map(|(t, values, delay, derivative, interpolation)| Signal {
        t,
        values,
        delay,
        derivative,
        interpolation,
    });
    let parts = |n| {
        let outputs = prop_oneof![9 => prop::collection::vec(channel(n), 2), 1 => prop::collection::vec(channel(n), 0..4)];
        let inputs = prop_oneof![9 => prop::collection::vec(channel(n), 1), 1 => prop::collection::vec(channel(n), 0..3)];
        (times(n), inputs, outputs)
    };
    let size = prop_oneof![9 => 4..16usize, 1 => 0..4usize];
    let signals =
        prop_oneof![4 => Just(Vec::new()), 1 => prop::collection::vec(prop::option::of(signal), 0..3)];
    (size.prop_flat_map(parts), interpolation(), signals, "[a-f]").prop_map(
        |((t, inputs, outputs), interpolation, signals, name)| Experiment {
            name,
            t,
            inputs,
            outputs,
            interpolation,
            signals,
        },
    )
}

fn grid() -> impl Strategy<Value = Grid> {
    prop_oneof![
        6 => (0..3usize).prop_map(Grid::Samples),
        2 => (0..5usize).prop_map(Grid::Uniform),
        1 => prop::collection::vec(number(), 0..4).prop_map(Grid::Edges),
    ]
}

fn noise() -> impl Strategy<Value = NoiseModel> {
    let scale = prop_oneof![
        3 => (number(), number(), number()).prop_map(|(start, lower, upper)| Scale::from(Sigma::Unknown { start, lower, upper })),
        3 => number().prop_map(Scale::Known),
        2 => (prop::option::of(number()), prop::option::of((number(), number()))).prop_map(|(start, bounds)| Scale::Unknown { start, bounds }),
    ];
    let density =
        prop_oneof![
            Just(Density::Gaussian),
            number().prop_map(Density::Huber),
            number().prop_map(Density::Laplace),
            number().prop_map(|n| Density::StudentT(Dof::Known(n))),
            (number(), number(), number())
                .prop_map(|(start, lower, upper)| Density::StudentT(Dof::Unknown { start, lower, upper })),
        ];
    let joint = prop_oneof![
        6 => Just(Joint::Independent),
        1 => Just(Joint::Unknown),
        1 => prop::collection::vec(number(), 0..6).prop_map(Joint::Known),
    ];
    let name = prop_oneof![4 => Just("y".to_owned()), 1 => Just("z".to_owned())];
    let scales = prop_oneof![3 => Just(Vec::new()), 1 => prop::collection::vec((name.clone(), scale), 0..2)];
    let densities = prop_oneof![3 => Just(Vec::new()), 1 => prop::collection::vec((name, density), 0..2)];
    (scales, densities, joint, any::<bool>()).prop_map(|(scales, densities, joint, per_experiment)| {
        NoiseModel { scales, densities, joint, per_experiment }
    })
}

fn shots() -> impl Strategy<Value = Option<Shots>> {
    let steps = prop_oneof![
        4 => (0..3usize).prop_map(Steps::Samples),
        1 => (0..5usize).prop_map(Steps::Number),
        1 => (0.01..1.0f64).prop_map(Steps::Length),
        1 => prop_oneof![Just(0.0), Just(-1.0), Just(f64::NAN)].prop_map(Steps::Length),
    ];
    let one = (grid(), steps)
        .prop_map(|(grid, steps)| Shots::default().grid(vec![grid]).integrator(Integrator::Rk4).steps(steps));
    prop_oneof![3 => Just(None), 1 => one.prop_map(Some)]
}

/// An error names something; a result has as many numbers as it should.
fn sound(error: &Error) -> bool {
    error.to_string().len() > 10
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 600, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn an_estimation_ends(
        records in prop::collection::vec(record(), 0..3),
        delays in any::<bool>(),
        order in prop_oneof![8 => 2..5usize, 1 => 0..70usize],
        grids in prop_oneof![6 => prop::collection::vec(grid(), 1), 1 => prop::collection::vec(grid(), 0..3)],
        noise in noise(),
        shots in shots(),
        start in prop::option::of((prop_oneof!["a", "b", "x", "tau", "sigma_y", "b\\[a\\]", "q"], number())),
        path in prop::option::of(channel(6)),
        tolerance in prop_oneof![9 => Just(1e-4), 1 => number()],
    ) {
        let model = model(delays);
        let limits = Settings::default().max_iterations(15).tolerance(tolerance).time_limit(Duration::from_secs(5));
        let mut estimation =
            Estimation::new(&model, &records).order(order).grids(grids).threads(1).noise_model(noise).solver(limits);
        if let Some(shots) = shots {
            estimation = estimation.shooting(shots).threads(1);
        }
        if let Some((name, value)) = start {
            estimation = estimation.start(&name, value);
        }
        if let Some(path) = path {
            estimation = estimation.start("x", path);
        }
        match estimation.solve() {
            Err(error) => prop_assert!(sound(&error), "{error:?}"),
            Ok(fit) => {
                prop_assert_eq!(fit.covariance.len(), fit.parameters.len().pow(2));
                prop_assert!(fit.parameters.iter().all(|p| p.value.is_finite()), "{}", fit);
                for (record, run) in fit.records.iter().zip(&records) {
                    prop_assert!(record.t == run.t && record.states[0].len() == run.t.len());
                }
            }
        }
    }

    #[test]
    fn a_simulation_ends(
        record in record(),
        delays in any::<bool>(),
        (a, b, tau) in (number(), number(), number()),
        initial in prop::option::of(number()),
        tolerance in prop_oneof![3 => Just(1e-6), 1 => number()],
    ) {
        let model = model(delays);
        let mut simulation = Simulation::new(&model, &record).parameter("a", a).parameter("b", b).tolerance(tolerance);
        if delays {
            simulation = simulation.parameter("tau", tau);
        }
        if let Some(x) = initial {
            simulation = simulation.initial("x", x);
        }
        match simulation.run() {
            Err(error) => prop_assert!(sound(&error), "{error:?}"),
            Ok(path) => {
                prop_assert_eq!(path.outputs.len(), 2);
                prop_assert!(path.states[0].len() == record.t.len() && path.states[0].iter().all(|x| x.is_finite()));
            }
        }
    }

    /// Any text is a model or an error.
    #[cfg(feature = "serde")]
    #[test]
    fn a_damaged_model_is_refused(cut in 0..3000usize, with in "[ -~]{0,3}", other in prop::option::of(0..3000usize)) {
        let mut m = model(true);
        m.noise = NoiseModel::new().scale("y", Sigma::Known(0.1)).density("w", Density::StudentT(Dof::Known(4.0)));
        let text = m.to_json();
        prop_assert_eq!(Model::from_json(&text).unwrap(), m);
        let (cut, end) = (cut.min(text.len()), other.map_or(cut, |o| o.max(cut)).min(text.len()).max(cut.min(text.len())));
        let damaged = format!("{}{with}{}", &text[..cut], &text[end..]);
        if let Err(error) = Model::from_json(&damaged) {
            prop_assert!(sound(&error), "{error:?}");
        }
    }
}
