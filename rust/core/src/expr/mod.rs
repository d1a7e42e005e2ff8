//! Symbolic expressions: what a user writes a model in.
//!
//! An [`Expr`] is an immutable, shared tree. It has no home: any two can be combined, sent to
//! another thread or saved. What is equal is found when a model is compiled ([`graph`]), where
//! derivatives are taken too ([`derive`](mod@derive)).

pub(crate) mod derive;
pub(crate) mod display;
pub(crate) mod graph;
mod operators;
pub(crate) mod ops;
mod partials;
#[cfg(feature = "serde")]
pub(crate) mod pool;

use std::collections::{BTreeSet, HashMap, HashSet};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

pub use graph::Graph;
pub use operators::{
    atan2, eq, ge, gt, hypot, le, lt, max, min, select, smooth_abs, smooth_max, smooth_min, smooth_sign,
};
pub use ops::Op;

use crate::table::Table;

/// A table lookup or one of its partial derivatives.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Lookup {
    /// The table.
    pub table: Arc<Table>,
    /// Order of differentiation with respect to each argument.
    pub order: [u8; 2],
}

impl Lookup {
    /// The partial derivative with respect to the i-th argument.
    pub fn derivative(&self, i: usize) -> Lookup {
        let mut lookup = self.clone();
        // Saturating: all derivatives above the third are zero.
        lookup.order[i] = lookup.order[i].saturating_add(1);
        lookup
    }

    /// Value at numbers.
    pub fn value(&self, x: &[f64]) -> f64 {
        match self.table.dimension() {
            1 => self.table.eval1(self.order[0], x[0]),
            _ => self.table.eval2(self.order[0], self.order[1], x[0], x[1]),
        }
    }
}

/// The content of a node of an expression.
#[derive(Debug)]
pub enum Node {
    /// A number.
    Constant(f64),
    /// A number that is printed by a name: a constant that a model declares.
    Named(Arc<str>, f64),
    /// A named quantity: state, input, parameter, time.
    Symbol(Arc<str>),
    /// An operation on other expressions.
    Apply(Op, Vec<Expr>),
    /// A table lookup.
    Lookup(Lookup, Vec<Expr>),
}

impl Drop for Node {
    /// Takes long chains apart one by one: a sum of many terms is a deep tree, and dropping it
    /// node within node would exhaust the stack.
    fn drop(&mut self) {
        let mut stack = match self {
            Node::Apply(_, args) | Node::Lookup(_, args) => std::mem::take(args),
            _ => return,
        };
        while let Some(expr) = stack.pop() {
            if let Ok(mut inner) = Arc::try_unwrap(expr.0)
                && let Node::Apply(_, args) | Node::Lookup(_, args) = &mut inner.node
            {
                stack.append(args);
            }
        }
    }
}

struct Inner {
    node: Node,
    hash: u64,
}

/// A symbolic expression. Cloning is cheap.
///
/// Operators take expressions, references to them and numbers, in any mixture with an expression in it;
/// functions of one argument are methods, those of two stand in [`expr`](self). Comparisons are functions
/// too, for [`select`]: Rust's own compare structure.
///
/// ```
/// use phugoid::expr::{Expr, atan2, gt, max, select};
///
/// let (x, y) = (Expr::symbol("x"), Expr::symbol("y"));
/// let f = 0.5 * x.pow(2.0) - &x * y.sin() / 3.0;
/// assert_eq!(f.to_string(), "0.5*x**2 - x*sin(y)/3");
/// assert_eq!(f.derivative("y").evaluate(&[("x".into(), 3.0), ("y".into(), 0.0)].into()), Ok(-1.0));
///
/// let kinked = select(gt(&x, 1.0), max(&x, &y), atan2(&y, &x));
/// let at = [("x".into(), 2.0), ("y".into(), -1.0)].into();
/// assert_eq!(kinked.evaluate(&at), Ok(2.0));
/// assert_eq!((-kinked).evaluate(&at), Ok(-2.0));
/// assert_eq!(f.evaluate(&[("x".into(), 2.0)].into()), Err("y".into())); // y was given no value
/// ```
#[derive(Clone)]
pub struct Expr(Arc<Inner>);

