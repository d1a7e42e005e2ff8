//! Expressions interned for compilation: equal nodes stored once, constants folded.
//!
//! A [`Graph`] is made when a model is compiled and thrown away after. Arguments always stand
//! before the node that uses them, so a sweep over ids is a sweep in evaluation order.

use std::collections::HashMap;
use std::sync::Arc;

use super::ops::Op;
use super::{Expr, Lookup, Node};

/// A node of a [`Graph`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Id(u32);

impl Id {
    /// Position in evaluation order.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// What a node of a [`Graph`] holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Item {
    /// The bits of a constant (bits, so that nodes can be compared and hashed).
    Constant(u64),
    /// The n-th symbol of the graph.
    Symbol(u32),
    /// An operation; unused arguments repeat the first.
    Apply(Op, [Id; 3]),
    /// The n-th table lookup of the graph; a 1-D lookup repeats its argument.
    Lookup(u32, [Id; 2]),
}

/// Hash-consed expressions. See the [module](self).
#[derive(Debug, Default, Clone)]
pub struct Graph {
    items: Vec<Item>,
    interned: HashMap<Item, Id>,
    symbols: Vec<Arc<str>>,
    symbol_ids: HashMap<Arc<str>, u32>,
    lookups: Vec<Lookup>,
    /// Whether each node is a sum of terms that are each switched: where(c, x, 0).
    switched: Vec<bool>,
}

impl Graph {
    /// An empty graph.
    pub fn new() -> Self {
        Self::default()
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.items.len()
    }

    /// Whether there are no nodes.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    /// What a node holds.
    pub fn item(&self, id: Id) -> Item {
        self.items[id.index()]
    }

    /// The arguments of a node.
    pub fn args(&self, id: Id) -> Vec<Id> {
        match self.item(id) {
            Item::Constant(_) | Item::Symbol(_) => Vec::new(),
            Item::Apply(op, args) => args[..op.entry().arity].to_vec(),
            Item::Lookup(k, args) => args[..self.lookups[k as usize].table.dimension()].to_vec(),
        }
    }

    /// The name of a symbol node.
    pub fn symbol_name(&self, id: Id) -> Option<&Arc<str>> {
        match self.item(id) {
            Item::Symbol(s) => Some(&self.symbols[s as usize]),
            _ => None,
        }
    }

    /// The n-th table lookup.
    pub fn lookup_at(&self, k: u32) -> &Lookup {
        &self.lookups[k as usize]
    }

