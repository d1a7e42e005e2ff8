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
//! Hessian comes out explicitly ([top], [border]): its inertia decides whether a step minimises, its inverse
//! is the [covariance] of the parameters.
//!
//! Where no equation joins some states with others, as between modes, each such [part] is eliminated by
//! itself: the work falls with the square of their number.
//!
//! The [plan] says once which entry goes where: to which row of a segment ([part]), to which point ([chain]).
//! The numbers go through a [tree] a chain, its groups the leaves: [piece] and [lu] eliminate a segment of a
//! part, [products] sum the Hessian over the points of a group, and a [form] is what is left of it. The
//! [forest] of all trees splits groups, and joins them again. A [residual] is taken from the entries as they
//! came, so that solutions may be refined.
//!
//! Groups are independent and run in parallel, and so are merges of one level. Their division depends on
//! the problem alone, and sums have a fixed order: results do not depend on the number of threads.

#![allow(clippy::needless_range_loop)] // the notation of matrices: one index into several arrays

mod border;
mod chain;
mod covariance;
mod deferred;
mod forest;
mod form;
mod group;
mod items;
mod lu;
mod merge;
mod own;
mod part;
mod piece;
mod places;
mod plan;
mod products;
mod residual;
mod run;
mod shape;
mod top;
mod tree;
mod vectors;
mod work;

use std::sync::Mutex;

use border::Border;
use forest::Forest;
use group::Context;
use plan::Plan;
use products::Products;
use tree::add;

use super::{Curvature, Direction, Effort, Entries, Factor, KktError, KktSolver, covariance_by_solving};
use crate::dense::dot_of;
use crate::index::VariableId;
use crate::interrupt::current;
use crate::nlp::{Chains, Structure};
use crate::tape::lanes::all_finite;
use crate::threads::Threads;

/// Least number of points for which waking other threads pays.
const PARALLEL_POINTS: usize = 2000;
/// Residuals of a solution, relative to its terms, that are refined.
const ROUGH: f64 = 1024.0 * f64::EPSILON;
/// Most steps of refinement.
const REFINEMENTS: usize = 3;

/// The factorisation. See the [module](self).
#[derive(Debug)]
pub struct ArrowKkt {
    plan: Plan,
    /// 1/unit of each state, and its unit.
    units: Vec<f64>,
    inverse: Vec<f64>,
    forest: Forest,
    /// Sums of the groups: one for each thread.
    products: Vec<Mutex<Products>>,
    sizes: (usize, usize),
    /// Entries of the last factorisation, for refinement.
    jacobian: Vec<f64>,
    /// Hessian of the border alone.
    outer: Vec<f64>,
    /// Reduced Hessian of the border without what the chains take off. Its rows are those of the border variables, then
    /// of end states that stay beside them, one for each constraint that is deferred.
    s: Vec<f64>,
    /// The constraints that are deferred, rows as long, their right-hand sides and then their multipliers.
    constraints: Vec<f64>,
    constraint_side: Vec<f64>,
    diagonal: Vec<f64>,
    eliminated: Vec<f64>,
    border: Border,
    held: Vec<bool>,
    shift: f64,
    /// The border: right-hand side, its remainder (solved in place), solution.
    right: Vec<f64>,
    theta: Vec<f64>,
    solution: Vec<f64>,
    /// The remainder of a right-hand side in the border, and of that of its constraints, with nothing held.
    reduced: (Vec<f64>, Vec<f64>),
    weak: Vec<Direction>,
    effort: Effort,
    is_eliminated: bool,
    /// Steps of refinement of the last solution.
    refinements: usize,
    /// Whether the entries of the last factorisation are kept for that: always where groups are split.
    refining: bool,
    threads: Threads,
    parallel: bool,
}

impl ArrowKkt {
    /// Plans the elimination for a structure; `units` are those of the n_x states: a step of that size
    /// matters. `None` where the entries do not fit the chains, and where the work was stopped.
    pub fn new(
        chains: &Chains,
        hessian: &Structure,
        jacobian: &Structure,
        sizes: (usize, usize),
        units: &[f64],
    ) -> Option<ArrowKkt> {
        let plan = Plan::new(chains, hessian, jacobian, sizes, units)?;
        if current().stops() {
            return None;
        }
        let border = plan.shape.border;
        let mut arrow = ArrowKkt {
            forest: Forest::new(&plan),
            units: units.iter().map(|u| 1.0 / u).collect(),
            inverse: units.to_vec(),
            products: Vec::new(),
            sizes,
            jacobian: vec![0.0; jacobian.len()],
            outer: vec![0.0; border * border],
            s: vec![0.0; border * border],
            constraints: Vec::new(),
            constraint_side: Vec::new(),
            diagonal: vec![0.0; border],
            eliminated: vec![0.0; border * border],
            border: Border::default(),
            held: vec![false; border],
            shift: 0.0,
            right: vec![0.0; border],
            theta: vec![0.0; border],
            solution: vec![0.0; border],
            reduced: (Vec::new(), Vec::new()),
            weak: Vec::new(),
            effort: Effort::FULL,
            is_eliminated: false,
            refinements: 0,
            refining: true,
            threads: Threads::default(),
            parallel: sizes.0 >= PARALLEL_POINTS * plan.shape.n,
            plan,
        };
        arrow.make_room();
        Some(arrow)
    }

