//! Systems whose dynamics fall into parts, against dense linear algebra.

use crate::common::Random;
use nalgebra::{DMatrix, DVector};
use phugoid::linalg::arrow::ArrowKkt;
use phugoid::linalg::{self, Effort, Factor, KktSolver};
use phugoid::nlp::{Boundary, Chain, Chains, ConstraintId, StateId, Structure, Threads, Tie, VariableId};

/// What a random system is like.
#[derive(Clone, Debug)]
struct Kind {
    /// Numbers of states; which states these are is random.
    parts: Vec<usize>,
    border: usize,
    /// Segments and points of each chain.
    chains: Vec<(usize, usize)>,
    /// Ties and boundary conditions of each chain.
    ties: usize,
    boundary: usize,
    /// By what a change of the first part grows from segment to segment.
    growth: f64,
    /// Whether the Hessian has entries of no sign beside the squares of outputs.
    exact: bool,
    /// Whether outputs see several parts.
    joined: bool,
}

impl Kind {
    fn random(random: &mut Random) -> Kind {
        let mut to = |most: u64| (random.bits() % most) as usize;
        let parts: Vec<usize> = (0..1 + to(4)).map(|_| 1 + to(3)).collect();
        let states: usize = parts.iter().sum();
        let border = to(5);
        Kind {
            border,
            chains: (0..1 + to(3)).map(|_| (1 + to(5), 1 + to(3))).collect(),
            ties: to(4),
            boundary: to(states as u64 + u64::from(border > 0)).min(2),
            growth: 0.9,
            exact: to(2) == 1,
            joined: to(4) > 0,
            parts,
        }
    }
}

/// Entries of a matrix.
#[derive(Clone, Debug, Default)]
struct Entries {
    structure: Structure,
    values: Vec<f64>,
}

impl Entries {
    /// Some entries come in two.
    fn push(&mut self, random: &mut Random, row: usize, column: usize, value: f64) {
        let first = if random.bits().is_multiple_of(5) { random.between(-1.0, 1.0) } else { value };
        self.one(row, column, first);
        if first != value {
            self.one(row, column, value - first);
        }
    }

    fn one(&mut self, row: usize, column: usize, value: f64) {
        self.structure.rows.push(row as u32);
        self.structure.columns.push(column as u32);
        self.values.push(value);
    }
}

struct System {
    chains: Chains,
    units: Vec<f64>,
    hessian: Entries,
    jacobian: Entries,
    /// Units of all variables, and reciprocals of those of all constraints.
    scale: Vec<f64>,
    n: usize,
    m: usize,
}