    /// The value of a constant node.
    pub fn as_constant(&self, id: Id) -> Option<f64> {
        match self.item(id) {
            Item::Constant(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    /// The node that holds an item, where there is one.
    pub fn find(&self, item: Item) -> Option<Id> {
        self.interned.get(&item).copied()
    }

    fn intern(&mut self, item: Item) -> Id {
        if let Some(&id) = self.interned.get(&item) {
            return id;
        }
        let id = Id(u32::try_from(self.items.len()).expect("fewer than 2^32 nodes"));
        let switched = match item {
            Item::Apply(Op::Where, x) => {
                self.as_constant(x[1]) == Some(0.0) || self.as_constant(x[2]) == Some(0.0)
            }
            Item::Apply(Op::Add | Op::Sub, x) => self.switched[x[0].index()] && self.switched[x[1].index()],
            _ => false,
        };
        self.switched.push(switched);
        self.items.push(item);
        self.interned.insert(item, id);
        id
    }

    /// A constant; −0 is stored as 0, so that the two are one node.
    pub fn constant(&mut self, value: f64) -> Id {
        self.intern(Item::Constant((value + 0.0).to_bits()))
    }

    /// The constant 0.
    pub fn zero(&mut self) -> Id {
        self.constant(0.0)
    }

    /// The constant 1.
    pub fn one(&mut self) -> Id {
        self.constant(1.0)
    }

    /// The symbol of a given name.
    pub fn symbol(&mut self, name: &str) -> Id {
        let next = self.symbols.len() as u32;
        let index = match self.symbol_ids.get(name) {
            Some(&index) => index,
            None => {
                let name: Arc<str> = name.into();
                self.symbols.push(name.clone());
                self.symbol_ids.insert(name, next);
                next
            }
        };
        self.intern(Item::Symbol(index))
    }

    /// A table lookup, or one of its partial derivatives.
    pub fn lookup(&mut self, lookup: &Lookup, args: &[Id]) -> Id {
        if let Some(values) = self.all_constant(args) {
            let value = lookup.value(&values);
            return self.constant(value);
        }
        let k = self.lookups.iter().position(|l| l == lookup).unwrap_or_else(|| {
            self.lookups.push(lookup.clone());
            self.lookups.len() - 1
        });
        self.intern(Item::Lookup(k as u32, [args[0], *args.last().unwrap()]))
    }

    fn all_constant(&self, args: &[Id]) -> Option<Vec<f64>> {
        args.iter().map(|&a| self.as_constant(a)).collect()
    }

    /// Applies an operation, folding constants and the identities that keep derivatives small.
    /// Constants are folded only to finite values: a failure must stay visible where it happens.
    pub fn apply(&mut self, op: Op, args: &[Id]) -> Id {
        debug_assert_eq!(args.len(), op.entry().arity);
        if let Some(values) = self.all_constant(args) {
            let value = (op.entry().value)(&values);
            if value.is_finite() {
                return self.constant(value);
            }
        }
        match op {
            Op::Add => self.add(args[0], args[1]),
            Op::Sub => self.sub(args[0], args[1]),
            Op::Mul => self.mul(args[0], args[1]),
            Op::Div => self.div(args[0], args[1]),
            Op::Neg => self.neg(args[0]),
            Op::Recip => self.recip(args[0]),
            Op::Pow => self.pow(args[0], args[1]),
            Op::Where => self.select(args[0], args[1], args[2]),
            Op::Min | Op::Max if args[0] == args[1] => args[0],
            _ => self.intern_apply(op, args),
        }
    }

    /// Applies an operation of one argument.
    pub fn unary(&mut self, op: Op, a: Id) -> Id {
        self.apply(op, &[a])
    }

    fn intern_apply(&mut self, op: Op, args: &[Id]) -> Id {
        let mut full = [args[0]; 3];
        full[..args.len()].copy_from_slice(args);
        // One order for the same operands; constants go first.
        let place = |a: Id| (self.as_constant(a).is_none(), a);
        if op.entry().commutative && place(full[0]) > place(full[1]) {
            full.swap(0, 1);
            full[2] = full[0];
        }
        self.intern(Item::Apply(op, full))
    }

    fn fold2(&mut self, op: Op, a: Id, b: Id) -> Option<Id> {
        let value = (op.entry().value)(&[self.as_constant(a)?, self.as_constant(b)?]);
        value.is_finite().then(|| self.constant(value))
    }

    fn negated(&self, id: Id) -> Option<Id> {
        match self.item(id) {
            Item::Apply(Op::Neg, a) => Some(a[0]),
            _ => None,
        }
    }

    /// a + b
    pub fn add(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Add, a, b) {
            return id;
        }
        if self.as_constant(a) == Some(0.0) {
            return b;
        }
        if self.as_constant(b) == Some(0.0) {
            return a;
        }
        if let Some(x) = self.negated(b) {
            return self.sub(a, x);
        }
        if let Some(x) = self.negated(a) {
            return self.sub(b, x);
        }
        if a == b {
            let two = self.constant(2.0);
            return self.mul(two, a);
        }
        if let Some((condition, yes, no)) = self.same_switch(a, b) {
            let (yes, no) = (self.add(yes[0], yes[1]), self.add(no[0], no[1]));
            return self.select(condition, yes, no);
        }
        self.intern_apply(Op::Add, &[a, b])
    }

    /// a − b
    pub fn sub(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Sub, a, b) {
            return id;
        }
        if self.as_constant(b) == Some(0.0) {
            return a;
        }
        if self.as_constant(a) == Some(0.0) {
            return self.neg(b);
        }
        if a == b {
            return self.zero();
        }
        if let Some(x) = self.negated(b) {
            return self.add(a, x);
        }
        if let Some((condition, yes, no)) = self.same_switch(a, b) {
            let (yes, no) = (self.sub(yes[0], yes[1]), self.sub(no[0], no[1]));
            return self.select(condition, yes, no);
        }
        self.intern_apply(Op::Sub, &[a, b])
    }

    /// For two terms that the same condition switches: the condition and both branches of each.
    /// Their sum is then switched as one.
    fn same_switch(&self, a: Id, b: Id) -> Option<(Id, [Id; 2], [Id; 2])> {
        match (self.item(a), self.item(b)) {
            (Item::Apply(Op::Where, x), Item::Apply(Op::Where, y))
                if x[0] == y[0] && self.switched[a.index()] && self.switched[b.index()] =>
            {
                Some((x[0], [x[1], y[1]], [x[2], y[2]]))
            }
            _ => None,
        }
    }

    /// −a
    pub fn neg(&mut self, a: Id) -> Id {
        if let Some(c) = self.as_constant(a) {
            return self.constant(-c);
        }
        match self.item(a) {
            Item::Apply(Op::Neg, x) => x[0],
            Item::Apply(Op::Sub, x) => self.sub(x[1], x[0]),
            Item::Apply(Op::Mul, x) if self.as_constant(x[0]).is_some() => {
                let c = self.neg(x[0]);
                self.mul(c, x[1])
            }
            Item::Apply(Op::Where, x) => {
                let (yes, no) = (self.neg(x[1]), self.neg(x[2]));
                self.select(x[0], yes, no)
            }
            _ => self.intern_apply(Op::Neg, &[a]),
        }
    }

    /// a · b
    pub fn mul(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Mul, a, b) {
            return id;
        }
        // Constants go first.
        let (a, b) = if self.as_constant(b).is_some() { (b, a) } else { (a, b) };
        if let Some(c) = self.as_constant(a) {
            if c == 0.0 {
                return self.zero();
            }
            if c == 1.0 {
                return b;
            }
            if c == -1.0 {
                return self.neg(b);
            }
            if let Item::Apply(Op::Mul, x) = self.item(b)
                && let Some(d) = self.as_constant(x[0])
            {
                let product = self.constant(c * d);
                return self.mul(product, x[1]);
            }
        }
        if let Some(x) = self.negated(b) {
            let product = self.mul(a, x);
            return self.neg(product);
        }
        if let Some(x) = self.negated(a) {
            let product = self.mul(x, b);
            return self.neg(product);
        }
        // A factor that is switched off must stay off: where(c, x, 0)·p as where(c, x·p, 0) keeps
        // a p that is not finite on the branch not taken (the derivative of sqrt at 0, say) out
        // of the result.
        for (s, p) in [(a, b), (b, a)] {
            if let Item::Apply(Op::Where, x) = self.item(s) {
                if self.as_constant(x[2]) == Some(0.0) {
                    let (on, off) = (self.mul(x[1], p), self.zero());
                    return self.select(x[0], on, off);
                }
                if self.as_constant(x[1]) == Some(0.0) {
                    let (on, off) = (self.mul(x[2], p), self.zero());
                    return self.select(x[0], off, on);
                }
            }
        }
        // The same for a sum of terms under several conditions, term by term.
        for (s, p) in [(a, b), (b, a)] {
            if let Item::Apply(op @ (Op::Add | Op::Sub), x) = self.item(s)
                && self.switched[s.index()]
            {
                let (left, right) = (self.mul(x[0], p), self.mul(x[1], p));
                return self.apply(op, &[left, right]);
            }
        }
        // c·x times y as c·(x·y), so that the product x·y is shared whatever the constant.
        if self.as_constant(a).is_none() {
            for (s, p) in [(a, b), (b, a)] {
                if let Item::Apply(Op::Mul, x) = self.item(s)
                    && self.as_constant(x[0]).is_some()
                {
                    let product = self.mul(x[1], p);
                    return self.mul(x[0], product);
                }
            }
        }
        self.intern_apply(Op::Mul, &[a, b])
    }

