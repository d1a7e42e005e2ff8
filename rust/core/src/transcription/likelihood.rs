//! The log-likelihood Σ ℓ_e (Eq. oem_coll_obj) and its derivatives, over blocks of samples.
//!
//! The program minimises, so all signs are turned: φ = −ℓ.

use super::defects::gather;
use super::disjoint::Disjoint;
use super::layout::Layout;
use super::samples::Samples;
use crate::nlp::Structure;
use crate::tape::{Function, Tape, Workspace};

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
        -(0..self.samples.n).map(|l| value.at(l)).sum::<f64>()
    }

    /// Writes the gradient with respect to states, and adds that with respect to parameters to `theta`.
    pub(super) fn gradient(&self, workspace: &mut Workspace, out: &Disjoint<'_>, theta: &mut [f64]) -> bool {
        let (tape, n_x) = (&self.likelihood.jacobian, self.layout.n_x);
        let lanes = self.samples.points.len();
        let registers = self.run(tape, workspace);
        let mut finite = true;
        for (operand, column) in tape.outputs.iter().zip(&self.likelihood.jacobian_pattern.columns) {
            let value = tape.read(*operand, registers, self.uniforms, lanes);
            if *column < n_x {
                for (l, &point) in self.samples.points[..self.samples.n].iter().enumerate() {
                    let v = value.at(l);
                    finite &= v.is_finite();
                    // SAFETY: sample times are distinct, so a point has one sample at most.
                    unsafe { out.part(self.layout.state(point as usize) + column, 1)[0] = -v };
                }
            } else {
                let sum: f64 = (0..self.samples.n).map(|l| value.at(l)).sum();
                finite &= sum.is_finite();
                theta[column - n_x] -= sum;
            }
        }
        finite
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
        let n_x = self.layout.n_x;
        let lanes = self.samples.points.len();
        let registers = self.run(tape, workspace);
        // SAFETY: the entries of blocks do not overlap.
        let out =
            unsafe { out.part(self.samples.hessian, hessian_entries(self.likelihood) * self.samples.n) };
        let mut runs = out.chunks_exact_mut(self.samples.n);
        let mut pair = pairs.iter_mut();
        let mut finite = true;
        for (operand, (_, column)) in tape.outputs.iter().zip(self.likelihood.hessian_pattern.iter()) {
            let value = tape.read(*operand, registers, self.uniforms, lanes);
            if column < n_x {
                for (l, o) in runs.next().expect("as many runs as in the structure").iter_mut().enumerate() {
                    *o = -factor * value.at(l);
                    finite &= o.is_finite();
                }
            } else {
                let sum: f64 = (0..self.samples.n).map(|l| value.at(l)).sum();
                finite &= sum.is_finite();
                *pair.next().expect("as many pairs as in the pattern") -= factor * sum;
            }
        }
        finite
    }
}
