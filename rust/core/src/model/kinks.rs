//! Kinks and jumps of the state equations, and the model with these smoothed.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use super::{Equation, Model};
use crate::error::Error;
use crate::expr::{Expr, Node, Op, le, select, smooth_abs, smooth_max, smooth_min, smooth_sign};

/// An operation with a kink or a jump that acts on states.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Kink {
    /// The quantity, or the state with a prime, in whose equation it stands.
    pub place: String,
    /// Name of the operation.
    pub name: &'static str,
    /// The operation with its arguments, as text.
    pub text: String,
    /// The argument that is zero at the kink, quantities put in: x of abs(x) and sign(x), else the difference of both
    /// arguments.
    pub argument: Expr,
}

/// A quantity or a state equation, by its number.
#[derive(Clone, Copy, PartialEq)]
enum Place {
    Quantity(usize),
    Dynamics(usize),
}

impl Model {
    /// The operations with a kink or a jump (abs, sign, min, max and comparisons) that act on states, in state equations
    /// and in the quantities that these use. In x|x| there is none.
    ///
    /// ```
    /// let mut m = phugoid::Model::new("friction");
    /// let v = m.state("v", "m/s")?;
    /// m.equation("v", -v.sign())?;
    /// let kinks = m.kinks();
    /// assert_eq!((kinks.len(), &*kinks[0].place, &*kinks[0].text), (1, "v'", "sign(v)"));
    /// assert_eq!(kinks[0].argument, v);
    /// assert_eq!(m.smoothed(&[0.01])?.dynamics[0].expr, -(v / 0.01).tanh());
    /// # Ok::<(), phugoid::Error>(())
    /// ```
    pub fn kinks(&self) -> Vec<Kink> {
        let known = self.definitions();
        let named = |(place, expr): (Place, Expr)| Kink {
            place: match place {
                Place::Quantity(i) => self.quantities[i].name.clone(),
                Place::Dynamics(i) => format!("{}'", self.dynamics[i].name),
            },
            name: operation(&expr).map_or("", |op| op.entry().name),
            text: expr.to_string(),
            argument: argument(&expr).substitute(&known),
        };
        self.kinked().into_iter().map(named).collect()
    }

    /// The model with each of its [`Model::kinks`] made smooth over a width, in the unit of its argument: tanh(x/width)
    /// for sign(x), √(x² + width²) for |x|, and min, max, comparisons and what is selected by these alike.
    ///
    /// # Errors
    /// Unless there is one width, positive and finite, for each kink.
    pub fn smoothed(&self, widths: &[f64]) -> Result<Model, Error> {
        let kinked = self.kinked();
        if widths.len() != kinked.len() || !widths.iter().all(|w| w.is_finite() && *w > 0.0) {
            let n = kinked.len();
            return Err(Error::option(format!(
                "smoothed: give {n} positive widths, one for each kink, not {widths:?}"
            )));
        }
        let mut model = self.clone();
        for place in self.places() {
            let here = kinked.iter().zip(widths).filter(|((p, _), _)| *p == place);
            let over: HashMap<Expr, f64> = here.map(|((_, expr), width)| (expr.clone(), *width)).collect();
            let equation = match place {
                Place::Quantity(i) => &mut model.quantities[i],
                Place::Dynamics(i) => &mut model.dynamics[i],
            };
            equation.expr = smooth(&equation.expr, &over);
        }
        Ok(model)
    }

    /// The state equations, and before them the quantities that these use.
    fn places(&self) -> Vec<Place> {
        let mut used: HashSet<Arc<str>> = self.dynamics.iter().flat_map(|e| e.expr.symbols()).collect();
        let mut places = Vec::new();
        for (i, quantity) in self.quantities.iter().enumerate().rev() {
            if used.contains(quantity.name.as_str()) {
                used.extend(quantity.expr.symbols());
                places.insert(0, Place::Quantity(i));
            }
        }
        places.extend((0..self.dynamics.len()).map(Place::Dynamics));
        places
    }

    fn at(&self, place: Place) -> &Equation {
        match place {
            Place::Quantity(i) => &self.quantities[i],
            Place::Dynamics(i) => &self.dynamics[i],
        }
    }

    /// Each kink once a place.
    fn kinked(&self) -> Vec<(Place, Expr)> {
        let mut moving: HashSet<Arc<str>> = self.states.iter().map(|s| s.name.as_str().into()).collect();
        let mut found = Vec::new();
        for place in self.places() {
            let Equation { name, expr, .. } = self.at(place);
            let mut left = with_kinks(expr);
            expr.visit(|e| {
                if left.remove(e) && e.symbols().iter().any(|s| moving.contains(s)) {
                    found.push((place, e.clone()));
                }
            });
            if matches!(place, Place::Quantity(_)) && expr.symbols().iter().any(|s| moving.contains(s)) {
                moving.insert(name.as_str().into());
            }
        }
        found
    }
}

