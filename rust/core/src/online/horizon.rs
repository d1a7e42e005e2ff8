//! The samples of the window, the estimates there, and the information on what was before: all that a sample changes, in memory
//! that is there from the beginning.

use super::map::Moment;
use super::triangle::Triangle;

/// A sample of the window and the state there.
#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) t: f64,
    pub(super) inputs: Vec<f64>,
    /// NaN where missing.
    pub(super) outputs: Vec<f64>,
    pub(super) x: Vec<f64>,
}

impl Node {
    fn new(n_u: usize, n_y: usize, n: usize) -> Node {
        Node { t: 0.0, inputs: vec![0.0; n_u], outputs: vec![f64::NAN; n_y], x: vec![0.0; n] }
    }

    pub(super) fn moment(&self) -> Moment<'_> {
        Moment { t: self.t, inputs: &self.inputs }
    }

    fn copy_from(&mut self, other: &Node) {
        self.t = other.t;
        self.inputs.copy_from_slice(&other.inputs);
        self.outputs.copy_from_slice(&other.outputs);
        self.x.copy_from_slice(&other.x);
    }
}

/// The window. The first `used` of the nodes are in it, in the order of time.
#[derive(Clone, Debug)]
pub(super) struct Horizon {
    pub(super) nodes: Vec<Node>,
    pub(super) used: usize,
    /// Information on the state at the first node, without the outputs there, and on the parameters: of steps from `reference`.
    pub(super) arrival: Triangle,
    /// State at the first node, then parameters.
    pub(super) reference: Vec<f64>,
    /// Parameters that are estimated.
    pub(super) theta: Vec<f64>,
}

/// The place of a time in the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// Behind all nodes.
    Latest,
    /// At a node.
    At(usize),
    /// In front of a node that is not the first.
    Before(usize),
    /// In front of all.
    TooLate,
}

impl Horizon {
    pub(super) fn new(window: usize, n_u: usize, n_y: usize, n: usize, theta: &[f64]) -> Horizon {
        let mut reference = vec![0.0; n];
        reference.extend(theta);
        Horizon {
            nodes: vec![Node::new(n_u, n_y, n); window + 1],
            used: 0,
            arrival: Triangle::new(reference.len()),
            reference,
            theta: theta.to_vec(),
        }
    }

    /// Becomes the same as another, without taking memory.
    pub(super) fn copy_from(&mut self, other: &Horizon) {
        self.used = other.used;
        for (to, from) in self.nodes.iter_mut().zip(&other.nodes[..other.used]) {
            to.copy_from(from);
        }
        self.arrival.copy_from(&other.arrival);
        self.reference.copy_from_slice(&other.reference);
        self.theta.copy_from_slice(&other.theta);
    }

    /// The node of the latest sample.
    pub(super) fn last(&self) -> Option<&Node> {
        self.nodes[..self.used].last()
    }

    pub(super) fn place(&self, t: f64) -> Place {
        let Some(last) = self.last() else { return Place::Latest };
        if t > last.t {
            return Place::Latest;
        }
        let nodes = &self.nodes[..self.used];
        match nodes.iter().position(|node| node.t >= t) {
            Some(k) if nodes[k].t == t => Place::At(k),
            Some(k) if k > 0 => Place::Before(k),
            _ => Place::TooLate,
        }
    }

    /// Opens a node in front of the k-th one, or behind all of them.
    pub(super) fn open(&mut self, k: usize, t: f64, inputs: &[f64], outputs: &[f64]) {
        self.nodes[k..=self.used].rotate_right(1);
        self.used += 1;
        let node = &mut self.nodes[k];
        node.t = t;
        node.inputs.copy_from_slice(inputs);
        node.outputs.copy_from_slice(outputs);
    }

    /// Puts inputs that a late sample does not have between those of its neighbours.
    pub(super) fn complete(&mut self, k: usize, held: &[bool]) {
        let (before, rest) = self.nodes.split_at_mut(k);
        let [node, after, ..] = rest else { return };
        let Some(before) = before.last() else { return };
        let share = (node.t - before.t) / (after.t - before.t);
        let ends = before.inputs.iter().zip(&after.inputs).zip(held);
        for (value, ((a, b), held)) in node.inputs.iter_mut().zip(ends).filter(|v| v.0.is_nan()) {
            *value = if *held { *a } else { a + share * (b - a) };
        }
    }

    /// Adds outputs to a node that has none of them; whether it took any.
    pub(super) fn merge(&mut self, k: usize, outputs: &[f64]) -> bool {
        let own = &mut self.nodes[k].outputs;
        let is_new = |(own, new): (&f64, &f64)| new.is_nan() || own.is_nan();
        if outputs.iter().all(|v| v.is_nan()) || !own.iter().zip(outputs).all(is_new) {
            return false;
        }
        own.iter_mut().zip(outputs).filter(|v| !v.1.is_nan()).for_each(|(own, new)| *own = *new);
        true
    }

    /// Takes the first node out.
    pub(super) fn drop_first(&mut self) {
        self.nodes[..self.used].rotate_left(1);
        self.used -= 1;
    }
}
