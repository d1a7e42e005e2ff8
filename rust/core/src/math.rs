//! Scalar elementary functions that vectorise over lanes.

#[inline(always)]
#[allow(missing_docs)]
pub fn sin(x: f64) -> f64 {
    x.sin()
}