/// Builds a random system: all of one structure where kinds and seeds but for the growth are the same.
fn system(kind: &Kind, seed: u64) -> System {
    let random = &mut Random(seed);
    let mut part_of: Vec<usize> =
        kind.parts.iter().enumerate().flat_map(|(p, &size)| std::iter::repeat_n(p, size)).collect();
    let n_x = part_of.len();
    (1..n_x).for_each(|i| part_of.swap(i, random.bits() as usize % (i + 1)));
    // The second part has no parameters, others share them.
    let enters: Vec<Vec<usize>> = (0..kind.parts.len())
        .map(|p| (0..kind.border).filter(|_| p != 1 && random.bits().is_multiple_of(2)).collect())
        .collect();
    let units: Vec<f64> = (0..n_x).map(|_| 10f64.powf(random.between(-2.0, 2.0))).collect();

    // Where all stands.
    let mut chains = Chains { border: kind.border, n_x, chains: Vec::new() };
    let (mut n, mut m) = (kind.border, 0);
    for &(segments, points) in &kind.chains {
        let mut of_tie: Vec<usize> = (0..kind.ties).map(|_| random.bits() as usize % segments).collect();
        of_tie.sort_unstable();
        let inner = segments * points * n_x;
        let tie = |(i, &segment): (usize, &usize)| {
            let at = inner + i * n_x;
            Tie { segment, variable: VariableId(n + n_x + at), row: ConstraintId(m + at) }
        };
        let ties = of_tie.iter().enumerate().map(tie).collect();
        let boundary = Boundary::default();
        chains.chains.push(Chain {
            variable: VariableId(n),
            row: ConstraintId(m),
            segments,
            points,
            ties,
            boundary,
        });
        n += n_x + inner + kind.ties * n_x;
        m += inner + kind.ties * n_x;
    }
    let mut scale = vec![1.0; kind.border];
    scale.extend((kind.border..n).map(|i| units[(i - kind.border) % n_x]));
    scale.extend((0..m).map(|i| 1.0 / units[i % n_x]));
    for chain in &mut chains.chains {
        let first = random.bits() as usize;
        let states: Vec<StateId> = (0..kind.boundary).map(|i| StateId((first + i) % n_x)).collect();
        scale.extend(states.iter().map(|s| 1.0 / units[s.0]));
        chain.boundary = Boundary { row: ConstraintId(m), states };
        m += kind.boundary;
    }
    let mut system =
        System { chains, units, hessian: Entries::default(), jacobian: Entries::default(), scale, n, m };
    for chain in &system.chains.chains {
        equations(kind, &part_of, &enters, chain, random, &mut system.jacobian);
        outputs(kind, &part_of, chain, random, &mut system.hessian);
    }
    for b in 0..kind.border {
        system.hessian.push(random, b, b, 2.0);
        (0..b).for_each(|c| system.hessian.push(random, b, c, 0.1));
    }
    // From units to those of the program.
    let System { scale, hessian, jacobian, .. } = &mut system;
    for (entries, first) in [(hessian, 0), (jacobian, n)] {
        let s = &entries.structure;
        for ((value, &r), &c) in entries.values.iter_mut().zip(&s.rows).zip(&s.columns) {
            *value /= scale[first + r as usize] * scale[c as usize];
        }
    }
    system
}

fn equations(
    kind: &Kind,
    part_of: &[usize],
    enters: &[Vec<usize>],
    chain: &Chain,
    random: &mut Random,
    to: &mut Entries,
) {
    let n_x = part_of.len();
    let states = |p: usize| (0..n_x).filter(move |&i| part_of[i] == p);
    for s in 0..chain.segments {
        let point = |j: usize| chain.variable.0 + (s * chain.points + j) * n_x;
        let core = (1..=chain.points).map(|j| (chain.row.0 + (s * chain.points + j - 1) * n_x, point(j)));
        let ties = chain.ties.iter().filter(|t| t.segment == s).map(|t| (t.row.0, t.variable.0));
        for (k, (row, own)) in core.chain(ties).enumerate() {
            for (i, &p) in part_of.iter().enumerate() {
                let row = row + i;
                for j in states(p) {
                    let before = if p == 0 { kind.growth } else { 0.9 };
                    let before = if i == j { before } else { random.between(-0.1, 0.1) };
                    to.push(random, row, point(0) + j, -before);
                    for l in 1..=chain.points {
                        let other = random.between(-0.1, 0.1);
                        let value = if l == k + 1 && i == j { 1.0 + other } else { other };
                        to.push(random, row, point(l) + j, value);
                    }
                }
                if k >= chain.points {
                    to.one(row, own + i, 1.0);
                }
                for &b in &enters[p] {
                    let value = random.between(-0.5, 0.5);
                    to.push(random, row, b, value);
                }
            }
        }
    }
    // Conditions may join parts.
    let last = chain.variable.0 + chain.segments * chain.points * n_x;
    for (k, &StateId(s)) in chain.boundary.states.iter().enumerate() {
        let row = chain.boundary.row.0 + k;
        for i in 0..n_x {
            let (a, b) = (random.between(-0.2, 0.2), random.between(-0.2, 0.2));
            to.push(random, row, chain.variable.0 + i, if i == s { 1.0 } else { a });
            if random.bits().is_multiple_of(2) {
                to.push(random, row, last + i, b);
            }
        }
        (0..kind.border.min(1)).for_each(|b| to.push(random, row, b, 0.3));
    }
}

