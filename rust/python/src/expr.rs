//! Symbolic expressions and tables.

use std::collections::HashMap;
use std::f64::consts::{LN_10, PI};
use std::sync::Arc;

use phugoid::Table;
use phugoid::expr::{self, Expr, Lookup, Op};
use phugoid::internals::display;
use phugoid::internals::operations::TABLE;
use phugoid::internals::pool::Pool;
use pyo3::basic::CompareOp;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::errors::named;

/// A symbolic expression.
#[pyclass(name = "Expr", module = "phugoid._core", frozen)]
#[derive(Clone)]
pub struct PyExpr(pub Expr);

/// An expression, or a number as one.
pub struct Operand(pub Expr);

impl<'a, 'py> FromPyObject<'a, 'py> for Operand {
    type Error = PyErr;

    fn extract(object: Borrowed<'a, 'py, PyAny>) -> PyResult<Self> {
        if let Ok(expr) = object.cast::<PyExpr>() {
            return Ok(Operand(expr.get().0.clone()));
        }
        let value: f64 = object.extract().map_err(|_| {
            let kind = object.get_type().name().map_or_else(|_| "object".into(), |n| n.to_string());
            PyTypeError::new_err(format!("a {kind} is neither an expression nor a number"))
        })?;
        Ok(Operand(Expr::constant(value)))
    }
}

impl Operand {
    /// The expression, unless it is a number that is not finite. Checked here and not when it is
    /// extracted: Python drops the error of an operator's operand.
    fn finite(self) -> PyResult<Expr> {
        match self.0.as_constant() {
            Some(c) if !c.is_finite() => {
                Err(named("ModelError", format!("the number {c} in an expression is not finite")))
            }
            _ => Ok(self.0),
        }
    }
}

fn two(op: Op, a: impl Into<Operand>, b: impl Into<Operand>) -> PyResult<PyExpr> {
    Ok(PyExpr(Expr::apply(op, vec![a.into().finite()?, b.into().finite()?])))
}

fn no_modulo(modulo: Option<Py<PyAny>>) -> PyResult<()> {
    modulo.map_or(Ok(()), |_| Err(PyTypeError::new_err("pow() of an expression takes no modulus")))
}

/// What MATLAB and others write for a power is the exclusive or of Python.
fn no_power() -> PyErr {
    PyTypeError::new_err("'^' is no power in Python: write x**2, not x^2")
}

impl From<&PyExpr> for Operand {
    fn from(expr: &PyExpr) -> Self {
        Operand(expr.0.clone())
    }
}

#[pymethods]
impl PyExpr {
    #[new]
    fn new(value: Operand) -> PyResult<Self> {
        value.finite().map(PyExpr)
    }

    /// The symbol of a name.
    #[staticmethod]
    fn symbol(name: &str) -> Self {
        PyExpr(Expr::symbol(name))
    }

    fn __add__(&self, other: Operand) -> PyResult<Self> {
        two(Op::Add, self, other)
    }
    fn __radd__(&self, other: Operand) -> PyResult<Self> {
        two(Op::Add, other, self)
    }
    fn __sub__(&self, other: Operand) -> PyResult<Self> {
        two(Op::Sub, self, other)
    }
    fn __rsub__(&self, other: Operand) -> PyResult<Self> {
        two(Op::Sub, other, self)
    }
    fn __mul__(&self, other: Operand) -> PyResult<Self> {
        two(Op::Mul, self, other)
    }
    fn __rmul__(&self, other: Operand) -> PyResult<Self> {
        two(Op::Mul, other, self)
    }
    fn __truediv__(&self, other: Operand) -> PyResult<Self> {
        if other.0.as_constant() == Some(0.0) {
            return Err(named("ModelError", format!("division of {} by zero", self.0.brief())));
        }
        two(Op::Div, self, other)
    }
    fn __rtruediv__(&self, other: Operand) -> PyResult<Self> {
        two(Op::Div, other, self)
    }
    fn __pow__(&self, other: Operand, modulo: Option<Py<PyAny>>) -> PyResult<Self> {
        no_modulo(modulo)?;
        two(Op::Pow, self, other)
    }
    fn __rpow__(&self, other: Operand, modulo: Option<Py<PyAny>>) -> PyResult<Self> {
        no_modulo(modulo)?;
        two(Op::Pow, other, self)
    }
    fn __neg__(&self) -> Self {
        PyExpr(-&self.0)
    }
    fn __pos__(&self) -> Self {
        self.clone()
    }
    fn __abs__(&self) -> Self {
        PyExpr(self.0.abs())
    }
    fn __and__(&self, other: Operand) -> PyResult<Self> {
        two(Op::And, self, other)
    }
    fn __or__(&self, other: Operand) -> PyResult<Self> {
        two(Op::Or, self, other)
    }
    fn __xor__(&self, _other: &Bound<'_, PyAny>) -> PyResult<Self> {
        Err(no_power())
    }
    fn __rxor__(&self, _other: &Bound<'_, PyAny>) -> PyResult<Self> {
        Err(no_power())
    }
    fn __invert__(&self) -> Self {
        PyExpr(Expr::apply(Op::Not, vec![self.0.clone()]))
    }

