//! The Newton system of chains of segments with a border, from the inside out.
//!
//! ```text
//!   segments  →  groups  →  chains  →  border
//!   LU of each    affine in    orthogonal      one small dense
//!   segment       their start  elimination     Cholesky
//! ```
//!
//! The constraints determine all states but n a chain, so the null space of A is small: it is spanned by
//! those and the border. Everything else is elimination, and it is the elimination that must be stable.
//! Within a [group] of segments the states follow from its first; this is condensing, as in single
//! shooting, and as harmful where small changes grow, so a group ends where they have grown by
//! [`group::GROWTH`]. Between groups orthogonal transformations are stable for any well-posed problem
//! ([merge]). No step needs the Hessian to be positive, and the zero block is never touched. The reduced
//! Hessian comes out explicitly ([root]): its inertia decides whether a step minimises, its inverse is
//! the covariance of the parameters.
//!
//! Where no equation joins some states with others, as between modes, each such [part] is eliminated by
//! itself: the work falls with the square of their number.
//!
//! Groups are independent and run in parallel, and so are merges of one level. Their division depends on
//! the problem alone, and sums have a fixed order: results do not depend on the number of threads.

#![allow(clippy::needless_range_loop)] // the notation of matrices: one index into several arrays

mod dense;
mod group;
mod merge;
mod part;
mod plan;
mod products;
mod root;

use std::sync::{Mutex, PoisonError};

use nalgebra::DMatrix;
use rayon::prelude::*;

use group::{Context, Form, Group, Side};
use merge::Merge;
use plan::{Part, Plan, Run, Shape};
use products::Products;
use root::{Border, Top};

use super::{Curvature, KktSolver, Singular, covariance_by_solving};
use crate::nlp::{Chains, Structure};

/// Most segments of a group.
const GROUP: usize = 128;
/// More groups than so many times the least are too many in a hurry, and a few.
const MANY: (usize, usize) = (4, 64);
/// Least number of points for which waking other threads pays.
const PARALLEL_POINTS: usize = 2000;
/// Residuals of a solution, relative to its terms, that are refined.
const ROUGH: f64 = 1e-13;
/// Most steps of refinement.
const REFINEMENTS: usize = 3;

/// A group, or two merged.
#[derive(Clone, Copy, Debug)]
enum Node {
    Group(usize),
    Merge(usize, usize),
}

/// A chain: groups, and levels of merges up to one.
#[derive(Debug)]
struct Tree {
    groups: Vec<Group>,
    levels: Vec<Vec<(Node, Node, Merge)>>,
    root: Node,
    top: Top,
    /// Right-hand side, what is left of it, and solution.
    right: Own,
    rest: Own,
    solution: Own,
    /// Of the terms of a segment's rows.
    sizes: Vec<f64>,
    /// States at the ends of groups; the first is that of the chain.
    ends: Vec<f64>,
}

/// A vector of the system on a chain, in units: of its first point, its own variables, its own rows and its
/// boundary conditions.
#[derive(Clone, Debug)]
struct Own {
    first: Vec<f64>,
    x: Vec<f64>,
    lambda: Vec<f64>,
    boundary: Vec<f64>,
}

impl Own {
    fn new(n: usize, rows: usize, k: usize) -> Own {
        Own { first: vec![0.0; n], x: vec![0.0; rows], lambda: vec![0.0; rows], boundary: vec![0.0; k] }
    }

    fn copy(&mut self, other: &Own) {
        self.first.copy_from_slice(&other.first);
        self.x.copy_from_slice(&other.x);
        self.lambda.copy_from_slice(&other.lambda);
        self.boundary.copy_from_slice(&other.boundary);
    }

    fn clear(&mut self) {
        self.first.fill(0.0);
        self.x.fill(0.0);
        self.lambda.fill(0.0);
        self.boundary.fill(0.0);
    }
}

