//! The Newton system within bounds: a quadratic program, whose matrix is factorised once, and in which only the few
//! bounded variables change sides.

use super::active_set::ActiveSet;
use super::damping::{Damping, ROUNDED, damps};
use super::iterate::Iterate;
use super::program::Program;
use super::promise::Promise;
use super::step::Step;
use crate::linalg::{Curvature, Direction, Effort, Factor, KktChoice, KktError, KktSolver};
use crate::nlp::NotFinite;

/// Why there is no step.
#[derive(Clone, Copy, Debug)]
pub(super) enum NoStep {
    /// A derivative is not finite.
    NotFinite,
    /// The system cannot be factorised.
    Singular(KktError),
    /// No shift makes it positive.
    NotPositive,
}

impl From<NotFinite> for NoStep {
    fn from(_: NotFinite) -> NoStep {
        NoStep::NotFinite
    }
}

/// The Newton system of a program: its linear algebra, active set and damping.
pub(super) struct NewtonSystem {
    pub(super) kkt: Box<dyn KktSolver>,
    pub(super) active: ActiveSet,
    pub(super) damping: Damping,
    /// Which matrix the factor is of: the moves of the iterate, whether the exact Hessian was asked for, and whether it is
    /// that.
    factorised: Option<(u64, bool, bool)>,
    /// Scratch: right-hand sides.
    pub(super) p: Vec<f64>,
    pub(super) q: Vec<f64>,
}

impl NewtonSystem {
    pub fn new(program: &Program<'_>, kkt: &KktChoice) -> NewtonSystem {
        NewtonSystem {
            kkt: kkt.take_or_make(program.nlp, &program.units.states),
            active: ActiveSet::new(program),
            damping: Damping::new(),
            factorised: None,
            p: vec![0.0; program.nlp.n()],
            q: vec![0.0; program.nlp.m()],
        }
    }

    pub fn flops(&self) -> u64 {
        self.kkt.flops()
    }

    /// Hands over what factorises the system, for other systems of the program.
    pub fn into_kkt(self) -> Box<dyn KktSolver> {
        self.kkt
    }

    /// Evaluates derivatives at the iterate, and factorises the system there with the exact Hessian, if that is positive along the constraints, else
    /// with that of Gauss and Newton, shifted until it is.
    pub fn factorise(
        &mut self,
        program: &Program<'_>,
        iterate: &mut Iterate,
        exact: bool,
        hurry: bool,
    ) -> Result<Factored<'_>, NoStep> {
        let is_exact = self.eliminate(program, iterate, exact, hurry)?;
        let NewtonSystem { kkt, active, damping, factorised, p, q } = self;
        let factor = kkt.factor().expect("it is eliminated");
        active.begin(program, iterate, if exact { 0..0 } else { program.nlp.profiled() });
        let mut system = Factored { factor, active, damping, p, q, is_exact };
        let mut found = system.finish();
        if is_exact && !(found.is_positive() || system.is_nearly_positive()) {
            // Far from the end after all, or on a ridge.
            *factorised = None;
            iterate.gauss_newton(program)?;
            program.count(|e| e.factorizations += 1);
            system.factor.replace_hessian(&iterate.entries()).map_err(NoStep::Singular)?;
            system.is_exact = false;
            found = system.finish();
            system.regularise(found)?;
        } else if !is_exact {
            system.regularise(found)?;
        }
        Ok(system)
    }

    /// Eliminates at the iterate, unless the last factor is of the same matrix, as after a step that failed and is damped
    /// more; whether the Hessian is the exact one.
    fn eliminate(
        &mut self,
        program: &Program<'_>,
        iterate: &mut Iterate,
        exact: bool,
        hurry: bool,
    ) -> Result<bool, NoStep> {
        if let Some((moves, asked, is_exact)) = self.factorised
            && (moves, asked) == (iterate.moves(), exact)
        {
            return Ok(is_exact);
        }
        self.factorised = None;
        iterate.evaluate(program)?;
        let is_exact = exact && iterate.exact_hessian(program).is_ok();
        if !is_exact {
            iterate.gauss_newton(program)?;
        }
        program.count(|e| e.factorizations += 1);
        let effort = Effort { refine: exact, hurry };
        self.kkt.factorize(&iterate.entries(), effort).map_err(NoStep::Singular)?;
        self.factorised = Some((iterate.moves(), exact, is_exact));
        Ok(is_exact)
    }
}

/// The system at an iterate, factorised.
pub(super) struct Factored<'a> {
    factor: &'a mut dyn Factor,
    active: &'a mut ActiveSet,
    pub damping: &'a mut Damping,
    p: &'a mut [f64],
    q: &'a mut [f64],
    /// Whether the Hessian is the exact one.
    is_exact: bool,
}

