//! Gauss-Newton iterations over the window: from the arrival cost to the latest sample by orthogonal transformations, and back by
//! substitution.

use super::bounds::Bounds;
use super::forgetting::Direction;
use super::horizon::{Horizon, Node};
use super::map::Map;
use super::sensors::Sensors;
use super::settings::Forgetting;
use super::transition::{self, Segment};
use super::triangle::Triangle;

/// What was not finite, or not regular.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// The state of this number.
    State(usize),
    /// The output of this number.
    Output(usize),
    /// The transition between two nodes.
    Singular,
}

/// The equations of the model, with what is assumed of them, and memory.
pub(super) struct GaussNewton {
    pub(super) map: Map,
    pub(super) sensors: Sensors,
    /// Numbers of the parameters that are estimated.
    pub(super) free: Vec<usize>,
    /// The column of each state and parameter of the model, where it is estimated.
    columns: Vec<Option<usize>>,
    /// Values of all parameters of the model.
    pub(super) values: Vec<f64>,
    pub(super) bounds: Bounds,
    /// Numbers of the states with process noise, and its standard deviation after 1 s.
    driven: Vec<usize>,
    intensity: Vec<f64>,
    /// The most that is known of each state for given parameters: the inverse of its least standard deviation.
    most: Vec<f64>,
    segments: Vec<Segment>,
    /// Information on the state at the latest node that was reached, and on the parameters.
    pub(super) info: Triangle,
    /// That at the last node, without its outputs.
    pub(super) predicted: Triangle,
    /// Equations of the outputs of a node, in standard deviations of their noise.
    rows: Vec<f64>,
    /// Those of the last node, and the numbers of the outputs that are there.
    pub(super) last_rows: Vec<f64>,
    pub(super) present: Vec<usize>,
    /// Residuals there after the last step, in standard deviations.
    pub(super) residuals: Vec<f64>,
    /// Steps of a state and the parameters, at a node and at the one before.
    pub(super) delta: Vec<f64>,
    before: Vec<f64>,
    noises: Vec<f64>,
    outputs: Vec<f64>,
    work: Vec<f64>,
    direction: Direction,
    /// Operations outside of triangles.
    flops: u64,
}

/// The parts that a [`GaussNewton`] is made of.
pub(super) struct Parts {
    pub(super) map: Map,
    pub(super) sensors: Sensors,
    pub(super) free: Vec<usize>,
    pub(super) values: Vec<f64>,
    pub(super) bounds: Bounds,
    pub(super) driven: Vec<(usize, f64)>,
    pub(super) most: Vec<f64>,
    pub(super) window: usize,
    pub(super) n: usize,
    pub(super) n_y: usize,
}

impl GaussNewton {
    pub(super) fn new(parts: Parts) -> GaussNewton {
        let Parts { map, sensors, free, values, bounds, driven, most, window, n, n_y } = parts;
        let (p, q) = (free.len(), driven.len());
        let (m, w) = (n + p, n + p + 1);
        let mut columns: Vec<Option<usize>> = (0..n).map(Some).collect();
        columns.extend((0..values.len()).map(|i| free.iter().position(|f| *f == i).map(|at| n + at)));
        GaussNewton {
            map,
            sensors,
            free,
            columns,
            values,
            bounds,
            driven: driven.iter().map(|d| d.0).collect(),
            intensity: driven.iter().map(|d| d.1).collect(),
            most,
            segments: vec![Segment::new(n, p, q); window],
            info: Triangle::new(m),
            predicted: Triangle::new(m),
            rows: vec![0.0; n_y * w],
            last_rows: vec![0.0; n_y * w],
            present: Vec::with_capacity(n_y),
            residuals: vec![0.0; n_y],
            delta: vec![0.0; m],
            before: vec![0.0; n],
            noises: vec![0.0; q],
            outputs: vec![0.0; n_y],
            work: vec![0.0; (q + n) * (q + w)],
            direction: Direction::new(n, p, n_y),
            flops: 0,
        }
    }

    /// Number of states.
    pub(super) fn n(&self) -> usize {
        self.before.len()
    }

    /// Operations so far.
    pub(super) fn flops(&self) -> u64 {
        self.flops + self.info.flops + self.predicted.flops + self.bounds.flops() + self.direction.flops()
    }

    /// Takes values of the estimated parameters.
    pub(super) fn load(&mut self, theta: &[f64]) {
        self.free.iter().zip(theta).for_each(|(i, v)| self.values[*i] = *v);
        self.map.load(&self.values);
        self.sensors.load(&self.values);
    }

