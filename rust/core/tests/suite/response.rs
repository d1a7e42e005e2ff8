//! How a path answers to forces on its equations: forward in time, by the KKT system, and solved again.

use crate::common::models::{known_noise, linear, record};
use crate::common::newton::solve_defects;
use nalgebra::{DMatrix, DVector};
use phugoid::Experiment;
use phugoid::Grid;
use phugoid::collocation::{Collocation, Settings};
use phugoid::internals::diagnosis::{Forward, Linearisation, Outputs, Place, Response};
use phugoid::model::End;
use phugoid::model::{Model, Parameter};
use phugoid::nlp::{ExperimentId, Nlp, PointId, VariableId};

/// Variables of `pendulum`.
const K: VariableId = VariableId(0);
const FORCE: VariableId = VariableId(2);

/// A damped pendulum on which a force acts that is known along time, with the parameter F as its size: ∂h/∂F is how
/// the defects answer to slopes of the force's shape.
fn pendulum() -> Model {
    let mut m = Model::new("pendulum");
    let (x, v) = (m.state("x", "rad").unwrap(), m.state("v", "rad/s").unwrap());
    let [u, bx, bv] = ["u", "bx", "bv"].map(|name| m.input(name, "").unwrap());
    let [k, c, force] =
        [("k", 2.0), ("c", 0.3), ("F", 0.0)].map(|p| m.parameter(Parameter::new(p.0, p.1)).unwrap());
    m.equation("v", -(&k * x.sin()) - &c * &v * &v * &v + &u + &force * &bv).unwrap();
    m.equation("x", &v + &force * &bx).unwrap();
    m.output("x", x.clone(), "").unwrap();
    m.output("a", -(&k * x.sin()) - &c * &v * &v * &v, "").unwrap();
    m
}

fn posed(model: &Model, records: &[Experiment], order: usize, grid: Grid) -> Collocation {
    let settings = Settings::default().order(order).grid(vec![grid]).threads(1);
    Collocation::new(model, records, known_noise(model), &settings).unwrap()
}

/// Samples at irregular times. A grid of equal segments has samples between its points, one of samples has none.
fn records(model: &Model) -> [Experiment; 2] {
    [record(model, "one", 33, false, 1), record(model, "two", 14, false, 2)]
}

/// States at the samples, and the whole point, of each experiment solved alone from (parameters, its initial states).
fn solved(
    model: &Model,
    order: usize,
    grid: &Grid,
    theta: &[f64],
    first: &[[f64; 2]],
) -> (Vec<f64>, Vec<f64>) {
    let (mut states, mut xi) = (Vec::new(), theta.to_vec());
    for (record, first) in records(model).iter().zip(first) {
        let problem = posed(model, std::slice::from_ref(record), order, grid.clone());
        let mut own = theta.to_vec();
        own.extend(first.repeat((problem.n() - theta.len()) / 2));
        solve_defects(&problem, &mut own);
        for point in &problem.meshes[ExperimentId(0)].sample_points {
            states.extend_from_slice(&own[problem.layout.states(PointId(*point))]);
        }
        xi.extend_from_slice(&own[theta.len()..]);
    }
    (states, xi)
}

const THETA: [f64; 3] = [2.0, 0.3, 0.0];
const FIRST: [[f64; 2]; 2] = [[0.4, -0.7], [-0.2, 0.5]];

/// The problem of both records at a point where its defects are nothing, and the slopes of the force.
fn at_rest(model: &Model, order: usize, grid: &Grid) -> (Collocation, Vec<f64>, Vec<f64>) {
    let problem = posed(model, &records(model), order, grid.clone());
    let (_, xi) = solved(&pendulum(), order, grid, &THETA, &FIRST);
    let mut slopes = Vec::new();
    for (mesh, inputs) in problem.meshes.iter().zip(&problem.inputs) {
        slopes.extend((0..mesh.n_mesh).flat_map(|p| [inputs[1][p], inputs[2][p]]));
    }
    (problem, xi, slopes)
}

