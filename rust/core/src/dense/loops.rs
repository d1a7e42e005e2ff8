//! Loops over small dense matrices.

use crate::simd::kernel;

/// Σ a·b over rows of any length, in a fixed order. Outside of kernels a fused product would be a call.
#[inline]
pub fn dot_of(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = [0.0; 8];
    let (a, b) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    for (a, b) in a.0.iter().zip(b.0) {
        for l in 0..8 {
            sum[l] += a[l] * b[l];
        }
    }
    let tail: f64 = a.1.iter().zip(b.1).map(|(a, b)| a * b).sum();
    sum.iter().sum::<f64>() + tail
}

/// Householder's QR of the first `k` columns of a (rows × columns); the reflections are applied to the
/// other columns, and to `q` (rows × rows) if given, which then becomes Qᵀ q. R stands in the upper
/// triangle, zeros below it.
pub fn triangularise(a: &mut [f64], rows: usize, columns: usize, k: usize, q: Option<&mut [f64]>) {
    let mut q = q;
    let mut v = [0.0; 64];
    let mut long = Vec::new(); // for more than 32 states only
    let v: &mut [f64] = if rows <= v.len() {
        &mut v[..rows]
    } else {
        long.resize(rows, 0.0);
        &mut long
    };
    for j in 0..k {
        for (i, v) in v.iter_mut().enumerate().skip(j) {
            *v = a[i * columns + j];
        }
        let norm = v[j..].iter().map(|x| x * x).sum::<f64>().sqrt();
        if norm == 0.0 {
            continue;
        }
        let head = if v[j] > 0.0 { -norm } else { norm };
        v[j] -= head;
        let square: f64 = v[j..].iter().map(|x| x * x).sum();
        let reflect = |a: &mut [f64], stride: usize, first: usize| {
            for c in first..stride {
                let along: f64 = (j..rows).map(|i| v[i] * a[i * stride + c]).sum();
                let factor = 2.0 * along / square;
                (j..rows).for_each(|i| a[i * stride + c] -= factor * v[i]);
            }
        };
        reflect(a, columns, j + 1);
        if let Some(q) = q.as_deref_mut() {
            reflect(q, rows, 0);
        }
        a[j * columns + j] = head;
        (j + 1..rows).for_each(|i| a[i * columns + j] = 0.0);
    }
}

/// Does what [`cholesky`](super::cholesky) does, by loops whatever the size.
pub fn by_loops(a: &mut [f64], n: usize, least: impl Fn(f64) -> f64) -> Result<(), usize> {
    for j in 0..n {
        let (above, rest) = a.split_at_mut(j * n);
        let row = &mut rest[..n];
        for k in 0..j {
            let sum = dot(&row[..k], &above[k * n..k * n + k]);
            row[k] = (row[k] - sum) / above[k * n + k];
        }
        let pivot = row[j] - dot(&row[..j], &row[..j]);
        if pivot.is_nan() || pivot <= least(row[j]) {
            return Err(j);
        }
        row[j] = pivot.sqrt();
    }
    Ok(())
}

/// The least pivot that is more than rounding leaves of a diagonal entry.
pub fn rounding(diagonal: f64) -> f64 {
    1e-15 * diagonal.abs()
}

/// Solves L x = b in place.
pub fn forward(l: &[f64], n: usize, b: &mut [f64]) {
    for i in 0..n {
        let sum: f64 = l[i * n..i * n + i].iter().zip(&b[..i]).map(|(x, y)| x * y).sum();
        b[i] = (b[i] - sum) / l[i * n + i];
    }
}

/// Solves Lᵀ x = b in place.
pub fn backward(l: &[f64], n: usize, b: &mut [f64]) {
    for i in (0..n).rev() {
        b[i] /= l[i * n + i];
        for k in 0..i {
            b[k] -= l[i * n + k] * b[i];
        }
    }
}

