//! Infix and LaTeX printing.

use std::collections::HashMap;
use std::fmt;

use super::{Expr, Lookup, Node, Op};

const SUM: u8 = 1;
const PRODUCT: u8 = 2;
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
    number: |c| format!("{c}"),
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

fn print(root: &Expr, style: &Style) -> String {
    let mut done: HashMap<*const Node, (String, u8)> = HashMap::new();
    root.visit(|e| {
        let args: Vec<&(String, u8)> =
            e.args().iter().map(|a| &done[&std::ptr::from_ref(a.node())]).collect();
        let printed = match e.node() {
            Node::Constant(c) if *c < 0.0 => ((style.number)(*c), PRODUCT),
            Node::Constant(c) => ((style.number)(*c), ATOM),
            Node::Symbol(name) => ((style.symbol)(name), ATOM),
            Node::Apply(op, _) => apply(*op, &args, style),
            Node::Lookup(lookup, _) => (print_lookup(lookup, &args, style), ATOM),
        };
        done.insert(std::ptr::from_ref(e.node()), printed);
    });
    done.remove(&std::ptr::from_ref(root.node())).map(|p| p.0).unwrap_or_default()
}

fn apply(op: Op, args: &[&(String, u8)], style: &Style) -> (String, u8) {
    let entry = op.entry();
    let quotient = matches!(op, Op::Div | Op::Recip);
    let printed: Vec<String> = args
        .iter()
        .enumerate()
        .map(|(i, (text, precedence))| {
            let delimited =
                entry.precedence == ATOM || (style.delimits && (quotient || (op == Op::Pow && i == 1)));
            // The right side of −, / and the base of a power bind tighter than the operation.
            let strict = i == 1 && !entry.commutative
                || (op == Op::Pow && i == 0)
                || matches!(op, Op::Neg | Op::Recip)
                || entry.precedence == 0;
            let needs = precedence < &entry.precedence || (strict && precedence == &entry.precedence);
            // A sign at the start of a right operand reads as two operators.
            let signed = i == 1 && text.starts_with('-') && entry.precedence >= SUM;
            if !delimited && (needs || signed) {
                format!("{}{text}{}", style.open, style.close)
            } else {
                text.clone()
            }
        })
        .collect();
    let precedence = if style.delimits && quotient { ATOM } else { entry.precedence };
    (fill((style.template)(op), &printed), precedence)
}

fn print_lookup(lookup: &Lookup, args: &[&(String, u8)], style: &Style) -> String {
    let mut name = (style.symbol)(lookup.table.name());
    if lookup.order != [0, 0] {
        name = format!("D[{name}, {}, {}]", lookup.order[0], lookup.order[1]);
    }
    let args: Vec<&str> = args.iter().map(|a| a.0.as_str()).collect();
    format!("{name}{}{}{}", style.open, args.join(", "), style.close)
}

/// Fills `{0}`, `{1}`, `{2}` of a template in one pass (the arguments hold braces themselves).
fn fill(template: &str, args: &[String]) -> String {
    let mut out = String::new();
    let mut rest = template;
    while let Some(at) = rest.find('{') {
        out.push_str(&rest[..at]);
        let tail = &rest[at..];
        let index =
            tail.as_bytes().get(1).filter(|d| d.is_ascii_digit() && tail.as_bytes().get(2) == Some(&b'}'));
        if let Some(digit) = index {
            out.push_str(&args[(digit - b'0') as usize]);
            rest = &tail[3..];
        } else {
            out.push('{');
            rest = &tail[1..];
        }
    }
    out + rest
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

fn latex_number(c: f64) -> String {
    let text = format!("{c:e}");
    match text.split_once('e') {
        Some((mantissa, exponent)) if exponent.parse::<i32>().is_ok_and(|e| !(-4..6).contains(&e)) => {
            format!("{mantissa} \\cdot 10^{{{exponent}}}")
        }
        _ => format!("{c}"),
    }
}
