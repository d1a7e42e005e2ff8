//! A point with the values of objective and constraints there.

use super::program::Program;
use crate::interrupt::Interrupt;
use crate::nlp::NotFinite;

/// φ and c at ξ.
#[derive(Clone, Debug)]
pub(crate) struct Point {
    pub xi: Vec<f64>,
    pub objective: f64,
    pub c: Vec<f64>,
    /// Σ |c| in units.
    pub defect: f64,
    /// max |c| in units.
    pub worst: f64,
}

impl Point {
    /// The point to start from, within bounds. It is always evaluated: it may be all that is left of a run.
    ///
    /// # Errors
    /// [`NotFinite`] when a function is not finite there.
    pub fn first(program: &Program<'_>, start: &[f64]) -> Result<Point, NotFinite> {
        let xi = start.iter().enumerate().map(|(i, x)| program.within(i, *x)).collect();
        let c = vec![0.0; program.nlp.m()];
        let mut point = Point { xi, objective: f64::NAN, c, defect: f64::NAN, worst: f64::NAN };
        Interrupt::shielded(|| point.evaluate(program))?;
        Ok(point)
    }

    /// Evaluates φ and c at ξ.
    pub fn evaluate(&mut self, program: &Program<'_>) -> Result<(), NotFinite> {
        program.constraints(&self.xi, &mut self.c)?;
        (self.defect, self.worst) = (0.0, 0.0);
        for (c, unit) in self.c.iter().zip(program.units.each()) {
            let size = c.abs() / unit;
            self.defect += size;
            self.worst = size.max(self.worst);
        }
        self.evaluate_objective(program)?;
        if self.defect.is_finite() { Ok(()) } else { Err(NotFinite) }
    }

    /// Evaluates φ alone.
    pub fn evaluate_objective(&mut self, program: &Program<'_>) -> Result<(), NotFinite> {
        self.objective = program.objective(&self.xi)?;
        Ok(())
    }

    /// Takes over another point.
    pub fn copy(&mut self, other: &Point) {
        self.xi.copy_from_slice(&other.xi);
        self.c.copy_from_slice(&other.c);
        (self.objective, self.defect, self.worst) = (other.objective, other.defect, other.worst);
    }

    /// Goes to base + α d, within bounds, and evaluates; whether all is finite there.
    pub fn step(&mut self, program: &Program<'_>, base: &[f64], alpha: f64, d: &[f64]) -> bool {
        for (i, x) in self.xi.iter_mut().enumerate() {
            *x = program.within(i, alpha.mul_add(d[i], base[i]));
        }
        self.evaluate(program).is_ok()
    }

    /// Moves on by d, likewise.
    pub fn correct(&mut self, program: &Program<'_>, d: &[f64]) -> bool {
        for (i, x) in self.xi.iter_mut().enumerate() {
            *x = program.within(i, *x + d[i]);
        }
        self.evaluate(program).is_ok()
    }
}
