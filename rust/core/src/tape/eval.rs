//! Running a tape on one block of lanes.

use super::lanes::{Values, scaled, sum};
use super::{Code, Instruction, LANE_MULTIPLE, Operand, Sink, Tape, UniformInstruction};
use crate::expr::{Lookup, Op};
use crate::math;
use crate::simd::kernel;

/// A cache line. Registers start on one, so that no vector straddles two.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Line([f64; LANE_MULTIPLE]);

/// Memory for running tapes; grows to the largest tape and block that it has served.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    registers: Vec<Line>,
}

impl Workspace {
    /// Registers for a tape on `n` lanes. The first of them are the lane inputs, for the caller to
    /// fill before [`Tape::run`].
    pub fn registers(&mut self, tape: &Tape, n: usize) -> &mut [f64] {
        let lines = (tape.n_registers * n).div_ceil(LANE_MULTIPLE);
        if self.registers.len() < lines {
            self.registers.resize(lines, Line([0.0; LANE_MULTIPLE]));
        }
        let start = self.registers.as_mut_ptr().cast::<f64>();
        // SAFETY: a Line is LANE_MULTIPLE numbers without padding, and so many are there.
        unsafe { std::slice::from_raw_parts_mut(start, tape.n_registers * n) }
    }
}

impl Tape {
    /// All uniform values for given parameters: to be computed once a call.
    pub fn uniforms(&self, parameters: &[f64], out: &mut Vec<f64>) {
        assert_eq!(parameters.len(), self.n_uniform_inputs);
        out.clear();
        out.extend_from_slice(&self.uniforms);
        out[..parameters.len()].copy_from_slice(parameters);
        for instruction in &self.uniform_code {
            match *instruction {
                UniformInstruction::Apply { op, dst, args } => {
                    let entry = op.entry();
                    let values = args.map(|a| out[a as usize]);
                    out[dst as usize] = (entry.value)(&values[..entry.arity]);
                }
                UniformInstruction::Lookup { lookup, dst, args } => {
                    let lookup = &self.lookups[lookup as usize];
                    out[dst as usize] = lookup.value(&args.map(|a| out[a as usize]));
                }
            }
        }
    }

    /// Runs on `n` lanes, a multiple of [`LANE_MULTIPLE`]. `registers` comes from
    /// [`Workspace::registers`], its lane inputs filled; `uniforms` from [`Tape::uniforms`].
    pub fn run(&self, registers: &mut [f64], uniforms: &[f64], n: usize) {
        self.run_into(registers, uniforms, n, &mut Sinks::default());
    }

    /// Runs as [`Tape::run`], for a tape with sinks. Outputs that are uniform go to their sinks as well.
    pub fn run_into(&self, registers: &mut [f64], uniforms: &[f64], n: usize, sinks: &mut Sinks<'_>) {
        assert!(registers.len() >= self.n_registers * n && n.is_multiple_of(LANE_MULTIPLE));
        assert_eq!(uniforms.len(), self.uniforms.len());
        assert!(sinks.count <= n);
        run(&self.code, &self.lookups, registers, uniforms, n, sinks);
        for &(sink, slot) in &self.uniform_sinks {
            let value = uniforms[slot as usize];
            match sink {
                Sink::Keep => {}
                Sink::Sum(place) => sinks.sums[place as usize] += value * sinks.count as f64,
                Sink::Store(row) => {
                    sinks.rows[row as usize * sinks.count..][..sinks.count].fill(sinks.factor * value);
                }
            }
        }
    }

    /// The values of an operand after a run: `n` lanes, or one number for all.
    pub fn read<'a>(
        &self,
        operand: Operand,
        registers: &'a [f64],
        uniforms: &'a [f64],
        n: usize,
    ) -> Values<'a> {
        match operand {
            Operand::Uniform(u) => Values::Uniform(uniforms[u as usize]),
            Operand::Lane(r) => Values::Lanes(&registers[r as usize * n..(r as usize + 1) * n]),
            Operand::Sunk => Values::Lanes(&[]),
        }
    }
}

/// The destinations of a tape's outputs.
#[derive(Debug, Default)]
pub struct Sinks<'a> {
    /// Lanes that count, the first ones.
    pub count: usize,
    /// The factor of stored values.
    pub factor: f64,
    /// Places of sums, to which they are added.
    pub sums: &'a mut [f64],
    /// Rows of `count` stored values.
    pub rows: &'a mut [f64],
}

