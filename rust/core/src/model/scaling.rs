//! Scalings of states and parameters that leave all outputs unchanged: x → sᵃ x, θ → sᵇ θ.
//!
//! Every symbol has an unknown exponent. A product adds the exponents of its factors, a power multiplies one; the
//! terms of a sum have one exponent, and the argument of a transcendental function has exponent 0, as have inputs,
//! time, numbers, outputs, standard deviations of the noise, and parameters that are fixed or have a prior. A state's right-hand side has the exponent of
//! the state. What solves these linear equations leaves all outputs as they are, for any s > 0.

use std::collections::{BTreeMap, BTreeSet};

use super::Model;
use crate::error::Error;
use crate::expr::Op;
use crate::expr::graph::{Graph, Id, Item};

/// A family of models with the same outputs: each quantity is multiplied by s to the power of its exponent.
#[derive(Clone, Debug, PartialEq)]
pub struct Scaling {
    /// Names and exponents, none of them 0: states, then parameters. That of the first is 1.
    pub exponents: Vec<(String, f64)>,
    /// The parameter that is best held, so that this scaling is no longer free.
    pub held: String,
    /// The value at which it is held: its start, unless that is 0.
    pub at: f64,
}

impl Scaling {
    /// Whether it scales a quantity; of a parameter with a value for each experiment, `name[experiment]`, too.
    pub fn scales(&self, name: &str) -> bool {
        self.exponents.iter().any(|e| e.0 == stem(name))
    }

    /// Whether a parameter is the one to hold, likewise.
    pub fn holds(&self, name: &str) -> bool {
        self.held == stem(name)
    }

    /// Says which quantities are free to scale, and what to fix.
    pub fn advice(&self, model: &Model) -> String {
        let power = |e: f64| match e {
            1.0 => "s".into(),
            e if e > 0.0 => format!("s**{}", significant(e, 4)),
            e => format!("s**({})", significant(e, 4)),
        };
        if let [(name, _)] = &self.exponents[..] {
            let at = significant(self.at, 6);
            return format!(
                "The size of {name} has no influence on the outputs, whatever the data; it was fixed at {at}. Remove it from the \
                 model, fix it, or give it a prior"
            );
        }
        let is_state = |name: &str| model.states.iter().any(|s| s.name == name);
        let scaled: Vec<String> = self.exponents.iter().map(|(n, e)| format!("{n}*{}", power(*e))).collect();
        let names: Vec<&str> = self.exponents.iter().map(|e| e.0.as_str()).collect();
        let (states, parameters): (Vec<&str>, Vec<&str>) = names.iter().partition(|n| is_state(n));
        let fix = match parameters[..] {
            [one] => format!("fix {one}"),
            _ => format!("fix one of {}", parameters.join(", ")),
        };
        let known = match &states[..] {
            [] => String::new(),
            own => format!(", or give {} a known initial value", own[..own.len().min(3)].join(" or ")),
        };
        format!(
            "{} cannot be distinguished with any data: the outputs stay the same with {} for every s > 0; {} was fixed at {}. \
             To determine them {fix}{known}, or give one a prior",
            names.join(", "),
            scaled.join(", "),
            self.held,
            significant(self.at, 6)
        )
    }
}

/// A number to so many significant digits.
fn significant(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap_or(value)
}

/// Exponents below this are 0.
const NOTHING: f64 = 1e-9;

