//! Explicit Runge-Kutta methods, by their Butcher tableaus.

/// A Runge-Kutta method of fixed steps (Eq. integ_method).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Integrator {
    /// Euler's, of order 1.
    Euler,
    /// Heun's, of order 2: the explicit trapezoid.
    Heun,
    /// Kutta's, of order 3.
    Kutta,
    /// The classical one of order 4.
    #[default]
    Rk4,
    /// The tableau of Dormand and Prince (1980) of order 5. Its step stays fixed, or the likelihood would jump.
    DormandPrince,
}

/// ẋ is evaluated at stages x + h Σ a k, at the times t + c h; then x moves on by h Σ b k.
#[derive(Clone, Debug)]
pub(crate) struct Tableau {
    pub(crate) a: Vec<Vec<f64>>,
    pub(crate) b: Vec<f64>,
    pub(crate) c: Vec<f64>,
}

impl Integrator {
    /// All of them, by order.
    pub const ALL: [Integrator; 5] =
        [Integrator::Euler, Integrator::Heun, Integrator::Kutta, Integrator::Rk4, Integrator::DormandPrince];

    /// Returns the name of the method.
    pub fn name(self) -> &'static str {
        match self {
            Integrator::Euler => "euler",
            Integrator::Heun => "heun",
            Integrator::Kutta => "kutta",
            Integrator::Rk4 => "rk4",
            Integrator::DormandPrince => "dopri5",
        }
    }

    /// The one of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|i| i.name() == name)
    }

    /// Returns the order: the error of a solution falls with this power of the step, as far as f is smooth.
    pub fn order(self) -> usize {
        Self::ALL.iter().position(|i| *i == self).map_or(0, |at| at + 1)
    }

    pub(crate) fn tableau(self) -> Tableau {
        let (a, b): (&[&[f64]], &[f64]) = match self {
            Integrator::Euler => (&[&[]], &[1.0]),
            Integrator::Heun => (&[&[], &[1.0]], &[0.5, 0.5]),
            Integrator::Kutta => (&[&[], &[0.5], &[-1.0, 2.0]], &[1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0]),
            Integrator::Rk4 => {
                (&[&[], &[0.5], &[0.0, 0.5], &[0.0, 0.0, 1.0]], &[1.0 / 6.0, 2.0 / 6.0, 2.0 / 6.0, 1.0 / 6.0])
            }
            // The seventh stage serves the estimate of the error, and is left out.
            Integrator::DormandPrince => (
                &[
                    &[],
                    &[1.0 / 5.0],
                    &[3.0 / 40.0, 9.0 / 40.0],
                    &[44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0],
                    &[19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0],
                    &[9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0],
                ],
                &[35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
            ),
        };
        // A stage stands at the time to which its own derivatives would carry time itself.
        let c = a.iter().map(|row| row.iter().sum()).collect();
        Tableau { a: a.iter().map(|row| row.to_vec()).collect(), b: b.to_vec(), c }
    }
}
