//! Rust operators and named functions on expressions.

use std::ops;

use super::{Expr, Op};

impl From<f64> for Expr {
    fn from(value: f64) -> Self {
        Expr::constant(value)
    }
}

impl From<&Expr> for Expr {
    fn from(expr: &Expr) -> Self {
        expr.clone()
    }
}

macro_rules! binary {
    ($($trait:ident $method:ident $op:expr;)*) => {$(
        impl<T: Into<Expr>> ops::$trait<T> for Expr {
            type Output = Expr;
            fn $method(self, other: T) -> Expr {
                Expr::apply($op, vec![self, other.into()])
            }
        }
        impl<T: Into<Expr>> ops::$trait<T> for &Expr {
            type Output = Expr;
            fn $method(self, other: T) -> Expr {
                Expr::apply($op, vec![self.clone(), other.into()])
            }
        }
        impl ops::$trait<Expr> for f64 {
            type Output = Expr;
            fn $method(self, other: Expr) -> Expr {
                Expr::apply($op, vec![self.into(), other])
            }
        }
        impl ops::$trait<&Expr> for f64 {
            type Output = Expr;
            fn $method(self, other: &Expr) -> Expr {
                Expr::apply($op, vec![self.into(), other.clone()])
            }
        }
    )*};
}

binary! {
    Add add Op::Add;
    Sub sub Op::Sub;
    Mul mul Op::Mul;
    Div div Op::Div;
}

impl ops::Neg for Expr {
    type Output = Expr;
    fn neg(self) -> Expr {
        Expr::apply(Op::Neg, vec![self])
    }
}

impl ops::Neg for &Expr {
    type Output = Expr;
    fn neg(self) -> Expr {
        -self.clone()
    }
}

macro_rules! methods {
    ($($name:ident $op:expr, $doc:expr;)*) => {
        impl Expr {
            $(#[doc = $doc]
            pub fn $name(&self) -> Expr {
                Expr::apply($op, vec![self.clone()])
            })*
        }
    };
}

methods! {
    sqrt Op::Sqrt, "Square root.";
    exp Op::Exp, "Exponential.";
    expm1 Op::Expm1, "Exponential less 1, accurate near 0.";
    log Op::Log, "Natural logarithm.";
    log1p Op::Log1p, "Natural logarithm of 1 + x, accurate near 0.";
    sin Op::Sin, "Sine.";
    cos Op::Cos, "Cosine.";
    tan Op::Tan, "Tangent.";
    asin Op::Asin, "Arc sine.";
    acos Op::Acos, "Arc cosine.";
    atan Op::Atan, "Arc tangent.";
    sinh Op::Sinh, "Hyperbolic sine.";
    cosh Op::Cosh, "Hyperbolic cosine.";
    tanh Op::Tanh, "Hyperbolic tangent.";
    abs Op::Abs, "Absolute value.";
    sign Op::Sign, "Sign: −1, 0 or 1.";
}

impl Expr {
    /// Power with any exponent: a number or an expression.
    pub fn pow(&self, exponent: impl Into<Expr>) -> Expr {
        Expr::apply(Op::Pow, vec![self.clone(), exponent.into()])
    }
}

fn two(op: Op, a: impl Into<Expr>, b: impl Into<Expr>) -> Expr {
    Expr::apply(op, vec![a.into(), b.into()])
}

/// Angle of the point (x, y).
pub fn atan2(y: impl Into<Expr>, x: impl Into<Expr>) -> Expr {
    two(Op::Atan2, y, x)
}

/// √(x² + y²), without overflow on the way.
pub fn hypot(x: impl Into<Expr>, y: impl Into<Expr>) -> Expr {
    two(Op::Hypot, x, y)
}

/// The smaller of two.
pub fn min(a: impl Into<Expr>, b: impl Into<Expr>) -> Expr {
    two(Op::Min, a, b)
}

/// The larger of two.
pub fn max(a: impl Into<Expr>, b: impl Into<Expr>) -> Expr {
    two(Op::Max, a, b)
}

/// a < b, as 1 or 0.
pub fn lt(a: impl Into<Expr>, b: impl Into<Expr>) -> Expr {
    two(Op::Lt, a, b)
}

/// a ≤ b, as 1 or 0.
pub fn le(a: impl Into<Expr>, b: impl Into<Expr>) -> Expr {
    two(Op::Le, a, b)
}

/// a > b, as 1 or 0.
pub fn gt(a: impl Into<Expr>, b: impl Into<Expr>) -> Expr {
    two(Op::Lt, b, a)
}

/// a ≥ b, as 1 or 0.
pub fn ge(a: impl Into<Expr>, b: impl Into<Expr>) -> Expr {
    two(Op::Le, b, a)
}

/// a = b, as 1 or 0.
pub fn eq(a: impl Into<Expr>, b: impl Into<Expr>) -> Expr {
    let (a, b) = (a.into(), b.into());
    two(Op::And, le(&a, &b), le(&b, &a))
}

/// `yes` where the condition holds, `no` elsewhere.
pub fn select(condition: impl Into<Expr>, yes: impl Into<Expr>, no: impl Into<Expr>) -> Expr {
    Expr::apply(Op::Where, vec![condition.into(), yes.into(), no.into()])
}

/// |x| with the kink rounded over a width: √(x² + width²).
pub fn smooth_abs(x: impl Into<Expr>, width: impl Into<Expr>) -> Expr {
    let (x, width) = (x.into(), width.into());
    (&x * &x + &width * &width).sqrt()
}

/// sign(x) with the jump spread over a width: tanh(x/width).
pub fn smooth_sign(x: impl Into<Expr>, width: impl Into<Expr>) -> Expr {
    (x.into() / width.into()).tanh()
}

/// max(a, b) with the kink rounded over a width.
pub fn smooth_max(a: impl Into<Expr>, b: impl Into<Expr>, width: impl Into<Expr>) -> Expr {
    let (a, b) = (a.into(), b.into());
    0.5 * (&a + &b + smooth_abs(&a - &b, width))
}

/// min(a, b) with the kink rounded over a width.
pub fn smooth_min(a: impl Into<Expr>, b: impl Into<Expr>, width: impl Into<Expr>) -> Expr {
    let (a, b) = (a.into(), b.into());
    0.5 * (&a + &b - smooth_abs(&a - &b, width))
}
