//! Infix and LaTeX printing.

use std::collections::{HashMap, HashSet};
use std::fmt;

use super::{Expr, Node, Op};
use crate::error::shortened;

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
    /// Between the definition of a part and what comes next.
    next: &'static str,
    /// Whether the template delimits the arguments of a quotient or exponent by itself.
    delimits: bool,
}

const INFIX: Style = Style {
    template: |op| op.entry().infix,
    symbol: str::to_owned,
    number,
    open: "(",
    close: ")",
    next: "; ",
    delimits: false,
};

const LATEX: Style = Style {
    template: |op| op.entry().latex,
    symbol: latex_symbol,
    number: latex_number,
    open: "\\left(",
    close: "\\right)",
    next: ";\\quad ",
    delimits: true,
};

impl fmt::Display for Expr {
    /// Infix text. Where it would be long, parts that occur more than once are written once, by name:
    /// `a = x*x + x; a*a + a`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&print(self, &INFIX))
    }
}

impl fmt::Debug for Expr {
    /// The infix text: the tree itself may be deeper than the stack.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Expr({self})")
    }
}

/// Most characters of an expression in a message.
const BRIEF: usize = 300;

impl Expr {
    /// LaTeX source, without delimiters of the formula.
    pub fn latex(&self) -> String {
        print(self, &LATEX)
    }

    /// The infix text for a message: its beginning, where it is long.
    pub fn brief(&self) -> String {
        shortened(&self.to_string(), BRIEF)
    }
}

/// Trees of so many nodes are printed as they are, whatever their parts have in common.
const SMALL: usize = 200;
/// Parts of fewer nodes are written wherever they occur: a name would be no shorter.
const NAMED: usize = 3;

type Names = HashMap<*const Node, String>;