/// The factorisation. See the [module](self).
#[derive(Debug)]
pub struct ArrowKkt {
    plan: Plan,
    /// 1/unit of each state, and its unit.
    units: Vec<f64>,
    inverse: Vec<f64>,
    trees: Vec<Tree>,
    /// Where groups sum: one for each thread.
    products: Vec<Mutex<Products>>,
    sizes: (usize, usize),
    /// Entries of the last factorisation, for refinement.
    jacobian: Vec<f64>,
    /// Hessian of the border alone.
    outer: Vec<f64>,
    /// Reduced Hessian of the border without what the chains take off.
    s: Vec<f64>,
    diagonal: Vec<f64>,
    eliminated: Vec<f64>,
    border: Border,
    held: Vec<bool>,
    shift: f64,
    /// Of the border: right-hand side, what is left of it (solved in place), solution.
    right: Vec<f64>,
    theta: Vec<f64>,
    solution: Vec<f64>,
    weak: Vec<Vec<(usize, f64)>>,
    refine: bool,
    /// Whether the entries of the last factorisation are kept for that: always where groups are split.
    refining: bool,
    least_groups: usize,
    /// Factorisations until groups that were split are tried whole again, and how many these were last time.
    wait: (u32, u32),
    hurry: bool,
    pool: Option<rayon::ThreadPool>,
    parallel: bool,
}

impl ArrowKkt {
    /// Plans the elimination for a structure; `units` are those of the n_x states: a step of that size
    /// matters. `None` where the entries do not fit the chains.
    pub fn new(
        chains: &Chains,
        hessian: &Structure,
        jacobian: &Structure,
        sizes: (usize, usize),
        units: &[f64],
    ) -> Option<ArrowKkt> {
        let plan = Plan::new(chains, hessian, jacobian, sizes, units)?;
        let border = plan.shape.border;
        let mut arrow = ArrowKkt {
            units: units.iter().map(|u| 1.0 / u).collect(),
            inverse: units.to_vec(),
            trees: Vec::new(),
            products: Vec::new(),
            sizes,
            jacobian: vec![0.0; jacobian.len()],
            outer: vec![0.0; border * border],
            s: vec![0.0; border * border],
            diagonal: vec![0.0; border],
            eliminated: vec![0.0; border * border],
            border: Border::default(),
            held: vec![false; border],
            shift: 0.0,
            right: vec![0.0; border],
            theta: vec![0.0; border],
            solution: vec![0.0; border],
            weak: Vec::new(),
            refine: true,
            refining: true,
            least_groups: 0,
            wait: (0, 0),
            hurry: false,
            pool: None,
            parallel: sizes.0 >= PARALLEL_POINTS * plan.shape.n,
            plan,
        };
        arrow.trees = arrow.whole();
        arrow.least_groups = arrow.groups();
        let threads = if arrow.parallel { rayon::current_num_threads() } else { 1 };
        arrow.make_room(threads);
        Some(arrow)
    }

    /// Works on so many threads; 0 for as many as there are cores. Results are the same.
    pub fn with_threads(mut self, threads: usize) -> ArrowKkt {
        self.parallel &= threads != 1;
        if threads > 1 {
            // Without a pool of its own the work goes to the common one: slower or faster, not wrong.
            self.pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().ok();
            self.make_room(threads);
        }
        self
    }

    fn make_room(&mut self, threads: usize) {
        self.products = (0..threads).map(|_| Mutex::new(Products::new(&self.plan.shape))).collect();
    }

    /// Trees with no group ended early.
    fn whole(&self) -> Vec<Tree> {
        let tree = |(c, plan): (usize, &plan::ChainPlan)| {
            let segments = plan.chain.segments;
            let count = segments.div_ceil(GROUP);
            let ends: Vec<usize> = (0..=count).map(|g| g * segments / count).collect();
            self.tree(c, &ends)
        };
        self.plan.chains.iter().enumerate().map(tree).collect()
    }

