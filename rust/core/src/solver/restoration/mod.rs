//! Restoration by integration: the states that follow from the parameters and the initial states.
//!
//! With these given, the constraints of a chain are a block triangular system of equations for all other states: of
//! each segment, one after the other, as an implicit Runge-Kutta method solves them (Hairer and Wanner, Solving Ordinary
//! Differential Equations II, section IV.8). Conditions on the initial states come before. Newton's method for all blocks at once
//! is tried from the states as they are; where that does not contract, windows of segments are solved, each from the states as
//! they are or, where these lead nowhere, from the end of the window before.
//!
//! The factors of a Jacobian serve for several iterations, as long as these contract well, and those of the path that a step
//! begins from serve for the first iterations after it (simplified Newton iterations: Hairer and Wanner, section IV.8).

mod at_once;
mod blocks;
mod defects;
mod in_turn;

use std::ops::Range;

use self::blocks::{Block, BlockEntry, blocks_of};
use super::program::Program;
use crate::dense::{solve_factorised, solve_factorised_transposed};
use crate::simd::kernel;

/// The blocks of a program, and memory.
pub(super) struct Restoration {
    blocks: Vec<Block>,
    n_x: usize,
    c: Vec<f64>,
    jacobian: Vec<f64>,
    d: Vec<f64>,
    /// Bounds what rounding leaves of the defects, by row.
    rounding: Vec<f64>,
    kept: Vec<f64>,
    /// Factors of the blocks of `jacobian`, all of them where `factorised`.
    factors: Vec<f64>,
    pivots: Vec<u32>,
    factorised: bool,
    /// Rows that are evaluated.
    ranges: Vec<Range<usize>>,
    right: Vec<f64>,
}

impl Restoration {
    /// The blocks of a program; `None` where its states do not follow from parameters and initial states, as with
    /// conditions on the last ones.
    pub fn new(program: &Program<'_>) -> Option<Restoration> {
        let nlp = program.nlp;
        let blocks = blocks_of(nlp)?;
        let entries = blocks.iter().map(|b| b.rows.len() * b.rows.len()).sum();
        let rows = blocks.iter().map(|b| b.rows.len()).sum();
        Some(Restoration {
            n_x: nlp.chains()?.n_x,
            c: vec![0.0; nlp.m()],
            jacobian: vec![0.0; nlp.jacobian_structure().len()],
            d: vec![0.0; nlp.n()],
            rounding: vec![0.0; nlp.m()],
            kept: vec![0.0; nlp.n()],
            factors: vec![0.0; entries],
            pivots: vec![0; rows],
            factorised: false,
            ranges: Vec::new(),
            right: Vec::new(),
            blocks,
        })
    }

    /// Sets all states that follow from the parameters and the initial states in ξ; whether there are such states, and within
    /// their bounds.
    pub fn restore(&mut self, program: &Program<'_>, xi: &mut [f64]) -> bool {
        self.kept.copy_from_slice(xi);
        self.rounding.fill(0.0);
        if !self.at_once(program, xi) {
            xi.copy_from_slice(&self.kept);
            if !self.in_turn(program, xi) || !self.at_once(program, xi) {
                return false;
            }
        }
        let mut columns = self.blocks.iter().flat_map(|b| &b.columns);
        columns.all(|&i| {
            let slack = 1e-9 * (1.0 + xi[i].abs());
            xi[i] >= program.lower[i] - slack && xi[i] <= program.upper[i] + slack
        })
    }

    /// The variables that are determined by others.
    pub fn determined(&self) -> impl Iterator<Item = usize> + '_ {
        self.blocks.iter().flat_map(|b| b.columns.iter().copied())
    }

    /// Factorises the blocks of a Jacobian, for the multipliers and derivatives there and for restorations nearby; whether all
    /// are regular.
    pub fn factorise(&mut self, jacobian: &[f64]) -> bool {
        self.jacobian.copy_from_slice(jacobian);
        self.factorise_all()
    }

    fn factorise_all(&mut self) -> bool {
        self.factorised = (0..self.blocks.len()).all(|k| self.factorise_block(k));
        self.factorised
    }

    fn factorise_block(&mut self, k: usize) -> bool {
        let block = &self.blocks[k];
        let n = block.rows.len();
        let factor = &mut self.factors[block.factor..][..n * n];
        block.factorise(&self.jacobian, factor, &mut self.pivots[block.pivots..][..n])
    }

    /// The derivatives of all variables with respect to the free ones, row-major in `z`, where the rows of the free ones are
    /// set; whether they are defined. `width` is the number of free variables. The Jacobian is that factorised last.
    pub fn sensitivities(&mut self, z: &mut [f64], width: usize) -> bool {
        for block in &self.blocks {
            let n = block.rows.len();
            self.right.clear();
            self.right.resize(n * width, 0.0);
            subtract(&block.others, &self.jacobian, z, width, &mut self.right);
            subtract(&block.free, &self.jacobian, z, width, &mut self.right);
            let (factor, pivots) =
                (&self.factors[block.factor..][..n * n], &self.pivots[block.pivots..][..n]);
            if !solve_factorised(factor, pivots, &mut self.right, width) {
                return false;
            }
            for (&column, from) in block.columns.iter().zip(self.right.chunks_exact(width)) {
                z[column * width..][..width].copy_from_slice(from);
            }
        }
        true
    }

    /// The multipliers with which the gradient of the Lagrangian vanishes for all determined variables, given that of
    /// the objective; whether there are such. The Jacobian is that factorised last.
    pub fn multipliers(&mut self, gradient: &[f64], out: &mut [f64]) -> bool {
        self.d.copy_from_slice(gradient);
        for block in self.blocks.iter().rev() {
            let n = block.rows.len();
            self.right.clear();
            self.right.extend(block.columns.iter().map(|&i| -self.d[i]));
            let (factor, pivots) =
                (&self.factors[block.factor..][..n * n], &self.pivots[block.pivots..][..n]);
            if !solve_factorised_transposed(factor, pivots, &mut self.right) {
                return false;
            }
            block.rows.iter().zip(&self.right).for_each(|(&row, l)| out[row] = *l);
            for &BlockEntry { entry, row: r, column } in &block.others {
                self.d[column] += self.jacobian[entry] * self.right[r];
            }
        }
        true
    }
}

kernel! {
    /// Subtracts the product of entries of the Jacobian and the rows of Z, of so many columns.
    fn subtract(entries: &[BlockEntry], jacobian: &[f64], z: &[f64], width: usize, right: &mut [f64]) {
        for &BlockEntry { entry, row, column } in entries {
            let (from, to) = (&z[column * width..][..width], &mut right[row * width..][..width]);
            to.iter_mut().zip(from).for_each(|(t, z)| *t -= jacobian[entry] * z);
        }
    }
}