fn outputs(kind: &Kind, part_of: &[usize], chain: &Chain, random: &mut Random, to: &mut Entries) {
    let n_x = part_of.len();
    let inner = (0..=chain.segments * chain.points).map(|i| chain.variable.0 + i * n_x);
    for (number, point) in inner.chain(chain.ties.iter().map(|t| t.variable.0)).enumerate() {
        // Of all parts, of one, of one but zero, none.
        let mode = random.bits() % 4;
        let seen = random.bits() as usize % kind.parts.len();
        let all = kind.joined && mode == 0;
        let states: Vec<usize> = (0..n_x).filter(|&i| all || part_of[i] == seen).collect();
        let mut on: Vec<usize> = states.iter().map(|i| point + i).collect();
        let parameters = if random.bits().is_multiple_of(2) { kind.border } else { 0 };
        on.extend((0..parameters).filter(|b| b % 2 == 0));
        let outputs = [1usize, 1, 1, 0][mode as usize] * 2;
        for _ in 0..outputs {
            let size = if mode == 2 { 0.0 } else { 1.0 };
            let slope: Vec<f64> = on.iter().map(|_| size * random.between(-1.0, 1.0)).collect();
            for (&i, a) in on.iter().zip(&slope) {
                for (&j, b) in on.iter().zip(&slope).filter(|x| *x.0 <= i) {
                    // Entries of zeros are not made of two that only rounding takes away.
                    if size == 0.0 { to.one(i, j, 0.0) } else { to.push(random, i, j, a * b) }
                }
            }
        }
        for (i, &p) in part_of.iter().enumerate() {
            if number == 0 || p == 0 {
                to.push(random, point + i, point + i, 0.5);
            }
            if kind.exact && random.bits().is_multiple_of(2) {
                let value = random.between(-0.7, 0.7);
                (0..kind.border.min(1)).for_each(|b| to.push(random, point + i, b, value));
                let other = if kind.joined { i / 2 } else { i };
                to.push(random, point + i, point + other, -value);
            }
        }
    }
}

impl System {
    fn arrow(&self) -> ArrowKkt {
        let (h, a) = (&self.hessian.structure, &self.jacobian.structure);
        ArrowKkt::new(&self.chains, h, a, (self.n, self.m), &self.units).unwrap()
    }

    fn entries(&self) -> linalg::Entries<'_> {
        linalg::Entries { hessian: &self.hessian.values, jacobian: &self.jacobian.values }
    }

    /// The matrix in units, with rows of the identity for variables held.
    fn dense(&self, held: &[bool]) -> DMatrix<f64> {
        let size = self.n + self.m;
        let mut k = DMatrix::zeros(size, size);
        let mut add = |r: usize, c: usize, v: f64| {
            let v = v * self.scale[r] * self.scale[c];
            k[(r, c)] += v;
            if r != c {
                k[(c, r)] += v;
            }
        };
        for (entries, first) in [(&self.hessian, 0), (&self.jacobian, self.n)] {
            let s = &entries.structure;
            for ((&v, &r), &c) in entries.values.iter().zip(&s.rows).zip(&s.columns) {
                add(first + r as usize, c as usize, v);
            }
        }
        for i in (0..self.n).filter(|&i| held[i]) {
            k.row_mut(i).fill(0.0);
            k.column_mut(i).fill(0.0);
            k[(i, i)] = 1.0;
        }
        k
    }

    /// Solves for a random right-hand side: the solution in units, and largest residual relative to the
    /// largest term.
    fn solved(&self, arrow: &mut ArrowKkt, dense: &DMatrix<f64>, held: &[bool]) -> (DVector<f64>, f64) {
        let (n, m) = (self.n, self.m);
        let mut random = Random(99);
        let mut right = DVector::from_fn(n + m, |_, _| random.between(-1.0, 1.0));
        let of_program = DVector::from_fn(n + m, |i, _| right[i] / self.scale[i]);
        let (mut d, mut lambda) = (vec![0.0; n], vec![0.0; m]);
        arrow.solve(&of_program.as_slice()[..n], &of_program.as_slice()[n..], &mut d, &mut lambda);
        let got = d.iter().chain(&lambda).zip(&self.scale).map(|(x, s)| x / s);
        let got = DVector::from_iterator(n + m, got);
        (0..n).filter(|&i| held[i]).for_each(|i| right[i] = 0.0);
        let rest = (dense * &got - &right).amax() / (dense.amax() * got.amax());
        // What is the answer of LU?
        let expected = dense.clone().lu().solve(&right).unwrap();
        (&got - expected, rest)
    }
}

