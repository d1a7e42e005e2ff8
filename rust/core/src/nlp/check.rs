//! Derivatives against central differences, in the user's names.

use super::{ConstraintId, Nlp, NotFinite, VariableId};

/// An entry that differs from its difference quotient.
#[derive(Clone, Debug, PartialEq)]
pub struct Mismatch {
    /// The name of the entry: `d(defect of q, ...)/d(Mw)`.
    pub entry: String,
    /// The value computed.
    pub computed: f64,
    /// The difference quotient.
    pub difference: f64,
}

/// Compares the gradient, the Jacobian and the Hessian of the Lagrangian (at `lambda`) with central
/// differences, entry by entry, for the given columns. Entries may differ by
/// `tolerance · (1 + |entry|)`.
///
/// # Errors
/// When a function is not finite near `xi`.
pub fn check_derivatives(
    nlp: &dyn Nlp,
    xi: &[f64],
    lambda: &[f64],
    columns: &[VariableId],
    tolerance: f64,
) -> Result<Vec<Mismatch>, NotFinite> {
    let (n, m) = (nlp.n(), nlp.m());
    let mut gradient = vec![0.0; n];
    nlp.gradient(xi, &mut gradient)?;
    let mut jacobian = vec![0.0; nlp.jacobian_structure().len()];
    nlp.jacobian(xi, &mut jacobian)?;
    let mut hessian = vec![0.0; nlp.hessian_structure().len()];
    nlp.hessian(xi, 1.0, lambda, &mut hessian)?;

    // ∇φ + Jᵀλ, whose derivative the Hessian of the Lagrangian is.
    let lagrangian = |xi: &[f64]| -> Result<Vec<f64>, NotFinite> {
        let mut out = vec![0.0; n];
        nlp.gradient(xi, &mut out)?;
        let mut values = vec![0.0; nlp.jacobian_structure().len()];
        nlp.jacobian(xi, &mut values)?;
        let s = nlp.jacobian_structure();
        for ((&row, &column), value) in s.rows.iter().zip(&s.columns).zip(&values) {
            out[column as usize] += lambda[row as usize] * value;
        }
        Ok(out)
    };

    let mut wrong = Vec::new();
    for &j in columns {
        let step = 6e-6 * (1.0 + xi[j].abs());
        let shifted = |d: f64| {
            let mut x = xi.to_vec();
            x[j] += d;
            x
        };
        let (high, low) = (shifted(step), shifted(-step));
        let width = high[j] - low[j];
        let mut compare = |computed: f64, difference: f64, entry: &dyn Fn() -> String| {
            if (computed - difference).abs() > tolerance * (1.0 + computed.abs()) || !computed.is_finite() {
                wrong.push(Mismatch { entry: entry(), computed, difference });
            }
        };

        let slope = (nlp.objective(&high)? - nlp.objective(&low)?) / width;
        compare(gradient[j], slope, &|| format!("d(objective)/d({})", nlp.variable_name(j)));

        let (mut up, mut down, mut column) = (vec![0.0; m], vec![0.0; m], vec![0.0; m]);
        nlp.constraints(&high, &mut up)?;
        nlp.constraints(&low, &mut down)?;
        let s = nlp.jacobian_structure();
        for k in (0..s.len()).filter(|&k| s.columns[k] as usize == j.0) {
            column[s.rows[k] as usize] += jacobian[k];
        }
        for i in 0..m {
            let name = || format!("d({})/d({})", nlp.constraint_name(ConstraintId(i)), nlp.variable_name(j));
            compare(column[i], (up[i] - down[i]) / width, &name);
        }

        let (up, down, mut column) = (lagrangian(&high)?, lagrangian(&low)?, vec![0.0; n]);
        let s = nlp.hessian_structure();
        for ((&row, &col), value) in s.rows.iter().zip(&s.columns).zip(&hessian) {
            let (row, col) = (row as usize, col as usize);
            if col == j.0 {
                column[row] += value;
            } else if row == j.0 {
                column[col] += value;
            }
        }
        for i in 0..n {
            let name = || format!("d²L/d({})d({})", nlp.variable_name(VariableId(i)), nlp.variable_name(j));
            compare(column[i], (up[i] - down[i]) / width, &name);
        }
    }
    Ok(wrong)
}
