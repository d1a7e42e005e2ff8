//! Expressions compiled to a tape that works on lanes of points.
//!
//! One instruction handles a whole block of mesh points, one *lane* a point, so dispatch costs
//! nothing and the loops vectorise. What depends on parameters alone is *uniform*: computed once a
//! call as a scalar and broadcast. Registers are reused as soon as their value is dead, so that a
//! block stays in the first-level cache.

mod compile;
mod eval;
mod function;
pub(crate) mod lanes;
mod terms;
mod trace;

pub use compile::Inputs;
pub use eval::{Sinks, Workspace};
pub use function::{Arguments, Function, Pairs, Pattern};
pub use lanes::Values;
pub use terms::{Loss, Terms};
pub use trace::{Trace, trace};

use crate::expr::{Lookup, Op};

/// Lanes in a full block: measured best among 56 to 120 (no power of two, so that registers do not
/// compete for the same cache sets). Blocks are padded to a multiple of [`LANE_MULTIPLE`].
pub const BLOCK: usize = 120;

/// Block lengths are multiples of this, so that loops over lanes have no remainder.
pub const LANE_MULTIPLE: usize = 8;

/// The place of a value after a run: one number for all lanes, or a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Operand {
    /// A uniform slot.
    Uniform(u32),
    /// A register of lanes. The lane inputs are the first registers.
    Lane(u32),
    /// Nowhere: it went to its [`Sink`].
    Sunk,
}

/// The destination of an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sink {
    /// It stays in its register, to be read after the run.
    Keep,
    /// Its sum over the lanes is added to this place, as soon as it is computed.
    Sum(u32),
    /// It is stored as this row, as soon as it is computed.
    Store(u32),
}

/// The operation of an instruction on lanes. `L` stands for a register, `U` for a uniform; the letters follow the
/// operands a, b, c.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Code {
    AddLL,
    AddLU,
    SubLL,
    SubLU,
    SubUL,
    MulLL,
    MulLU,
    /// a·b + c
    FmaLLL,
    FmaLLU,
    FmaLUL,
    FmaLUU,
    /// a·b − c
    FmsLLL,
    FmsLLU,
    FmsLUL,
    FmsLUU,
    /// c − a·b
    FnmaLLL,
    FnmaLLU,
    FnmaLUL,
    FnmaLUU,
    /// sine to `dst`, cosine to register `c`
    SinCos,
    /// uniform `a` to all lanes
    Splat,
    /// register a to the whole power held as an `i32` in the bits of b
    PowI,
    /// any other operation of the table, on registers
    Apply(Op),
    /// 1-D or 2-D table lookup, its index in c
    Lookup1,
    Lookup2,
    /// sum of register a to place c
    Sum,
    /// register a to row c
    Store,
}

/// One instruction on lanes; registers and uniforms by number. `dst` is never an operand.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instruction {
    code: Code,
    dst: u32,
    a: u32,
    b: u32,
    c: u32,
}

/// One instruction on uniforms.
#[derive(Clone, Copy, Debug)]
pub(crate) enum UniformInstruction {
    Apply { op: Op, dst: u32, args: [u32; 3] },
    Lookup { lookup: u32, dst: u32, args: [u32; 2] },
}

/// A compiled set of expressions. See the [module](self).
#[derive(Clone, Debug)]
pub struct Tape {
    /// Uniform inputs, the first uniform slots.
    pub(crate) n_uniform_inputs: usize,
    pub(crate) n_registers: usize,
    /// Initial uniform slots: inputs (to be filled), then constants, then results.
    pub(crate) uniforms: Vec<f64>,
    pub(crate) uniform_code: Vec<UniformInstruction>,
    pub(crate) code: Vec<Instruction>,
    pub(crate) lookups: Vec<Lookup>,
    /// Sinks of uniform outputs, which no instruction on lanes serves.
    pub(crate) uniform_sinks: Vec<(Sink, u32)>,
    /// The place of each output.
    pub outputs: Vec<Operand>,
}

impl Tape {
    /// Number of instructions on lanes: a measure of cost that does not depend on the machine.
    pub fn instructions(&self) -> usize {
        self.code.len()
    }

    /// Number of registers, lane inputs among them.
    pub fn registers(&self) -> usize {
        self.n_registers
    }
}
