//! The partial derivatives of the operations, as expressions of their arguments and results.

use super::graph::{Graph, Id};
use super::ops::Op;

/// Partial derivatives with respect to each argument; `None` where identically zero.
pub(crate) type Partials = [Option<Id>; 3];

/// Returns the partial derivatives of an operation, given its arguments `a` and its result `r`.
pub(crate) fn partials(op: Op, g: &mut Graph, a: &[Id], r: Id) -> Partials {
    match op {
        Op::Add => [Some(g.one()), Some(g.one()), None],
        Op::Sub => [Some(g.one()), Some(g.constant(-1.0)), None],
        Op::Mul => [Some(a[1]), Some(a[0]), None],
        Op::Div => {
            let d0 = g.recip(a[1]);
            let q = g.mul(r, d0);
            [Some(d0), Some(g.neg(q)), None]
        }
        Op::Pow => {
            // d(x^y) = y x^(y-1) dx + x^y log(x) dy; the second only where y varies,
            // so that x may be negative under a constant whole exponent.
            let one = g.one();
            let lower = g.sub(a[1], one);
            if g.as_constant(a[1]).is_some() {
                let power = g.pow(a[0], lower);
                return [Some(g.mul(a[1], power)), None, None];
            }
            // An exponent that is estimated, as in Hill's equation, of a state that begins at zero: x^y log(x) has the
            // limit 0 there, and the slope of x^y, which is infinite for y < 1, is taken as that at 1. Derivatives of
            // these expressions are finite at zero, too.
            let size = g.unary(Op::Abs, a[0]);
            let null = g.zero();
            let vanishes = g.apply(Op::Le, &[size, null]);
            let steep = g.apply(Op::Lt, &[a[1], one]);
            let infinite = g.apply(Op::And, &[vanishes, steep]);
            let base = g.select(infinite, one, a[0]);
            let power = g.pow(base, lower);
            let dx = g.mul(a[1], power);
            let positive = g.select(vanishes, one, a[0]);
            let log = g.unary(Op::Log, positive);
            [Some(dx), Some(g.mul(r, log)), None]
        }
        Op::Neg => [Some(g.constant(-1.0)), None, None],
        Op::Recip => {
            let square = g.mul(r, r);
            [Some(g.neg(square)), None, None]
        }
        Op::Sqrt => {
            let inverse = g.recip(r);
            let half = g.constant(0.5);
            [Some(g.mul(half, inverse)), None, None]
        }
        Op::Exp => [Some(r), None, None],
        Op::Expm1 => [Some(g.unary(Op::Exp, a[0])), None, None],
        Op::Log => [Some(g.recip(a[0])), None, None],
        Op::Log1p => {
            let one = g.one();
            let sum = g.add(one, a[0]);
            [Some(g.recip(sum)), None, None]
        }
        Op::Hypot => {
            let inverse = g.recip(r);
            [Some(g.mul(a[0], inverse)), Some(g.mul(a[1], inverse)), None]
        }
        Op::Sin => [Some(g.unary(Op::Cos, a[0])), None, None],
        Op::Cos => {
            let sin = g.unary(Op::Sin, a[0]);
            [Some(g.neg(sin)), None, None]
        }
        Op::Tan => {
            let square = g.mul(r, r);
            let one = g.one();
            [Some(g.add(one, square)), None, None]
        }
        Op::Asin => [Some(inverse_root_of_one_minus_square(g, a[0])), None, None],
        Op::Acos => {
            let d = inverse_root_of_one_minus_square(g, a[0]);
            [Some(g.neg(d)), None, None]
        }
        Op::Atan => {
            let square = g.mul(a[0], a[0]);
            let one = g.one();
            let sum = g.add(one, square);
            [Some(g.recip(sum)), None, None]
        }
        Op::Atan2 => {
            let (yy, xx) = (g.mul(a[0], a[0]), g.mul(a[1], a[1]));
            let sum = g.add(yy, xx);
            let inverse = g.recip(sum);
            let dy = g.mul(a[1], inverse);
            let dx = g.mul(a[0], inverse);
            [Some(dy), Some(g.neg(dx)), None]
        }
        Op::Sinh => [Some(g.unary(Op::Cosh, a[0])), None, None],
        Op::Cosh => [Some(g.unary(Op::Sinh, a[0])), None, None],
        Op::Tanh => {
            let square = g.mul(r, r);
            let one = g.one();
            [Some(g.sub(one, square)), None, None]
        }
        Op::Abs => [Some(g.unary(Op::Sign, a[0])), None, None],
        Op::Min => choose(g, a[0], a[1]),
        Op::Max => choose(g, a[1], a[0]),
        Op::Where => {
            let (zero, one) = (g.zero(), g.one());
            [None, Some(g.apply(Op::Where, &[a[0], one, zero])), Some(g.apply(Op::Where, &[a[0], zero, one]))]
        }
        Op::Sign | Op::Lt | Op::Le | Op::And | Op::Or | Op::Not => [None, None, None],
    }
}

/// 1/sqrt(1 - x²), the derivative of the arc sine.
fn inverse_root_of_one_minus_square(g: &mut Graph, x: Id) -> Id {
    let square = g.mul(x, x);
    let one = g.one();
    let rest = g.sub(one, square);
    let root = g.unary(Op::Sqrt, rest);
    g.recip(root)
}

/// Partials of a minimum or maximum: one for the first argument where `low <= high`, else for the
/// second.
fn choose(g: &mut Graph, low: Id, high: Id) -> Partials {
    let (zero, one) = (g.zero(), g.one());
    let first = g.apply(Op::Le, &[low, high]);
    [Some(g.apply(Op::Where, &[first, one, zero])), Some(g.apply(Op::Where, &[first, zero, one])), None]
}