    /// A tree over groups between the given segments.
    fn tree(&self, c: usize, ends: &[usize]) -> Tree {
        let (shape, plan) = (&self.plan.shape, &self.plan.chains[c]);
        let n = shape.n;
        let context = Context { shape, plan };
        let groups: Vec<Group> = ends.windows(2).map(|w| Group::new(&context, w[0]..w[1])).collect();
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

    /// Tries groups whole again after a while: it may have been but a bad iterate at which small changes
    /// grew. Each time in vain the next is put off longer.
    fn rejoin(&mut self) {
        if self.groups() == self.least_groups {
            self.wait = (0, 0);
        } else if self.wait.0 == 0 {
            self.trees = self.whole();
            self.wait = (2 * self.wait.1 + 1, 2 * self.wait.1 + 1);
        } else {
            self.wait.0 -= 1;
        }
    }

    /// Number of places where small changes have grown too far.
    fn splits(&self) -> usize {
        self.trees.iter().flat_map(|t| &t.groups).map(|g| g.splits.len()).sum()
    }

    /// Ends groups where small changes have grown too far; whether there were any.
    fn split(&mut self) -> bool {
        let mut any = false;
        for c in 0..self.trees.len() {
            let groups = &self.trees[c].groups;
            if groups.iter().all(|g| g.splits.is_empty()) {
                continue;
            }
            any = true;
            let mut ends = vec![0];
            for group in groups {
                ends.extend(&group.splits);
                ends.push(group.segments.end);
            }
            self.trees[c] = self.tree(c, &ends);
        }
        any
    }

    /// Number of groups of all chains: more than the least where the system is unstable.
    pub fn groups(&self) -> usize {
        self.trees.iter().map(|t| t.groups.len()).sum()
    }

    fn eliminate(&mut self, hessian: &[f64], jacobian: &[f64]) -> Result<(), Singular> {
        let (shape, parallel) = (&self.plan.shape, self.parallel);
        for (tree, plan) in self.trees.iter_mut().zip(&self.plan.chains) {
            let context = Context { shape, plan };
            let done = if parallel {
                let work = |g: &mut Group| {
                    let own = rayon::current_thread_index().unwrap_or(0) % self.products.len();
                    // Nothing is left in it that matters after a panic.
                    let mut products = self.products[own].lock().unwrap_or_else(PoisonError::into_inner);
                    g.factorize(&context, &mut products, hessian, jacobian)
                };
                tree.groups.par_iter_mut().map(work).reduce(|| Ok(()), Result::and)
            } else {
                let products = self.products[0].get_mut().unwrap_or_else(PoisonError::into_inner);
                tree.groups.iter_mut().try_for_each(|g| g.factorize(&context, products, hessian, jacobian))
            };
            done.map_err(|row| Singular { row: global_row(plan, shape.n, row) })?;
        }
        Ok(())
    }

    fn merge(&mut self, hessian: &[f64], jacobian: &[f64]) -> Result<(), Singular> {
        let shape = &self.plan.shape;
        self.outer.fill(0.0);
        for &(entry, row, column) in &self.plan.border {
            let (row, column, value) = (row as usize, column as usize, hessian[entry as usize]);
            self.outer[row * shape.border + column] += value;
            if row != column {
                self.outer[column * shape.border + row] += value;
            }
        }
        self.s.copy_from_slice(&self.outer);
        for (tree, plan) in self.trees.iter_mut().zip(&self.plan.chains) {
            let singular = Singular { row: plan.chain.row };
            for l in 0..tree.levels.len() {
                let (done, level) = tree.levels.split_at_mut(l);
                let form = |node: &Node| form_of(&tree.groups, done, *node);
                let work = |(left, right, merge): &mut (Node, Node, Merge)| {
                    merge.factorize(shape, form(left), form(right))
                };
                let fine = if level[0].len() > 8 && self.parallel {
                    level[0].par_iter_mut().map(work).all(|x| x)
                } else {
                    level[0].iter_mut().map(work).fold(true, |a, b| a & b)
                };
                if !fine {
                    return Err(singular);
                }
            }
            let columns = shape.n + shape.used();
            tree.top.boundary.fill(0.0);
            for (entry, place) in plan.boundary.of(0) {
                let (row, column) = (place / columns, place % columns);
                tree.top.boundary[place] += jacobian[entry] * boundary_factor(&self.units, plan, row, column);
            }
            if !tree.top.factorize(shape, form_of(&tree.groups, &tree.levels, tree.root)) {
                return Err(singular);
            }
            tree.top.add_border(shape, &mut self.s);
        }
        for (i, d) in self.diagonal.iter_mut().enumerate() {
            *d = self.s[i * shape.border + i];
        }
        if self.s.iter().all(|x| x.is_finite()) { Ok(()) } else { Err(Singular { row: 0 }) }
    }

    /// Takes a right-hand side, into units and the order of own rows.
    fn take(&mut self, p: &[f64], q: &[f64]) {
        let (n, border) = (self.plan.shape.n, self.plan.shape.border);
        self.right.copy_from_slice(&p[..border]);
        self.theta.copy_from_slice(&p[..border]);
        self.solution.fill(0.0);
        for (tree, plan) in self.trees.iter_mut().zip(&self.plan.chains) {
            let (variable, inverse) = (plan.chain.variable, &self.inverse);
            gather(plan, variable + n, |t| t.variable, inverse, p, &mut tree.right.x);
            gather(plan, plan.chain.row, |t| t.row, &self.units, q, &mut tree.right.lambda);
            scale(&p[variable..variable + n], inverse, &mut tree.right.first);
            let boundary = &plan.chain.boundary;
            for ((to, q), &s) in tree.right.boundary.iter_mut().zip(&q[boundary.row..]).zip(&boundary.states)
            {
                *to = q * self.units[s];
            }
            tree.rest.copy(&tree.right);
            tree.solution.clear();
        }
    }

    /// The solution as the program has it.
    fn give(&self, d: &mut [f64], lambda: &mut [f64]) {
        let (n, border) = (self.plan.shape.n, self.plan.shape.border);
        d[..border].copy_from_slice(&self.solution);
        for (tree, plan) in self.trees.iter().zip(&self.plan.chains) {
            let (variable, inverse) = (plan.chain.variable, &self.inverse);
            scatter(plan, variable + n, |t| t.variable, inverse, &tree.solution.x, d);
            scatter(plan, plan.chain.row, |t| t.row, &self.units, &tree.solution.lambda, lambda);
            scale(&tree.solution.first, inverse, &mut d[variable..variable + n]);
            let boundary = &plan.chain.boundary;
            let own = tree.solution.boundary.iter().zip(&boundary.states);
            for (to, (x, &s)) in lambda[boundary.row..].iter_mut().zip(own) {
                *to = x * self.units[s];
            }
        }
    }

    /// Solves for what is left of the right-hand side, and adds that to the solution.
    fn solve_rest(&mut self) {
        let shape = &self.plan.shape;
        let n = shape.n;
        let parallel = self.parallel;
        for (tree, plan) in self.trees.iter_mut().zip(&self.plan.chains) {
            let Tree { groups, levels, root, top, rest, .. } = tree;
            let context = Context { shape, plan };
            let reduce = |g: &mut Group| g.reduce(&context, &rest.x, &rest.lambda, &rest.first);
            if parallel {
                groups.par_iter_mut().for_each(reduce)
            } else {
                groups.iter_mut().for_each(reduce)
            }
            for l in 0..levels.len() {
                let (done, level) = levels.split_at_mut(l);
                for (left, right, merge) in &mut level[0] {
                    merge.reduce(shape, side_of(groups, done, *left), side_of(groups, done, *right));
                }
            }
            top.target.copy_from_slice(&rest.boundary);
            top.reduce(
                shape,
                form_of(groups, levels, *root),
                side_of(groups, levels, *root),
                &mut self.theta,
            );
        }
        self.theta.iter_mut().zip(&self.held).for_each(|(t, held)| {
            if *held {
                *t = 0.0
            }
        });
        self.border.solve(&mut self.theta);
        add(&mut self.solution, &self.theta);
        for (tree, plan) in self.trees.iter_mut().zip(&self.plan.chains) {
            tree.expand(shape, plan, &self.theta, parallel);
            add(&mut tree.solution.first, &tree.ends[..n]);
            add(&mut tree.solution.boundary, &tree.top.multipliers);
            let mut own = 0;
            for group in &tree.groups {
                let next = own + group.y.len();
                add(&mut tree.solution.x[own..next], &group.y);
                add(&mut tree.solution.lambda[own..next], &group.lambda);
                own = next;
            }
        }
    }

    /// Runs on the pool that was asked for.
    fn on_threads<R: Send>(&mut self, work: impl FnOnce(&mut Self) -> R + Send) -> R {
        match self.pool.take() {
            Some(pool) => {
                let result = pool.install(|| work(self));
                self.pool = Some(pool);
                result
            }
            None => work(self),
        }
    }

    /// What the solution leaves of the right-hand side; the largest rest of a constraint relative to its
    /// terms.
    fn residual(&mut self) -> f64 {
        let shape = &self.plan.shape;
        let border = shape.border;
        for (i, (rest, right)) in self.theta.iter_mut().zip(&self.right).enumerate() {
            let row = &self.outer[i * border..(i + 1) * border];
            *rest = right - row.iter().zip(&self.solution).map(|(h, x)| h * x).sum::<f64>();
        }
        let mut worst: f64 = 0.0;
        for (tree, plan) in self.trees.iter_mut().zip(&self.plan.chains) {
            tree.rest.copy(&tree.right);
            let border = (&*self.solution, &mut *self.theta);
            worst = worst.max(tree.residual(shape, plan, &self.units, &self.jacobian, border));
        }
        for (rest, held) in self.theta.iter_mut().zip(&self.held) {
            if *held {
                *rest = 0.0;
            }
        }
        worst
    }
}

impl Tree {
    /// From the border's solution down to every point.
    fn expand(&mut self, shape: &Shape, plan: &plan::ChainPlan, theta: &[f64], parallel: bool) {
        let n = shape.n;
        let Tree { groups, levels, root, top, rest, ends, .. } = self;
        match *root {
            Node::Group(g) => {
                let Group { form, side, .. } = &mut groups[g];
                top.expand(shape, form, side, theta);
            }
            Node::Merge(l, i) => {
                let Merge { form, side, .. } = &mut levels[l][i].2;
                top.expand(shape, form, side, theta);
            }
        }
        // Which groups a node spans follows from its place: from the left, each takes those it covers.
        let last = groups.len();
        ends[..n].copy_from_slice(&top.v[..n]);
        ends[last * n..].copy_from_slice(&top.v[n..2 * n]);
        descend(shape, groups, levels, *root, 0..last, ends, theta);
        let context = Context { shape, plan };
        let work = |(g, group): (usize, &mut Group)| {
            group.expand(&context, &ends[g * n..(g + 1) * n], theta, &rest.x);
        };
        if parallel {
            groups.par_iter_mut().enumerate().for_each(work);
        } else {
            groups.iter_mut().enumerate().for_each(work);
        }
    }

