//! Expressions interned for compilation: equal nodes stored once, constants folded.
//!
//! A [`Graph`] is made when a model is compiled and thrown away after. Arguments always stand
//! before the node that uses them, so a sweep over ids is a sweep in evaluation order.

mod fold;
mod sweep;

use std::sync::Arc;

use rustc_hash::FxHashMap;

use super::Lookup;
use super::ops::Op;

/// A node of a [`Graph`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Id(u32);

impl Id {
    /// Position in evaluation order.
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// The content of a node of a [`Graph`].
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
    interned: FxHashMap<Item, Id>,
    symbols: Vec<Arc<str>>,
    symbol_ids: FxHashMap<Arc<str>, u32>,
    lookups: Vec<Lookup>,
    /// Whether each node is a sum of terms that are each switched: where(c, x, 0).
    switched: Vec<bool>,
    /// Number of `where`, and of sums of switched terms, from the top of each node down.
    depth: Vec<u32>,
    /// For switched nodes that were asked for, the condition under which they are on.
    conditions: FxHashMap<Id, Id>,
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

    /// Returns the content of a node.
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
        let depth = |x: Id| self.depth[x.index()];
        let depth = match item {
            Item::Apply(Op::Where, x) => 1 + depth(x[1]).max(depth(x[2])),
            Item::Apply(_, x) if switched => 1 + depth(x[0]).max(depth(x[1])),
            _ => 0,
        };
        self.switched.push(switched);
        self.depth.push(depth);
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

    /// Declares `n` symbols, named by the name and a number each. No name of a model contains a space.
    pub fn symbols(&mut self, name: &str, n: usize) -> Vec<Id> {
        (0..n).map(|i| self.symbol(&format!("{name} {i}"))).collect()
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
