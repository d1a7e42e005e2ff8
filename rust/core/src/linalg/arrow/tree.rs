//! A chain as a tree: its groups are the leaves, merged two by two up to one.

use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use super::form::{Form, Side};
use super::group::{Context, Group};
use super::merge::Merge;
use super::own::Own;
use super::products::Products;
use super::top::Top;
use crate::interrupt::current;
use crate::linalg::KktError;
use crate::threads::{prelude::*, thread_index};

/// A group, or two merged.
#[derive(Clone, Copy, Debug)]
enum Node {
    Group(usize),
    Merge(usize, usize),
}

/// Merges that can be made at the same time, each with what it merges.
type Level = Vec<(Node, Node, Merge)>;

/// Fewer merges than so many are not worth waking other threads.
const FEW: usize = 8;

/// A chain: groups, and levels of merges up to one.
#[derive(Debug)]
pub(super) struct Tree {
    pub groups: Vec<Group>,
    levels: Vec<Level>,
    root: Node,
    pub top: Top,
    /// Right-hand side, what is left of it, and solution.
    pub right: Own,
    pub rest: Own,
    pub solution: Own,
    /// The sizes of the terms of a segment's rows.
    pub sizes: Vec<f64>,
    /// States at the ends of groups; the first is that of the chain.
    ends: Vec<f64>,
}

impl Tree {
    /// A tree over groups between the given segments.
    pub fn new(context: &Context<'_>, ends: &[usize]) -> Tree {
        let (shape, plan) = (context.shape, context.plan);
        let n = shape.n;
        let groups: Vec<Group> = ends.windows(2).map(|w| Group::new(context, w[0]..w[1])).collect();
        let mut nodes: Vec<Node> = (0..groups.len()).map(Node::Group).collect();
        let mut levels = Vec::new();
        while nodes.len() > 1 {
            let (mut level, mut next) = (Vec::new(), Vec::new());
            for pair in nodes.chunks(2) {
                next.push(match *pair {
                    [left, right] => {
                        let groups = span_of(&levels, left) + span_of(&levels, right);
                        level.push((left, right, Merge::new(shape, groups)));
                        Node::Merge(levels.len(), level.len() - 1)
                    }
                    [one] => one,
                    _ => unreachable!("chunks of two"),
                });
            }
            levels.push(level);
            nodes = next;
        }
        let (rows, k) = (plan.row(plan.chain.segments, n), plan.chain.boundary.states.len());
        Tree {
            root: nodes[0],
            ends: vec![0.0; (groups.len() + 1) * n],
            groups,
            levels,
            top: Top::new(shape, k),
            sizes: vec![0.0; n * (plan.chain.points + plan.most_ties())],
            right: Own::new(n, rows, k),
            rest: Own::new(n, rows, k),
            solution: Own::new(n, rows, k),
        }
    }

    /// Eliminates the interior of all groups. There is room for the sums of each thread that works in parallel.
    pub fn eliminate(
        &mut self,
        context: &Context<'_>,
        room: &mut [Mutex<Products>],
        parallel: bool,
        hessian: &[f64],
        jacobian: &[f64],
    ) -> Result<(), KktError> {
        let interrupt = current();
        let done = if parallel {
            let work = |g: &mut Group| {
                let own = thread_index() % room.len();
                // Nothing is left in it that matters after a panic.
                let mut products = room[own].lock().unwrap_or_else(PoisonError::into_inner);
                g.factorize(context, &mut products, hessian, jacobian, &interrupt)
            };
            self.groups.par_iter_mut().map(work).find_first(Result::is_err).unwrap_or(Ok(()))
        } else {
            let products = room[0].get_mut().unwrap_or_else(PoisonError::into_inner);
            let work = |g: &mut Group| g.factorize(context, products, hessian, jacobian, &interrupt);
            self.groups.iter_mut().try_for_each(work)
        };
        // Groups number the rows of their chain.
        done.map_err(|error| match error {
            KktError::Dependent { row } => {
                KktError::Dependent { row: context.plan.constraint(row.0, context.shape.n) }
            }
            other => other,
        })
    }

    /// Merges the groups up to one, and finds the reduced Hessian of that; `units` are reciprocals.
    pub fn merge(
        &mut self,
        context: &Context<'_>,
        units: &[f64],
        jacobian: &[f64],
        parallel: bool,
    ) -> Result<(), KktError> {
        let (shape, plan) = (context.shape, context.plan);
        let Tree { groups, levels, root, top, .. } = self;
        let interrupt = current();
        for l in 0..levels.len() {
            let (done, level) = levels.split_at_mut(l);
            let form = |node: &Node| of(groups, done, *node).0;
            let work = |(left, right, merge): &mut (Node, Node, Merge)| {
                !interrupt.stops() && merge.factorize(shape, form(left), form(right))
            };
            let fine = if level[0].len() > FEW && parallel {
                level[0].par_iter_mut().map(work).all(|x| x)
            } else {
                level[0].iter_mut().map(work).fold(true, |a, b| a & b)
            };
            // The states between two groups always follow, unless a coefficient is too large.
            if !fine {
                return Err(if interrupt.stops() { KktError::Stopped } else { KktError::NotFinite });
            }
        }
        let columns = shape.n + shape.used();
        top.boundary.fill(0.0);
        for (entry, place) in plan.boundary.of(0) {
            let (row, column) = (place / columns, place % columns);
            top.boundary[place] += jacobian[entry] * plan.boundary_factor(units, row, column);
        }
        top.factorize(shape, of(groups, levels, *root).0)
    }

