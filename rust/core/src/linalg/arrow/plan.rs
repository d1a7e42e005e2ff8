//! Which entry of the Newton system goes where: from triplets to the panels of segments and points.

use crate::nlp::{Chain, Chains, Structure};

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
    /// Length of a row of sensitivities to (first states of a group, dynamic border), padded.
    pub width: usize,
    /// Length of a row of couplings with the border, padded.
    pub coupling: usize,
}

impl Shape {
    /// Length of a row of sensitivities without the padding.
    pub fn used(&self) -> usize {
        self.n + self.dynamic.len()
    }

    /// Length of a row of the panel of a segment with d core rows: M, then what it is solved for.
    pub fn panel(&self, d: usize) -> usize {
        d.next_multiple_of(8) + self.width
    }

    /// Length of the record of a point: its Hessian, then its couplings.
    pub fn record(&self) -> usize {
        (self.n * self.n).next_multiple_of(8) + self.n * self.coupling
    }

    /// Where the couplings start in a record.
    pub fn couplings(&self) -> usize {
        (self.n * self.n).next_multiple_of(8)
    }

    /// Number of variables of a form: two ends of a group and the border.
    pub fn form(&self) -> usize {
        2 * self.n + self.border
    }
}

/// Entries by the panel that they go to: item = (entry, place in the panel).
#[derive(Clone, Debug, Default)]
pub(super) struct Items {
    pub start: Vec<u32>,
    pub items: Vec<(u32, u32)>,
}

impl Items {
    /// Sorts (panel, entry, place) by panel, entries in their order.
    fn new(panels: usize, entries: &[(u32, u32, u32)]) -> Items {
        let mut start = vec![0u32; panels + 1];
        for e in entries {
            start[e.0 as usize + 1] += 1;
        }
        for i in 0..panels {
            start[i + 1] += start[i];
        }
        let (mut next, mut items) = (start.clone(), vec![(0, 0); entries.len()]);
        for &(panel, entry, place) in entries {
            let at = &mut next[panel as usize];
            items[*at as usize] = (entry, place);
            *at += 1;
        }
        Items { start, items }
    }

    #[inline(always)]
    pub fn of(&self, panel: usize) -> &[(u32, u32)] {
        &self.items[self.start[panel] as usize..self.start[panel + 1] as usize]
    }
}

/// Where the parts of a chain's own rows and points stand, and which entries they take.
///
/// The *own rows* of a chain are numbered segment by segment, first those of the points in the chain
/// (its *core*), then those of its ties; own variables alike. Point 0 is the first of the chain, the
/// others follow in the order of own rows.
#[derive(Clone, Debug)]
pub(super) struct ChainPlan {
    pub chain: Chain,
    /// Core rows of a segment, d.
    pub d: usize,
    /// Number of ties before each segment, and the total.
    pub ties: Vec<u32>,
    /// Jacobian entries by segment.
    pub jacobian: Items,
    /// Hessian entries by point.
    pub hessian: Items,
}

/// The whole structure.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub shape: Shape,
    pub chains: Vec<ChainPlan>,
    /// Hessian entries between border variables: (entry, row, column).
    pub border: Vec<(u32, u32, u32)>,
}

/// Chain, segment and place in the segment's own rows; or in the first point.
#[derive(Clone, Copy)]
struct Place {
    chain: u32,
    /// Segment + 1; 0 for the first point.
    after: u32,
    index: u32,
}

impl ChainPlan {
    /// First own row of a segment.
    #[inline(always)]
    pub fn row(&self, segment: usize, n: usize) -> usize {
        segment * self.d + self.ties[segment] as usize * n
    }

    /// Number of points of a segment's own.
    #[inline(always)]
    pub fn points(&self, segment: usize) -> usize {
        self.chain.points + (self.ties[segment + 1] - self.ties[segment]) as usize
    }

    /// Ties of a segment.
    pub fn ties_of(&self, segment: usize) -> &[crate::nlp::Tie] {
        &self.chain.ties[self.ties[segment] as usize..self.ties[segment + 1] as usize]
    }
}