    /// `==` and `!=` compare structure, so that expressions can be kept in sets and dicts; the
    /// others give an expression that is 1 where they hold.
    fn __richcmp__(&self, other: Bound<'_, PyAny>, op: CompareOp) -> PyResult<Py<PyAny>> {
        let py = other.py();
        let (a, b) = (self.0.clone(), other.extract::<Operand>());
        let b = match (op, b) {
            (CompareOp::Eq, b) => {
                return Ok(b.is_ok_and(|b| b.0 == a).into_pyobject(py)?.to_owned().into_any().unbind());
            }
            (CompareOp::Ne, b) => {
                return Ok((!b.is_ok_and(|b| b.0 == a)).into_pyobject(py)?.to_owned().into_any().unbind());
            }
            (_, b) => b?.finite()?,
        };
        let expr = match op {
            CompareOp::Lt => expr::lt(a, b),
            CompareOp::Le => expr::le(a, b),
            CompareOp::Gt => expr::gt(a, b),
            _ => expr::ge(a, b),
        };
        Ok(PyExpr(expr).into_pyobject(py)?.into_any().unbind())
    }

    fn __hash__(&self) -> u64 {
        self.0.structural_hash()
    }

    fn __bool__(&self) -> PyResult<bool> {
        Err(PyTypeError::new_err(format!(
            "'{}' has no truth value before numbers are put in: write phugoid.where(condition, yes, no) \
             for 'if', phugoid.minimum and phugoid.maximum for 'min' and 'max', and & | ~ for 'and', 'or', 'not'",
            self.0.brief()
        )))
    }

    fn __float__(&self) -> PyResult<f64> {
        let simple = self.0.simplified();
        simple.as_constant().ok_or_else(|| {
            PyTypeError::new_err(format!(
                "'{}' is not a number: it holds symbols (functions of expressions are those of phugoid \
                     and numpy, not of math)",
                self.0.brief()
            ))
        })
    }

    fn __repr__(&self) -> String {
        self.0.to_string()
    }

    /// LaTeX source of the expression.
    fn latex(&self) -> String {
        self.0.latex()
    }

    fn _repr_latex_(&self) -> String {
        format!("${}$", self.0.latex())
    }

    /// Names of all symbols, sorted.
    #[getter]
    fn symbols(&self) -> Vec<String> {
        self.0.symbols().iter().map(ToString::to_string).collect()
    }

    /// Name, where the expression is a symbol.
    #[getter]
    fn name(&self) -> Option<String> {
        self.0.as_symbol().map(ToOwned::to_owned)
    }

    /// Names and values of all named constants, sorted.
    #[getter]
    fn constants(&self) -> Vec<(String, f64)> {
        self.0.constants().iter().map(|(name, value)| (name.to_string(), *value)).collect()
    }

    /// Number, where the expression is one.
    #[getter]
    fn constant(&self) -> Option<f64> {
        self.0.as_constant()
    }

    /// Name of the top operation and its arguments; `("symbol", ())` and `("constant", ())` for leaves.
    #[getter]
    fn operation(&self) -> (&'static str, Vec<PyExpr>) {
        let args = self.0.args().iter().cloned().map(PyExpr).collect();
        let name = match self.0.node() {
            expr::Node::Constant(_) | expr::Node::Named(..) => "constant",
            expr::Node::Symbol(_) => "symbol",
            expr::Node::Apply(op, _) => op.entry().name,
            expr::Node::Lookup(..) => "lookup",
        };
        (name, args)
    }

