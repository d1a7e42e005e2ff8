//! The one operation table: name, arity, value, partial derivatives, domain and printing.
//!
//! Everything that must know an operation (folding, differentiation, tapes, printing, tests,
//! Python's function list) reads it from [`TABLE`]. To add an operation, add a variant to [`Op`]
//! and a row to [`TABLE`], and its loop over lanes in `tape::lanes`.

use super::graph::{Graph, Id};
use crate::math;

/// An operation of the expression language.
#[allow(missing_docs)] // each variant is described by its row in TABLE
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u8)]
pub enum Op {
    Add,
    Sub,
    Mul,
    Div,
    Pow,
    Neg,
    Recip,
    Sqrt,
    Exp,
    Expm1,
    Log,
    Log1p,
    Hypot,
    Sin,
    Cos,
    Tan,
    Asin,
    Acos,
    Atan,
    Atan2,
    Sinh,
    Cosh,
    Tanh,
    Abs,
    Sign,
    Min,
    Max,
    Lt,
    Le,
    And,
    Or,
    Not,
    Where,
}

/// Partial derivatives with respect to each argument; `None` where identically zero.
pub type Partials = [Option<Id>; 3];

/// One row of the operation table.
pub struct Entry {
    /// The operation that the row describes.
    pub op: Op,
    /// Name in Python, in saved models and in infix printing of functions.
    pub name: &'static str,
    /// Number of arguments.
    pub arity: usize,
    /// Value at numbers; the same function that the lanes of the tape use.
    pub value: fn(&[f64]) -> f64,
    /// Partial derivatives, given the arguments and the result.
    pub partials: fn(&mut Graph, &[Id], Id) -> Partials,
    /// Interval in which each argument must lie for a finite, differentiable result.
    pub domain: &'static [(f64, f64)],
    /// Infix form, `{0}` standing for the first argument.
    pub infix: &'static str,
    /// LaTeX form.
    pub latex: &'static str,
    /// Binding strength of the printed form: 4 atoms and functions, 3 powers, 2 products and
    /// signs, 1 sums, 0 comparisons.
    pub precedence: u8,
    /// Whether the arguments may be swapped.
    pub commutative: bool,
}

impl Op {
    /// The row of the table that describes this operation.
    pub fn entry(self) -> &'static Entry {
        &TABLE[self as usize]
    }

    /// The operation of a given name.
    pub fn from_name(name: &str) -> Option<Op> {
        TABLE.iter().find(|e| e.name == name).map(|e| e.op)
    }
}

const INF: f64 = f64::INFINITY;
const ANY: (f64, f64) = (-INF, INF);
const POSITIVE: (f64, f64) = (0.0, INF);
const UNIT: (f64, f64) = (-1.0, 1.0);

fn zero(_: &mut Graph, _: &[Id], _: Id) -> Partials {
    [None, None, None]
}

const fn function(
    op: Op,
    name: &'static str,
    value: fn(&[f64]) -> f64,
    partials: fn(&mut Graph, &[Id], Id) -> Partials,
    domain: &'static [(f64, f64)],
    infix: &'static str,
    latex: &'static str,
) -> Entry {
    Entry {
        op,
        name,
        arity: domain.len(),
        value,
        partials,
        domain,
        infix,
        latex,
        precedence: 4,
        commutative: false,
    }
}

#[allow(clippy::too_many_arguments)] // one for each column of the table
const fn operator(
    op: Op,
    name: &'static str,
    value: fn(&[f64]) -> f64,
    partials: fn(&mut Graph, &[Id], Id) -> Partials,
    infix: &'static str,
    latex: &'static str,
    precedence: u8,
    commutative: bool,
) -> Entry {
    let domain: &'static [(f64, f64)] = &[ANY, ANY];
    Entry { op, name, arity: 2, value, partials, domain, infix, latex, precedence, commutative }
}

fn truth(x: bool) -> f64 {
    f64::from(u8::from(x))
}

