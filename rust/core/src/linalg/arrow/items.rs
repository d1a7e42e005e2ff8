//! Entries of a matrix by the panel that they go to.

use crate::interrupt::current;

/// Operations, about, to find the place of an entry.
const OPERATIONS: usize = 64;
/// Instead of a panel.
const NONE: u32 = u32::MAX;

/// Panel of an entry, or place in it; `Some(None)` for an entry that needs none, `None` where it does not fit.
pub(super) type Slot = Option<Option<usize>>;

/// Entries by the panel that they go to: item = (entry, place in the panel).
///
/// Programs write the entries of consecutive panels side by side, so what a panel takes is mostly what
/// the one before it takes, each entry one further: it is kept once for all of them.
#[derive(Clone, Debug, Default)]
pub(super) struct Items {
    /// For each panel the start of its items, their number, and the offset of their entries.
    pub panels: Vec<(u32, u32, u32)>,
    pub items: Vec<(u32, u32)>,
}

impl Items {
    /// Sorts the entries of a matrix by panel. The panels are those of several chains, `panels` of each,
    /// numbered through. Entries that are `like` each other have the same place in their panels, which is found once for
    /// those that stand side by side. `None` where an entry does not fit, and where the work was stopped.
    #[inline]
    pub fn sorted<K: PartialEq>(
        panels: &[usize],
        entries: usize,
        panel: impl Fn(usize) -> Slot,
        like: impl Fn(usize) -> Option<K>,
        place: impl Fn(usize) -> Slot,
    ) -> Option<Vec<Items>> {
        let total: usize = panels.iter().sum();
        let mut turns = current().turns(OPERATIONS);
        let (mut starts, mut panel_of) = (vec![0u32; total + 1], Vec::with_capacity(entries));
        for t in 0..entries {
            if turns.stop() {
                return None;
            }
            let panel = panel(t)?;
            if let Some(panel) = panel {
                starts[panel + 1] += 1;
            }
            panel_of.push(panel.map_or(NONE, |panel| panel as u32));
        }
        for i in 0..total {
            starts[i + 1] += starts[i];
        }
        let mut ends = starts[..total].to_vec();
        let mut items = vec![(0, 0); starts[total] as usize];
        let mut last: Option<(K, Option<usize>)> = None;
        for t in 0..entries {
            if turns.stop() {
                return None;
            }
            if panel_of[t] == NONE {
                continue;
            }
            let key = like(t);
            let same =
                last.as_ref().filter(|(before, _)| key.as_ref() == Some(before)).map(|(_, place)| *place);
            let found = match same {
                Some(found) => found,
                None => place(t)?,
            };
            last = key.map(|key| (key, found));
            if let Some(place) = found {
                let end = &mut ends[panel_of[t] as usize];
                items[*end as usize] = (t as u32, place as u32);
                *end += 1;
            }
        }
        let mut first = 0;
        let of_chain = panels.iter().map(|&count| {
            let own = first..first + count;
            first += count;
            Items::folded(own.map(|p| &items[starts[p] as usize..ends[p] as usize]))
        });
        Some(of_chain.collect())
    }

    /// Keeps what differs from panel to panel.
    fn folded<'a>(panels: impl Iterator<Item = &'a [(u32, u32)]>) -> Items {
        let mut folded = Items::default();
        for own in panels {
            let repeated = folded.panels.last().filter(|&&(start, count, add)| {
                let before = &folded.items[start as usize..(start + count) as usize];
                before.len() == own.len() && before.iter().zip(own).all(|(b, o)| (b.0 + add + 1, b.1) == *o)
            });
            let panel = match repeated {
                Some(&(start, count, add)) => (start, count, add + 1),
                None => (folded.items.len() as u32, own.len() as u32, 0),
            };
            if repeated.is_none() {
                folded.items.extend(own);
            }
            folded.panels.push(panel);
        }
        folded.items.shrink_to_fit();
        folded
    }

    /// The items of a panel.
    #[inline(always)]
    pub fn of(&self, panel: usize) -> impl Iterator<Item = (usize, usize)> + '_ {
        let (start, count, add) = self.panels[panel];
        self.items[start as usize..(start + count) as usize]
            .iter()
            .map(move |&(entry, place)| ((entry + add) as usize, place as usize))
    }
}
