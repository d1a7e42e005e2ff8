//! The assignment of the entries of the Newton system: from triplets to the panels of segments and points.

use super::chain::ChainPlan;
use super::items::{Items, Slot};
use super::part::{Part, PartPlan};
use super::places::Places;
use super::shape::{Shape, positions};
use crate::interrupt::current;
use crate::nlp::{Chains, Structure};

/// An entry of the Hessian between two border variables.
#[derive(Clone, Copy, Debug)]
pub(super) struct BorderEntry {
    pub entry: u32,
    pub row: u32,
    pub column: u32,
}

/// The whole structure.
#[derive(Clone, Debug)]
pub(super) struct Plan {
    pub shape: Shape,
    pub chains: Vec<ChainPlan>,
    /// Hessian entries between border variables.
    pub border: Vec<BorderEntry>,
}

impl Plan {
    /// Sorts all entries; `None` where an entry does not fit the chains.
    pub fn new(
        chains: &Chains,
        hessian: &Structure,
        jacobian: &Structure,
        sizes: (usize, usize),
        units: &[f64],
    ) -> Option<Plan> {
        let (n, border) = (chains.n_x, chains.border);
        let mut shape = Shape::new(chains, hessian, jacobian)?;
        let plans = chains.chains.iter().map(|chain| ChainPlan::new(chain, n, border));
        let mut plans = plans.collect::<Option<Vec<_>>>()?;
        let places = Places::new(&plans, n, sizes);
        if current().stops() {
            return None;
        }
        shape.find_parts(&places, jacobian);

        let mut of_rows = rows_by_panel(&shape, &plans, &places, jacobian)?.into_iter();
        let of_points = points_by_panel(&shape, &plans, &places, hessian)?;
        for (plan, of_points) in plans.iter_mut().zip(of_points) {
            let points = (plan.chain.points, plan.chain.points + plan.most_ties());
            let own = shape.parts.iter().zip(&mut of_rows);
            plan.parts = own.map(|(part, items)| PartPlan::new(part, points, items, units)).collect();
            plan.boundary = of_rows.next()?;
            plan.bend(of_points, n, n + shape.coupled.len(), units);
        }
        shape.meet(plans.iter().flat_map(ChainPlan::all_runs));
        let border = between_border(hessian, border);
        places.are_complete(shape.border).then_some(Plan { shape, chains: plans, border })
    }
}

