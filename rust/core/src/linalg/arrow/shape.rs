//! Sizes that all panels share.

use super::part::Part;
use super::places::Places;
use super::run::Run;
use crate::nlp::{Chains, Structure};

/// Sizes that all panels share.
#[derive(Clone, Debug, Default)]
pub(super) struct Shape {
    /// States, n.
    pub n: usize,
    /// Border variables, B.
    pub border: usize,
    /// Border variables that constraints depend on.
    pub dynamic: Vec<usize>,
    /// Border variables that the Hessian couples with states.
    pub coupled: Vec<usize>,
    pub parts: Vec<Part>,
    /// Length of a row of sensitivities of all parts.
    pub width: usize,
}

impl Shape {
    /// The border of a program, and what of it meets constraints and states; [parts](Shape::parts) are still to be found.
    /// `None` where there is more than a run can count.
    pub fn new(chains: &Chains, hessian: &Structure, jacobian: &Structure) -> Option<Shape> {
        let border = chains.border;
        let (mut dynamic, mut coupled) = (vec![false; border], vec![false; border]);
        for &c in jacobian.columns.iter().filter(|c| (**c as usize) < border) {
            dynamic[c as usize] = true;
        }
        for (&r, &c) in hessian.rows.iter().zip(&hessian.columns) {
            let (low, high) = (r.min(c) as usize, r.max(c) as usize);
            if low < border && high >= border {
                coupled[low] = true;
            }
        }
        let shape = Shape {
            n: chains.n_x,
            border,
            dynamic: (0..border).filter(|&b| dynamic[b]).collect(),
            coupled: (0..border).filter(|&b| coupled[b]).collect(),
            ..Shape::default()
        };
        (shape.n.max(shape.coupled.len()) <= usize::from(u16::MAX)).then_some(shape)
    }

    /// Finds the parts that the dynamics fall into: sets of states that no entry of the Jacobian joins.
    pub fn find_parts(&mut self, places: &Places, jacobian: &Structure) {
        let n = self.n;
        let of_row = |t: usize| {
            let row = places.rows[jacobian.rows[t] as usize];
            row.is_own().then_some(row.index as usize)
        };
        // Each state points to one of its part, the first of them to itself.
        let mut to: Vec<usize> = (0..n).collect();
        let root = |to: &[usize], mut i: usize| {
            while to[i] != i {
                i = to[i];
            }
            i
        };
        let mut last = None;
        for (t, &column) in jacobian.columns.iter().enumerate().filter(|(_, c)| **c as usize >= self.border) {
            if let Some(i) = of_row(t) {
                let j = places.variables[column as usize].index as usize;
                // As the one before, mostly: entries of consecutive segments stand side by side.
                if last.replace((i, j)) == Some((i, j)) {
                    continue;
                }
                let (a, b) = (root(&to, i % n), root(&to, j % n));
                to[a.max(b)] = a.min(b);
            }
        }
        let roots: Vec<usize> = (0..n).map(|i| root(&to, i)).collect();
        let place = positions(&self.dynamic, self.border, 0);
        let mut enters = vec![false; n * self.dynamic.len()];
        for (t, &column) in jacobian.columns.iter().enumerate().filter(|(_, c)| (**c as usize) < self.border)
        {
            if let Some(i) = of_row(t) {
                enters[roots[i % n] * self.dynamic.len() + place[column as usize]] = true;
            }
        }
        let part = |root: usize| {
            let states: Vec<usize> = (0..n).filter(|&i| roots[i] == root).collect();
            let count = self.dynamic.len();
            let dynamic: Vec<usize> = (0..count).filter(|d| enters[root * count + d]).collect();
            let width = (states.len() + dynamic.len()).next_multiple_of(8);
            self.width += width;
            Part { states, dynamic, width, first: self.width - width, meets: Vec::new() }
        };
        self.parts = (0..n).filter(|&i| roots[i] == i).map(part).collect();
    }

    /// Length of a row of sensitivities of the whole without the padding.
    pub fn used(&self) -> usize {
        self.n + self.dynamic.len()
    }

    /// Number of variables of a form: two ends of a group and the border.
    pub fn form(&self) -> usize {
        2 * self.n + self.border
    }

    /// Notes which parts the Hessian brings together, and with which of the coupled border. Of two parts the
    /// first takes note.
    pub fn meet<'a>(&mut self, runs: impl Iterator<Item = &'a Run>) {
        let total = self.width + self.coupled.len().next_multiple_of(8);
        let mut part_of = vec![0; self.n];
        for (p, part) in self.parts.iter().enumerate() {
            part.states.iter().for_each(|&s| part_of[s] = p);
        }
        let mut met = vec![vec![false; total / 8]; self.parts.len()];
        for run in runs {
            let p = part_of[run.state as usize];
            for other in run.others() {
                if run.coupled {
                    met[p][(self.width + other) / 8] = true;
                } else {
                    let (low, high) = (p.min(part_of[other]), p.max(part_of[other]));
                    let to = &self.parts[high];
                    met[low][to.first / 8..(to.first + to.width) / 8].fill(true);
                }
            }
        }
        for (part, met) in self.parts.iter_mut().zip(met) {
            for j in (0..total).step_by(8).filter(|j| met[j / 8]) {
                match part.meets.last_mut() {
                    Some(range) if range.end == j => range.end += 8,
                    _ => part.meets.push(j..j + 8),
                }
            }
        }
    }

    /// Returns for each column of a row of all parts its variable in a form's order without the end of the group:
    /// initial states, then the dynamic border. Padding has none.
    pub fn columns(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.parts.iter().flat_map(|part| {
            let dynamic = part.dynamic.iter().map(|d| self.n + d);
            part.states.iter().copied().chain(dynamic).enumerate().map(|(i, v)| (part.first + i, v))
        })
    }
}

/// Returns for each border variable of a set its number in it, counted from `first`.
pub(super) fn positions(set: &[usize], border: usize, first: usize) -> Vec<usize> {
    let mut position = vec![usize::MAX; border];
    set.iter().enumerate().for_each(|(i, &b)| position[b] = first + i);
    position
}
