//! LU with row exchanges of the square of a segment, its ties along.

use super::vectors::axpy;

#[inline(always)]
fn larger(x: f64, i: usize, best: &mut usize, size: &mut f64) {
    if x.abs() > *size {
        (*best, *size) = (i, x.abs());
    }
}

/// Row and size of the largest entry of the first column. Kept out of the kernel: for a handful of rows
/// the compiler makes thousands of vector instructions of it.
#[inline(never)]
fn first_pivot(panel: &[f64], length: usize, d: usize) -> (usize, f64) {
    let (mut best, mut size) = (0, 0.0);
    for i in 0..d {
        larger(panel[i * length], i, &mut best, &mut size);
    }
    (best, size)
}

/// Exchanges the first entries of two rows. Rare, and kept out of the kernel for the same reason.
#[cold]
#[inline(never)]
fn exchange(a: &mut [f64], stride: usize, count: usize, k: usize, i: usize) {
    let (low, high) = a.split_at_mut(i * stride);
    low[k * stride..k * stride + count].swap_with_slice(&mut high[..count]);
}

/// LU with row exchanges of the first d of `rows` rows of M, the rows after them (ties) eliminated
/// along; then M⁻¹ e in place of e, in a panel of rows [M, e]. The column that has no pivot where M is
/// singular.
#[inline(always)]
pub(super) fn eliminate<const V: usize>(
    panel: &mut [f64],
    d: usize,
    width: usize,
    lu: &mut [f64],
    pivots: &mut [u16],
) -> Result<(), usize> {
    let first = d.next_multiple_of(8);
    let length = first + width;
    // The largest entry of the column to come is found while rows are eliminated.
    let (mut best, mut size) = first_pivot(panel, length, d);
    for k in 0..d {
        pivots[k] = best as u16;
        if !(size > 1e-280 && size.is_finite()) {
            return Err(k);
        }
        if best != k {
            exchange(panel, length, length, k, best);
            exchange(lu, d, k, k, best);
        }
        let (above, below) = panel.split_at_mut((k + 1) * length);
        let pivot_row = &above[k * length..];
        let inverse = 1.0 / pivot_row[k];
        let (lu_above, lu_below) = lu.split_at_mut((k + 1) * d);
        let u = &mut lu_above[k * d..];
        u[k] = inverse;
        u[k + 1..].copy_from_slice(&pivot_row[k + 1..d]);
        // Left of the pivot the row is zero: whole vectors may be taken, and all of few.
        let skipped = if V > 0 { 0 } else { k & !7 };
        let from = &pivot_row[skipped..];
        (best, size) = (k + 1, 0.0);
        let mut i = k;
        for (to, lu) in below.chunks_exact_mut(length).zip(lu_below.chunks_exact_mut(d)) {
            let l = to[k] * inverse;
            lu[k] = l;
            axpy::<V>(&mut to[skipped..], -l, from);
            i += 1;
            if i < d {
                larger(to[k + 1], i, &mut best, &mut size);
            }
        }
    }
    for k in (0..d).rev() {
        let inverse = lu[k * d + k];
        panel[k * length + first..(k + 1) * length].iter_mut().for_each(|x| *x *= inverse);
        let skipped = if V > 0 { 0 } else { first };
        let (above, row) = panel.split_at_mut(k * length);
        for (to, lu) in above.chunks_exact_mut(length).zip(lu.chunks_exact(d)) {
            axpy::<V>(&mut to[skipped..], -lu[k], &row[skipped..length]);
        }
    }
    Ok(())
}

/// y = M⁻¹ y, ties along.
#[inline(always)]
pub(super) fn solve(m: &[f64], rows: usize, d: usize, pivots: &[u16], y: &mut [f64]) {
    for (k, &pivot) in pivots.iter().enumerate() {
        y.swap(k, pivot as usize);
    }
    for k in 0..d {
        let yk = y[k];
        for i in k + 1..rows {
            y[i] = (-m[i * d + k]).mul_add(yk, y[i]);
        }
    }
    for k in (0..d).rev() {
        y[k] *= m[k * d + k];
        let yk = y[k];
        for i in 0..k {
            y[i] = (-m[i * d + k]).mul_add(yk, y[i]);
        }
    }
}

/// v = M⁻ᵀ v, ties along.
#[inline(always)]
pub(super) fn solve_transposed(m: &[f64], rows: usize, d: usize, pivots: &[u16], v: &mut [f64]) {
    for k in 0..d {
        v[k] *= m[k * d + k];
        let vk = v[k];
        for j in k + 1..d {
            v[j] = (-m[k * d + j]).mul_add(vk, v[j]);
        }
    }
    for k in (0..d).rev() {
        let mut sum = v[k];
        for i in k + 1..rows {
            sum = (-m[i * d + k]).mul_add(v[i], sum);
        }
        v[k] = sum;
    }
    for (k, &pivot) in pivots.iter().enumerate().rev() {
        v.swap(k, pivot as usize);
    }
}