    /// The state at a node, from that at the one before, with the parameters that are loaded.
    pub(super) fn predict(&mut self, nodes: &mut [Node]) -> Result<(), Fault> {
        let [from, to, ..] = nodes else { return Ok(()) };
        self.flops += self.map.flops();
        if !self.map.end(from.moment(), to.moment(), &from.x) {
            return Err(self.lost());
        }
        to.x.copy_from_slice(self.map.state());
        Ok(())
    }

    fn lost(&self) -> Fault {
        Fault::State(self.map.state().iter().position(|x| !x.is_finite()).unwrap_or(0))
    }

    /// Equations of the outputs that are there at a node, into `rows`, and the numbers of these outputs.
    fn measure(&mut self, node: &Node, sigma: &[f64]) -> Result<(), Fault> {
        let GaussNewton { sensors, rows, columns, present, outputs, info, .. } = self;
        let w = info.width();
        present.clear();
        present.extend((0..sigma.len()).filter(|c| !node.outputs[*c].is_nan()));
        if present.is_empty() {
            return Ok(());
        }
        self.flops += sensors.flops();
        sensors.values(node.moment(), &node.x, outputs);
        rows[..present.len() * w].fill(0.0);
        let mut lost = None;
        sensors.slopes(node.moment(), &node.x, |output, column, value| {
            let (Ok(k), Some(column)) = (present.binary_search(&output), columns[column]) else { return };
            if !value.is_finite() {
                lost = Some(Fault::Output(output));
            }
            rows[k * w + column] = value / sigma[output];
        });
        for (k, output) in present.iter().enumerate() {
            let residual = (node.outputs[*output] - outputs[*output]) / sigma[*output];
            if !residual.is_finite() {
                lost = Some(Fault::Output(*output));
            }
            rows[k * w + w - 1] = residual;
        }
        lost.map_or(Ok(()), Err)
    }

    /// Linearises the segment behind the k-th node.
    fn linearise(&mut self, nodes: &[Node], k: usize) -> Result<(), Fault> {
        let (from, to) = (&nodes[k], &nodes[k + 1]);
        self.flops += self.map.flops();
        if !(self.map.end(from.moment(), to.moment(), &from.x) && self.map.linearise()) {
            return Err(self.lost());
        }
        let (n, p) = (self.n(), self.free.len());
        let segment = &mut self.segments[k];
        for (i, (defect, end)) in segment.defect.iter_mut().zip(self.map.state()).enumerate() {
            *defect = end - to.x[i];
        }
        self.map.with_slopes(|slope| {
            for r in 0..n {
                (0..n).for_each(|c| segment.a[r * n + c] = slope(r, c));
                self.free.iter().enumerate().for_each(|(c, i)| segment.b[r * p + c] = slope(r, n + i));
            }
        });
        let root = (to.t - from.t).sqrt();
        segment.noise.iter_mut().zip(&self.intensity).for_each(|(s, q)| *s = q * root);
        Ok(())
    }

    /// Carries the information over a segment. Without process noise the states are ever better known for given parameters, and rows
    /// grow like the inverse of what decays, without limit; so they are cut back to what is known of a state at most.
    fn advance(&mut self, k: usize) -> Result<(), Fault> {
        if !self.segments[k].advance(&mut self.info, &self.driven, &mut self.work) {
            return Err(Fault::Singular);
        }
        let w = self.info.width();
        for (i, most) in self.most.iter().enumerate() {
            let row = &mut self.info.r[i * w..(i + 1) * w];
            let size = row[i].abs();
            if size > *most {
                row.iter_mut().for_each(|v| *v *= most / size);
            }
        }
        Ok(())
    }

    /// Information in front of the window, counted from the present estimates.
    fn arrive(&mut self, window: &Horizon) {
        let n = self.n();
        self.info.copy_from(&window.arrival);
        let now = window.nodes[0].x.iter().chain(&window.theta);
        for ((step, now), then) in self.delta.iter_mut().zip(now).zip(&window.reference) {
            *step = now - then;
        }
        debug_assert_eq!(window.reference.len(), n + self.free.len());
        let delta = std::mem::take(&mut self.delta);
        self.info.shift(&delta);
        self.delta = delta;
    }

    /// An error of the state in front of a segment and of the parameters, carried to the state behind it.
    pub(super) fn carry(&self, segment: usize, error: &[f64], out: &mut [f64]) {
        let (n, p) = (self.n(), self.free.len());
        let Segment { a, b, .. } = &self.segments[segment];
        let (x, theta) = error.split_at(n);
        for (i, out) in out[..n].iter_mut().enumerate() {
            let by_x: f64 = a[i * n..(i + 1) * n].iter().zip(x).map(|(a, x)| a * x).sum();
            let by_theta: f64 = b[i * p..(i + 1) * p].iter().zip(theta).map(|(b, t)| b * t).sum();
            *out = by_x + by_theta;
        }
        out[n..].copy_from_slice(theta);
    }