fn cases() -> [(usize, Grid); 6] {
    let all = |order| [(order, Grid::Samples(1)), (order, Grid::Uniform(9))];
    let [a, b, c] = [2, 3, 4].map(all);
    [a[0].clone(), a[1].clone(), b[0].clone(), b[1].clone(), c[0].clone(), c[1].clone()]
}

/// Difference quotient about 0, extrapolated.
fn quotient(f: impl Fn(f64) -> Vec<f64>) -> Vec<f64> {
    let central = |h: f64| -> Vec<f64> {
        f(h).iter().zip(&f(-h)).map(|(high, low)| (high - low) / (2.0 * h)).collect()
    };
    central(2e-3).iter().zip(&central(1e-3)).map(|(coarse, fine)| (4.0 * fine - coarse) / 3.0).collect()
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let size = b.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    a.iter().zip(b).fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / size
}

#[test]
fn forward_it_is_the_path_solved_again() {
    let model = pendulum();
    for (order, grid) in cases() {
        let (problem, xi, slopes) = at_rest(&model, order, &grid);
        assert_eq!(problem.meshes[ExperimentId(0)].between.is_empty(), matches!(grid, Grid::Samples(_)));
        let forward = Forward::new(&problem, &xi).unwrap().expect("a pendulum that is not unstable");
        let found = &forward.solve(&[&slopes])[0];
        let again = quotient(|force| solved(&model, order, &grid, &[2.0, 0.3, force], &FIRST).0);
        let error = distance(found, &again);
        assert!(error < 1e-9, "order {order}, {grid:?}: off by {error:e}");

        let second = problem.layout.state(problem.layout.first_point[ExperimentId(1)]);
        let tangents = forward.tangents(&[FORCE, K, second + 1, problem.layout.state(PointId(2))]);
        let error = distance(&tangents[0], found);
        assert!(error < 1e-12, "the force as a parameter, order {order}, {grid:?}: off by {error:e}");
        let by_k = quotient(|d| solved(&model, order, &grid, &[2.0 + d, 0.3, 0.0], &FIRST).0);
        let error = distance(&tangents[1], &by_k);
        assert!(error < 1e-9, "a parameter, order {order}, {grid:?}: off by {error:e}");
        let by_state = quotient(|d| solved(&model, order, &grid, &THETA, &[FIRST[0], [-0.2, 0.5 + d]]).0);
        let error = distance(&tangents[2], &by_state);
        assert!(error < 1e-9, "an initial state, order {order}, {grid:?}: off by {error:e}");
        assert!(tangents[3].iter().all(|v| *v == 0.0), "what is no first point moves nothing of its own");
    }
}

/// More right-hand sides than are solved for together.
#[test]
fn each_answer_is_its_own() {
    let model = pendulum();
    let (problem, xi, slopes) = at_rest(&model, 4, &Grid::Uniform(9));
    let forward = Forward::new(&problem, &xi).unwrap().unwrap();
    let many: Vec<Vec<f64>> = (0..37).map(|k| slopes.iter().map(|b| f64::from(k) * b).collect()).collect();
    let found = forward.solve(&many.iter().map(Vec::as_slice).collect::<Vec<_>>());
    let one = &forward.solve(&[&slopes])[0];
    for (k, answer) in found.iter().enumerate() {
        let wanted: Vec<f64> = one.iter().map(|x| k as f64 * x).collect();
        assert!(answer.iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-12 * (1.0 + b.abs())), "{k}");
    }
    assert!(forward.solve(&[]).is_empty());
}

