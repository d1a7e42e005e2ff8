//! Infix text that reads back as the same expression, and LaTeX with closed brackets.

use crate::common::{close, parse, values};
use phugoid::expr::{Expr, Op, lt, select};
use phugoid::internals::display::symbol_parts;
use phugoid::internals::operations::TABLE;

fn symbols() -> [Expr; 3] {
    ["a", "b", "c"].map(Expr::symbol)
}

/// Evaluates an expression and its text at a point where nothing vanishes or cancels.
fn reads_back(expr: &Expr) {
    let at = values(&[("a", 1.7), ("b", 0.6), ("c", 2.3)]);
    let (value, text) = (expr.evaluate(&at).unwrap(), expr.to_string());
    let read = parse::evaluate(&text, &at);
    assert!(close(value, read, 1e-14), "{expr:?}\nprinted as {text}: {read}, not {value}");
}

fn brackets_close(text: &str) {
    let mut open = Vec::new();
    for c in text.chars() {
        match c {
            '(' => open.push(')'),
            '{' => open.push('}'),
            '[' => open.push(']'),
            ')' | '}' | ']' => assert_eq!(open.pop(), Some(c), "in {text}"),
            _ => (),
        }
    }
    assert!(open.is_empty(), "'{open:?}' missing in {text}");
    assert_eq!(text.matches("\\left").count(), text.matches("\\right").count(), "in {text}");
    assert_eq!(text.matches("\\begin").count(), text.matches("\\end").count(), "in {text}");
}

#[test]
fn chosen_cases_print_as_expected() {
    let [a, b, c] = symbols();
    let cases = [
        (&a - (&b - &c), "a - (b - c)"),
        (&a - &b - &c, "a - b - c"),
        (&a - (&b + &c), "a - (b + c)"),
        (&a / (&b * &c), "a/(b*c)"),
        (&a / (&b / &c), "a/(b/c)"),
        (&a / &b / &c, "a/b/c"),
        ((-&a).pow(2.0), "(-a)**2"),
        (-a.pow(2.0), "-a**2"),
        (a.pow(b.pow(&c)), "a**(b**c)"),
        (a.pow(&b).pow(&c), "(a**b)**c"),
        (2.0 * (-&a), "2*(-a)"),
        ((-&a) * &b, "-a*b"),
        (-(&a * &b), "-(a*b)"),
        (-(&a + &b), "-(a + b)"),
        (&a + (-&b), "a + (-b)"),
        (&a - (-2.0 * &b), "a - (-2*b)"),
        (a.pow(-2.0), "a**(-2)"),
        (Expr::constant(-2.0).pow(&a), "(-2)**a"),
        ((&a + &b) * &c, "(a + b)*c"),
        (a.sin().pow(2.0), "sin(a)**2"),
        (select(lt(&a, &b), &a + &b, &c), "where(a < b, a + b, c)"),
        (lt(&a, &b) * &c, "(a < b)*c"),
    ];
    for (expr, text) in cases {
        assert_eq!(expr.to_string(), text);
        if !text.contains("(-2)**a") {
            reads_back(&expr);
        }
    }
}

#[test]
fn every_pair_of_operations_reads_back_as_it_was() {
    let [a, b, c] = symbols();
    let args = [a, b, c];
    for outer in &TABLE {
        for inner in &TABLE {
            for place in 0..outer.arity {
                let mut outer_args = args[..outer.arity].to_vec();
                outer_args[place] = Expr::apply(inner.op, args[..inner.arity].to_vec());
                reads_back(&Expr::apply(outer.op, outer_args));
            }
        }
    }
}

#[test]
fn every_pair_of_operations_has_closed_brackets() {
    let args = symbols();
    for outer in &TABLE {
        for inner in &TABLE {
            let one = Expr::apply(inner.op, args[..inner.arity].to_vec());
            let expr = Expr::apply(outer.op, vec![one; outer.arity]);
            for text in [expr.to_string(), expr.latex()] {
                assert!(!text.is_empty());
                brackets_close(&text);
            }
            for name in ["a", "b", "c"].iter().take(inner.arity) {
                let found = expr.latex().matches(name).count();
                assert!(found >= outer.arity, "{name} is missing in {}", expr.latex());
            }
        }
    }
}

#[test]
fn chosen_cases_print_in_latex() {
    let [a, b, c] = symbols();
    let cases = [
        (&a / &b, r"\frac{a}{b}"),
        (Expr::apply(Op::Recip, vec![a.clone()]), r"\frac{1}{a}"),
        ((&a + &b) / &c, r"\frac{a + b}{c}"),
        ((&a / &b).pow(2.0), r"{\left(\frac{a}{b}\right)}^{2}"),
        (a.exp().pow(2.0), r"{\left(e^{a}\right)}^{2}"),
        (a.pow(&b + &c), r"{a}^{b + c}"),
        ((&a + &b).pow(2.0), r"{\left(a + b\right)}^{2}"),
        (&a * (&b + &c), r"a \, \left(b + c\right)"),
        (Expr::symbol("alpha_dot").sqrt(), r"\sqrt{\alpha_{\mathrm{dot}}}"),
        (Expr::constant(1.5e-9) * &a, r"1.5 \cdot 10^{-9} \, a"),
        (Expr::symbol("Cma") * Expr::symbol("CL"), r"C_{m\alpha} \, C_{L}"),
        (Expr::symbol("Mde") + Expr::symbol("CL_alpha"), r"M_{\delta e} + \mathrm{CL}_{\alpha}"),
        (&a * 0.396 + 0.000_243_996_350_824, r"a \cdot 0.396 + 0.000243996"),
        (&a * -2.0 + 1_234_567.0, r"a \cdot \left(-2\right) + 1.23457 \cdot 10^{6}"),
    ];
    for (expr, text) in cases {
        assert_eq!(expr.latex(), text);
    }
}

#[test]
fn symbols_have_a_head_and_indices() {
    let cases: [(&str, &[&str]); 10] = [
        ("Cma", &["C", "mα"]),
        ("CL", &["C", "L"]),
        ("Mde", &["M", "δe"]),
        ("Nbeta", &["N", "β"]),
        ("sigma_alpha", &["σ", "α"]),
        ("sigma_CL", &["σ", "CL"]),
        ("CL_alpha", &["CL", "α"]),
        ("Delta", &["Δ"]),
        ("q_dot_0", &["q", "dot", "0"]),
        ("mass", &["mass"]),
    ];
    for (name, parts) in cases {
        assert_eq!(symbol_parts(name), parts);
    }
}

#[test]
fn numbers_read_back_exactly() {
    for number in [0.1, 1.0 / 3.0, 6.02e23, 1.6e-35, 1e300, 5e-324, f64::MAX] {
        let text = Expr::constant(number).to_string();
        assert_eq!(text.parse::<f64>().unwrap(), number);
        assert!(text.len() < 30, "{text} is no way to write {number:e}");
    }
}