/// out = a b, with a (m, k) and b (k, n).
pub fn product(out: &mut [f64], a: &[f64], b: &[f64], [m, k, n]: [usize; 3]) {
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
pub fn add_transposed_product(out: &mut [f64], a: &[f64], b: &[f64], [m, k, n]: [usize; 3]) {
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
pub fn product_transposed(out: &mut [f64], a: &[f64], b: &[f64], [m, k, n]: [usize; 3]) {
    for i in 0..m {
        for j in 0..n {
            out[i * n + j] = dot(&a[i * k..(i + 1) * k], &b[j * k..(j + 1) * k]);
        }
    }
}

/// The inner product.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Returns the largest magnitude of some numbers: 0 without any, infinity where one is NaN.
pub fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    let larger = |a: f64, b: f64| if b.is_nan() { f64::INFINITY } else { a.max(b.abs()) };
    values.into_iter().fold(0.0, larger)
}

/// Makes a square matrix symmetric, which rounding has made it not quite.
pub fn symmetrise(a: &mut [f64], n: usize) {
    for i in 0..n {
        for j in 0..i {
            let mean = 0.5 * (a[i * n + j] + a[j * n + i]);
            (a[i * n + j], a[j * n + i]) = (mean, mean);
        }
    }
}

/// Solves C Cᵀ X = B in place, B (n, columns).
pub fn solve(c: &[f64], b: &mut [f64], n: usize, columns: usize) {
    for i in 0..n {
        for j in 0..i {
            let factor = c[i * n + j];
            let (above, row) = b.split_at_mut(i * columns);
            axpy(&mut row[..columns], -factor, &above[j * columns..(j + 1) * columns]);
        }
        b[i * columns..(i + 1) * columns].iter_mut().for_each(|v| *v /= c[i * n + i]);
    }
    for i in (0..n).rev() {
        for j in i + 1..n {
            let factor = c[j * n + i];
            let (above, below) = b.split_at_mut(j * columns);
            axpy(&mut above[i * columns..(i + 1) * columns], -factor, &below[..columns]);
        }
        b[i * columns..(i + 1) * columns].iter_mut().for_each(|v| *v /= c[i * n + i]);
    }
}

/// Adds a times `from`.
#[inline]
pub fn axpy(to: &mut [f64], a: f64, from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(t, f)| *t += a * f);
}

kernel! {
    /// Does what [`inverse_of_first`](super::inverse_of_first) does, by loops whatever the size, for zeros (k, k).
    pub fn inverse_by_loops(factor: &[f64], m: usize, inverse: &mut [f64], k: usize) {
        let mut root = vec![0.0; k * k]; // the inverse of L
        for i in 0..k {
            let (above, rest) = root.split_at_mut(i * k);
            let row = &mut rest[..=i];
            for (j, other) in above.chunks_exact(k).enumerate() {
                let factor = factor[i * m + j];
                row.iter_mut().zip(&other[..=j]).for_each(|(r, o)| *r -= factor * o);
            }
            row[i] = 1.0;
            row.iter_mut().for_each(|r| *r /= factor[i * m + i]);
        }
        for row in 0..k {
            for i in 0..=row {
                let factor = root[row * k + i];
                let (to, from) = (&mut inverse[i * k..][..=row], &root[row * k..][..=row]);
                to.iter_mut().zip(from).for_each(|(t, f)| *t += factor * f);
            }
        }
    }
}

/// ln det C Cᵀ.
pub fn log_det(c: &[f64], n: usize) -> f64 {
    (0..n).map(|i| 2.0 * c[i * n + i].ln()).sum()
}

/// Place of an entry of a symmetric matrix among those of its lower triangle.
pub fn place(i: usize, j: usize) -> usize {
    let (row, column) = (i.max(j), i.min(j));
    row * (row + 1) / 2 + column
}

/// The lower triangle of a matrix, row by row.
pub fn lower(w: &[f64], n: usize) -> impl Iterator<Item = f64> + '_ {
    (0..n).flat_map(move |i| w[i * n..=i * n + i].iter().copied())
}

