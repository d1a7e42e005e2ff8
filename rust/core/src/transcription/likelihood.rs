//! The log-likelihood Σ ℓ_e (Eq. oem_coll_obj) and its derivatives, over blocks of samples.
//!
//! The program minimises, so all signs are turned: φ = −ℓ.

use super::defects::gather;
use super::disjoint::Disjoint;
use super::layout::Layout;
use super::samples::Samples;
use crate::nlp::Structure;
use crate::simd::kernel;
use crate::tape::lanes::{all_finite, scaled, sum};
use crate::tape::{Function, Tape, Values, Workspace};

/// A block of samples with all that evaluating it needs.
pub(super) struct Job<'a> {
    pub(super) likelihood: &'a Function,
    pub(super) layout: &'a Layout,
    pub(super) samples: &'a Samples,
    pub(super) xi: &'a [f64],
    pub(super) uniforms: &'a [f64],
}

/// Number of entries of the Hessian a sample writes.
pub(super) fn hessian_entries(likelihood: &Function) -> usize {
    likelihood.hessian_pattern.iter().filter(|(_, c)| *c < likelihood.n_states).count()
}

/// Places of the entries of the Hessian of a block.
pub(super) fn hessian_structure(
    likelihood: &Function,
    samples: &Samples,
    layout: &Layout,
    out: &mut Structure,
) {
    let n_x = likelihood.n_states;
    for (a, b) in likelihood.hessian_pattern.iter().filter(|(_, c)| *c < n_x) {
        for &point in &samples.points[..samples.n] {
            let x = layout.state(point as usize);
            if a < n_x { out.push(x + a, x + b) } else { out.push(x + b, a - n_x) }
        }
    }
}

impl Job<'_> {
    fn run<'w>(&self, tape: &Tape, workspace: &'w mut Workspace) -> &'w [f64] {
        let n = self.samples.points.len();
        let registers = workspace.registers(tape, n);
        let n_data = self.samples.data.len();
        registers[..n_data].copy_from_slice(&self.samples.data);
        gather(self.xi, self.layout, &self.samples.points, &mut registers[n_data..]);
        tape.run(registers, self.uniforms, n);
        registers
    }

    /// −ℓ of the block. The order of summation is fixed: results do not depend on threads.
    pub(super) fn objective(&self, workspace: &mut Workspace) -> f64 {
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

    /// Writes the gradient with respect to states, and adds that with respect to parameters to `theta`.
    pub(super) fn gradient(&self, workspace: &mut Workspace, out: &Disjoint<'_>, theta: &mut [f64]) -> bool {
        let registers = self.run(&self.likelihood.jacobian, workspace);
        collect_gradient(self, registers, out, theta)
    }

    /// Entries of factor · ∇²φ, by the tape of it or of an approximation, at the samples' points, and
    /// sums between parameters.
    pub(super) fn hessian(
        &self,
        tape: &Tape,
        workspace: &mut Workspace,
        factor: f64,
        out: &Disjoint<'_>,
        pairs: &mut [f64],
    ) -> bool {
        let registers = self.run(tape, workspace);
        // SAFETY: the entries of blocks do not overlap.
        let out =
            unsafe { out.part(self.samples.hessian, hessian_entries(self.likelihood) * self.samples.n) };
        collect_hessian(self, tape, registers, factor, out, pairs)
    }
}

kernel! {
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
                unsafe { out.part(job.layout.state(point as usize) + column, 1)[0] = -v };
            }
        } else {
            theta[column - n_x] -= job.total(value);
        }
    }
    finite && all_finite(theta)
}
}

kernel! {
fn collect_hessian(
    job: &Job<'_>,
    tape: &Tape,
    registers: &[f64],
    factor: f64,
    out: &mut [f64],
    pairs: &mut [f64],
) -> bool {
    let lanes = job.samples.points.len();
    let mut runs = out.chunks_exact_mut(job.samples.n);
    let mut pair = pairs.iter_mut();
    for (operand, &column) in tape.outputs.iter().zip(&job.likelihood.hessian_pattern.columns) {
        let value = tape.read(*operand, registers, job.uniforms, lanes);
        if column < job.layout.n_x {
            scaled(runs.next().expect("as many runs as in the structure"), factor, value, 0);
        } else {
            *pair.next().expect("as many pairs as in the pattern") += factor * job.total(value);
        }
    }
    all_finite(out) && all_finite(pairs)
}
}