/// Entries of the Jacobian: for each chain those of each part by segment, then those of the boundary conditions.
fn rows_by_panel(
    shape: &Shape,
    plans: &[ChainPlan],
    places: &Places,
    jacobian: &Structure,
) -> Option<Vec<Items>> {
    let (n, border) = (shape.n, shape.border);
    let (variables, rows) = (&*places.variables, &*places.rows);
    let mut part_of = vec![(0, 0); n]; // part of a state, and place in it
    for (p, part) in shape.parts.iter().enumerate() {
        part.states.iter().enumerate().for_each(|(i, &s)| part_of[s] = (p, i));
    }
    // For an own row of a segment its part, and its place among the part's own.
    let most = plans.iter().map(|plan| plan.chain.points + plan.most_ties()).max().unwrap_or(0);
    let own_row = |index: usize| {
        let (p, i) = part_of[index % n];
        (p, index / n * shape.parts[p].states.len() + i)
    };
    let of_row: Vec<(usize, usize)> = (0..most * n).map(own_row).collect();

    let column_of = positions(&shape.dynamic, border, 0);
    let of_part: Vec<Vec<usize>> =
        shape.parts.iter().map(|part| positions(&part.dynamic, shape.dynamic.len(), 0)).collect();
    let place = |t: usize| -> Slot {
        let (row, column) = (rows[jacobian.rows[t] as usize], jacobian.columns[t] as usize);
        let plan = plans.get(row.chain as usize)?;
        let i = row.index as usize;
        let last = plan.d.checked_sub(n)?;
        if row.is_boundary() {
            let v = variables[column];
            let j = v.index as usize;
            let at_end = v.after as usize == plan.chain.segments && (last..plan.d).contains(&j);
            let column = if column < border {
                2 * n + column_of[column]
            } else if v.chain == row.chain && v.after == 0 {
                j
            } else if v.chain == row.chain && at_end {
                n + j - last
            } else {
                return None;
            };
            return Some(Some(i * (n + shape.used()) + column));
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
    let n_parts = shape.parts.len();
    let of_chain = |plan: &ChainPlan| std::iter::repeat_n(plan.chain.segments, n_parts).chain([1]);
    let panels: Vec<usize> = plans.iter().flat_map(of_chain).collect();
    let first = cumulated(&panels);
    let like = |t: usize| {
        let (row, column) = (rows[jacobian.rows[t] as usize], jacobian.columns[t] as usize);
        let other = if column < border {
            (u32::MAX, column as u32, 0, false)
        } else {
            let v = variables[column];
            (v.chain, v.index, row.after.wrapping_sub(v.after), v.after == 0)
        };
        (!row.is_boundary()).then_some((row.chain, row.index, other))
    };
    let panel = |t: usize| -> Slot {
        let row = rows[jacobian.rows[t] as usize];
        let (items, segment) = if row.is_boundary() {
            (n_parts, 0)
        } else {
            (of_row[row.index as usize].0, row.after as usize - 1)
        };
        Some(Some(first.get(row.chain as usize * (n_parts + 1) + items)? + segment))
    };
    Items::sorted(&panels, jacobian.len(), panel, like, place)
}

/// Entries of the Hessian, for each chain by its first point and its segments: at places in records of n² pairs of
/// states and n rows across.
fn points_by_panel(
    shape: &Shape,
    plans: &[ChainPlan],
    places: &Places,
    hessian: &Structure,
) -> Option<Vec<Items>> {
    let (n, border, variables) = (shape.n, shape.border, &*places.variables);
    let coupling_of = positions(&shape.coupled, border, n);
    let across = n + shape.coupled.len();
    let place = |t: usize| -> Slot {
        let (low, high) = ends(hessian, t);
        if high < border {
            return Some(None);
        }
        let v = variables[high];
        let (point, i) = (v.index as usize / n, v.index as usize % n);
        let other = if low < border {
            coupling_of[low]
        } else {
            let other = variables[low];
            let same = (other.chain, other.after, other.index as usize / n) == (v.chain, v.after, point);
            if !same {
                return None;
            }
            other.index as usize % n
        };
        // In the order in which they are worked on: states before the border.
        let within = if low < border { n * n + i * across + other } else { i * n + other };
        Some(Some(point * (n * n + n * across) + within))
    };
    let like = |t: usize| {
        let (low, high) = ends(hessian, t);
        let v = variables[high];
        if low < border {
            return (high >= border).then_some((v.index, low as u32, true));
        }
        let other = variables[low];
        ((other.chain, other.after) == (v.chain, v.after)).then_some((v.index, other.index, false))
    };
    let panels: Vec<usize> = plans.iter().map(|plan| plan.chain.segments + 1).collect();
    let first = cumulated(&panels);
    let panel = |t: usize| -> Slot {
        let (_, high) = ends(hessian, t);
        if high < border {
            return Some(None);
        }
        let v = variables[high];
        Some(Some(first.get(v.chain as usize)? + v.after as usize))
    };
    Items::sorted(&panels, hessian.len(), panel, like, place)
}

/// Entries of the Hessian between border variables: (entry, row, column).
fn between_border(hessian: &Structure, border: usize) -> Vec<BorderEntry> {
    let entry = |t: usize| {
        let (low, high) = ends(hessian, t);
        (high < border).then_some(BorderEntry { entry: t as u32, row: high as u32, column: low as u32 })
    };
    (0..hessian.len()).filter_map(entry).collect()
}

/// The variables of an entry of the Hessian, the lower first.
fn ends(hessian: &Structure, t: usize) -> (usize, usize) {
    let (row, column) = (hessian.rows[t], hessian.columns[t]);
    (row.min(column) as usize, row.max(column) as usize)
}

/// Sums of what comes before each.
fn cumulated(counts: &[usize]) -> Vec<usize> {
    let sums = counts.iter().scan(0, |sum, count| {
        *sum += count;
        Some(*sum - count)
    });
    sums.collect()
}
