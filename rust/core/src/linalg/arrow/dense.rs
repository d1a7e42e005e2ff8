//! Small dense matrices, row-major with a stride, and rows of whole vectors.

use crate::interrupt::current;

/// to += a · from. `V` is the number of vectors of eight where it is known (the loop is then unrolled),
/// else 0.
#[inline(always)]
pub(super) fn axpy<const V: usize>(to: &mut [f64], a: f64, from: &[f64]) {
    if V > 0 {
        let to: &mut [[f64; 8]; V] = to.as_chunks_mut().0.first_chunk_mut().expect("V vectors");
        let from: &[[f64; 8]; V] = from.as_chunks().0.first_chunk().expect("V vectors");
        for (t, f) in to.iter_mut().zip(from) {
            *t = std::array::from_fn(|l| a.mul_add(f[l], t[l]));
        }
    } else {
        for (t, f) in to.iter_mut().zip(from) {
            *t = a.mul_add(*f, *t);
        }
    }
}

/// to = mask · from + Σ_r factor_r · row_r, rows `stride` apart: where its length is known the sum stays in
/// registers, and nothing is copied by a call.
#[inline(always)]
pub(super) fn sum_rows<const V: usize>(
    to: &mut [f64],
    (mask, from): (&[f64], &[f64]),
    factors: &[f64],
    rows: &[f64],
    stride: usize,
) {
    if V > 0 {
        let mask: &[[f64; 8]; V] = mask.as_chunks().0.first_chunk().expect("V vectors");
        let from: &[[f64; 8]; V] = from.as_chunks().0.first_chunk().expect("V vectors");
        let to: &mut [[f64; 8]; V] = to.as_chunks_mut().0.first_chunk_mut().expect("V vectors");
        let mut sum: [[f64; 8]; V] =
            std::array::from_fn(|v| std::array::from_fn(|l| mask[v][l] * from[v][l]));
        // Not a chain of iterators: their state would go through memory, which costs more than the sums.
        for r in 0..factors.len() {
            let row: &[[f64; 8]; V] = rows[r * stride..].as_chunks().0.first_chunk().expect("V vectors");
            for (s, x) in sum.iter_mut().zip(row) {
                *s = std::array::from_fn(|l| factors[r].mul_add(x[l], s[l]));
            }
        }
        *to = sum;
    } else {
        to.iter_mut().zip(mask).zip(from).for_each(|((t, m), f)| *t = m * f);
        for (r, a) in factors.iter().enumerate() {
            axpy::<0>(to, *a, &rows[r * stride..][..to.len()]);
        }
    }
}

/// Copies rows of V vectors, with strides of their own.
#[inline(always)]
pub(super) fn copy_rows<const V: usize>(to: &mut [f64], width: usize, from: &[f64], stride: usize) {
    for (to, from) in to.chunks_exact_mut(width).zip(from.chunks(stride)) {
        if V > 0 {
            let to: &mut [[f64; 8]; V] = to.as_chunks_mut().0.first_chunk_mut().expect("V vectors");
            *to = *from.as_chunks().0.first_chunk().expect("V vectors");
        } else {
            to.copy_from_slice(&from[..width]);
        }
    }
}

/// Calls a function for the number of vectors at hand, known to the compiler where it is small.
macro_rules! for_vectors {
    ($count:expr, $function:ident($($argument:expr),* $(,)?)) => {
        match $count {
            1 => $function::<1>($($argument),*),
            2 => $function::<2>($($argument),*),
            3 => $function::<3>($($argument),*),
            4 => $function::<4>($($argument),*),
            5 => $function::<5>($($argument),*),
            _ => $function::<0>($($argument),*),
        }
    };
}
pub(super) use for_vectors;

/// Σ a·b over whole vectors of eight, in a fixed order.
#[inline(always)]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sum = [0.0; 8];
    for (&a, &b) in a.as_chunks::<8>().0.iter().zip(b.as_chunks::<8>().0) {
        sum = std::array::from_fn(|l| a[l].mul_add(b[l], sum[l]));
    }
    let [a, b, c, d, e, f, g, h] = sum;
    ((a + e) + (b + f)) + ((c + g) + (d + h))
}

/// Σ a·b over rows of any length, in a fixed order. Outside of kernels a fused product would be a call.
pub(super) fn dot_of(a: &[f64], b: &[f64]) -> f64 {
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
pub(super) fn triangularise(a: &mut [f64], rows: usize, columns: usize, k: usize, q: Option<&mut [f64]>) {
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

/// Cholesky's factor L in the lower triangle, for a matrix with unit-like diagonal; the index at which
/// a pivot falls to `tiny` or below, or at which the interrupt in force stops it.
pub(crate) fn cholesky(a: &mut [f64], n: usize, tiny: f64) -> Result<(), usize> {
    let interrupt = current();
    for j in 0..n {
        if j % 32 == 31 && interrupt.stops() {
            return Err(j);
        }
        let (above, rest) = a.split_at_mut(j * n);
        let row = &mut rest[..n];
        for k in 0..j {
            let other = &above[k * n..k * n + k];
            let sum: f64 = row[..k].iter().zip(other).map(|(x, y)| x * y).sum();
            row[k] = (row[k] - sum) / above[k * n + k];
        }
        let pivot = row[j] - row[..j].iter().map(|x| x * x).sum::<f64>();
        if pivot.is_nan() || pivot <= tiny {
            return Err(j);
        }
        row[j] = pivot.sqrt();
    }
    Ok(())
}

/// Solves L x = b in place.
pub(crate) fn forward(l: &[f64], n: usize, b: &mut [f64]) {
    for i in 0..n {
        let sum: f64 = l[i * n..i * n + i].iter().zip(&b[..i]).map(|(x, y)| x * y).sum();
        b[i] = (b[i] - sum) / l[i * n + i];
    }
}

/// Solves Lᵀ x = b in place.
pub(crate) fn backward(l: &[f64], n: usize, b: &mut [f64]) {
    for i in (0..n).rev() {
        b[i] /= l[i * n + i];
        for k in 0..i {
            b[k] -= l[i * n + k] * b[i];
        }
    }
}