/// A d + ∂h/∂c times how much, relative to the greatest sum of what cancels.
fn left(problem: &Collocation, xi: &[f64], d: &[f64], slopes: Option<&[f64]>) -> f64 {
    let (mut sums, mut sizes) = (vec![0.0; problem.m()], vec![0.0; problem.m()]);
    if let Some(slopes) = slopes {
        problem.forced(slopes, &mut sums);
        sums.iter().zip(&mut sizes).for_each(|(sum, size)| *size = sum.abs());
    }
    let structure = problem.jacobian_structure();
    let mut values = vec![0.0; structure.len()];
    problem.jacobian(xi, &mut values).unwrap();
    for ((&r, &c), v) in structure.rows.iter().zip(&structure.columns).zip(&values) {
        sums[r as usize] += v * d[c as usize];
        sizes[r as usize] += (v * d[c as usize]).abs();
    }
    let size = sizes.iter().fold(0.0f64, |a, v| a.max(*v));
    assert!(size > 1e-6, "nothing was moved");
    sums.iter().fold(0.0f64, |a, v| a.max(v.abs())) / size
}

fn at_samples(problem: &Collocation, d: &[f64]) -> Vec<f64> {
    let mut out = d[..problem.layout.n_theta].to_vec();
    for (mesh, first) in problem.meshes.iter().zip(&problem.layout.first_point) {
        for point in &mesh.sample_points {
            out.extend_from_slice(&d[problem.layout.states(*first + *point)]);
        }
    }
    out
}

/// Tangents by all parameters and initial states of forward: (variables, samples), an orthogonal basis in columns.
fn tangents(problem: &Collocation, forward: &Forward<&Collocation>, wanted: &[VariableId]) -> DMatrix<f64> {
    let n_theta = problem.layout.n_theta;
    let columns: Vec<DVector<f64>> = forward
        .tangents(wanted)
        .iter()
        .zip(wanted)
        .map(|(states, &i)| {
            let theta = (0..n_theta).map(|p| f64::from(p == i.0));
            DVector::from_iterator(n_theta + states.len(), theta.chain(states.iter().copied()))
        })
        .collect();
    DMatrix::from_columns(&columns)
}

/// How far a vector is from the space of columns, relative to its size.
fn beside(columns: &DMatrix<f64>, v: &DVector<f64>) -> f64 {
    let q = columns.clone().qr().q();
    (v - &q * (q.transpose() * v)).norm() / v.norm()
}

#[test]
fn by_the_kkt_system_it_differs_by_tangents_alone() {
    let model = pendulum();
    for (order, grid) in cases() {
        let (problem, xi, slopes) = at_rest(&model, order, &grid);
        let (layout, mut d) = (&problem.layout, vec![0.0; problem.n()]);
        let forward = Forward::new(&problem, &xi).unwrap().unwrap();
        let mut response = Response::new(&problem, &xi, &[FORCE]).unwrap();
        response.forced(&slopes, &mut d);
        let rest = left(&problem, &xi, &d, Some(&slopes));
        assert!(rest < 1e-12, "order {order}, {grid:?}: A d misses -dh/dc by {rest:e}");
        assert_eq!(d[FORCE], 0.0, "what is held does not move");

        let mut own = vec![0.0; layout.n_theta];
        own.extend(&forward.solve(&[&slopes])[0]);
        let difference = DVector::from(at_samples(&problem, &d)) - DVector::from(own);
        let mut wanted = vec![K, K + 1];
        wanted
            .extend(layout.first_point.iter().take(2).flat_map(|p| [layout.state(*p), layout.state(*p) + 1]));
        let space = tangents(&problem, &forward, &wanted);
        let apart = beside(&space, &difference);
        assert!(difference.norm() > 1e-3 && apart < 1e-10, "order {order}, {grid:?}: apart by {apart:e}");

        for i in wanted {
            response.tangent(i, &mut d);
            let rest = left(&problem, &xi, &d, None);
            assert!(rest < 1e-12, "order {order}, {grid:?}: A d = {rest:e} of a tangent along {i:?}");
            let apart = beside(&space, &DVector::from(at_samples(&problem, &d)));
            assert!(apart < 1e-10, "order {order}, {grid:?}: the tangent along {i:?} is apart by {apart:e}");
        }
    }
}

