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
///
/// Programs write the entries of consecutive panels side by side, so what a panel takes is mostly what
/// the one before it takes, each entry one further: it is kept once for all of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Items {
    /// For each panel: where its items start, their number, and what to add to their entries.
    panels: Vec<(u32, u32, u32)>,
    items: Vec<(u32, u32)>,
}

impl Items {
    /// Sorts the entries of a matrix by panel. The panels are those of several chains, `panels` of each,
    /// numbered through. `None` where an entry does not fit.
    fn sorted(
        panels: &[usize],
        entries: usize,
        panel: impl Fn(usize) -> Slot,
        place: impl Fn(usize) -> Slot,
    ) -> Option<Vec<Items>> {
        let total: usize = panels.iter().sum();
        let mut starts = vec![0u32; total + 1];
        for t in 0..entries {
            if let Some(panel) = panel(t)? {
                starts[panel + 1] += 1;
            }
        }
        for i in 0..total {
            starts[i + 1] += starts[i];
        }
        let mut ends = starts[..total].to_vec();
        let mut items = vec![(0, 0); starts[total] as usize];
        for t in 0..entries {
            if let (Some(panel), Some(place)) = (panel(t)?, place(t)?) {
                items[ends[panel] as usize] = (t as u32, place as u32);
                ends[panel] += 1;
            }
        }
        let mut first = 0;
        let of_chain = panels.iter().map(|&count| {
            let own = first..first + count;
            first += count;
            Items::folded(own.map(|p| &items[starts[p] as usize..ends[p] as usize]))
        });
        Some(of_chain.collect())
    }

