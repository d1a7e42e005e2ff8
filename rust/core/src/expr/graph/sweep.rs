//! Whole expressions in and out of a graph.

use std::collections::HashMap;
use std::sync::Arc;

use rustc_hash::FxHashMap;

use super::{Graph, Id, Item};
use crate::expr::{Expr, Node};

impl Graph {
    /// Interns an expression; `define` may replace a symbol (a quantity by its definition).
    pub fn import(&mut self, root: &Expr, define: &HashMap<Arc<str>, Id>) -> Id {
        // An explicit stack: sums of thousands of terms are deep trees.
        let mut done: FxHashMap<*const Node, Id> = FxHashMap::default();
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
                Node::Constant(c) | Node::Named(_, c) => self.constant(*c),
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
        let mut done: FxHashMap<Id, Id> = old.iter().copied().zip(new.iter().copied()).collect();
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
}
