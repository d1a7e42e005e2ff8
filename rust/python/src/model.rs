//! Models.

use phugoid::model::Transform;
use phugoid::model::{Condition, Constant, End};
use phugoid::model::{Delays, LateInput, LateOutput, Model, Parameter, Variable};
use phugoid::noise::{NoiseModel, Scale};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::errors::raise;
use crate::expr::{Operand, PyExpr};

/// The core's model. `phugoid.Model` wraps it.
#[pyclass(name = "Model", module = "phugoid._core")]
#[derive(Clone)]
pub struct PyModel(pub Model);

/// Late inputs (name, the input, the parameter) and late outputs (name, the parameter).
pub type DelaySpec = (Vec<(String, String, String)>, Vec<(String, String)>);

type Named = (String, PyExpr, String, Option<String>);

fn named(equations: &[phugoid::model::Equation]) -> Vec<Named> {
    let one = |e: &phugoid::model::Equation| {
        (e.name.clone(), PyExpr(e.expr.clone()), e.unit.clone(), e.source.clone())
    };
    equations.iter().map(one).collect()
}

impl PyModel {
    /// The model with these delays.
    pub fn late(&self, (inputs, outputs): DelaySpec) -> Model {
        let inputs = inputs.into_iter().map(|(name, of, by)| LateInput { name, of, by }).collect();
        let outputs = outputs.into_iter().map(|(output, by)| LateOutput { output, by }).collect();
        Model { delays: Delays { inputs, outputs }, ..self.0.clone() }
    }
}

