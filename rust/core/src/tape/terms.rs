//! A log-density in the terms that its derivatives are put together from.

use crate::expr::graph::{Graph, Id};

/// A log-density rest − ½ Σ square² − Σ ρ − Σ log. What is left of its Hessian when the curvature of the residuals is
/// dropped (Gauss-Newton) is never indefinite, as long as `rest` is concave.
#[derive(Clone, Debug)]
pub struct Terms {
    /// Residuals over their standard deviation.
    pub squares: Vec<Id>,
    /// The terms that are not squares.
    pub losses: Vec<Loss>,
    /// The part that depends on parameters alone.
    pub rest: Id,
    /// Logarithms of standard deviations that are expressions of the model.
    pub logs: Vec<Id>,
}

/// ρ(r, η): a function of a residual r and of parameters η of its own.
#[derive(Clone, Debug)]
pub struct Loss {
    /// r, a function of states, data and parameters, but none of its own; 0 where the sample is missing.
    pub residual: Id,
    /// The symbol that stands for r in `value` and `weight`.
    pub argument: Id,
    /// η, symbols of parameters.
    pub own: Vec<Id>,
    /// ρ.
    pub value: Id,
    /// ω ≥ 0: takes the place of ∂²ρ/∂r² in Gauss-Newton's Hessian.
    pub weight: Id,
    /// 1 where the sample is there, 0 where it is missing; `None` where none is.
    pub present: Option<Id>,
}

/// A loss with its derivatives, the residual put in.
pub(super) struct Slopes {
    /// ρ
    pub value: Id,
    /// ∂ρ/∂r
    pub first: Id,
    curvature: Id,
    weight: Id,
    /// Place of each own parameter among the variables.
    own: Vec<usize>,
    /// ∂²ρ/∂r∂η
    mixed: Vec<Option<Id>>,
    /// ∂²ρ/∂η_i∂η_j and ∂ρ/∂η_i ∂ρ/∂η_j, i ≥ j.
    pairs: Vec<(Id, Id)>,
}

impl Loss {
    pub(super) fn slopes(&self, graph: &mut Graph, variables: &[Id]) -> Slopes {
        let zero = graph.zero();
        let first = graph.gradient(self.value, &[self.argument])[0].unwrap_or(zero);
        let curvature = graph.gradient(first, &[self.argument])[0].unwrap_or(zero);
        let mixed = graph.gradient(first, &self.own);
        let by_own = graph.gradient(self.value, &self.own);
        let mut found = vec![self.value, first, curvature, self.weight];
        found.extend(mixed.iter().map(|m| m.unwrap_or(zero)));
        let simple = found.len();
        for (i, slope) in by_own.iter().enumerate() {
            let slope = slope.unwrap_or(zero);
            let second = graph.gradient(slope, &self.own[..=i]);
            for (j, second) in second.into_iter().enumerate() {
                let other = by_own[j].unwrap_or(zero);
                found.extend([second.unwrap_or(zero), graph.mul(slope, other)]);
            }
        }
        let mut found = graph.replace(&found, &[self.argument], &[self.residual]);
        // Where nothing was measured, r is 0 and does not move, but ρ and its slopes in η are not 0.
        if let Some(present) = self.present {
            for at in std::iter::once(0).chain(simple..found.len()) {
                found[at] = graph.select(present, found[at], zero);
            }
        }
        let place = |id: &Id| variables.iter().position(|v| v == id).expect("own parameters are variables");
        Slopes {
            value: found[0],
            first: found[1],
            curvature: found[2],
            weight: found[3],
            own: self.own.iter().map(place).collect(),
            mixed: (4..simple)
                .map(|k| (graph.as_constant(found[k]) != Some(0.0)).then_some(found[k]))
                .collect(),
            pairs: found[simple..].chunks_exact(2).map(|p| (p[0], p[1])).collect(),
        }
    }
}

impl Slopes {
    /// Entry (a, b) of the Hessian without the curvature of r, exact and Gauss-Newton's; `slopes` are those of
    /// r with respect to both.
    pub(super) fn second(
        &self,
        graph: &mut Graph,
        (a, b): (usize, usize),
        slopes: (Option<Id>, Option<Id>),
    ) -> Option<(Id, Id)> {
        let own = |v: usize| self.own.iter().position(|&o| o == v);
        match (slopes, own(a), own(b)) {
            ((Some(x), Some(y)), ..) => {
                let product = graph.product(x, y);
                Some((graph.mul(self.curvature, product), graph.mul(self.weight, product)))
            }
            ((Some(x), None), _, Some(i)) | ((None, Some(x)), Some(i), _) => {
                let mixed = self.mixed[i]?;
                Some((graph.mul(mixed, x), graph.zero()))
            }
            (_, Some(i), Some(j)) => {
                let (i, j) = (i.max(j), i.min(j));
                Some(self.pairs[i * (i + 1) / 2 + j])
            }
            _ => None,
        }
    }
}
