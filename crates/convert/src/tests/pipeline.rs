//! Jobs passed to threads and back (`tests/schedules.rs` tests their schedules).

use crate::pipeline::{Closed, Pipeline, run_alone};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};

const JOBS: u64 = 1000;

#[test]
fn jobs_come_back_in_order_and_few_run_ahead() {
    for (threads, ahead) in [(1, 1), (2, 4), (5, 3)] {
        let (mut next, done) = (0, AtomicU64::new(0));
        let run = Pipeline { threads, ahead }.run(
            |job| (0..JOBS).try_for_each(|number| job(number).map_err(|Closed| "closed")),
            || {
                |number: u64| {
                    done.fetch_add(1, Ordering::SeqCst);
                    // Occasionally a job takes longer than those after it.
                    if number.is_multiple_of(97) {
                        std::thread::yield_now();
                    }
                    Ok(number)
                }
            },
            |number| {
                assert_eq!(number, next);
                next += 1;
                let ahead_now = done.load(Ordering::SeqCst) - number;
                assert!(ahead_now <= ahead as u64, "{ahead_now} jobs done since");
                Ok(())
            },
            || Ok(()),
            |_| "no thread",
        );
        assert_eq!((run, next), (Ok(()), JOBS));
    }
}

#[test]
fn a_worker_that_panics_wakes_the_others() {
    let run = || {
        Pipeline { threads: 3, ahead: 4 }.run(
            |job| (0..JOBS).try_for_each(|number| job(number).map_err(|Closed| "closed")),
            || |number: u64| if number == 17 { panic!("a planted fault") } else { Ok(number) },
            |_| Ok(()),
            || Ok(()),
            |_| "no thread",
        )
    };
    assert!(catch_unwind(AssertUnwindSafe(run)).is_err());
}

#[test]
fn without_threads_jobs_come_in_order_and_the_first_error_ends_them() {
    let run = |wrong: u64, refused: u64| {
        let mut taken = Vec::new();
        let done = run_alone(
            |job| (0..JOBS).try_for_each(|number| job(number).map_err(|Closed| "closed")),
            |number| if number == wrong { Err("work") } else { Ok(2 * number) },
            |number| {
                if number == 2 * refused {
                    return Err("take");
                }
                taken.push(number);
                Ok(())
            },
            || Ok(()),
        );
        (done, taken)
    };
    assert_eq!(run(JOBS, JOBS), (Ok(()), (0..JOBS).map(|number| 2 * number).collect()));
    assert_eq!(run(3, 5), (Err("work"), vec![0, 2, 4]));
    assert_eq!(run(5, 2), (Err("take"), vec![0, 2]));
    assert_eq!(run_alone(|_| Err("give"), |()| Ok(()), Ok, || Ok(())), Err("give"));
}