// Each map reads its chunks into arrays, works on those, and stores the result: the compiler then
// need not prove that lanes do not overlap, and uses one vector for a chunk.

#[inline(always)]
fn map1(d: &mut [f64], a: &[f64], f: impl Fn(f64) -> f64) {
    let (d, a) = (d.as_chunks_mut::<LANE_MULTIPLE>().0, a.as_chunks::<LANE_MULTIPLE>().0);
    for (d, &a) in d.iter_mut().zip(a) {
        *d = std::array::from_fn(|l| f(a[l]));
    }
}

#[inline(always)]
fn map2(d: &mut [f64], a: &[f64], b: &[f64], f: impl Fn(f64, f64) -> f64) {
    let (d, a) = (d.as_chunks_mut::<LANE_MULTIPLE>().0, a.as_chunks::<LANE_MULTIPLE>().0);
    let b = b.as_chunks::<LANE_MULTIPLE>().0;
    for ((d, &a), &b) in d.iter_mut().zip(a).zip(b) {
        *d = std::array::from_fn(|l| f(a[l], b[l]));
    }
}

#[inline(always)]
fn map3(d: &mut [f64], a: &[f64], b: &[f64], c: &[f64], f: impl Fn(f64, f64, f64) -> f64) {
    let (d, a) = (d.as_chunks_mut::<LANE_MULTIPLE>().0, a.as_chunks::<LANE_MULTIPLE>().0);
    let (b, c) = (b.as_chunks::<LANE_MULTIPLE>().0, c.as_chunks::<LANE_MULTIPLE>().0);
    for (((d, &a), &b), &c) in d.iter_mut().zip(a).zip(b).zip(c) {
        *d = std::array::from_fn(|l| f(a[l], b[l], c[l]));
    }
}

#[inline(always)]
fn truth(x: bool) -> f64 {
    f64::from(u8::from(x))
}

kernel! {
fn run(code: &[Instruction], lookups: &[Lookup], registers: &mut [f64], uniforms: &[f64], n: usize, sinks: &mut Sinks<'_>) {
    let base = registers.as_mut_ptr();
    // SAFETY (for both): the compiler numbers registers below `n_registers`, whose room `run` of
    // Tape has checked, and never lets a destination be an operand, so the lanes do not alias.
    let lane = |r: u32| unsafe { std::slice::from_raw_parts(base.add(r as usize * n), n) };
    let lane_mut = |r: u32| unsafe { std::slice::from_raw_parts_mut(base.add(r as usize * n), n) };
    for i in code {
        match i.code {
            Code::Sum => {
                sinks.sums[i.c as usize] += sum(&lane(i.a)[..sinks.count]);
                continue;
            }
            Code::Store => {
                let row = &mut sinks.rows[i.c as usize * sinks.count..][..sinks.count];
                scaled(row, sinks.factor, Values::Lanes(lane(i.a)), 0);
                continue;
            }
            _ => {}
        }
        let d = lane_mut(i.dst);
        let uniform = |u: u32| uniforms[u as usize];
        match i.code {
            Code::AddLL => map2(d, lane(i.a), lane(i.b), |a, b| a + b),
            Code::AddLU => {
                let b = uniform(i.b);
                map1(d, lane(i.a), |a| a + b);
            }
            Code::SubLL => map2(d, lane(i.a), lane(i.b), |a, b| a - b),
            Code::SubLU => {
                let b = uniform(i.b);
                map1(d, lane(i.a), |a| a - b);
            }
            Code::SubUL => {
                let a = uniform(i.a);
                map1(d, lane(i.b), |b| a - b);
            }
            Code::MulLL => map2(d, lane(i.a), lane(i.b), |a, b| a * b),
            Code::MulLU => {
                let b = uniform(i.b);
                map1(d, lane(i.a), |a| a * b);
            }
            Code::FmaLLL => map3(d, lane(i.a), lane(i.b), lane(i.c), f64::mul_add),
            Code::FmaLLU => {
                let c = uniform(i.c);
                map2(d, lane(i.a), lane(i.b), |a, b| a.mul_add(b, c));
            }
            Code::FmaLUL => {
                let b = uniform(i.b);
                map2(d, lane(i.a), lane(i.c), |a, c| a.mul_add(b, c));
            }
            Code::FmaLUU => {
                let (b, c) = (uniform(i.b), uniform(i.c));
                map1(d, lane(i.a), |a| a.mul_add(b, c));
            }
            Code::FmsLLL => map3(d, lane(i.a), lane(i.b), lane(i.c), |a, b, c| a.mul_add(b, -c)),
            Code::FmsLLU => {
                let c = -uniform(i.c);
                map2(d, lane(i.a), lane(i.b), |a, b| a.mul_add(b, c));
            }
            Code::FmsLUL => {
                let b = uniform(i.b);
                map2(d, lane(i.a), lane(i.c), |a, c| a.mul_add(b, -c));
            }
            Code::FmsLUU => {
                let (b, c) = (uniform(i.b), -uniform(i.c));
                map1(d, lane(i.a), |a| a.mul_add(b, c));
            }
            Code::FnmaLLL => map3(d, lane(i.a), lane(i.b), lane(i.c), |a, b, c| (-a).mul_add(b, c)),
            Code::FnmaLLU => {
                let c = uniform(i.c);
                map2(d, lane(i.a), lane(i.b), |a, b| (-a).mul_add(b, c));
            }
            Code::FnmaLUL => {
                let b = -uniform(i.b);
                map2(d, lane(i.a), lane(i.c), |a, c| a.mul_add(b, c));
            }
            Code::FnmaLUU => {
                let (b, c) = (-uniform(i.b), uniform(i.c));
                map1(d, lane(i.a), |a| a.mul_add(b, c));
            }
            Code::SinCos => math::sin_cos_lanes(d, lane_mut(i.c), lane(i.a)),
            Code::Splat => d.fill(uniform(i.a)),
            Code::PowI => math::powi_lanes(d, lane(i.a), i.b as i32),
            Code::Lookup1 => {
                let lookup = &lookups[i.c as usize];
                lookup.table.eval1_lanes(lookup.order[0], d, lane(i.a));
            }
            Code::Lookup2 => {
                let lookup = &lookups[i.c as usize];
                lookup.table.eval2_lanes(lookup.order[0], lookup.order[1], d, lane(i.a), lane(i.b));
            }
            Code::Apply(op) => apply(op, d, lane(i.a), lane(i.b), lane(i.c)),
            Code::Sum | Code::Store => unreachable!("handled above: they have no destination"),
        }
    }
}
}

