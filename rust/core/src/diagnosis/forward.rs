//! The linearised equations solved forward in time, for many right-hand sides at once.

use std::ops::Deref;

use nalgebra::{DMatrix, Dyn, LU};

use crate::collocation::Collocation;
use crate::index::{ConstraintId, ExperimentId, PointId, StateId, VariableId};
use crate::interrupt::{Interrupt, current};
use crate::nlp::{Nlp, NotFinite};
use crate::problem::layout::{ConstraintPlace, Place};
use crate::simd::kernel;
use crate::solver::state_units;
use crate::threads::Threads;
use crate::threads::prelude::*;

/// Initial states may grow by this factor, in units of what the states do: digits that a later projection loses.
const GROWTH: f64 = 1e6;

/// Operations of a segment for each right-hand side, about: what is between two looks at the clock follows from it.
const OPERATIONS: usize = 1 << 6;

/// Right-hand sides that are solved for together: their path stays in the cache.
pub(super) const AT_ONCE: usize = 16;

/// A number for each of them.
pub(super) type Lanes = [f64; AT_ONCE];

/// The points of samples between mesh points, and derivatives by the states at all points of the segment.
type Between = Vec<(usize, DMatrix<f64>)>;

/// The derivative of a constraint by a parameter.
struct ByParameter {
    /// Row within the segment, or among the samples between mesh points.
    row: usize,
    parameter: VariableId,
    value: f64,
}

/// One segment: the constraints of its points, and of the samples between them.
struct Step {
    /// Factors of the derivatives by the states at all its points but the first.
    own: LU<f64, Dyn, Dyn>,
    /// Derivatives by the states at its first point.
    first: DMatrix<f64>,
    parameters: Vec<ByParameter>,
    /// For each sample between: its point, and derivatives by the states at all points of the segment.
    between: Vec<(usize, DMatrix<f64>)>,
    /// Its first point within the experiment.
    point: usize,
    /// The map from states at the first point and slopes at all points to states at the others, row by row; at the
    /// last point alone where no sample asks for those between.
    map: Vec<f64>,
}

/// ∂h/∂x of a collocation problem, segment by segment. `P` is how it has the problem: borrowed, or shared.
pub struct Forward<P> {
    problem: P,
    steps: Vec<Vec<Step>>,
    /// Derivatives of the constraints of samples between mesh points by parameters, as in a step, one list an
    /// experiment.
    of_ties: Vec<Vec<ByParameter>>,
}

