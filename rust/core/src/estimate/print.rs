//! A fit as text.

use std::fmt;

use super::fit::{Estimate, Fit, Record};

impl fmt::Display for Fit {
    /// How the run went, the estimates, and how well each output is matched.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let samples: usize = self.records.iter().map(|r| r.t.len()).sum();
        let points: usize = self.records.iter().map(|r| r.mesh_t.len()).sum();
        let runs = match self.records.len() {
            1 => String::new(),
            n => format!("{n} experiments, "),
        };
        writeln!(f, "{}", self.model.name)?;
        writeln!(f, "  status          {}: {}", self.status, self.message)?;
        writeln!(f, "  iterations      {} in {:.3} s", self.iterations, self.solution.time.as_secs_f64())?;
        writeln!(f, "  log-likelihood  {:.6}", self.log_likelihood)?;
        writeln!(f, "  data            {runs}{samples} samples, {points} mesh points\n")?;
        table(
            f,
            &["parameter", "estimate", "std. error", "unit", ""],
            self.parameters.iter().map(estimate_row),
        )?;
        writeln!(f)?;
        let header = ["output", "RMS residual", "samples", "unit", ""];
        table(f, &header, (0..self.model.outputs.len()).map(|i| self.match_row(i)))?;
        self.warnings.iter().try_for_each(|w| write!(f, "\nwarning: {w}\n"))
    }
}

impl Fit {
    fn match_row(&self, i: usize) -> [String; 5] {
        let residuals = |r: &Record| r.residuals[i].clone();
        let r: Vec<f64> = self.records.iter().flat_map(residuals).filter(|r| !r.is_nan()).collect();
        let rms = (r.iter().map(|r| r * r).sum::<f64>() / r.len() as f64).sqrt();
        let rms = if self.feasible { number(rms, 4) } else { String::new() };
        let output = &self.model.outputs[i];
        [output.name.clone(), rms, r.len().to_string(), output.unit.clone(), String::new()]
    }
}

fn estimate_row(e: &Estimate) -> [String; 5] {
    let error = if e.std_error.is_nan() { String::new() } else { number(e.std_error, 2) };
    let bound = e.bound.map(|b| b.to_string()).unwrap_or_default();
    [e.name.clone(), number(e.value, 7), error, e.unit.clone(), bound]
}

/// A number with so many significant digits.
pub(super) fn number(value: f64, digits: i32) -> String {
    let exponent = if value == 0.0 { 0 } else { value.abs().log10().floor() as i32 };
    if value.is_finite() && (-4..6).contains(&exponent) {
        format!("{value:.*}", (digits - 1 - exponent).max(0) as usize)
    } else {
        format!("{value:.*e}", digits as usize - 1)
    }
}

/// A number with so many significant digits, without zeros at the end.
pub(super) fn short(value: f64, digits: i32) -> String {
    let text = number(value, digits);
    let (digits, exponent) = text.split_once('e').unwrap_or((&text, ""));
    let digits =
        if digits.contains('.') { digits.trim_end_matches('0').trim_end_matches('.') } else { digits };
    if exponent.is_empty() { digits.to_owned() } else { format!("{digits}e{exponent}") }
}

/// Columns as wide as what they hold; numbers, which stand second and third, to the right.
fn table(
    f: &mut fmt::Formatter<'_>,
    header: &[&str; 5],
    rows: impl Iterator<Item = [String; 5]>,
) -> fmt::Result {
    let rows: Vec<[String; 5]> = std::iter::once(header.map(str::to_owned)).chain(rows).collect();
    let width = |c: usize| rows.iter().map(|r| r[c].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..5).map(width).collect();
    for row in &rows {
        let cell = |c: usize| match c {
            1 | 2 => format!("{:>1$}", row[c], widths[c]),
            _ => format!("{:1$}", row[c], widths[c]),
        };
        let line = (0..5).map(cell).collect::<Vec<String>>().join("  ");
        writeln!(f, "  {}", line.trim_end())?;
    }
    Ok(())
}
