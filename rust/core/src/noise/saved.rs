//! Declared noise as it is saved with a model, by Rust or by Python.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use super::{Custom, Density, Dof, Joint, NoiseModel, Scale};
use crate::error::Error;
use crate::expr::Expr;
use crate::expr::pool::Pool;
use crate::pairs::Pairs;
use crate::parameter::Parameter;

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum SavedScale {
    Known { known: f64 },
    Expression { expression: String },
    Unknown { start: Option<f64>, bounds: Option<(f64, f64)> },
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum SavedDof {
    All(f64),
    ByName(Pairs<Option<f64>>),
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum SavedCovariance {
    Rows(Vec<Vec<f64>>),
    ByName(Pairs<Pairs<f64>>),
}

/// A parameter of a density: start, bounds, unit, whether it is fixed.
type SavedParameter = (f64, Option<f64>, Option<f64>, String, bool);

/// Noise other than independent Gaussian: its kind, and what this kind has.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub(crate) struct Kind {
    kind: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma: Option<Pairs<SavedScale>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    correlated: Option<bool>,
    /// `Some(None)` for one that is not known, which Python writes as null.
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<Option<SavedCovariance>>,
    /// `Some(None)` for unknown degrees of freedom.
    #[serde(skip_serializing_if = "Option::is_none")]
    dof: Option<Option<SavedDof>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    start: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bounds: Option<(f64, f64)>,
    #[serde(skip_serializing_if = "Option::is_none")]
    k: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    smoothing: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    log_density: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    parameters: Option<Pairs<SavedParameter>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    outputs: Option<Pairs<SavedNoise>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    noise: Option<Box<SavedNoise>>,
}

/// Noise as it is saved: of a kind, or scales by output where it is independent and Gaussian.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub(crate) enum SavedNoise {
    Gaussian(Pairs<SavedScale>),
    Other(Box<Kind>),
}

const GAUSSIAN: &str = "gaussian";
const STUDENT_T: &str = "student t";
const HUBER: &str = "huber";
const LAPLACE: &str = "laplace";
const CUSTOM: &str = "custom";
const PER_OUTPUT: &str = "per output";
const PER_EXPERIMENT: &str = "per experiment";

impl NoiseModel {
    /// Reads noise as it is saved with a model that has these outputs.
    ///
    /// # Errors
    /// For what is no noise of theirs.
    pub fn from_json(text: &str, outputs: &[&str]) -> Result<NoiseModel, Error> {
        let saved: SavedNoise =
            serde_json::from_str(text).map_err(|e| Error::model(format!("noise: it cannot be read: {e}")))?;
        saved.declared(outputs).map_err(Error::model)
    }
}

impl SavedNoise {
    /// The saved form; `None` for noise of which nothing is said.
    pub(crate) fn of(noise: &NoiseModel) -> Option<SavedNoise> {
        if *noise == NoiseModel::default() {
            return None;
        }
        if noise.per_experiment {
            let inner = NoiseModel { per_experiment: false, ..noise.clone() };
            let inner = SavedNoise::of(&inner).unwrap_or(SavedNoise::Gaussian(Pairs::default()));
            return Some(Kind { noise: Some(Box::new(inner)), ..Kind::new(PER_EXPERIMENT) }.into());
        }
        let scales = || noise.scales.iter().map(|(name, s)| (name.clone(), SavedScale::of(s))).collect();
        let kind = match &noise.joint {
            Joint::Known(matrix) => {
                let n = (matrix.len() as f64).sqrt().round().max(1.0) as usize;
                let rows = SavedCovariance::Rows(matrix.chunks(n).map(<[f64]>::to_vec).collect());
                Kind {
                    sigma: Some(Pairs::default()),
                    correlated: Some(false),
                    covariance: Some(Some(rows)),
                    ..Kind::new(GAUSSIAN)
                }
            }
            Joint::Unknown => {
                let sigma = Some(scales());
                Kind { sigma, correlated: Some(true), covariance: Some(None), ..Kind::new(GAUSSIAN) }
            }
            Joint::Independent if noise.densities.is_empty() => return Some(SavedNoise::Gaussian(scales())),
            Joint::Independent => {
                let of = |(name, d): &(String, Density)| (name.clone(), SavedNoise::of_density(d));
                let outputs = Some(noise.densities.iter().map(of).collect());
                Kind { sigma: Some(scales()), outputs, ..Kind::new(PER_OUTPUT) }
            }
        };
        Some(kind.into())
    }