/// The content of a node, its arguments by number: nodes with equal content print alike.
#[derive(PartialEq, Eq, Hash)]
enum Shape<'a> {
    Constant(u64),
    Symbol(&'a str),
    Apply(Op, Vec<usize>),
    Lookup(&'a str, [u8; 2], Vec<usize>),
}

/// Returns for each node the first one that prints alike: whether parts that are equal are one node in memory must not show, as a
/// model that was saved and read shares more of them.
fn representatives(root: &Expr) -> HashMap<*const Node, *const Node> {
    let key = |e: &Expr| std::ptr::from_ref(e.node());
    let (mut numbers, mut kinds) = (HashMap::new(), HashMap::<Shape<'_>, usize>::new());
    let (mut firsts, mut found) = (Vec::new(), HashMap::new());
    root.visit(|e| {
        let args = || e.args().iter().map(|a| numbers[&key(a)]).collect();
        let shape = match e.node() {
            Node::Constant(c) => Shape::Constant(c.to_bits()),
            Node::Symbol(name) | Node::Named(name, _) => Shape::Symbol(name),
            Node::Apply(op, _) => Shape::Apply(*op, args()),
            Node::Lookup(lookup, _) => Shape::Lookup(lookup.table.name(), lookup.order, args()),
        };
        let next = kinds.len();
        let number = *kinds.entry(shape).or_insert(next);
        if number == firsts.len() {
            firsts.push(key(e));
        }
        numbers.insert(key(e), number);
        found.insert(key(e), firsts[number]);
    });
    found
}

/// Names for the parts that occur more than once, and those parts in the order in which they need each other.
fn shared(root: &Expr) -> (Names, Vec<&Expr>) {
    let first = representatives(root);
    let key = |e: &Expr| first[&std::ptr::from_ref(e.node())];
    let (mut uses, mut sizes) = (HashMap::new(), HashMap::new());
    let mut seen = HashSet::new();
    root.visit(|e| {
        if !seen.insert(key(e)) {
            return;
        }
        let mut size = 1_usize;
        for arg in e.args() {
            *uses.entry(key(arg)).or_insert(0_usize) += 1;
            size = size.saturating_add(sizes[&key(arg)]);
        }
        sizes.insert(key(e), size);
    });
    let (mut names, mut parts) = (Names::new(), Vec::new());
    if sizes[&key(root)] <= SMALL {
        return (names, parts);
    }
    let taken = words(root);
    let mut free = (0..).map(name).filter(|name| !taken.contains(name));
    root.visit(|e| {
        let own = e.args().iter().map(|a| if names.contains_key(&key(a)) { 1 } else { sizes[&key(a)] });
        let own = own.fold(1_usize, usize::saturating_add);
        sizes.insert(key(e), own);
        if own >= NAMED && uses.get(&key(e)).is_some_and(|&n| n > 1) && !names.contains_key(&key(e)) {
            names.insert(key(e), free.next().expect("names without end"));
            parts.push(e);
        }
    });
    // By each node, as the printer meets them.
    let each = first.iter().filter_map(|(node, first)| Some((*node, names.get(first)?.clone())));
    (each.collect(), parts)
}

/// a to z, then a1 to z1 and so on.
fn name(k: usize) -> String {
    let letter = char::from(b'a' + (k % 26) as u8);
    if k < 26 { letter.to_string() } else { format!("{letter}{}", k / 26) }
}

/// Names that the expression holds: of symbols and tables.
fn words(root: &Expr) -> HashSet<String> {
    let mut found = HashSet::new();
    root.visit(|e| match e.node() {
        Node::Symbol(name) | Node::Named(name, _) => _ = found.insert(name.to_string()),
        Node::Lookup(lookup, _) => _ = found.insert(lookup.table.name().to_owned()),
        _ => {}
    });
    found
}

/// The remaining tasks of printing.
enum Task<'a> {
    Text(&'static str),
    Expr(&'a Expr),
}

fn print(root: &Expr, style: &Style) -> String {
    let (names, parts) = shared(root);
    let printer = Printer { style, names };
    let mut out = String::new();
    for part in parts {
        out.push_str(&(style.symbol)(&printer.names[&std::ptr::from_ref(part.node())]));
        out.push_str(" = ");
        printer.print(part, &mut out);
        out.push_str(style.next);
    }
    printer.print(root, &mut out);
    out
}

struct Printer<'s> {
    style: &'s Style,
    names: Names,
}

impl Printer<'_> {
    /// The name of a part that is written once.
    fn name(&self, expr: &Expr) -> Option<&String> {
        self.names.get(&std::ptr::from_ref(expr.node()))
    }

    /// Prints with an explicit stack into one text: sums of thousands of terms are deep trees. The root is written
    /// out, be it named or not.
    fn print(&self, root: &Expr, out: &mut String) {
        let style = self.style;
        let mut stack = vec![Task::Expr(root)];
        let mut first = true;
        while let Some(task) = stack.pop() {
            let expr = match task {
                Task::Text(text) => {
                    out.push_str(text);
                    continue;
                }
                Task::Expr(expr) => expr,
            };
            if let Some(name) = self.name(expr).filter(|_| !first) {
                out.push_str(&(style.symbol)(name));
                continue;
            }
            first = false;
            let start = stack.len();
            match expr.node() {
                Node::Constant(c) => out.push_str(&(style.number)(*c)),
                Node::Symbol(name) | Node::Named(name, _) => out.push_str(&(style.symbol)(name)),
                Node::Apply(op, args) => self.push_operation(*op, args, &mut stack),
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
    }

    /// The template of an operation, cut at `{0}`, `{1}`, `{2}`; other braces stand for themselves.
    fn push_operation<'a>(&self, op: Op, args: &'a [Expr], stack: &mut Vec<Task<'a>>) {
        let style = self.style;
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
            // Numbers beside each other would run together.
            let apart =
                op == Op::Mul && style.delimits && index == 1 && matches!(arg.node(), Node::Constant(_));
            stack.push(Task::Text(if apart { " \\cdot " } else { &rest[..at] }));
            let brackets = self.in_brackets(op, index, arg);
            stack.extend(brackets.then_some(Task::Text(style.open)));
            stack.push(Task::Expr(arg));
            stack.extend(brackets.then_some(Task::Text(style.close)));
            (rest, from) = (&rest[at + 3..], 0);
        }
        stack.push(Task::Text(rest));
    }

    /// Returns the precedence of the printed form of an expression.
    fn precedence(&self, expr: &Expr) -> u8 {
        match expr.node() {
            _ if self.name(expr).is_some() => ATOM,
            Node::Constant(c) if *c < 0.0 => PRODUCT,
            // A fraction is an atom, an exponential a power; neither can be raised to a power as it is.
            Node::Apply(Op::Div | Op::Recip | Op::Exp, _) if self.style.delimits => POWER,
            Node::Apply(op, _) => op.entry().precedence,
            _ => ATOM,
        }
    }

    /// Whether the i-th argument of an operation needs brackets.
    fn in_brackets(&self, op: Op, i: usize, arg: &Expr) -> bool {
        let (entry, style) = (op.entry(), self.style);
        let quotient = matches!(op, Op::Div | Op::Recip);
        if entry.precedence == ATOM || (style.delimits && (quotient || (op == Op::Pow && i == 1))) {
            return false;
        }
        // The right side of −, / and the base of a power bind tighter than the operation.
        let strict = i == 1 && !entry.commutative
            || (op == Op::Pow && i == 0)
            || matches!(op, Op::Neg | Op::Recip)
            || entry.precedence == 0;
        let inner = self.precedence(arg);
        inner < entry.precedence
            || (strict && inner == entry.precedence)
            // A sign at the start of a right operand reads as two operators.
            || (i == 1 && entry.precedence >= SUM && self.starts_with_sign(arg))
    }

    fn starts_with_sign(&self, expr: &Expr) -> bool {
        let mut expr = expr;
        loop {
            match expr.node() {
                _ if self.name(expr).is_some() => return false,
                Node::Constant(c) => return *c < 0.0,
                Node::Apply(Op::Neg, _) => return true,
                Node::Apply(op, args)
                    if (self.style.template)(*op).starts_with("{0}")
                        && !self.in_brackets(*op, 0, &args[0]) =>
                {
                    expr = &args[0];
                }
                _ => return false,
            }
        }
    }
}

/// Greek letters by their names.
const GREEK: &[(&str, char)] = &[
    ("alpha", 'α'),
    ("beta", 'β'),
    ("gamma", 'γ'),
    ("delta", 'δ'),
    ("epsilon", 'ε'),
    ("zeta", 'ζ'),
    ("eta", 'η'),
    ("theta", 'θ'),
    ("iota", 'ι'),
    ("kappa", 'κ'),
    ("lambda", 'λ'),
    ("mu", 'μ'),
    ("nu", 'ν'),
    ("xi", 'ξ'),
    ("pi", 'π'),
    ("rho", 'ρ'),
    ("sigma", 'σ'),
    ("tau", 'τ'),
    ("upsilon", 'υ'),
    ("phi", 'φ'),
    ("chi", 'χ'),
    ("psi", 'ψ'),
    ("omega", 'ω'),
];

/// Lists what forces, moments and their coefficients are differentiated with respect to.
const VARIABLES: &[&str] = &[
    "0", "u", "v", "w", "p", "q", "r", "a", "b", "V", "da", "de", "df", "dr", "ds", "dt", "alpha", "beta",
    "theta",
];

/// The symbol of a name: Greek letters by their names, an index after each `_`, and stability and control derivatives as
/// they are written: `Cma` is C_{m\alpha}, `Mde` is M_{\delta e}.
fn latex_symbol(name: &str) -> String {
    if let Some(Derivative { head, axis, about }) = derivative(name) {
        return format!("{head}_{{{axis}{}}}", latex_variable(about));
    }
    let (head, tail) = name.split_once('_').unwrap_or((name, ""));
    let head = greek(head).unwrap_or_else(|| {
        if head.chars().count() > 1 { format!("\\mathrm{{{head}}}") } else { head.to_owned() }
    });
    if tail.is_empty() { head } else { format!("{head}_{{{}}}", latex_symbol(tail)) }
}

/// The symbol of a name in Unicode, for other markup: its head and the index after each `_`, `["C", "mα"]` of `Cma`.
pub fn symbol_parts(name: &str) -> Vec<String> {
    if let Some(Derivative { head, axis, about }) = derivative(name) {
        let index = format!("{axis}{}", unicode_variable(about));
        return [head.to_owned(), index].into();
    }
    let word = |word: &str| match (greek_letter(word), derivative(word)) {
        (Some(letter), _) => letter.to_string(),
        (None, Some(Derivative { head, axis, about })) => format!("{head}{axis}{}", unicode_variable(about)),
        (None, None) => word.to_owned(),
    };
    let mut words = name.split('_');
    let head = words.next().unwrap_or(name);
    let head = greek_letter(head).map_or_else(|| head.to_owned(), String::from);
    [head].into_iter().chain(words.map(word)).collect()
}

/// The Greek letter of a name: `delta` is a small one, `Delta` a capital.
fn greek_letter(name: &str) -> Option<char> {
    GREEK.iter().find_map(|&(small, letter)| {
        let capital =
            || name.len() == small.len() && name[1..] == small[1..] && name.eq_ignore_ascii_case(small);
        match name == small {
            true => Some(letter),
            false if name.is_ascii() && capital() => letter.to_uppercase().next(),
            false => None,
        }
    })
}

fn greek(name: &str) -> Option<String> {
    greek_letter(name).map(|_| format!("\\{name}"))
}

/// Holds the parts of the name of a stability or control derivative. A force or moment that is no coefficient has no axis; a
/// coefficient may be that of the force itself, `CL`, which is with respect to nothing.
struct Derivative<'a> {
    head: &'a str,
    axis: &'a str,
    about: &'a str,
}

