//! Every disk call fails, once or from then on, in every way.
//!
//! | fault | allowed outcome |
//! |---|---|
//! | interrupted, short | the new archive, without a trace of the fault |
//! | full, broken, refused | the new archive; or a clear error and the old one; or, if the folder cannot be synced, [`Error::NotDurable`] and the new one; or, if the rename fails, the old one, and the new one under the name that the error states |
//!
//! In each case another run, resuming or not, makes the new archive and leaves nothing else.

use super::*;
use crate::disk::testing::{Call, Hooked, Verdict};
use std::io::{self, ErrorKind};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    Full,
    Broken,
    Interrupted,
    Short,
    Refused,
}

impl Fault {
    const ALL: [Self; 5] = [Self::Full, Self::Broken, Self::Interrupted, Self::Short, Self::Refused];

    /// Returns the effect on a call; `None` if the fault cannot occur in it.
    fn meets(self, call: Call) -> Option<Verdict> {
        use Call::*;
        Some(match self {
            Self::Full if matches!(call, Write) => Verdict::Torn(ErrorKind::StorageFull.into()),
            Self::Full if matches!(call, Create | Sync | Rename | RenameNew | Link) => {
                Verdict::Fails(ErrorKind::StorageFull.into())
            }
            Self::Broken => Verdict::Torn(io::Error::other("the disk is broken")),
            Self::Interrupted => Verdict::Fails(ErrorKind::Interrupted.into()),
            Self::Short if matches!(call, Read | Write) => Verdict::Short,
            Self::Refused if !matches!(call, Read | Write | Length | Sync | SyncFolder | FreeBytes) => {
                Verdict::Fails(ErrorKind::PermissionDenied.into())
            }
            Self::Full | Self::Short | Self::Refused => return None,
        })
    }
}

/// Returns a disk on which the `strikes`-th call that can have the fault fails, and all later ones if `lasts`; and the
/// counter of such calls.
fn faulty(disk: Arc<ModelDisk>, fault: Fault, strikes: u64, lasts: bool) -> (Arc<Hooked>, Arc<AtomicU64>) {
    let calls = Arc::new(AtomicU64::new(0));
    let counted = calls.clone();
    let hook = move |call| {
        let Some(verdict) = fault.meets(call) else { return Verdict::Done };
        let number = counted.fetch_add(1, Ordering::Relaxed);
        // Signals come between the steps of the work and do not end it.
        let again = lasts && (fault != Fault::Interrupted || (number - strikes.min(number)).is_multiple_of(2));
        if number == strikes || number > strikes && again { verdict } else { Verdict::Done }
    };
    (Hooked::new(disk, hook), calls)
}

/// Refuses an outcome that the table does not allow.
fn check(job: &Job, fault: Fault, done: &Result<Report>, left: &Content) {
    let target = left.bytes(&job.options.output);
    let kept: Vec<_> =
        left.names().filter(|path| **path != *job.options.output && left.bytes(path) == Some(&job.new[..])).collect();
    match done {
        Ok(_) => assert_eq!(target, Some(&job.new[..])),
        Err(error) => {
            let said = error.to_string();
            assert!(!matches!(fault, Fault::Interrupted | Fault::Short), "{said}");
            assert!(said.lines().count() == 1 && said.contains(job.folder.path().to_str().unwrap()), "{said}");
            match error {
                Error::NotDurable { .. } => assert_eq!(target, Some(&job.new[..])),
                _ => assert_eq!(target, Some(&job.old[..]), "{said}"),
            }
            if let Error::Output { .. } = error {
                assert!(kept.iter().any(|path| said.contains(path.to_str().unwrap())), "{said}");
            }
        }
    }
}

#[test]
fn whichever_call_fails_in_whatever_way_nothing_is_lost_and_nothing_is_left_behind() {
    let (failed, resumed) = strike(&Job::new(), &[(false, false), (true, true), (false, true), (true, false)]);
    assert!(failed > 100 && resumed > 10);
}

#[test]
#[ignore = "slow: .ci/run"]
fn nor_is_anything_of_an_archive_with_colours() {
    let job = Job::with(ColourMode::Of(ColourSource::Intensity));
    assert!(strike(&job, &[(false, false), (true, false)]).0 > 50);
}

/// Lets each call fail, once or from then on, with and without resuming. Returns the number of faults, of failed runs,
/// and of runs that can be resumed.
fn strike(job: &Job, ways: &[(bool, bool)]) -> (u64, u64) {
    let (mut struck, mut failed, mut resumed) = (0, 0, 0);
    for fault in Fault::ALL {
        for &(lasts, resume) in ways {
            for strikes in 0.. {
                let model = ModelDisk::new(job.content());
                let (disk, calls) = faulty(model.clone(), fault, strikes, lasts);
                let done = job.convert_on(disk, resume);
                if calls.load(Ordering::Relaxed) <= strikes {
                    assert!(done.is_ok());
                    break;
                }
                struck += 1;
                let left = model.content();
                check(job, fault, &done, &left);
                failed += u64::from(done.is_err());
                resumed += u64::from(matches!(done, Err(Error::Resumable { .. })));
                if let Some(wrong) = job.next_run_fails(left, resume) {
                    panic!("{fault:?} at call {strikes} (lasts: {lasts}, resume: {resume}): {wrong}; {:?}", done.err());
                }
            }
        }
    }
    println!("{struck} faults, {failed} of them failures, {resumed} of these to be resumed");
    (failed, resumed)
}