    /// From the arrival cost to the last node, which is in `info` then; without its outputs it is in `predicted`.
    pub(super) fn forward(&mut self, window: &Horizon, sigma: &[f64]) -> Result<(), Fault> {
        self.load(&window.theta);
        self.arrive(window);
        let w = self.info.width();
        for k in 0..window.used {
            let node = &window.nodes[k];
            self.measure(node, sigma)?;
            let count = self.present.len() * w;
            if k + 1 == window.used {
                self.predicted.copy_from(&self.info);
                self.last_rows[..count].copy_from_slice(&self.rows[..count]);
            }
            self.info.absorb(&mut self.rows[..count]);
            if k + 1 < window.used {
                self.linearise(&window.nodes, k)?;
                self.advance(k)?;
            }
        }
        Ok(())
    }

    /// The step of all unknowns, which are changed by it. Twice the decrease of the cost that it promises, with a minus.
    pub(super) fn backward(&mut self, window: &mut Horizon) -> f64 {
        let (n, m) = (self.n(), self.info.m);
        self.bounds.solve(&mut self.info, &window.theta, &mut self.delta);
        self.info.solve(0, n, &mut self.delta);
        let mut decrement = 0.0;
        let w = self.info.width();
        for i in 0..m {
            let row = &self.info.r[i * w..];
            decrement += (i..m).map(|j| row[j] * self.delta[j]).sum::<f64>().powi(2);
        }
        for (residual, row) in self.residuals.iter_mut().zip(self.last_rows.chunks_exact(w)) {
            *residual = row[m] - row.iter().zip(&self.delta).map(|(h, d)| h * d).sum::<f64>();
        }
        window.theta.iter_mut().zip(&self.delta[n..]).for_each(|(v, d)| *v += d);
        self.bounds.project(&mut window.theta);
        // The defects vanish to first order: a small step of the last state alone says nothing of those before.
        for k in (0..window.used).rev() {
            window.nodes[k].x.iter_mut().zip(&self.delta).for_each(|(x, d)| *x += d);
            if k > 0 {
                self.segments[k - 1].back(&self.driven, &self.delta, &mut self.before, &mut self.noises);
                self.delta[..n].copy_from_slice(&self.before);
            }
        }
        self.flops += (m * m + window.used * 2 * n * (n + m)) as u64;
        decrement
    }

    /// Eliminates the first node, with its outputs and the segment behind it, into the arrival cost of the next one; where it is
    /// the only one, its outputs alone.
    pub(super) fn eliminate_first(
        &mut self,
        window: &mut Horizon,
        sigma: &[f64],
        forgetting: Forgetting,
    ) -> Result<(), Fault> {
        self.load(&window.theta);
        self.arrive(window);
        self.measure(&window.nodes[0], sigma)?;
        let count = self.present.len() * self.info.width();
        let more = window.used > 1;
        if more {
            let interval = window.nodes[1].t - window.nodes[0].t;
            self.direction.forget(&mut self.info, forgetting, interval, &self.rows[..count]);
        }
        self.info.absorb(&mut self.rows[..count]);
        if more {
            self.linearise(&window.nodes, 0)?;
            self.advance(0)?;
        }
        let n = self.n();
        window.arrival.copy_from(&self.info);
        let at = usize::from(more);
        window.reference[..n].copy_from_slice(&window.nodes[at].x);
        window.reference[n..].copy_from_slice(&window.theta);
        window.drop_first();
        Ok(())
    }

    /// Operations of the iterations after a sample, of taking it and of eliminating so many others, at most.
    pub(super) fn bound(&self, window: usize, iterations: usize, eliminated: usize) -> u64 {
        let (n, p, n_y, q) = (self.n(), self.free.len(), self.outputs.len(), self.driven.len());
        let (m, w) = (n + p, n + p + 1);
        let shift = (m * (m + 1)) as u64;
        let absorb: usize = (0..m).map(|j| 4 * (w - j) * (1 + n_y)).sum();
        let node = self.sensors.flops() + absorb as u64;
        let segment = self.map.flops() + transition::flops(n, p, q) + (n * w) as u64;
        let back = (2 * m * m + m * m + window * 2 * n * (n + m)) as u64 + self.bounds.bound();
        let pass = shift + window as u64 * node + (window as u64 - 1) * segment + back;
        let eliminate = shift + self.direction.bound() + node + segment;
        iterations as u64 * pass + eliminated as u64 * eliminate + 2 * self.map.flops()
    }
}
