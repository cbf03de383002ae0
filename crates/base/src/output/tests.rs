use super::*;
use crate::disk::testing::{Call, Hooked};
use std::fs;
use std::sync::{Arc, Mutex};
use tempfile::TempDir;

const ARCHIVE: OutputKind = OutputKind::Archive(Existing::Refuse);
const ARCHIVE_OVER: OutputKind = OutputKind::Archive(Existing::Replace);
const MERGED: OutputKind = OutputKind::Archive(Existing::KeepSame);
const PLAN: OutputKind = OutputKind::Plan(Existing::Refuse);
const PLAN_OVER: OutputKind = OutputKind::Plan(Existing::Replace);

fn archive(content: &str) -> Vec<u8> {
    [&ARCHIVE_MAGIC[..], content.as_bytes()].concat()
}

fn plan(content: &str) -> Vec<u8> {
    format!("{{\n  \"{PLAN_KEY}\": 1, \"{content}\": 2}}").into_bytes()
}

/// Returns content that an output of `kind` may replace.
fn sort(kind: OutputKind, content: &str) -> Vec<u8> {
    match kind {
        OutputKind::Archive(_) => archive(content),
        OutputKind::Plan(_) => plan(content),
        OutputKind::Result => content.into(),
    }
}

fn publish(target: &Path, kind: OutputKind, bytes: &[u8]) -> Result<bool> {
    publish_beside(target, kind, bytes, Protected::default())
}

fn publish_beside(target: &Path, kind: OutputKind, bytes: &[u8], protected: Protected) -> Result<bool> {
    let mut output = Output::create(target, kind, protected)?;
    output.write_at(0, bytes)?;
    output.publish()
}

/// Runs `act` on a disk whose calls fail when `hook` fails.
fn with_faults<T>(hook: impl FnMut(Call) -> io::Result<()> + Send + 'static, act: impl FnOnce() -> T) -> T {
    crate::disk::with(Hooked::real(hook), act)
}

/// Creates a folder, and a target in it that holds `old`.
fn place(old: Option<&[u8]>) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let target = folder.path().join("target.x");
    if let Some(old) = old {
        fs::write(&target, old).unwrap();
    }
    (folder, target)
}

