//! ZᵀHZ and Zᵀ D Z, put together.

use super::basis::{Basis, axpy};
use super::rows::Rows;
use crate::dense::large;
use crate::simd::kernel;

/// Rows of Z that are multiplied at once.
const PANEL: usize = 96;

/// Symmetric matrices over the free variables, column-major, their lower triangles.
#[derive(Debug, Default)]
pub(super) struct Products {
    k: usize,
    stride: usize,
    hessian: Vec<f64>,
    shift: Vec<f64>,
    has_shift: bool,
    /// Σ |H_ii| z_ij², for each free variable j: its curvature if nothing cancelled.
    size: Vec<f64>,
    /// The greatest entry of H.
    largest: f64,
    /// Some rows of Z, and of HZ or D Z.
    panels: (Vec<f64>, Vec<f64>),
    /// H between free variables and the basis, times Z.
    mixed: Vec<f64>,
    operations: u64,
}

impl Products {
    /// Counted floating-point operations of the last [`Products::assemble`].
    pub fn operations(&self) -> u64 {
        self.operations
    }

    /// The greatest entry of H.
    pub fn largest(&self) -> f64 {
        self.largest
    }

    /// Entry of Zᵀ(H + shift D)Z.
    #[inline(always)]
    pub fn entry(&self, i: usize, j: usize, shift: f64) -> f64 {
        let at = i.min(j) * self.stride + i.max(j);
        self.hessian[at] + if shift > 0.0 { shift * self.shift[at] } else { 0.0 }
    }

    /// Returns the diagonal of Zᵀ(H + shift D)Z if nothing cancelled.
    pub fn size(&self, j: usize, shift: f64) -> f64 {
        self.size[j] + if shift > 0.0 { shift * self.shift[j * self.stride + j] } else { 0.0 }
    }

    /// ZᵀHZ from H, both triangles.
    pub fn assemble(&mut self, h: &Rows, basis: &Basis) {
        let k = basis.free().len();
        (self.k, self.stride) = (k, basis.stride());
        self.has_shift = false;
        for all in [&mut self.hessian, &mut self.shift, &mut self.mixed] {
            all.clear();
            all.resize(k * self.stride, 0.0);
        }
        self.size.clear();
        self.size.resize(self.stride, 0.0);
        self.largest = h.values().iter().fold(0.0f64, |a, v| a.max(v.abs()));
        self.panels.0.resize(PANEL * self.stride, 0.0);
        self.panels.1.resize(PANEL * self.stride, 0.0);
        products(self, h, basis);
        // H between free and other variables counts twice, as two triangles.
        for j in 0..k {
            for i in j..k {
                let both = self.mixed[i * self.stride + j] + self.mixed[j * self.stride + i];
                self.hessian[j * self.stride + i] += both;
            }
        }
        for (i, &v) in basis.free().iter().enumerate() {
            for (w, value) in h.row(v as usize) {
                if let Err(j) = basis.place(w)
                    && j <= i
                {
                    self.hessian[j * self.stride + i] += value;
                    self.size[i] += if i == j { value.abs() } else { 0.0 };
                }
            }
        }
    }

    /// Zᵀ D Z, D diagonal, if it is not there.
    pub fn assemble_shift(&mut self, d: &[f64], basis: &Basis) {
        if self.has_shift {
            return;
        }
        weighted_squares(self, d, basis);
        for (i, &v) in basis.free().iter().enumerate() {
            self.shift[i * self.stride + i] += d[v as usize];
        }
        self.has_shift = true;
    }
}

/// Adds the product of the first rows of two panels, AᵀB, of which only the lower triangle is wanted.
fn multiply(to: &mut [f64], k: usize, stride: usize, panels: &(Vec<f64>, Vec<f64>), rows: usize) {
    if rows == 0 || k == 0 {
        return;
    }
    large::add_lower_product(to, &panels.0, &panels.1, [k, stride, rows]);
}

kernel! {
    /// Parts of ZᵀHZ that come from the basis: with itself, and with free variables.
    fn products(r: &mut Products, h: &Rows, basis: &Basis) {
        let (k, stride) = (r.k, r.stride);
        let mut rows = 0;
        r.operations = 0;
        for (j, &v) in basis.pivots().iter().enumerate() {
            let z = basis.z(j);
            let product = &mut r.panels.1[rows * stride..(rows + 1) * stride];
            product.fill(0.0);
            let mut any = false;
            for (w, value) in h.row(v as usize) {
                if value == 0.0 {
                    continue;
                }
                match basis.place(w) {
                    Ok(other) => {
                        axpy(product, value, basis.z(other));
                        any = true;
                    }
                    Err(column) => axpy(&mut r.mixed[column * stride..(column + 1) * stride], value, z),
                }
                if w == v as usize {
                    for (size, z) in r.size.iter_mut().zip(z) {
                        *size += value.abs() * z * z;
                    }
                }
                r.operations += 2 * k as u64;
            }
            // Points between samples have no part in the likelihood.
            if any {
                r.panels.0[rows * stride..(rows + 1) * stride].copy_from_slice(z);
                r.operations += (k * k) as u64;
                rows += 1;
            }
            if rows == PANEL {
                multiply(&mut r.hessian, k, stride, &r.panels, rows);
                rows = 0;
            }
        }
        multiply(&mut r.hessian, k, stride, &r.panels, rows);
    }
}

kernel! {
    /// The part of Zᵀ D Z that comes from the basis.
    fn weighted_squares(r: &mut Products, d: &[f64], basis: &Basis) {
        let stride = r.stride;
        for (number, pivots) in basis.pivots().chunks(PANEL).enumerate() {
            let to = r.panels.0.chunks_exact_mut(stride.max(1)).zip(r.panels.1.chunks_exact_mut(stride.max(1)));
            for ((j, &v), (plain, weighted)) in pivots.iter().enumerate().zip(to) {
                let z = basis.z(number * PANEL + j);
                plain.copy_from_slice(z);
                weighted.iter_mut().zip(z).for_each(|(to, z)| *to = d[v as usize] * z);
            }
            multiply(&mut r.shift, r.k, stride, &r.panels, pivots.len());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::multiply;

    /// faer 0.24.4 writes the other triangle of a row-major matrix, so this is not taken for granted.
    #[test]
    fn products_are_added_to_the_lower_triangle() {
        for k in 1..50usize {
            for rows in [1, 2, 7, 96] {
                let stride = k.next_multiple_of(8);
                let entry =
                    |i: usize, j: usize, of: usize| if j < k { ((i * 7 + j * of) % 11) as f64 } else { 0.0 };
                let panel = |of| (0..rows * stride).map(|at| entry(at / stride, at % stride, of)).collect();
                let mut to = vec![1.0; k * stride];
                multiply(&mut to, k, stride, &(panel(3), panel(5)), rows);
                for i in 0..k {
                    for j in 0..=i {
                        let sum: f64 = (0..rows).map(|r| entry(r, i, 3) * entry(r, j, 5)).sum();
                        assert_eq!(to[j * stride + i], 1.0 + sum, "{i}, {j} of {k}, {rows} rows");
                    }
                }
            }
        }
    }
}
