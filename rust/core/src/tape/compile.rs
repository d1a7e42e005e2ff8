//! The compilation of a graph to a tape: uniform values, order, and registers.

use rustc_hash::FxHashMap;

use super::{Code, Instruction, Operand, Sink, Tape, UniformInstruction};
use crate::error::Error;
use crate::expr::graph::{Graph, Id, Item};
use crate::expr::{Lookup, Op};

/// The symbols that a tape is given values for.
#[derive(Clone, Debug, Default)]
pub struct Inputs {
    /// One value a lane: states, inputs, measurements, weights.
    pub lanes: Vec<Id>,
    /// One value for all lanes: parameters.
    pub uniforms: Vec<Id>,
}

impl Tape {
    /// Compiles the nodes `outputs` of a graph.
    ///
    /// # Errors
    /// When an output depends on a symbol that is no input.
    pub fn compile(graph: &Graph, inputs: &Inputs, outputs: &[Id]) -> Result<Tape, Error> {
        Tape::compile_into(graph, inputs, outputs, &vec![Sink::Keep; outputs.len()])
    }

    /// Compiles as [`Tape::compile`], with a sink for each output. Values that need not be kept do not occupy a
    /// register until the end: a tape with many outputs then stays in the first-level cache.
    ///
    /// # Errors
    /// As [`Tape::compile`].
    pub fn compile_into(
        graph: &Graph,
        inputs: &Inputs,
        outputs: &[Id],
        sinks: &[Sink],
    ) -> Result<Tape, Error> {
        let mut compiler = Compiler::new(graph, inputs, outputs)?;
        compiler.schedule(outputs, sinks);
        Ok(compiler.finish(outputs, sinks))
    }
}

/// An instruction before registers are assigned: nodes for operands.
struct Virtual {
    code: Code,
    /// None for what goes to a sink.
    dst: Option<Id>,
    second: Option<Id>,
    args: [Arg; 3],
}

#[derive(Clone, Copy)]
enum Arg {
    None,
    Node(Id),
    Uniform(u32),
    Raw(u32),
}

/// A sum or difference that is one instruction: a·b + c (Fma), a·b − c (Fms) or c − a·b (Fnma).
struct Fused {
    product: Id,
    /// The other side.
    other: Id,
    code: Code,
}

struct Compiler<'a> {
    graph: &'a Graph,
    uses: Vec<u32>,
    needed: Vec<bool>,
    /// Uniform slot of a node, where it is uniform.
    slots: FxHashMap<Id, u32>,
    splats: FxHashMap<Id, ()>,
    emitted: Vec<bool>,
    code: Vec<Virtual>,
    lane_inputs: Vec<Id>,
    tape: Tape,
}

/// The number of a register, uniform or table. There are no more of them than nodes, which [`Id`] counts by `u32`.
fn number(n: usize) -> u32 {
    n as u32
}

impl<'a> Compiler<'a> {
    fn new(graph: &'a Graph, inputs: &Inputs, outputs: &[Id]) -> Result<Self, Error> {
        let n = graph.len();
        let mut compiler = Compiler {
            graph,
            uses: vec![0; n],
            needed: vec![false; n],
            slots: FxHashMap::default(),
            splats: FxHashMap::default(),
            emitted: vec![false; n],
            code: Vec::new(),
            lane_inputs: inputs.lanes.clone(),
            tape: Tape {
                n_uniform_inputs: inputs.uniforms.len(),
                n_registers: inputs.lanes.len(),
                uniforms: vec![0.0; inputs.uniforms.len()],
                uniform_code: Vec::new(),
                code: Vec::new(),
                lookups: Vec::new(),
                uniform_sinks: Vec::new(),
                outputs: Vec::new(),
            },
        };
        for (i, &id) in inputs.uniforms.iter().enumerate() {
            compiler.slots.insert(id, number(i));
        }
        for &id in &inputs.lanes {
            compiler.emitted[id.index()] = true;
        }
        let reachable = graph.reachable(outputs);
        for &id in &reachable {
            compiler.needed[id.index()] = true;
            for arg in graph.args(id) {
                compiler.uses[arg.index()] += 1;
            }
        }
        for id in outputs {
            compiler.uses[id.index()] += 1;
        }
        compiler.check_symbols(&reachable)?;
        compiler.find_uniforms(&reachable);
        Ok(compiler)
    }

