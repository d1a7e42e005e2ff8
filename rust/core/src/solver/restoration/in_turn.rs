//! Newton's method for windows of blocks, one after the other along each chain.

use std::ops::Range;

use super::super::program::Program;
use super::Restoration;

/// Most iterations for a window of blocks, and for one.
const OF_WINDOW: usize = 8;
const IN_TURN: usize = 25;
/// Blocks that are solved together first.
const FIRST_WINDOW: usize = 16;
/// Most blocks that are solved in turn.
const MOST_BLOCKS: usize = 2000;

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

impl Restoration {
    /// Window after window of blocks of each chain, each from the end of the one before: as many at once as Newton's method
    /// contracts for, from the states as they are or from such as do not move. All chains advance together, since an
    /// evaluation is one of all of them.
    pub(super) fn in_turn(&mut self, program: &Program<'_>, xi: &mut [f64]) -> bool {
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
}
