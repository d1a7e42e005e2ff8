//! Small dense matrices, row by row in slices: what one interval needs.

/// out = a b, with a (m, k) and b (k, n).
pub(super) fn product(out: &mut [f64], a: &[f64], b: &[f64], [m, k, n]: [usize; 3]) {
    out[..m * n].fill(0.0);
    for i in 0..m {
        for l in 0..k {
            let factor = a[i * k + l];
            for (o, b) in out[i * n..(i + 1) * n].iter_mut().zip(&b[l * n..(l + 1) * n]) {
                *o += factor * b;
            }
        }
    }
}

/// out += aᵀ b, with a (k, m) and b (k, n).
pub(super) fn add_transposed_product(out: &mut [f64], a: &[f64], b: &[f64], [m, k, n]: [usize; 3]) {
    for l in 0..k {
        for i in 0..m {
            let factor = a[l * m + i];
            for (o, b) in out[i * n..(i + 1) * n].iter_mut().zip(&b[l * n..(l + 1) * n]) {
                *o += factor * b;
            }
        }
    }
}

/// out = a bᵀ, with a (m, k) and b (n, k).
pub(super) fn product_transposed(out: &mut [f64], a: &[f64], b: &[f64], [m, k, n]: [usize; 3]) {
    for i in 0..m {
        for j in 0..n {
            out[i * n + j] = dot(&a[i * k..(i + 1) * k], &b[j * k..(j + 1) * k]);
        }
    }
}

/// The inner product.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Makes a square matrix symmetric, which rounding has made it not quite.
pub(super) fn symmetrise(a: &mut [f64], n: usize) {
    for i in 0..n {
        for j in 0..i {
            let mean = 0.5 * (a[i * n + j] + a[j * n + i]);
            (a[i * n + j], a[j * n + i]) = (mean, mean);
        }
    }
}

/// The factor C of a = C Cᵀ, in the lower triangle of `a`; the first column without a positive pivot where
/// there is one.
pub(super) fn cholesky(a: &mut [f64], n: usize) -> Result<(), usize> {
    for j in 0..n {
        let pivot = a[j * n + j] - dot(&a[j * n..j * n + j], &a[j * n..j * n + j]);
        // Less than rounding leaves of the diagonal is nothing.
        if pivot.is_nan() || pivot <= 1e-15 * a[j * n + j].abs() {
            return Err(j);
        }
        let root = pivot.sqrt();
        a[j * n + j] = root;
        for i in j + 1..n {
            let (above, row) = a.split_at(i * n);
            let rest = row[j] - dot(&row[..j], &above[j * n..j * n + j]);
            a[i * n + j] = rest / root;
        }
    }
    Ok(())
}

/// Solves C Cᵀ X = B in place, B (n, columns).
pub(super) fn solve(c: &[f64], b: &mut [f64], n: usize, columns: usize) {
    for i in 0..n {
        for j in 0..i {
            let factor = c[i * n + j];
            let (above, row) = b.split_at_mut(i * columns);
            subtract(&mut row[..columns], factor, &above[j * columns..(j + 1) * columns]);
        }
        b[i * columns..(i + 1) * columns].iter_mut().for_each(|v| *v /= c[i * n + i]);
    }
    for i in (0..n).rev() {
        for j in i + 1..n {
            let factor = c[j * n + i];
            let (above, below) = b.split_at_mut(j * columns);
            subtract(&mut above[i * columns..(i + 1) * columns], factor, &below[..columns]);
        }
        b[i * columns..(i + 1) * columns].iter_mut().for_each(|v| *v /= c[i * n + i]);
    }
}

fn subtract(row: &mut [f64], factor: f64, other: &[f64]) {
    row.iter_mut().zip(other).for_each(|(r, o)| *r -= factor * o);
}

/// The inverse of C Cᵀ.
pub(super) fn inverse(c: &[f64], n: usize) -> Vec<f64> {
    let mut out = vec![0.0; n * n];
    (0..n).for_each(|i| out[i * n + i] = 1.0);
    solve(c, &mut out, n, n);
    symmetrise(&mut out, n);
    out
}

/// ln det C Cᵀ.
pub(super) fn log_det(c: &[f64], n: usize) -> f64 {
    (0..n).map(|i| 2.0 * c[i * n + i].ln()).sum()
}

/// Place of an entry of a symmetric matrix among those of its lower triangle.
pub(super) fn place(i: usize, j: usize) -> usize {
    let (row, column) = (i.max(j), i.min(j));
    row * (row + 1) / 2 + column
}

/// The lower triangle of a matrix, row by row.
pub(super) fn lower(w: &[f64], n: usize) -> impl Iterator<Item = f64> + '_ {
    (0..n).flat_map(move |i| w[i * n..=i * n + i].iter().copied())
}