impl Expr {
    fn new(node: Node) -> Self {
        let mut hasher = DefaultHasher::new();
        match &node {
            Node::Constant(c) => c.to_bits().hash(&mut hasher),
            Node::Named(name, c) => (name, c.to_bits()).hash(&mut hasher),
            Node::Symbol(name) => name.hash(&mut hasher),
            Node::Apply(op, args) => {
                op.hash(&mut hasher);
                args.iter().for_each(|a| a.0.hash.hash(&mut hasher));
            }
            Node::Lookup(lookup, args) => {
                lookup.table.name().hash(&mut hasher);
                args.iter().for_each(|a| a.0.hash.hash(&mut hasher));
            }
        }
        Expr(Arc::new(Inner { node, hash: hasher.finish() }))
    }

    /// A number.
    pub fn constant(value: f64) -> Self {
        Self::new(Node::Constant(value))
    }

    /// A number with a name, by which it is printed; in everything else it is the number.
    ///
    /// ```
    /// use phugoid::expr::Expr;
    ///
    /// let area = Expr::named("S", 30.1);
    /// let lift = &area * Expr::symbol("CL");
    /// assert_eq!(lift.to_string(), "S*CL");
    /// assert_eq!(lift.simplified().to_string(), "30.1*CL");
    /// assert_eq!(area.as_constant(), Some(30.1));
    /// assert_eq!(lift.constants(), [("S".into(), 30.1)]);
    /// ```
    pub fn named(name: &str, value: f64) -> Self {
        Self::new(Node::Named(name.into(), value))
    }

    /// A named quantity. Two symbols of one name are the same symbol.
    pub fn symbol(name: &str) -> Self {
        Self::new(Node::Symbol(name.into()))
    }

    /// An operation on expressions.
    ///
    /// # Panics
    /// When the number of arguments is not the operation's.
    pub fn apply(op: Op, args: Vec<Expr>) -> Self {
        assert_eq!(args.len(), op.entry().arity, "{} takes {} arguments", op.entry().name, op.entry().arity);
        Self::new(Node::Apply(op, args))
    }

    /// A table lookup.
    ///
    /// # Panics
    /// When the number of arguments is not the table's dimension.
    pub fn lookup(lookup: Lookup, args: Vec<Expr>) -> Self {
        assert_eq!(args.len(), lookup.table.dimension(), "table '{}'", lookup.table.name());
        Self::new(Node::Lookup(lookup, args))
    }

    /// Returns the content of the top node.
    pub fn node(&self) -> &Node {
        &self.0.node
    }

    /// A hash of the structure, equal for equal expressions.
    pub fn structural_hash(&self) -> u64 {
        self.0.hash
    }

    /// The arguments of the top node.
    pub fn args(&self) -> &[Expr] {
        match self.node() {
            Node::Apply(_, args) | Node::Lookup(_, args) => args,
            _ => &[],
        }
    }

    /// The number, where the expression is one.
    pub fn as_constant(&self) -> Option<f64> {
        match self.node() {
            Node::Constant(c) | Node::Named(_, c) => Some(*c),
            _ => None,
        }
    }

    /// The name, where the expression is a symbol.
    pub fn as_symbol(&self) -> Option<&str> {
        match self.node() {
            Node::Symbol(name) => Some(name),
            _ => None,
        }
    }

    /// Visits every distinct node once, arguments before the nodes that use them.
    pub fn visit<'a>(&'a self, mut f: impl FnMut(&'a Expr)) {
        let mut seen: HashSet<*const Inner> = HashSet::new();
        let mut stack = vec![(self, false)];
        while let Some((expr, ready)) = stack.pop() {
            let key = Arc::as_ptr(&expr.0);
            if ready {
                f(expr);
            } else if seen.insert(key) {
                stack.push((expr, true));
                stack.extend(expr.args().iter().rev().map(|a| (a, false)));
            }
        }
    }

    /// Names of all symbols, sorted.
    pub fn symbols(&self) -> BTreeSet<Arc<str>> {
        let mut names = BTreeSet::new();
        self.visit(|e| {
            if let Node::Symbol(name) = e.node() {
                names.insert(name.clone());
            }
        });
        names
    }

    /// Names and values of all named constants, each once, sorted by name.
    pub fn constants(&self) -> Vec<(Arc<str>, f64)> {
        let mut found: Vec<(Arc<str>, f64)> = Vec::new();
        self.visit(|e| {
            if let Node::Named(name, c) = e.node()
                && !found.iter().any(|(n, v)| n == name && v.to_bits() == c.to_bits())
            {
                found.push((name.clone(), *c));
            }
        });
        found.sort_by(|a, b| a.0.cmp(&b.0));
        found
    }

