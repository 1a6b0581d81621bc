//! Errors of reading name the remedy.

#![allow(clippy::expect_used, reason = "tests fail as tests do")]

use std::io;

use evolvent_trace::{ReadError, RecoverError, TraceFile, recover};

#[test]
fn a_file_that_cannot_be_read_is_told_with_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("run.mcap");
    let describe = |kind: io::ErrorKind| {
        let source = io::Error::from(kind);
        let path = path.clone();
        let error = ReadError::Io { path, source };
        (error.to_string(), error.is_wrong_name())
    };
    for (kind, wanted, is_wrong_name) in [
        (
            io::ErrorKind::NotFound,
            "run.mcap does not exist; check the name",
            true,
        ),
        (
            io::ErrorKind::IsADirectory,
            "is a folder; name one of the traces",
            true,
        ),
        (io::ErrorKind::PermissionDenied, "ask its owner", false),
        (io::ErrorKind::TimedOut, "try again", false),
    ] {
        let (text, wrong) = describe(kind);
        assert!(text.contains(wanted), "{text}");
        assert_eq!(wrong, is_wrong_name, "{text}");
    }
    let error = TraceFile::open(folder.path()).expect_err("a folder is not a trace");
    assert!(
        error.to_string().contains("is a folder") && error.is_wrong_name(),
        "{error}"
    );
}

#[test]
fn where_a_run_was_broken_off_its_part_file_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let part = folder.path().join("run.mcap.part");
    std::fs::write(&part, b"").expect("writing");
    let error = TraceFile::open(&folder.path().join("run.mcap")).expect_err("there is none");
    let advice = format!("`evolvent trace recover {}`", part.display());
    assert!(error.to_string().contains(&advice), "{error}");
    // A recorder's leftovers may be removed; a file that is not a trace may be anything.
    let error = recover(&part, None).expect_err("nothing is in it");
    assert!(
        error.to_string().contains("remove it") && !error.is_wrong_name(),
        "{error}"
    );
    let program = folder.path().join("part.ngc");
    std::fs::write(&program, b"G0 X1").expect("writing");
    let error = recover(&program, None).expect_err("not a trace");
    assert!(
        matches!(error, RecoverError::NotATrace { bytes: 5, .. }),
        "{error}"
    );
    assert!(
        !error.to_string().contains("remove") && error.is_wrong_name(),
        "{error}"
    );
}

/// A read of a pipe without a writer would wait without end.
#[test]
fn a_pipe_is_refused_and_not_waited_for() {
    let pipe = std::env::temp_dir().join(format!("evolvent-trace-pipe-{}", std::process::id()));
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.is_ok_and(|status| status.success()));
    let (sender, receiver) = std::sync::mpsc::channel();
    let path = pipe.clone();
    std::thread::spawn(move || {
        let opened = TraceFile::open(&path).map(drop);
        let recovered = recover(&path, None).map(drop);
        // The receiver may have ended.
        let _ = sender.send((
            opened.map_err(|error| error.to_string()),
            recovered.map_err(|error| error.to_string()),
        ));
    });
    let replied = receiver.recv_timeout(std::time::Duration::from_secs(10));
    std::fs::remove_file(&pipe).expect("the pipe");
    let (opened, recovered) = replied.expect("a reply within 10 s");
    for error in [opened, recovered] {
        let text = error.expect_err("a pipe is no trace");
        assert!(text.contains("a pipe or a device"), "{text}");
    }
}
