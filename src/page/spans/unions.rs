//! Unions of a block's spans: the heights that its pixels cover together, floor and obstacle apart.

use crate::page::Span;
use crate::sort::sort_by_key;

/// Finds the unions of a block's spans; reusable.
#[derive(Debug)]
pub(super) struct UnionFinder {
    /// Covered heights of floor and of obstacle, two bits for each height above the lowest of the block. The second bit
    /// stands for the gap to the next height, so that spans that share no height stay apart.
    covered: [[u64; Self::WORDS]; 2],
    sorted: Vec<Span>,
    unions: Vec<Span>,
}

impl UnionFinder {
    /// Words of `covered`, one more than the tallest block needs. Spans of taller blocks are sorted instead.
    const WORDS: usize = 2 * 2048 / 64 + 1;
    /// Longest span that is marked bit by bit (quanta).
    const LONGEST: u32 = 512;

    pub fn with_capacity(spans: usize) -> Self {
        let lists = [(); 2].map(|()| Vec::with_capacity(spans));
        let [sorted, unions] = lists;
        Self { covered: [[0; Self::WORDS]; 2], sorted, unions }
    }

    /// Returns the unions of the floor spans and those of the obstacle spans in `spans`, lowest bottom first.
    pub fn find(&mut self, spans: &[Span]) -> &[Span] {
        // Signed, because not every processor compares several unsigned numbers at once.
        let (mut low, mut high, mut longest) = (i32::MAX, 0, 0);
        for span in spans {
            let (bottom, top) = (span.bottom() as i32, span.top() as i32);
            (low, high, longest) = (low.min(bottom), high.max(top), longest.max(top - bottom));
        }
        let (low, high, longest) = (low as u32, high as u32, longest as u32);
        self.unions.clear();
        if longest <= Self::LONGEST && high - low < 32 * (Self::WORDS as u32 - 1) {
            self.by_bits(spans, low, high);
        } else {
            self.by_order(spans);
        }
        &self.unions
    }

    fn by_bits(&mut self, spans: &[Span], low: u32, high: u32) {
        for span in spans {
            let covered = &mut self.covered[usize::from(span.is_obstacle())];
            let (first, last) = (2 * (span.bottom() - low), 2 * (span.top() - low));
            let (mut word, end) = (first as usize / 64, last as usize / 64);
            let mut run = u64::MAX << (first % 64);
            while word < end {
                covered[word] |= run;
                run = u64::MAX;
                word += 1;
            }
            covered[end] |= run & u64::MAX >> (63 - last % 64);
        }
        let words = 2 * (high - low) as usize / 64 + 2;
        for (kind, covered) in self.covered.iter_mut().enumerate() {
            let mut begun = None;
            for (number, word) in covered[..words.min(Self::WORDS)].iter_mut().enumerate() {
                let height = |bit: u32| low + (64 * number as u32 + bit) / 2;
                let mut bits = std::mem::take(word);
                if bits == u64::MAX && begun.is_some() {
                    continue;
                }
                let mut passed = 0;
                loop {
                    // Finds a run, from its first set bit to the first clear one; it may continue in the next word.
                    if begun.is_none() {
                        if bits == 0 {
                            break;
                        }
                        passed = bits.trailing_zeros();
                        begun = Some(height(passed));
                    }
                    let end = passed + (!(bits >> passed)).trailing_zeros();
                    if end >= 64 {
                        break;
                    }
                    let bottom = begun.take();
                    // If a run ends where the word begins, its last bit is that of the previous word.
                    let top = low + (64 * number as u32 + end - 1) / 2;
                    self.unions.extend(bottom.and_then(|bottom| Span::new(bottom, top, kind == 1)));
                    bits &= u64::MAX << end;
                    passed = 0;
                }
            }
        }
        self.merge_kinds();
    }

    fn by_order(&mut self, spans: &[Span]) {
        let Self { sorted, unions, .. } = self;
        for obstacle in [false, true] {
            sorted.clear();
            sorted.extend(spans.iter().filter(|span| span.is_obstacle() == obstacle));
            sort_by_key(sorted, |span| (span.bottom(), span.top()));
            let mut run: Option<(u32, u32)> = None;
            for span in sorted.iter() {
                run = match run {
                    Some((bottom, top)) if span.bottom() <= top => Some((bottom, top.max(span.top()))),
                    ended => {
                        unions.extend(ended.and_then(|(bottom, top)| Span::new(bottom, top, obstacle)));
                        Some((span.bottom(), span.top()))
                    }
                };
            }
            unions.extend(run.and_then(|(bottom, top)| Span::new(bottom, top, obstacle)));
        }
        self.merge_kinds();
    }

    /// Puts the unions in order: those of floor precede those of obstacle, and each class is already in order.
    fn merge_kinds(&mut self) {
        let is_one_kind = |ends: (&Span, &Span)| ends.0.is_obstacle() == ends.1.is_obstacle();
        if !self.unions.first().zip(self.unions.last()).is_none_or(is_one_kind) {
            sort_by_key(&mut self.unions, |span| (span.bottom(), span.is_obstacle()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Runs of heights that spans of one class cover, from a list of all half heights.
    fn covered(spans: &[Span], obstacle: bool) -> Vec<Span> {
        let mut halves = vec![false; 2 * 16321 + 1];
        for span in spans.iter().filter(|span| span.is_obstacle() == obstacle) {
            halves[2 * span.bottom() as usize..=2 * span.top() as usize].fill(true);
        }
        let mut unions = Vec::new();
        let mut bottom = None;
        for (at, &inside) in halves.iter().enumerate() {
            match (inside, bottom) {
                (true, None) => bottom = Some(at as u32 / 2),
                (false, Some(from)) => {
                    unions.extend(Span::new(from, (at as u32 - 1) / 2, obstacle));
                    bottom = None;
                }
                _ => {}
            }
        }
        unions
    }

    proptest! {
        /// One finder for all blocks, as in a page; spans short and long, close together and far apart.
        #[test]
        fn unions_are_the_runs_of_heights_that_spans_cover(
            blocks in proptest::collection::vec((0u32..14000, prop_oneof![Just(40u32), Just(700), Just(2300)], prop_oneof![Just(2u32), Just(70), Just(900)]), 1..6),
            parts in proptest::collection::vec((any::<u16>(), any::<u16>(), any::<bool>()), 1..64),
        ) {
            let mut finder = UnionFinder::with_capacity(64);
            for (base, reach, longest) in blocks {
                let spans: Vec<_> = parts.iter().filter_map(|&(at, len, obstacle)| {
                    let bottom = base + u32::from(at) % reach;
                    Span::new(bottom, (bottom + u32::from(len) % longest).min(16320), obstacle)
                }).collect();
                let mut expected = [false, true].map(|obstacle| covered(&spans, obstacle)).concat();
                expected.sort_by_key(|span| (span.bottom(), span.is_obstacle()));
                prop_assert_eq!(finder.find(&spans), &expected[..]);
            }
        }
    }
}