    fn check_symbols(&self, reachable: &[Id]) -> Result<(), Error> {
        for &id in reachable {
            if let Some(name) = self.graph.symbol_name(id)
                && !self.emitted[id.index()]
                && !self.slots.contains_key(&id)
            {
                let text = format!("symbol '{name}' has no value: it is not a state, input or parameter");
                return Err(Error::model(text));
            }
        }
        Ok(())
    }

    /// Gives every node that depends on uniforms alone a slot, and writes the scalar program.
    fn find_uniforms(&mut self, reachable: &[Id]) {
        for &id in reachable {
            if self.slots.contains_key(&id) {
                continue;
            }
            if let Some(value) = self.graph.as_constant(id) {
                self.slots.insert(id, number(self.tape.uniforms.len()));
                self.tape.uniforms.push(value);
                continue;
            }
            let args = self.graph.args(id);
            if args.is_empty() || !args.iter().all(|a| self.slots.contains_key(a)) {
                continue;
            }
            let dst = number(self.tape.uniforms.len());
            let slot = |k: usize| self.slots[&args[k.min(args.len() - 1)]];
            let instruction = match self.graph.item(id) {
                Item::Apply(op, _) => {
                    UniformInstruction::Apply { op, dst, args: [slot(0), slot(1), slot(2)] }
                }
                Item::Lookup(k, _) => {
                    let args = [slot(0), slot(1)];
                    UniformInstruction::Lookup { lookup: self.table(k), dst, args }
                }
                _ => unreachable!("leaves were handled above"),
            };
            self.tape.uniforms.push(0.0);
            self.tape.uniform_code.push(instruction);
            self.slots.insert(id, dst);
        }
    }

    fn table(&mut self, k: u32) -> u32 {
        let lookup: &Lookup = self.graph.lookup_at(k);
        let place = self.tape.lookups.iter().position(|l| l == lookup).unwrap_or_else(|| {
            self.tape.lookups.push(lookup.clone());
            self.tape.lookups.len() - 1
        });
        number(place)
    }

    /// Depth-first from the outputs: a value is computed just before it is first needed.
    fn schedule(&mut self, outputs: &[Id], sinks: &[Sink]) {
        for (&output, sink) in outputs.iter().zip(sinks) {
            let mut stack = vec![(output, false)];
            while let Some((id, ready)) = stack.pop() {
                if self.emitted[id.index()] || self.slots.contains_key(&id) {
                    continue;
                }
                if ready {
                    self.emit(id);
                } else {
                    stack.push((id, true));
                    let args = self.operands(id);
                    stack.extend(args.into_iter().rev().map(|a| (a, false)));
                }
            }
            let (code, place) = match sink {
                Sink::Keep => continue,
                Sink::Sum(place) => (Code::Sum, *place),
                Sink::Store(row) => (Code::Store, *row),
            };
            if !self.slots.contains_key(&output) {
                let args = [Arg::Node(output), Arg::None, Arg::Raw(place)];
                self.code.push(Virtual { code, dst: None, second: None, args });
            }
        }
    }

    /// The nodes that must be there before `id` is emitted: through a product that is fused.
    fn operands(&self, id: Id) -> Vec<Id> {
        match self.fusable(id) {
            Some(Fused { product, other, .. }) => {
                let mut args = self.graph.args(product);
                args.push(other);
                args
            }
            None => self.graph.args(id),
        }
    }

    /// Returns how a sum or difference with a product that nothing else needs is fused.
    fn fusable(&self, id: Id) -> Option<Fused> {
        let Item::Apply(op @ (Op::Add | Op::Sub), args) = self.graph.item(id) else { return None };
        let product = |p: Id| {
            matches!(self.graph.item(p), Item::Apply(Op::Mul, _))
                && self.uses[p.index()] == 1
                && !self.slots.contains_key(&p)
                && !self.emitted[p.index()]
        };
        if product(args[1]) {
            let code = if op == Op::Add { Code::FmaLLL } else { Code::FnmaLLL };
            Some(Fused { product: args[1], other: args[0], code })
        } else if product(args[0]) {
            let code = if op == Op::Add { Code::FmaLLL } else { Code::FmsLLL };
            Some(Fused { product: args[0], other: args[1], code })
        } else {
            None
        }
    }

