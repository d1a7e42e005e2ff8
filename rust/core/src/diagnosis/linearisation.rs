//! A collocation problem linearised about a point: the responses of states and outputs to its variables, and to signals
//! at a place of the model.

use std::ops::Deref;

use super::forward::{AT_ONCE, Forward, Lanes};
use super::response::Response;
use crate::collocation::Collocation;
use crate::index::{PointId, VariableId};
use crate::interrupt::current;
use crate::nlp::NotFinite;
use crate::threads::Threads;
use crate::threads::prelude::*;

/// Derivatives of the outputs by states and parameters at all samples, those of all experiments after each other.
pub struct Outputs<'a> {
    /// (samples, n_y, n_x)
    pub by_state: &'a [f64],
    /// (samples, n_y, n_θ)
    pub by_parameter: &'a [f64],
    /// (samples, n_y) the row of a response, among those of measurements; below 0 where nothing was measured.
    pub rows: &'a [isize],
    /// Number of outputs.
    pub n_y: usize,
}

/// The places where signals act, and the effect of a signal of size 1.
pub struct Place<'a> {
    /// The effect on f, (mesh points, n_x).
    pub slopes: &'a [f64],
    /// The effect on the outputs, (samples, n_y).
    pub outputs: &'a [f64],
}

/// The factorised system: the equations segment by segment, forward in time, or the KKT system where the motion is
/// too unstable for that.
enum Factors<P> {
    Forward(Forward<P>),
    Response(Response<P>),
}

/// The linearisation about a point with some variables held, factorised once, when it is first needed, for all that is
/// asked.
pub struct Linearisation<P> {
    problem: P,
    xi: Vec<f64>,
    held: Vec<VariableId>,
    factors: Option<Factors<P>>,
}

impl<P: Deref<Target = Collocation> + Clone + Sync> Linearisation<P> {
    /// About ξ. Variables `held` (fixed, at a bound, of the noise) do not move.
    pub fn new(problem: P, xi: &[f64], held: &[VariableId]) -> Linearisation<P> {
        Linearisation { problem, xi: xi.to_vec(), held: held.to_vec(), factors: None }
    }

    /// Whether it is that about ξ, with these variables held.
    pub fn is_at(&self, xi: &[f64], held: &[VariableId]) -> bool {
        self.xi == xi && self.held == held
    }

    fn factors(&mut self) -> Result<&mut Factors<P>, NotFinite> {
        let factors = match self.factors.take() {
            Some(factors) => factors,
            None => match Forward::new(self.problem.clone(), &self.xi)? {
                Some(forward) => Factors::Forward(forward),
                None => Factors::Response(Response::new(self.problem.clone(), &self.xi, &self.held)?),
            },
        };
        Ok(self.factors.insert(factors))
    }

    /// Tangents of the path along variables, n_θ + n_x · samples numbers each: parameters, then the states at the samples
    /// of each experiment, sample by sample. And whether that is forward in time: then they are those of one variable
    /// alone, a parameter or an initial state, whatever conditions there are.
    ///
    /// # Errors
    /// [`NotFinite`] when a derivative is not finite there, the equations depend on each other, or the interrupt in force
    /// stops it.
    pub fn tangents(&mut self, variables: &[VariableId]) -> Result<(Vec<f64>, bool), NotFinite> {
        let problem = self.problem.clone();
        let layout = &problem.layout;
        let mut out = Vec::new();
        let response = match self.factors()? {
            Factors::Forward(forward) => {
                for (&i, states) in variables.iter().zip(forward.tangents(variables)) {
                    out.extend((0..layout.n_theta).map(|p| f64::from(p == i.0)));
                    out.extend(states);
                }
                return if current().stops() { Err(NotFinite) } else { Ok((out, true)) };
            }
            Factors::Response(response) => response,
        };
        let mut d = vec![0.0; layout.n()];
        let interrupt = current();
        for &i in variables {
            if interrupt.stops() {
                return Err(NotFinite);
            }
            response.tangent(i, &mut d);
            out.extend_from_slice(&d[..layout.n_theta]);
            for (mesh, first) in problem.meshes.iter().zip(&layout.first_point) {
                for point in &mesh.sample_points {
                    out.extend_from_slice(&d[layout.states(*first + *point)]);
                }
            }
        }
        Ok((out, false))
    }

