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

use std::ops::Range;

use super::program::Program;
use crate::dense::{factorise, largest, solve_factorised, solve_factorised_transposed};
use crate::simd::kernel;

/// Defects below this part of the unit of their state are none.
const SATISFIED: f64 = 1e-8;
/// The same of the state itself, where its unit is smaller than rounding errors of it.
const ROUNDING: f64 = 1e-13;
/// The same of the terms of which the defect is the difference, which are large where a segment is long for a fast motion.
const CANCELLATION: f64 = 4.0 * f64::EPSILON;
/// After several steps with one Jacobian, of which the last leaves more than a step of Newton's method, another is taken where
/// defects are above this part of that.
const SATISFIED_AGAIN: f64 = 0.01;
/// Most iterations with the factors of one Jacobian, and how much of the defects one may leave if the next is to be taken with
/// the same factors.
const WITH_ONE: usize = 6;
const LEAVES: f64 = 0.2;
/// Most Jacobians for all blocks at once, and iterations for a window of them, and for one.
const AT_ONCE: usize = 6;
const OF_WINDOW: usize = 8;
const IN_TURN: usize = 25;
/// Blocks that are solved together first.
const FIRST_WINDOW: usize = 16;
/// Most blocks that are solved in turn.
const MOST_BLOCKS: usize = 2000;

/// An entry of the Jacobian in the equations of a block.
#[derive(Clone, Copy)]
struct BlockEntry {
    /// Its number among all entries.
    entry: usize,
    /// Its row within the block.
    row: usize,
    /// Its column: within the block where the block determines it, else among all variables.
    column: usize,
}

/// Equations that determine as many variables.
struct Block {
    chain: usize,
    rows: Vec<usize>,
    columns: Vec<usize>,
    /// Entries in columns that it determines.
    own: Vec<BlockEntry>,
    /// Entries in columns that another block determines.
    others: Vec<BlockEntry>,
    /// Entries in columns that no block determines.
    free: Vec<BlockEntry>,
    /// The states of the point before, which the block starts from; none of the first.
    before: Option<usize>,
    /// Where its factor and its pivots begin.
    factor: usize,
    pivots: usize,
}

impl Block {
    /// Factorises its square of the Jacobian; whether that is regular.
    fn factorise(&self, jacobian: &[f64], factor: &mut [f64], pivots: &mut [u32]) -> bool {
        let n = self.rows.len();
        factor.fill(0.0);
        for &BlockEntry { entry, row: r, column: c } in &self.own {
            factor[r * n + c] += jacobian[entry];
        }
        factorise(factor, pivots)
    }
}

/// The solution of the blocks of a chain, window after window.
#[derive(Default)]
struct March {
    blocks: Range<usize>,
    /// Holds those that are solved now; none at the end.
    window: Range<usize>,
    /// States before the first step.
    before: Vec<f64>,
    /// Lets windows begin with the states as they are; tells whether this one did.
    follows: bool,
    followed: bool,
    /// Largest defect before the last step, and steps that may be taken yet.
    last: f64,
    left: usize,
    /// Whether a step has been taken; the step, and the part of it.
    steps: bool,
    step: Vec<f64>,
    part: f64,
    todo: Todo,
}

