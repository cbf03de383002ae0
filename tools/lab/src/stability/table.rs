//! Tables, as CSV files and in the page, and small statistics.

/// A table of text: one row per case.
#[derive(Debug, Clone, Default)]
pub struct Table {
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// An empty table with these columns.
    pub fn new<S: Into<String>>(head: impl IntoIterator<Item = S>) -> Self {
        Self { head: head.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds a row.
    ///
    /// # Panics
    /// When the row has another length than the head.
    pub fn row<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) {
        let cells: Vec<String> = cells.into_iter().map(Into::into).collect();
        assert_eq!(cells.len(), self.head.len(), "{cells:?}");
        self.rows.push(cells);
    }

    /// As comma-separated values.
    pub fn csv(&self) -> String {
        let line = |cells: &Vec<String>| cells.join(",") + "\n";
        std::iter::once(&self.head).chain(&self.rows).map(line).collect()
    }

    /// As a Markdown table.
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let rule = vec!["---".to_owned(); self.head.len()];
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        (line(&self.head) + &line(&rule) + &rows).trim_end().to_owned()
    }
}

/// Formats a number with `decimals` digits; -0 is 0.
pub fn number(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.chars().all(|c| c == '0' || c == '.') => rest.to_owned(),
        _ => text,
    }
}

/// A share as a percentage, with more decimals near 0 and 100.
pub fn percent(share: f64) -> String {
    let value = share * 100.0;
    if value == 0.0 || value == 100.0 {
        format!("{value:.0} %")
    } else if !(1.0..=99.0).contains(&value) {
        format!("{value:.2} %")
    } else {
        format!("{value:.1} %")
    }
}

/// A share of yes among all.
#[derive(Debug, Clone, Copy, Default)]
pub struct Share {
    /// Number of yes.
    pub yes: u64,
    /// Number of all.
    pub all: u64,
}

impl Share {
    /// Counts one.
    pub fn add(&mut self, yes: bool) {
        self.yes += u64::from(yes);
        self.all += 1;
    }

    /// Counts all of another.
    pub fn merge(&mut self, other: Self) {
        self.yes += other.yes;
        self.all += other.all;
    }

    /// Yes over all; 0 of none.
    pub fn value(&self) -> f64 {
        if self.all == 0 { 0.0 } else { self.yes as f64 / self.all as f64 }
    }
}

/// Errors of one measured quantity.
#[derive(Debug, Clone, Default)]
pub struct Errors(pub Vec<f64>);

impl Errors {
    /// Root mean square.
    pub fn rmse(&self) -> f64 {
        (self.0.iter().map(|e| e * e).sum::<f64>() / self.0.len().max(1) as f64).sqrt()
    }

    /// Mean: positive is too high.
    pub fn mean(&self) -> f64 {
        self.0.iter().sum::<f64>() / self.0.len().max(1) as f64
    }

    /// Magnitude that this share of all errors does not exceed; 1 is the greatest.
    pub fn quantile(&self, share: f64) -> f64 {
        let mut sizes: Vec<f64> = self.0.iter().map(|e| e.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let at = (share * sizes.len() as f64).ceil() as usize;
        sizes.get(at.clamp(1, sizes.len().max(1)) - 1).copied().unwrap_or(0.0)
    }
}

/// Median, least and greatest; the upper of two medians, NaN of none.
pub fn spread(values: &[f64]) -> [f64; 3] {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |n: usize| sorted.get(n).copied().unwrap_or(f64::NAN);
    [at(sorted.len() / 2), at(0), at(sorted.len().saturating_sub(1))]
}

/// First `x` at which the polyline through `points` reaches `level` from below.
pub fn crossing(points: &[(f64, f64)], level: f64) -> Option<f64> {
    if points.first()?.1 >= level {
        return Some(points[0].0);
    }
    points.windows(2).find(|pair| pair[0].1 < level && pair[1].1 >= level).map(|pair| {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        x0 + (x1 - x0) * (level - y0) / (y1 - y0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_stand_between_the_extremes() {
        assert_eq!(spread(&[3.0, 1.0, 2.0]), [2.0, 1.0, 3.0]);
        assert_eq!(spread(&[5.0]), [5.0; 3]);
        assert!(spread(&[])[0].is_nan());
    }

    #[test]
    fn statistics_of_small_samples() {
        let errors = Errors(vec![-3.0, 1.0, 1.0, 1.0]);
        assert_eq!((errors.quantile(0.75), errors.quantile(1.0), errors.mean()), (1.0, 3.0, 0.0));
        assert_eq!(errors.rmse(), 3f64.sqrt());
        assert_eq!(crossing(&[(0.0, 0.0), (10.0, 1.0)], 0.5), Some(5.0));
        assert_eq!(crossing(&[(0.0, 0.0), (10.0, 0.4)], 0.5), None);
        assert_eq!((number(-0.001, 2), percent(0.5)), ("0.00".into(), "50.0 %".into()));
    }
}