impl Factored<'_> {
    fn finish(&mut self) -> Curvature {
        self.factor.finish(self.active.held(), self.damping.shift())
    }

    /// Whether the exact system lacks no more than what rounding takes where the data hardly tell: then it is shifted
    /// by that. Gauss-Newton steps could circle about such an optimum for long.
    fn is_nearly_positive(&mut self) -> bool {
        let before = self.damping.shift();
        for shift in ROUNDED {
            self.damping.set(shift.max(before));
            if self.finish().is_positive() {
                return true;
            }
        }
        self.damping.set(before);
        false
    }

    /// Shifts the system until it is positive.
    fn regularise(&mut self, mut found: Curvature) -> Result<(), NoStep> {
        while !found.is_positive() {
            if !self.damping.raise(1e-10) {
                return Err(NoStep::NotPositive);
            }
            found = self.finish();
        }
        Ok(())
    }

    /// Whether there is more shift than makes a singular system regular.
    pub fn is_damped(&self) -> bool {
        damps(self.damping.shift())
    }

    /// Takes away what shift the system does not need to be positive; whether it is still of use, and not an exact one
    /// that needs some.
    pub fn relieve(&mut self) -> Result<bool, NoStep> {
        self.damping.set(0.0);
        let found = self.finish();
        if self.is_exact && !found.is_positive() {
            return Ok(false);
        }
        self.regularise(found).map(|()| true)
    }

    /// Solves for the step within bounds.
    pub fn step(&mut self, program: &Program<'_>, iterate: &Iterate, step: &mut Step) -> Promise {
        let most = self.active.rounds();
        let before = self.settle(program, iterate, step);
        self.solve(program, iterate, step);
        for round in before..most {
            // Releasing is given up at last, so that this ends.
            if !self.active.change(program, iterate, step, self.p, round < most / 2) {
                break;
            }
            let found = self.finish();
            // The equations may leave the last state no choice, given the others that are held.
            let released = !found.is_positive() && self.active.release_last();
            if released {
                self.finish();
            }
            self.solve(program, iterate, step);
            if released {
                break;
            }
        }
        self.active.end();
        Promise::of(program, iterate, step, self.active)
    }

    /// Changes what is held in the system of the first variables, as long as there is anything to change: with many
    /// parameters at bounds that takes dozens of rounds, and a solution for all states in each would cost more than the
    /// factorisation. The number of rounds.
    fn settle(&mut self, program: &Program<'_>, iterate: &Iterate, step: &mut Step) -> usize {
        let most = self.active.rounds();
        if most == 0 {
            return 0;
        }
        self.p.iter_mut().zip(&iterate.gradient).for_each(|(p, g)| *p = -g);
        self.q.iter_mut().zip(&iterate.point.c).for_each(|(q, c)| *q = -c);
        let count = self.factor.reduce(self.p, self.q);
        if count == 0 || !self.active.are_first(count) {
            return 0;
        }
        let (d, z) = (&mut step.d[..count], &mut self.p[..count]);
        for round in 0..most {
            self.factor.solve_reduced(&self.active.to()[..count], d, z);
            if !self.active.change_first(program, iterate, (d, z), round < most / 2) {
                return round;
            }
            self.factor.finish(self.active.held(), self.damping.shift());
        }
        most
    }

    /// Solves for the step with the variables held as they are.
    fn solve(&mut self, program: &Program<'_>, iterate: &Iterate, step: &mut Step) {
        self.p.iter_mut().zip(&iterate.gradient).for_each(|(p, g)| *p = -g);
        self.q.iter_mut().zip(&iterate.point.c).for_each(|(q, c)| *q = -c);
        self.active.move_over(program, iterate, (self.p, self.q));
        program.count(|e| e.solutions += 1);
        self.factor.solve(self.p, self.q, &mut step.d, &mut step.multipliers);
        self.active.put(&mut step.d);
    }

    /// The step with another shift, where the system is positive with that.
    pub fn damped(
        &mut self,
        shift: f64,
        program: &Program<'_>,
        iterate: &Iterate,
        step: &mut Step,
    ) -> Option<Promise> {
        if !self.factor.finish(self.active.held(), shift).is_positive() {
            return None;
        }
        self.solve(program, iterate, step);
        Some(Promise::of(program, iterate, step, self.active))
    }

    /// The step back to the constraints from a point where they have the values `c`.
    pub fn correction(&mut self, program: &Program<'_>, c: &[f64], step: &mut Step) {
        self.p.fill(0.0);
        self.q.iter_mut().zip(c).for_each(|(q, c)| *q = -c);
        program.count(|e| e.solutions += 1);
        self.factor.solve(self.p, self.q, &mut step.d, &mut step.multipliers);
    }

    /// What curvature there is without a shift, and directions that have none.
    pub fn unshifted(&mut self) -> (Curvature, &[Direction]) {
        (self.factor.finish(self.active.held(), 0.0), self.factor.weak_directions())
    }
}
