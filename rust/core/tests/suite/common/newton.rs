//! Solves the defects of one experiment for its states, parameters and first point held.

use nalgebra::{DMatrix, DVector};
use phugoid::collocation::Collocation;
use phugoid::nlp::{ExperimentId, Nlp, PointId};

/// Newton's method. Constraint k ends at point k + 1, so the Jacobian with respect to all points but
/// the first is square, and block lower triangular: a block a segment, then one a tied sample.
pub fn solve_defects(problem: &Collocation, xi: &mut [f64]) {
    assert_eq!(problem.meshes.len(), 1, "one experiment");
    let (n_x, mesh) = (problem.layout.n_x, &problem.meshes[ExperimentId(0)]);
    let first = problem.layout.state(PointId(1)).0;
    let (m, k) = (problem.m(), n_x * (mesh.rule.order() - 1));
    let ends: Vec<usize> = (1..=mesh.segments.len())
        .map(|s| s * k)
        .chain((1..=mesh.between.len()).map(|b| mesh.segments.len() * k + b * n_x))
        .collect();
    assert_eq!(ends.last(), Some(&m));
    let structure = problem.jacobian_structure();
    let mut by_row: Vec<Vec<usize>> = vec![Vec::new(); m];
    for i in 0..structure.len() {
        if structure.columns[i] as usize >= first {
            by_row[structure.rows[i] as usize].push(i);
        }
    }
    let (mut c, mut jacobian) = (vec![0.0; m], vec![0.0; structure.len()]);
    for _ in 0..30 {
        problem.constraints(xi, &mut c).unwrap();
        problem.jacobian(xi, &mut jacobian).unwrap();
        let mut step = vec![0.0; m];
        let mut start = 0;
        for &end in &ends {
            let mut block = DMatrix::zeros(end - start, end - start);
            let mut rhs = DVector::zeros(end - start);
            for row in start..end {
                rhs[row - start] = -c[row];
                for &i in &by_row[row] {
                    let column = structure.columns[i] as usize - first;
                    assert!(column < end, "the constraint ending at point {row} reaches beyond its block");
                    if column >= start {
                        block[(row - start, column - start)] += jacobian[i];
                    } else {
                        rhs[row - start] -= jacobian[i] * step[column];
                    }
                }
            }
            let solution = block.lu().solve(&rhs).expect("a regular block");
            step[start..end].copy_from_slice(solution.as_slice());
            start = end;
        }
        let size = step.iter().fold(0.0, |a: f64, s| a.max(s.abs()));
        xi[first..].iter_mut().zip(&step).for_each(|(x, s)| *x += s);
        // After so small a step rounding errors are all that is left.
        if size < 1e-11 {
            return;
        }
    }
    panic!("Newton's method did not converge");
}