fn names(folder: &TempDir) -> Vec<String> {
    let names = fs::read_dir(folder.path()).unwrap();
    let mut names: Vec<_> = names.map(|name| name.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn whichever_call_fails_the_old_file_stays_or_the_new_one_is_complete() {
    for (kind, old) in [(ARCHIVE, false), (ARCHIVE_OVER, true), (ARCHIVE_OVER, false), (PLAN_OVER, true)]
        .into_iter()
        .chain([(MERGED, false), (OutputKind::Result, true), (OutputKind::Result, false)])
    {
        let old = old.then(|| sort(kind, "old"));
        let new = sort(kind, "new");
        let (mut refused, mut not_durable) = (0, 0);
        for fails in 0.. {
            let (folder, target) = place(old.as_deref());
            // Number of calls, the one that failed, and whether a sync succeeded.
            let calls = Arc::new(Mutex::new((0, None, false)));
            let seen = calls.clone();
            let hook = move |call| {
                let (number, failed, synced) = &mut *seen.lock().unwrap();
                *number += 1;
                if *number - 1 != fails {
                    *synced |= call == Call::Sync;
                    return Ok(());
                }
                *failed = Some(call);
                Err(io::Error::other("made to fail"))
            };
            let done = with_faults(hook, || publish(&target, kind, &new));
            let there = fs::read(&target).ok();
            let (_, call, synced) = *calls.lock().unwrap();
            match &done {
                Ok(_) => assert_eq!(there.as_ref(), Some(&new), "{kind:?}, {call:?}"),
                Err(Error::NotDurable { .. }) => {
                    assert_eq!((there.as_ref(), call), (Some(&new), Some(Call::SyncFolder)), "{kind:?}");
                    not_durable += 1;
                }
                Err(error) => {
                    assert_eq!(there, old, "{kind:?}, {call:?}");
                    assert!(error.to_string().contains("made to fail"), "{kind:?}, {call:?}: {error}");
                    refused += 1;
                }
            }
            // A complete output, which may have taken hours, is kept, and nothing else.
            let names = names(&folder);
            let kept: Vec<_> = names.iter().filter(|name| *name != "target.x").collect();
            let is_complete = synced && done.as_ref().is_err_and(|error| !matches!(error, Error::NotDurable { .. }));
            let is_kept = is_complete && kind != OutputKind::Result;
            // Where no rename refuses to replace, a hard link gives the name; a temporary name that cannot be removed
            // then stays until the next output.
            let refuses =
                cfg!(all(feature = "spill", any(target_os = "linux", target_os = "android", target_vendor = "apple")));
            let is_twice = !refuses && done.is_ok() && call == Some(Call::Remove);
            assert_eq!(kept.len(), usize::from(is_kept || is_twice), "{kind:?}, {call:?}: {names:?}");
            if let ([kept], Err(error)) = (&kept[..], &done) {
                assert!(kept.starts_with("target.slicewalk-") && error.to_string().contains(*kept), "{kept}: {error}");
                assert_eq!(fs::read(folder.path().join(kept)).unwrap(), new);
            }
            if call.is_none() {
                break;
            }
        }
        assert!(refused >= 6 && not_durable == 1, "{kind:?}: {refused} {not_durable}");
    }
}

#[test]
fn folders_that_their_file_system_cannot_sync_are_no_error() {
    for kind in [ErrorKind::InvalidInput, ErrorKind::Unsupported] {
        let (folder, target) = place(None);
        let hook = move |call| if call == Call::SyncFolder { Err(kind.into()) } else { Ok(()) };
        assert!(with_faults(hook, || publish(&target, ARCHIVE, &archive("new"))).unwrap());
        assert_eq!((fs::read(&target).unwrap(), names(&folder)), (archive("new"), vec!["target.x".to_owned()]));
    }
}

#[test]
fn signals_that_interrupt_every_call_change_nothing() {
    for kind in [ARCHIVE, ARCHIVE_OVER, OutputKind::Result] {
        let old = (kind != ARCHIVE).then(|| sort(kind, "old"));
        let (folder, target) = place(old.as_deref());
        fs::write(folder.path().join(".target.x.slicewalk-0123456789abcdef.part"), "of a killed run").unwrap();
        let mut number = 0;
        let hook = move |_| {
            number += 1;
            if number % 3 > 0 { Err(ErrorKind::Interrupted.into()) } else { Ok(()) }
        };
        assert!(with_faults(hook, || publish(&target, kind, &sort(kind, "new"))).unwrap());
        assert_eq!(fs::read(&target).unwrap(), sort(kind, "new"));
        assert_eq!(names(&folder), ["target.x"]);
    }
}

/// Returns a hook that writes `bytes` to `target` at the first call of `at`.
fn appears(at: Call, target: &Path, bytes: Vec<u8>) -> impl FnMut(Call) -> io::Result<()> + Send + 'static {
    let mut what = Some((target.to_path_buf(), bytes));
    move |call| match what.take_if(|_| call == at) {
        Some((target, bytes)) => fs::write(target, bytes),
        None => Ok(()),
    }
}

#[test]
fn what_appears_while_the_output_is_synced_stays_and_the_output_is_kept() {
    for kind in [ARCHIVE, MERGED, PLAN] {
        for at in [Call::Sync, Call::RenameNew] {
            let (folder, target) = place(None);
            let (there, new) = (sort(kind, "appeared"), sort(kind, "new"));
            let hook = appears(at, &target, there.clone());
            let said = with_faults(hook, || publish(&target, kind, &new)).unwrap_err().to_string();
            assert!(said.contains("another file got this name"), "{said}");
            assert_eq!(fs::read(&target).unwrap(), there);
            let names = names(&folder);
            let kept = names.iter().find(|name| name.starts_with("target.slicewalk-") && name.ends_with(".x")).unwrap();
            assert!(names.len() == 2 && said.contains(kept), "{said}");
            assert_eq!(fs::read(folder.path().join(kept)).unwrap(), new);
        }
    }
}

#[test]
fn what_appears_before_the_rename_is_judged_too() {
    for at in [Call::Sync, Call::RenameNew] {
        for (kind, appeared, is_replaced) in [
            (OutputKind::Result, b"a picture".to_vec(), true),
            (OutputKind::Result, archive("precious"), false),
            (ARCHIVE_OVER, archive("old"), true),
            (ARCHIVE_OVER, b"a scan".to_vec(), false),
        ] {
            let (folder, target) = place(None);
            let new = sort(kind, "new");
            let hook = appears(at, &target, appeared.clone());
            let done = with_faults(hook, || publish(&target, kind, &new));
            assert_eq!(done.is_ok(), is_replaced, "{kind:?}, {at:?}");
            let kept = names(&folder).iter().filter(|name| name.starts_with("target.slicewalk-")).count();
            assert_eq!(kept, usize::from(!is_replaced && kind != OutputKind::Result), "{kind:?}, {at:?}");
            assert_eq!(fs::read(&target).unwrap(), if is_replaced { new } else { appeared });
            assert_eq!(names(&folder).len(), 1 + kept);
        }
    }
}

#[test]
fn each_kind_replaces_its_own_sort_only() {
    let contents = [archive("a"), plan("a"), b"a picture or a scan".to_vec(), Vec::new()];
    for (kind, replaces) in [
        (ARCHIVE, [false; 4]),
        (ARCHIVE_OVER, [true, false, false, true]),
        (MERGED, [false; 4]),
        (PLAN, [false; 4]),
        (PLAN_OVER, [false, true, false, true]),
        (OutputKind::Result, [false, false, true, true]),
    ] {
        for (content, replaced) in contents.iter().zip(replaces) {
            let (folder, target) = place(Some(content));
            let new = sort(kind, "new");
            let done = publish(&target, kind, &new);
            assert_eq!(done.is_ok(), replaced, "{kind:?}: {done:?}");
            assert_eq!(&fs::read(&target).unwrap(), if replaced { &new } else { content });
            assert_eq!(names(&folder), ["target.x"]);
            // The message suggests allowing a replacement if and only if that would help.
            let helps = matches!(kind, OutputKind::Archive(_) if content.starts_with(&ARCHIVE_MAGIC) || content.is_empty())
                || matches!(kind, OutputKind::Plan(_) if content.starts_with(b"{") || content.is_empty());
            let said = done.map_or_else(|error| error.to_string(), |_| String::new());
            assert!(replaced || said.contains("allow it to be replaced") == helps, "{kind:?}: {said}");
        }
    }
    // If the file already has these bytes, it counts as written and is left alone.
    let (_folder, target) = place(Some(&archive("same")));
    let before = crate::bytes::FileId::at(&target);
    assert!(!publish(&target, MERGED, &archive("same")).unwrap());
    assert_eq!(crate::bytes::FileId::at(&target), before);
}

#[test]
fn a_failed_write_is_never_published() {
    let (folder, target) = place(Some(b"old"));
    let mut is_first = true;
    let hook = move |call| match call == Call::Write && std::mem::take(&mut is_first) {
        true => Err(io::Error::other("disk is full")),
        false => Ok(()),
    };
    let create = || Output::create(&target, OutputKind::Result, Protected::default()).unwrap();
    let mut output = with_faults(hook, create);
    assert!(output.write_all(b"new").unwrap_err().to_string().contains("disk is full"));
    output.write_all(b"more").unwrap();
    assert!(output.publish().is_err());
    assert_eq!((fs::read(&target).unwrap(), names(&folder)), (b"old".to_vec(), vec!["target.x".to_owned()]));
}

#[test]
fn bytes_go_where_writes_and_seeks_say() {
    let (_folder, target) = place(None);
    let mut output = Output::create(&target, OutputKind::Result, Protected::default()).unwrap();
    output.write_all(b"hello world").unwrap();
    assert_eq!(output.seek(SeekFrom::Start(1)).unwrap(), 1);
    output.write_all(b"a").unwrap();
    assert_eq!(output.seek(SeekFrom::End(-1)).unwrap(), 10);
    output.write_all(b"ms").unwrap();
    assert_eq!(output.seek(SeekFrom::Current(-2)).unwrap(), 10);
    assert!(output.seek(SeekFrom::Current(-11)).is_err());
    output.publish().unwrap();
    assert_eq!(fs::read(&target).unwrap(), b"hallo worlms");
}

#[test]
fn what_was_written_is_read_back() {
    let (_folder, target) = place(None);
    let mut output = Output::create(&target, OutputKind::Result, Protected::default()).unwrap();
    output.write_all(b"hello world").unwrap();
    let mut bytes = [0; 5];
    output.read_at(6, &mut bytes).unwrap();
    assert_eq!(&bytes, b"world");
    assert!(output.read_at(7, &mut bytes).is_err());
    output.seek(SeekFrom::Start(2)).unwrap();
    let mut rest = String::new();
    output.read_to_string(&mut rest).unwrap();
    assert_eq!(rest, "llo world");
}

#[test]
fn the_same_bytes_are_kept_and_one_other_byte_is_refused() {
    // More than is compared at once.
    let bytes = archive(&"x".repeat(CHUNK + CHUNK / 2));
    let (_folder, target) = place(Some(&bytes));
    assert!(!publish(&target, MERGED, &bytes).unwrap());
    for at in [8, CHUNK - 1, CHUNK, bytes.len() - 1] {
        let mut other = bytes.clone();
        other[at] ^= 1;
        assert!(publish(&target, MERGED, &other).is_err(), "byte {at}");
    }
    assert!(publish(&target, MERGED, &bytes[..bytes.len() - 1]).is_err());
    assert_eq!(fs::read(&target).unwrap(), bytes);
}

#[test]
fn two_failed_writes_are_no_good_one() {
    let (_folder, target) = place(None);
    let mut left = 2;
    let hook = move |call| {
        let fails = call == Call::Write && left > 0;
        left -= u32::from(fails);
        if fails { Err(io::Error::other("disk is full")) } else { Ok(()) }
    };
    let create = || Output::create(&target, OutputKind::Result, Protected::default()).unwrap();
    let mut output = with_faults(hook, create);
    assert!(output.write_at(0, b"new").is_err() && output.write_at(0, b"new").is_err());
    output.write_at(0, b"new").unwrap();
    assert!(output.publish().is_err());
    assert!(!target.exists());
}

#[test]
fn a_plan_is_an_object_with_its_key_and_nothing_else() {
    let key = format!("\"{PLAN_KEY}\": 1");
    for other in ["{\"a\": 1}".to_owned(), key.clone(), format!("[{{{key}}}]")] {
        let (_folder, target) = place(Some(other.as_bytes()));
        assert!(publish(&target, PLAN_OVER, &plan("new")).is_err(), "{other}");
        assert_eq!(fs::read(&target).unwrap(), other.as_bytes());
    }
    let (_folder, target) = place(Some(format!("\u{feff} \n{{{key}}}").as_bytes()));
    assert!(publish(&target, PLAN_OVER, &plan("new")).unwrap());
}

#[test]
fn refusals_name_what_is_there_and_what_should_be() {
    let said = |kind, content: &[u8]| {
        let (_folder, target) = place(Some(content));
        publish(&target, kind, &sort(kind, "new")).unwrap_err().to_string()
    };
    assert!(said(PLAN_OVER, &archive("a")).contains("exists and is not a plan, so"));
    assert!(said(ARCHIVE_OVER, &plan("a")).contains("exists and is not a slice archive, so"));
    let never = "which a picture, table or export never replaces";
    assert!(said(OutputKind::Result, &archive("a")).contains(&format!("is a slice archive, {never}")));
    assert!(said(OutputKind::Result, &plan("a")).contains(&format!("is a plan, {never}")));
}

#[test]
fn what_a_source_reads_is_not_replaced_and_its_neighbours_are() {
    let (folder, target) = place(Some(b"read"));
    let mut protected = Protected::default();
    protected.add_source(&FileSource::open(&target).unwrap());
    let said = publish_beside(&target, OutputKind::Result, b"new", protected.clone()).unwrap_err().to_string();
    assert!(said.contains("a file that this command reads"), "{said}");
    assert_eq!(fs::read(&target).unwrap(), b"read");
    let other = folder.path().join("other.x");
    fs::write(&other, "old").unwrap();
    assert!(publish_beside(&other, OutputKind::Result, b"new", protected).unwrap());
    assert_eq!(fs::read(&other).unwrap(), b"new");
}

#[test]
fn a_name_that_another_output_takes_is_refused_before_it_exists() {
    let (folder, target) = place(None);
    fs::create_dir(folder.path().join("sub")).unwrap();
    let protected: Protected = [&target].into_iter().collect();
    for name in [target.clone(), folder.path().join("./target.x"), folder.path().join("sub/../target.x")] {
        let said = publish_beside(&name, OutputKind::Result, b"new", protected.clone()).unwrap_err().to_string();
        assert!(said.contains("is another output of this command"), "{said}");
        assert_eq!(names(&folder), ["sub"]);
    }
    for name in ["other.x", "sub/target.x"] {
        assert!(publish_beside(&folder.path().join(name), OutputKind::Result, b"new", protected.clone()).unwrap());
    }
    // Standard input is no file of that name, and nothing can be written to a folder that is missing.
    for read in ["-", "missing/target.x"] {
        let protected: Protected = [read].into_iter().collect();
        assert!(publish_beside(&target, OutputKind::Result, b"new", protected).unwrap());
    }
}

#[test]
fn archives_and_plans_are_not_written_to_standard_output() {
    for (kind, name) in [(ARCHIVE, "a slice archive"), (PLAN_OVER, "a plan")] {
        let said = check(Path::new("-"), kind, Protected::default()).unwrap_err().to_string();
        assert!(said.contains(&format!("{name} is not written to standard output")), "{said}");
    }
}

#[test]
fn what_is_no_file_or_has_no_folder_is_refused() {
    let (folder, target) = place(None);
    fs::write(&target, "").unwrap();
    for name in ["", "..", "no/such", "no/..", "new/", "new/.", "target.x/x", "target.x/"] {
        for kind in [ARCHIVE_OVER, OutputKind::Result] {
            let said = publish(&folder.path().join(name), kind, b"new").unwrap_err().to_string();
            assert!(said.contains(folder.path().to_str().unwrap()) && said.lines().count() == 1, "{said}");
        }
    }
    assert_eq!(names(&folder), ["target.x"]);
}

#[cfg(unix)]
mod on_unix {
    use super::*;
    use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt, symlink};

    #[test]
    fn links_stay_and_what_they_name_is_replaced_or_made() {
        for kind in [ARCHIVE_OVER, OutputKind::Result] {
            let (folder, target) = place(Some(&sort(kind, "old")));
            fs::create_dir(folder.path().join("sub")).unwrap();
            let (link, far, nothing) =
                (folder.path().join("link"), folder.path().join("sub/far"), folder.path().join("sub/nothing"));
            symlink("target.x", &link).unwrap();
            symlink("../link", &far).unwrap();
            symlink("made", &nothing).unwrap();
            publish(&far, kind, &sort(kind, "new")).unwrap();
            publish(&nothing, kind, &sort(kind, "new")).unwrap();
            assert_eq!(fs::read(&target).unwrap(), sort(kind, "new"));
            assert_eq!(fs::read(folder.path().join("sub/made")).unwrap(), sort(kind, "new"));
            for link in [&link, &far, &nothing] {
                assert!(fs::symlink_metadata(link).unwrap().is_symlink());
            }
            let round = folder.path().join("round");
            symlink("round", &round).unwrap();
            assert!(publish(&round, kind, b"new").unwrap_err().to_string().contains("leads to itself"));
            assert_eq!(names(&folder), ["link", "round", "sub", "target.x"]);
        }
        // Without permission to replace, a link to an archive is treated like an archive.
        let (folder, target) = place(Some(&archive("old")));
        let link = folder.path().join("link");
        symlink(&target, &link).unwrap();
        assert!(publish(&link, ARCHIVE, &archive("new")).unwrap_err().to_string().contains("allow it to be replaced"));
    }

    #[test]
    fn a_link_to_nothing_that_appears_meanwhile_stays() {
        for kind in [ARCHIVE, ARCHIVE_OVER, OutputKind::Result] {
            let (_folder, target) = place(None);
            let (mut links, link) = (Some(()), target.clone());
            let hook = move |call| match links.take_if(|_| call == Call::Sync) {
                Some(()) => symlink("nothing", &link),
                None => Ok(()),
            };
            let said = with_faults(hook, || publish(&target, kind, &sort(kind, "new"))).unwrap_err().to_string();
            assert!(said.contains("another file got this name"), "{said}");
            assert!(fs::symlink_metadata(&target).unwrap().is_symlink());
        }
    }

    #[test]
    fn what_is_read_is_not_replaced_under_any_name() {
        for kind in [ARCHIVE_OVER, MERGED, OutputKind::Result] {
            let (folder, target) = place(Some(&sort(kind, "read")));
            let (hard, soft) = (folder.path().join("hard"), folder.path().join("soft"));
            fs::hard_link(&target, &hard).unwrap();
            symlink(&target, &soft).unwrap();
            let odd = folder.path().join("./target.x");
            for (read, name) in
                [(&target, &target), (&target, &hard), (&hard, &target), (&target, &soft), (&soft, &odd)]
            {
                let protected = [read].into_iter().collect();
                let said = publish_beside(name, kind, b"new", protected).unwrap_err().to_string();
                assert!(said.contains("this command reads"), "{said}");
            }
            // A name that becomes a link to a file being read while the output is written.
            let late = folder.path().join("late");
            let (from, to) = (target.clone(), late.clone());
            let mut links = Some(());
            let hook = move |call| match links.take_if(|_| call == Call::Sync) {
                Some(()) => fs::hard_link(&from, &to),
                None => Ok(()),
            };
            let done = with_faults(hook, || publish_beside(&late, kind, b"new", [&target].into_iter().collect()));
            assert!(done.is_err());
            assert_eq!(fs::read(&target).unwrap(), sort(kind, "read"));
            assert_eq!(fs::read(&late).unwrap(), sort(kind, "read"));
        }
    }

    #[test]
    fn a_descriptor_of_a_file_that_is_read_is_refused() {
        use std::os::fd::AsRawFd;
        let (folder, target) = place(Some(b"read"));
        let open = fs::OpenOptions::new().append(true).open(&target).unwrap();
        let name = PathBuf::from(format!("/dev/fd/{}", open.as_raw_fd()));
        let said = publish_beside(&name, OutputKind::Result, b"new", [&target].into_iter().collect());
        assert!(said.unwrap_err().to_string().contains("a file that this command reads"));
        fs::write(folder.path().join("other"), "").unwrap();
        let other = [folder.path().join("other")].into_iter().collect();
        assert!(publish_beside(&name, OutputKind::Result, b" and more", other).unwrap());
        assert_eq!(fs::read(&target).unwrap(), b"read and more");
        // More than is copied at once, under another name of the descriptor.
        let more: Vec<u8> = (0..CHUNK + CHUNK / 2).map(|at| (at / 1000) as u8).collect();
        let name = PathBuf::from(format!("/proc/self/fd/{}", open.as_raw_fd()));
        if name.exists() {
            assert!(publish(&name, OutputKind::Result, &more).unwrap());
            assert_eq!(fs::read(&target).unwrap(), [b"read and more", &more[..]].concat());
        }
    }

    #[test]
    fn the_owner_is_who_makes_files() {
        let (_folder, target) = place(Some(b"mine"));
        let output = Output::create(&target, OutputKind::Result, Protected::default()).unwrap();
        assert_eq!(output.owner(), Some(fs::metadata(&target).unwrap().uid()));
    }

    #[test]
    fn devices_are_written_to_and_stay() {
        let (folder, _) = place(None);
        let null = folder.path().join("null");
        symlink("/dev/null", &null).unwrap();
        assert!(publish(&null, OutputKind::Result, b"new").unwrap());
        for kind in [ARCHIVE_OVER, PLAN_OVER] {
            assert!(publish(&null, kind, b"new").unwrap_err().to_string().contains("not a regular file"));
        }
        assert!(fs::metadata(&null).unwrap().file_type().is_char_device());
        if Path::new("/dev/full").exists() {
            let full = folder.path().join("full");
            symlink("/dev/full", &full).unwrap();
            assert!(publish(&full, OutputKind::Result, b"new").unwrap_err().to_string().contains("full: cannot write"));
            assert!(fs::metadata(&full).unwrap().file_type().is_char_device());
        }
        assert!(names(&folder).iter().all(|name| name == "null" || name == "full"));
    }

    #[test]
    fn a_socket_is_refused_and_stays() {
        let (folder, _) = place(None);
        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        for (kind, words) in [(OutputKind::Result, "cannot open"), (ARCHIVE_OVER, "not a regular file")] {
            let said = publish(&socket, kind, b"new").unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
        }
        assert!(fs::metadata(&socket).unwrap().file_type().is_socket());
        assert_eq!(names(&folder), ["socket"]);
    }

    #[test]
    fn a_pipe_that_appears_meanwhile_stays() {
        for kind in [ARCHIVE_OVER, OutputKind::Result] {
            let (_folder, target) = place(None);
            let (mut pipes, pipe) = (Some(()), target.clone());
            let hook = move |call| -> io::Result<()> {
                if pipes.take_if(|_| call == Call::Sync).is_some() {
                    assert!(std::process::Command::new("mkfifo").arg(&pipe).status()?.success());
                }
                Ok(())
            };
            let said = with_faults(hook, || publish(&target, kind, &sort(kind, "new"))).unwrap_err().to_string();
            assert!(said.contains("is not a regular file"), "{said}");
            assert!(fs::metadata(&target).unwrap().file_type().is_fifo());
        }
    }

    #[test]
    fn a_pipe_under_the_name_of_a_leftover_holds_nobody_up() {
        let (folder, target) = place(None);
        let pipe = folder.path().join(".target.x.slicewalk-0123456789abcdef.part");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        if !made.is_ok_and(|status| status.success()) {
            eprintln!("skipped: no pipe can be made here");
            return;
        }
        let (done, is_done) = std::sync::mpsc::channel();
        std::thread::spawn(move || done.send(publish(&target, ARCHIVE, b"new").unwrap()));
        assert_eq!(
            is_done.recv_timeout(std::time::Duration::from_secs(60)),
            Ok(true),
            "it waits for the pipe's reader"
        );
        assert!(pipe.exists());
    }

    #[test]
    fn a_new_file_has_the_permissions_of_any_and_another_no_more_than_what_it_replaces() {
        let mode = |path: &Path| fs::metadata(path).unwrap().mode() & 0o777;
        for kind in [ARCHIVE_OVER, PLAN_OVER, OutputKind::Result] {
            let (folder, target) = place(None);
            let plain = folder.path().join("plain");
            fs::write(&plain, "").unwrap();
            publish(&target, kind, &sort(kind, "new")).unwrap();
            assert_eq!(mode(&target), mode(&plain));
            fs::set_permissions(&target, fs::Permissions::from_mode(0o600)).unwrap();
            publish(&target, kind, &sort(kind, "newer")).unwrap();
            assert_eq!(mode(&target), 0o600);
        }
        let (_folder, target) = place(Some(b"old"));
        fs::set_permissions(&target, fs::Permissions::from_mode(0o444)).unwrap();
        assert!(publish(&target, OutputKind::Result, b"new").unwrap_err().to_string().contains("read-only"));
        assert_eq!(fs::read(&target).unwrap(), b"old");
    }
}

#[test]
fn what_was_written_is_read_back_in_pieces_from_where_writing_stands() {
    let (_folder, target) = place(None);
    let mut output = Output::create(&target, OutputKind::Result, Protected::default()).unwrap();
    output.write_all(b"one two three").unwrap();
    output.seek(SeekFrom::Start(4)).unwrap();
    let (mut piece, mut read) = ([0; 4], Vec::new());
    loop {
        match output.read(&mut piece).unwrap() {
            0 => break,
            count => read.extend_from_slice(&piece[..count]),
        }
    }
    assert_eq!(read, b"two three");
}