    /// Answers (k, rows) of the outputs to signals (k, points), and how parameters took part in them (k, n_θ): not at all
    /// where the equations can be solved forward in time.
    ///
    /// # Errors
    /// [`NotFinite`] when a derivative is not finite there, the equations depend on each other, or the interrupt in force
    /// stops it.
    pub fn answers(
        &mut self,
        outputs: &Outputs<'_>,
        place: &Place<'_>,
        signals: &[f64],
    ) -> Result<(Vec<f64>, Vec<f64>), NotFinite> {
        let problem = self.problem.clone();
        let layout = &problem.layout;
        let (n, n_theta) = (layout.n_x, layout.n_theta);
        let points: usize = problem.meshes.iter().map(|m| m.times.len()).sum();
        let meshes = || problem.meshes.iter().zip(&layout.first_point);
        let samples: Vec<PointId> =
            meshes().flat_map(|(m, f)| m.sample_points.iter().map(move |p| *f + *p)).collect();
        let width = outputs.rows.iter().filter(|&&r| r >= 0).count();
        let k = signals.len() / points.max(1);
        let (mut columns, mut parameters) = (vec![0.0; k * width], vec![0.0; k * n_theta]);
        let lanes = |signals: &[f64]| {
            let mut at = vec![[0.0; AT_ONCE]; points];
            for (c, signal) in signals.chunks_exact(points).enumerate() {
                at.iter_mut().zip(signal).for_each(|(at, s)| at[c] = *s);
            }
            at
        };
        // From signals, and states if they move, to columns.
        let put = |at: &[Lanes], states: &[Lanes], out: &mut [f64]| {
            let mut block = vec![[0.0; AT_ONCE]; width];
            for (s, point) in samples.iter().enumerate() {
                let x = if states.is_empty() { &[] } else { &states[s * n..][..n] };
                for i in s * outputs.n_y..(s + 1) * outputs.n_y {
                    let Ok(row) = usize::try_from(outputs.rows[i]) else { continue };
                    let mut y = at[point.0].map(|v| v * place.outputs[i]);
                    for (by, x) in outputs.by_state[i * n..].iter().zip(x) {
                        y.iter_mut().zip(x).for_each(|(y, x)| *y += by * x);
                    }
                    block[row] = y;
                }
            }
            for (c, out) in out.chunks_exact_mut(width).enumerate() {
                out.iter_mut().zip(&block).for_each(|(out, y)| *out = y[c]);
            }
        };
        let chunks = (AT_ONCE * points, AT_ONCE * width.max(1));
        let interrupt = current();
        let factors = if place.slopes.iter().all(|v| *v == 0.0) { None } else { Some(self.factors()?) };
        match factors {
            None => {
                let some = |(out, signals): (&mut [f64], &[f64])| {
                    if !interrupt.stops() {
                        put(&lanes(signals), &[], out);
                    }
                };
                let pairs = columns.par_chunks_mut(chunks.1).zip(signals.par_chunks(chunks.0));
                Threads::default().install(|| pairs.for_each(some));
            }
            Some(Factors::Forward(forward)) => {
                let forward = &*forward;
                let some = |(out, signals): (&mut [f64], &[f64])| {
                    if interrupt.stops() {
                        return;
                    }
                    let at = lanes(signals);
                    let states = forward.states(&interrupt, |mesh_point, point, given| {
                        let slopes = place.slopes[mesh_point * n..].chunks_exact(n);
                        for ((given, slopes), at) in given.chunks_exact_mut(n).zip(slopes).zip(&at[point.0..])
                        {
                            given.iter_mut().zip(slopes).for_each(|(g, b)| *g = at.map(|v| v * b));
                        }
                    });
                    put(&at, &states, out);
                };
                let pairs = columns.par_chunks_mut(chunks.1).zip(signals.par_chunks(chunks.0));
                Threads::default().install(|| pairs.for_each(some));
            }
            Some(Factors::Response(response)) => {
                let (mut d, mut slopes) = (vec![0.0; layout.n()], vec![0.0; place.slopes.len()]);
                let all = columns
                    .chunks_mut(chunks.1)
                    .zip(signals.chunks(chunks.0))
                    .zip(parameters.chunks_mut(AT_ONCE * n_theta));
                for ((out, signals), parameters) in all {
                    let mut states = vec![[0.0; AT_ONCE]; samples.len() * n];
                    for (c, signal) in signals.chunks_exact(points).enumerate() {
                        if interrupt.stops() {
                            return Err(NotFinite);
                        }
                        let at_mesh = meshes().flat_map(|(m, f)| &signal[f.0..f.0 + m.n_mesh]);
                        for ((slope, one), s) in
                            slopes.chunks_exact_mut(n).zip(place.slopes.chunks_exact(n)).zip(at_mesh)
                        {
                            slope.iter_mut().zip(one).for_each(|(b, one)| *b = one * s);
                        }
                        response.forced(&slopes, &mut d);
                        parameters[c * n_theta..][..n_theta].copy_from_slice(&d[..n_theta]);
                        for (s, point) in samples.iter().enumerate() {
                            for r in 0..n {
                                states[s * n + r][c] = d[layout.state(*point) + r];
                            }
                        }
                    }
                    put(&lanes(signals), &states, out);
                    for (theta, out) in parameters.chunks_exact(n_theta).zip(out.chunks_exact_mut(width)) {
                        for (i, row) in outputs.rows.iter().enumerate() {
                            let Ok(row) = usize::try_from(*row) else { continue };
                            let by = &outputs.by_parameter[i * n_theta..];
                            out[row] += theta.iter().zip(by).map(|(t, by)| t * by).sum::<f64>();
                        }
                    }
                }
            }
        }
        if interrupt.stops() { Err(NotFinite) } else { Ok((columns, parameters)) }
    }
}
