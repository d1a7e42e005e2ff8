//! How exactly a path of the states solves its differential equations: the integration error of each segment.

use nalgebra::{DMatrix, DVector};

use super::Transcription;
use super::fit::{Fit, Record};
use super::print::short;
use crate::dense::largest;
use crate::error::Error;
use crate::evaluator::at_points;
use crate::experiment::Experiment;
use crate::lgl::Lgl;
use crate::model::Model;
use crate::noise::{SIGMA, Scale};
use crate::tape::{Inputs, Tape};

/// Nodes of the finer rule beyond those of the segment; two more for every sample inside it, up to a limit.
const MORE: usize = 5;
const MOST: usize = 24;
/// No scale is smaller than this part of how far the state moves; a state that is not measured counts as measured to so
/// much of that.
const FLOOR: f64 = 1e-6;
const UNMEASURED: f64 = 1e-2;
/// Errors of a segment below this, in units of the noise, are small beside it.
const COARSE: f64 = 0.1;
/// Begins the warnings of a mesh that is too coarse.
pub(super) const COARSE_MESH: &str = "the mesh is coarse";
/// The same of all segments together: the noise that a fit finds has what they add up to within it.
const ACCUMULATED: f64 = 0.1;
/// Points that are evaluated at a time.
const CHUNK: usize = 4096;
/// Most sweeps of Picard's iteration, and the change after which they end.
const SWEEPS: usize = 12;
const SETTLED: f64 = 1e-4;
/// Times closer than this part of a segment are the same.
const SAME: f64 = 1e-9;

/// The error that each of S segments of one experiment adds to the path.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct IntegrationError {
    /// Name of the experiment.
    pub name: String,
    /// Ends of the segments, s, S + 1 of them.
    pub edges: Vec<f64>,
    /// n_x states of S segments: how far, at most, the collocation polynomial departs within the segment from the exact
    /// solution through its first point, in the unit of the state. Infinite where that cannot be computed.
    pub errors: Vec<Vec<f64>>,
    /// For each state what is small for it: the standard deviation of the noise of its measurement; one hundredth of the
    /// standard deviation of its path where it is not measured; at least 1e-6 of that.
    pub scales: Vec<f64>,
}

impl IntegrationError {
    /// Returns the largest error of any state in each segment, in units of its scale.
    pub fn worst(&self) -> Vec<f64> {
        let relative = |s: usize| self.errors.iter().zip(&self.scales).map(move |(e, scale)| e[s] / scale);
        (0..self.edges.len() - 1).map(|s| relative(s).fold(0.0, f64::max)).collect()
    }
}

/// Holds what polynomials neglect of a path, in units of the noise.
#[derive(Clone, Copy, Debug, Default)]
struct Neglected {
    largest: f64,
    sum: f64,
}

/// A path that collocation of an order left in an experiment.
#[derive(Clone, Copy, Debug)]
pub struct CollocatedPath<'a> {
    /// The model, without delays.
    pub model: &'a Model,
    /// The experiment, whose inputs act.
    pub experiment: &'a Experiment,
    /// Parameters of the model in this experiment.
    pub parameters: &'a [f64],
    /// The standard deviation of each output's noise, where there is one.
    pub sigmas: &'a [Option<f64>],
    /// Points of a segment.
    pub order: usize,
    /// Times of the mesh points, s.
    pub t: &'a [f64],
    /// n_x states there.
    pub states: &'a [Vec<f64>],
}