/// Signals that act at a place: the slopes of each, solved for, and what the outputs make of it, in both ways.
#[test]
fn answers_are_outputs_of_the_states() {
    let model = pendulum();
    for (order, grid) in cases() {
        let (problem, xi, _) = at_rest(&model, order, &grid);
        let (layout, k) = (&problem.layout, 21); // more than are solved for together
        let points: usize = problem.meshes.iter().map(|m| m.times.len()).sum();
        let mesh_points: usize = problem.meshes.iter().map(|m| m.n_mesh).sum();
        let samples: usize = problem.meshes.iter().map(|m| m.sample_points.len()).sum();
        let made = |n: usize, f: f64| (0..n).map(|i| (f * (i * i % 97) as f64).sin()).collect::<Vec<_>>();
        let signals = made(k * points, 0.3);
        let (slopes, direct) = (made(mesh_points * 2, 0.7), made(samples, 1.1));
        let (by_state, by_parameter) = (made(samples * 2, 0.9), made(samples * layout.n_theta, 0.2));
        // One output, the first sample of which is missing; rows the other way round.
        let rows: Vec<isize> = (0..samples as isize)
            .map(|s| samples as isize - 1 - s - isize::from(s == 0) * samples as isize)
            .collect();
        let outputs = Outputs { by_state: &by_state, by_parameter: &by_parameter, rows: &rows, n_y: 1 };
        let place = Place { slopes: &slopes, outputs: &direct };
        let (columns, parameters) =
            Linearisation::new(&problem, &xi, &[FORCE]).answers(&outputs, &place, &signals).unwrap();
        assert_eq!((columns.len(), parameters.len()), (k * (samples - 1), k * layout.n_theta));
        assert!(parameters.iter().all(|p| *p == 0.0), "forward in time parameters take no part");
        let forward = Forward::new(&problem, &xi).unwrap().unwrap();
        for (signal, column) in signals.chunks(points).zip(columns.chunks(samples - 1)) {
            let meshes = || problem.meshes.iter().zip(&layout.first_point);
            let at_mesh = meshes().flat_map(|(m, f)| &signal[f.0..f.0 + m.n_mesh]);
            let forced: Vec<f64> =
                at_mesh.zip(slopes.chunks(2)).flat_map(|(s, b)| b.iter().map(move |b| b * s)).collect();
            let states = &forward.solve(&[&forced])[0];
            let at = meshes().flat_map(|(m, f)| m.sample_points.iter().map(move |p| f.0 + p));
            let mut wanted: Vec<f64> = at
                .enumerate()
                .map(|(s, point)| {
                    let moved: f64 =
                        by_state[2 * s..2 * s + 2].iter().zip(&states[2 * s..]).map(|(a, b)| a * b).sum();
                    moved + direct[s] * signal[point]
                })
                .skip(1)
                .collect();
            wanted.reverse();
            let error = distance(column, &wanted);
            assert!(error < 1e-12, "order {order}, {grid:?}: off by {error:e}");
        }
    }
}