    /// Reduces the chain's residual to the border's right-hand side, to which it is added.
    pub fn reduce(&mut self, context: &Context<'_>, border: &mut [f64], parallel: bool) {
        let shape = context.shape;
        let Tree { groups, levels, root, top, rest, .. } = self;
        each(groups, parallel, |_, group| group.reduce(context, &rest.x, &rest.lambda, &rest.first));
        for l in 0..levels.len() {
            let (done, level) = levels.split_at_mut(l);
            for (left, right, merge) in &mut level[0] {
                merge.reduce(shape, of(groups, done, *left).1, of(groups, done, *right).1);
            }
        }
        top.target.copy_from_slice(&rest.boundary);
        let (form, side) = of(groups, levels, *root);
        top.reduce(shape, form, side, border);
    }

    /// Expands the border's solution to every point; adds to the solution.
    pub fn expand(&mut self, context: &Context<'_>, border: &[f64], parallel: bool) {
        let (shape, n) = (context.shape, context.shape.n);
        let Tree { groups, levels, root, top, rest, solution, ends, .. } = self;
        let (form, side) = of_mut(groups, levels, *root);
        top.expand(shape, form, side, border);
        let theta = &border[..shape.border];
        // Which groups a node spans follows from its place: from the left, each takes those it covers.
        let last = groups.len();
        ends[..n].copy_from_slice(&top.v[..n]);
        ends[last * n..].copy_from_slice(&top.v[n..2 * n]);
        descend(context, groups, levels, *root, 0..last, ends, theta);
        each(groups, parallel, |g, group| group.expand(context, &ends[g * n..(g + 1) * n], theta, &rest.x));
        add(&mut solution.first, &ends[..n]);
        add(&mut solution.boundary, &top.multipliers);
        let mut own = 0;
        for group in groups {
            let next = own + group.y.len();
            add(&mut solution.x[own..next], &group.y);
            add(&mut solution.lambda[own..next], &group.lambda);
            own = next;
        }
    }
}

/// Works on all groups, each with its number.
fn each(groups: &mut [Group], parallel: bool, work: impl Fn(usize, &mut Group) + Sync) {
    let work = |(g, group)| work(g, group);
    if parallel {
        groups.par_iter_mut().enumerate().for_each(work);
    } else {
        groups.iter_mut().enumerate().for_each(work);
    }
}

/// to += from
pub(super) fn add(to: &mut [f64], from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(t, f)| *t += f);
}

/// States between groups and multipliers of their constraints, from a node's ends down.
fn descend(
    context: &Context<'_>,
    groups: &mut [Group],
    levels: &mut [Level],
    node: Node,
    span: Range<usize>,
    ends: &mut [f64],
    theta: &[f64],
) {
    let Node::Merge(l, i) = node else { return };
    let n = context.shape.n;
    let (below, level) = levels.split_at_mut(l);
    let (left, right, merge) = &mut level[0][i];
    let (left, right) = (*left, *right);
    let middle = span.start + span_of(below, left);
    merge.v[..n].copy_from_slice(&ends[span.start * n..(span.start + 1) * n]);
    merge.v[n..2 * n].copy_from_slice(&ends[span.end * n..(span.end + 1) * n]);
    merge.v[2 * n..].copy_from_slice(theta);
    merge.expand(context.shape, &mut ends[middle * n..(middle + 1) * n]);
    of_mut(groups, below, left).1.multiplier.copy_from_slice(&merge.multipliers[..n]);
    of_mut(groups, below, right).1.multiplier.copy_from_slice(&merge.multipliers[n..]);
    descend(context, groups, below, left, span.start..middle, ends, theta);
    descend(context, groups, below, right, middle..span.end, ends, theta);
}

/// Number of groups of a node.
fn span_of(levels: &[Level], node: Node) -> usize {
    match node {
        Node::Group(_) => 1,
        Node::Merge(l, i) => levels[l][i].2.groups,
    }
}

/// Returns the remaining form of a node.
fn of<'a>(groups: &'a [Group], levels: &'a [Level], node: Node) -> (&'a Form, &'a Side) {
    match node {
        Node::Group(g) => (&groups[g].form, &groups[g].side),
        Node::Merge(l, i) => (&levels[l][i].2.form, &levels[l][i].2.side),
    }
}

/// Returns the remaining form of a node, to write the multiplier.
fn of_mut<'a>(groups: &'a mut [Group], levels: &'a mut [Level], node: Node) -> (&'a Form, &'a mut Side) {
    match node {
        Node::Group(g) => (&groups[g].form, &mut groups[g].side),
        Node::Merge(l, i) => {
            let merge = &mut levels[l][i].2;
            (&merge.form, &mut merge.side)
        }
    }
}
