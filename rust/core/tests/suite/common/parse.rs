//! Reads printed infix text as Python would, and evaluates it: an independent check of printing.

use std::collections::HashMap;
use std::sync::Arc;

use phugoid::expr::Op;

/// The value of an infix expression, after definitions of parts that occur in it: `a = x*x; a + a`. Operators bind as in
/// Python.
pub fn evaluate(text: &str, values: &HashMap<Arc<str>, f64>) -> f64 {
    let Some((definitions, last)) = text.rsplit_once("; ") else { return value(text, values) };
    let mut known = values.clone();
    for definition in definitions.split("; ") {
        let (name, part) = definition.split_once(" = ").unwrap();
        let part = value(part, &known);
        known.insert(name.into(), part);
    }
    value(last, &known)
}

fn value(text: &str, values: &HashMap<Arc<str>, f64>) -> f64 {
    let mut parser = Parser { rest: text, values };
    let value = parser.comparison();
    assert!(parser.rest.trim().is_empty(), "'{}' is left of '{text}'", parser.rest);
    value
}

struct Parser<'a> {
    rest: &'a str,
    values: &'a HashMap<Arc<str>, f64>,
}

impl Parser<'_> {
    fn take(&mut self, token: &str) -> bool {
        self.rest = self.rest.trim_start();
        match self.rest.strip_prefix(token) {
            // `*` is no part of `**`.
            Some(rest) if !(token == "*" && rest.starts_with('*')) => {
                self.rest = rest;
                true
            }
            _ => false,
        }
    }

    fn comparison(&mut self) -> f64 {
        let left = self.sum();
        if self.take("<=") {
            f64::from(u8::from(left <= self.sum()))
        } else if self.take("<") {
            f64::from(u8::from(left < self.sum()))
        } else {
            left
        }
    }

    fn sum(&mut self) -> f64 {
        let mut value = self.product();
        loop {
            if self.take("+") {
                value += self.product();
            } else if self.take("-") {
                value -= self.product();
            } else {
                return value;
            }
        }
    }

    fn product(&mut self) -> f64 {
        let mut value = self.signed();
        loop {
            if self.take("*") {
                value *= self.signed();
            } else if self.take("/") {
                value /= self.signed();
            } else {
                return value;
            }
        }
    }

    fn signed(&mut self) -> f64 {
        if self.take("-") { -self.signed() } else { self.power() }
    }

    fn power(&mut self) -> f64 {
        let base = self.atom();
        if self.take("**") { base.powf(self.signed()) } else { base }
    }

    fn atom(&mut self) -> f64 {
        if self.take("(") {
            let value = self.comparison();
            assert!(self.take(")"), "a bracket is not closed before '{}'", self.rest);
            return value;
        }
        let digits = self.rest.starts_with(|c: char| c.is_ascii_digit());
        let mut before = ' ';
        let end = self.rest.find(|c: char| {
            let exponent = digits && before == 'e' && c == '-';
            before = c;
            !(c.is_alphanumeric() || "._".contains(c) || exponent)
        });
        let (word, rest) = self.rest.split_at(end.unwrap_or(self.rest.len()));
        self.rest = rest;
        if let Ok(number) = word.parse::<f64>() {
            return number;
        }
        if !self.take("(") {
            return *self.values.get(word).unwrap_or_else(|| panic!("unknown word '{word}'"));
        }
        let mut args = vec![self.comparison()];
        while self.take(",") {
            args.push(self.comparison());
        }
        assert!(self.take(")"), "a bracket is not closed before '{}'", self.rest);
        let op = Op::from_name(word).unwrap_or_else(|| panic!("unknown function '{word}'"));
        (op.entry().value)(&args)
    }
}