/// It is the least in the metric of the Hessian: no tangent shortens it.
#[test]
fn by_the_kkt_system_it_is_the_least() {
    let model = pendulum();
    let (problem, xi, slopes) = at_rest(&model, 3, &Grid::Uniform(9));
    // With F free the answer would be F = -1, and nothing else would move.
    let mut response = Response::new(&problem, &xi, &[FORCE]).unwrap();
    let (mut d, mut tangent) = (vec![0.0; problem.n()], vec![0.0; problem.n()]);
    response.forced(&slopes, &mut d);
    let structure = problem.hessian_structure();
    let mut values = vec![0.0; structure.len()];
    problem.gauss_newton(&xi, 1.0, &mut values).unwrap();
    let product = |a: &[f64], b: &[f64]| -> f64 {
        let entries = structure.rows.iter().zip(&structure.columns).zip(&values);
        entries
            .map(|((&r, &c), v)| {
                let (r, c) = (r as usize, c as usize);
                if r == c { v * a[r] * b[r] } else { v * (a[r] * b[c] + a[c] * b[r]) }
            })
            .sum()
    };
    for i in [
        K,
        K + 1,
        problem.layout.state(PointId(0)),
        problem.layout.state(PointId(problem.meshes[ExperimentId(0)].n_mesh - 1)),
    ] {
        response.tangent(i, &mut tangent);
        let size = (product(&d, &d) * product(&tangent, &tangent)).sqrt();
        let cosine = product(&d, &tangent) / size;
        assert!(size > 0.0 && cosine.abs() < 1e-8, "cosine {cosine:e} with the tangent along {i:?}");
    }
}

#[test]
fn conditions_on_the_beginning_are_met() {
    let mut model = pendulum();
    let k = phugoid::Expr::symbol("k");
    model.condition(End::Initial, "x", 0.2 * &k).unwrap();
    let (problem, _, slopes) = at_rest(&model, 4, &Grid::Uniform(9));
    let (_, xi) = solved(&pendulum(), 4, &Grid::Uniform(9), &THETA, &[[0.4, -0.7], [0.4, 0.5]]);
    let mut residuals = vec![0.0; problem.m()];
    problem.constraints(&xi, &mut residuals).unwrap();
    assert_eq!(problem.m(), problem.layout.m() + 2);
    assert!(residuals.iter().all(|r| r.abs() < 1e-10), "{residuals:?}");

    let forward = Forward::new(&problem, &xi).unwrap().expect("conditions on the beginning are no hindrance");
    let mut response = Response::new(&problem, &xi, &[FORCE]).unwrap();
    let mut d = vec![0.0; problem.n()];
    response.forced(&slopes, &mut d);
    let rest = left(&problem, &xi, &d, Some(&slopes));
    assert!(rest < 1e-12, "A d misses -dh/dc by {rest:e}");
    // Both first angles follow k.
    let first: Vec<VariableId> =
        problem.layout.first_point.iter().take(2).map(|p| problem.layout.state(*p)).collect();
    assert!(d[K].abs() > 1e-6, "the force moves k");
    assert!(first.iter().all(|&i| (d[i] - 0.2 * d[K]).abs() < 1e-12 * d[K].abs().max(1.0)));
    let mut own = vec![0.0; problem.layout.n_theta];
    own.extend(&forward.solve(&[&slopes])[0]);
    let difference = DVector::from(at_samples(&problem, &d)) - DVector::from(own);
    // Directions that meet the conditions: k takes the first angles along, c and the first rates are free.
    let all = tangents(&problem, &forward, &[K, K + 1, first[0], first[0] + 1, first[1], first[1] + 1]);
    let along_k = all.column(0) + 0.2 * (all.column(2) + all.column(4));
    let meeting = [along_k, all.column(1).into(), all.column(3).into(), all.column(5).into()];
    let apart = beside(&DMatrix::from_columns(&meeting), &difference);
    assert!(apart < 1e-10, "apart by {apart:e}");
}

#[test]
fn conditions_on_the_end_are_none_of_forward() {
    for end in [End::Final, End::Periodic] {
        let mut model = pendulum();
        model.condition(end, "x", phugoid::Expr::constant(0.1)).unwrap();
        let (problem, xi, slopes) = at_rest(&model, 4, &Grid::Samples(1));
        assert!(Forward::new(&problem, &xi).unwrap().is_none(), "{end:?}");
        let mut d = vec![0.0; problem.n()];
        Response::new(&problem, &xi, &[]).unwrap().forced(&slopes, &mut d);
        let rest = left(&problem, &xi, &d, Some(&slopes));
        assert!(rest < 1e-12, "{end:?}: A d misses -dh/dc by {rest:e}");
    }
}