    fn of_density(density: &Density) -> SavedNoise {
        let kind = |kind: &str| Kind { sigma: Some(Pairs::default()), ..Kind::new(kind) };
        match density {
            Density::Gaussian => return SavedNoise::Gaussian(Pairs::default()),
            Density::StudentT(Dof::Known(dof)) => Kind {
                dof: Some(Some(SavedDof::All(*dof))),
                bounds: Some((1.0, 100.0)), // which play no part
                ..kind(STUDENT_T)
            },
            Density::StudentT(Dof::Unknown { start, lower, upper }) => Kind {
                dof: Some(None),
                start: Some(*start),
                bounds: Some((*lower, *upper)),
                ..kind(STUDENT_T)
            },
            Density::Huber(k) => Kind { k: Some(*k), ..kind(HUBER) },
            Density::Laplace(s) => Kind { smoothing: Some(*s), ..kind(LAPLACE) },
            Density::Custom(custom) => {
                let one =
                    |p: &Parameter| (p.name.clone(), (p.start, p.lower, p.upper, p.unit.clone(), p.fixed));
                let text = Pool::new([&custom.log_density]).to_json().expect("expressions are plain data");
                Kind {
                    log_density: Some(text),
                    parameters: Some(custom.parameters.iter().map(one).collect()),
                    ..kind(CUSTOM)
                }
            }
        }
        .into()
    }

    /// The noise of a model with these outputs.
    ///
    /// # Errors
    /// Says what is missing, or of a kind that this release does not know.
    pub(crate) fn declared(&self, outputs: &[&str]) -> Result<NoiseModel, String> {
        let kind = match self {
            SavedNoise::Gaussian(scales) => {
                return Ok(NoiseModel { scales: plain(scales)?, ..NoiseModel::new() });
            }
            SavedNoise::Other(kind) => kind,
        };
        let scales = kind.sigma.as_ref().map(plain).transpose()?.unwrap_or_default();
        let joint = match (&kind.covariance, kind.correlated) {
            (Some(Some(covariance)), _) => Joint::Known(matrix(covariance, outputs)?),
            (_, Some(true)) => Joint::Unknown,
            _ => Joint::Independent,
        };
        let said = NoiseModel { scales, joint, ..NoiseModel::new() };
        match kind.kind.as_str() {
            GAUSSIAN => Ok(said),
            PER_EXPERIMENT => {
                let inner = kind.noise.as_ref().ok_or("noise: the noise of each experiment is missing")?;
                Ok(inner.declared(outputs)?.per_experiment())
            }
            PER_OUTPUT => {
                let each = kind.outputs.as_ref().ok_or("noise: there are no outputs")?;
                let mut densities = Vec::new();
                for (name, noise) in &each.0 {
                    let one = noise.declared(&[name])?;
                    densities.extend(one.densities.into_iter().filter(|d| d.0 == *name));
                }
                Ok(NoiseModel { densities, ..said })
            }
            _ => {
                let one = |name: &&str| Ok(((*name).to_owned(), kind.density(name)?));
                let densities = outputs.iter().map(one).collect::<Result<_, String>>()?;
                Ok(NoiseModel { densities, ..said })
            }
        }
    }
}

impl From<Kind> for SavedNoise {
    fn from(kind: Kind) -> Self {
        SavedNoise::Other(Box::new(kind))
    }
}

impl SavedScale {
    fn of(scale: &Scale) -> SavedScale {
        match scale {
            Scale::Known(known) => SavedScale::Known { known: *known },
            Scale::Unknown { start, bounds } => SavedScale::Unknown { start: *start, bounds: *bounds },
            Scale::Expression(expr) => SavedScale::Expression {
                expression: Pool::new([expr]).to_json().expect("expressions are plain data"),
            },
        }
    }
}

