//! Interpolation of sampled inputs at arbitrary times.
//!
//! What an input does between its samples is an assumption about the
//! experiment, and a wrong one looks like a model error.

/// The interpolation of an input between its samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "lowercase"))]
#[non_exhaustive]
pub enum Interpolation {
    /// Straight lines between the samples.
    Linear,
    /// Cubic spline with continuous second derivative and not-a-knot ends, as
    /// scipy's `CubicSpline` (de Boor, A Practical Guide to Splines, 1978):
    /// the parabola through 3 samples, the line through 2.
    Cubic,
    /// Each sample is held until the next (zero-order hold), as a computer puts out a command. At a sample time the
    /// value is that of the sample.
    Hold,
}

impl Interpolation {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Interpolation::Linear => "linear",
            Interpolation::Cubic => "cubic",
            Interpolation::Hold => "hold",
        }
    }
}

/// A time this part of a sampling interval before a sample counts as that of the sample where the sample is held:
/// delays and divisions of time carry rounding.
const SAME: f64 = 1e-9;
/// Number of samples after the last one used that are searched one by one.
const NEAR: usize = 4;

/// Values at the times `at` of a signal sampled as `values` at the times `t`.
///
/// `t` increases strictly, at any spacing; `at` may be in any order. At a
/// sample time the result is the sample, bit for bit. Outside `[t[0], t[N-1]]`
/// the end values are held, for any kind: a polynomial continued past its
/// data soon means nothing. NaN in `at` gives NaN. Missing (NaN)
/// values are for the caller to reject or fill: one of them spoils its two
/// neighbouring intervals if linear, everything between samples if cubic, and
/// the interval after it if held.
///
/// # Panics
/// If `t` is empty or its length is not that of `values`.
///
/// ```
/// use phugoid::internals::interpolate::{Interpolation, interpolate};
///
/// let (t, u) = ([0.0, 1.0, 3.0, 4.0], [0.0, 1.0, 9.0, 16.0]);
/// assert_eq!(interpolate(Interpolation::Linear, &t, &u, &[2.0]), [5.0]);
/// assert_eq!(interpolate(Interpolation::Cubic, &t, &u, &[2.0]), [4.0]);
/// assert_eq!(interpolate(Interpolation::Hold, &t, &u, &[2.0, 3.0]), [1.0, 9.0]);
/// ```
pub fn interpolate(kind: Interpolation, t: &[f64], values: &[f64], at: &[f64]) -> Vec<f64> {
    let signal = Interpolant::new(kind, t, values);
    let mut n = 0;
    at.iter()
        .map(|&s| {
            n = signal.before(s, n);
            signal.between(s, n)
        })
        .collect()
}

/// A sampled signal at any time, one time after the other: as [`interpolate`], prepared once.
#[derive(Clone, Debug)]
pub struct Interpolant<'a> {
    t: &'a [f64],
    values: &'a [f64],
    held: bool,
    /// Derivatives at the samples of a spline; none of straight lines.
    slopes: Option<Vec<f64>>,
}

impl<'a> Interpolant<'a> {
    /// Makes the interpolation of the samples `values` at the times `t`.
    ///
    /// # Panics
    /// As [`interpolate`].
    pub fn new(kind: Interpolation, t: &'a [f64], values: &'a [f64]) -> Self {
        assert!(!t.is_empty(), "no samples to interpolate");
        assert_eq!(t.len(), values.len(), "as many sample times as sample values are needed");
        debug_assert!(t.windows(2).all(|pair| pair[0] < pair[1]), "sample times must increase strictly");
        let slopes = (kind == Interpolation::Cubic).then(|| spline_slopes(t, values));
        Interpolant { t, values, held: kind == Interpolation::Hold, slopes }
    }

    /// The times of its samples.
    pub fn times(&self) -> &'a [f64] {
        self.t
    }

    /// Returns the value at a time; before the first sample and after the last one it is theirs.
    pub fn at(&self, s: f64) -> f64 {
        self.between(s, self.t.partition_point(|&sample| sample <= s))
    }

    /// Number of samples at or before `s`, looked for from a number on: times mostly come in order.
    fn before(&self, s: f64, from: usize) -> usize {
        let t = self.t;
        if from > 0 && t[from - 1] > s || s.is_nan() {
            return t.partition_point(|&sample| sample <= s);
        }
        match t[from..].iter().take(NEAR).position(|&sample| sample > s) {
            Some(more) => from + more,
            None => from + t[from..].partition_point(|&sample| sample <= s),
        }
    }

    /// Returns the value at a time that follows so many samples.
    fn between(&self, s: f64, n: usize) -> f64 {
        let (t, values) = (self.t, self.values);
        if s.is_nan() {
            return f64::NAN;
        }
        if n == 0 {
            return values[0];
        }
        let i = n - 1;
        if n == t.len() || t[i] == s {
            return values[i];
        }
        if self.held {
            return values[if t[n] - s <= SAME * (t[n] - t[i]) { n } else { i }];
        }
        let (h, u) = (t[n] - t[i], s - t[i]);
        let secant = (values[n] - values[i]) / h;
        let Some(slopes) = &self.slopes else { return values[i] + secant * u };
        let bend = (slopes[i] + slopes[n] - 2.0 * secant) / h;
        let c2 = (secant - slopes[i]) / h - bend;
        let c3 = bend / h;
        values[i] + u * (slopes[i] + u * (c2 + u * c3))
    }

    /// Returns a held signal from `begin` to `end`: its value where it does not jump inside, else its mean there.
    pub fn over(&self, begin: f64, end: f64) -> f64 {
        let (t, values) = (self.t, self.values);
        let slack = SAME * (end - begin);
        let first = t.partition_point(|&sample| sample <= begin + slack);
        let last = t.partition_point(|&sample| sample < end - slack);
        let before = values[first.saturating_sub(1)];
        if (first..last).all(|i| values[i] == before) {
            return before;
        }
        let (mut from, mut sum) = (begin, 0.0);
        for i in first..last {
            sum += (t[i] - from) * values[i.saturating_sub(1)];
            from = t[i];
        }
        (sum + (end - from) * values[last - 1]) / (end - begin)
    }
}

