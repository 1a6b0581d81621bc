//! A full disk: a clear error, a readable file, and nothing that was flushed is lost.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail as tests do"
)]

use std::fs::{self, File};
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use crate::common::{self, Manners, SmallDisk, assert_same, cycle, info};
use evolvent_trace::{FileSink, RecordError, Recorder, Remains, TraceFile, recover};

/// Records until it fails. Returns the number of flushed cycles and the error.
fn fill(recorder: &mut Recorder) -> (u64, RecordError) {
    let mut flushed = 0;
    for n in 0..1_000_000 {
        if let Err(error) = recorder.cycle(&cycle(n, "XYZ")) {
            return (flushed, error);
        }
        if n % 100 == 99 {
            match recorder.flush() {
                Ok(()) => flushed = n + 1,
                Err(error) => return (flushed, error),
            }
        }
    }
    panic!("a small disk holds a million cycles");
}

fn cycles_of(path: &Path) -> u64 {
    let mut trace = TraceFile::open(path).expect("opening");
    let mut count = 0;
    for (n, record) in trace.cycles().enumerate() {
        assert_same(&record.expect("a cycle"), &cycle(n as u64, "XYZ"));
        count += 1;
    }
    count
}

#[test]
fn flushed_data_is_readable_for_any_disk_size() {
    let folder = common::folder();
    let path = folder.path().join("small.mcap");
    for manners in [Manners::Foresees, Manners::Truncates, Manners::Stubborn] {
        for capacity in (60_000..400_000).step_by(7001) {
            let disk = SmallDisk::new(capacity, manners);
            let mut recorder = Recorder::with_sink(Box::new(disk.clone()), &path, &info("XYZ"))
                .unwrap_or_else(|error| panic!("{capacity} bytes are enough for a start: {error}"));
            let (flushed, error) = fill(&mut recorder);
            let RecordError::DiskFull { remains, bytes, .. } = &error else {
                panic!("{error}")
            };
            fs::write(&path, disk.content()).expect("writing");
            if manners == Manners::Foresees {
                assert_eq!(*remains, Remains::Complete, "capacity {capacity}");
            }
            if *remains == Remains::Complete {
                assert_eq!(*bytes, disk.content().len() as u64);
                assert_eq!(cycles_of(&path), flushed, "capacity {capacity}");
                assert!(
                    TraceFile::open(&path)
                        .expect("opening")
                        .info()
                        .recovery
                        .contains_key("failure")
                );
            } else {
                let recovered = recover(&path, Some(&folder.path().join("out.mcap"))).expect("recovering");
                // One chunk more if only its index did not fit.
                let found = cycles_of(&recovered.path);
                assert!(
                    (flushed..=flushed + 100).contains(&found),
                    "capacity {capacity}: {found} of {flushed}"
                );
            }
        }
    }
}

/// A served machine attaches the initial data of its jobs, hundreds of times: their index is larger than the
/// rest of the end.
#[test]
fn a_full_disk_takes_the_index_of_every_attachment() {
    let folder = common::folder();
    let path = folder.path().join("attached.mcap");
    for capacity in (100_000..200_000).step_by(7001) {
        let disk = SmallDisk::new(capacity, Manners::Foresees);
        let mut recorder =
            Recorder::with_sink(Box::new(disk.clone()), &path, &info("XYZ")).expect("creating");
        let name = |n: u32| format!("job-{n}/block-of-mdi-{n}.ngc");
        let text = |n: u32| format!("G1 X{n}\n").into_bytes();
        let mut attached = 0;
        let error = loop {
            match recorder.attach_text(&name(attached), 0, &text(attached)) {
                Ok(()) => attached += 1,
                Err(error) => break error,
            }
        };
        assert!(
            matches!(
                error,
                RecordError::DiskFull {
                    remains: Remains::Complete,
                    ..
                }
            ),
            "capacity {capacity}, {attached} attached: {error}"
        );
        assert!(attached > 200, "{attached}");
        fs::write(&path, disk.content()).expect("writing");
        let mut trace = TraceFile::open(&path).expect("opening");
        for n in 0..attached {
            let found = trace.attachment(&name(n)).expect("readable");
            assert_eq!(found, Some(text(n)), "capacity {capacity}");
        }
    }
}