    /// Takes off `rest` what the solution makes, and off that of the border; see [`ArrowKkt::residual`].
    fn residual(
        &mut self,
        shape: &Shape,
        plan: &plan::ChainPlan,
        units: &[f64],
        jacobian: &[f64],
        (border, theta): (&[f64], &mut [f64]),
    ) -> f64 {
        let (n, d) = (shape.n, plan.d);
        let Tree { groups, solution, rest, sizes, .. } = self;
        let mut worst: f64 = 0.0;
        for s in 0..plan.chain.segments {
            let (row, end) = (plan.row(s, n), plan.row(s + 1, n));
            let size = &mut sizes[..end - row];
            for (i, size) in size.iter_mut().enumerate() {
                *size = rest.lambda[row + i].abs();
                if i >= d {
                    // A tie's own variable.
                    rest.lambda[row + i] -= solution.x[row + i];
                    *size += solution.x[row + i].abs();
                    rest.x[row + i] -= solution.lambda[row + i];
                }
            }
            for (part, own) in shape.parts.iter().zip(&plan.parts) {
                let (right, length) = (Part::right(part.rows(plan.chain.points)), own.columns.len());
                for (entry, place) in own.jacobian.of(s) {
                    let (i, column) = (place / length, place % length);
                    // Columns after the first d stand on the right-hand side.
                    let (at, i) = own.place[i];
                    let a = jacobian[entry] * own.rows[at as usize] * own.columns[column].abs();
                    let i = i as usize;
                    let (x, p) = if column < right {
                        let core = row + own.place[column].1 as usize;
                        (solution.x[core], &mut rest.x[core])
                    } else if column >= right + part.states.len() {
                        let b = shape.dynamic[part.dynamic[column - right - part.states.len()]];
                        (border[b], &mut theta[b])
                    } else if s == 0 {
                        let state = part.states[column - right];
                        (solution.first[state], &mut rest.first[state])
                    } else {
                        let before = plan.row(s - 1, n) + d - n + part.states[column - right];
                        (solution.x[before], &mut rest.x[before])
                    };
                    *p -= a * solution.lambda[row + i];
                    rest.lambda[row + i] -= a * x;
                    size[i] += (a * x).abs();
                }
            }
            for (rest, size) in rest.lambda[row..end].iter().zip(size) {
                if *size > 0.0 {
                    worst = worst.max(rest.abs() / *size);
                }
            }
        }
        let (columns, last) = (n + shape.used(), plan.row(plan.chain.segments - 1, n) + d - n);
        sizes.iter_mut().zip(&rest.boundary).for_each(|(s, r)| *s = r.abs());
        for (entry, place) in plan.boundary.of(0) {
            let (i, column) = (place / columns, place % columns);
            let a = jacobian[entry] * boundary_factor(units, plan, i, column);
            let (x, p) = if column < n {
                (solution.first[column], &mut rest.first[column])
            } else if column < 2 * n {
                (solution.x[last + column - n], &mut rest.x[last + column - n])
            } else {
                let b = shape.dynamic[column - 2 * n];
                (border[b], &mut theta[b])
            };
            *p -= a * solution.boundary[i];
            rest.boundary[i] -= a * x;
            sizes[i] += (a * x).abs();
        }
        for (rest, size) in rest.boundary.iter().zip(&*sizes) {
            if *size > 0.0 {
                worst = worst.max(rest.abs() / size);
            }
        }
        let context = Context { shape, plan };
        let mut bend = |x: &mut [f64], y: &[f64], run: &Run, values: &[f64]| {
            let i = run.state as usize;
            for (j, value) in run.others().zip(values) {
                if run.coupled {
                    let b = shape.coupled[j];
                    x[i] -= value * border[b];
                    theta[b] -= value * y[i];
                } else {
                    x[i] -= value * y[j];
                    if i != j {
                        x[j] -= value * y[i];
                    }
                }
            }
        };
        for group in groups {
            group.curvature(&context, |point, run, values| match point {
                None => bend(&mut rest.first, &solution.first, run, values),
                Some(own) => bend(&mut rest.x[own..own + n], &solution.x[own..own + n], run, values),
            });
        }
        worst
    }
}

/// What an entry of a boundary condition is multiplied by; `units` are reciprocals.
fn boundary_factor(units: &[f64], plan: &plan::ChainPlan, row: usize, column: usize) -> f64 {
    let n = units.len();
    let of_column = if column < 2 * n { 1.0 / units[column % n] } else { 1.0 };
    units[plan.chain.boundary.states[row]] * of_column
}

/// to += from
fn add(to: &mut [f64], from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(t, f)| *t += f);
}