impl CollocatedPath<'_> {
    /// Estimates the error of each segment.
    ///
    /// On a segment, collocation replaces f along the path by its polynomial through the segment's points (Eq.
    /// fhat_interp). What f is in truth between the points, at those of a finer Lobatto rule, leaves a defect d; the
    /// error follows from the linearised state equations e' = f_x e + d, e = 0 at the start of the segment, solved on
    /// the finer rule.
    ///
    /// # Errors
    /// Where f is not finite between the points, and as [`Model::check`].
    pub fn integration_error(&self) -> Result<IntegrationError, Error> {
        let (order, n) = (self.order, self.model.states.len());
        let edges: Vec<f64> = self.t.iter().copied().step_by(order - 1).collect();
        let bends = self.experiment.input_times();
        let inside = |w: &[f64]| {
            let slack = SAME * (w[1] - w[0]);
            let until = bends.partition_point(|t| *t < w[1] - slack);
            until.saturating_sub(bends.partition_point(|t| *t < w[0] + slack))
        };
        let inside = edges.windows(2).map(inside).max().unwrap_or(0);
        let (rough, fine) =
            (Lgl::new(order), Lgl::new((order + MORE + 2 * inside).min(MOST.max(order + MORE))));
        let (m, segments) = (fine.nodes.len(), edges.len() - 1);
        let rules = Rules {
            rise: fine.nodes.iter().map(|s| rough.integrate_to(0, *s)).collect(),
            there: fine.nodes.iter().map(|s| rough.basis(*s)).collect(),
            to: fine.nodes.iter().map(|s| fine.integrate_to(0, *s)).collect(),
        };

        let flow = Flow::new(self, &edges)?;
        let (at_mesh, at_fine) = (flow.inputs(&rough.nodes), flow.inputs(&fine.nodes));
        let mut errors = vec![vec![0.0; segments]; n];
        let step = (CHUNK / m).max(1);
        for first in (0..segments).step_by(step) {
            let part = first..(first + step).min(segments);
            let point = |s: usize, k: usize| s * (order - 1) + k;
            let x: Vec<Vec<f64>> = self
                .states
                .iter()
                .map(|path| part.clone().flat_map(|s| (0..order).map(move |k| path[point(s, k)])).collect())
                .collect();
            // Of each segment by itself: where an input jumps, f has another value in the next.
            let f = flow.slopes(&part, order, &at_mesh, &x)?;
            let of_segment = |c: &[f64], k: usize, row: &[f64]| -> f64 {
                c[k * order..(k + 1) * order].iter().zip(row).map(|(f, w)| f * w).sum()
            };
            let path: Vec<Vec<f64>> = (0..n)
                .map(|a| {
                    let one = |(k, s): (usize, usize)| {
                        let (h, from) = (edges[s + 1] - edges[s], self.states[a][point(s, 0)]);
                        let f = &f[a];
                        rules.rise.iter().map(move |row| from + h * of_segment(f, k, row))
                    };
                    part.clone().enumerate().flat_map(one).collect()
                })
                .collect();
            let truth = flow.slopes(&part, m, &at_fine, &path)?;
            let jacobian = flow.jacobian(&part, m, &at_fine, &path);
            for (k, s) in part.clone().enumerate() {
                let defect = DMatrix::from_fn(n, m, |a, l| {
                    truth[a][k * m + l] - of_segment(&f[a], k, &rules.there[l])
                });
                let slope = |a: usize, b: usize, l: usize| jacobian[a * n + b][k * m + l];
                let e = rules.departure(slope, &defect, edges[s + 1] - edges[s]);
                for (of_state, e) in errors.iter_mut().zip(e.row_iter()) {
                    of_state[s] = largest(e.iter().copied());
                }
            }
        }
        let name = self.experiment.name.clone();
        Ok(IntegrationError { name, edges, errors, scales: self.scales() })
    }

    /// Returns what the collocation polynomials may lack, at most in any segment and summed over the segments, of the state for
    /// which that is largest in units of the noise: the next coefficient, extrapolated from the last two as of a geometric
    /// series. The trapezoid has but two: its error in a segment is h³/12 times the third derivative, which third differences
    /// show.
    fn neglected(&self) -> Neglected {
        let (order, scales) = (self.order, self.scales());
        let rule = Lgl::new(order);
        // By the discrete orthogonality of the Legendre polynomials at the Lobatto points, where that of the highest
        // degree has the norm 2/degree in place of 2/(2 degree + 1).
        let row = |degree: usize, factor: f64| -> Vec<f64> {
            let p = rule.nodes.iter().map(|x| legendre(degree, 2.0 * x - 1.0));
            p.zip(&rule.weights).map(|(p, w)| factor * p * w).collect()
        };
        let trapezoid = order == 2 && self.t.len() > 3;
        let (before, last) = (row(order - 2, (2 * order - 3) as f64), row(order - 1, (order - 1) as f64));
        let mut found = Neglected::default();
        for (x, scale) in self.states.iter().zip(&scales) {
            let third = |w: &[f64]| (w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]).abs() / (12.0 * scale);
            let next = |s: usize| {
                let points = &x[s * (order - 1)..=(s + 1) * (order - 1)];
                let size =
                    |row: &[f64]| (row.iter().zip(points).map(|(w, x)| w * x).sum::<f64>() / scale).abs();
                let (before, last) = (size(&before), size(&last));
                if before == 0.0 { 0.0 } else { last * last.min(before) / before }
            };
            let (mut largest, mut sum) = (0.0, 0.0);
            let mut add = |e: f64| (largest, sum) = (f64::max(largest, e), sum + e);
            if trapezoid {
                x.windows(4).map(third).for_each(&mut add);
            } else {
                (0..(x.len() - 1) / (order - 1)).map(next).for_each(&mut add);
            }
            found = Neglected { largest: found.largest.max(largest), sum: found.sum.max(sum) };
        }
        found
    }

    fn scales(&self) -> Vec<f64> {
        let measured = self.model.measured_states(self.parameters);
        let one = |(path, measured): (&Vec<f64>, &Option<crate::measured::Measured>)| {
            let largest = path.iter().fold(0.0, |l: f64, x| l.max(x.abs()));
            let moves = [deviation(path), largest, 1.0].into_iter().find(|v| *v != 0.0).unwrap_or(1.0);
            let sigma = |m: &crate::measured::Measured| Some(self.sigmas[m.output]? / m.slope.abs());
            measured.as_ref().and_then(sigma).map_or(UNMEASURED * moves, |s| s.max(FLOOR * moves))
        };
        self.states.iter().zip(&measured).map(one).collect()
    }
}