#[test]
fn what_a_failed_write_left_half_done_is_cut_off() {
    let folder = common::folder();
    let path = folder.path().join("hiccup.mcap");
    let disk = SmallDisk::new(150_000, Manners::Hiccups);
    let mut recorder = Recorder::with_sink(Box::new(disk.clone()), &path, &info("XYZ")).expect("creating");
    let (flushed, error) = fill(&mut recorder);
    assert!(
        matches!(
            error,
            RecordError::Write {
                remains: Remains::Complete,
                ..
            }
        ),
        "{error}"
    );
    fs::write(&path, disk.content()).expect("writing");
    assert!(flushed > 100);
    assert_eq!(cycles_of(&path), flushed);
    // In the order of the file too, without the index.
    let messages = mcap::MessageStream::new(&disk.content())
        .expect("stream")
        .filter(|message| message.as_ref().expect("a whole message").channel.topic == "/cycle")
        .count();
    assert_eq!(messages as u64, flushed);
}

#[test]
fn on_a_stubborn_disk_what_was_flushed_is_recovered() {
    let folder = common::folder();
    let disk = SmallDisk::new(100_000, Manners::Stubborn);
    let mut recorder =
        Recorder::with_sink(Box::new(disk.clone()), Path::new("small.mcap"), &info("XYZ")).expect("creating");
    let (flushed, error) = fill(&mut recorder);
    assert!(
        matches!(
            error,
            RecordError::DiskFull {
                remains: Remains::NeedsRecovery,
                ..
            }
        ),
        "{error}"
    );
    assert!(error.to_string().contains("evolvent trace recover"), "{error}");
    let path = folder.path().join("small.mcap");
    fs::write(&path, disk.content()).expect("writing");
    let recovered = recover(&path, None).expect("recovering");
    assert!(flushed > 100);
    assert_eq!(cycles_of(&recovered.path), flushed);
}

#[test]
fn calls_after_error_repeat_it_and_touch_nothing() {
    let disk = SmallDisk::new(80_000, Manners::Foresees);
    let mut recorder =
        Recorder::with_sink(Box::new(disk.clone()), Path::new("small.mcap"), &info("XYZ")).expect("creating");
    let (_, error) = fill(&mut recorder);
    let before = disk.content();
    let failures = *disk.failures.lock().expect("lock");
    for n in 0..100_000 {
        let again = recorder.cycle(&cycle(n, "XYZ")).expect_err("still full");
        if n == 0 {
            assert_eq!(again.to_string(), error.to_string());
        }
    }
    assert!(recorder.flush().is_err() && recorder.pose(0, [0.0; 3]).is_err());
    assert!(recorder.finish(&Default::default()).is_err());
    assert_eq!(disk.content(), before);
    assert_eq!(*disk.failures.lock().expect("lock"), failures);
}

/// The device that is always full: the real error of the real system call.
#[test]
#[cfg(target_os = "linux")]
fn the_full_device_is_named_as_full() {
    let device = File::options().write(true).open("/dev/full").expect("/dev/full");
    let sink = FileSink::new(device).expect("sink");
    let error = Recorder::with_sink(Box::new(sink), Path::new("/dev/full"), &info("XYZ")).expect_err("full");
    assert!(matches!(error, RecordError::DiskFull { .. }), "{error}");
}

/// A real full file system, if the user may mount one.
#[test]
#[cfg(target_os = "linux")]
fn full_file_system_leaves_file_with_flushed_data() {
    use std::process::Command;
    let folder = common::folder();
    let mount = folder.path().join("small");
    fs::create_dir(&mount).expect("folder");
    let mounted = Command::new("mount")
        .args(["-t", "tmpfs", "-o", "size=512k", "tmpfs"])
        .arg(&mount)
        .output()
        .is_ok_and(|output| output.status.success());
    if !mounted {
        println!("skipped: mounting needs root");
        return;
    }
    let path = mount.join("run.mcap");
    let outcome = std::panic::catch_unwind(|| {
        let mut recorder = Recorder::create(&path, &info("XYZ")).expect("creating");
        let (flushed, error) = fill(&mut recorder);
        drop(recorder);
        let RecordError::DiskFull {
            path: at, remains, ..
        } = error
        else {
            panic!("{error}")
        };
        // The allocated space was enough for the index.
        assert_eq!((remains, &at), (Remains::Complete, &path));
        println!("{remains:?}, {flushed} cycles");
        (cycles_of(&path), flushed)
    });
    // A child that another test starts at this moment has every file open until it becomes its program.
    let deadline = Instant::now() + Duration::from_secs(30);
    let mut unmounted = false;
    while !unmounted && Instant::now() < deadline {
        std::thread::sleep(Duration::from_millis(20));
        unmounted = Command::new("umount")
            .arg(&mount)
            .stderr(Stdio::null())
            .status()
            .is_ok_and(|status| status.success());
    }
    let (found, flushed) = outcome.expect("the run on a small disk");
    assert!(flushed > 0 && unmounted);
    assert_eq!(found, flushed);
}