/// States between groups and multipliers of their constraints, from a node's ends down.
fn descend(
    shape: &Shape,
    groups: &mut [Group],
    levels: &mut [Vec<(Node, Node, Merge)>],
    node: Node,
    span: std::ops::Range<usize>,
    ends: &mut [f64],
    theta: &[f64],
) {
    let Node::Merge(l, i) = node else { return };
    let n = shape.n;
    let (below, level) = levels.split_at_mut(l);
    let (left, right, merge) = &mut level[0][i];
    let (left, right) = (*left, *right);
    let middle = span.start + span_of(below, left);
    merge.v[..n].copy_from_slice(&ends[span.start * n..(span.start + 1) * n]);
    merge.v[n..2 * n].copy_from_slice(&ends[span.end * n..(span.end + 1) * n]);
    merge.v[2 * n..].copy_from_slice(theta);
    merge.expand(shape, &mut ends[middle * n..(middle + 1) * n]);
    side_mut(groups, below, left).multiplier.copy_from_slice(&merge.multipliers[..n]);
    side_mut(groups, below, right).multiplier.copy_from_slice(&merge.multipliers[n..]);
    descend(shape, groups, below, left, span.start..middle, ends, theta);
    descend(shape, groups, below, right, middle..span.end, ends, theta);
}

