//! The Legendre-Gauss-Lobatto rule on the unit segment `[0, 1]`: nodes,
//! quadrature weights, and the integrals of its Lagrange basis that make up
//! the collocation constraints (`Eq. colloc_constraint`).
//!
//! Indices count from 0 here and from 1 in the paper. A segment of length `h`
//! that starts at `t` has its mesh points at `t + h tau_k`, and its
//! integrals are `h` times those of the unit segment.

/// Legendre-Gauss-Lobatto rule with `order` points on `[0, 1]`.
///
/// The nodes are 0, 1 and the zeros of `P'_{m-1}(2 tau - 1)`. They are
/// symmetric to the last bit: `1 - nodes[k] == nodes[m-1-k]` both ways, and so
/// all differences of nodes are exact.
///
/// The composite collocation method on these nodes converges with order
/// `2m - 2` at the ends of the segments: `m = 2` is the trapezoidal rule,
/// `m = 3` Hermite-Simpson (Lobatto IIIA).
///
/// ```
/// use phugoid::internals::lgl::Lgl;
///
/// let simpson = Lgl::new(3);
/// assert_eq!(simpson.nodes, [0.0, 0.5, 1.0]);
/// assert!((simpson.weights[1] - 2.0 / 3.0).abs() < 1e-15);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Lgl {
    /// Number of points `m`, ends included; at least 2.
    pub order: usize,
    /// Nodes `tau_k`, increasing from 0 to 1; length `m`.
    pub nodes: Vec<f64>,
    /// Quadrature weights: `integral of g over [0, 1] = sum_k weights[k] g(tau_k)`,
    /// exact up to degree `2m - 3`; length `m`, sum 1.
    pub weights: Vec<f64>,
    /// Barycentric weights of the nodes, up to a common factor.
    barycentric: Vec<f64>,
    /// Gauss-Legendre rule on `[0, 1]`, exact for the degree `m - 1` of the basis.
    gauss: Vec<(f64, f64)>,
}

impl Lgl {
    /// The rule with `order` points.
    ///
    /// # Panics
    /// If `order` is less than 2: the two ends always belong to the rule.
    pub fn new(order: usize) -> Lgl {
        assert!(order >= 2, "a Lobatto rule needs an order (number of points) of at least 2, got {order}");
        let n = order - 1;
        let mut nodes = vec![0.0; order];
        let mut weights = vec![0.0; order];
        for k in 0..order.div_ceil(2) {
            let tau = if 2 * k == n { 0.5 } else { lobatto_node(n, k) };
            // Rounding the larger one first makes both `1 - a == b` and
            // `1 - b == a` exact.
            nodes[n - k] = 1.0 - tau;
            nodes[k] = 1.0 - nodes[n - k];
            // P_n is stationary at the inner nodes, so that the rounding of
            // the node does not harm the weight.
            let (p, _) = legendre(n, tau);
            let weight = 1.0 / ((n * order) as f64 * p * p);
            weights[k] = weight;
            weights[n - k] = weight;
        }
        // The barycentric weights of the nodes are proportional to 1 / P_n(tau_j)
        // (Wang, Huybrechs and Vandewalle, Math. Comp. 83, 2014), which
        // alternates in sign.
        let barycentric = (weights.iter().enumerate())
            .map(|(j, w)| if j % 2 == 0 { w.sqrt() } else { -w.sqrt() })
            .collect();
        Lgl { order, nodes, weights, barycentric, gauss: gauss_legendre(order.div_ceil(2)) }
    }

    /// The integration matrix `C` of `Eq. coll_integral_defn` per unit length of
    /// segment: `C[j, k]` is the integral of `lambda_j` over
    /// `[tau_k, tau_{k+1}]`.
    ///
    /// Row-major, `m` rows and `m - 1` columns: `C[j, k]` is at `j * (m - 1) + k`.
    /// Symmetric to the last bit under reversal of both indices.
    pub fn integration_matrix(&self) -> Vec<f64> {
        let columns = self.order - 1;
        let mut c = vec![0.0; self.order * columns];
        for k in 0..columns.div_ceil(2) {
            let column = self.integrate_from(k, self.nodes[k + 1] - self.nodes[k]);
            for (j, &integral) in column.iter().enumerate() {
                let mirror = (columns - j) * columns + (columns - 1 - k);
                // The middle column is its own mirror image; its second half
                // was written with its first.
                if columns - 1 - k == k && 2 * j > columns {
                    break;
                }
                c[j * columns + k] = integral;
                c[mirror] = integral;
            }
        }
        c
    }

    /// Integrals of every `lambda_j` from node `k` to the point `s`; length `m`.
    ///
    /// They give the collocation polynomial between the mesh points (dense
    /// output): `x(s) = x_k + h sum_j integrate_to(k, s)[j] f_j`. `s` is
    /// meant to lie in `[0, 1]`; outside, the polynomial is continued.
    ///
    /// # Panics
    /// If there is no node `k`.
    pub fn integrate_to(&self, k: usize, s: f64) -> Vec<f64> {
        self.integrate_from(k, s - self.nodes[k])
    }

