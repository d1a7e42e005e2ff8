//! Gaps in the sampling of records, in which the inputs are unknown.

use crate::experiment::Experiment;

/// Intervals on either side that one is compared with; fewer than `FEWEST` show no rule.
const NEAR: usize = 10;
const FEWEST: usize = 8;
/// A gap is longer than this many of them, and this many of them may be as long.
const LONG: f64 = 10.0;
const OTHERS: usize = 2;
/// An input stands still where it changes by less than this part of its range.
const STILL: f64 = 1e-6;
/// Gaps and inputs that a warning names.
const NAMED: usize = 3;

/// Numbers of the intervals between sample times (s, increasing) that are gaps: longer than ten times the intervals
/// beside them.
///
/// Compared are the ten intervals before and the ten after (at an end, the nearest twenty), of which two may be as
/// long: what is irregular by nature, such as samples ever farther apart, bursts, or those of several rates, has no gaps. Nor
/// have fewer than ten samples.
///
/// ```
/// let mut t: Vec<f64> = (0..40).map(|k| 0.04 * k as f64).collect();
/// t.iter_mut().skip(25).for_each(|t| *t += 30.0);
/// assert_eq!(phugoid::internals::gaps::gaps(&t), [24]);
/// ```
pub fn gaps(t: &[f64]) -> Vec<usize> {
    let h: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
    let is_gap = |&i: &usize| {
        let first = i.saturating_sub(NEAR).min(h.len().saturating_sub(2 * NEAR + 1));
        let (before, after) = (&h[first..i], &h[i + 1..h.len().min(first + 2 * NEAR + 1)]);
        let as_long = before.iter().chain(after).filter(|other| LONG * **other >= h[i]);
        before.len() + after.len() >= FEWEST && as_long.count() <= OTHERS
    };
    (0..h.len()).filter(is_gap).collect()
}

/// Warnings about gaps of records over which inputs that move are interpolated, or held, one for each record.
/// `inputs` are their names.
pub fn gap_warnings(inputs: &[&str], experiments: &[Experiment]) -> Vec<String> {
    experiments.iter().filter_map(|e| gap_warning(inputs, e)).collect()
}

fn gap_warning(inputs: &[&str], experiment: &Experiment) -> Option<String> {
    // Begin and end of each gap, and the inputs that it is one of.
    let mut found: Vec<([f64; 2], Vec<&str>)> = Vec::new();
    let common = if inputs.is_empty() { Vec::new() } else { gaps(&experiment.t) };
    for (channel, name) in inputs.iter().enumerate() {
        let own = experiment.signals.get(channel).and_then(Option::as_ref);
        let apart = own.filter(|s| s.t != experiment.t);
        // The rate of an input says what the input says; what is held and has samples of its own has them where it
        // jumps.
        if own.is_some_and(|s| s.derivative > 0) || apart.is_some() && experiment.is_held(channel) {
            continue;
        }
        let places = apart.map_or_else(|| common.clone(), |s| gaps(&s.t));
        if places.is_empty() {
            continue;
        }
        let signal = experiment.signal(channel);
        for i in places.into_iter().filter(|&i| moves(&signal.values, i)) {
            let ends = [i, i + 1].map(|k| signal.t[k] + signal.delay);
            if ends[1] <= experiment.t[0] || ends[0] >= experiment.t[experiment.t.len() - 1] {
                continue;
            }
            match found.iter_mut().find(|f| f.0 == ends) {
                Some((_, names)) => names.push(name),
                None => found.push((ends, vec![name])),
            }
        }
    }
    found.sort_by(|a, b| a.0[0].total_cmp(&b.0[0]));
    let one = |([begin, end], names): &([f64; 2], Vec<&str>)| {
        let more = if names.len() > NAMED { ", ..." } else { "" };
        let names = names[..names.len().min(NAMED)].join(", ");
        format!("{:.3} from t = {begin:.3} on ({names}{more})", end - begin)
    };
    let listed: Vec<String> = found.iter().take(NAMED).map(one).collect();
    let more = found.len().saturating_sub(NAMED);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    (!found.is_empty()).then(|| {
        format!(
            "experiment '{}': inputs have gaps between samples, of {}{more}: they are not known there, and the model uses \
             values that are interpolated or held; split the record there",
            experiment.name,
            listed.join(", ")
        )
    })
}

/// Whether an input moves across an interval or near it.
fn moves(values: &[f64], interval: usize) -> bool {
    let range = |v: &[f64]| {
        let (low, high) =
            v.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        high - low
    };
    let near = &values[interval.saturating_sub(NEAR)..values.len().min(interval + 2 + NEAR)];
    range(near) > STILL * range(values)
}