/// The loop over lanes of each operation of the table.
#[inline(always)]
fn apply(op: Op, d: &mut [f64], a: &[f64], b: &[f64], c: &[f64]) {
    match op {
        Op::Add => map2(d, a, b, |a, b| a + b),
        Op::Sub => map2(d, a, b, |a, b| a - b),
        Op::Mul => map2(d, a, b, |a, b| a * b),
        Op::Div => map2(d, a, b, |a, b| a / b),
        Op::Pow => math::pow_lanes(d, a, b),
        Op::Neg => map1(d, a, |a| -a),
        Op::Recip => map1(d, a, |a| 1.0 / a),
        Op::Sqrt => map1(d, a, f64::sqrt),
        Op::Exp => math::exp_lanes(d, a),
        Op::Expm1 => math::expm1_lanes(d, a),
        Op::Log => math::log_lanes(d, a),
        Op::Log1p => math::log1p_lanes(d, a),
        Op::Hypot => math::hypot_lanes(d, a, b),
        Op::Sin => math::sin_lanes(d, a),
        Op::Cos => math::cos_lanes(d, a),
        Op::Tan => math::tan_lanes(d, a),
        Op::Asin => math::asin_lanes(d, a),
        Op::Acos => math::acos_lanes(d, a),
        Op::Atan => math::atan_lanes(d, a),
        Op::Atan2 => math::atan2_lanes(d, a, b),
        Op::Sinh => math::sinh_lanes(d, a),
        Op::Cosh => math::cosh_lanes(d, a),
        Op::Tanh => math::tanh_lanes(d, a),
        Op::Abs => map1(d, a, f64::abs),
        Op::Sign => map1(d, a, math::sign),
        Op::Min => map2(d, a, b, math::min),
        Op::Max => map2(d, a, b, math::max),
        Op::Lt => map2(d, a, b, |a, b| truth(a < b)),
        Op::Le => map2(d, a, b, |a, b| truth(a <= b)),
        Op::And => map2(d, a, b, |a, b| truth(a != 0.0 && b != 0.0)),
        Op::Or => map2(d, a, b, |a, b| truth(a != 0.0 || b != 0.0)),
        Op::Not => map1(d, a, |a| truth(a == 0.0)),
        Op::Where => map3(d, a, b, c, |a, b, c| if a != 0.0 { b } else { c }),
    }
}