#[pymethods]
impl PyModel {
    #[new]
    fn new(name: &str) -> Self {
        PyModel(Model::new(name))
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    #[pyo3(signature = (name, unit, start=None, lower=f64::NEG_INFINITY, upper=f64::INFINITY))]
    fn state(
        &mut self,
        name: &str,
        unit: &str,
        start: Option<f64>,
        lower: f64,
        upper: f64,
    ) -> PyResult<PyExpr> {
        let (lower, upper) =
            ((lower != f64::NEG_INFINITY).then_some(lower), (upper != f64::INFINITY).then_some(upper));
        let state = Variable { start, lower, upper, ..Variable::new(name, unit) };
        self.0.state_within(state).map(PyExpr).map_err(raise)
    }

    /// Name, unit, start and bounds of the states.
    #[getter]
    fn declared_states(&self) -> Vec<(String, String, Option<f64>, f64, f64)> {
        let one = |v: &Variable| (v.name.clone(), v.unit.clone(), v.start, v.bounds().0, v.bounds().1);
        self.0.states.iter().map(one).collect()
    }

    fn input(&mut self, name: &str, unit: &str) -> PyResult<PyExpr> {
        self.0.input(name, unit).map(PyExpr).map_err(raise)
    }

    #[pyo3(signature = (name, unit, start, lower, upper, prior, fixed, local, log, scale))]
    #[allow(clippy::too_many_arguments)] // the fields of one parameter, from one call in Python
    fn parameter(
        &mut self,
        name: &str,
        unit: &str,
        start: f64,
        lower: f64,
        upper: f64,
        prior: Option<(f64, f64)>,
        fixed: bool,
        local: bool,
        log: bool,
        scale: Option<f64>,
    ) -> PyResult<PyExpr> {
        let bound = |b: f64| (!b.is_infinite()).then_some(b);
        let transform = if log { Transform::Log } else { scale.map_or(Transform::None, Transform::Scale) };
        let parameter = Parameter::new(name, start)
            .unit(unit.to_owned())
            .lower(bound(lower))
            .upper(bound(upper))
            .prior(prior)
            .fixed(fixed)
            .local(local)
            .transform(transform);
        self.0.parameter(parameter).map(PyExpr).map_err(raise)
    }

    fn constant(&mut self, name: &str, value: f64, unit: &str, meaning: &str) -> PyResult<PyExpr> {
        let constant = Constant::new(name, value).unit(unit).meaning(meaning);
        self.0.constant(constant).map(PyExpr).map_err(raise)
    }

    fn quantity(&mut self, name: &str, expr: Operand, source: Option<String>) -> PyResult<PyExpr> {
        self.0.written_at(source).quantity(name, expr.0).map(PyExpr).map_err(raise)
    }

    fn equation(&mut self, state: &str, expr: Operand, source: Option<String>) -> PyResult<()> {
        self.0.written_at(source).equation(state, expr.0).map_err(raise)
    }

    fn output(&mut self, name: &str, expr: Operand, unit: &str, source: Option<String>) -> PyResult<()> {
        self.0.written_at(source).output(name, expr.0, unit).map_err(raise)
    }

    /// `end` is "initial", "final" or "periodic".
    fn condition(&mut self, end: &str, state: &str, expr: Operand, source: Option<String>) -> PyResult<()> {
        let end = match end {
            "initial" => End::Initial,
            "final" => End::Final,
            "periodic" => End::Periodic,
            _ => return Err(PyValueError::new_err(format!("unknown end '{end}'"))),
        };
        self.0.written_at(source).condition(end, state, expr.0).map_err(raise)
    }

    /// End, state, expression and source.
    #[getter]
    fn conditions(&self) -> Vec<(&'static str, String, PyExpr, Option<String>)> {
        let one = |c: &Condition| {
            let end = match c.end {
                End::Initial => "initial",
                End::Final => "final",
                End::Periodic => "periodic",
            };
            (end, c.state.clone(), PyExpr(c.expr.clone()), c.source.clone())
        };
        self.0.conditions.iter().map(one).collect()
    }

    fn check(&self) -> PyResult<()> {
        self.0.check().map_err(raise)
    }

    /// Kinks and jumps in the states: the operation, and in words where it stands, as in "sign(v) in v'".
    fn kinks(&self) -> Vec<(&'static str, String)> {
        self.0.kinks().into_iter().map(|k| (k.name, k.label())).collect()
    }

    /// The model without these delays, for data that were moved by the base (s) of each.
    #[allow(clippy::needless_pass_by_value)]
    fn at_delays(&self, delays: DelaySpec, base: Vec<(String, f64)>) -> PyModel {
        let base = base.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        PyModel(self.late(delays).at_delays(&base, f64::INFINITY))
    }

    /// A model of its own.
    fn copy(&self) -> PyModel {
        PyModel(self.0.clone())
    }

    /// Scalings that no output can tell: exponents by name, the parameter to hold, and where.
    #[allow(clippy::type_complexity)]
    fn scalings(&self, starts: Vec<f64>) -> PyResult<Vec<(Vec<(String, f64)>, String, f64)>> {
        let found = self.0.scalings(&starts).map_err(raise)?;
        Ok(found.into_iter().map(|s| (s.exponents, s.held, s.at)).collect())
    }

    /// Names and units.
    #[getter]
    fn states(&self) -> Vec<(String, String)> {
        self.0.states.iter().map(|v| (v.name.clone(), v.unit.clone())).collect()
    }

    /// Names and units.
    #[getter]
    fn inputs(&self) -> Vec<(String, String)> {
        self.0.inputs.iter().map(|v| (v.name.clone(), v.unit.clone())).collect()
    }

    /// Name, unit, start, lower and upper bound, prior, fixed, one an experiment, by its logarithm, scale.
    #[getter]
    #[allow(clippy::type_complexity)]
    fn parameters(
        &self,
    ) -> Vec<(String, String, f64, f64, f64, Option<(f64, f64)>, bool, bool, bool, Option<f64>)> {
        let one = |p: &Parameter| {
            let (lower, upper) = (p.lower.unwrap_or(f64::NEG_INFINITY), p.upper.unwrap_or(f64::INFINITY));
            let scale = if let Transform::Scale(s) = p.transform { Some(s) } else { None };
            let log = p.transform == Transform::Log;
            (p.name.clone(), p.unit.clone(), p.start, lower, upper, p.prior, p.fixed, p.local, log, scale)
        };
        self.0.parameters.iter().map(one).collect()
    }

    /// Name, value, unit and meaning.
    #[getter]
    fn constants(&self) -> Vec<(String, f64, String, String)> {
        let one = |c: &Constant| (c.name.clone(), c.value, c.unit.clone(), c.meaning.clone());
        self.0.constants.iter().map(one).collect()
    }

    /// Name, expression, unit and source.
    #[getter]
    fn quantities(&self) -> Vec<Named> {
        named(&self.0.quantities)
    }

    /// Name, expression, unit and source.
    #[getter]
    fn dynamics(&self) -> Vec<Named> {
        named(&self.0.dynamics)
    }

    /// Name, expression, unit and source.
    #[getter]
    fn outputs(&self) -> Vec<Named> {
        named(&self.0.outputs)
    }

    /// For each state that an output measures, with these values of the parameters: state, output, offset and slope.
    #[allow(clippy::needless_pass_by_value)]
    fn measured_states(&self, parameters: Vec<f64>) -> Vec<(String, String, f64, f64)> {
        let found = self.0.measured_states(&parameters);
        let pairs = self.0.states.iter().zip(found).filter_map(|(s, m)| Some((s, m?)));
        pairs
            .map(|(s, m)| (s.name.clone(), self.0.outputs[m.output].name.clone(), m.offset, m.slope))
            .collect()
    }

    /// Without noise and delays, which `phugoid.Model` holds itself.
    fn to_json(&self) -> String {
        Model { noise: NoiseModel::new(), ..self.0.clone() }.to_json()
    }

    /// Takes the standard deviations of the noise that are expressions, by output: their symbols count as used.
    fn noise_expressions(&mut self, expressions: Vec<(String, Operand)>) {
        let scales = expressions.into_iter().map(|(name, e)| (name, Scale::Expression(e.0)));
        self.0.noise = NoiseModel { scales: scales.collect(), ..NoiseModel::new() };
    }

    #[staticmethod]
    fn from_json(text: &str) -> PyResult<Self> {
        let model = Model::from_json(text).map_err(raise)?;
        // `phugoid.Model` holds these two itself.
        Ok(PyModel(Model { noise: Default::default(), delays: Default::default(), ..model }))
    }
}
