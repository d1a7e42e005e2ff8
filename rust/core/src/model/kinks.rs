//! Where the state equations have kinks and jumps.

use std::collections::HashSet;
use std::sync::Arc;

use super::Model;
use crate::expr::{Expr, Node, Op};

impl Model {
    /// The operations with a kink or a jump that act on states, in quantities and state equations: the name of the
    /// quantity or the state with a prime, the name of the operation, and the expression as text.
    ///
    /// ```
    /// let mut m = phugoid::Model::new("friction");
    /// let v = m.state("v", "m/s")?;
    /// m.equation("v", -v.sign(), None)?;
    /// assert_eq!(m.kinks(), [("v'".into(), "sign", "sign(v)".into())]);
    /// # Ok::<(), phugoid::Error>(())
    /// ```
    pub fn kinks(&self) -> Vec<(String, &'static str, String)> {
        let mut moving: HashSet<Arc<str>> = self.states.iter().map(|s| s.name.as_str().into()).collect();
        let mut found = Vec::new();
        let mut look = |place: String, expr: &Expr, moving: &HashSet<Arc<str>>| {
            expr.visit(|e| {
                if let Node::Apply(op @ (Op::Abs | Op::Sign | Op::Min | Op::Max | Op::Where), _) = e.node()
                    && e.symbols().iter().any(|s| moving.contains(s))
                {
                    found.push((place.clone(), op.entry().name, e.to_string()));
                }
            });
        };
        for quantity in &self.quantities {
            look(quantity.name.clone(), &quantity.expr, &moving);
            if quantity.expr.symbols().iter().any(|s| moving.contains(s)) {
                moving.insert(quantity.name.as_str().into());
            }
        }
        for equation in &self.dynamics {
            look(format!("{}'", equation.name), &equation.expr, &moving);
        }
        found
    }
}
