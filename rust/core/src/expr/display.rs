//! Infix and LaTeX printing.

use std::fmt;

use super::{Expr, Node, Op};

const SUM: u8 = 1;
const PRODUCT: u8 = 2;
const POWER: u8 = 3;
const ATOM: u8 = 4;

/// The two ways to print, as what differs between them.
struct Style {
    template: fn(Op) -> &'static str,
    symbol: fn(&str) -> String,
    number: fn(f64) -> String,
    open: &'static str,
    close: &'static str,
    /// Whether the template delimits the arguments of a quotient or exponent by itself.
    delimits: bool,
}

const INFIX: Style = Style {
    template: |op| op.entry().infix,
    symbol: str::to_owned,
    number,
    open: "(",
    close: ")",
    delimits: false,
};

const LATEX: Style = Style {
    template: |op| op.entry().latex,
    symbol: latex_symbol,
    number: latex_number,
    open: "\\left(",
    close: "\\right)",
    delimits: true,
};

impl fmt::Display for Expr {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&print(self, &INFIX))
    }
}

impl Expr {
    /// LaTeX source, without delimiters of the formula.
    pub fn latex(&self) -> String {
        print(self, &LATEX)
    }
}

/// What is left to print.
enum Task<'a> {
    Text(&'static str),
    Expr(&'a Expr),
}

/// Prints with an explicit stack into one text: sums of thousands of terms are deep trees.
fn print(root: &Expr, style: &Style) -> String {
    let mut out = String::new();
    let mut stack = vec![Task::Expr(root)];
    while let Some(task) = stack.pop() {
        let expr = match task {
            Task::Text(text) => {
                out.push_str(text);
                continue;
            }
            Task::Expr(expr) => expr,
        };
        let start = stack.len();
        match expr.node() {
            Node::Constant(c) => out.push_str(&(style.number)(*c)),
            Node::Symbol(name) => out.push_str(&(style.symbol)(name)),
            Node::Apply(op, args) => push_operation(*op, args, style, &mut stack),
            Node::Lookup(lookup, args) => {
                let name = (style.symbol)(lookup.table.name());
                match lookup.order {
                    [0, 0] => out.push_str(&name),
                    [i, j] => out.push_str(&format!("D[{name}, {i}, {j}]")),
                }
                stack.push(Task::Text(style.open));
                for (i, arg) in args.iter().enumerate() {
                    stack.push(Task::Text(if i == 0 { "" } else { ", " }));
                    stack.push(Task::Expr(arg));
                }
                stack.push(Task::Text(style.close));
            }
        }
        stack[start..].reverse();
    }
    out
}

/// The template of an operation, cut at `{0}`, `{1}`, `{2}`; other braces stand for themselves.
fn push_operation<'a>(op: Op, args: &'a [Expr], style: &Style, stack: &mut Vec<Task<'a>>) {
    let mut rest = (style.template)(op);
    let mut from = 0;
    while let Some(at) = rest[from..].find('{').map(|at| from + at) {
        let index = match rest.as_bytes()[at..] {
            [_, digit @ b'0'..=b'2', b'}', ..] => usize::from(digit - b'0'),
            _ => args.len(),
        };
        let Some(arg) = args.get(index) else {
            from = at + 1;
            continue;
        };
        stack.push(Task::Text(&rest[..at]));
        let brackets = in_brackets(op, index, arg, style);
        stack.extend(brackets.then_some(Task::Text(style.open)));
        stack.push(Task::Expr(arg));
        stack.extend(brackets.then_some(Task::Text(style.close)));
        (rest, from) = (&rest[at + 3..], 0);
    }
    stack.push(Task::Text(rest));
}

/// How strongly the printed form of an expression holds together.
fn precedence(expr: &Expr, style: &Style) -> u8 {
    match expr.node() {
        Node::Constant(c) if *c < 0.0 => PRODUCT,
        // A fraction is an atom, an exponential a power; neither can be raised to a power as it is.
        Node::Apply(Op::Div | Op::Recip | Op::Exp, _) if style.delimits => POWER,
        Node::Apply(op, _) => op.entry().precedence,
        _ => ATOM,
    }
}

/// Whether the i-th argument of an operation needs brackets.
fn in_brackets(op: Op, i: usize, arg: &Expr, style: &Style) -> bool {
    let entry = op.entry();
    let quotient = matches!(op, Op::Div | Op::Recip);
    if entry.precedence == ATOM || (style.delimits && (quotient || (op == Op::Pow && i == 1))) {
        return false;
    }
    // The right side of −, / and the base of a power bind tighter than the operation.
    let strict = i == 1 && !entry.commutative
        || (op == Op::Pow && i == 0)
        || matches!(op, Op::Neg | Op::Recip)
        || entry.precedence == 0;
    let inner = precedence(arg, style);
    inner < entry.precedence
        || (strict && inner == entry.precedence)
        // A sign at the start of a right operand reads as two operators.
        || (i == 1 && entry.precedence >= SUM && starts_with_sign(arg, style))
}

fn starts_with_sign(expr: &Expr, style: &Style) -> bool {
    let mut expr = expr;
    loop {
        match expr.node() {
            Node::Constant(c) => return *c < 0.0,
            Node::Apply(Op::Neg, _) => return true,
            Node::Apply(op, args)
                if (style.template)(*op).starts_with("{0}") && !in_brackets(*op, 0, &args[0], style) =>
            {
                expr = &args[0];
            }
            _ => return false,
        }
    }
}

const GREEK: &[&str] = &[
    "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu",
    "nu", "xi", "pi", "rho", "sigma", "tau", "upsilon", "phi", "chi", "psi", "omega",
];

fn latex_symbol(name: &str) -> String {
    let (head, tail) = name.split_once('_').unwrap_or((name, ""));
    let lower = head.to_lowercase();
    let head = if GREEK.contains(&head) || (GREEK.contains(&lower.as_str()) && head[1..] == lower[1..]) {
        format!("\\{head}")
    } else if head.chars().count() > 1 {
        format!("\\mathrm{{{head}}}")
    } else {
        head.to_owned()
    };
    if tail.is_empty() { head } else { format!("{head}_{{{}}}", latex_symbol(tail)) }
}

/// The shortest text that reads back as the number.
fn number(c: f64) -> String {
    if c == 0.0 || (1e-5..1e16).contains(&c.abs()) || !c.is_finite() {
        format!("{c}")
    } else {
        format!("{c:e}")
    }
}

fn latex_number(c: f64) -> String {
    let text = format!("{c:e}");
    match text.split_once('e') {
        Some((mantissa, exponent)) if exponent.parse::<i32>().is_ok_and(|e| !(-4..6).contains(&e)) => {
            format!("{mantissa} \\cdot 10^{{{exponent}}}")
        }
        _ => format!("{c}"),
    }
}