impl<P: Deref<Target = Collocation> + Sync> Forward<P> {
    /// Linearises at ξ; `None` where the motion is so unstable that a solution forward in time loses its digits, or
    /// where there are conditions on the ends of the records. Conditions on their beginnings are left to the caller.
    ///
    /// # Errors
    /// [`NotFinite`] when a derivative is not finite there, a segment is singular, or the interrupt in force stops it.
    pub fn new(problem: P, xi: &[f64]) -> Result<Option<Self>, NotFinite> {
        if problem.has_conditions_at_ends() {
            return Ok(None);
        }
        let mut values = vec![0.0; problem.jacobian_structure().len()];
        problem.jacobian(xi, &mut values)?;
        let layout = &problem.layout;
        let n = layout.n_x;
        let mut blocks: Vec<Vec<[DMatrix<f64>; 2]>> = Vec::new();
        let mut between: Vec<Vec<Between>> = Vec::new();
        let mut parameters: Vec<Vec<Vec<ByParameter>>> = Vec::new();
        let mut of_ties: Vec<Vec<ByParameter>> = problem.meshes.iter().map(|_| Vec::new()).collect();
        for mesh in &problem.meshes {
            let k = mesh.rule.order() - 1;
            let empty = || [DMatrix::zeros(k * n, n), DMatrix::zeros(k * n, k * n)];
            blocks.push(mesh.segments.iter().map(|_| empty()).collect());
            let mut ties: Vec<Vec<(usize, DMatrix<f64>)>> = vec![Vec::new(); mesh.segments.len()];
            for tie in &mesh.between {
                ties[tie.segment].push((tie.point, DMatrix::zeros(n, (k + 1) * n)));
            }
            between.push(ties);
            parameters.push(mesh.segments.iter().map(|_| Vec::new()).collect());
        }
        let structure = problem.jacobian_structure();
        for ((&r, &c), v) in structure.rows.iter().zip(&structure.columns).zip(&values) {
            if r as usize >= layout.m() {
                continue;
            }
            let ConstraintPlace { experiment, row, state: StateId(state) } =
                layout.constraint(ConstraintId(r as usize));
            let (mesh, e, k) =
                (&problem.meshes[experiment], experiment.0, problem.meshes[experiment].rule.order() - 1);
            let Place::State { point, state: StateId(column), .. } = layout.place(VariableId(c as usize))
            else {
                let parameter = VariableId(c as usize);
                if row + 1 < mesh.n_mesh {
                    let row_of_segment = row % k * n + state;
                    parameters[e][row / k].push(ByParameter { row: row_of_segment, parameter, value: *v });
                } else {
                    let tie = row + 1 - mesh.n_mesh;
                    of_ties[e].push(ByParameter { row: tie * n + state, parameter, value: *v });
                }
                continue;
            };
            if row + 1 < mesh.n_mesh {
                let (segment, inner) = (row / k, row % k);
                let at = point - mesh.segments[segment].point;
                let [first, own] = &mut blocks[e][segment];
                match at {
                    0 => first[(inner * n + state, column)] += v,
                    _ => own[(inner * n + state, (at - 1) * n + column)] += v,
                }
            } else {
                let tie = &mesh.between[row + 1 - mesh.n_mesh];
                if point != tie.point {
                    let at = point - mesh.segments[tie.segment].point;
                    let ties = &mut between[e][tie.segment];
                    let (_, block) = ties.iter_mut().find(|t| t.0 == tie.point).expect("its own segment's");
                    block[(state, at * n + column)] += v;
                }
            }
        }
        let mut steps = Vec::new();
        let mut turns = current().turns(OPERATIONS * n * n);
        let each = problem.meshes.iter().zip(blocks).zip(between).zip(parameters);
        for (((mesh, blocks), between), parameters) in each {
            let each = mesh.segments.iter().zip(blocks).zip(between).zip(parameters);
            let k = mesh.rule.order() - 1;
            let mut inner = vec![false; mesh.segments.len()];
            for &point in mesh.sample_points.iter().filter(|&&p| p < mesh.n_mesh && p % k != 0) {
                inner[point / k] = true;
            }
            let step = each.zip(inner).map(|((((segment, [first, own]), between), parameters), inner)| {
                if turns.stop() {
                    return Err(NotFinite);
                }
                let own: DMatrix<f64> = own;
                let mut step =
                    Step { own: own.lu(), first, parameters, between, point: segment.point, map: Vec::new() };
                let mut map = DMatrix::zeros(k * n, (k + 2) * n);
                map.columns_mut(0, n).copy_from(&-&step.first);
                for (i, j, r) in
                    (0..k).flat_map(|i| (0..=k).flat_map(move |j| (0..n).map(move |r| (i, j, r))))
                {
                    map[(i * n + r, (j + 1) * n + r)] = segment.h * mesh.rule.c(j, i);
                }
                step.own.solve_mut(&mut map);
                let whole = inner || !step.between.is_empty();
                let skipped = if whole { 0 } else { (k - 1) * n };
                step.map = map.rows_range(skipped..).transpose().as_slice().to_vec();
                Ok(step)
            });
            steps.push(step.collect::<Result<Vec<_>, _>>()?);
        }
        let units = state_units(&*problem, xi);
        let forward = Forward { problem, steps, of_ties };
        if forward.steps.iter().flatten().any(|s| !s.own.is_invertible()) {
            return Err(NotFinite);
        }
        Ok((forward.growth(&units) < GROWTH).then_some(forward))
    }

