//! The places of the entries of the derivatives.

use super::Shooting;
use super::pieces::triangle;

impl Shooting {
    /// Lays out the sparse entries of the Jacobian and the Hessian: node by node, then between parameters.
    pub(super) fn place_derivatives(&mut self) {
        let (n_x, n_theta) = (self.layout.n_x, self.layout.n_theta);
        for (e, nodes) in self.nodes.numbered() {
            let map = &self.posed.estimands.maps[e];
            for s in 0..nodes.len() {
                let x = self.layout.state(self.layout.first_point[e] + s).0;
                for r in 0..n_x {
                    (0..=r).for_each(|q| self.hessian_structure.push(x + r, x + q));
                    map.iter().for_each(|p| self.hessian_structure.push(x + r, p.0));
                }
                if s + 1 < nodes.len() {
                    let row = (self.layout.first_row(e) + s) * n_x;
                    for r in 0..n_x {
                        self.jacobian_structure.push(row + r, x + n_x + r);
                        (0..n_x).for_each(|q| self.jacobian_structure.push(row + r, x + q));
                        let model = map.iter().take(self.posed.n_seen());
                        model.for_each(|p| self.jacobian_structure.push(row + r, p.0));
                    }
                }
            }
        }
        for r in 0..n_theta {
            (0..=r).for_each(|q| self.hessian_structure.push(r, q));
        }
        if let Some(boundary) = &mut self.boundary {
            let structures = (&mut self.jacobian_structure, &mut self.hessian_structure);
            boundary.place(&self.layout, &self.posed.estimands, structures);
        }
        // The objective's own: of samples, then dense between parameters.
        self.objective.place(&self.posed, &self.sampled, &mut self.sampled_hessian);
        let first = self.sampled_hessian.len();
        for r in 0..n_theta {
            (0..=r).for_each(|q| self.sampled_hessian.push(r, q));
        }
        self.objective.place_pairs(&self.posed, |r, c| first + triangle(r.0) + c.0);
    }
}