kernel! {
    /// Factorises A, n × n and row-major, by elimination with row exchanges: U stands in the upper triangle, the multipliers of L
    /// below it, and `pivots` says which row each column was exchanged with. Whether A is regular.
    pub fn factorise(a: &mut [f64], pivots: &mut [u32]) -> bool {
        let n = pivots.len();
        for k in 0..n {
            let mut pivot = k;
            for i in k + 1..n {
                if a[i * n + k].abs() > a[pivot * n + k].abs() {
                    pivot = i;
                }
            }
            let size = a[pivot * n + k].abs();
            if !(size > 0.0 && size.is_finite()) {
                return false;
            }
            pivots[k] = pivot as u32;
            if pivot != k {
                (0..n).for_each(|j| a.swap(pivot * n + j, k * n + j));
            }
            let (above, below) = a.split_at_mut((k + 1) * n);
            let row = &above[k * n..];
            for to in below.chunks_exact_mut(n) {
                let part = to[k] / row[k];
                to[k] = part;
                if part != 0.0 {
                    to[k + 1..].iter_mut().zip(&row[k + 1..]).for_each(|(t, r)| *t -= part * r);
                }
            }
        }
        true
    }
}

kernel! {
    /// Solves A X = B in place with the factors of [`factorise`], B row-major with so many columns. Whether X is finite.
    pub fn solve_factorised(a: &[f64], pivots: &[u32], b: &mut [f64], width: usize) -> bool {
        let n = pivots.len();
        for (k, &pivot) in pivots.iter().enumerate() {
            if pivot as usize != k {
                (0..width).for_each(|j| b.swap(pivot as usize * width + j, k * width + j));
            }
        }
        if width == 1 {
            for i in 1..n {
                b[i] -= dot_of(&a[i * n..i * n + i], &b[..i]);
            }
            for k in (0..n).rev() {
                b[k] = (b[k] - dot_of(&a[k * n + k + 1..(k + 1) * n], &b[k + 1..])) / a[k * n + k];
            }
            return b.iter().all(|x| x.is_finite());
        }
        for i in 1..n {
            let (above, below) = b.split_at_mut(i * width);
            let to = &mut below[..width];
            for (part, x) in a[i * n..i * n + i].iter().zip(above.chunks_exact(width)).filter(|p| *p.0 != 0.0) {
                to.iter_mut().zip(x).for_each(|(t, x)| *t -= part * x);
            }
        }
        for k in (0..n).rev() {
            let (above, below) = b.split_at_mut((k + 1) * width);
            let to = &mut above[k * width..];
            let row = &a[k * n + k + 1..(k + 1) * n];
            for (from, x) in row.iter().zip(below.chunks_exact(width)).filter(|p| *p.0 != 0.0) {
                to.iter_mut().zip(x).for_each(|(t, x)| *t -= from * x);
            }
            to.iter_mut().for_each(|t| *t /= a[k * n + k]);
        }
        b.iter().all(|x| x.is_finite())
    }
}

kernel! {
    /// Solves Aᵀ x = b in place with the factors of [`factorise`]. Whether x is finite.
    pub fn solve_factorised_transposed(a: &[f64], pivots: &[u32], b: &mut [f64]) -> bool {
        let n = pivots.len();
        for k in 0..n {
            b[k] /= a[k * n + k];
            let (x, rest) = (b[k], &mut b[k + 1..]);
            rest.iter_mut().zip(&a[k * n + k + 1..(k + 1) * n]).for_each(|(t, u)| *t -= u * x);
        }
        for k in (1..n).rev() {
            let x = b[k];
            b[..k].iter_mut().zip(&a[k * n..k * n + k]).for_each(|(t, l)| *t -= l * x);
        }
        for (k, &pivot) in pivots.iter().enumerate().rev() {
            b.swap(k, pivot as usize);
        }
        b.iter().all(|x| x.is_finite())
    }
}