fn no_held(system: &System) -> Vec<bool> {
    vec![false; system.n]
}

#[test]
fn any_parts_are_solved_as_dense_algebra_does_and_have_the_same_inertia() {
    let (mut positive, mut indefinite) = (0, 0);
    for seed in 0..100 {
        let kind = Kind::random(&mut Random(seed));
        let system = system(&kind, 1000 + seed);
        let mut held = no_held(&system);
        (0..kind.border).for_each(|b| held[b] = (seed + b as u64).is_multiple_of(3));
        let mut arrow = system.arrow();
        let effort = Effort { refine: seed.is_multiple_of(2), hurry: false };
        arrow.factorize(&system.entries(), effort).unwrap();
        let found = arrow.finish(&held, 0.0);
        let dense = system.dense(&held);
        let eigen = dense.clone().symmetric_eigenvalues();
        let negative = eigen.iter().filter(|e| **e < 0.0).count();
        assert_eq!(found.is_positive(), negative == system.m, "seed {seed}, {kind:?}: {found:?}");
        if !found.is_positive() {
            assert!(found.negative > 0, "seed {seed}, {kind:?}: {found:?}");
            indefinite += 1;
            continue;
        }
        positive += 1;
        let (apart, rest) = system.solved(&mut arrow, &dense, &held);
        let least = eigen.iter().fold(f64::INFINITY, |a, e| a.min(e.abs()));
        let limit = if seed.is_multiple_of(2) { 1e-13 } else { 1e-12 };
        assert!(rest < limit, "seed {seed}, {kind:?}: residual {rest:e}");
        assert!(apart.amax() < 1e-10 / least, "seed {seed}, {kind:?}: {:e} apart, {least:e}", apart.amax());
    }
    assert!(positive >= 50 && indefinite >= 10, "{positive} positive, {indefinite} not");
}

#[test]
fn the_covariance_is_the_block_of_the_inverse() {
    for seed in 0..40 {
        let kind = Kind { exact: false, ..Kind::random(&mut Random(seed)) };
        let system = system(&kind, seed);
        let mut held = no_held(&system);
        if kind.border > 1 {
            held[1] = true;
        }
        let mut arrow = system.arrow();
        arrow.factorize(&system.entries(), Effort::FULL).unwrap();
        assert!(arrow.finish(&held, 0.0).is_positive(), "seed {seed}");
        let mut inverse = system.dense(&held).try_inverse().unwrap();
        (0..system.n).filter(|&i| held[i]).for_each(|i| inverse[(i, i)] = 0.0);
        let n_x = system.units.len();
        let first = system.chains.chains.iter().flat_map(|c| c.variable.0..c.variable.0 + n_x);
        let wanted: Vec<usize> = (0..kind.border).chain(first).collect();
        // Read off, and with a state inside by solving.
        for others in [vec![], vec![system.n - 1]] {
            let wanted: Vec<usize> = wanted.iter().chain(&others).copied().collect();
            let mut covariance = vec![0.0; wanted.len() * wanted.len()];
            let variables: Vec<VariableId> = wanted.iter().map(|&i| VariableId(i)).collect();
            arrow.covariance(&variables, &mut covariance);
            for (i, &a) in wanted.iter().enumerate() {
                for (j, &b) in wanted.iter().enumerate() {
                    let got = covariance[i * wanted.len() + j] / (system.scale[a] * system.scale[b]);
                    let size = (inverse[(a, a)] * inverse[(b, b)]).abs().sqrt().max(1e-3);
                    let apart = (got - inverse[(a, b)]).abs();
                    assert!(apart < 1e-9 * size, "seed {seed}, {a}, {b}: {got} for {}", inverse[(a, b)]);
                }
            }
        }
    }
}

#[test]
fn what_conditions_determine_wholly_is_left_to_another_method() {
    let kind = Kind { border: 0, boundary: 6, ..unstable(0.9) };
    let s = system(&kind, 1);
    let (h, a) = (&s.hessian.structure, &s.jacobian.structure);
    assert!(ArrowKkt::new(&s.chains, h, a, (s.n, s.m), &s.units).is_none());
}