/// Number of groups of a node.
fn span_of(levels: &[Vec<(Node, Node, Merge)>], node: Node) -> usize {
    match node {
        Node::Group(_) => 1,
        Node::Merge(l, i) => levels[l][i].2.groups,
    }
}

fn form_of<'a>(groups: &'a [Group], levels: &'a [Vec<(Node, Node, Merge)>], node: Node) -> &'a Form {
    match node {
        Node::Group(g) => &groups[g].form,
        Node::Merge(l, i) => &levels[l][i].2.form,
    }
}

fn side_of<'a>(groups: &'a [Group], levels: &'a [Vec<(Node, Node, Merge)>], node: Node) -> &'a Side {
    match node {
        Node::Group(g) => &groups[g].side,
        Node::Merge(l, i) => &levels[l][i].2.side,
    }
}

fn side_mut<'a>(
    groups: &'a mut [Group],
    levels: &'a mut [Vec<(Node, Node, Merge)>],
    node: Node,
) -> &'a mut Side {
    match node {
        Node::Group(g) => &mut groups[g].side,
        Node::Merge(l, i) => &mut levels[l][i].2.side,
    }
}

/// From the order of the program to that of own rows, each number multiplied by the factor of its
/// component.
fn gather(
    plan: &plan::ChainPlan,
    core: usize,
    tie: impl Fn(&crate::nlp::Tie) -> usize,
    factors: &[f64],
    from: &[f64],
    to: &mut [f64],
) {
    places(plan, factors.len(), core, tie, |program, own, count| {
        scale(&from[program..program + count], factors, &mut to[own..own + count]);
    });
}