/// What a chain needs next.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
enum Todo {
    #[default]
    Nothing,
    Evaluation,
    Step,
    Lost,
}

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
        let chains = nlp.chains()?;
        let n_x = chains.n_x;
        let mut blocks: Vec<Block> = Vec::new();
        let block = |chain, rows: Vec<usize>, columns: Vec<usize>, before: Option<usize>| Block {
            chain,
            rows,
            columns,
            own: Vec::new(),
            others: Vec::new(),
            free: Vec::new(),
            before,
            factor: 0,
            pivots: 0,
        };
        let mut conditions = Vec::new(); // rows that may depend on the initial states alone
        for (e, chain) in chains.chains.iter().enumerate() {
            let (row, states) = (chain.boundary.row.0, &chain.boundary.states);
            if !states.is_empty() {
                let columns: Vec<usize> = states.iter().map(|s| (chain.variable + s.0).0).collect();
                let once = (0..columns.len()).all(|i| !columns[..i].contains(&columns[i]));
                if !once {
                    return None;
                }
                let first = chain.variable.0;
                conditions.push((row..row + states.len(), first..first + n_x));
                blocks.push(block(e, (row..row + states.len()).collect(), columns, None));
            }
            let size = chain.points * n_x;
            let mut ties = chain.ties.iter().peekable();
            for s in 0..chain.segments {
                let (row, variable) = (chain.row.0 + s * size, chain.variable.0 + n_x + s * size);
                let own = (row..row + size).collect();
                blocks.push(block(e, own, (variable..variable + size).collect(), Some(variable - n_x)));
                while let Some(tie) = ties.next_if(|t| t.segment == s) {
                    let (row, first) = (tie.row.0, tie.variable.0);
                    let columns = (first..first + n_x).collect();
                    blocks.push(block(e, (row..row + n_x).collect(), columns, Some(variable - n_x)));
                }
            }
        }
        let (mut of_row, mut of_column) = (vec![None; nlp.m()], vec![None; nlp.n()]);
        for (number, b) in blocks.iter().enumerate() {
            b.rows.iter().enumerate().for_each(|(i, &r)| of_row[r] = Some((number, i)));
            b.columns.iter().enumerate().for_each(|(i, &c)| of_column[c] = Some((number, i)));
        }
        let structure = nlp.jacobian_structure();
        for (k, (&row, &column)) in structure.rows.iter().zip(&structure.columns).enumerate() {
            let (row, column) = (row as usize, column as usize);
            let on_ends = conditions.iter().find(|c| c.0.contains(&row));
            if on_ends.is_some_and(|c| column >= chains.border && !c.1.contains(&column)) {
                return None;
            }
            let (number, r) = of_row[row]?;
            match of_column[column] {
                Some((of, c)) if of == number => {
                    blocks[number].own.push(BlockEntry { entry: k, row: r, column: c })
                }
                Some(_) => blocks[number].others.push(BlockEntry { entry: k, row: r, column }),
                None => blocks[number].free.push(BlockEntry { entry: k, row: r, column }),
            }
        }
        let (mut entries, mut rows) = (0, 0);
        for block in &mut blocks {
            (block.factor, block.pivots) = (entries, rows);
            entries += block.rows.len() * block.rows.len();
            rows += block.rows.len();
        }
        Some(Restoration {
            n_x,
            c: vec![0.0; nlp.m()],
            jacobian: vec![0.0; structure.len()],
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

    /// Newton's method for all blocks, as long as it contracts. The factors of a Jacobian are used again while they leave little
    /// of the defects.
    fn at_once(&mut self, program: &Program<'_>, xi: &mut [f64]) -> bool {
        // Whether the factors are those of other states, and the defects before the first step with them.
        let (mut earlier, mut first) = (self.factorised, f64::INFINITY);
        // Defects before the last step, and before the last one with a Jacobian of its own.
        let (mut last, mut before) = (f64::INFINITY, f64::INFINITY);
        let (mut jacobians, mut steps) = (0, 0);
        loop {
            let size = match program.constraints(xi, &mut self.c) {
                Ok(()) => self.largest_defect(program, 0..self.blocks.len(), xi, last),
                Err(_) => f64::INFINITY,
            };
            if size <= 1.0 {
                let by_newton = steps == 0 || steps == 1 && !earlier;
                return by_newton || size <= SATISFIED_AGAIN || self.step_all(xi);
            }
            if program.interrupt.stops() {
                return false;
            }
            let again = self.factorised && steps < WITH_ONE && size < LEAVES * last;
            if !again && earlier && size > first {
                // These factors have led away.
                xi.copy_from_slice(&self.kept);
                (self.factorised, earlier, steps, last) = (false, false, 0, f64::INFINITY);
                continue;
            }
            if !again {
                if !size.is_finite() || size >= 0.5 * before || jacobians == AT_ONCE {
                    return false;
                }
                self.factorised = false;
                if program.jacobian(xi, &mut self.jacobian).is_err() || !self.factorise_all() {
                    return false;
                }
                (jacobians, steps, before, earlier) = (jacobians + 1, 0, size, false);
            }
            if earlier && steps == 0 {
                first = size;
            }
            (steps, last) = (steps + 1, size);
            if !self.step_all(xi) {
                return false;
            }
        }
    }

    /// Takes a Newton step of all blocks, with the factors of a Jacobian; whether there is one.
    fn step_all(&mut self, xi: &mut [f64]) -> bool {
        self.d.fill(0.0);
        let found = (0..self.blocks.len()).all(|k| self.step_of(k));
        xi.iter_mut().zip(&self.d).for_each(|(x, d)| *x += d);
        found
    }

    /// Window after window of blocks of each chain, each from the end of the one before: as many at once as Newton's method
    /// contracts for, from the states as they are or from such as do not move. All chains advance together, since an
    /// evaluation is one of all of them.
    fn in_turn(&mut self, program: &Program<'_>, xi: &mut [f64]) -> bool {
        let mut marches = self.marches();
        if marches.iter().any(|m| m.blocks.len() > MOST_BLOCKS) {
            return false;
        }
        self.factorised = false;
        marches.iter_mut().for_each(|m| self.begin(m, FIRST_WINDOW, xi));
        loop {
            if program.interrupt.stops() {
                return false;
            }
            // What is not finite is so in the defects of its own block.
            self.rows_of(&marches, |m| !m.window.is_empty());
            program.constraints_within(xi, &self.ranges, &mut self.c);
            for march in &mut marches {
                march.todo = self.judge(program, march, xi);
            }
            let any = |todo| marches.iter().any(|m| m.todo == todo);
            if any(Todo::Lost) {
                return false;
            }
            if !any(Todo::Step) {
                if any(Todo::Evaluation) {
                    continue;
                }
                return true;
            }
            self.rows_of(&marches, |m| m.todo == Todo::Step);
            program.jacobian_within(xi, &self.ranges, &mut self.jacobian);
            self.d.fill(0.0);
            for march in marches.iter_mut().filter(|m| m.todo == Todo::Step) {
                let mut window = march.window.clone();
                if window.all(|k| self.factorise_block(k) && self.step_of(k)) {
                    march.part = 1.0;
                    march.step = self.columns(march).map(|i| self.d[i]).collect();
                    self.columns(march).zip(&march.step).for_each(|(i, d)| xi[i] += d);
                } else {
                    march.left = 0;
                }
            }
        }
    }

    /// Sets the ranges of the rows of some windows.
    fn rows_of(&mut self, marches: &[March], which: impl Fn(&March) -> bool) {
        self.ranges.clear();
        for block in marches.iter().filter(|m| which(m)).flat_map(|m| &self.blocks[m.window.clone()]) {
            let (first, end) = (block.rows[0], block.rows[block.rows.len() - 1] + 1);
            match self.ranges.last_mut().filter(|r| r.end == first) {
                Some(range) => range.end = end,
                None => self.ranges.push(first..end),
            }
        }
    }

    /// The chains, of which each has its blocks one after the other.
    fn marches(&self) -> Vec<March> {
        let mut found: Vec<March> = Vec::new();
        for (k, block) in self.blocks.iter().enumerate() {
            match found.last_mut().filter(|m| self.blocks[m.blocks.start].chain == block.chain) {
                Some(march) => march.blocks.end = k + 1,
                None => {
                    found.push(March { blocks: k..k + 1, window: k..k, follows: true, ..March::default() })
                }
            }
        }
        found
    }

    fn columns<'a>(&'a self, march: &March) -> impl Iterator<Item = usize> + 'a {
        self.blocks[march.window.clone()].iter().flat_map(|b| b.columns.iter().copied())
    }

    /// Turns to the next window of a chain, of so many blocks at most.
    fn begin(&self, march: &mut March, width: usize, xi: &mut [f64]) {
        let first = march.window.end;
        march.window = first..(first + width).min(march.blocks.end);
        if march.window.is_empty() {
            return;
        }
        march.followed = march.follows;
        if !march.follows {
            self.hold(march, xi);
        }
        march.before = self.columns(march).map(|i| xi[i]).collect();
        self.start(march);
    }

    fn start(&self, march: &mut March) {
        march.left = if march.window.len() == 1 { IN_TURN } else { OF_WINDOW };
        (march.last, march.steps) = (f64::INFINITY, false);
    }

    /// Looks at the defects of a window: turns to the next one where there are none, takes back what led nowhere, and says
    /// whether a step is due.
    fn judge(&mut self, program: &Program<'_>, march: &mut March, xi: &mut [f64]) -> Todo {
        if march.window.is_empty() {
            return Todo::Nothing;
        }
        let width = march.window.len();
        let size = self.largest_defect(program, march.window.clone(), xi, march.last);
        if size <= 1.0 {
            // States that led nowhere say nothing of what comes next.
            march.follows &= march.followed;
            self.begin(march, 2 * width, xi);
            return if march.window.is_empty() { Todo::Nothing } else { Todo::Evaluation };
        }
        // A full step of a block by itself may be a detour.
        let detour = width == 1 && march.steps && march.part == 1.0;
        let contracts = size < march.last || (detour && size <= 2.0 * march.last);
        if width == 1 && march.steps && !contracts && march.part >= 1e-2 {
            // A shorter one of the same step.
            let shorter = 0.4 * march.part;
            self.columns(march).zip(&march.step).for_each(|(i, d)| xi[i] -= (march.part - shorter) * d);
            march.part = shorter;
            return Todo::Evaluation;
        }
        if !contracts || march.left == 0 {
            if march.followed {
                march.followed = false;
                self.hold(march, xi);
                self.start(march);
                return Todo::Evaluation;
            }
            if width == 1 {
                return Todo::Lost;
            }
            self.columns(march).zip(&march.before).for_each(|(i, x)| xi[i] = *x);
            march.window.end = march.window.start;
            self.begin(march, width.div_ceil(4), xi);
            return Todo::Evaluation;
        }
        (march.last, march.left, march.steps) = (size, march.left - 1, true);
        Todo::Step
    }

    /// Sets all states of a window to those that it starts from: nothing moves, so that all is finite where it is so there.
    fn hold(&self, march: &March, xi: &mut [f64]) {
        let Some(point) = self.blocks[march.window.start].before else { return };
        for b in &self.blocks[march.window.clone()] {
            for (i, &column) in b.columns.iter().enumerate() {
                xi[column] = xi[point + i % self.n_x];
            }
        }
    }

    /// The Newton step of a block with its factor, given those of the blocks before; whether there is one.
    fn step_of(&mut self, k: usize) -> bool {
        let block = &self.blocks[k];
        let n = block.rows.len();
        self.right.clear();
        self.right.extend(block.rows.iter().map(|&r| -self.c[r]));
        for &BlockEntry { entry, row: r, column } in &block.others {
            self.right[r] -= self.jacobian[entry] * self.d[column];
        }
        let (factor, pivots) = (&self.factors[block.factor..][..n * n], &self.pivots[block.pivots..][..n]);
        if !solve_factorised(factor, pivots, &mut self.right, 1) {
            return false;
        }
        block.columns.iter().zip(&self.right).for_each(|(&i, x)| self.d[i] = *x);
        true
    }

    /// Sets what rounding may leave of the defects of some blocks, from the last Jacobian.
    fn measure_rounding(&mut self, blocks: Range<usize>, xi: &[f64]) {
        for block in &self.blocks[blocks] {
            block.rows.iter().for_each(|&row| self.rounding[row] = 0.0);
            let own = block.own.iter().map(|own| BlockEntry { column: block.columns[own.column], ..*own });
            for BlockEntry { entry, row: r, column } in own.chain(block.others.iter().copied()) {
                self.rounding[block.rows[r]] += CANCELLATION * (self.jacobian[entry] * xi[column]).abs();
            }
        }
    }

    /// The largest defect of some blocks. Where a step has not made it less than half of the `last` one, rounding may be all
    /// that is left, and is measured.
    fn largest_defect(&mut self, program: &Program<'_>, blocks: Range<usize>, xi: &[f64], last: f64) -> f64 {
        let of =
            |this: &Self| largest(this.blocks[blocks.clone()].iter().map(|b| this.defect_of(program, b, xi)));
        let size = of(self);
        if size <= 1.0 || size < 0.5 * last || last == f64::INFINITY {
            return size;
        }
        self.measure_rounding(blocks.clone(), xi);
        of(self)
    }

    /// The largest defect of a block, at most 1 where it counts as none, infinite where it is not a number.
    fn defect_of(&self, program: &Program<'_>, block: &Block, xi: &[f64]) -> f64 {
        let one = |(&row, &column): (&usize, &usize)| {
            let least = (SATISFIED * program.units.of(row)).max(ROUNDING * xi[column].abs());
            self.c[row] / least.max(self.rounding[row])
        };
        largest(block.rows.iter().zip(&block.columns).map(one))
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
