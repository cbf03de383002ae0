//! Checks of a table that need all of its pieces: whether there are as many rows as the line before them states, and
//! which rows were left out.

use crate::Result;
use crate::diagnostics::Findings;

/// Number of points in the first line of a table.
#[derive(Debug, Clone, Copy)]
pub(super) struct Count {
    /// `None` if the rows begin without a count.
    pub stated: Option<u64>,
    /// True if more clouds may follow, each after a count of its own.
    pub may_repeat: bool,
}

/// Counts collected in one piece; their size does not depend on that of the piece.
#[derive(Debug, Default, Clone)]
pub(super) struct Tally {
    /// Rows before the first count in the piece.
    before: u64,
    /// Number of counts; `last`: the last count; `behind`: rows after it.
    counts: u64,
    last: u64,
    behind: u64,
    /// First cloud within the piece with fewer rows than stated; `more`: the first with more.
    fewer: Option<Uneven>,
    more: Option<Uneven>,
    /// Rows that clouds within the piece lack.
    lacking: u64,
    /// Number of rows left out; `first`: offset and fault of the first.
    faults: u64,
    first: Option<(u64, String)>,
}

/// A cloud whose number of rows differs from the stated one, with its index among the clouds of the piece.
#[derive(Debug, Clone, Copy)]
struct Uneven {
    cloud: u64,
    stated: u64,
    rows: u64,
}

impl Uneven {
    fn text(&self, may_repeat: bool) -> String {
        let Self { cloud, stated, rows } = self;
        let cloud = if may_repeat { format!("cloud {}: ", cloud + 1) } else { String::new() };
        let points = if *stated == 1 { "point" } else { "points" };
        let follow = if *rows == 1 { "line follows" } else { "lines follow" };
        format!("{cloud}its first line states {stated} {points}, {rows} {follow}")
    }
}

impl Tally {
    #[inline]
    pub fn add_row(&mut self) {
        *(if self.counts == 0 { &mut self.before } else { &mut self.behind }) += 1;
    }

    /// Adds a count found between rows.
    pub fn add_count(&mut self, stated: u64) {
        if self.counts > 0 {
            self.end_cloud();
        }
        (self.counts, self.last, self.behind) = (self.counts + 1, stated, 0);
    }

    fn end_cloud(&mut self) {
        let found = Uneven { cloud: self.counts, stated: self.last, rows: self.behind };
        if found.rows < found.stated {
            self.fewer.get_or_insert(found);
            self.lacking = self.lacking.saturating_add(found.stated - found.rows);
        } else if found.rows > found.stated {
            self.more.get_or_insert(found);
        }
    }

    pub fn add_fault(&mut self, at: u64, reason: String) {
        self.faults += 1;
        self.first.get_or_insert((at, reason));
    }

    /// Appends the tally of the next piece to one that has a count.
    fn join(&mut self, next: &Self) {
        self.behind += next.before;
        if next.counts == 0 {
            return;
        }
        self.end_cloud();
        let here = self.counts;
        let moved = |uneven: Uneven| Uneven { cloud: uneven.cloud + here, ..uneven };
        self.fewer = self.fewer.or(next.fewer.map(moved));
        self.more = self.more.or(next.more.map(moved));
        self.lacking = self.lacking.saturating_add(next.lacking);
        (self.counts, self.last, self.behind) = (here + next.counts, next.last, next.behind);
    }
}

/// Compares the rows of all pieces, in order, with the counts in the text.
pub(super) fn check_count<'a>(
    count: Count,
    pieces: impl Iterator<Item = &'a Tally>,
    findings: &mut Findings<'_>,
) -> Result<()> {
    let mut all = Tally::default();
    // Rows without a count before them are a cloud, too.
    all.add_count(count.stated.unwrap_or(0));
    pieces.for_each(|piece| all.join(piece));
    all.end_cloud();
    let is_counted = |uneven: &Uneven| count.stated.is_some() || uneven.cloud > 1;
    let text = |uneven: Uneven| Uneven { cloud: uneven.cloud - 1, ..uneven }.text(count.may_repeat);
    if let Some(more) = all.more.filter(is_counted) {
        findings.note(format!("{}; all are read", text(more)));
    }
    match all.fewer {
        Some(fewer) => findings.lose_points(all.lacking, text(fewer)),
        None => Ok(()),
    }
}

/// Returns the number of rows left out of all pieces, with the offset and fault of the first.
pub(super) fn faults<'a>(pieces: impl Iterator<Item = &'a Tally>) -> (u64, Option<(u64, String)>) {
    let (mut count, mut first) = (0, None);
    for piece in pieces {
        count += piece.faults;
        first = first.or(piece.first.clone());
    }
    (count, first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Creates a piece from rows, each part with a count before it if given.
    fn piece(parts: &[(Option<u64>, u64)]) -> Tally {
        let mut tally = Tally::default();
        for &(count, rows) in parts {
            count.into_iter().for_each(|count| tally.add_count(count));
            (0..rows).for_each(|_| tally.add_row());
        }
        tally
    }

    #[test]
    fn rows_are_compared_with_their_number_across_pieces() {
        let check = |stated: Option<u64>, pieces: &[Tally]| {
            let (path, allow_incomplete) = (Path::new("a"), true);
            let mut findings = Findings { path, allow_incomplete, notes: Vec::new(), lost: Vec::new(), points: 0 };
            check_count(Count { stated, may_repeat: true }, pieces.iter(), &mut findings).unwrap();
            findings.lost.into_iter().chain(findings.notes).collect::<Vec<_>>()
        };
        let nothing: [&str; 0] = [];
        assert_eq!(check(Some(5), &[piece(&[(None, 2)]), piece(&[]), piece(&[(None, 3)])]), nothing);
        assert_eq!(check(None, &[piece(&[(None, 2), (Some(1), 1)])]), nothing);
        let two = [piece(&[(None, 2), (Some(7), 3)]), piece(&[(None, 4), (Some(0), 0), (Some(2), 1)])];
        assert_eq!(check(Some(2), &two), ["cloud 4: its first line states 2 points, 1 line follows"]);
        let two = [piece(&[(None, 2), (Some(7), 3)]), piece(&[(None, 3), (Some(1), 1), (Some(2), 4)])];
        let found = check(Some(2), &two);
        assert_eq!(found[0], "cloud 2: its first line states 7 points, 6 lines follow");
        assert_eq!(found[1], "cloud 4: its first line states 2 points, 4 lines follow; all are read");
        // Both within the second piece.
        let two = [piece(&[(None, 2)]), piece(&[(None, 0), (Some(1), 0), (Some(3), 4), (Some(2), 2)])];
        let found = check(Some(2), &two);
        assert_eq!(found[0], "cloud 2: its first line states 1 point, 0 lines follow");
        assert_eq!(found[1], "cloud 3: its first line states 3 points, 4 lines follow; all are read");
        assert_eq!(check(Some(3), &[piece(&[])]), ["cloud 1: its first line states 3 points, 0 lines follow"]);
        assert_eq!(check(Some(3), &[]), ["cloud 1: its first line states 3 points, 0 lines follow"]);
    }
}