impl Plan {
    /// Sorts all entries; `None` where an entry does not fit the chains.
    pub fn new(
        chains: &Chains,
        hessian: &Structure,
        jacobian: &Structure,
        n: usize,
        m: usize,
    ) -> Option<Plan> {
        let (n_x, border) = (chains.n_x, chains.border);
        let mut shape = Shape { n: n_x, border, ..Shape::default() };
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
        shape.dynamic = (0..border).filter(|&b| dynamic[b]).collect();
        shape.coupled = (0..border).filter(|&b| coupled[b]).collect();
        shape.width = shape.used().next_multiple_of(8);
        shape.coupling = shape.coupled.len().next_multiple_of(8);

        let nowhere = Place { chain: u32::MAX, after: 0, index: 0 };
        let (mut variables, mut rows) = (vec![nowhere; n], vec![nowhere; m]);
        let mut plans = Vec::new();
        for (c, chain) in chains.chains.iter().enumerate() {
            let d = chain.points * n_x;
            let mut ties = vec![0u32; chain.segments + 1];
            for tie in &chain.ties {
                ties[tie.segment + 1] += 1;
            }
            (0..chain.segments).for_each(|s| ties[s + 1] += ties[s]);
            let place = |after: usize, index: usize| Place {
                chain: c as u32,
                after: after as u32,
                index: index as u32,
            };
            for i in 0..n_x {
                variables[chain.variable + i] = place(0, i);
            }
            for s in 0..chain.segments {
                for i in 0..d {
                    variables[chain.variable + n_x + s * d + i] = place(s + 1, i);
                    rows[chain.row + s * d + i] = place(s + 1, i);
                }
            }
            for (t, tie) in chain.ties.iter().enumerate() {
                let first = d + (t - ties[tie.segment] as usize) * n_x;
                for i in 0..n_x {
                    variables[tie.variable + i] = place(tie.segment + 1, first + i);
                    rows[tie.row + i] = place(tie.segment + 1, first + i);
                }
            }
            let none = Items::default();
            plans.push(ChainPlan { chain: chain.clone(), d, ties, jacobian: none.clone(), hessian: none });
        }

        let column_of = positions(&shape.dynamic, border, n_x);
        let mut entries: Vec<Vec<(u32, u32, u32)>> = vec![Vec::new(); plans.len()];
        for (t, (&row, &column)) in jacobian.rows.iter().zip(&jacobian.columns).enumerate() {
            let (row, column) = (rows[row as usize], column as usize);
            let plan = plans.get(row.chain as usize)?;
            let (segment, i) = (row.after as usize - 1, row.index as usize);
            let length = shape.panel(plan.d);
            let sensitivity = |column: usize| i * length + plan.d.next_multiple_of(8) + column;
            let place = if column < border {
                sensitivity(column_of[column])
            } else {
                let v = variables[column];
                let j = v.index as usize;
                if v.chain != row.chain {
                    return None;
                } else if v.after == row.after {
                    if j < plan.d {
                        i * length + j
                    } else if j == i {
                        continue; // a tie's own variable: the structure makes it 1
                    } else {
                        return None;
                    }
                } else if v.after + 1 == row.after && (v.after == 0 || (plan.d - n_x..plan.d).contains(&j)) {
                    sensitivity(if v.after == 0 { j } else { j + n_x - plan.d })
                } else {
                    return None;
                }
            };
            entries[row.chain as usize].push((segment as u32, t as u32, place as u32));
        }
        for (plan, entries) in plans.iter_mut().zip(&entries) {
            plan.jacobian = Items::new(plan.chain.segments, entries);
        }

        let coupling_of = positions(&shape.coupled, border, 0);
        let mut between = Vec::new();
        entries.iter_mut().for_each(Vec::clear);
        for (t, (&row, &column)) in hessian.rows.iter().zip(&hessian.columns).enumerate() {
            let (low, high) = (row.min(column) as usize, row.max(column) as usize);
            if high < border {
                between.push((t as u32, high as u32, low as u32));
                continue;
            }
            let v = variables[high];
            let plan = plans.get(v.chain as usize)?;
            let (point, i) = point_of(plan, v, n_x);
            let list = &mut entries[v.chain as usize];
            if low < border {
                let at = shape.couplings() + i * shape.coupling + coupling_of[low];
                list.push((point as u32, t as u32, at as u32));
            } else {
                let other = variables[low];
                if other.chain != v.chain || point_of(plan, other, n_x).0 != point {
                    return None;
                }
                let j = point_of(plan, other, n_x).1;
                list.push((point as u32, t as u32, (i * n_x + j) as u32));
                if i != j {
                    list.push((point as u32, t as u32, (j * n_x + i) as u32));
                }
            }
        }
        for (plan, entries) in plans.iter_mut().zip(&entries) {
            let points = 1 + plan.row(plan.chain.segments, n_x) / n_x;
            plan.hessian = Items::new(points, entries);
        }
        let complete = variables[border..].iter().all(|v| v.chain != u32::MAX)
            && rows.iter().all(|r| r.chain != u32::MAX);
        complete.then_some(Plan { shape, chains: plans, border: between })
    }
}

/// For each border variable of a set its number in it, counted from `first`.
fn positions(set: &[usize], border: usize, first: usize) -> Vec<usize> {
    let mut position = vec![usize::MAX; border];
    set.iter().enumerate().for_each(|(i, &b)| position[b] = first + i);
    position
}

/// Point of a chain, and component.
fn point_of(plan: &ChainPlan, v: Place, n: usize) -> (usize, usize) {
    if v.after == 0 {
        return (0, v.index as usize);
    }
    let row = plan.row(v.after as usize - 1, n) + v.index as usize;
    (1 + row / n, row % n)
}
