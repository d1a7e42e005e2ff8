//! The log-likelihood Σ ℓ_e (Eq. oem_coll_obj) and its derivatives, over blocks of samples.
//!
//! The program minimises, so all signs are turned: φ = −ℓ.

use super::disjoint::Disjoint;
use super::estimands::ParameterMap;
use super::layout::Layout;
use super::samples::Samples;
use crate::index::{ParameterId, PointId};
use crate::nlp::Part;
use crate::simd::kernel;
use crate::tape::lanes::{all_finite, sum};
use crate::tape::{Function, Sinks, Tape, Values, Workspace};

/// A block of samples with all that evaluating it needs.
pub(crate) struct Job<'a> {
    pub(crate) likelihood: &'a Function,
    pub(crate) layout: &'a Layout,
    pub(crate) samples: &'a Samples,
    pub(crate) xi: &'a [f64],
    pub(crate) uniforms: &'a [f64],
}

/// Number of entries of the Hessian a sample writes.
pub(crate) fn hessian_entries(likelihood: &Function) -> usize {
    likelihood.hessian_pattern.iter().filter(|(_, c)| *c < likelihood.n_states).count()
}

/// Places of the entries of the Hessian of a block.
pub(crate) fn hessian_structure(
    likelihood: &Function,
    samples: &Samples,
    layout: &Layout,
    map: &ParameterMap,
    out: &mut Part<'_>,
) {
    let n_x = likelihood.n_states;
    for (a, b) in likelihood.hessian_pattern.iter().filter(|(_, c)| *c < n_x) {
        for &point in &samples.points[..samples.n] {
            let x = layout.state(PointId(point as usize)).0;
            if a < n_x { out.push(x + a, x + b) } else { out.push(x + b, map[ParameterId(a - n_x)].0) }
        }
    }
}

impl Job<'_> {
    /// Registers of a tape with data and states in place.
    fn load<'w>(&self, tape: &Tape, workspace: &'w mut Workspace) -> &'w mut [f64] {
        let registers = workspace.registers(tape, self.samples.points.len());
        let n_data = self.samples.data.len();
        registers[..n_data].copy_from_slice(&self.samples.data);
        self.layout.gather(self.xi, &self.samples.points, &mut registers[n_data..]);
        registers
    }

    fn run<'w>(&self, tape: &Tape, workspace: &'w mut Workspace) -> &'w [f64] {
        let registers = self.load(tape, workspace);
        tape.run(registers, self.uniforms, self.samples.points.len());
        registers
    }

    /// −ℓ of the block. The order of summation is fixed: results do not depend on threads.
    pub(crate) fn objective(&self, workspace: &mut Workspace) -> f64 {
        let tape = &self.likelihood.value;
        let registers = self.run(tape, workspace);
        let value = tape.read(tape.outputs[0], registers, self.uniforms, self.samples.points.len());
        -self.total(value)
    }

    /// Sum over the samples of the block.
    #[inline(always)]
    fn total(&self, value: Values<'_>) -> f64 {
        match value {
            Values::Uniform(u) => u * self.samples.n as f64,
            Values::Lanes(v) => sum(&v[..self.samples.n]),
        }
    }

    /// Writes the gradient with respect to states (`out` holds those alone), and adds that with respect to parameters to `theta`.
    pub(crate) fn gradient(&self, workspace: &mut Workspace, out: &Disjoint<'_>, theta: &mut [f64]) -> bool {
        let registers = self.run(&self.likelihood.jacobian, workspace);
        collect_gradient(self, registers, out, theta)
    }

    /// Entries of factor · ∇²φ, by the tape of it or of an approximation, at the samples' points, and
    /// sums between parameters.
    pub(crate) fn hessian(
        &self,
        tape: &Tape,
        workspace: &mut Workspace,
        factor: f64,
        out: &Disjoint<'_>,
        pairs: &mut [f64],
    ) -> bool {
        let count = self.samples.n;
        // SAFETY: the entries of blocks do not overlap.
        let rows = unsafe { out.part(self.samples.hessian, hessian_entries(self.likelihood) * count) };
        let lanes = self.samples.points.len();
        let registers = self.load(tape, workspace);
        let mut sinks = Sinks { count, factor, sums: &mut *pairs, rows: &mut *rows };
        tape.run_into(registers, self.uniforms, lanes, &mut sinks);
        let finite = all_finite(rows) && all_finite(pairs);
        pairs.iter_mut().for_each(|p| *p *= factor);
        finite
    }
}

kernel! {
    /// Writes −∂ℓ/∂x at the samples' points, and adds −∂ℓ/∂θ to `theta`; whether all are finite.
    fn collect_gradient(job: &Job<'_>, registers: &[f64], out: &Disjoint<'_>, theta: &mut [f64]) -> bool {
        let (tape, n_x) = (&job.likelihood.jacobian, job.layout.n_x);
        let (lanes, samples) = (job.samples.points.len(), job.samples);
        let mut finite = true;
        for (operand, &column) in tape.outputs.iter().zip(&job.likelihood.jacobian_pattern.columns) {
            let value = tape.read(*operand, registers, job.uniforms, lanes);
            if column < n_x {
                for (l, &point) in samples.points[..samples.n].iter().enumerate() {
                    let v = value.at(l);
                    finite &= v.is_finite();
                    // SAFETY: sample times are distinct, so a point has one sample at most.
                    unsafe { out.part(point as usize * n_x + column, 1)[0] = -v };
                }
            } else {
                theta[column - n_x] -= job.total(value);
            }
        }
        finite && all_finite(theta)
    }
}