    /// Returns the growth of initial states of the size of the states' units, in these units.
    fn growth(&self, units: &[f64]) -> f64 {
        let n = self.problem.layout.n_x;
        let unit = |r: usize| units.get(r).copied().unwrap_or(1.0);
        let mut most: f64 = 1.0;
        for steps in &self.steps {
            let mut x = DMatrix::from_fn(n, n, |r, c| if r == c { unit(r) } else { 0.0 });
            for step in steps {
                let mut y = -(&step.first * &x);
                step.own.solve_mut(&mut y);
                x = y.rows(y.nrows() - n, n).into_owned();
                for (r, row) in x.row_iter().enumerate() {
                    most = row.iter().fold(most, |m, v| m.max(v.abs() / unit(r)));
                }
                if !most.is_finite() {
                    return f64::INFINITY;
                }
            }
        }
        most
    }

    /// States at the samples, `out[k][sample · n_x + state]` of all experiments after each other, in response
    /// to slopes added to f, (k, points · n_x), with initial states and parameters fixed. They are invalid where the
    /// interrupt in force stopped it.
    pub fn solve(&self, slopes: &[&[f64]]) -> Vec<Vec<f64>> {
        let n = self.problem.layout.n_x;
        let interrupt = current();
        let some = |slopes: &[&[f64]]| {
            let states = self.states(&interrupt, |mesh_point, _, given| {
                for (c, slope) in slopes.iter().enumerate() {
                    given.iter_mut().zip(&slope[mesh_point * n..]).for_each(|(g, b)| g[c] = *b);
                }
            });
            (0..slopes.len()).map(|c| states.iter().map(|x| x[c]).collect()).collect::<Vec<_>>()
        };
        Threads::default().install(|| slopes.par_chunks(AT_ONCE).flat_map_iter(some).collect())
    }

    /// Computes the states of a few columns, side by side, [sample · n_x + state]. `slopes` gives those of the points
    /// from one on: its place among all mesh points, and among all points. They are invalid where the interrupt
    /// stopped it.
    pub(super) fn states(
        &self,
        interrupt: &Interrupt,
        slopes: impl Fn(usize, PointId, &mut [Lanes]),
    ) -> Vec<Lanes> {
        let layout = &self.problem.layout;
        let n = layout.n_x;
        let samples: usize = self.problem.meshes.iter().map(|m| m.sample_points.len()).sum();
        let mut out = Vec::with_capacity(samples * n);
        let mut turns = interrupt.turns(OPERATIONS * n * AT_ONCE);
        let mut begin = 0; // mesh point of the experiment among all
        for ((mesh, steps), first) in self.problem.meshes.iter().zip(&self.steps).zip(&layout.first_point) {
            let k = mesh.rule.order() - 1;
            let mut path = vec![[0.0; AT_ONCE]; mesh.times.len() * n];
            let mut given = vec![[0.0; AT_ONCE]; (k + 2) * n]; // states at the first point, slopes at all
            let mut ties = mesh.between.iter();
            for step in steps {
                if turns.stop() {
                    break;
                }
                given[..n].copy_from_slice(&path[step.point * n..][..n]);
                slopes(begin + step.point, *first + step.point, &mut given[n..]);
                let end = (step.point + k + 1) * n;
                let rows = step.map.len() / given.len();
                combined(&step.map, &given, &mut path[end - rows..end]);
                for ((point, block), tie) in step.between.iter().zip(&mut ties) {
                    // The states of all points of the segment, and what the slopes add.
                    let weights = (0..n).flat_map(|r| {
                        let states = block.row(r).iter().map(|v| -v).collect::<Vec<_>>();
                        let slopes = tie
                            .weights
                            .iter()
                            .flat_map(move |w| (0..n).map(move |i| if i == r { *w } else { 0.0 }));
                        states.into_iter().chain(slopes)
                    });
                    let known: Vec<_> =
                        path[step.point * n..end].iter().chain(&given[n..]).copied().collect();
                    let mut x = vec![[0.0; AT_ONCE]; n];
                    combined(&weights.collect::<Vec<_>>(), &known, &mut x);
                    path[point * n..][..n].copy_from_slice(&x);
                }
            }
            for point in &mesh.sample_points {
                out.extend_from_slice(&path[point * n..][..n]);
            }
            begin += mesh.n_mesh;
        }
        out
    }

