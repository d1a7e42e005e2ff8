//! Operations as they are applied: constants folded, and the identities that keep derivatives small.

use super::{Graph, Id, Item};
use crate::expr::ops::Op;

/// A factor or a sign is put into the branches of `where` down to so many levels. Deeper ones, as of a chain of cases,
/// are taken as a whole: each step of a sweep would go through all of them again.
const DEEP: u32 = 128;

/// Two terms that one condition switches, and both branches of each.
struct Switched {
    condition: Id,
    yes: [Id; 2],
    no: [Id; 2],
}

impl Graph {
    /// Applies an operation, folding constants and the identities that keep derivatives small.
    /// Constants are folded only to finite values: a failure must stay visible where it happens.
    pub fn apply(&mut self, op: Op, args: &[Id]) -> Id {
        debug_assert_eq!(args.len(), op.entry().arity);
        if let Some(values) = self.all_constant(args) {
            let value = (op.entry().value)(&values);
            if value.is_finite() {
                return self.constant(value);
            }
        }
        match op {
            Op::Add => self.add(args[0], args[1]),
            Op::Sub => self.sub(args[0], args[1]),
            Op::Mul => self.mul(args[0], args[1]),
            Op::Div => self.div(args[0], args[1]),
            Op::Neg => self.neg(args[0]),
            Op::Recip => self.recip(args[0]),
            Op::Pow => self.pow(args[0], args[1]),
            Op::Where => self.select(args[0], args[1], args[2]),
            Op::Min | Op::Max if args[0] == args[1] => args[0],
            _ => self.intern_apply(op, args),
        }
    }

    /// Applies an operation of one argument.
    pub fn unary(&mut self, op: Op, a: Id) -> Id {
        self.apply(op, &[a])
    }

    fn intern_apply(&mut self, op: Op, args: &[Id]) -> Id {
        let mut full = [args[0]; 3];
        full[..args.len()].copy_from_slice(args);
        // One order for the same operands; constants go first.
        let place = |a: Id| (self.as_constant(a).is_none(), a);
        if op.entry().commutative && place(full[0]) > place(full[1]) {
            full.swap(0, 1);
            full[2] = full[0];
        }
        self.intern(Item::Apply(op, full))
    }

    fn fold2(&mut self, op: Op, a: Id, b: Id) -> Option<Id> {
        let value = (op.entry().value)(&[self.as_constant(a)?, self.as_constant(b)?]);
        value.is_finite().then(|| self.constant(value))
    }

    fn negated(&self, id: Id) -> Option<Id> {
        match self.item(id) {
            Item::Apply(Op::Neg, a) => Some(a[0]),
            _ => None,
        }
    }