    /// The Lagrange basis polynomials `lambda_j` (`Eq. lagrange_basis`) at `s`;
    /// length `m`. At a node they are exactly 0 and 1.
    ///
    /// `s` is meant to lie in `[0, 1]`; outside, the polynomials are continued.
    pub fn basis(&self, s: f64) -> Vec<f64> {
        let mut basis = vec![0.0; self.order];
        self.basis_from(0, s, &mut basis);
        basis
    }

    /// Integrals of the basis over `[tau_k, tau_k + length]`, by a
    /// Gauss-Legendre rule that is exact for their degree. Integrating
    /// monomials instead would lose about a digit with every point or two.
    fn integrate_from(&self, k: usize, length: f64) -> Vec<f64> {
        let mut integral = vec![0.0; self.order];
        let mut basis = vec![0.0; self.order];
        for &(node, weight) in &self.gauss {
            self.basis_from(k, length * node, &mut basis);
            for (sum, value) in integral.iter_mut().zip(&basis) {
                *sum += weight * value;
            }
        }
        integral.iter_mut().for_each(|sum| *sum *= length);
        integral
    }

    /// Writes the basis at `tau_k + offset` by the barycentric formula
    /// (Berrut and Trefethen, SIAM Review 46, 2004). Differences of nodes are
    /// exact, so that near node `k` nothing is lost to cancellation.
    fn basis_from(&self, k: usize, offset: f64, basis: &mut [f64]) {
        let distance = |j: usize| (self.nodes[k] - self.nodes[j]) + offset;
        // Closer than this and the quotient below might overflow.
        let hit = (0..self.order).find(|&j| distance(j).abs() < 1e-300);
        if let Some(hit) = hit {
            basis.fill(0.0);
            basis[hit] = 1.0;
            return;
        }
        let mut sum = 0.0;
        for (j, value) in basis.iter_mut().enumerate() {
            *value = self.barycentric[j] / distance(j);
            sum += *value;
        }
        basis.iter_mut().for_each(|value| *value /= sum);
    }
}

/// `P_n(1 - 2 tau)` and `P_n - P_{n-1}` there.
///
/// The three-term recurrence in terms of differences keeps full relative
/// accuracy near `tau = 0`, where the nodes crowd.
fn legendre(n: usize, tau: f64) -> (f64, f64) {
    let (mut p, mut difference) = (1.0, 0.0);
    for i in 0..n {
        let i = i as f64;
        difference = (i * difference - (2.0 * i + 1.0) * 2.0 * tau * p) / (i + 1.0);
        p += difference;
    }
    (p, difference)
}

/// The `k`-th zero of `(1 - x^2) P'_n(x)`, counted from `x = 1`, as
/// `tau = (1 - x) / 2`; for `tau < 1/2`.
fn lobatto_node(n: usize, k: usize) -> f64 {
    if k == 0 {
        return 0.0;
    }
    // The Chebyshev-Lobatto point is close enough for Newton's method.
    let mut tau = (std::f64::consts::FRAC_PI_2 * k as f64 / n as f64).sin().powi(2);
    newton(&mut tau, |tau| {
        // (1 - x^2) P'_n = n (P_{n-1} - x P_n), with derivative -n (n + 1) P_n.
        let (p, difference) = legendre(n, tau);
        (difference - 2.0 * tau * p) / (2.0 * (n + 1) as f64 * p)
    });
    tau
}

/// The Gauss-Legendre rule with `n` points on `[0, 1]`, as (node, weight).
fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    let mut rule = vec![(0.5, 0.0); n];
    for k in 0..n.div_ceil(2) {
        let mut tau = 0.5;
        if 2 * k + 1 != n {
            let angle = std::f64::consts::FRAC_PI_2 * (k as f64 + 0.75) / (n as f64 + 0.5);
            tau = angle.sin().powi(2);
            newton(&mut tau, |tau| {
                let (p, _) = legendre(n, tau);
                p / (2.0 * legendre_derivative(n, tau))
            });
        }
        let slope = legendre_derivative(n, tau);
        // 2 / ((1 - x^2) P'_n^2) on [-1, 1], and half of it on [0, 1].
        let weight = 1.0 / (4.0 * tau * (1.0 - tau) * slope * slope);
        rule[n - 1 - k] = (1.0 - tau, weight);
        rule[k] = (tau, weight);
    }
    rule
}

/// `P'_n(x)` at `x = 1 - 2 tau`, inside the interval.
fn legendre_derivative(n: usize, tau: f64) -> f64 {
    let (p, difference) = legendre(n, tau);
    n as f64 * (2.0 * tau * p - difference) / (4.0 * tau * (1.0 - tau))
}

/// Newton's method with `step` returning what to add, in `tau = (1 - x) / 2`.
/// It converges in 3 or 4 steps; a few more reach the last bit.
fn newton(tau: &mut f64, step: impl Fn(f64) -> f64) {
    for _ in 0..20 {
        let change = step(*tau);
        *tau += change;
        if change.abs() <= 0.5 * f64::EPSILON * *tau {
            break;
        }
    }
}
