//! Places for the words beside dots: none overlaps a dot or another word, and few cross a line.

/// A rectangle in pixels: left, top, right, bottom.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rect(pub f64, pub f64, pub f64, pub f64);

impl Rect {
    /// With its middle at `(x, y)`.
    pub fn around((x, y): (f64, f64), width: f64, height: f64) -> Self {
        Self(x - width / 2.0, y - height / 2.0, x + width / 2.0, y + height / 2.0)
    }

    fn meets(&self, other: &Self) -> bool {
        self.0 < other.2 && other.0 < self.2 && self.1 < other.3 && other.1 < self.3
    }

    fn holds(&self, other: &Self) -> bool {
        self.0 <= other.0 && self.1 <= other.1 && other.2 <= self.2 && other.3 <= self.3
    }

    /// Whether a stretch from `a` to `b` passes through, tried at steps of 3 pixels.
    fn crossed(&self, a: (f64, f64), b: (f64, f64)) -> bool {
        let steps = ((b.0 - a.0).hypot(b.1 - a.1) / 3.0).ceil().max(1.0);
        (0..=steps as usize).any(|n| {
            let part = n as f64 / steps;
            let (x, y) = (a.0 + (b.0 - a.0) * part, a.1 + (b.1 - a.1) * part);
            self.0 < x && x < self.2 && self.1 < y && y < self.3
        })
    }

    /// Its middle.
    pub fn middle(&self) -> (f64, f64) {
        ((self.0 + self.2) / 2.0, (self.1 + self.3) / 2.0)
    }
}

/// Shapes that labels must not cover.
pub struct Surroundings {
    /// They stay inside.
    pub bounds: Rect,
    /// Dots and, as they are placed, words.
    pub taken: Vec<Rect>,
    /// Stretches of lines.
    pub lines: Vec<[(f64, f64); 2]>,
}

/// From the middle of a dot to a word beside it (pixels).
const BESIDE: f64 = 6.0;
/// Lines through a word before it cannot be read.
const MOST_CROSSED: usize = 1;

impl Surroundings {
    /// A place for a word of this size beside a dot, which is taken from then on; none where there is no room.
    pub fn place(&mut self, dot: (f64, f64), width: f64, height: f64) -> Option<Rect> {
        const WAYS: [(f64, f64); 8] =
            [(0.0, -1.0), (1.0, -1.0), (1.0, 0.0), (-1.0, -1.0), (-1.0, 0.0), (0.0, 1.0), (1.0, 1.0), (-1.0, 1.0)];
        let free = WAYS.iter().filter_map(|way| {
            let (away_x, away_y) = (width / 2.0 + BESIDE, height / 2.0 + BESIDE);
            let rect = Rect::around((dot.0 + way.0 * away_x, dot.1 + way.1 * away_y), width, height);
            let clear = self.bounds.holds(&rect) && !self.taken.iter().any(|taken| taken.meets(&rect));
            let crossed = || self.lines.iter().filter(|[a, b]| rect.crossed(*a, *b)).count();
            clear.then(|| (crossed(), rect))
        });
        let free = free.filter(|(crossed, _)| *crossed <= MOST_CROSSED);
        let best = free.min_by_key(|(crossed, _)| *crossed)?.1;
        self.taken.push(best);
        Some(best)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_find_a_free_side_until_there_is_none() {
        let bounds = Rect(0.0, 0.0, 60.0, 60.0);
        let mut around = Surroundings { bounds, taken: vec![], lines: vec![[(0.0, 17.0), (60.0, 17.0)]] };
        let first = around.place((30.0, 30.0), 16.0, 12.0);
        assert_eq!(first.map(|rect| rect.middle()), Some((44.0, 30.0)), "above runs a line");
        let more: Vec<Rect> = (0..20).map_while(|_| around.place((30.0, 30.0), 16.0, 12.0)).collect();
        assert!((3..8).contains(&more.len()), "{more:?}");
        let all = &around.taken;
        assert!(all.iter().enumerate().all(|(n, a)| all[n + 1..].iter().all(|b| !a.meets(b)) && bounds.holds(a)));
    }
}