impl Model {
    /// The scalings with at least one parameter that leave all outputs unchanged, with one parameter to hold for each.
    /// `starts` holds the parameters' starting values.
    ///
    /// ```
    /// use phugoid::{Model, Parameter};
    ///
    /// let mut m = Model::new("gain");
    /// let (x, u) = (m.state("x", "")?, m.input("u", "V")?);
    /// let (b, c) = (m.parameter(Parameter::new("b", 1.0))?, m.parameter(Parameter::new("c", 1.0))?);
    /// m.equation("x", b * u - &x)?;
    /// m.output("y", c * x, "")?;
    ///
    /// let found = m.scalings(&[1.0, 1.0])?; // x may be in any unit
    /// assert_eq!(found[0].exponents, [("x".into(), 1.0), ("b".into(), 1.0), ("c".into(), -1.0)]);
    /// assert_eq!(found[0].held, "b");
    /// # Ok::<(), phugoid::Error>(())
    /// ```
    ///
    /// # Errors
    /// As [`Model::check`].
    pub fn scalings(&self, starts: &[f64]) -> Result<Vec<Scaling>, Error> {
        let compiled = self.compile()?;
        let n_x = self.states.len();
        // Columns: states, then parameters, those that are best held last. What is free is a last column.
        let mut free: Vec<usize> = (0..self.parameters.len())
            .filter(|&i| !self.parameters[i].fixed && self.parameters[i].prior.is_none())
            .filter(|&i| !self.delays.parameters().contains(&self.parameters[i].name.as_str()))
            .collect();
        free.sort_by_key(|&i| (starts[i] != 0.0, !self.parameters[i].local, std::cmp::Reverse(i)));
        let names: Vec<&str> = (self.states.iter().map(|s| s.name.as_str()))
            .chain(free.iter().map(|&i| self.parameters[i].name.as_str()))
            .collect();
        let known_zero: Vec<&str> =
            (self.parameters.iter()).filter(|p| p.fixed && p.start == 0.0).map(|p| p.name.as_str()).collect();

        let mut equations = Equations::new(names.len());
        let scales: Vec<Id> = compiled.scales.iter().flatten().copied().collect();
        let roots = [&compiled.dynamics[..], &compiled.outputs, &compiled.conditions, &scales].concat();
        let exponents = exponents(&compiled.graph, &roots, &names, &known_zero, &mut equations);
        let unit = |i: usize| Exponent::Of((0..names.len()).map(|k| f64::from(u8::from(k == i))).collect());
        for (i, id) in compiled.dynamics.iter().enumerate() {
            equations.equal(&exponents[id], &unit(i));
        }
        for id in compiled.outputs.iter().chain(&scales) {
            equations.none(&exponents[id]);
        }
        for (c, id) in self.conditions.iter().zip(&compiled.conditions) {
            if let Some(i) = self.states.iter().position(|s| s.name == c.state) {
                equations.equal(&exponents[id], &unit(i));
            }
        }
        // A symbol that is in none of the equations scales alone, and is no concern of ours.
        let scaling = |(column, vector): (usize, Vec<f64>)| {
            let parameter = free.get(column.checked_sub(n_x)?)?;
            let held = &self.parameters[*parameter];
            let order = (0..n_x).chain(
                (0..self.parameters.len()).filter_map(|i| free.iter().position(|&f| f == i).map(|k| n_x + k)),
            );
            let there: Vec<usize> = order.filter(|&k| vector[k].abs() > NOTHING).collect();
            let unit = vector[*there.first()?];
            let exponents = there.iter().map(|&k| (names[k].to_owned(), vector[k] / unit)).collect();
            let (low, high) = (held.lower.unwrap_or(f64::NEG_INFINITY), held.upper.unwrap_or(f64::INFINITY));
            let at = match starts[*parameter] {
                0.0 if high > 0.0 => high.min(low.max(1.0)),
                0.0 => low.max(-1.0),
                start => start,
            };
            Some(Scaling { exponents, held: held.name.clone(), at })
        };
        Ok(equations.directions().into_iter().rev().filter_map(scaling).collect())
    }
}

/// The factor of a node.
#[derive(Clone, Debug)]
enum Exponent {
    /// The node is zero, which may be multiplied by anything.
    Any,
    /// A power of s, a combination of the unknown exponents.
    Of(Vec<f64>),
}

