//! Counted floating-point operations of a factorisation: a cost that does not depend on the machine.

use super::chain::ChainPlan;
use super::part::Part;
use super::plan::Plan;
use super::run::Run;
use super::tree::Tree;

impl Plan {
    /// Returns the floating-point operations of a factorisation with such trees.
    pub fn flops(&self, trees: &[Tree]) -> u64 {
        let shape = &self.shape;
        let (n, w, f) = (shape.n as u64, shape.used() as u64, shape.form() as u64);
        let mut bent = (std::ptr::null(), 0); // that of most panels is that of the one before
        let mut segment = |plan: &ChainPlan, s: usize| {
            let runs = plan.runs(s + 1);
            if runs.as_ptr() != bent.0 {
                bent = (runs.as_ptr(), self.bent(runs));
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
        self.chains.iter().zip(trees).fold(0, |sum, (plan, tree)| {
            let segments: u64 = (0..plan.chain.segments).map(|s| segment(plan, s)).sum();
            sum + segments + merge * (tree.groups.len() as u64 - 1) + top
        })
    }

    /// Operations for ZᵀHZ and ZᵀK with some runs of the Hessian.
    fn bent(&self, runs: &[Run]) -> u64 {
        let parts = &self.shape.parts;
        let part_of = |state: usize| parts.iter().position(|p| p.states.contains(&state));
        let used = |state: usize| part_of(state).map_or(0, |p| parts[p].used() as u64);
        let columns = |part: &Part| {
            let met = |column: &usize| part.meets.iter().any(|range| range.contains(column));
            self.shape.columns().filter(|column| met(&column.0)).count() as u64
        };
        let products: u64 = parts.iter().map(|p| 2 * (p.states.len() * p.used()) as u64 * columns(p)).sum();
        let mut point = u32::MAX;
        let each = runs.iter().map(|run| {
            let state = used(run.state as usize);
            if run.coupled {
                return 2 * state * u64::from(run.count);
            }
            let first = std::mem::replace(&mut point, run.point) != run.point;
            let own = run.others().map(|o| used(o) + if o == run.state as usize { 0 } else { state });
            2 * own.sum::<u64>() + if first { products } else { 0 }
        });
        each.sum()
    }
}