/// And back.
fn scatter(
    plan: &plan::ChainPlan,
    core: usize,
    tie: impl Fn(&crate::nlp::Tie) -> usize,
    factors: &[f64],
    from: &[f64],
    to: &mut [f64],
) {
    places(plan, factors.len(), core, tie, |program, own, count| {
        scale(&from[own..own + count], factors, &mut to[program..program + count]);
    });
}

/// Calls `each` with the first place in the program, the first own row and the number of rows for all
/// that stands together in both.
fn places(
    plan: &plan::ChainPlan,
    n: usize,
    core: usize,
    tie: impl Fn(&crate::nlp::Tie) -> usize,
    mut each: impl FnMut(usize, usize, usize),
) {
    if plan.chain.ties.is_empty() {
        return each(core, 0, plan.row(plan.chain.segments, n));
    }
    for s in 0..plan.chain.segments {
        let row = plan.row(s, n);
        each(core + s * plan.d, row, plan.d);
        for (i, t) in plan.ties_of(s).iter().enumerate() {
            each(tie(t), row + plan.d + i * n, n);
        }
    }
}

fn scale(from: &[f64], factors: &[f64], to: &mut [f64]) {
    for (to, from) in to.chunks_exact_mut(factors.len()).zip(from.chunks_exact(factors.len())) {
        to.iter_mut().zip(from).zip(factors).for_each(|((t, x), f)| *t = x * f);
    }
}

/// The program's constraint of an own row.
fn global_row(plan: &plan::ChainPlan, n: usize, row: usize) -> usize {
    let s = (0..plan.chain.segments).rev().find(|&s| plan.row(s, n) <= row).unwrap_or(0);
    let i = row - plan.row(s, n);
    if i < plan.d {
        plan.chain.row + s * plan.d + i
    } else {
        plan.ties_of(s)[(i - plan.d) / n].row + (i - plan.d) % n
    }
}

impl KktSolver for ArrowKkt {
    fn factorize(&mut self, hessian: &[f64], jacobian: &[f64]) -> Result<(), Singular> {
        let done = self.on_threads(|arrow| {
            arrow.rejoin();
            arrow.eliminate(hessian, jacobian)?;
            let many = MANY.0 * arrow.least_groups + MANY.1;
            if arrow.hurry && arrow.groups() + arrow.splits() > many {
                return Err(Singular { row: 0 });
            }
            if arrow.split() {
                arrow.eliminate(hessian, jacobian)?;
            }
            arrow.merge(hessian, jacobian)
        });
        self.refining = self.refine || self.groups() > self.least_groups;
        if self.refining {
            self.jacobian.copy_from_slice(jacobian);
        }
        done
    }

    fn set_refinement(&mut self, on: bool) {
        self.refine = on;
    }

    fn set_hurry(&mut self, on: bool) {
        self.hurry = on;
    }

    fn finish(&mut self, held: &[bool], shift: f64) -> Curvature {
        let shape = &self.plan.shape;
        self.weak.clear();
        self.shift = shift;
        self.held.copy_from_slice(&held[..shape.border]);
        self.eliminated.copy_from_slice(&self.s);
        let mut found = Curvature::default();
        for (tree, plan) in self.trees.iter_mut().zip(&self.plan.chains) {
            let before = self.weak.len();
            let here = tree.top.eliminate(shape, shift, &mut self.eliminated, &mut self.weak);
            found.negative += here.negative;
            found.zero += here.zero;
            // Ends of the chain as variables of the program.
            let last = plan.chain.variable + plan.chain.segments * plan.d;
            for direction in &mut self.weak[before..] {
                for (i, _) in direction {
                    *i = if *i < shape.n { plan.chain.variable + *i } else { last + *i - shape.n };
                }
            }
        }
        if !found.is_positive() {
            return found;
        }
        self.border.factorize(&self.eliminated, &self.diagonal, &self.held, shift, &mut self.weak)
    }

