//! Which entry of the Newton system goes where: from triplets to the panels of segments and points.

use std::ops::Range;

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
    pub parts: Vec<Part>,
    /// Length of a row of sensitivities of all parts.
    pub width: usize,
}

/// States that no others enter: a system that falls apart, like one of modes, is eliminated part by part.
///
/// Only the Hessian couples parts, through outputs that depend on several.
#[derive(Clone, Debug)]
pub(super) struct Part {
    /// In ascending order.
    pub states: Vec<usize>,
    /// Places in [`Shape::dynamic`] of what enters their equations.
    pub dynamic: Vec<usize>,
    /// Length of a row of sensitivities to (first states of a group, dynamic border) of the part, padded.
    pub width: usize,
    /// Where these columns start in a row of all parts.
    pub first: usize,
    /// Columns of [H Z, K], from the part's own on, that are not zero in its rows: whole vectors.
    pub meets: Vec<Range<usize>>,
}

impl Part {
    /// Length of a row of sensitivities without the padding.
    pub fn used(&self) -> usize {
        self.states.len() + self.dynamic.len()
    }

    /// Rows of a segment with so many points.
    pub fn rows(&self, points: usize) -> usize {
        points * self.states.len()
    }

    /// Where, in the panel of a segment with d own core rows, stands what M is solved for.
    pub fn right(d: usize) -> usize {
        d.next_multiple_of(8)
    }

    /// Length of a row of the panel of a segment with so many core points: M, then what it is solved for.
    pub fn panel(&self, points: usize) -> usize {
        Part::right(self.rows(points)) + self.width
    }

    /// Among the rows of a segment, all states together, that of a row of the part.
    #[inline(always)]
    pub fn row(&self, own: usize, n: usize) -> usize {
        own / self.states.len() * n + self.states[own % self.states.len()]
    }
}

impl Shape {
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
    fn meet<'a>(&mut self, runs: impl Iterator<Item = &'a Run>) {
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

    /// For each column of a row of all parts its variable in a form's order without the end of the group:
    /// first states, then the dynamic border. Padding has none.
    pub fn columns(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.parts.iter().flat_map(|part| {
            let dynamic = part.dynamic.iter().map(|d| self.n + d);
            part.states.iter().copied().chain(dynamic).enumerate().map(|(i, v)| (part.first + i, v))
        })
    }
}

/// Entries of the Hessian of a point that stand side by side: of a state with other states, or with border
/// variables of those coupled.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    /// Among the points of a panel.
    pub point: u32,
    pub state: u16,
    /// The first of the others, and their number.
    pub other: u16,
    pub count: u16,
    pub coupled: bool,
}

impl Run {
    /// The places of the others.
    #[inline(always)]
    pub fn others(&self) -> Range<usize> {
        self.other as usize..self.other as usize + self.count as usize
    }

    /// Whether another entry is the next of the run.
    fn goes_on(&self, next: &Run) -> bool {
        (self.point, self.state, self.coupled) == (next.point, next.state, next.coupled)
            && self.others().end == next.other as usize
            && self.count < u16::MAX
    }

    /// Runs with their values, which follow each other; those of zeros are left out.
    #[inline(always)]
    pub fn with<'a>(runs: &'a [Run], mut values: &'a [f64]) -> impl Iterator<Item = (&'a Run, &'a [f64])> {
        runs.iter().filter_map(move |run| {
            let (own, after) = values.split_at(run.count as usize);
            values = after;
            own.iter().any(|v| *v != 0.0).then_some((run, own))
        })
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
            if repeated.is_none() {
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

/// Where a chain's own rows and points stand, and which entries they take.
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
    /// For each part its Jacobian entries by segment.
    pub parts: Vec<PartPlan>,
    /// Those of the boundary conditions, at their places in rows of (first states, last states, dynamic
    /// border).
    pub boundary: Items,
    /// Hessian entries of the first point, and of the own points of each segment.
    pub hessian: Items,
    /// What they add up to, point by point, states before the border; the factors of these sums from the
    /// program into units; and where both stand for each panel.
    runs: Vec<Run>,
    factors: Vec<f64>,
    spans: Vec<(Range<u32>, Range<u32>)>,
}

/// A part along a chain.
#[derive(Clone, Debug)]
pub(super) struct PartPlan {
    pub jacobian: Items,
    /// What the rows of a panel are multiplied by, 1/unit of each state, and its columns: the unit of own
    /// states, then −unit of states before, −1 for θ.
    pub rows: Vec<f64>,
    pub columns: Vec<f64>,
    /// For each row of a segment its state in the part, and its place among the segment's own rows.
    pub place: Vec<(u32, u32)>,
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
        self.point(segment) * n
    }