    fn emit(&mut self, id: Id) {
        if let Some(Fused { product, other, code }) = self.fusable(id) {
            self.emit_fused(id, product, other, code);
            return;
        }
        match self.graph.item(id) {
            Item::Apply(op, args) => match op {
                Op::Add | Op::Sub | Op::Mul => self.emit_arithmetic(id, op, args[0], args[1]),
                Op::Sin | Op::Cos => self.emit_sin_cos(id, op, args[0]),
                Op::Pow if self.whole_exponent(args[1]).is_some() => {
                    let bits = self.whole_exponent(args[1]).unwrap() as u32;
                    self.push(Code::PowI, id, None, [Arg::Node(args[0]), Arg::Raw(bits), Arg::None]);
                }
                _ => {
                    let args = self.graph.args(id);
                    let lanes: Vec<Arg> = args.into_iter().map(|a| self.as_lane(a)).collect();
                    let arg = |k: usize| lanes[k.min(lanes.len() - 1)];
                    self.push(Code::Apply(op), id, None, [arg(0), arg(1), arg(2)]);
                }
            },
            Item::Lookup(k, _) => {
                let args = self.graph.args(id);
                let table = Arg::Raw(self.table(k));
                let lanes: Vec<Arg> = args.into_iter().map(|a| self.as_lane(a)).collect();
                let code = if lanes.len() == 1 { Code::Lookup1 } else { Code::Lookup2 };
                self.push(code, id, None, [lanes[0], lanes[lanes.len() - 1], table]);
            }
            Item::Symbol(_) | Item::Constant(_) => unreachable!("symbols are inputs, constants uniform"),
        }
    }

    fn whole_exponent(&self, exponent: Id) -> Option<i32> {
        let c = self.graph.as_constant(exponent)?;
        (c.fract() == 0.0 && c.abs() <= 64.0).then_some(c as i32)
    }

    fn emit_arithmetic(&mut self, id: Id, op: Op, a: Id, b: Id) {
        let (ua, ub) = (self.slots.get(&a).copied(), self.slots.get(&b).copied());
        let (code, args) = match (op, ua, ub) {
            (Op::Add, None, None) => (Code::AddLL, [Arg::Node(a), Arg::Node(b)]),
            (Op::Add, None, Some(u)) => (Code::AddLU, [Arg::Node(a), Arg::Uniform(u)]),
            (Op::Add, Some(u), _) => (Code::AddLU, [Arg::Node(b), Arg::Uniform(u)]),
            (Op::Sub, None, None) => (Code::SubLL, [Arg::Node(a), Arg::Node(b)]),
            (Op::Sub, None, Some(u)) => (Code::SubLU, [Arg::Node(a), Arg::Uniform(u)]),
            (Op::Sub, Some(u), _) => (Code::SubUL, [Arg::Uniform(u), Arg::Node(b)]),
            (_, None, None) => (Code::MulLL, [Arg::Node(a), Arg::Node(b)]),
            (_, None, Some(u)) => (Code::MulLU, [Arg::Node(a), Arg::Uniform(u)]),
            (_, Some(u), _) => (Code::MulLU, [Arg::Node(b), Arg::Uniform(u)]),
        };
        self.push(code, id, None, [args[0], args[1], Arg::None]);
    }

    fn emit_fused(&mut self, id: Id, product: Id, other: Id, code: Code) {
        let factors = self.graph.args(product);
        let (a, b) = if self.slots.contains_key(&factors[0]) {
            (factors[1], factors[0])
        } else {
            (factors[0], factors[1])
        };
        let operand = |x: Id| self.slots.get(&x).map_or(Arg::Node(x), |&u| Arg::Uniform(u));
        let args = [Arg::Node(a), operand(b), operand(other)];
        let uniform = (matches!(args[1], Arg::Uniform(_)), matches!(args[2], Arg::Uniform(_)));
        let variants = match code {
            Code::FmaLLL => [Code::FmaLLL, Code::FmaLLU, Code::FmaLUL, Code::FmaLUU],
            Code::FmsLLL => [Code::FmsLLL, Code::FmsLLU, Code::FmsLUL, Code::FmsLUU],
            _ => [Code::FnmaLLL, Code::FnmaLLU, Code::FnmaLUL, Code::FnmaLUU],
        };
        let code = variants[2 * usize::from(uniform.0) + usize::from(uniform.1)];
        self.push(code, id, None, args);
    }