/// Short period with a static instability: e-folds in a record decide.
#[test]
fn what_is_too_unstable_is_left_to_the_kkt_system() {
    let model = linear();
    for (mw, stable) in [(0.2, true), (6.0, false)] {
        let record = record(&model, "flight", 60, false, 3);
        let problem = posed(&model, std::slice::from_ref(&record), 4, Grid::Samples(1));
        let mut xi: Vec<f64> = problem.posed.parameters.iter().map(|p| p.start).collect();
        xi[3] = mw;
        // States of a flight under control: what a simulation would give plays no part for a linear system.
        xi.extend((0..(problem.n() - xi.len())).map(|i| 0.5 * (0.37 * i as f64).sin()));
        let forward = Forward::new(&problem, &xi).unwrap();
        assert_eq!(forward.is_some(), stable, "Mw = {mw}");
        let slopes: Vec<f64> =
            (0..2 * problem.meshes[ExperimentId(0)].n_mesh).map(|i| (0.11 * i as f64).cos()).collect();
        let mut d = vec![0.0; problem.n()];
        Response::new(&problem, &xi, &[]).unwrap().forced(&slopes, &mut d);
        let rest = left(&problem, &xi, &d, Some(&slopes));
        assert!(rest < 1e-11, "Mw = {mw}: A d misses -dh/dc by {rest:e}");
        let largest = d.iter().fold(0.0f64, |a, v| a.max(v.abs()));
        assert!(largest < 1e3, "Mw = {mw}: it grows to {largest:e}");
    }
}

#[test]
fn what_is_not_finite_is_said() {
    let (problem, mut xi, _) = at_rest(&pendulum(), 4, &Grid::Samples(1));
    xi[problem.layout.state(PointId(3))] = f64::NAN;
    assert!(Forward::new(&problem, &xi).is_err());
    assert!(Response::new(&problem, &xi, &[]).is_err());
}

/// What was asked before, and in which order, changes no bit.
#[test]
fn one_linearisation_answers_all_questions() {
    // A final condition leaves no way forward in time.
    for at_end in [false, true] {
        let mut model = pendulum();
        if at_end {
            model.condition(End::Final, "x", phugoid::Expr::constant(0.1)).unwrap();
        }
        let (problem, xi, _) = at_rest(&model, 3, &Grid::Samples(1));
        let points: usize = problem.meshes.iter().map(|m| m.times.len()).sum();
        let mesh_points: usize = problem.meshes.iter().map(|m| m.n_mesh).sum();
        let samples: usize = problem.meshes.iter().map(|m| m.sample_points.len()).sum();
        let made = |n: usize, f: f64| (0..n).map(|i| (f * (i * i % 97) as f64).sin()).collect::<Vec<_>>();
        let (signals, direct) = (made(3 * points, 0.3), made(samples, 1.1));
        let (by_state, by_parameter) = (made(samples * 2, 0.9), made(samples * problem.layout.n_theta, 0.2));
        let rows: Vec<isize> = (0..samples as isize).collect();
        let outputs = Outputs { by_state: &by_state, by_parameter: &by_parameter, rows: &rows, n_y: 1 };
        let new = || Linearisation::new(&problem, &xi, &[FORCE]);
        let mut kept = new();
        assert!(kept.is_at(&xi, &[FORCE]) && !kept.is_at(&xi, &[]));
        for f in [0.7, 0.2] {
            let slopes = made(mesh_points * 2, f);
            let place = Place { slopes: &slopes, outputs: &direct };
            let found = kept.answers(&outputs, &place, &signals).unwrap();
            assert_eq!(found, new().answers(&outputs, &place, &signals).unwrap());
            assert_eq!(kept.tangents(&[K, FORCE]).unwrap(), new().tangents(&[K, FORCE]).unwrap());
        }
    }
}