impl Fit {
    /// Estimates the error that each segment of the mesh adds to the path, in each of the experiments of the estimation.
    /// With delays these are of the model at fixed delays, on records that were moved by them.
    ///
    /// # Errors
    /// For a fit that was not transcribed by collocation, and where the state equations are not finite between the points
    /// of the mesh.
    pub fn integration_error(&self, experiments: &[Experiment]) -> Result<Vec<IntegrationError>, Error> {
        self.paths(experiments, |path| path.integration_error())
    }

    /// Returns whether the errors of all segments, each small beside the noise, may add up to more than it: a position is an
    /// integral, and keeps all of them.
    pub(super) fn may_accumulate_error(&self, experiments: &[Experiment]) -> bool {
        self.neglected(experiments).is_some_and(|n| n.sum > ACCUMULATED)
    }

    /// Returns the most that the path of any experiment neglects; None without a mesh.
    fn neglected(&self, experiments: &[Experiment]) -> Option<Neglected> {
        let each = self.paths(experiments, |path| Ok(path.neglected())).ok()?;
        let most = |a: Neglected, b: Neglected| Neglected {
            largest: a.largest.max(b.largest),
            sum: a.sum.max(b.sum),
        };
        each.into_iter().reduce(most)
    }

    /// Returns a sentence on the segment whose integration error is largest, where that is not small beside the noise.
    ///
    /// The error itself is computed only where the path's last Legendre coefficients show that it may be as large: of a
    /// path that the mesh resolves they fall off fast, and to see that takes microseconds.
    pub(super) fn coarse_mesh_warning(&self, experiments: &[Experiment]) -> Option<String> {
        if self.neglected(experiments)?.largest <= COARSE {
            return None;
        }
        // Equations may not be finite between the points of the mesh.
        let errors = self.integration_error(experiments).ok()?;
        let all = errors.iter().flat_map(|e| e.worst().into_iter().enumerate().map(move |(k, w)| (e, k, w)));
        let (found, k, worst) = all.fold(None, |best: Option<(&IntegrationError, usize, f64)>, one| {
            best.filter(|b| b.2 >= one.2).or(Some(one))
        })?;
        let place = if errors.len() > 1 { format!(" of '{}'", found.name) } else { String::new() };
        (worst > COARSE).then(|| {
            format!(
                "{COARSE_MESH}: from t = {} to {}{place} integration is wrong by {} times the noise, and estimates may \
                 be wrong with it: the option refine of the collocation divides the mesh as needed",
                short(found.edges[k], 4),
                short(found.edges[k + 1], 4),
                short(worst, 1)
            )
        })
    }

