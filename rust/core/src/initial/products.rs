//! A place to start from where parameters are multiplied with each other, as an effectiveness and the offset of its input.
//!
//! Regarded as a parameter of its own, each product makes the defects linear, so that least squares give the factors that also stand
//! alone wherever the start is; the other factors follow from these (Bai, Automatica 34(3), 1998). A descent in the factors
//! themselves may lead to infinity instead: an offset that grows while its factor goes to 0 is a constant, which is better than
//! nothing.

use nalgebra::{DMatrix, DVector};

use super::normal::Normal;
use super::regression::{Equations, Regression};
use crate::nlp::Structure;
use crate::solver::Point;

/// Most products: with more of them each costs more than it tells.
const MOST: usize = 60;
/// Part of a column (squared) below which what its products leave of it is rounding.
const ROUNDING: f64 = 1e-20;

/// A product of two free variables, numbered among these.
struct Product {
    factors: [usize; 2],
    /// Its column, as entries with their numbers in the structure of the Jacobian.
    column: Vec<(usize, f64)>,
}

impl Regression<'_> {
    /// Regresses with products as parameters of their own, and goes on from the factors that follow: the place with its
    /// criterion. `None` where there are no products, or it leads nowhere.
    pub(super) fn regress_with_products(&mut self, start: &Point) -> Option<(f64, Point)> {
        self.here.copy(start);
        let place = self.factors().and_then(|()| self.descend()).and_then(|()| self.criterion());
        place.map(|criterion| (criterion, self.here.clone()))
    }

    /// Moves to the factors that the regression with products gives.
    fn factors(&mut self) -> Option<()> {
        let products = self.products()?;
        let (step, alone) = self.step_with_products(&products)?;
        let k = self.free.len();
        let before: Vec<f64> = self.free.iter().map(|&i| self.here.xi[i]).collect();
        self.move_by(&step[..k]);
        // Of two factors that never stand alone the product is known. At 0 neither has influence.
        for (p, product) in products.iter().enumerate() {
            let [i, j] = product.factors;
            let value = before[i].mul_add(before[j], step[k + p]);
            if alone[i] || alone[j] || value == 0.0 {
                continue;
            }
            let (i, j) = (self.free[i], self.free[j]);
            let xi = &mut self.here.xi;
            if xi[i] == 0.0 && xi[j] == 0.0 {
                xi[i] = self.program.within(i, value.abs().sqrt());
            }
            if xi[j] == 0.0 && xi[i] != 0.0 {
                xi[j] = self.program.within(j, value / xi[i]);
            } else if xi[i] == 0.0 && xi[j] != 0.0 {
                xi[i] = self.program.within(i, value / xi[j]);
            }
        }
        self.here.evaluate(self.program).ok()?;
        let weights = self.weights_of_defects();
        let step = self.equations(&weights)?.step_but(&alone)?;
        self.move_by(step.as_slice());
        self.here.evaluate(self.program).ok()
    }

    /// The products of free variables, with their columns in the Jacobian of the constraints, which are differences: exact, since
    /// the Jacobian is linear in each factor.
    fn products(&mut self) -> Option<Vec<Product>> {
        let of = |i: usize| self.place.get(i).copied().filter(|k| *k != usize::MAX);
        let pairs = self.nlp.products();
        let pairs = pairs.iter().filter_map(|(i, j)| Some([of(i.0)?, of(j.0)?]));
        // Few variables are moved where these are the ones in most products.
        let mut pairs: Vec<[usize; 2]> = pairs
            .map(|[i, j]| if self.nonlinear[i] && !self.nonlinear[j] { [j, i] } else { [i, j] })
            .collect();
        if pairs.is_empty() || pairs.len() > MOST {
            return None;
        }
        pairs.sort_unstable_by_key(|p| p[1]);
        self.program.jacobian(&self.here.xi, &mut self.jacobian).ok()?;
        let structure = self.nlp.jacobian_structure();
        let mut moved = vec![0.0; structure.len()];
        let mut products = Vec::with_capacity(pairs.len());
        for group in pairs.chunk_by(|a, b| a[1] == b[1]) {
            let j = self.free[group[0][1]];
            self.trial.xi.copy_from_slice(&self.here.xi);
            let (x, by) = (self.here.xi[j], self.here.xi[j].abs().max(1.0));
            let up = self.program.within(j, x + by);
            self.trial.xi[j] = if up == x { self.program.within(j, x - by) } else { up };
            let by = self.trial.xi[j] - x;
            if by == 0.0 {
                return None;
            }
            self.program.jacobian(&self.trial.xi, &mut moved).ok()?;
            for &factors in group {
                let i = self.free[factors[0]];
                let entries = structure.columns.iter().enumerate().filter(|(_, c)| **c as usize == i);
                let column = entries.map(|(t, _)| (t, (moved[t] - self.jacobian[t]) / by));
                products.push(Product { factors, column: column.filter(|entry| entry.1 != 0.0).collect() });
            }
        }
        Some(products)
    }

    /// The step of the free variables and of the products, and which variables have a column of their own beside those of
    /// their products. The others stay where they are.
    fn step_with_products(&mut self, products: &[Product]) -> Option<(Vec<f64>, Vec<bool>)> {
        let (k, n) = (self.free.len(), self.nlp.n());
        let all = k + products.len();
        let rows = self.program.units.rows;
        let weights = self.weights_of_defects();
        let structure = self.nlp.jacobian_structure();
        // The matrix with a column more for each product; entries of a row stay near each other.
        let mut further: Vec<(usize, usize, f64)> = Vec::new();
        for (p, product) in products.iter().enumerate() {
            further.extend(product.column.iter().map(|&(t, v)| (t, p, v)));
        }
        further.sort_unstable_by_key(|entry| (entry.0, entry.1));
        let mut further = further.into_iter().peekable();
        let (mut wide, mut values) = (Structure::default(), Vec::new());
        let mut before = vec![0.0; k];
        for (t, (&row, &column)) in structure.rows.iter().zip(&structure.columns).enumerate() {
            if row as usize >= rows {
                continue;
            }
            let Some(&of) = self.place.get(column as usize).filter(|of| **of != usize::MAX) else { continue };
            let mut put = |column: u32, value: f64| {
                wide.rows.push(row);
                wide.columns.push(column);
                values.push(value);
            };
            put(column, self.jacobian[t]);
            before[of] += weights[row as usize % weights.len()] * self.jacobian[t] * self.jacobian[t];
            while let Some((_, p, value)) = further.next_if(|entry| entry.0 == t) {
                let [i, j] = products[p].factors.map(|of| self.free[of]);
                put((n + p) as u32, value);
                put(i as u32, -value * self.here.xi[j]);
                put(j as u32, -value * self.here.xi[i]);
            }
        }
        let mut place = self.place.clone();
        place.resize(n, usize::MAX);
        place.extend(k..all);
        let mut normal = Normal::new(&wide, &place, all, rows);
        normal.sum(&wide, &values, &place, &self.here.c, &weights)?;
        let a = DMatrix::from_fn(all, all, |i, j| if j <= i { normal.square(i, j) } else { 0.0 });
        let b = DVector::from_fn(all, |i, _| -normal.right(i));
        let alone: Vec<bool> = (0..k).map(|i| a[(i, i)] > ROUNDING * before[i]).collect();
        let held: Vec<bool> = (0..all).map(|i| i < k && !alone[i]).collect();
        let step = Equations::new(a, b).step_but(&held)?;
        Some((step.as_slice().to_vec(), alone))
    }
}
