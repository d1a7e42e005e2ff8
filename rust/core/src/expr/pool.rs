//! Saved form of expressions: one list of nodes, shared parts written once.

use std::collections::HashMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Expr, Lookup, Node, Op};
use crate::table::Table;

/// One saved node; arguments are positions of earlier nodes.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum Saved {
    Constant {
        value: f64,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        name: Option<String>,
    },
    Symbol {
        symbol: String,
    },
    Apply {
        op: String,
        args: Vec<usize>,
    },
    Lookup {
        table: usize,
        order: [u8; 2],
        args: Vec<usize>,
    },
}

/// The key by which nodes are equal, with their arguments by place.
#[derive(PartialEq, Eq, Hash)]
enum Key<'a> {
    Constant(u64),
    Named(&'a str, u64),
    Symbol(&'a str),
    Apply(Op, Vec<usize>),
    Lookup(usize, [u8; 2], Vec<usize>),
}

/// Expressions as they are saved and sent between processes.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Pool {
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    tables: Vec<Table>,
    nodes: Vec<Saved>,
    roots: Vec<usize>,
}

impl Pool {
    /// Saves expressions together.
    pub fn new<'a>(exprs: impl IntoIterator<Item = &'a Expr>) -> Self {
        let mut pool = Pool::default();
        // Equal parts are found by what their arguments are: to compare whole trees would walk them again and again.
        let mut places: HashMap<Key<'a>, usize> = HashMap::new();
        let mut done: HashMap<*const Node, usize> = HashMap::new();
        let mut tables: Vec<Arc<Table>> = Vec::new();
        for root in exprs {
            root.visit(|e| {
                let own = std::ptr::from_ref(e.node());
                if done.contains_key(&own) {
                    return;
                }
                let args: Vec<usize> = e.args().iter().map(|a| done[&std::ptr::from_ref(a.node())]).collect();
                let (key, saved) = match e.node() {
                    Node::Constant(c) => {
                        (Key::Constant(c.to_bits()), Saved::Constant { value: *c, name: None })
                    }
                    Node::Named(name, c) => {
                        let saved = Saved::Constant { value: *c, name: Some(name.to_string()) };
                        (Key::Named(name, c.to_bits()), saved)
                    }
                    Node::Symbol(name) => (Key::Symbol(name), Saved::Symbol { symbol: name.to_string() }),
                    Node::Apply(op, _) => {
                        let name = op.entry().name.to_owned();
                        (Key::Apply(*op, args.clone()), Saved::Apply { op: name, args })
                    }
                    Node::Lookup(lookup, _) => {
                        let table = tables.iter().position(|t| *t == lookup.table).unwrap_or_else(|| {
                            tables.push(lookup.table.clone());
                            tables.len() - 1
                        });
                        let order = lookup.order;
                        (Key::Lookup(table, order, args.clone()), Saved::Lookup { table, order, args })
                    }
                };
                let place = *places.entry(key).or_insert_with(|| {
                    pool.nodes.push(saved);
                    pool.nodes.len() - 1
                });
                done.insert(own, place);
            });
            pool.roots.push(done[&std::ptr::from_ref(root.node())]);
        }
        pool.tables = tables.iter().map(|t| Table::clone(t)).collect();
        pool
    }

    /// The expressions, in the order in which they were saved.
    ///
    /// # Errors
    /// A sentence that says what is wrong with the saved nodes.
    pub fn expressions(&self) -> Result<Vec<Expr>, String> {
        let tables: Vec<Arc<Table>> = self.tables.iter().cloned().map(Arc::new).collect();
        let mut exprs: Vec<Expr> = Vec::with_capacity(self.nodes.len());
        for (i, saved) in self.nodes.iter().enumerate() {
            let find = |args: &[usize]| -> Result<Vec<Expr>, String> {
                args.iter()
                    .map(|&a| {
                        exprs.get(a).cloned().ok_or(format!("node {i} uses node {a}, which is not before it"))
                    })
                    .collect()
            };
            let expr = match saved {
                Saved::Constant { value, name: None } => Expr::constant(*value),
                Saved::Constant { value, name: Some(name) } => Expr::named(name, *value),
                Saved::Symbol { symbol } => Expr::symbol(symbol),
                Saved::Apply { op, args } => {
                    let op = Op::from_name(op).ok_or(format!("node {i}: unknown operation '{op}'"))?;
                    if args.len() != op.entry().arity {
                        return Err(format!(
                            "node {i}: {} takes {} arguments",
                            op.entry().name,
                            op.entry().arity
                        ));
                    }
                    Expr::apply(op, find(args)?)
                }
                Saved::Lookup { table, order, args } => {
                    let table = tables.get(*table).cloned().ok_or(format!("node {i}: no table {table}"))?;
                    if args.len() != table.dimension() {
                        return Err(format!(
                            "node {i}: table '{}' takes {} arguments",
                            table.name(),
                            table.dimension()
                        ));
                    }
                    Expr::lookup(Lookup { table, order: *order }, find(args)?)
                }
            };
            exprs.push(expr);
        }
        self.roots.iter().map(|&r| exprs.get(r).cloned().ok_or(format!("no node {r}"))).collect()
    }
}

impl Pool {
    /// The pool as JSON text.
    ///
    /// # Errors
    /// For a constant that is not finite, which JSON cannot hold.
    pub fn to_json(&self) -> Result<String, String> {
        if self.nodes.iter().any(|n| matches!(n, Saved::Constant { value, .. } if !value.is_finite())) {
            return Err("a constant of the expression is not finite and cannot be saved".into());
        }
        serde_json::to_string(self).map_err(|e| e.to_string())
    }

    /// Reads what [`Pool::to_json`] wrote.
    ///
    /// # Errors
    /// For other text.
    pub fn from_json(text: &str) -> Result<Self, String> {
        serde_json::from_str(text).map_err(|e| e.to_string())
    }
}