    /// Works on these threads. Results are the same.
    pub fn with_threads(mut self, threads: Threads) -> ArrowKkt {
        self.parallel = self.parallel && threads.number() > 1;
        self.threads = threads;
        self.make_room();
        self
    }

    fn make_room(&mut self) {
        let threads = if self.parallel { self.threads.number() } else { 1 };
        self.products = (0..threads).map(|_| Mutex::new(Products::new(&self.plan.shape))).collect();
    }

    /// Number of groups of all chains: more than the least where the system is unstable.
    pub fn groups(&self) -> usize {
        self.forest.groups()
    }

    /// Number of steps of refinement that the last solution took.
    pub fn refinements(&self) -> usize {
        self.refinements
    }

    /// Eliminates the interior of all groups.
    fn eliminate(&mut self, hessian: &[f64], jacobian: &[f64]) -> Result<(), KktError> {
        let ArrowKkt { plan, forest, products, parallel, .. } = self;
        for (tree, chain) in forest.trees.iter_mut().zip(&plan.chains) {
            let context = Context { shape: &plan.shape, plan: chain };
            tree.eliminate(&context, products, *parallel, hessian, jacobian)?;
        }
        Ok(())
    }

    /// Merges the groups of each chain, and adds up the reduced Hessian of the border.
    fn merge(&mut self, hessian: &[f64], jacobian: &[f64]) -> Result<(), KktError> {
        let shape = &self.plan.shape;
        self.outer.fill(0.0);
        for at in &self.plan.border {
            let (row, column, value) = (at.row as usize, at.column as usize, hessian[at.entry as usize]);
            self.outer[row * shape.border + column] += value;
            if row != column {
                self.outer[column * shape.border + row] += value;
            }
        }
        let border = shape.border;
        let mut size = border;
        for (tree, plan) in self.forest.trees.iter_mut().zip(&self.plan.chains) {
            tree.merge(&Context { shape, plan }, &self.units, jacobian, self.parallel)?;
            tree.top.place = size;
            size += tree.top.deferred();
        }
        self.s.clear();
        self.s.resize(size * size, 0.0);
        for (to, from) in self.s.chunks_exact_mut(size.max(1)).zip(self.outer.chunks_exact(border.max(1))) {
            to[..border].copy_from_slice(from);
        }
        self.constraints.resize((size - border) * size, 0.0);
        self.constraint_side.resize(size - border, 0.0);
        for tree in &self.forest.trees {
            let own =
                (tree.top.place - border) * size..(tree.top.place + tree.top.deferred() - border) * size;
            tree.top.add_border(shape, &mut self.s, size);
            tree.top.put_constraints(shape, &mut self.constraints[own], size.max(1));
        }
        self.diagonal.clear();
        self.diagonal.extend((0..size).map(|i| self.s[i * size + i]));
        self.held.resize(size, false);
        self.theta.resize(size, 0.0);
        if !all_finite(&self.s) || !all_finite(&self.constraints) {
            return Err(KktError::NotFinite);
        }
        let fine = self.border.can_meet(&self.constraints, &self.diagonal);
        if fine { Ok(()) } else { Err(KktError::Boundary) }
    }

    /// Eliminates everything but the border.
    pub(super) fn eliminate_all(&mut self, entries: &Entries<'_>, effort: Effort) -> Result<(), KktError> {
        (self.effort, self.is_eliminated) = (effort, false);
        let Entries { hessian, jacobian } = *entries;
        let done = self.on_threads(|arrow| {
            arrow.forest.rejoin(&arrow.plan);
            arrow.eliminate(hessian, jacobian)?;
            if effort.hurry && arrow.forest.grows_wildly() {
                return Err(KktError::TooCostly);
            }
            if arrow.forest.split(&arrow.plan) {
                arrow.eliminate(hessian, jacobian)?;
            }
            arrow.merge(hessian, jacobian)
        });
        // Comparisons with NaN find no pivot, as where there is none.
        done.map_err(|error| match error {
            KktError::Dependent { .. } if !all_finite(jacobian) => KktError::NotFinite,
            other => other,
        })?;
        self.refining = effort.refine || self.forest.is_split();
        if self.refining {
            self.jacobian.copy_from_slice(jacobian);
        }
        self.is_eliminated = true;
        Ok(())
    }