    fn solve(&mut self, p: &[f64], q: &[f64], d: &mut [f64], lambda: &mut [f64]) {
        self.on_threads(|arrow| {
            arrow.take(p, q);
            arrow.solve_rest();
            // With a shift the step is damped anyway.
            if arrow.refining && arrow.shift == 0.0 {
                for _ in 0..REFINEMENTS {
                    if arrow.residual() <= ROUGH {
                        break;
                    }
                    arrow.solve_rest();
                }
            }
            arrow.give(d, lambda);
        });
    }

    fn weak_directions(&self) -> &[Vec<(usize, f64)>] {
        &self.weak
    }

    /// Between parameters and first states it is read off the reduced Hessian.
    fn covariance(&mut self, wanted: &[usize], out: &mut [f64]) {
        let (n, border, k) = (self.plan.shape.n, self.plan.shape.border, wanted.len());
        let mut of_border = DMatrix::<f64>::identity(border, border);
        for mut column in of_border.column_iter_mut() {
            self.border.solve(column.as_mut_slice());
        }
        for i in (0..border).filter(|&i| self.held[i]) {
            of_border.row_mut(i).fill(0.0);
            of_border.column_mut(i).fill(0.0);
        }
        // Everything wanted follows θ, and first states of one chain vary beside.
        let mut follow = DMatrix::zeros(k, border);
        let mut beside = DMatrix::<f64>::zeros(k, k);
        let mut found = 0;
        for (row, &i) in wanted.iter().enumerate().filter(|w| *w.1 < border) {
            follow[(row, i)] = 1.0;
            found += 1;
        }
        for (plan, tree) in self.plan.chains.iter().zip(&self.trees) {
            let first = plan.chain.variable..plan.chain.variable + n;
            let here: Vec<(usize, usize)> = wanted
                .iter()
                .enumerate()
                .filter(|w| first.contains(w.1))
                .map(|(row, i)| (row, i - first.start))
                .collect();
            if here.is_empty() {
                continue;
            }
            found += here.len();
            let (along, free) = tree.top.first_states(&self.plan.shape);
            for &(row, i) in &here {
                follow.row_mut(row).copy_from(&(along.row(i) / self.units[i]));
                for &(other, j) in &here {
                    beside[(row, other)] = free[(i, j)] / (self.units[i] * self.units[j]);
                }
            }
        }
        if found < k {
            return covariance_by_solving(self, wanted, out);
        }
        let all = &follow * of_border * follow.transpose() + beside;
        for (i, row) in out.chunks_exact_mut(k).enumerate() {
            row.iter_mut().enumerate().for_each(|(j, o)| *o = all[(i, j)]);
        }
    }

    fn sizes(&self) -> (usize, usize) {
        self.sizes
    }

    fn flops(&self) -> u64 {
        let shape = &self.plan.shape;
        let (n, w, f) = (shape.n as u64, shape.used() as u64, shape.form() as u64);
        let mut bent = (std::ptr::null(), 0); // that of most panels is that of the one before
        let mut segment = |plan: &plan::ChainPlan, s: usize| {
            let runs = plan.runs(s + 1);
            if runs.as_ptr() != bent.0 {
                bent = (runs.as_ptr(), self.plan.bent(runs));
            }
            let points = plan.points(s) as u64;
            let eliminate = shape.parts.iter().map(|part| {
                let (n, w) = (part.states.len() as u64, part.used() as u64);
                let (d, rows) = (part.rows(plan.chain.points) as u64, points * n);
                2 * d * d * d / 3 + 2 * (rows - d) * d * d + 2 * rows * d * w + 2 * rows * n * w
            });
            eliminate.sum::<u64>() + bent.1
        };
        let merge = 8 * n * n * (3 * n + w) + 2 * n * n * (2 * n + w) + 4 * n * (2 * n + w) * f;
        let top = 2 * f * 2 * n * f + 2 * f * f * n + f * f * f / 3;
        self.plan.chains.iter().zip(&self.trees).fold(0, |sum, (plan, tree)| {
            let segments: u64 = (0..plan.chain.segments).map(|s| segment(plan, s)).sum();
            sum + segments + merge * (tree.groups.len() as u64 - 1) + top
        })
    }
}