    /// Sine and cosine of one angle share the range reduction.
    fn emit_sin_cos(&mut self, id: Id, op: Op, angle: Id) {
        let other = if op == Op::Sin { Op::Cos } else { Op::Sin };
        let partner = self.graph.find(op_key(other, angle)).filter(|p| self.needed[p.index()]);
        match partner {
            Some(partner) if !self.emitted[partner.index()] => {
                let (sin, cos) = if op == Op::Sin { (id, partner) } else { (partner, id) };
                self.push(Code::SinCos, sin, Some(cos), [Arg::Node(angle), Arg::None, Arg::None]);
                self.emitted[cos.index()] = true;
            }
            _ => self.push(Code::Apply(op), id, None, [Arg::Node(angle); 3]),
        }
    }

    /// A register that holds the node, broadcast first where the node is uniform.
    fn as_lane(&mut self, id: Id) -> Arg {
        if let Some(&slot) = self.slots.get(&id)
            && self.splats.insert(id, ()).is_none()
        {
            self.push(Code::Splat, id, None, [Arg::Uniform(slot), Arg::None, Arg::None]);
        }
        Arg::Node(id)
    }

    fn push(&mut self, code: Code, dst: Id, second: Option<Id>, args: [Arg; 3]) {
        self.emitted[dst.index()] = true;
        self.code.push(Virtual { code, dst: Some(dst), second, args });
    }

    /// Assigns registers by a linear scan: a register is free after the last use of its value.
    fn finish(mut self, outputs: &[Id], sinks: &[Sink]) -> Tape {
        let mut last_use: FxHashMap<Id, usize> = FxHashMap::default();
        for (at, v) in self.code.iter().enumerate() {
            for arg in v.args {
                if let Arg::Node(id) = arg {
                    last_use.insert(id, at);
                }
            }
        }
        for (&output, sink) in outputs.iter().zip(sinks) {
            if *sink == Sink::Keep {
                last_use.insert(output, usize::MAX);
            }
        }
        let mut registers: FxHashMap<Id, u32> = FxHashMap::default();
        for (i, &id) in self.lane_inputs.iter().enumerate() {
            registers.insert(id, number(i));
        }
        let n_inputs = self.lane_inputs.len();
        let mut free: Vec<u32> = Vec::new();
        let mut count = n_inputs;
        for (at, v) in self.code.iter().enumerate() {
            let mut take = |registers: &mut FxHashMap<Id, u32>, id: Id| {
                let register = free.pop().unwrap_or_else(|| {
                    count += 1;
                    number(count - 1)
                });
                registers.insert(id, register);
                register
            };
            // The destination is taken before operands are freed: lanes never alias.
            let dst = v.dst.map_or(0, |id| take(&mut registers, id));
            let second = v.second.map(|id| take(&mut registers, id));
            let resolve = |arg: Arg| match arg {
                Arg::None => 0,
                Arg::Node(id) => registers[&id],
                Arg::Uniform(u) | Arg::Raw(u) => u,
            };
            let [a, b, c] = v.args.map(resolve);
            self.tape.code.push(Instruction { code: v.code, dst, a, b, c: second.unwrap_or(c) });
            let mut dead: Vec<u32> = Vec::new();
            for arg in v.args {
                if let Arg::Node(id) = arg
                    && last_use[&id] == at
                    && registers[&id] as usize >= n_inputs
                {
                    dead.push(registers[&id]);
                }
            }
            for id in [v.dst, v.second].into_iter().flatten() {
                if !last_use.contains_key(&id) {
                    dead.push(registers[&id]);
                }
            }
            dead.sort_unstable();
            dead.dedup();
            free.extend(dead);
        }
        self.tape.n_registers = count;
        let uniform = outputs.iter().zip(sinks).filter(|(_, sink)| **sink != Sink::Keep);
        self.tape.uniform_sinks =
            uniform.filter_map(|(id, &sink)| Some((sink, *self.slots.get(id)?))).collect();
        self.tape.outputs = outputs
            .iter()
            .zip(sinks)
            .map(|(id, sink)| match self.slots.get(id) {
                Some(&slot) => Operand::Uniform(slot),
                None if *sink == Sink::Keep => Operand::Lane(registers[id]),
                None => Operand::Sunk,
            })
            .collect();
        self.tape
    }
}

fn op_key(op: Op, a: Id) -> Item {
    Item::Apply(op, [a; 3])
}
