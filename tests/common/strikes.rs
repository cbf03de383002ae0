//! Each call of some work fails once, in turn.

use slicewalk::bytes::testing::Strike;
use slicewalk::{Error, Result};
use std::sync::Arc;

/// Lets each call that `run` reports to its strike fail in turn, from number `first` on, until all have; of many calls,
/// fewer of the later ones. A run without a failed call must return `whole`, as must one that `repeats` failed calls; all
/// others must end with an error. Returns the number of calls.
pub fn sweep<T: PartialEq + std::fmt::Debug>(
    name: &str,
    first: u64,
    whole: T,
    repeats: bool,
    is_right: impl Fn(&Error) -> bool,
    mut run: impl FnMut(&Arc<Strike>) -> Result<T>,
) -> u64 {
    let mut number = first;
    loop {
        let strike = Strike::at(number);
        let done = run(&strike);
        match done {
            done if !strike.fell() => {
                assert_eq!(done.unwrap_or_else(|error| panic!("{name}: {error}")), whole, "{name}");
                return number;
            }
            Ok(done) if repeats => assert_eq!(done, whole, "{name}: call {number}"),
            Ok(done) => panic!("{name}: call {number} failed, and yet: {done:?}"),
            Err(error) => {
                let text = error.to_string();
                assert!(is_right(&error) && text.lines().count() == 1, "{name}: call {number}: {text}");
            }
        }
        number += 1 + number / 32;
    }
}

/// Returns whether an error states why the call failed.
pub fn says_the_reason(error: &Error) -> bool {
    error.to_string().contains(Strike::REASON)
}

/// Returns whether an error says that the user stopped the work.
pub fn is_stop(error: &Error) -> bool {
    matches!(error, Error::Interrupted)
}
