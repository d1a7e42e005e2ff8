//! A model's expressions with quantities put in.

use std::collections::HashMap;
use std::sync::Arc;

use super::{Equation, Model, TIME};
use crate::error::Error;
use crate::expr::Expr;
use crate::expr::graph::{Graph, Id};
use crate::noise::{Noise, Scale};

/// A model's expressions in one graph.
#[derive(Clone, Debug)]
pub struct Compiled {
    /// The graph.
    pub graph: Graph,
    /// Time and inputs: the data that f and g see.
    pub data: Vec<Id>,
    /// State symbols.
    pub states: Vec<Id>,
    /// Parameter symbols.
    pub parameters: Vec<Id>,
    /// Right-hand sides f, in the order of the states.
    pub dynamics: Vec<Id>,
    /// Outputs g.
    pub outputs: Vec<Id>,
    /// Right-hand sides of the conditions.
    pub conditions: Vec<Id>,
    /// Standard deviations of the noise that are expressions, by output.
    pub scales: Vec<Option<Id>>,
}

impl Model {
    /// The model's expressions in one graph, quantities put in where they are used.
    ///
    /// # Errors
    /// As [`Model::check`].
    pub fn compile(&self) -> Result<Compiled, Error> {
        self.check()?;
        let mut graph = Graph::new();
        let mut data = vec![graph.symbol(TIME)];
        data.extend(self.inputs.iter().map(|v| graph.symbol(&v.name)));
        let states = self.states.iter().map(|v| graph.symbol(&v.name)).collect();
        let parameters = self.parameters.iter().map(|p| graph.symbol(&p.name)).collect();
        let mut define: HashMap<Arc<str>, Id> = HashMap::new();
        for quantity in &self.quantities {
            let id = graph.import(&quantity.expr, &define);
            define.insert(quantity.name.as_str().into(), id);
        }
        let dynamics = self
            .states
            .iter()
            .map(|s| graph.import(&self.dynamics_of(&s.name).expect("checked").expr, &define))
            .collect();
        let outputs = self.outputs.iter().map(|e| graph.import(&e.expr, &define)).collect();
        let conditions = self.conditions.iter().map(|c| graph.import(&c.expr, &define)).collect();
        let scale = |o: &Equation| match self.noise.scale_of(&o.name) {
            Some(Scale::Expression(expr)) => Some(graph.import(expr, &define)),
            _ => None,
        };
        let scales = self.outputs.iter().map(scale).collect();
        Ok(Compiled { graph, data, states, parameters, dynamics, outputs, conditions, scales })
    }

    /// Writes the standard deviations of a noise that are expressions into the graph of the compiled model.
    ///
    /// # Errors
    /// Names the output whose expression has a symbol that the model does not have.
    pub(crate) fn scales(&self, noise: &Noise, graph: &mut Graph) -> Result<Vec<Option<Id>>, Error> {
        let define = self.definitions();
        let one = |(output, expr): (&Equation, Option<Expr>)| {
            let Some(expr) = expr else { return Ok(None) };
            self.check_scale(&output.name, &expr)?;
            Ok(Some(graph.import(&expr.substitute(&define), &HashMap::new())))
        };
        self.outputs.iter().zip(noise.expressions()).map(one).collect()
    }

    /// The quantities by name, with those before put in.
    pub(crate) fn definitions(&self) -> HashMap<Arc<str>, Expr> {
        let mut define: HashMap<Arc<str>, Expr> = HashMap::new();
        for quantity in &self.quantities {
            let expr = quantity.expr.substitute(&define);
            define.insert(quantity.name.as_str().into(), expr);
        }
        define
    }

    /// The right-hand sides with quantities put in, as expressions: f in the order of the states, then g.
    pub fn expanded(&self) -> (Vec<Expr>, Vec<Expr>) {
        let define = self.definitions();
        let expand = |e: &Equation| e.expr.substitute(&define);
        let dynamics = self.states.iter().filter_map(|s| self.dynamics_of(&s.name)).map(expand).collect();
        (dynamics, self.outputs.iter().map(expand).collect())
    }
}