/// The operation table, in the order of [`Op`].
pub static TABLE: [Entry; 33] = [
    operator(
        Op::Add,
        "add",
        |x| x[0] + x[1],
        |g, _, _| [Some(g.one()), Some(g.one()), None],
        "{0} + {1}",
        "{0} + {1}",
        1,
        true,
    ),
    operator(
        Op::Sub,
        "sub",
        |x| x[0] - x[1],
        |g, _, _| [Some(g.one()), Some(g.constant(-1.0)), None],
        "{0} - {1}",
        "{0} - {1}",
        1,
        false,
    ),
    operator(
        Op::Mul,
        "mul",
        |x| x[0] * x[1],
        |_, a, _| [Some(a[1]), Some(a[0]), None],
        "{0}*{1}",
        "{0} \\, {1}",
        2,
        true,
    ),
    operator(
        Op::Div,
        "div",
        |x| x[0] / x[1],
        |g, a, r| {
            let d0 = g.recip(a[1]);
            let q = g.mul(r, d0);
            [Some(d0), Some(g.neg(q)), None]
        },
        "{0}/{1}",
        "\\frac{{0}}{{1}}",
        2,
        false,
    ),
    Entry {
        op: Op::Pow,
        name: "pow",
        arity: 2,
        value: |x| math::pow(x[0], x[1]),
        partials: |g, a, r| {
            // d(x^y) = y x^(y-1) dx + x^y log(x) dy; the second only where y varies,
            // so that x may be negative under a constant whole exponent.
            let one = g.one();
            let lower = g.sub(a[1], one);
            let power = g.pow(a[0], lower);
            let dx = g.mul(a[1], power);
            let dy = if g.as_constant(a[1]).is_some() {
                None
            } else {
                let log = g.unary(Op::Log, a[0]);
                Some(g.mul(r, log))
            };
            [Some(dx), dy, None]
        },
        domain: &[POSITIVE, ANY],
        infix: "{0}**{1}",
        latex: "{{0}}^{{1}}",
        precedence: 3,
        commutative: false,
    },
    Entry {
        op: Op::Neg,
        name: "neg",
        arity: 1,
        value: |x| -x[0],
        partials: |g, _, _| [Some(g.constant(-1.0)), None, None],
        domain: &[ANY],
        infix: "-{0}",
        latex: "-{0}",
        precedence: 2,
        commutative: false,
    },
    Entry {
        op: Op::Recip,
        name: "recip",
        arity: 1,
        value: |x| 1.0 / x[0],
        partials: |g, _, r| {
            let square = g.mul(r, r);
            [Some(g.neg(square)), None, None]
        },
        domain: &[POSITIVE],
        infix: "1/{0}",
        latex: "\\frac{1}{{0}}",
        precedence: 2,
        commutative: false,
    },
    function(
        Op::Sqrt,
        "sqrt",
        |x| x[0].sqrt(),
        |g, _, r| {
            let inverse = g.recip(r);
            let half = g.constant(0.5);
            [Some(g.mul(half, inverse)), None, None]
        },
        &[POSITIVE],
        "sqrt({0})",
        "\\sqrt{{0}}",
    ),
    function(
        Op::Exp,
        "exp",
        |x| math::exp(x[0]),
        |_, _, r| [Some(r), None, None],
        &[ANY],
        "exp({0})",
        "e^{{0}}",
    ),
    function(
        Op::Expm1,
        "expm1",
        |x| math::expm1(x[0]),
        |g, a, _| [Some(g.unary(Op::Exp, a[0])), None, None],
        &[ANY],
        "expm1({0})",
        "\\operatorname{expm1}\\left({0}\\right)",
    ),
    function(
        Op::Log,
        "log",
        |x| math::log(x[0]),
        |g, a, _| [Some(g.recip(a[0])), None, None],
        &[POSITIVE],
        "log({0})",
        "\\ln\\left({0}\\right)",
    ),
    function(
        Op::Log1p,
        "log1p",
        |x| math::log1p(x[0]),
        |g, a, _| {
            let one = g.one();
            let sum = g.add(one, a[0]);
            [Some(g.recip(sum)), None, None]
        },
        &[(-1.0, INF)],
        "log1p({0})",
        "\\operatorname{log1p}\\left({0}\\right)",
    ),
    function(
        Op::Hypot,
        "hypot",
        |x| math::hypot(x[0], x[1]),
        |g, a, r| {
            let inverse = g.recip(r);
            [Some(g.mul(a[0], inverse)), Some(g.mul(a[1], inverse)), None]
        },
        &[ANY, POSITIVE],
        "hypot({0}, {1})",
        "\\operatorname{hypot}\\left({0}, {1}\\right)",
    ),
    function(
        Op::Sin,
        "sin",
        |x| math::sin(x[0]),
        |g, a, _| [Some(g.unary(Op::Cos, a[0])), None, None],
        &[ANY],
        "sin({0})",
        "\\sin\\left({0}\\right)",
    ),
    function(
        Op::Cos,
        "cos",
        |x| math::cos(x[0]),
        |g, a, _| {
            let sin = g.unary(Op::Sin, a[0]);
            [Some(g.neg(sin)), None, None]
        },
        &[ANY],
        "cos({0})",
        "\\cos\\left({0}\\right)",
    ),
    function(
        Op::Tan,
        "tan",
        |x| math::tan(x[0]),
        |g, _, r| {
            let square = g.mul(r, r);
            let one = g.one();
            [Some(g.add(one, square)), None, None]
        },
        &[ANY],
        "tan({0})",
        "\\tan\\left({0}\\right)",
    ),
    function(
        Op::Asin,
        "asin",
        |x| math::asin(x[0]),
        |g, a, _| [Some(inverse_root_of_one_minus_square(g, a[0])), None, None],
        &[UNIT],
        "asin({0})",
        "\\arcsin\\left({0}\\right)",
    ),
    function(
        Op::Acos,
        "acos",
        |x| math::acos(x[0]),
        |g, a, _| {
            let d = inverse_root_of_one_minus_square(g, a[0]);
            [Some(g.neg(d)), None, None]
        },
        &[UNIT],
        "acos({0})",
        "\\arccos\\left({0}\\right)",
    ),
    function(
        Op::Atan,
        "atan",
        |x| math::atan(x[0]),
        |g, a, _| {
            let square = g.mul(a[0], a[0]);
            let one = g.one();
            let sum = g.add(one, square);
            [Some(g.recip(sum)), None, None]
        },
        &[ANY],
        "atan({0})",
        "\\arctan\\left({0}\\right)",
    ),
    function(
        Op::Atan2,
        "atan2",
        |x| math::atan2(x[0], x[1]),
        |g, a, _| {
            let (yy, xx) = (g.mul(a[0], a[0]), g.mul(a[1], a[1]));
            let sum = g.add(yy, xx);
            let inverse = g.recip(sum);
            let dy = g.mul(a[1], inverse);
            let dx = g.mul(a[0], inverse);
            [Some(dy), Some(g.neg(dx)), None]
        },
        &[ANY, POSITIVE],
        "atan2({0}, {1})",
        "\\operatorname{atan2}\\left({0}, {1}\\right)",
    ),
    function(
        Op::Sinh,
        "sinh",
        |x| math::sinh(x[0]),
        |g, a, _| [Some(g.unary(Op::Cosh, a[0])), None, None],
        &[ANY],
        "sinh({0})",
        "\\sinh\\left({0}\\right)",
    ),
    function(
        Op::Cosh,
        "cosh",
        |x| math::cosh(x[0]),
        |g, a, _| [Some(g.unary(Op::Sinh, a[0])), None, None],
        &[ANY],
        "cosh({0})",
        "\\cosh\\left({0}\\right)",
    ),
    function(
        Op::Tanh,
        "tanh",
        |x| math::tanh(x[0]),
        |g, _, r| {
            let square = g.mul(r, r);
            let one = g.one();
            [Some(g.sub(one, square)), None, None]
        },
        &[ANY],
        "tanh({0})",
        "\\tanh\\left({0}\\right)",
    ),
    function(
        Op::Abs,
        "abs",
        |x| x[0].abs(),
        |g, a, _| [Some(g.unary(Op::Sign, a[0])), None, None],
        &[ANY],
        "abs({0})",
        "\\left|{0}\\right|",
    ),
    function(
        Op::Sign,
        "sign",
        |x| math::sign(x[0]),
        zero,
        &[ANY],
        "sign({0})",
        "\\operatorname{sign}\\left({0}\\right)",
    ),
    function(
        Op::Min,
        "min",
        |x| math::min(x[0], x[1]),
        |g, a, _| choose(g, a[0], a[1]),
        &[ANY, ANY],
        "min({0}, {1})",
        "\\min\\left({0}, {1}\\right)",
    ),
    function(
        Op::Max,
        "max",
        |x| math::max(x[0], x[1]),
        |g, a, _| choose(g, a[1], a[0]),
        &[ANY, ANY],
        "max({0}, {1})",
        "\\max\\left({0}, {1}\\right)",
    ),
    operator(Op::Lt, "lt", |x| truth(x[0] < x[1]), zero, "{0} < {1}", "{0} < {1}", 0, false),
    operator(Op::Le, "le", |x| truth(x[0] <= x[1]), zero, "{0} <= {1}", "{0} \\le {1}", 0, false),
    function(
        Op::And,
        "and",
        |x| truth(x[0] != 0.0 && x[1] != 0.0),
        zero,
        &[ANY, ANY],
        "and({0}, {1})",
        "\\left({0}\\right) \\wedge \\left({1}\\right)",
    ),
    function(
        Op::Or,
        "or",
        |x| truth(x[0] != 0.0 || x[1] != 0.0),
        zero,
        &[ANY, ANY],
        "or({0}, {1})",
        "\\left({0}\\right) \\vee \\left({1}\\right)",
    ),
    function(Op::Not, "not", |x| truth(x[0] == 0.0), zero, &[ANY], "not({0})", "\\neg\\left({0}\\right)"),
    function(
        Op::Where,
        "where",
        |x| if x[0] != 0.0 { x[1] } else { x[2] },
        |g, a, _| {
            let (zero, one) = (g.zero(), g.one());
            [None, Some(g.apply(Op::Where, &[a[0], one, zero])), Some(g.apply(Op::Where, &[a[0], zero, one]))]
        },
        &[ANY, ANY, ANY],
        "where({0}, {1}, {2})",
        "\\begin{cases} {1} & {0} \\\\ {2} & \\text{otherwise} \\end{cases}",
    ),
];

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_stand_in_the_order_of_the_operations() {
        for (i, entry) in TABLE.iter().enumerate() {
            assert_eq!(entry.op as usize, i, "{}", entry.name);
            assert_eq!(entry.arity, entry.domain.len(), "{}", entry.name);
            assert_eq!(Op::from_name(entry.name), Some(entry.op));
        }
    }
}
