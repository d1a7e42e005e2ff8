//! The one operation table: name, arity, value, domain and printing.
//!
//! Everything that must know an operation (folding, tapes, printing, tests, Python's function list) reads it from
//! [`TABLE`]. To add an operation, add a variant to [`Op`] and a row to [`TABLE`], its derivatives in
//! [`partials`](super::partials), and its loop over lanes in `tape::lanes`.

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

const fn function(
    op: Op,
    name: &'static str,
    value: fn(&[f64]) -> f64,
    domain: &'static [(f64, f64)],
    infix: &'static str,
    latex: &'static str,
) -> Entry {
    Entry { op, name, arity: domain.len(), value, domain, infix, latex, precedence: 4, commutative: false }
}

const fn operator(
    op: Op,
    name: &'static str,
    value: fn(&[f64]) -> f64,
    infix: &'static str,
    latex: &'static str,
    precedence: u8,
    commutative: bool,
) -> Entry {
    let domain: &'static [(f64, f64)] = &[ANY, ANY];
    Entry { op, name, arity: 2, value, domain, infix, latex, precedence, commutative }
}

fn truth(x: bool) -> f64 {
    f64::from(u8::from(x))
}

/// The operation table, in the order of [`Op`].
pub static TABLE: [Entry; 33] = [
    operator(Op::Add, "add", |x| x[0] + x[1], "{0} + {1}", "{0} + {1}", 1, true),
    operator(Op::Sub, "sub", |x| x[0] - x[1], "{0} - {1}", "{0} - {1}", 1, false),
    operator(Op::Mul, "mul", |x| x[0] * x[1], "{0}*{1}", "{0} \\, {1}", 2, true),
    operator(Op::Div, "div", |x| x[0] / x[1], "{0}/{1}", "\\frac{{0}}{{1}}", 2, false),
    Entry {
        op: Op::Pow,
        name: "pow",
        arity: 2,
        value: |x| math::pow(x[0], x[1]),
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
        domain: &[POSITIVE],
        infix: "1/{0}",
        latex: "\\frac{1}{{0}}",
        precedence: 2,
        commutative: false,
    },
    function(Op::Sqrt, "sqrt", |x| x[0].sqrt(), &[POSITIVE], "sqrt({0})", "\\sqrt{{0}}"),
    function(Op::Exp, "exp", |x| math::exp(x[0]), &[ANY], "exp({0})", "e^{{0}}"),
    function(
        Op::Expm1,
        "expm1",
        |x| math::expm1(x[0]),
        &[ANY],
        "expm1({0})",
        "\\operatorname{expm1}\\left({0}\\right)",
    ),
    function(Op::Log, "log", |x| math::log(x[0]), &[POSITIVE], "log({0})", "\\ln\\left({0}\\right)"),
    function(
        Op::Log1p,
        "log1p",
        |x| math::log1p(x[0]),
        &[(-1.0, INF)],
        "log1p({0})",
        "\\operatorname{log1p}\\left({0}\\right)",
    ),
    function(
        Op::Hypot,
        "hypot",
        |x| math::hypot(x[0], x[1]),
        &[ANY, POSITIVE],
        "hypot({0}, {1})",
        "\\operatorname{hypot}\\left({0}, {1}\\right)",
    ),
    function(Op::Sin, "sin", |x| math::sin(x[0]), &[ANY], "sin({0})", "\\sin\\left({0}\\right)"),
    function(Op::Cos, "cos", |x| math::cos(x[0]), &[ANY], "cos({0})", "\\cos\\left({0}\\right)"),
    function(Op::Tan, "tan", |x| math::tan(x[0]), &[ANY], "tan({0})", "\\tan\\left({0}\\right)"),
    function(Op::Asin, "asin", |x| math::asin(x[0]), &[UNIT], "asin({0})", "\\arcsin\\left({0}\\right)"),
    function(Op::Acos, "acos", |x| math::acos(x[0]), &[UNIT], "acos({0})", "\\arccos\\left({0}\\right)"),
    function(Op::Atan, "atan", |x| math::atan(x[0]), &[ANY], "atan({0})", "\\arctan\\left({0}\\right)"),
    function(
        Op::Atan2,
        "atan2",
        |x| math::atan2(x[0], x[1]),
        &[ANY, POSITIVE],
        "atan2({0}, {1})",
        "\\operatorname{atan2}\\left({0}, {1}\\right)",
    ),
    function(Op::Sinh, "sinh", |x| math::sinh(x[0]), &[ANY], "sinh({0})", "\\sinh\\left({0}\\right)"),
    function(Op::Cosh, "cosh", |x| math::cosh(x[0]), &[ANY], "cosh({0})", "\\cosh\\left({0}\\right)"),
    function(Op::Tanh, "tanh", |x| math::tanh(x[0]), &[ANY], "tanh({0})", "\\tanh\\left({0}\\right)"),
    function(Op::Abs, "abs", |x| x[0].abs(), &[ANY], "abs({0})", "\\left|{0}\\right|"),
    function(
        Op::Sign,
        "sign",
        |x| math::sign(x[0]),
        &[ANY],
        "sign({0})",
        "\\operatorname{sign}\\left({0}\\right)",
    ),
    function(
        Op::Min,
        "min",
        |x| math::min(x[0], x[1]),
        &[ANY, ANY],
        "min({0}, {1})",
        "\\min\\left({0}, {1}\\right)",
    ),
    function(
        Op::Max,
        "max",
        |x| math::max(x[0], x[1]),
        &[ANY, ANY],
        "max({0}, {1})",
        "\\max\\left({0}, {1}\\right)",
    ),
    operator(Op::Lt, "lt", |x| truth(x[0] < x[1]), "{0} < {1}", "{0} < {1}", 0, false),
    operator(Op::Le, "le", |x| truth(x[0] <= x[1]), "{0} <= {1}", "{0} \\le {1}", 0, false),
    function(
        Op::And,
        "and",
        |x| truth(x[0] != 0.0 && x[1] != 0.0),
        &[ANY, ANY],
        "and({0}, {1})",
        "\\left({0}\\right) \\wedge \\left({1}\\right)",
    ),
    function(
        Op::Or,
        "or",
        |x| truth(x[0] != 0.0 || x[1] != 0.0),
        &[ANY, ANY],
        "or({0}, {1})",
        "\\left({0}\\right) \\vee \\left({1}\\right)",
    ),
    function(Op::Not, "not", |x| truth(x[0] == 0.0), &[ANY], "not({0})", "\\neg\\left({0}\\right)"),
    function(
        Op::Where,
        "where",
        |x| if x[0] != 0.0 { x[1] } else { x[2] },
        &[ANY, ANY, ANY],
        "where({0}, {1}, {2})",
        "\\begin{cases} {1} & {0} \\\\ {2} & \\text{otherwise} \\end{cases}",
    ),
];

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