    /// Points before a segment, the chain's first left out.
    #[inline(always)]
    pub fn point(&self, segment: usize) -> usize {
        segment * self.chain.points + self.ties[segment] as usize
    }

    /// Number of points of a segment's own.
    #[inline(always)]
    pub fn points(&self, segment: usize) -> usize {
        self.chain.points + (self.ties[segment + 1] - self.ties[segment]) as usize
    }

    /// The runs of a panel of the Hessian.
    #[inline(always)]
    pub fn runs(&self, panel: usize) -> &[Run] {
        let span = &self.spans[panel].0;
        &self.runs[span.start as usize..span.end as usize]
    }

    /// For each value of a panel its factor into units.
    #[inline(always)]
    pub fn factors(&self, panel: usize) -> &[f64] {
        let span = &self.spans[panel].1;
        &self.factors[span.start as usize..span.end as usize]
    }

    /// Takes the entries of the Hessian, at places in records of n² pairs of states and n rows across:
    /// entries of one place are one value, and its number takes the place's stead.
    fn bend(&mut self, mut hessian: Items, n: usize, across: usize, units: &[f64]) {
        let record = n * n + n * across;
        let mut last = (u32::MAX, 0);
        for &(start, count, _) in &hessian.panels {
            // One without entries starts where the next does.
            if (start, count) == last {
                self.spans.push(self.spans[self.spans.len() - 1].clone());
                continue;
            }
            last = (start, count);
            let (first_run, first) = (self.runs.len(), self.factors.len());
            let items = &mut hessian.items[start as usize..(start + count) as usize];
            items.sort_by_key(|item| item.1);
            let mut before = u32::MAX;
            for (_, place) in items {
                let at = std::mem::replace(&mut before, *place);
                if at != *place {
                    let (point, within) = (*place as usize / record, *place as usize % record);
                    let coupled = within >= n * n;
                    let (state, other) = if coupled {
                        ((within - n * n) / across, (within - n * n) % across - n)
                    } else {
                        (within / n, within % n)
                    };
                    self.factors.push(units[state] * if coupled { 1.0 } else { units[other] });
                    let (point, state, other) = (point as u32, state as u16, other as u16);
                    let next = Run { point, state, other, count: 1, coupled };
                    match self.runs[first_run..].last_mut() {
                        Some(run) if run.goes_on(&next) => run.count += 1,
                        _ => self.runs.push(next),
                    }
                }
                *place = (self.factors.len() - first - 1) as u32;
            }
            let (runs, factors) = (self.runs.len() as u32, self.factors.len() as u32);
            self.spans.push((first_run as u32..runs, first as u32..factors));
        }
        self.hessian = hessian;
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
        (n, m): (usize, usize),
        units: &[f64],
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
        if n_x.max(shape.coupled.len()) > usize::from(u16::MAX) {
            return None;
        }

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
            // More than the ends can meet; or nothing is left that varies.
            let k = chain.boundary.states.len();
            if k > n_x || (k == n_x && border == 0) {
                return None;
            }
            let (boundary, hessian) = (Items::default(), Items::default());
            plans.push(ChainPlan {
                chain: chain.clone(),
                d,
                ties,
                parts: Vec::new(),
                boundary,
                hessian,
                factors: Vec::new(),
                runs: Vec::new(),
                spans: Vec::new(),
            });
        }