    /// a · b of two nodes that are both wanted for themselves: nothing is taken out of them, so the
    /// product costs one instruction.
    pub fn product(&mut self, a: Id, b: Id) -> Id {
        if self.as_constant(a).is_some() || self.as_constant(b).is_some() {
            return self.mul(a, b);
        }
        self.intern_apply(Op::Mul, &[a, b])
    }

    /// a / b, as a · (1/b): the reciprocal is shared by all quotients and derivatives.
    pub fn div(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Div, a, b) {
            return id;
        }
        let inverse = self.recip(b);
        self.mul(a, inverse)
    }

    /// 1 / a
    pub fn recip(&mut self, a: Id) -> Id {
        if let Some(c) = self.as_constant(a) {
            let inverse = 1.0 / c;
            if inverse.is_finite() {
                return self.constant(inverse);
            }
        }
        match self.item(a) {
            Item::Apply(Op::Neg, x) => {
                let inverse = self.recip(x[0]);
                self.neg(inverse)
            }
            _ => self.intern_apply(Op::Recip, &[a]),
        }
    }

    /// a^b; small whole and half exponents become products, roots and reciprocals.
    pub fn pow(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Pow, a, b) {
            return id;
        }
        match self.as_constant(b) {
            Some(0.0) => self.one(),
            Some(1.0) => a,
            Some(2.0) => self.mul(a, a),
            Some(3.0) => {
                let square = self.mul(a, a);
                self.mul(a, square)
            }
            Some(0.5) => self.unary(Op::Sqrt, a),
            Some(-0.5) => {
                let root = self.unary(Op::Sqrt, a);
                self.recip(root)
            }
            Some(-1.0) => self.recip(a),
            Some(-2.0) => {
                let inverse = self.recip(a);
                self.mul(inverse, inverse)
            }
            _ => self.intern_apply(Op::Pow, &[a, b]),
        }
    }

    /// where(condition, yes, no)
    pub fn select(&mut self, condition: Id, yes: Id, no: Id) -> Id {
        // Within a branch the same condition is known.
        let yes = self.branch(condition, yes).map_or(yes, |x| x[1]);
        let no = self.branch(condition, no).map_or(no, |x| x[2]);
        if yes == no {
            return yes;
        }
        match self.as_constant(condition) {
            Some(0.0) => no,
            Some(_) => yes,
            None => self.intern_apply(Op::Where, &[condition, yes, no]),
        }
    }

    /// The arguments of a `where` on this very condition.
    fn branch(&self, condition: Id, a: Id) -> Option<[Id; 3]> {
        match self.item(a) {
            Item::Apply(Op::Where, x) if x[0] == condition => Some(x),
            _ => None,
        }
    }

    /// Interns an expression; `define` may replace a symbol (a quantity by its definition).
    pub fn import(&mut self, root: &Expr, define: &HashMap<Arc<str>, Id>) -> Id {
        // An explicit stack: sums of thousands of terms are deep trees.
        let mut done: HashMap<*const Node, Id> = HashMap::new();
        let mut stack = vec![(root, false)];
        while let Some((expr, ready)) = stack.pop() {
            let key = std::ptr::from_ref(expr.node());
            if done.contains_key(&key) {
                continue;
            }
            let args = expr.args();
            if !ready && !args.is_empty() {
                stack.push((expr, true));
                stack.extend(args.iter().map(|a| (a, false)));
                continue;
            }
            let ids: Vec<Id> = args.iter().map(|a| done[&std::ptr::from_ref(a.node())]).collect();
            let id = match expr.node() {
                Node::Constant(c) => self.constant(*c),
                Node::Symbol(name) => match define.get(name) {
                    Some(&id) => id,
                    None => self.symbol(name),
                },
                Node::Apply(op, _) => self.apply(*op, &ids),
                Node::Lookup(lookup, _) => self.lookup(lookup, &ids),
            };
            done.insert(key, id);
        }
        done[&std::ptr::from_ref(root.node())]
    }

    /// The expression that a node stands for.
    pub fn export(&self, root: Id) -> Expr {
        let mut exprs: Vec<Option<Expr>> = vec![None; root.index() + 1];
        for id in self.reachable(&[root]) {
            let args = self.args(id).iter().map(|a| exprs[a.index()].clone().unwrap()).collect();
            exprs[id.index()] = Some(match self.item(id) {
                Item::Constant(bits) => Expr::constant(f64::from_bits(bits)),
                Item::Symbol(s) => Expr::symbol(&self.symbols[s as usize]),
                Item::Apply(op, _) => Expr::apply(op, args),
                Item::Lookup(k, _) => Expr::lookup(self.lookups[k as usize].clone(), args),
            });
        }
        exprs[root.index()].clone().unwrap()
    }

    /// The roots with some nodes replaced by others.
    pub fn replace(&mut self, roots: &[Id], old: &[Id], new: &[Id]) -> Vec<Id> {
        let mut done: HashMap<Id, Id> = old.iter().copied().zip(new.iter().copied()).collect();
        for id in self.reachable(roots) {
            if done.contains_key(&id) {
                continue;
            }
            let args: Vec<Id> = self.args(id).iter().map(|a| done[a]).collect();
            let replaced = match self.item(id) {
                Item::Constant(_) | Item::Symbol(_) => id,
                Item::Apply(op, _) => self.apply(op, &args),
                Item::Lookup(k, _) => {
                    let lookup = self.lookups[k as usize].clone();
                    self.lookup(&lookup, &args)
                }
            };
            done.insert(id, replaced);
        }
        roots.iter().map(|r| done[r]).collect()
    }

    /// All nodes that the roots need, in evaluation order.
    pub fn reachable(&self, roots: &[Id]) -> Vec<Id> {
        let size = roots.iter().map(|r| r.index() + 1).max().unwrap_or(0);
        let mut seen = vec![false; size];
        for root in roots {
            seen[root.index()] = true;
        }
        for i in (0..size).rev() {
            if seen[i] {
                for arg in self.args(Id(i as u32)) {
                    seen[arg.index()] = true;
                }
            }
        }
        (0..size).filter(|&i| seen[i]).map(|i| Id(i as u32)).collect()
    }

    /// The value of one node from the values of its arguments.
    pub fn value(&self, id: Id, args: &[f64]) -> f64 {
        match self.item(id) {
            Item::Constant(bits) => f64::from_bits(bits),
            Item::Symbol(_) => f64::NAN,
            Item::Apply(op, _) => (op.entry().value)(args),
            Item::Lookup(k, _) => self.lookups[k as usize].value(args),
        }
    }
}