    /// Value at numbers given by name.
    #[pyo3(signature = (values = None, /, **named_values))]
    fn evaluate(
        &self,
        values: Option<HashMap<String, f64>>,
        named_values: Option<HashMap<String, f64>>,
    ) -> PyResult<f64> {
        let all = values.into_iter().flatten().chain(named_values.into_iter().flatten());
        let all: HashMap<Arc<str>, f64> = all.map(|(k, v)| (k.into(), v)).collect();
        self.0
            .evaluate(&all)
            .map_err(|name| named("ModelError", format!("no value was given for symbol '{name}'")))
    }

    /// Exact derivative with respect to a symbol.
    fn diff(&self, symbol: &Bound<'_, PyAny>) -> PyResult<PyExpr> {
        let name = match symbol.cast::<PyExpr>() {
            Ok(e) => e.get().0.as_symbol().map(ToOwned::to_owned),
            Err(_) => Some(symbol.extract::<String>()?),
        };
        let name = name.ok_or_else(|| {
            let text = symbol.cast::<PyExpr>().map_or_else(|_| symbol.to_string(), |e| e.get().0.brief());
            PyTypeError::new_err(format!("'{text}' is not a symbol"))
        })?;
        Ok(PyExpr(self.0.derivative(&name)))
    }

    /// The expression with symbols replaced by expressions or numbers.
    fn substitute(&self, replace: HashMap<String, Operand>) -> PyResult<PyExpr> {
        let replace =
            replace.into_iter().map(|(k, v)| Ok((k.into(), v.finite()?))).collect::<PyResult<_>>()?;
        Ok(PyExpr(self.0.substitute(&replace)))
    }

    /// The expression with constants folded.
    fn simplify(&self) -> PyExpr {
        PyExpr(self.0.simplified())
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, (String,))> {
        let load = py.import("phugoid._core")?.getattr("load_expression")?;
        Ok((load, (self.to_json()?,)))
    }

    /// Saved form.
    fn to_json(&self) -> PyResult<String> {
        serde_text(&Pool::new([&self.0]))
    }

    #[pyo3(signature = (ufunc, method, *inputs, **options))]
    fn __array_ufunc__<'py>(
        &self,
        ufunc: &Bound<'py, PyAny>,
        method: &str,
        inputs: &Bound<'py, PyTuple>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let apply = ufunc.py().import("phugoid.functions")?.getattr("apply_ufunc")?;
        apply.call((ufunc, method, inputs, options), None)
    }
}

macro_rules! named_methods {
    ($($name:ident $op:expr;)*) => {
        /// numpy calls these on the elements of an object array: `np.sin(array)` gives `x.sin()`.
        #[pymethods]
        impl PyExpr {
            $(fn $name(&self) -> Self {
                PyExpr(Expr::apply($op, vec![self.0.clone()]))
            })*
            fn arctan2(&self, x: Operand) -> PyResult<Self> {
                two(Op::Atan2, self, x)
            }
            fn square(&self) -> Self {
                PyExpr(&self.0 * &self.0)
            }
            fn hypot(&self, other: Operand) -> PyResult<Self> {
                two(Op::Hypot, self, other)
            }
            fn log10(&self) -> Self {
                PyExpr(self.0.log() / LN_10)
            }
            fn deg2rad(&self) -> Self {
                PyExpr(&self.0 * (PI / 180.0))
            }
            fn radians(&self) -> Self {
                self.deg2rad()
            }
            fn rad2deg(&self) -> Self {
                PyExpr(&self.0 * (180.0 / PI))
            }
            fn degrees(&self) -> Self {
                self.rad2deg()
            }
            /// `np.clip` of a single expression; `out` is always `None` there.
            #[pyo3(signature = (low, high, out = None))]
            fn clip(&self, low: Operand, high: Operand, out: Option<Py<PyAny>>) -> PyResult<Self> {
                let _ = out;
                two(Op::Min, &two(Op::Max, self, low)?, high)
            }
            fn conjugate(&self) -> Self {
                self.clone()
            }
        }
    };
}

named_methods! {
    sin Op::Sin;
    cos Op::Cos;
    tan Op::Tan;
    arcsin Op::Asin;
    arccos Op::Acos;
    arctan Op::Atan;
    sinh Op::Sinh;
    cosh Op::Cosh;
    tanh Op::Tanh;
    exp Op::Exp;
    expm1 Op::Expm1;
    log1p Op::Log1p;
    log Op::Log;
    sqrt Op::Sqrt;
    sign Op::Sign;
    fabs Op::Abs;
}