fn derivative(name: &str) -> Option<Derivative<'_>> {
    if !name.is_ascii() || name.len() < 2 {
        return None;
    }
    let (head, axis, about) = match name.as_bytes()[0] {
        b'C' if b"DLTXYZlmn".contains(&name.as_bytes()[1]) => (&name[..1], &name[1..2], &name[2..]),
        b'L' | b'M' | b'N' | b'X' | b'Y' | b'Z' => (&name[..1], "", &name[1..]),
        _ => return None,
    };
    let known = VARIABLES.contains(&about) || (head == "C" && about.is_empty());
    known.then_some(Derivative { head, axis, about })
}

/// The variable of a derivative: the name of a Greek letter, or "", and what follows it. `a` is alpha, `de` is delta e.
fn variable(name: &str) -> (&str, &str) {
    match name {
        "a" => ("alpha", ""),
        "b" => ("beta", ""),
        _ if greek_letter(name).is_some() => (name, ""),
        _ => match name.strip_prefix('d').filter(|rest| !rest.is_empty()) {
            Some(rest) => ("delta", rest),
            None => ("", name),
        },
    }
}

fn latex_variable(name: &str) -> String {
    match variable(name) {
        ("", rest) => rest.to_owned(),
        (letter, "") => format!("\\{letter}"),
        (letter, rest) => format!("\\{letter} {rest}"),
    }
}

fn unicode_variable(name: &str) -> String {
    let (letter, rest) = variable(name);
    greek_letter(letter).map(String::from).unwrap_or_default() + rest
}

/// The shortest text that reads back as the number.
fn number(c: f64) -> String {
    if c == 0.0 || (1e-5..1e16).contains(&c.abs()) || !c.is_finite() {
        format!("{c}")
    } else {
        format!("{c:e}")
    }
}

/// Six significant digits: the text is for readers, and does not read back.
fn latex_number(c: f64) -> String {
    let text = format!("{c:.5e}");
    let Some((mantissa, exponent)) = text.split_once('e') else { return text };
    let Ok(power) = exponent.parse::<i32>() else { return text };
    let without_zeros = |text: &str| match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text.to_owned(),
    };
    if (-4..6).contains(&power) {
        without_zeros(&format!("{c:.*}", usize::try_from(5 - power).unwrap_or(0)))
    } else {
        format!("{} \\cdot 10^{{{power}}}", without_zeros(mantissa))
    }
}
