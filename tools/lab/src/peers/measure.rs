//! Times of single calls, with their answers.

use std::hint::black_box;
use std::time::{Duration, Instant};

/// Time for one round of a method that is too slow for all items.
const ROUND: Duration = Duration::from_millis(1500);
const ROUNDS: usize = 3;

pub struct Measured<R> {
    /// Mean, median, 99th and 99.9th percentile (ns).
    pub times: [f64; 4],
    /// The answers to the first items.
    pub answers: Vec<R>,
}

/// Asks about as many items as there is time for.
pub fn measure<T, R>(items: &[T], call: impl FnMut(&T) -> R) -> Measured<R> {
    measure_within(ROUND, items, call)
}

/// Asks about as many items as one round has time for. Per item the best of three rounds, less the clock's own time: other
/// work on the machine only adds.
pub fn measure_within<T, R>(round: Duration, items: &[T], mut call: impl FnMut(&T) -> R) -> Measured<R> {
    let mut clock: Vec<f64> = (0..10_000).map(|_| nanoseconds(Instant::now())).collect();
    clock.sort_by(f64::total_cmp);
    let clock = clock[clock.len() / 2];
    let (mut answers, mut best) = (Vec::new(), Vec::new());
    let begin = Instant::now();
    for item in items {
        let start = Instant::now();
        let answer = black_box(call(black_box(item)));
        best.push(nanoseconds(start));
        answers.push(answer);
        if begin.elapsed() > round {
            break;
        }
    }
    for _ in 1..ROUNDS {
        for (item, best) in items.iter().zip(&mut best) {
            let start = Instant::now();
            black_box(call(black_box(item)));
            *best = best.min(nanoseconds(start));
        }
    }
    best.iter_mut().for_each(|time| *time = (*time - clock).max(0.0));
    Measured { times: summary(best), answers }
}

/// Mean, median, 99th and 99.9th percentile.
pub fn summary(mut times: Vec<f64>) -> [f64; 4] {
    times.sort_by(f64::total_cmp);
    let at = |share: f64| times[((times.len() - 1) as f64 * share).round() as usize];
    [times.iter().sum::<f64>() / times.len() as f64, at(0.5), at(0.99), at(0.999)]
}

fn nanoseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e9
}