/// The operation, where it has a kink or a jump.
fn operation(expr: &Expr) -> Option<Op> {
    match expr.node() {
        Node::Apply(op @ (Op::Abs | Op::Sign | Op::Min | Op::Max | Op::Lt | Op::Le), _) => Some(*op),
        _ => None,
    }
}

/// Returns the operations with a kink or a jump of an expression, without those that factors make smooth: x|x|, as in a quadratic
/// drag, and x² sign(x) have continuous derivatives.
fn with_kinks(expr: &Expr) -> HashSet<Expr> {
    let (mut found, mut seen) = (HashSet::new(), HashSet::new());
    let mut stack = vec![expr];
    while let Some(e) = stack.pop() {
        if !seen.insert(e) {
            continue;
        }
        let (factors, others) = factors_of(e);
        stack.extend(others);
        for factor in &factors {
            let times = |x: &Expr| factors.iter().map(|f| times_in(x, f)).sum::<f64>();
            let smooth = match (factor.node(), factor.args()) {
                (Node::Apply(Op::Abs, _), [x]) => times(x) >= 1.0,
                (Node::Apply(Op::Sign, _), [x]) => times(x) >= 2.0,
                _ => false,
            };
            if operation(factor).is_some() && !smooth {
                found.insert((*factor).clone());
            }
            stack.extend(factor.args());
        }
    }
    found
}

/// Returns the factors of a product, and the denominators beside them; another expression is its own factor.
fn factors_of(expr: &Expr) -> (Vec<&Expr>, Vec<&Expr>) {
    let (mut factors, mut denominators, mut stack) = (Vec::new(), Vec::new(), vec![expr]);
    while let Some(e) = stack.pop() {
        match (e.node(), e.args()) {
            (Node::Apply(Op::Mul, _), [a, b]) => stack.extend([a, b]),
            (Node::Apply(Op::Neg, _), [a]) => stack.push(a),
            (Node::Apply(Op::Div, _), [a, b]) => {
                stack.push(a);
                denominators.push(b);
            }
            _ => factors.push(e),
        }
    }
    (factors, denominators)
}

/// Returns how often a factor holds an expression: its exponent in a power.
fn times_in(x: &Expr, factor: &Expr) -> f64 {
    match (factor.node(), factor.args()) {
        _ if factor == x => 1.0,
        (Node::Apply(Op::Pow, _), [base, exponent]) if base == x => exponent.as_constant().unwrap_or(0.0),
        _ => 0.0,
    }
}

/// Returns the argument that is zero at a kink.
fn argument(expr: &Expr) -> Expr {
    match expr.args() {
        // That x is the symbol itself tells its unit.
        [a, b] if b.as_constant() == Some(0.0) => a.clone(),
        [a, b] if a.as_constant() == Some(0.0) => b.clone(),
        [a, b] => a - b,
        args => args[0].clone(),
    }
}

/// The expression with operations made smooth over widths.
fn smooth(expr: &Expr, over: &HashMap<Expr, f64>) -> Expr {
    expr.rebuilt(|old, args| {
        let width = over.get(old).copied();
        let changed = |i: usize| args[i] != old.args()[i];
        let truth = |i: usize| if changed(i) { args[i].clone() } else { truth(&args[i]) };
        let Node::Apply(op, _) = old.node() else { return None };
        Some(match (op, args, width) {
            (Op::Abs, [x], Some(w)) => smooth_abs(x, w),
            (Op::Sign, [x], Some(w)) => smooth_sign(x, w),
            (Op::Min, [a, b], Some(w)) => smooth_min(a, b, w),
            (Op::Max, [a, b], Some(w)) => smooth_max(a, b, w),
            (Op::Lt | Op::Le, [a, b], Some(w)) => 0.5 + 0.5 * smooth_sign(b - a, w),
            (Op::Not, [a], _) if changed(0) => 1.0 - a,
            (Op::And, _, _) if changed(0) || changed(1) => truth(0) * truth(1),
            (Op::Or, _, _) if changed(0) || changed(1) => 1.0 - (1.0 - truth(0)) * (1.0 - truth(1)),
            (Op::Where, [p, yes, no], _) if changed(0) => {
                // Far from the jump the other branch does not enter, which need not be finite there.
                let both = p * yes + (1.0 - p) * no;
                select(le(1.0, p), yes, select(le(p, 0.0), no, both))
            }
            _ => return None,
        })
    })
}

/// A condition as 0 or 1: numbers other than 0 hold.
fn truth(condition: &Expr) -> Expr {
    match condition.node() {
        Node::Apply(Op::Lt | Op::Le | Op::And | Op::Or | Op::Not, _) => condition.clone(),
        _ => 1.0 - Expr::apply(Op::Not, vec![condition.clone()]),
    }
}