fn serde_text(pool: &Pool) -> PyResult<String> {
    pool.to_json().map_err(PyValueError::new_err)
}

/// An operation of the table by name.
#[pyfunction]
#[pyo3(signature = (name, *args))]
pub fn apply(name: &str, args: Vec<Operand>) -> PyResult<PyExpr> {
    let op = Op::from_name(name).ok_or_else(|| PyValueError::new_err(format!("no operation '{name}'")))?;
    if args.len() != op.entry().arity {
        return Err(PyTypeError::new_err(format!(
            "{name} takes {} arguments, {} were given",
            op.entry().arity,
            args.len()
        )));
    }
    let args = args.into_iter().map(Operand::finite).collect::<PyResult<Vec<Expr>>>()?;
    let numbers: Option<Vec<f64>> = args.iter().map(Expr::as_constant).collect();
    if let Some(x) = numbers {
        let value = (op.entry().value)(&x);
        if !value.is_finite() {
            let expr = Expr::apply(op, args);
            let expr = expr.brief();
            return Err(named("ModelError", format!("{expr} is {value}: outside the domain of {name}")));
        }
        // A named constant is printed by its name.
        if !args.iter().any(|a| matches!(a.node(), expr::Node::Named(..))) {
            return Ok(PyExpr(Expr::constant(value)));
        }
    }
    Ok(PyExpr(Expr::apply(op, args)))
}

/// Name, arity and domain of every operation of the table.
#[pyfunction]
#[allow(clippy::type_complexity)] // one row of the table
pub fn operations() -> Vec<(&'static str, usize, Vec<(f64, f64)>)> {
    TABLE.iter().map(|e| (e.name, e.arity, e.domain.to_vec())).collect()
}

/// Head and indices of the symbol of a name, in Unicode: `["C", "mα"]` of `Cma`.
#[pyfunction]
pub fn symbol_parts(name: &str) -> Vec<String> {
    display::symbol_parts(name)
}

/// Reads an expression saved by `Expr.to_json`.
#[pyfunction]
pub fn load_expression(text: &str) -> PyResult<PyExpr> {
    let exprs = Pool::from_json(text).and_then(|p| p.expressions()).map_err(PyValueError::new_err)?;
    exprs.into_iter().next().map(PyExpr).ok_or_else(|| PyValueError::new_err("no expression"))
}

/// An interpolation table with smooth derivatives, to be called on expressions.
#[pyclass(name = "Table", module = "phugoid._core", frozen)]
pub struct PyTable(Arc<Table>);

#[pymethods]
impl PyTable {
    #[new]
    #[pyo3(signature = (name, x, values, y = None))]
    fn new(name: &str, x: Vec<f64>, values: Vec<f64>, y: Option<Vec<f64>>) -> PyResult<Self> {
        let table = match y {
            None => Table::new_1d(name, &x, &values),
            Some(y) => Table::new_2d(name, &x, &y, &values),
        };
        table.map(|t| PyTable(Arc::new(t))).map_err(|e| named("ModelError", e.to_string()))
    }

    #[pyo3(signature = (*args))]
    fn __call__(&self, args: Vec<Operand>) -> PyResult<PyExpr> {
        if args.len() != self.0.dimension() {
            let text = format!(
                "table '{}' takes {} arguments, {} were given",
                self.0.name(),
                self.0.dimension(),
                args.len()
            );
            return Err(PyTypeError::new_err(text));
        }
        let lookup = Lookup { table: self.0.clone(), order: [0, 0] };
        let args = args.into_iter().map(Operand::finite).collect::<PyResult<_>>()?;
        Ok(PyExpr(Expr::lookup(lookup, args)))
    }

    #[getter]
    fn name(&self) -> &str {
        self.0.name()
    }
}

/// Values of a sampled channel at other times: `kind` is "linear", "cubic" or "hold".
#[pyfunction]
pub fn interpolate(kind: &str, t: Vec<f64>, values: Vec<f64>, at: Vec<f64>) -> PyResult<Vec<f64>> {
    Ok(phugoid::internals::interpolate::interpolate(crate::problem::interpolation(kind)?, &t, &values, &at))
}