    /// Takes a right-hand side.
    fn take(&mut self, p: &[f64], q: &[f64]) {
        let border = self.plan.shape.border;
        self.right.copy_from_slice(&p[..border]);
        self.theta[..border].copy_from_slice(&p[..border]);
        self.solution.fill(0.0);
        for (tree, plan) in self.forest.trees.iter_mut().zip(&self.plan.chains) {
            tree.right.take(plan, (&self.units, &self.inverse), p, q);
            tree.rest.copy(&tree.right);
            tree.solution.clear();
        }
    }

    /// The solution as the program has it.
    fn give(&self, d: &mut [f64], lambda: &mut [f64]) {
        d[..self.plan.shape.border].copy_from_slice(&self.solution);
        for (tree, plan) in self.forest.trees.iter().zip(&self.plan.chains) {
            tree.solution.give(plan, (&self.units, &self.inverse), d, lambda);
        }
    }

    /// Brings what is left of the right-hand side to the border.
    fn reduce_rest(&mut self) {
        let (shape, parallel) = (&self.plan.shape, self.parallel);
        self.theta[shape.border..].fill(0.0);
        for (tree, plan) in self.forest.trees.iter_mut().zip(&self.plan.chains) {
            tree.reduce(&Context { shape, plan }, &mut self.theta, parallel);
            let own = tree.top.place - shape.border..tree.top.place - shape.border + tree.top.deferred();
            self.constraint_side[own].copy_from_slice(&tree.top.right);
        }
    }

    /// Solves for what is left of the right-hand side, and adds that to the solution.
    fn solve_rest(&mut self) {
        self.reduce_rest();
        let (shape, parallel) = (&self.plan.shape, self.parallel);
        clear_held(&mut self.theta, &self.held);
        self.border.solve(&mut self.theta, &mut self.constraint_side);
        // Rounding in the basis of what constraints leave.
        clear_held(&mut self.theta, &self.held);
        add(&mut self.solution, &self.theta);
        for (tree, plan) in self.forest.trees.iter_mut().zip(&self.plan.chains) {
            let own = tree.top.place - shape.border..tree.top.place - shape.border + tree.top.deferred();
            tree.top.forces.copy_from_slice(&self.constraint_side[own]);
            tree.expand(&Context { shape, plan }, &self.theta, parallel);
        }
    }

    /// Runs on the threads, where that pays.
    fn on_threads<R: Send>(&mut self, work: impl FnOnce(&mut Self) -> R + Send) -> R {
        if !self.parallel {
            return work(self);
        }
        let (threads, interrupt) = (self.threads.clone(), current());
        threads.install(|| interrupt.run(|| work(self)))
    }

    /// Computes the residual of the solution; returns the largest residual of a constraint relative to its terms.
    fn residual(&mut self) -> f64 {
        let shape = &self.plan.shape;
        let border = shape.border;
        for (i, (rest, right)) in self.theta.iter_mut().zip(&self.right).enumerate() {
            let row = &self.outer[i * border..(i + 1) * border];
            *rest = right - row.iter().zip(&self.solution).map(|(h, x)| h * x).sum::<f64>();
        }
        let mut worst: f64 = 0.0;
        for (tree, plan) in self.forest.trees.iter_mut().zip(&self.plan.chains) {
            let border = (&*self.solution, &mut *self.theta);
            worst = worst.max(tree.residual(&Context { shape, plan }, &self.units, &self.jacobian, border));
        }
        clear_held(&mut self.theta, &self.held);
        worst
    }
}

/// Weak direction of a part of the system, by the numbers of its own variables.
type Local = Vec<(usize, f64)>;

/// Zeros where a variable is held.
fn clear_held(theta: &mut [f64], held: &[bool]) {
    theta.iter_mut().zip(held).filter(|(_, held)| **held).for_each(|(t, _)| *t = 0.0);
}

impl KktSolver for ArrowKkt {
    fn factorize(&mut self, entries: &Entries<'_>, effort: Effort) -> Result<&mut dyn Factor, KktError> {
        self.eliminate_all(entries, effort)?;
        Ok(self)
    }

    fn factor(&mut self) -> Option<&mut dyn Factor> {
        self.is_eliminated.then_some(self)
    }

    fn flops(&self) -> u64 {
        self.plan.flops(&self.forest.trees)
    }
}

impl Factor for ArrowKkt {
    // H and A are eliminated together.
    fn replace_hessian(&mut self, entries: &Entries<'_>) -> Result<(), KktError> {
        self.eliminate_all(entries, self.effort)
    }

