//! Exact derivatives with structural sparsity: reverse sweeps over the graph.

use rustc_hash::FxHashMap;

use super::graph::{Graph, Id, Item};
use super::partials::partials;

/// Structurally nonzero entries of a Jacobian or of the lower triangle of a Hessian.
#[derive(Clone, Debug, Default)]
pub struct Sparse {
    /// Row of each entry.
    pub rows: Vec<usize>,
    /// Column of each entry.
    pub columns: Vec<usize>,
    /// Node of each entry.
    pub values: Vec<Id>,
}

impl Sparse {
    /// The entries by row and column.
    pub fn by_place(&self) -> FxHashMap<(usize, usize), Id> {
        let places = self.rows.iter().copied().zip(self.columns.iter().copied());
        places.zip(self.values.iter().copied()).collect()
    }

    /// The entry at a place, where it is structurally nonzero. It looks through all entries: where many are
    /// wanted, take [`Sparse::by_place`].
    pub fn find(&self, row: usize, column: usize) -> Option<Id> {
        let at = self.rows.iter().zip(&self.columns).position(|(&r, &c)| (r, c) == (row, column))?;
        Some(self.values[at])
    }
}

impl Graph {
    /// Partial derivatives of one node with respect to its arguments; `None` where zero.
    fn partials(&mut self, id: Id) -> Vec<(Id, Option<Id>)> {
        match self.item(id) {
            Item::Constant(_) | Item::Symbol(_) => Vec::new(),
            Item::Apply(op, _) => {
                let args = self.args(id);
                let partials = partials(op, self, &args, id);
                args.into_iter().zip(partials).collect()
            }
            Item::Lookup(k, _) => {
                let lookup = self.lookup_at(k).clone();
                let args = self.args(id);
                (0..args.len()).map(|i| (args[i], Some(self.lookup(&lookup.derivative(i), &args)))).collect()
            }
        }
    }

    /// Gradient of a node with respect to symbols: one reverse sweep. `None` where the derivative
    /// is identically zero.
    pub fn gradient(&mut self, root: Id, symbols: &[Id]) -> Vec<Option<Id>> {
        let nodes = self.reachable(&[root]);
        let mut depends = vec![false; root.index() + 1];
        for symbol in symbols {
            if let Some(d) = depends.get_mut(symbol.index()) {
                *d = true;
            }
        }
        for id in &nodes {
            if self.args(*id).iter().any(|a| depends[a.index()]) {
                depends[id.index()] = true;
            }
        }
        let mut adjoint: FxHashMap<Id, Id> = FxHashMap::default();
        if depends[root.index()] {
            let one = self.one();
            adjoint.insert(root, one);
        }
        for &id in nodes.iter().rev() {
            if !depends[id.index()] {
                continue;
            }
            let Some(&own) = adjoint.get(&id) else { continue };
            for (arg, partial) in self.partials(id) {
                let Some(partial) = partial else { continue };
                if !depends[arg.index()] {
                    continue;
                }
                let term = self.mul(own, partial);
                let sum = match adjoint.get(&arg) {
                    Some(&other) => self.add(other, term),
                    None => term,
                };
                adjoint.insert(arg, sum);
            }
        }
        symbols
            .iter()
            .map(|s| adjoint.get(s).copied().filter(|&d| self.as_constant(d) != Some(0.0)))
            .collect()
    }

    /// Jacobian of several nodes, row by row.
    pub fn jacobian(&mut self, roots: &[Id], symbols: &[Id]) -> Sparse {
        let mut sparse = Sparse::default();
        for (row, &root) in roots.iter().enumerate() {
            for (column, entry) in self.gradient(root, symbols).into_iter().enumerate() {
                if let Some(value) = entry {
                    sparse.rows.push(row);
                    sparse.columns.push(column);
                    sparse.values.push(value);
                }
            }
        }
        sparse
    }

    /// Lower triangle of the Hessian of a node.
    pub fn hessian(&mut self, root: Id, symbols: &[Id]) -> Sparse {
        self.hessian_within(root, symbols, usize::MAX).expect("no more entries than memory holds")
    }

    /// Returns the Hessian, or `None` where it has more entries than `most`.
    pub fn hessian_within(&mut self, root: Id, symbols: &[Id], most: usize) -> Option<Sparse> {
        let mut sparse = Sparse::default();
        let gradient = self.gradient(root, symbols);
        for (row, entry) in gradient.into_iter().enumerate() {
            let Some(slope) = entry else { continue };
            for (column, second) in self.gradient(slope, &symbols[..=row]).into_iter().enumerate() {
                if let Some(value) = second {
                    sparse.rows.push(row);
                    sparse.columns.push(column);
                    sparse.values.push(value);
                }
            }
            if sparse.values.len() > most {
                return None;
            }
        }
        Some(sparse)
    }
}
