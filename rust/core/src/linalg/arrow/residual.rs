//! The residual of a solution in the rows of a chain, from the entries of the system.

use super::chain::ChainPlan;
use super::group::{Context, Group};
use super::own::Own;
use super::part::Part;
use super::run::Run;
use super::shape::Shape;
use super::tree::Tree;

impl Tree {
    /// Computes the residual of the chain's rows, and subtracts the chain's terms from `theta`, the residual of the
    /// border, whose solution is `border`. Returns the largest residual of a constraint relative to its terms.
    /// `units` are reciprocals.
    pub fn residual(
        &mut self,
        context: &Context<'_>,
        units: &[f64],
        jacobian: &[f64],
        (border, theta): (&[f64], &mut [f64]),
    ) -> f64 {
        let Context { shape, plan } = *context;
        self.rest.copy(&self.right);
        let (solution, rest, sizes) = (&self.solution, &mut self.rest, &mut *self.sizes);
        let mut residual = Residual { shape, plan, jacobian, solution, rest, border, theta, sizes };
        let of_segments = residual.less_segments();
        let of_boundary = residual.less_boundary(units);
        self.groups.iter().for_each(|group| residual.less_curvature(context, group));
        of_segments.max(of_boundary)
    }
}

/// The rest of a right-hand side, from which terms are taken off.
struct Residual<'a> {
    shape: &'a Shape,
    plan: &'a ChainPlan,
    jacobian: &'a [f64],
    solution: &'a Own,
    rest: &'a mut Own,
    /// Solution of the border, and its rest.
    border: &'a [f64],
    theta: &'a mut [f64],
    /// The sizes of the terms of rows.
    sizes: &'a mut [f64],
}

impl Residual<'_> {
    /// Takes off the rows of all segments, as they stand and transposed; the largest rest of a row.
    fn less_segments(&mut self) -> f64 {
        let Residual { shape, plan, jacobian, solution, rest, border, theta, sizes } = self;
        let (n, d) = (shape.n, plan.d);
        let mut worst: f64 = 0.0;
        for s in 0..plan.chain.segments {
            let (row, end) = (plan.row(s, n), plan.row(s + 1, n));
            let size = &mut sizes[..end - row];
            for (i, size) in size.iter_mut().enumerate() {
                *size = rest.lambda[row + i].abs();
                if i >= d {
                    // A tie's own variable.
                    rest.lambda[row + i] -= solution.x[row + i];
                    *size += solution.x[row + i].abs();
                    rest.x[row + i] -= solution.lambda[row + i];
                }
            }
            for (part, own) in shape.parts.iter().zip(&plan.parts) {
                let (right, length) = (Part::right(part.rows(plan.chain.points)), own.columns.len());
                for (entry, place) in own.jacobian.of(s) {
                    let (i, column) = (place / length, place % length);
                    // Columns after the first d stand on the right-hand side.
                    let (at, i) = own.place[i];
                    let a = jacobian[entry] * own.rows[at as usize] * own.columns[column].abs();
                    let i = i as usize;
                    let (x, p) = if column < right {
                        let core = row + own.place[column].1 as usize;
                        (solution.x[core], &mut rest.x[core])
                    } else if column >= right + part.states.len() {
                        let b = shape.dynamic[part.dynamic[column - right - part.states.len()]];
                        (border[b], &mut theta[b])
                    } else if s == 0 {
                        let state = part.states[column - right];
                        (solution.first[state], &mut rest.first[state])
                    } else {
                        let before = plan.row(s - 1, n) + d - n + part.states[column - right];
                        (solution.x[before], &mut rest.x[before])
                    };
                    *p -= a * solution.lambda[row + i];
                    rest.lambda[row + i] -= a * x;
                    size[i] += (a * x).abs();
                }
            }
            worst = worst.max(largest(&rest.lambda[row..end], size));
        }
        worst
    }

    /// Subtracts the terms of the boundary conditions.
    fn less_boundary(&mut self, units: &[f64]) -> f64 {
        let Residual { shape, plan, jacobian, solution, rest, border, theta, sizes } = self;
        let n = shape.n;
        let (columns, last) = (n + shape.used(), plan.row(plan.chain.segments - 1, n) + plan.d - n);
        sizes.iter_mut().zip(&rest.boundary).for_each(|(s, r)| *s = r.abs());
        for (entry, place) in plan.boundary.of(0) {
            let (i, column) = (place / columns, place % columns);
            let a = jacobian[entry] * plan.boundary_factor(units, i, column);
            let (x, p) = if column < n {
                (solution.first[column], &mut rest.first[column])
            } else if column < 2 * n {
                (solution.x[last + column - n], &mut rest.x[last + column - n])
            } else {
                let b = shape.dynamic[column - 2 * n];
                (border[b], &mut theta[b])
            };
            *p -= a * solution.boundary[i];
            rest.boundary[i] -= a * x;
            sizes[i] += (a * x).abs();
        }
        largest(&rest.boundary, sizes)
    }

    /// Takes off the Hessian of a group's points.
    fn less_curvature(&mut self, context: &Context<'_>, group: &Group) {
        let Residual { shape, solution, rest, border, theta, .. } = self;
        let n = shape.n;
        let mut bend = |x: &mut [f64], y: &[f64], run: &Run, values: &[f64]| {
            let i = run.state as usize;
            for (j, value) in run.others().zip(values) {
                if run.coupled {
                    let b = shape.coupled[j];
                    x[i] -= value * border[b];
                    theta[b] -= value * y[i];
                } else {
                    x[i] -= value * y[j];
                    if i != j {
                        x[j] -= value * y[i];
                    }
                }
            }
        };
        group.curvature(context, |point, run, values| match point {
            None => bend(&mut rest.first, &solution.first, run, values),
            Some(own) => bend(&mut rest.x[own..own + n], &solution.x[own..own + n], run, values),
        });
    }
}

/// Size in units of its state below which the terms of a row are rounding. Where a state rests, as before the first input,
/// all its terms are, and no refinement would make the rest of its row small beside them.
const AT_REST: f64 = 1e-3;

/// Largest rest relative to the size of its terms.
fn largest(rest: &[f64], sizes: &[f64]) -> f64 {
    let relative = |(rest, size): (&f64, &f64)| rest.abs() / size.max(AT_REST);
    rest.iter().zip(sizes).map(relative).fold(0.0, f64::max)
}