    fn paths<R>(
        &self,
        experiments: &[Experiment],
        of: impl Fn(&CollocatedPath<'_>) -> Result<R, Error>,
    ) -> Result<Vec<R>, Error> {
        let (fit, experiments) = match &self.moved {
            Some(moved) => (&moved.fit, &moved.experiments[..]),
            None => (self, experiments),
        };
        let Transcription::Collocation(settings) = &fit.transcription else {
            let text = "integration error: only collocation has a mesh whose error can be estimated";
            return Err(Error::option(text.into()));
        };
        let one = |(record, experiment): (&Record, &Experiment)| {
            let (parameters, sigmas) = fit.numbers_of(&record.name);
            of(&CollocatedPath {
                model: &fit.model,
                experiment,
                parameters: &parameters,
                sigmas: &sigmas,
                order: settings.order,
                t: &record.mesh_t,
                states: &record.mesh_states,
            })
        };
        fit.records.iter().zip(experiments).map(one).collect()
    }

    /// The parameters of the model in an experiment, and the standard deviations of the noise by output.
    pub(super) fn numbers_of(&self, experiment: &str) -> (Vec<f64>, Vec<Option<f64>>) {
        let of = |name: &str| {
            let own = self.parameter(&format!("{name}[{experiment}]"));
            own.or_else(|| self.parameter(name)).map(|e| e.value)
        };
        let parameters = self.model.parameters.iter().map(|p| of(&p.name).unwrap_or(p.start)).collect();
        let sigma = |name: &str| match self.noise.scale_of(name) {
            Some(Scale::Known(sigma)) => Some(*sigma),
            _ => of(&format!("{SIGMA}{name}")),
        };
        (parameters, self.model.outputs.iter().map(|o| sigma(&o.name)).collect())
    }
}

/// Weights of the points of a segment, for each node of the finer rule, per unit length.
struct Rules {
    /// Integrals of the basis of the segment up to the node.
    rise: Vec<Vec<f64>>,
    /// The basis of the segment at the node.
    there: Vec<Vec<f64>>,
    /// Integrals of the basis of the finer rule up to the node.
    to: Vec<Vec<f64>>,
}

impl Rules {
    /// Solves e' = J e + d with e = 0 at the first node, in a segment of length h: n × m values at the nodes.
    fn departure(
        &self,
        slope: impl Fn(usize, usize, usize) -> f64,
        defect: &DMatrix<f64>,
        h: f64,
    ) -> DMatrix<f64> {
        let (n, m) = defect.shape();
        let integrated = |d: &DMatrix<f64>| {
            DMatrix::from_fn(n, m, |a, l| h * (0..m).map(|j| d[(a, j)] * self.to[l][j]).sum::<f64>())
        };
        let forced = integrated(defect);
        let mut e = forced.clone();
        // Picard's iterations are enough where segments are short beside the time constants; of stiff ones they diverge.
        for _ in 0..SWEEPS {
            let driven =
                DMatrix::from_fn(n, m, |a, l| (0..n).map(|b| slope(a, b, l) * e[(b, l)]).sum::<f64>());
            let next = &forced + integrated(&driven);
            let (moved, size) = ((&next - &e).amax(), next.amax());
            let finite = next.iter().all(|e| e.is_finite());
            e = next;
            if finite && moved <= SETTLED * size {
                return e;
            }
        }
        // All nodes but the first at once. Row (j, a), column (l, b): what e_b at node l adds to e_a at node j.
        let system = DMatrix::from_fn((m - 1) * n, (m - 1) * n, |row, column| {
            let (j, a, l, b) = (row / n + 1, row % n, column / n + 1, column % n);
            f64::from(row == column) - h * self.to[j][l] * slope(a, b, l)
        });
        let right = DVector::from_fn((m - 1) * n, |row, _| forced[(row % n, row / n + 1)]);
        let solved = system.lu().solve(&right);
        let at = |a: usize, l: usize| solved.as_ref().map_or(f64::NAN, |x| x[(l - 1) * n + a]);
        DMatrix::from_fn(n, m, |a, l| if l == 0 { forced[(a, 0)] } else { at(a, l) })
    }
}

/// Time and inputs at the nodes of a rule in each segment: columns of S × nodes.
type Columns = Vec<Vec<f64>>;

/// The state equations with numbers put in, over the segments of an experiment.
struct Flow<'a> {
    path: &'a CollocatedPath<'a>,
    edges: &'a [f64],
    dynamics: Tape,
    /// With the place of each entry in the matrix, row by row.
    jacobian: (Tape, Vec<usize>),
}