    /// Returns the responses to variables that move by 1: parameters, or states at a first point (all others give
    /// nothing). They are invalid where the interrupt in force stopped it.
    pub fn tangents(&self, variables: &[VariableId]) -> Vec<Vec<f64>> {
        let layout = &self.problem.layout;
        let (n, theta) = (layout.n_x, layout.n_theta);
        let first =
            |e, r: usize, c: usize| f64::from(variables[c] == layout.state(layout.first_point[e]) + r);
        let column = |v: VariableId| variables.iter().position(|&i| i == v && v.0 < theta);
        let force = |e: usize, _: usize, step: usize, y: &mut DMatrix<f64>| {
            for by in &self.steps[e][step].parameters {
                if let Some(c) = column(by.parameter) {
                    y[(by.row, c)] -= by.value;
                }
            }
        };
        let tied = |e: usize, _: usize, tie: usize, x: &mut DMatrix<f64>| {
            for by in self.of_ties[e].iter().filter(|by| by.row / n == tie) {
                if let Some(c) = column(by.parameter) {
                    x[(by.row % n, c)] -= by.value;
                }
            }
        };
        self.march(variables.len(), first, force, tied)
    }

    /// Goes from the initial states of each experiment through its segments: `force` adds the right-hand sides of one,
    /// `tied` those of a sample between mesh points.
    fn march(
        &self,
        columns: usize,
        first: impl Fn(ExperimentId, usize, usize) -> f64,
        force: impl Fn(usize, usize, usize, &mut DMatrix<f64>),
        tied: impl Fn(usize, usize, usize, &mut DMatrix<f64>),
    ) -> Vec<Vec<f64>> {
        let n = self.problem.layout.n_x;
        let samples: usize = self.problem.meshes.iter().map(|m| m.sample_points.len()).sum();
        let mut out = vec![Vec::with_capacity(samples * n); columns];
        let mut turns = current().turns(OPERATIONS * n * columns);
        let mut begin = 0; // mesh point of the experiment among all
        for (e, (mesh, steps)) in self.problem.meshes.iter().zip(&self.steps).enumerate() {
            let k = mesh.rule.order() - 1;
            // States at all points, a column for each right-hand side.
            let mut path = DMatrix::<f64>::zeros(mesh.times.len() * n, columns);
            path.rows_mut(0, n).copy_from(&DMatrix::from_fn(n, columns, |r, c| first(ExperimentId(e), r, c)));
            let mut tie = 0;
            for (i, step) in steps.iter().enumerate() {
                if turns.stop() {
                    break;
                }
                let mut y = DMatrix::<f64>::zeros(k * n, columns);
                force(e, begin, i, &mut y);
                y.gemm(-1.0, &step.first, &path.rows(step.point * n, n), 1.0);
                step.own.solve_mut(&mut y);
                path.rows_mut((step.point + 1) * n, k * n).copy_from(&y);
                for (point, block) in &step.between {
                    let mut x = -(block * path.rows(step.point * n, (k + 1) * n));
                    tied(e, begin, tie, &mut x);
                    path.rows_mut(point * n, n).copy_from(&x);
                    tie += 1;
                }
            }
            for (c, column) in path.column_iter().enumerate() {
                for point in &mesh.sample_points {
                    out[c].extend(column.rows(point * n, n).iter());
                }
            }
            begin += mesh.n_mesh;
        }
        out
    }
}

kernel! {
    /// Linear combinations, one a row of `map`, of what is given, for all right-hand sides.
    fn combined(map: &[f64], given: &[Lanes], out: &mut [Lanes]) {
        for (row, out) in map.chunks_exact(given.len()).zip(out) {
            let mut sum = [0.0; AT_ONCE];
            for (m, given) in row.iter().zip(given) {
                for (s, g) in sum.iter_mut().zip(given) {
                    *s = m.mul_add(*g, *s);
                }
            }
            *out = sum;
        }
    }
}