        shape.parts = parts(&shape, jacobian, &rows, &variables);
        shape.width = shape.parts.last().map_or(0, |part| part.first + part.width);
        let mut part_of = vec![(0, 0); n_x]; // part of a state, and place in it
        for (p, part) in shape.parts.iter().enumerate() {
            part.states.iter().enumerate().for_each(|(i, &s)| part_of[s] = (p, i));
        }
        // For an own row of a segment its part, and its place among the part's own.
        let most = plans.iter().map(|plan| plan.chain.points + plan.most_ties()).max().unwrap_or(0);
        let own_row = |index: usize| {
            let (p, i) = part_of[index % n_x];
            (p, index / n_x * shape.parts[p].states.len() + i)
        };
        let of_row: Vec<(usize, usize)> = (0..most * n_x).map(own_row).collect();

        let column_of = positions(&shape.dynamic, border, 0);
        let of_part: Vec<Vec<usize>> =
            shape.parts.iter().map(|part| positions(&part.dynamic, shape.dynamic.len(), 0)).collect();
        let place = |t: usize| -> Slot {
            let (row, column) = (rows[jacobian.rows[t] as usize], jacobian.columns[t] as usize);
            let plan = plans.get(row.chain as usize)?;
            let i = row.index as usize;
            let last = plan.d.checked_sub(n_x)?;
            if row.after == BOUNDARY {
                let v = variables[column];
                let j = v.index as usize;
                let column = if column < border {
                    2 * n_x + column_of[column]
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
            let (p, i_own) = of_row[i];
            let part = &shape.parts[p];
            let right = Part::right(part.rows(plan.chain.points));
            let column = if column < border {
                right + part.states.len() + of_part[p][column_of[column]]
            } else {
                let v = variables[column];
                let j = v.index as usize;
                if v.chain != row.chain {
                    return None;
                } else if v.after == row.after && j < plan.d {
                    of_row[j].1
                } else if v.after == row.after && j == i {
                    return Some(None); // a tie's own variable: the structure makes it 1
                } else if v.after == 0 && row.after == 1 {
                    right + of_row[j].1
                } else if v.after + 1 == row.after && (last..plan.d).contains(&j) {
                    right + of_row[j - last].1
                } else {
                    return None;
                }
            };
            Some(Some(i_own * part.panel(plan.chain.points) + column))
        };
        // For each chain the segments of each part, then the boundary.
        let n_parts = shape.parts.len();
        let panels: Vec<usize> = plans
            .iter()
            .flat_map(|plan| std::iter::repeat_n(plan.chain.segments, n_parts).chain([1]))
            .collect();
        let first = cumulated(&panels);
        let panel = |t: usize| -> Slot {
            let row = rows[jacobian.rows[t] as usize];
            let (items, segment) = if row.after == BOUNDARY {
                (n_parts, 0)
            } else {
                (of_row[row.index as usize].0, row.after as usize - 1)
            };
            Some(Some(first.get(row.chain as usize * (n_parts + 1) + items)? + segment))
        };
        let sorted_jacobian = Items::sorted(&panels, jacobian.len(), panel, place)?;

        let coupling_of = positions(&shape.coupled, border, n_x);
        let across = n_x + shape.coupled.len();
        let place = |t: usize| -> Slot {
            let (row, column) = (hessian.rows[t], hessian.columns[t]);
            let (low, high) = (row.min(column) as usize, row.max(column) as usize);
            if high < border {
                return Some(None);
            }
            let v = variables[high];
            let (point, i) = (v.index as usize / n_x, v.index as usize % n_x);
            let other = if low < border {
                coupling_of[low]
            } else {
                let other = variables[low];
                let same =
                    (other.chain, other.after, other.index as usize / n_x) == (v.chain, v.after, point);
                if !same {
                    return None;
                }
                other.index as usize % n_x
            };
            // In the order in which they are worked on: states before the border.
            let within = if low < border { n_x * n_x + i * across + other } else { i * n_x + other };
            Some(Some(point * (n_x * n_x + n_x * across) + within))
        };
        let panels: Vec<usize> = plans.iter().map(|plan| plan.chain.segments + 1).collect();
        let first = cumulated(&panels);
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
        let mut sorted_jacobian = sorted_jacobian.into_iter();
        for (plan, hessian) in plans.iter_mut().zip(sorted_hessian) {
            let most = plan.chain.points + plan.most_ties();
            plan.parts = shape
                .parts
                .iter()
                .zip(&mut sorted_jacobian)
                .map(|(part, jacobian)| PartPlan::new(part, (plan.chain.points, most), jacobian, units))
                .collect();
            plan.boundary = sorted_jacobian.next()?;
            plan.bend(hessian, n_x, across, units);
        }
        shape.meet(plans.iter().flat_map(|plan| &plan.runs));
        let complete = variables[border..].iter().all(|v| v.chain != u32::MAX)
            && rows.iter().all(|r| r.chain != u32::MAX);
        complete.then_some(Plan { shape, chains: plans, border: between })
    }
}

impl PartPlan {
    fn new(part: &Part, (points, most): (usize, usize), jacobian: Items, units: &[f64]) -> PartPlan {
        let own: Vec<f64> = part.states.iter().map(|&s| units[s]).collect();
        let (n, d) = (own.len(), part.rows(points));
        let right = Part::right(d);
        let mut columns = vec![0.0; part.panel(points)];
        columns[..d].iter_mut().zip(own.iter().cycle()).for_each(|(c, u)| *c = *u);
        columns[right..right + n].iter_mut().zip(&own).for_each(|(c, u)| *c = -u);
        columns[right + n..right + part.used()].fill(-1.0);
        let place = (0..part.rows(most)).map(|i| ((i % n) as u32, part.row(i, units.len()) as u32)).collect();
        PartPlan { jacobian, place, rows: own.iter().map(|u| 1.0 / u).collect(), columns }
    }
}

/// The parts that the dynamics fall into: sets of states that no entry of the Jacobian joins.
fn parts(shape: &Shape, jacobian: &Structure, rows: &[Place], variables: &[Place]) -> Vec<Part> {
    let n = shape.n;
    let of_row = |t: usize| {
        let row = rows[jacobian.rows[t] as usize];
        (row.after != BOUNDARY && row.chain != u32::MAX).then(|| row.index as usize % n)
    };
    // Each state points to one of its part, the first of them to itself.
    let mut to: Vec<usize> = (0..n).collect();
    let root = |to: &[usize], mut i: usize| {
        while to[i] != i {
            i = to[i];
        }
        i
    };
    for (t, &column) in jacobian.columns.iter().enumerate().filter(|(_, c)| **c as usize >= shape.border) {
        if let Some(i) = of_row(t) {
            let (a, b) = (root(&to, i), root(&to, variables[column as usize].index as usize % n));
            to[a.max(b)] = a.min(b);
        }
    }
    let roots: Vec<usize> = (0..n).map(|i| root(&to, i)).collect();
    let place = positions(&shape.dynamic, shape.border, 0);
    let mut enters = vec![false; n * shape.dynamic.len()];
    for (t, &column) in jacobian.columns.iter().enumerate().filter(|(_, c)| (**c as usize) < shape.border) {
        if let Some(i) = of_row(t) {
            enters[roots[i] * shape.dynamic.len() + place[column as usize]] = true;
        }
    }
    let mut first = 0;
    let part = |root: usize| {
        let states: Vec<usize> = (0..n).filter(|&i| roots[i] == root).collect();
        let count = shape.dynamic.len();
        let dynamic: Vec<usize> = (0..count).filter(|d| enters[root * count + d]).collect();
        let width = (states.len() + dynamic.len()).next_multiple_of(8);
        first += width;
        Part { states, dynamic, width, first: first - width, meets: Vec::new() }
    };
    (0..n).filter(|&i| roots[i] == i).map(part).collect()
}

impl Plan {
    /// Operations for ZᵀHZ and ZᵀK with some runs of the Hessian.
    pub fn bent(&self, runs: &[Run]) -> u64 {
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