/// Exponents of the nodes that `roots` are made of; what they must meet is added to the equations.
fn exponents(
    graph: &Graph,
    roots: &[Id],
    names: &[&str],
    zero: &[&str],
    equations: &mut Equations,
) -> BTreeMap<Id, Exponent> {
    let none = || Exponent::Of(vec![0.0; names.len()]);
    let (mut reached, mut stack) = (BTreeSet::new(), roots.to_vec());
    while let Some(id) = stack.pop() {
        if reached.insert(id) {
            stack.extend(graph.args(id));
        }
    }
    let mut found: BTreeMap<Id, Exponent> = BTreeMap::new();
    for id in reached {
        let args: Vec<Id> = graph.args(id);
        let of = |k: usize| found[&args[k]].clone();
        let exponent = match graph.item(id) {
            Item::Constant(bits) if f64::from_bits(bits) == 0.0 => Exponent::Any,
            Item::Constant(_) => none(),
            Item::Symbol(_) => match graph.symbol_name(id).map(|n| &**n) {
                Some(name) if zero.contains(&name) => Exponent::Any,
                name => Exponent::Of(names.iter().map(|n| f64::from(u8::from(Some(*n) == name))).collect()),
            },
            Item::Apply(op, _) => match op {
                Op::Add | Op::Sub | Op::Min | Op::Max | Op::Hypot => equations.equal(&of(0), &of(1)),
                Op::Mul => combined(&of(0), 1.0, &of(1), 1.0),
                Op::Div => combined(&of(0), 1.0, &of(1), -1.0),
                Op::Neg | Op::Abs => of(0),
                Op::Recip => combined(&of(0), -1.0, &none(), 0.0),
                Op::Sqrt => combined(&of(0), 0.5, &none(), 0.0),
                Op::Pow => match graph.as_constant(args[1]) {
                    Some(power) => combined(&of(0), power, &none(), 0.0),
                    None => {
                        equations.none(&of(0));
                        equations.none(&of(1));
                        none()
                    }
                },
                Op::Sign => none(),
                Op::Lt | Op::Le | Op::Atan2 => {
                    equations.equal(&of(0), &of(1));
                    none()
                }
                Op::Where => {
                    equations.none(&of(0));
                    equations.equal(&of(1), &of(2))
                }
                Op::Exp
                | Op::Expm1
                | Op::Log
                | Op::Log1p
                | Op::Sin
                | Op::Cos
                | Op::Tan
                | Op::Asin
                | Op::Acos
                | Op::Atan
                | Op::Sinh
                | Op::Cosh
                | Op::Tanh
                | Op::And
                | Op::Or
                | Op::Not => {
                    (0..args.len()).for_each(|k| equations.none(&of(k)));
                    none()
                }
            },
            Item::Lookup(..) => {
                (0..args.len()).for_each(|k| equations.none(&of(k)));
                none()
            }
        };
        found.insert(id, exponent);
    }
    found
}

fn combined(a: &Exponent, of_a: f64, b: &Exponent, of_b: f64) -> Exponent {
    match (a, b) {
        (Exponent::Of(a), Exponent::Of(b)) => {
            Exponent::Of(a.iter().zip(b).map(|(a, b)| of_a * a + of_b * b).collect())
        }
        _ => Exponent::Any,
    }
}

/// Homogeneous linear equations, reduced as they come: each row has a leading 1 where all others have 0.
struct Equations {
    n: usize,
    rows: Vec<(usize, Vec<f64>)>,
}

impl Equations {
    fn new(n: usize) -> Equations {
        Equations { n, rows: Vec::new() }
    }

    /// Two exponents are one, which is returned.
    fn equal(&mut self, a: &Exponent, b: &Exponent) -> Exponent {
        match (a, b) {
            (Exponent::Of(x), Exponent::Of(y)) => {
                self.add(x.iter().zip(y).map(|(x, y)| x - y).collect());
                a.clone()
            }
            (Exponent::Any, other) | (other, Exponent::Any) => other.clone(),
        }
    }

    /// An exponent is 0.
    fn none(&mut self, a: &Exponent) {
        if let Exponent::Of(x) = a {
            self.add(x.clone());
        }
    }

    fn add(&mut self, mut row: Vec<f64>) {
        for (lead, other) in &self.rows {
            let factor = row[*lead];
            if factor != 0.0 {
                row.iter_mut().zip(other).for_each(|(x, y)| *x -= factor * y);
            }
        }
        let Some(lead) = row.iter().position(|x| x.abs() > NOTHING) else { return };
        let scale = row[lead];
        row.iter_mut().for_each(|x| *x /= scale);
        for (_, other) in &mut self.rows {
            let factor = other[lead];
            if factor != 0.0 {
                other.iter_mut().zip(&row).for_each(|(x, y)| *x -= factor * y);
            }
        }
        self.rows.push((lead, row));
    }

    /// A basis of the solutions, each with the one column, the last it has, that no other has.
    fn directions(&self) -> Vec<(usize, Vec<f64>)> {
        let free = (0..self.n).filter(|c| self.rows.iter().all(|(lead, _)| lead != c));
        let direction = |c: usize| {
            let mut vector = vec![0.0; self.n];
            vector[c] = 1.0;
            self.rows.iter().for_each(|(lead, row)| vector[*lead] = -row[c]);
            (c, vector)
        };
        free.map(direction).collect()
    }
}

/// The name of a parameter without that of an experiment.
fn stem(name: &str) -> &str {
    name.split('[').next().unwrap_or(name)
}
