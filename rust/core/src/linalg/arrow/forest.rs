//! The trees of all chains, and their division into groups.

use super::group::Context;
use super::plan::Plan;
use super::tree::Tree;

/// Most segments of a group.
const GROUP: usize = 128;
/// More groups than so many times the least are too many in a hurry, and a few.
const MANY: (usize, usize) = (4, 64);

/// One tree a chain. Groups end early where small changes grow, and are joined again.
#[derive(Debug)]
pub(super) struct Forest {
    pub trees: Vec<Tree>,
    /// Number of groups if none ends early.
    least: usize,
    /// Factorisations until groups that were split are tried whole again, and how many these were last time.
    wait: (u32, u32),
}

impl Forest {
    /// Makes the forest with no group ended early.
    pub fn new(plan: &Plan) -> Forest {
        let mut forest = Forest { trees: whole(plan), least: 0, wait: (0, 0) };
        forest.least = forest.groups();
        forest
    }

    /// Number of groups of all chains.
    pub fn groups(&self) -> usize {
        self.trees.iter().map(|t| t.groups.len()).sum()
    }

    /// Whether groups have ended early.
    pub fn is_split(&self) -> bool {
        self.groups() > self.least
    }

    /// Tries groups whole again after a while: small changes may have grown at a single bad iterate
    /// only. After each failure the next attempt is delayed longer.
    pub fn rejoin(&mut self, plan: &Plan) {
        if !self.is_split() {
            self.wait = (0, 0);
        } else if self.wait.0 == 0 {
            self.trees = whole(plan);
            self.wait = (2 * self.wait.1 + 1, 2 * self.wait.1 + 1);
        } else {
            self.wait.0 -= 1;
        }
    }

    /// Whether there are too many places where small changes have grown too far, for one in a hurry.
    pub fn grows_wildly(&self) -> bool {
        let splits: usize = self.trees.iter().flat_map(|t| &t.groups).map(|g| g.splits.len()).sum();
        self.groups() + splits > MANY.0 * self.least + MANY.1
    }

    /// Ends groups where small changes have grown too far; whether there were any.
    pub fn split(&mut self, plan: &Plan) -> bool {
        let mut any = false;
        for (tree, chain) in self.trees.iter_mut().zip(&plan.chains) {
            if tree.groups.iter().all(|g| g.splits.is_empty()) {
                continue;
            }
            any = true;
            let mut ends = vec![0];
            for group in &tree.groups {
                ends.extend(&group.splits);
                ends.push(group.segments.end);
            }
            *tree = Tree::new(&Context { shape: &plan.shape, plan: chain }, &ends);
        }
        any
    }
}

/// Trees with no group ended early.
fn whole(plan: &Plan) -> Vec<Tree> {
    let tree = |chain| {
        let context = Context { shape: &plan.shape, plan: chain };
        let segments = chain.chain.segments;
        let count = segments.div_ceil(GROUP);
        let ends: Vec<usize> = (0..=count).map(|g| g * segments / count).collect();
        Tree::new(&context, &ends)
    };
    plan.chains.iter().map(tree).collect()
}