/// First or second derivative of what [`interpolate`] gives. Where it jumps, at samples, it is the mean of both
/// sides; outside the samples it is zero.
///
/// A signal that is held has impulses for its derivative: each is taken as spread evenly over the two intervals beside
/// the jump, one half over each, so that its integral and its mean time are kept. The second derivative is zero.
///
/// # Panics
/// As [`interpolate`], and for another order than 1 or 2.
pub fn derivative(kind: Interpolation, t: &[f64], values: &[f64], at: &[f64], order: usize) -> Vec<f64> {
    assert!(matches!(order, 1 | 2), "derivatives of order 1 and 2 are available, not of order {order}");
    let slopes = if kind == Interpolation::Cubic { spline_slopes(t, values) } else { Vec::new() };
    let inside = |i: usize, s: f64| {
        let h = t[i + 1] - t[i];
        let secant = (values[i + 1] - values[i]) / h;
        match kind {
            Interpolation::Linear => return if order == 1 { secant } else { 0.0 },
            Interpolation::Hold if order == 2 => return 0.0,
            Interpolation::Hold => return held_slope(t, values, i),
            Interpolation::Cubic => (),
        }
        let bend = (slopes[i] + slopes[i + 1] - 2.0 * secant) / h;
        let (c2, c3, u) = ((secant - slopes[i]) / h - bend, bend / h, s - t[i]);
        if order == 1 { slopes[i] + u * (2.0 * c2 + u * 3.0 * c3) } else { 2.0 * c2 + u * 6.0 * c3 }
    };
    let last = t.len() - 1;
    at.iter()
        .map(|&s| {
            let n = t.partition_point(|&sample| sample <= s);
            let side = |i: usize| if i < last { inside(i, s) } else { 0.0 };
            match n {
                0 => 0.0,
                _ if t[n - 1] != s => side(n - 1),
                1 => 0.5 * side(0),
                _ => 0.5 * (side(n - 2) + side(n - 1)),
            }
        })
        .collect()
}

/// The derivative of a held signal over interval i, see [`derivative`].
fn held_slope(t: &[f64], values: &[f64], i: usize) -> f64 {
    0.5 * (values[i + 1] - values[i.saturating_sub(1)]) / (t[i + 1] - t[i])
}

/// First derivatives at the samples of the not-a-knot cubic spline.
fn spline_slopes(t: &[f64], values: &[f64]) -> Vec<f64> {
    let n = t.len();
    let h: Vec<f64> = t.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let secant: Vec<f64> = (values.windows(2).zip(&h)).map(|(pair, h)| (pair[1] - pair[0]) / h).collect();
    match n {
        1 => return vec![0.0],
        2 => return vec![secant[0]; 2],
        3 => {
            // With one inner knot the not-a-knot conditions coincide; scipy
            // takes the parabola.
            let middle = (h[1] * secant[0] + h[0] * secant[1]) / (h[0] + h[1]);
            return vec![2.0 * secant[0] - middle, middle, 2.0 * secant[1] - middle];
        }
        _ => {}
    }

    // Tridiagonal system: continuity of the second derivative at the inner
    // knots, of the third at the second and the last but one. Elimination
    // needs no pivoting: after the first row the inner ones are diagonally
    // dominant, and the last pivot stays positive.
    let row = |i: usize| {
        if i == 0 {
            let span = h[0] + h[1];
            let right = ((h[0] + 2.0 * span) * h[1] * secant[0] + h[0] * h[0] * secant[1]) / span;
            (0.0, h[1], span, right)
        } else if i == n - 1 {
            let (last, before) = (h[n - 2], h[n - 3]);
            let span = last + before;
            let right = (last * last * secant[n - 3] + (2.0 * span + last) * before * secant[n - 2]) / span;
            (span, before, 0.0, right)
        } else {
            let right = 3.0 * (h[i] * secant[i - 1] + h[i - 1] * secant[i]);
            (h[i], 2.0 * (h[i - 1] + h[i]), h[i - 1], right)
        }
    };
    let mut slopes = vec![0.0; n];
    let mut ratio = vec![0.0; n];
    let (mut previous, mut previous_ratio) = (0.0, 0.0);
    for i in 0..n {
        let (lower, diagonal, upper, right) = row(i);
        let pivot = diagonal - lower * previous_ratio;
        previous = (right - lower * previous) / pivot;
        previous_ratio = upper / pivot;
        slopes[i] = previous;
        ratio[i] = previous_ratio;
    }
    for i in (0..n - 1).rev() {
        slopes[i] -= ratio[i] * slopes[i + 1];
    }
    slopes
}
