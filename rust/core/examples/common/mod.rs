//! What the examples and benchmarks share: where records lie, how to read and to simulate them.
#![allow(dead_code)] // each uses a part of it

use std::path::{Path, PathBuf};

use phugoid::internals::evaluator::Evaluator;
use phugoid::{Fit, Model};

/// A record in the folder $PHUGOID_DATA, else in `shared/data` beside the checkout. None ships with the
/// project: README.md says where to get them.
pub fn find(file: &str) -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let named = std::env::var_os("PHUGOID_DATA").map(PathBuf::from);
    named.into_iter().chain([beside]).map(|folder| folder.join(file)).find(|path| path.is_file())
}

/// The path that the first argument gives, else what is found; says so where there is nothing.
pub fn argument_or_find(file: &str) -> Option<PathBuf> {
    let path = std::env::args().nth(1).map(PathBuf::from).or_else(|| find(file));
    if path.is_none() {
        println!(
            "{file} is neither in $PHUGOID_DATA nor in ../shared/data: a simulated twin takes its place.\n"
        );
    }
    path
}

/// The columns of a table of numbers apart by blanks.
pub fn columns(path: &Path) -> Result<Vec<Vec<f64>>, Box<dyn std::error::Error>> {
    let mut columns: Vec<Vec<f64>> = Vec::new();
    for (n, line) in std::fs::read_to_string(path)?.lines().enumerate() {
        let row = line.split_whitespace().map(str::parse).collect::<Result<Vec<f64>, _>>();
        let row = row.map_err(|e| format!("{}, line {}: {e}", path.display(), n + 1))?;
        columns.resize(row.len().max(columns.len()), Vec::new());
        columns.iter_mut().zip(row).for_each(|(column, value)| column.push(value));
    }
    Ok(columns)
}

/// SplitMix64 (Steele, Lea and Flood, 2014), and normal numbers by Box and Muller: the same everywhere.
pub struct Random(pub u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A number of mean 0 and standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// States at the times `t`, by `steps` steps of the classical Runge-Kutta method between two of them.
/// `inputs(t, x)` may feed states back.
pub fn simulate(
    model: &Model,
    parameters: &[f64],
    t: &[f64],
    initial: &[f64],
    steps: usize,
    inputs: impl Fn(f64, &[f64]) -> Vec<f64>,
) -> Result<Vec<Vec<f64>>, phugoid::Error> {
    let evaluator = Evaluator::new(model)?;
    let f = |t: f64, x: &[f64]| -> Vec<f64> {
        let point: Vec<f64> = [t].into_iter().chain(inputs(t, x)).chain(x.iter().copied()).collect();
        let columns: Vec<&[f64]> = point.iter().map(std::slice::from_ref).collect();
        let slopes = evaluator.dynamics(parameters, &columns);
        slopes.expect("a point has all columns").into_iter().flatten().collect()
    };
    let ahead =
        |x: &[f64], h: f64, k: &[f64]| -> Vec<f64> { x.iter().zip(k).map(|(x, k)| x + h * k).collect() };
    let mut x = initial.to_vec();
    let mut states: Vec<Vec<f64>> = x.iter().map(|x| vec![*x]).collect();
    for pair in t.windows(2) {
        let h = (pair[1] - pair[0]) / steps as f64;
        for step in 0..steps {
            let t = pair[0] + h * step as f64;
            let k1 = f(t, &x);
            let k2 = f(t + 0.5 * h, &ahead(&x, 0.5 * h, &k1));
            let k3 = f(t + 0.5 * h, &ahead(&x, 0.5 * h, &k2));
            let k4 = f(t + h, &ahead(&x, h, &k3));
            for (i, x) in x.iter_mut().enumerate() {
                *x += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
            }
        }
        states.iter_mut().zip(&x).for_each(|(path, x)| path.push(*x));
    }
    Ok(states)
}

/// Outputs at the times `t`, with noise of given standard deviations.
pub fn measure(
    model: &Model,
    parameters: &[f64],
    t: &[f64],
    inputs: &[Vec<f64>],
    states: &[Vec<f64>],
    sigmas: &[f64],
    seed: u64,
) -> Result<Vec<Vec<f64>>, phugoid::Error> {
    let columns: Vec<&[f64]> = [t].into_iter().chain(inputs.iter().chain(states).map(|c| &c[..])).collect();
    let mut outputs = Evaluator::new(model)?.outputs(parameters, &columns)?;
    let mut random = Random(seed);
    for (output, sigma) in outputs.iter_mut().zip(sigmas) {
        output.iter_mut().for_each(|y| *y += sigma * random.normal());
    }
    Ok(outputs)
}

/// Prints estimates beside published ones.
pub fn compare(fit: &Fit, published: &[(&str, f64)]) {
    println!("{:12} {:>20} {:>20} {:>12} {:>12}", "", "estimate", "published", "difference", "std. error");
    for (name, value) in published {
        let found = &fit[*name];
        let difference = found.value - value;
        println!(
            "{name:12} {:>20.13} {value:>20.13} {difference:>12.1e} {:>12.1e}",
            found.value, found.std_error
        );
    }
}
