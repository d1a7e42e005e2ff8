//! A tape with sinks gives what the same tape without them gives.

use phugoid::expr::Graph;
use phugoid::internals::tape::{Inputs, Operand, Sink, Sinks, Tape, Workspace};

#[test]
fn sums_and_rows_are_those_of_the_kept_outputs() {
    let mut graph = Graph::new();
    let (x, y, p) = (graph.symbol("x"), graph.symbol("y"), graph.symbol("p"));
    let product = graph.mul(x, y);
    let sum = graph.add(product, p);
    let twice = graph.add(p, p);
    // Used again after it went to its sink, a bare lane input, and a uniform.
    let outputs = [product, sum, x, twice, twice];
    let sinks = [Sink::Sum(1), Sink::Store(0), Sink::Store(1), Sink::Sum(0), Sink::Store(2)];
    let inputs = Inputs { lanes: vec![x, y], uniforms: vec![p] };
    let tape = Tape::compile_into(&graph, &inputs, &outputs, &sinks).unwrap();
    assert_eq!(tape.outputs[0], Operand::Sunk);

    let (n, count, factor) = (16, 11, -2.0);
    let mut workspace = Workspace::default();
    let registers = workspace.registers(&tape, n);
    for l in 0..n {
        registers[l] = l as f64;
        registers[n + l] = 0.5 * l as f64 - 3.0;
    }
    let mut uniforms = Vec::new();
    tape.uniforms(&[0.25], &mut uniforms);
    let (mut sums, mut rows) = (vec![100.0; 2], vec![f64::NAN; 3 * count]);
    let mut into = Sinks { count, factor, sums: &mut sums, rows: &mut rows };
    tape.run_into(registers, &uniforms, n, &mut into);

    let value = |l: usize| l as f64 * (0.5 * l as f64 - 3.0);
    let expected: f64 = (0..count).map(value).sum();
    assert!((sums[1] - 100.0 - expected).abs() < 1e-12 * expected.abs());
    assert_eq!(sums[0], 100.0 + 0.5 * count as f64);
    for l in 0..count {
        assert!((rows[l] - factor * (value(l) + 0.25)).abs() < 1e-13);
        assert_eq!(rows[count + l], factor * l as f64);
        assert_eq!(rows[2 * count + l], factor * 0.5);
    }
}
