//! The blocks of a program: equations that determine as many states, in the order in which these follow from each other.

use std::ops::Range;

use crate::dense::factorise;
use crate::nlp::{Chains, Nlp};

/// An entry of the Jacobian in the equations of a block.
#[derive(Clone, Copy)]
pub(super) struct BlockEntry {
    /// Its number among all entries.
    pub entry: usize,
    /// Its row within the block.
    pub row: usize,
    /// Its column: within the block where the block determines it, else among all variables.
    pub column: usize,
}

/// Equations that determine as many variables.
pub(super) struct Block {
    pub chain: usize,
    pub rows: Vec<usize>,
    pub columns: Vec<usize>,
    /// Entries in columns that it determines.
    pub own: Vec<BlockEntry>,
    /// Entries in columns that another block determines.
    pub others: Vec<BlockEntry>,
    /// Entries in columns that no block determines.
    pub free: Vec<BlockEntry>,
    /// The states of the point before, which the block starts from; none of the first.
    pub before: Option<usize>,
    /// Where its factor and its pivots begin.
    pub factor: usize,
    pub pivots: usize,
}

impl Block {
    fn new(chain: usize, rows: Range<usize>, columns: Vec<usize>, before: Option<usize>) -> Block {
        let (own, others, free) = (Vec::new(), Vec::new(), Vec::new());
        Block { chain, rows: rows.collect(), columns, own, others, free, before, factor: 0, pivots: 0 }
    }

    /// Factorises its square of the Jacobian; whether that is regular.
    pub fn factorise(&self, jacobian: &[f64], factor: &mut [f64], pivots: &mut [u32]) -> bool {
        let n = self.rows.len();
        factor.fill(0.0);
        for &BlockEntry { entry, row: r, column: c } in &self.own {
            factor[r * n + c] += jacobian[entry];
        }
        factorise(factor, pivots)
    }
}

/// Rows that may depend, of all states, on the first ones alone, and these.
type Condition = (Range<usize>, Range<usize>);

/// Returns the blocks of a program, in the order in which they are solved; `None` where its states do not follow from
/// parameters and initial states.
pub(super) fn blocks_of(nlp: &dyn Nlp) -> Option<Vec<Block>> {
    let chains = nlp.chains()?;
    let (mut blocks, conditions) = along(chains)?;
    distribute(nlp, chains.border, &conditions, &mut blocks)?;
    let (mut entries, mut rows) = (0, 0);
    for block in &mut blocks {
        (block.factor, block.pivots) = (entries, rows);
        entries += block.rows.len() * block.rows.len();
        rows += block.rows.len();
    }
    Some(blocks)
}

/// Returns the blocks of all chains without their entries: conditions on initial states, segments and what ties these.
fn along(chains: &Chains) -> Option<(Vec<Block>, Vec<Condition>)> {
    let n_x = chains.n_x;
    let mut blocks: Vec<Block> = Vec::new();
    let mut conditions = Vec::new();
    for (e, chain) in chains.chains.iter().enumerate() {
        let (row, states) = (chain.boundary.row.0, &chain.boundary.states);
        if !states.is_empty() {
            let columns: Vec<usize> = states.iter().map(|s| (chain.variable + s.0).0).collect();
            let once = (0..columns.len()).all(|i| !columns[..i].contains(&columns[i]));
            if !once {
                return None;
            }
            let first = chain.variable.0;
            conditions.push((row..row + states.len(), first..first + n_x));
            blocks.push(Block::new(e, row..row + states.len(), columns, None));
        }
        let size = chain.points * n_x;
        let mut ties = chain.ties.iter().peekable();
        for s in 0..chain.segments {
            let (row, variable) = (chain.row.0 + s * size, chain.variable.0 + n_x + s * size);
            let own = row..row + size;
            blocks.push(Block::new(e, own, (variable..variable + size).collect(), Some(variable - n_x)));
            while let Some(tie) = ties.next_if(|t| t.segment == s) {
                let (row, first) = (tie.row.0, tie.variable.0);
                let columns = (first..first + n_x).collect();
                blocks.push(Block::new(e, row..row + n_x, columns, Some(variable - n_x)));
            }
        }
    }
    Some((blocks, conditions))
}

/// Gives each block the entries of the Jacobian in its rows.
fn distribute(nlp: &dyn Nlp, border: usize, conditions: &[Condition], blocks: &mut [Block]) -> Option<()> {
    let (mut of_row, mut of_column) = (vec![None; nlp.m()], vec![None; nlp.n()]);
    for (number, b) in blocks.iter().enumerate() {
        b.rows.iter().enumerate().for_each(|(i, &r)| of_row[r] = Some((number, i)));
        b.columns.iter().enumerate().for_each(|(i, &c)| of_column[c] = Some((number, i)));
    }
    let structure = nlp.jacobian_structure();
    for (k, (&row, &column)) in structure.rows.iter().zip(&structure.columns).enumerate() {
        let (row, column) = (row as usize, column as usize);
        let on_ends = conditions.iter().find(|c| c.0.contains(&row));
        if on_ends.is_some_and(|c| column >= border && !c.1.contains(&column)) {
            return None;
        }
        let (number, r) = of_row[row]?;
        match of_column[column] {
            Some((of, c)) if of == number => {
                blocks[number].own.push(BlockEntry { entry: k, row: r, column: c })
            }
            Some(_) => blocks[number].others.push(BlockEntry { entry: k, row: r, column }),
            None => blocks[number].free.push(BlockEntry { entry: k, row: r, column }),
        }
    }
    Some(())
}
