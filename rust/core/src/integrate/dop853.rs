//! Dormand and Prince's method of order 8 (Hairer, Nørsett and Wanner, *Solving Ordinary Differential Equations I*, 2nd
//! edition, section II.10): a step, its error, and whether it was the stability of the method that made it so short.

use super::field::Field;

/// Numbers of stages; the slope at the end of a step is one more.
const STAGES: usize = 12;
/// h times the greatest eigenvalue above which the method is not stable (Hairer's program DOP853).
const STABLE: f64 = 6.1;

const C: [f64; STAGES] = [
    0.0,
    0.05260015195876773,
    0.0789002279381516,
    0.1183503419072274,
    0.2816496580927726,
    0.3333333333333333,
    0.25,
    0.3076923076923077,
    0.6512820512820513,
    0.6,
    0.8571428571428571,
    1.0,
];
const A: [&[f64]; STAGES] = [
    &[],
    &[0.05260015195876773],
    &[0.0197250569845379, 0.0591751709536137],
    &[0.02958758547680685, 0.0, 0.08876275643042054],
    &[0.2413651341592667, 0.0, -0.8845494793282861, 0.924834003261792],
    &[0.037037037037037035, 0.0, 0.0, 0.17082860872947386, 0.12546768756682242],
    &[0.037109375, 0.0, 0.0, 0.17025221101954405, 0.06021653898045596, -0.017578125],
    &[
        0.03709200011850479,
        0.0,
        0.0,
        0.17038392571223998,
        0.10726203044637328,
        -0.015319437748624402,
        0.008273789163814023,
    ],
    &[
        0.6241109587160757,
        0.0,
        0.0,
        -3.3608926294469414,
        -0.868219346841726,
        27.59209969944671,
        20.154067550477894,
        -43.48988418106996,
    ],
    &[
        0.47766253643826434,
        0.0,
        0.0,
        -2.4881146199716677,
        -0.590290826836843,
        21.230051448181193,
        15.279233632882423,
        -33.28821096898486,
        -0.020331201708508627,
    ],
    &[
        -0.9371424300859873,
        0.0,
        0.0,
        5.186372428844064,
        1.0914373489967295,
        -8.149787010746927,
        -18.52006565999696,
        22.739487099350505,
        2.4936055526796523,
        -3.0467644718982196,
    ],
    &[
        2.273310147516538,
        0.0,
        0.0,
        -10.53449546673725,
        -2.0008720582248625,
        -17.9589318631188,
        27.94888452941996,
        -2.8589982771350235,
        -8.87285693353063,
        12.360567175794303,
        0.6433927460157636,
    ],
];
const B: [f64; STAGES] = [
    0.054293734116568765,
    0.0,
    0.0,
    0.0,
    0.0,
    4.450312892752409,
    1.8915178993145003,
    -5.801203960010585,
    0.3111643669578199,
    -0.1521609496625161,
    0.20136540080403034,
    0.04471061572777259,
];
/// Differences to the weights of orders 3 and 5; the error is a mean of both.
const E3: [f64; STAGES] = [
    -0.18980075407240762,
    0.0,
    0.0,
    0.0,
    0.0,
    4.450312892752409,
    1.8915178993145003,
    -5.801203960010585,
    -0.4226823213237919,
    -0.1521609496625161,
    0.20136540080403034,
    0.02265179219836082,
];
const E5: [f64; STAGES] = [
    0.01312004499419488,
    0.0,
    0.0,
    0.0,
    0.0,
    -1.2251564463762044,
    -0.4957589496572502,
    1.6643771824549864,
    -0.35032884874997366,
    0.3341791187130175,
    0.08192320648511571,
    -0.022355307863886294,
];

/// A step and what it needs.
#[derive(Debug)]
pub(crate) struct Dop853 {
    /// Slopes at the stages, n each.
    k: Vec<f64>,
    stage: Vec<f64>,
    /// The slope at the beginning of the step.
    pub slope: Vec<f64>,
    /// The state at its end, and the slope there.
    pub next: Vec<f64>,
    pub next_slope: Vec<f64>,
}

impl Dop853 {
    pub fn new(n: usize) -> Dop853 {
        let zeros = vec![0.0; n];
        Dop853 {
            k: vec![0.0; STAGES * n],
            stage: zeros.clone(),
            slope: zeros.clone(),
            next: zeros.clone(),
            next_slope: zeros,
        }
    }

    /// A step of length h from (t, x), where the slope is `self.slope`. The error in units of what is allowed, and
    /// whether a longer step would not be stable; nothing where something is not finite.
    pub fn step(
        &mut self,
        field: &mut Field<'_>,
        (t, h): (f64, f64),
        x: &[f64],
        (relative, absolute): (f64, &[f64]),
    ) -> Option<(f64, bool)> {
        let n = x.len();
        self.k[..n].copy_from_slice(&self.slope);
        for s in 1..STAGES {
            let (done, rest) = self.k.split_at_mut(s * n);
            combine(&mut self.stage, x, h, A[s], done);
            if !field.slope(t + C[s] * h, &self.stage, &mut rest[..n]) {
                return None;
            }
        }
        combine(&mut self.next, x, h, &B, &self.k);
        if !field.slope(t + h, &self.next, &mut self.next_slope) {
            return None;
        }
        let (mut by_5, mut by_3, mut turn, mut way) = (0.0, 0.0, 0.0, 0.0);
        for i in 0..n {
            let sum = |e: &[f64; STAGES]| (0..STAGES).map(|s| e[s] * self.k[s * n + i]).sum::<f64>();
            let size = absolute[i] + relative * x[i].abs().max(self.next[i].abs());
            by_5 += (sum(&E5) / size).powi(2);
            by_3 += (sum(&E3) / size).powi(2);
            turn += (self.next_slope[i] - self.k[(STAGES - 1) * n + i]).powi(2);
            way += (self.next[i] - self.stage[i]).powi(2);
        }
        let error = if by_5 == 0.0 { 0.0 } else { h * by_5 / ((by_5 + 0.01 * by_3) * n as f64).sqrt() };
        error.is_finite().then_some((error, way > 0.0 && h * (turn / way).sqrt() > STABLE))
    }
}

/// to = x + h Σ weight k
fn combine(to: &mut [f64], x: &[f64], h: f64, weights: &[f64], k: &[f64]) {
    let n = x.len();
    to.fill(0.0);
    for (w, k) in weights.iter().zip(k.chunks_exact(n.max(1))) {
        if *w != 0.0 {
            to.iter_mut().zip(k).for_each(|(t, k)| *t = w.mul_add(*k, *t));
        }
    }
    to.iter_mut().zip(x).for_each(|(t, x)| *t = h.mul_add(*t, *x));
}