    fn finish(&mut self, held: &[bool], shift: f64) -> Curvature {
        let shape = &self.plan.shape;
        self.weak.clear();
        self.shift = shift;
        self.held[..shape.border].copy_from_slice(&held[..shape.border]);
        self.eliminated.clone_from(&self.s);
        let size = self.diagonal.len();
        let mut found = Curvature::default();
        if current().stops() {
            return Curvature { zero: 1, ..found };
        }
        for (tree, plan) in self.forest.trees.iter_mut().zip(&self.plan.chains) {
            let mut weak = Vec::new();
            let here = tree.top.eliminate(shape, shift, (&mut self.eliminated, size), &mut weak);
            found.negative += here.negative;
            found.zero += here.zero;
            // Ends of the chain as variables of the program.
            let (n, last) = (shape.n, plan.chain.variable + plan.chain.segments * plan.d);
            let variable = |i: usize| if i < n { plan.chain.variable + i } else { last + (i - n) };
            let direction = |of: Local| of.into_iter().map(|(i, part)| (variable(i), part)).collect();
            self.weak.extend(weak.into_iter().map(direction));
        }
        if !found.is_positive() {
            return found;
        }
        let matrix = (&*self.eliminated, &*self.constraints);
        let mut weak = Vec::new();
        let found = self.border.factorize(matrix, &self.diagonal, &self.held, shift, &mut weak);
        // End states that stay in the border are no variables of the program.
        let of_border = |of: Local| of.into_iter().filter(|(i, _)| *i < shape.border);
        let direction = |of: Local| of_border(of).map(|(i, part)| (VariableId(i), part)).collect();
        self.weak.extend(weak.into_iter().map(direction));
        found
    }

    fn solve(&mut self, p: &[f64], q: &[f64], d: &mut [f64], lambda: &mut [f64]) {
        if current().stops() {
            d.fill(f64::NAN);
            lambda.fill(f64::NAN);
            return;
        }
        self.on_threads(|arrow| {
            arrow.take(p, q);
            arrow.solve_rest();
            arrow.refinements = 0;
            // With a shift the step is damped anyway.
            while arrow.refining
                && arrow.shift == 0.0
                && arrow.refinements < REFINEMENTS
                && arrow.residual() > ROUGH
            {
                arrow.solve_rest();
                arrow.refinements += 1;
            }
            arrow.give(d, lambda);
        });
    }

    fn reduce(&mut self, p: &[f64], q: &[f64]) -> usize {
        if current().stops() {
            return 0;
        }
        self.on_threads(|arrow| {
            arrow.take(p, q);
            arrow.reduce_rest();
        });
        self.reduced.0.clone_from(&self.theta);
        self.reduced.1.clone_from(&self.constraint_side);
        self.plan.shape.border
    }

    fn solve_reduced(&mut self, to: &[f64], d: &mut [f64], z: &mut [f64]) {
        let (border, size) = (self.plan.shape.border, self.diagonal.len());
        // right −= K x, of rows as long as x.
        let less = |right: &mut [f64], rows: &[f64], x: &[f64]| {
            for (r, row) in right.iter_mut().zip(rows.chunks_exact(size.max(1))) {
                *r -= dot_of(&row[..x.len()], x);
            }
        };
        let held = &self.held[..border];
        d.iter_mut().zip(to).zip(held).for_each(|((d, to), held)| *d = if *held { *to } else { 0.0 });
        self.theta.copy_from_slice(&self.reduced.0);
        less(&mut self.theta, &self.eliminated, d);
        clear_held(&mut self.theta, &self.held);
        self.constraint_side.copy_from_slice(&self.reduced.1);
        less(&mut self.constraint_side, &self.constraints, d);
        self.border.solve(&mut self.theta, &mut self.constraint_side);
        clear_held(&mut self.theta, &self.held);
        d.iter_mut().zip(&self.theta).for_each(|(d, x)| *d += x);
        self.theta[..border].copy_from_slice(d);
        z.copy_from_slice(&self.reduced.0[..border]);
        less(z, &self.eliminated, &self.theta);
        for (force, row) in self.constraint_side.iter().zip(self.constraints.chunks_exact(size.max(1))) {
            z.iter_mut().zip(row).for_each(|(z, e)| *z -= force * e);
        }
    }

    fn weak_directions(&self) -> &[Direction] {
        &self.weak
    }

    fn covariance(&mut self, wanted: &[VariableId], out: &mut [f64]) {
        if !self.read_covariance(wanted, out) {
            covariance_by_solving(self, wanted, out);
        }
    }

    fn sizes(&self) -> (usize, usize) {
        self.sizes
    }
}