    /// Keeps what differs from panel to panel.
    fn folded<'a>(panels: impl Iterator<Item = &'a [(u32, u32)]>) -> Items {
        let mut folded = Items::default();
        for own in panels {
            let repeated = folded.panels.last().filter(|&&(start, count, add)| {
                let before = &folded.items[start as usize..(start + count) as usize];
                before.len() == own.len() && before.iter().zip(own).all(|(b, o)| (b.0 + add + 1, b.1) == *o)
            });
            let panel = match repeated {
                Some(&(start, count, add)) => (start, count, add + 1),
                None => (folded.items.len() as u32, own.len() as u32, 0),
            };
            if panel.2 == 0 {
                folded.items.extend(own);
            }
            folded.panels.push(panel);
        }
        folded.items.shrink_to_fit();
        folded
    }

    /// The items of a panel.
    #[inline(always)]
    pub fn of(&self, panel: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let (start, count, add) = self.panels[panel];
        self.items[start as usize..(start + count) as usize]
            .iter()
            .map(move |&(entry, place)| ((entry + add) as usize, place as usize))
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
    /// Jacobian entries by segment; then those of the boundary conditions, at their places in rows of
    /// (first states, last states, dynamic border).
    pub jacobian: Items,
    /// Hessian entries of the first point, and of the own points of each segment, one record after the
    /// other.
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

/// Panel of an entry, or place in it; `Some(None)` for an entry that needs none, `None` where it does not fit.
type Slot = Option<Option<usize>>;

/// Instead of the segment of a row, for a boundary condition.
const BOUNDARY: u32 = u32::MAX;

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

    /// Most ties of a segment.
    pub fn most_ties(&self) -> usize {
        self.ties.windows(2).map(|t| (t[1] - t[0]) as usize).max().unwrap_or(0)
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
            for i in 0..chain.boundary.states.len() {
                rows[chain.boundary.row + i] = Place { chain: c as u32, after: BOUNDARY, index: i as u32 };
            }
            if chain.boundary.states.len() > n_x {
                return None;
            }
            let none = Items::default();
            plans.push(ChainPlan { chain: chain.clone(), d, ties, jacobian: none.clone(), hessian: none });
        }

        let column_of = positions(&shape.dynamic, border, n_x);
        let place = |t: usize| -> Slot {
            let (row, column) = (rows[jacobian.rows[t] as usize], jacobian.columns[t] as usize);
            let plan = plans.get(row.chain as usize)?;
            let i = row.index as usize;
            if row.after == BOUNDARY {
                let v = variables[column];
                let (j, last) = (v.index as usize, plan.d - n_x);
                let column = if column < border {
                    n_x + column_of[column]
                } else if v.chain == row.chain && v.after == 0 {
                    j
                } else if v.chain == row.chain
                    && v.after as usize == plan.chain.segments
                    && (last..plan.d).contains(&j)
                {
                    n_x + j - last
                } else {
                    return None;
                };
                return Some(Some(i * (n_x + shape.used()) + column));
            }
            let first = plan.d.next_multiple_of(8);
            let column = if column < border {
                first + column_of[column]
            } else {
                let v = variables[column];
                let j = v.index as usize;
                let last = plan.d - n_x;
                if v.chain != row.chain {
                    return None;
                } else if v.after == row.after && j < plan.d {
                    j
                } else if v.after == row.after && j == i {
                    return Some(None); // a tie's own variable: the structure makes it 1
                } else if v.after == 0 && row.after == 1 {
                    first + j
                } else if v.after + 1 == row.after && (last..plan.d).contains(&j) {
                    first + j - last
                } else {
                    return None;
                }
            };
            Some(Some(i * shape.panel(plan.d) + column))
        };
        let panels: Vec<usize> = plans.iter().map(|plan| plan.chain.segments + 1).collect();
        let first: Vec<usize> = cumulated(&panels);
        let panel = |t: usize| -> Slot {
            let row = rows[jacobian.rows[t] as usize];
            let c = row.chain as usize;
            let own = if row.after == BOUNDARY { panels.get(c)? } else { &(row.after as usize) };
            Some(Some(first.get(c)? + own - 1))
        };
        let sorted_jacobian = Items::sorted(&panels, jacobian.len(), panel, place)?;

        let coupling_of = positions(&shape.coupled, border, 0);
        let place = |t: usize| -> Slot {
            let (row, column) = (hessian.rows[t], hessian.columns[t]);
            let (low, high) = (row.min(column) as usize, row.max(column) as usize);
            if high < border {
                return Some(None);
            }
            let v = variables[high];
            let (point, i) = (v.index as usize / n_x, v.index as usize % n_x);
            let within = if low < border {
                shape.couplings() + i * shape.coupling + coupling_of[low]
            } else {
                let other = variables[low];
                let same =
                    (other.chain, other.after, other.index as usize / n_x) == (v.chain, v.after, point);
                if !same {
                    return None;
                }
                i * n_x + other.index as usize % n_x
            };
            Some(Some(point * shape.record() + within))
        };
        let panel = |t: usize| -> Slot {
            let high = hessian.rows[t].max(hessian.columns[t]) as usize;
            if high < border {
                return Some(None);
            }
            let v = variables[high];
            Some(Some(first.get(v.chain as usize)? + v.after as usize))
        };
        let sorted_hessian = Items::sorted(&panels, hessian.len(), panel, place)?;
        let between =
            (0..hessian.len()).filter(|&t| (hessian.rows[t].max(hessian.columns[t]) as usize) < border);
        let between = between
            .map(|t| {
                let (row, column) = (hessian.rows[t], hessian.columns[t]);
                (t as u32, row.max(column), row.min(column))
            })
            .collect();
        for ((plan, jacobian), hessian) in plans.iter_mut().zip(sorted_jacobian).zip(sorted_hessian) {
            (plan.jacobian, plan.hessian) = (jacobian, hessian);
        }
        let complete = variables[border..].iter().all(|v| v.chain != u32::MAX)
            && rows.iter().all(|r| r.chain != u32::MAX);
        complete.then_some(Plan { shape, chains: plans, border: between })
    }
}

/// Sums of what comes before each.
fn cumulated(counts: &[usize]) -> Vec<usize> {
    let sums = counts.iter().scan(0, |sum, count| {
        *sum += count;
        Some(*sum - count)
    });
    sums.collect()
}

/// For each border variable of a set its number in it, counted from `first`.
fn positions(set: &[usize], border: usize, first: usize) -> Vec<usize> {
    let mut position = vec![usize::MAX; border];
    set.iter().enumerate().for_each(|(i, &b)| position[b] = first + i);
    position
}