    /// a + b
    pub fn add(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Add, a, b) {
            return id;
        }
        if self.as_constant(a) == Some(0.0) {
            return b;
        }
        if self.as_constant(b) == Some(0.0) {
            return a;
        }
        if let Some(x) = self.negated(b) {
            return self.sub(a, x);
        }
        if let Some(x) = self.negated(a) {
            return self.sub(b, x);
        }
        if a == b {
            let two = self.constant(2.0);
            return self.mul(two, a);
        }
        if let Some(Switched { condition, yes, no }) = self.same_switch(a, b) {
            let (yes, no) = (self.add(yes[0], yes[1]), self.add(no[0], no[1]));
            return self.select(condition, yes, no);
        }
        self.intern_apply(Op::Add, &[a, b])
    }

    /// a − b
    pub fn sub(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Sub, a, b) {
            return id;
        }
        if self.as_constant(b) == Some(0.0) {
            return a;
        }
        if self.as_constant(a) == Some(0.0) {
            return self.neg(b);
        }
        if a == b {
            return self.zero();
        }
        if let Some(x) = self.negated(b) {
            return self.add(a, x);
        }
        if let Some(Switched { condition, yes, no }) = self.same_switch(a, b) {
            let (yes, no) = (self.sub(yes[0], yes[1]), self.sub(no[0], no[1]));
            return self.select(condition, yes, no);
        }
        self.intern_apply(Op::Sub, &[a, b])
    }

    /// Returns two terms as what the same condition switches. Their sum is then switched as one.
    fn same_switch(&self, a: Id, b: Id) -> Option<Switched> {
        match (self.item(a), self.item(b)) {
            (Item::Apply(Op::Where, x), Item::Apply(Op::Where, y))
                if x[0] == y[0]
                    && self.switched[a.index()]
                    && self.switched[b.index()]
                    && !self.is_deep(a)
                    && !self.is_deep(b) =>
            {
                Some(Switched { condition: x[0], yes: [x[1], y[1]], no: [x[2], y[2]] })
            }
            _ => None,
        }
    }

    /// −a
    pub fn neg(&mut self, a: Id) -> Id {
        if let Some(c) = self.as_constant(a) {
            return self.constant(-c);
        }
        match self.item(a) {
            Item::Apply(Op::Neg, x) => x[0],
            Item::Apply(Op::Sub, x) => self.sub(x[1], x[0]),
            Item::Apply(Op::Mul, x) if self.as_constant(x[0]).is_some() => {
                let c = self.neg(x[0]);
                self.mul(c, x[1])
            }
            Item::Apply(Op::Where, x) if !self.is_deep(a) => {
                let (yes, no) = (self.neg(x[1]), self.neg(x[2]));
                self.select(x[0], yes, no)
            }
            _ => self.intern_apply(Op::Neg, &[a]),
        }
    }

    /// a · b
    pub fn mul(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Mul, a, b) {
            return id;
        }
        // Constants go first.
        let (a, b) = if self.as_constant(b).is_some() { (b, a) } else { (a, b) };
        if let Some(c) = self.as_constant(a) {
            if c == 0.0 {
                return self.zero();
            }
            if c == 1.0 {
                return b;
            }
            if c == -1.0 {
                return self.neg(b);
            }
            if let Item::Apply(Op::Mul, x) = self.item(b)
                && let Some(d) = self.as_constant(x[0])
            {
                let product = self.constant(c * d);
                return self.mul(product, x[1]);
            }
        }
        if let Some(x) = self.negated(b) {
            let product = self.mul(a, x);
            return self.neg(product);
        }
        if let Some(x) = self.negated(a) {
            let product = self.mul(x, b);
            return self.neg(product);
        }
        // A factor that is switched off must stay off: where(c, x, 0)·p as where(c, x·p, 0) keeps
        // a p that is not finite on the branch not taken (the derivative of sqrt at 0, say) out
        // of the result.
        for (s, p) in [(a, b), (b, a)] {
            if self.switched[s.index()] && self.is_deep(s) {
                return self.switched_product(s, p);
            }
            if let Item::Apply(Op::Where, x) = self.item(s) {
                if self.as_constant(x[2]) == Some(0.0) {
                    let (on, off) = (self.mul(x[1], p), self.zero());
                    return self.select(x[0], on, off);
                }
                if self.as_constant(x[1]) == Some(0.0) {
                    let (on, off) = (self.mul(x[2], p), self.zero());
                    return self.select(x[0], off, on);
                }
            }
        }
        // The same for a sum of terms under several conditions, term by term.
        for (s, p) in [(a, b), (b, a)] {
            if let Item::Apply(op @ (Op::Add | Op::Sub), x) = self.item(s)
                && self.switched[s.index()]
            {
                let (left, right) = (self.mul(x[0], p), self.mul(x[1], p));
                return self.apply(op, &[left, right]);
            }
        }
        // c·x times y as c·(x·y), so that the product x·y is shared whatever the constant.
        if self.as_constant(a).is_none() {
            for (s, p) in [(a, b), (b, a)] {
                if let Item::Apply(Op::Mul, x) = self.item(s)
                    && self.as_constant(x[0]).is_some()
                {
                    let product = self.mul(x[1], p);
                    return self.mul(x[0], product);
                }
            }
        }
        self.intern_apply(Op::Mul, &[a, b])
    }

    fn is_deep(&self, a: Id) -> bool {
        self.depth[a.index()] > DEEP
    }

    /// s · p, s switched: the product where s is on, else 0.
    fn switched_product(&mut self, s: Id, p: Id) -> Id {
        let (condition, zero) = (self.condition(s), self.zero());
        let product = if condition == s { p } else { self.intern_apply(Op::Mul, &[s, p]) };
        self.select(condition, product, zero)
    }

    /// 1 where a switched node is on, else 0: the node itself where it is 1 or 0.
    fn condition(&mut self, root: Id) -> Id {
        // With a stack: chains of cases are deep.
        let mut stack = vec![root];
        while let Some(&id) = stack.last() {
            if self.conditions.contains_key(&id) {
                stack.pop();
                continue;
            }
            let open: Vec<Id> = match self.item(id) {
                Item::Apply(Op::Where | Op::Add | Op::Sub, x) if self.switched[id.index()] => {
                    let parts = if matches!(self.item(id), Item::Apply(Op::Where, _)) {
                        [x[1], x[2]]
                    } else {
                        [x[0], x[1]]
                    };
                    parts.into_iter().filter(|p| !self.conditions.contains_key(p)).collect()
                }
                _ => Vec::new(),
            };
            if !open.is_empty() {
                stack.extend(open);
                continue;
            }
            let of = |graph: &Graph, p: Id| graph.conditions[&p];
            let on = match self.item(id) {
                Item::Apply(Op::Where, x) if self.switched[id.index()] => {
                    let (yes, no) = (of(self, x[1]), of(self, x[2]));
                    self.select(x[0], yes, no)
                }
                Item::Apply(Op::Add | Op::Sub, x) if self.switched[id.index()] => {
                    let (left, right) = (of(self, x[0]), of(self, x[1]));
                    self.apply(Op::Or, &[left, right])
                }
                _ if self.as_constant(id) == Some(0.0) => self.zero(),
                _ => self.one(),
            };
            self.conditions.insert(id, on);
            stack.pop();
        }
        self.conditions[&root]
    }

    /// a · b of two nodes that are both wanted for themselves: nothing is taken out of them, so the
    /// product costs one instruction.
    pub fn product(&mut self, a: Id, b: Id) -> Id {
        if self.as_constant(a).is_some() || self.as_constant(b).is_some() {
            return self.mul(a, b);
        }
        self.intern_apply(Op::Mul, &[a, b])
    }

    /// The sum of nodes times weights.
    pub fn weighted_sum(&mut self, weights: &[Id], nodes: &[Id]) -> Id {
        let mut sum = self.zero();
        for (&weight, &node) in weights.iter().zip(nodes) {
            let term = self.product(weight, node);
            sum = self.add(sum, term);
        }
        sum
    }

    /// a / b, as a · (1/b): the reciprocal is shared by all quotients and derivatives.
    pub fn div(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Div, a, b) {
            return id;
        }
        let inverse = self.recip(b);
        self.mul(a, inverse)
    }

    /// 1 / a
    pub fn recip(&mut self, a: Id) -> Id {
        if let Some(c) = self.as_constant(a) {
            let inverse = 1.0 / c;
            if inverse.is_finite() {
                return self.constant(inverse);
            }
        }
        match self.item(a) {
            Item::Apply(Op::Neg, x) => {
                let inverse = self.recip(x[0]);
                self.neg(inverse)
            }
            _ => self.intern_apply(Op::Recip, &[a]),
        }
    }

    /// a^b; small whole and half exponents become products, roots and reciprocals.
    pub fn pow(&mut self, a: Id, b: Id) -> Id {
        if let Some(id) = self.fold2(Op::Pow, a, b) {
            return id;
        }
        match self.as_constant(b) {
            Some(0.0) => self.one(),
            Some(1.0) => a,
            Some(2.0) => self.mul(a, a),
            Some(3.0) => {
                let square = self.mul(a, a);
                self.mul(a, square)
            }
            Some(0.5) => self.unary(Op::Sqrt, a),
            Some(-0.5) => {
                let root = self.unary(Op::Sqrt, a);
                self.recip(root)
            }
            Some(-1.0) => self.recip(a),
            Some(-2.0) => {
                let inverse = self.recip(a);
                self.mul(inverse, inverse)
            }
            _ => self.intern_apply(Op::Pow, &[a, b]),
        }
    }

    /// where(condition, yes, no)
    pub fn select(&mut self, condition: Id, yes: Id, no: Id) -> Id {
        // Within a branch the same condition is known.
        let yes = self.branch(condition, yes).map_or(yes, |x| x[1]);
        let no = self.branch(condition, no).map_or(no, |x| x[2]);
        if yes == no {
            return yes;
        }
        match self.as_constant(condition) {
            Some(0.0) => no,
            Some(_) => yes,
            None => self.intern_apply(Op::Where, &[condition, yes, no]),
        }
    }

    /// The arguments of a `where` on this very condition.
    fn branch(&self, condition: Id, a: Id) -> Option<[Id; 3]> {
        match self.item(a) {
            Item::Apply(Op::Where, x) if x[0] == condition => Some(x),
            _ => None,
        }
    }
}