impl Kind {
    fn new(kind: &str) -> Kind {
        Kind { kind: kind.to_owned(), ..Kind::default() }
    }

    /// The density of one output.
    fn density(&self, output: &str) -> Result<Density, String> {
        let need = |what: Option<f64>, name: &str| {
            what.ok_or_else(|| format!("noise of kind '{}': it has no {name}", self.kind))
        };
        match self.kind.as_str() {
            STUDENT_T => {
                let dof = match &self.dof {
                    Some(Some(SavedDof::All(dof))) => Some(*dof),
                    // Those not named are as they are where nothing is said.
                    Some(Some(SavedDof::ByName(each))) => {
                        each.0.iter().find(|d| d.0 == output).map_or(Some(4.0), |d| d.1)
                    }
                    _ => None,
                };
                let (lower, upper) = self.bounds.unwrap_or((1.0, 100.0));
                let start = self.start.unwrap_or_else(|| 10f64.max(lower).min(upper));
                Ok(Density::StudentT(dof.map_or(Dof::Unknown { start, lower, upper }, Dof::Known)))
            }
            HUBER => Ok(Density::Huber(need(self.k, "k")?)),
            LAPLACE => Ok(Density::Laplace(need(self.smoothing, "smoothing")?)),
            CUSTOM => {
                let text = self.log_density.as_deref().ok_or("noise: there is no log-density")?;
                let exprs = Pool::from_json(text).and_then(|p| p.expressions())?;
                let expr = exprs.first().ok_or("noise: there is no log-density")?;
                let (mut parameters, mut fixed) = (Vec::new(), HashMap::new());
                for (name, (start, lower, upper, unit, held)) in
                    self.parameters.as_ref().map_or(&[][..], |p| &p.0[..])
                {
                    if *held {
                        fixed.insert(name.as_str().into(), Expr::constant(*start));
                        continue;
                    }
                    let unit = unit.clone();
                    let (lower, upper) = (*lower, *upper);
                    parameters.push(Parameter { lower, upper, unit, ..Parameter::new(name, *start) });
                }
                Ok(Density::Custom(Custom { log_density: expr.substitute(&fixed), parameters }))
            }
            other => Err(format!("noise of kind '{other}' is not known; was it saved by a newer version?")),
        }
    }
}

fn plain(scales: &Pairs<SavedScale>) -> Result<Vec<(String, Scale)>, String> {
    let one = |s: &SavedScale| -> Result<Scale, String> {
        Ok(match s {
            SavedScale::Known { known } => Scale::Known(*known),
            SavedScale::Unknown { start, bounds } => Scale::Unknown { start: *start, bounds: *bounds },
            SavedScale::Expression { expression } => {
                let exprs = Pool::from_json(expression).and_then(|p| p.expressions())?;
                Scale::Expression(exprs.into_iter().next().ok_or("noise: an expression is missing")?)
            }
        })
    };
    scales.0.iter().map(|(name, s)| Ok((name.clone(), one(s)?))).collect()
}

/// Row by row, in the order of the outputs.
fn matrix(saved: &SavedCovariance, outputs: &[&str]) -> Result<Vec<f64>, String> {
    let n = outputs.len();
    let mut matrix = vec![0.0; n * n];
    match saved {
        SavedCovariance::Rows(rows) if rows.len() == n && rows.iter().all(|r| r.len() == n) => {
            return Ok(rows.concat());
        }
        SavedCovariance::Rows(rows) => {
            return Err(format!("noise: the covariance has {} rows, but there are {n} outputs", rows.len()));
        }
        SavedCovariance::ByName(rows) => {
            let place = |name: &str| {
                let found = outputs.iter().position(|o| *o == name);
                found.ok_or_else(|| format!("noise: '{name}' of the covariance is not an output"))
            };
            for (a, row) in &rows.0 {
                for (b, value) in &row.0 {
                    let (a, b) = (place(a)?, place(b)?);
                    (matrix[a * n + b], matrix[b * n + a]) = (*value, *value);
                }
            }
        }
    }
    Ok(matrix)
}