    /// The value at numbers, or the name of a symbol that was given none.
    pub fn evaluate(&self, values: &HashMap<Arc<str>, f64>) -> Result<f64, Arc<str>> {
        let mut done: HashMap<*const Inner, f64> = HashMap::new();
        let mut missing = None;
        self.visit(|e| {
            let args: Vec<f64> = e.args().iter().map(|a| done[&Arc::as_ptr(&a.0)]).collect();
            let value = match e.node() {
                Node::Constant(c) | Node::Named(_, c) => *c,
                Node::Symbol(name) => values.get(name).copied().unwrap_or_else(|| {
                    missing.get_or_insert_with(|| name.clone());
                    f64::NAN
                }),
                Node::Apply(op, _) => (op.entry().value)(&args),
                Node::Lookup(lookup, _) => lookup.value(&args),
            };
            done.insert(Arc::as_ptr(&e.0), value);
        });
        match missing {
            Some(name) => Err(name),
            None => Ok(done[&Arc::as_ptr(&self.0)]),
        }
    }

    /// The expression with symbols replaced.
    pub fn substitute(&self, replace: &HashMap<Arc<str>, Expr>) -> Expr {
        self.rebuilt(|old, _| match old.node() {
            Node::Symbol(name) => replace.get(name).cloned(),
            _ => None,
        })
    }

    /// The expression with nodes replaced, from its leaves up: `change` sees each node and its arguments as they are by
    /// then, and returns what stands for it, or `None` for the same operation.
    pub(crate) fn rebuilt(&self, mut change: impl FnMut(&Expr, &[Expr]) -> Option<Expr>) -> Expr {
        let mut done: HashMap<*const Inner, Expr> = HashMap::new();
        self.visit(|e| {
            let args: Vec<Expr> = e.args().iter().map(|a| done[&Arc::as_ptr(&a.0)].clone()).collect();
            let unchanged = args.iter().zip(e.args()).all(|(new, old)| Arc::ptr_eq(&new.0, &old.0));
            let new = change(e, &args).unwrap_or_else(|| match e.node() {
                _ if unchanged => e.clone(),
                Node::Apply(op, _) => Expr::apply(*op, args),
                Node::Lookup(lookup, _) => Expr::lookup(lookup.clone(), args),
                Node::Symbol(_) | Node::Constant(_) | Node::Named(..) => e.clone(),
            });
            done.insert(Arc::as_ptr(&e.0), new);
        });
        done[&Arc::as_ptr(&self.0)].clone()
    }

    /// The exact derivative with respect to a symbol.
    pub fn derivative(&self, symbol: &str) -> Expr {
        let mut graph = Graph::new();
        let root = graph.import(self, &HashMap::new());
        let symbol = graph.symbol(symbol);
        match graph.gradient(root, &[symbol])[0] {
            Some(id) => graph.export(id),
            None => Expr::constant(0.0),
        }
    }

    /// The expression with constants folded, named ones among them, and equal parts shared.
    pub fn simplified(&self) -> Expr {
        let mut graph = Graph::new();
        let root = graph.import(self, &HashMap::new());
        graph.export(root)
    }
}

impl PartialEq for Expr {
    /// Compares the structure, not the value: `a + b` and `b + a` differ.
    fn eq(&self, other: &Self) -> bool {
        let mut seen = HashSet::new();
        let mut stack = vec![(self, other)];
        while let Some((a, b)) = stack.pop() {
            if Arc::ptr_eq(&a.0, &b.0) || !seen.insert((Arc::as_ptr(&a.0), Arc::as_ptr(&b.0))) {
                continue;
            }
            let same = a.0.hash == b.0.hash
                && match (a.node(), b.node()) {
                    (Node::Constant(x), Node::Constant(y)) => x.to_bits() == y.to_bits(),
                    (Node::Named(a, x), Node::Named(b, y)) => a == b && x.to_bits() == y.to_bits(),
                    (Node::Symbol(x), Node::Symbol(y)) => x == y,
                    (Node::Apply(x, _), Node::Apply(y, _)) => x == y,
                    (Node::Lookup(x, _), Node::Lookup(y, _)) => x == y,
                    _ => false,
                };
            if !same {
                return false;
            }
            stack.extend(a.args().iter().zip(b.args()));
        }
        true
    }
}

impl Eq for Expr {}

impl Hash for Expr {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.0.hash.hash(state);
    }
}