impl<'a> Flow<'a> {
    fn new(path: &'a CollocatedPath<'a>, edges: &'a [f64]) -> Result<Self, Error> {
        let mut c = path.model.compile()?;
        let lanes = c.data.iter().chain(&c.states).copied().collect();
        let inputs = Inputs { lanes, uniforms: c.parameters };
        let dynamics = Tape::compile(&c.graph, &inputs, &c.dynamics)?;
        let entries = c.graph.jacobian(&c.dynamics, &c.states);
        let places = entries.rows.iter().zip(&entries.columns).map(|(r, k)| r * c.states.len() + k).collect();
        let jacobian = (Tape::compile(&c.graph, &inputs, &entries.values)?, places);
        Ok(Flow { path, edges, dynamics, jacobian })
    }

    fn inputs(&self, nodes: &[f64]) -> Columns {
        let spans = || self.edges.windows(2).flat_map(|w| nodes.iter().map(move |x| ([w[0], w[1]], x)));
        let times: Vec<f64> = spans().map(|([a, b], x)| a + (b - a) * x).collect();
        let spans: Vec<[f64; 2]> = spans().map(|s| s.0).collect();
        let input = |c: usize| self.path.experiment.input_over(c, &times, &spans);
        let inputs: Vec<Vec<f64>> = (0..self.path.experiment.inputs.len()).map(input).collect();
        std::iter::once(times).chain(inputs).collect()
    }

    fn columns<'c>(
        part: &std::ops::Range<usize>,
        nodes: usize,
        inputs: &'c Columns,
        x: &'c [Vec<f64>],
    ) -> Vec<&'c [f64]> {
        let here = part.start * nodes..part.end * nodes;
        inputs.iter().map(|c| &c[here.clone()]).chain(x.iter().map(Vec::as_slice)).collect()
    }

    /// f at the nodes of some segments, n_x columns.
    fn slopes(
        &self,
        part: &std::ops::Range<usize>,
        nodes: usize,
        inputs: &Columns,
        x: &[Vec<f64>],
    ) -> Result<Columns, Error> {
        let columns = Self::columns(part, nodes, inputs, x);
        let f = at_points(&self.dynamics, self.path.parameters, &columns);
        let bad = (0..columns[0].len()).find_map(|k| Some((k, f.iter().position(|f| !f[k].is_finite())?)));
        match bad {
            Some((k, i)) => Err(Error::evaluation(format!(
                "experiment '{}': the equation of {}' is not finite at t = {} on the collocation polynomial: the mesh is \
                 too coarse there",
                self.path.experiment.name,
                self.path.model.states[i].name,
                short(columns[0][k], 6)
            ))),
            None => Ok(f),
        }
    }

    /// Its derivatives by the states, n_x × n_x columns.
    fn jacobian(
        &self,
        part: &std::ops::Range<usize>,
        nodes: usize,
        inputs: &Columns,
        x: &[Vec<f64>],
    ) -> Columns {
        let columns = Self::columns(part, nodes, inputs, x);
        let n = self.path.states.len();
        let mut dense = vec![vec![0.0; columns[0].len()]; n * n];
        let values = at_points(&self.jacobian.0, self.path.parameters, &columns);
        for (place, column) in self.jacobian.1.iter().zip(values) {
            dense[*place] = column;
        }
        dense
    }
}

/// Returns the Legendre polynomial of a degree at x.
fn legendre(degree: usize, x: f64) -> f64 {
    let (mut before, mut p) = (0.0, 1.0);
    for k in 0..degree {
        let k = k as f64;
        (before, p) = (p, ((2.0 * k + 1.0) * x * p - k * before) / (k + 1.0));
    }
    p
}

/// Returns the standard deviation of some values.
pub(super) fn deviation(x: &[f64]) -> f64 {
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    (x.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / x.len() as f64).sqrt()
}