/// Three parts of which one may be unstable.
fn unstable(growth: f64) -> Kind {
    let (parts, chains) = (vec![1, 3, 2], vec![(30, 1), (12, 2)]);
    Kind { parts, border: 3, chains, ties: 2, boundary: 1, growth, exact: false, joined: true }
}

#[test]
fn groups_end_where_changes_of_one_part_grow_and_are_joined_again_when_they_do_not() {
    let (tame, wild) = (system(&unstable(0.9), 5), system(&unstable(3.0), 5));
    let held = no_held(&tame);
    let mut arrow = tame.arrow();
    let least = arrow.groups();
    let check = |arrow: &mut ArrowKkt, system: &System, refine: bool, what: &str| {
        arrow.factorize(&system.entries(), Effort { refine, hurry: false }).unwrap();
        assert!(arrow.finish(&held, 0.0).is_positive(), "{what}");
        let (apart, rest) = system.solved(arrow, &system.dense(&held), &held);
        assert!(rest < 1e-12 && apart.amax() < 1e-8, "{what}: residual {rest:e}, {:e} apart", apart.amax());
        arrow.groups()
    };
    for refine in [false, true] {
        assert_eq!(check(&mut arrow, &tame, refine, "at first"), least);
        // 3^n < 100 up to five segments of one point.
        let split = check(&mut arrow, &wild, refine, "unstable");
        assert!(split >= least + 6, "{split} groups of at least {least}");
        let joined: Vec<usize> =
            (0..4).map(|i| check(&mut arrow, &tame, refine, &format!("joined {i}"))).collect();
        assert_eq!(joined.last(), Some(&least), "{joined:?}");
    }
}

#[test]
fn long_chains_of_parts_merge_and_have_the_same_bits_on_any_threads() {
    let kind = Kind { chains: vec![(300, 1), (1900, 1)], ties: 5, ..unstable(0.9) };
    let system = system(&kind, 3);
    let mut bits = Vec::new();
    for threads in [1, 4] {
        let mut arrow = system.arrow().with_threads(Threads::new(threads).unwrap());
        assert!(arrow.groups() >= 18, "{}", arrow.groups());
        arrow.factorize(&system.entries(), Effort::FULL).unwrap();
        assert!(arrow.finish(&no_held(&system), 0.0).is_positive());
        let (p, q) = (vec![1.0; system.n], vec![-1.0; system.m]);
        let (mut d, mut lambda) = (vec![0.0; system.n], vec![0.0; system.m]);
        arrow.solve(&p, &q, &mut d, &mut lambda);
        let s = &system.jacobian.structure;
        let (mut rest, mut size) = (q, vec![1.0; system.m]);
        for ((a, &r), &c) in system.jacobian.values.iter().zip(&s.rows).zip(&s.columns) {
            rest[r as usize] -= a * d[c as usize];
            size[r as usize] += (a * d[c as usize]).abs();
        }
        let worst = rest.iter().zip(&size).fold(0.0f64, |w, (r, s)| w.max(r.abs() / s));
        assert!(worst < 1e-13, "{worst:e}");
        bits.push(d.iter().chain(&lambda).map(|x| x.to_bits()).collect::<Vec<_>>());
    }
    assert!(bits[0] == bits[1]);
}

/// Operations that a segment of five points adds, without those of a chain's ends.
fn flops_of_a_segment(parts: Vec<usize>) -> f64 {
    let count = |segments: usize| {
        let kind = Kind {
            parts: parts.clone(),
            border: 0,
            chains: vec![(segments, 4)],
            ties: 0,
            boundary: 0,
            growth: 0.9,
            exact: false,
            joined: false,
        };
        system(&kind, 1).arrow().flops() as f64
    };
    (count(120) - count(40)) / 80.0
}

#[test]
fn work_grows_with_the_number_of_parts_not_with_its_cube() {
    let few = flops_of_a_segment(vec![2; 4]);
    let many = flops_of_a_segment(vec![2; 16]);
    assert!(many < 4.5 * few, "{many} for {few}");
    let full = flops_of_a_segment(vec![32]);
    assert!(full > 10.0 * many, "{full} for {many}");
}
