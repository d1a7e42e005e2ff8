//! Rows of whole vectors of eight, for the panels of segments: with their number known, sums stay in registers.

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
