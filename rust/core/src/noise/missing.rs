//! Missing measurements: their pattern and their number.

/// The pattern of missing measurements, over all experiments.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Missing {
    /// Whether any sample of each output is missing.
    pub outputs: Vec<bool>,
    /// The different sets of outputs that are present in a sample, but for that of all outputs.
    pub patterns: Vec<Vec<bool>>,
}

/// Numbers of measurements, over all experiments.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Counts {
    /// Measurements of each output.
    pub outputs: Vec<usize>,
    /// Samples with a measurement at all.
    pub samples: usize,
}

/// Returns the outputs that are present in each sample of an experiment, whose outputs are given.
fn present(outputs: &[Vec<f64>]) -> impl Iterator<Item = Vec<bool>> + '_ {
    let n = outputs.first().map_or(0, Vec::len);
    (0..n).map(|k| outputs.iter().map(|z| !z[k].is_nan()).collect())
}

impl Missing {
    /// Collects the pattern of the outputs of several experiments.
    pub fn new<'a>(experiments: impl Iterator<Item = &'a Vec<Vec<f64>>>) -> Missing {
        let mut found = Missing::default();
        for outputs in experiments {
            found.outputs.resize(outputs.len(), false);
            if !outputs.iter().flatten().any(|z| z.is_nan()) {
                continue;
            }
            for set in present(outputs).filter(|set| set.contains(&false)) {
                found.outputs.iter_mut().zip(&set).for_each(|(any, there)| *any |= !there);
                if !found.patterns.contains(&set) {
                    found.patterns.push(set);
                }
            }
        }
        found
    }

    /// Flags of an experiment's samples, 0 or 1: a column for each output of which a sample is missing
    /// somewhere, then one for each of so many patterns.
    pub fn flags(&self, outputs: &[Vec<f64>], patterns: usize) -> Vec<Vec<f64>> {
        let flag = |there: bool| f64::from(u8::from(there));
        let with_gaps = self.outputs.iter().zip(outputs).filter(|c| *c.0);
        let mut columns: Vec<Vec<f64>> =
            with_gaps.map(|(_, z)| z.iter().map(|v| flag(!v.is_nan())).collect()).collect();
        for pattern in &self.patterns[..patterns] {
            columns.push(present(outputs).map(|set| flag(set == *pattern)).collect());
        }
        columns
    }
}

impl Counts {
    /// Counts the measurements of the outputs of several experiments.
    pub fn new<'a>(experiments: impl Iterator<Item = &'a Vec<Vec<f64>>>) -> Counts {
        let mut counts = Counts::default();
        for outputs in experiments {
            counts.outputs.resize(outputs.len(), 0);
            for (count, z) in counts.outputs.iter_mut().zip(outputs) {
                *count += z.iter().filter(|z| !z.is_nan()).count();
            }
            let samples = 0..outputs.first().map_or(0, Vec::len);
            counts.samples += samples.filter(|&k| outputs.iter().any(|z| !z[k].is_nan())).count();
        }
        counts
    }
}
