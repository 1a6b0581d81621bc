//! Flipped bits give an error or a reported loss, never a panic and never a wrong figure.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use evolvent_random::{Random, cases};
use std::path::Path;

use crate::common::{PROGRAM, cycles, long_program, record};
use evolvent_inspect::{ExportChannel, ExportFormat, Selection, compare, export, write_report};
use evolvent_replay::verify;
use evolvent_runtime::Clock;
use evolvent_trace::{CycleRecord, TraceFile, recover};

fn same(a: &CycleRecord, b: &CycleRecord) -> bool {
    // NaN is not equal to itself, but its bits are.
    let plain = |record: &CycleRecord| CycleRecord {
        load: 0.0,
        following_error: [0.0; 9],
        drive_position: [0.0; 9],
        ..*record
    };
    let odd = |record: &CycleRecord| {
        (
            record.load.to_bits(),
            record.following_error.map(f64::to_bits),
            record.drive_position.map(f64::to_bits),
        )
    };
    plain(a) == plain(b) && odd(a) == odd(b)
}

/// The cycles that a reader returns up to an error.
fn read(path: &Path) -> (Vec<CycleRecord>, bool) {
    let Ok(mut file) = TraceFile::open(path) else {
        return (Vec::new(), true);
    };
    let mut found = Vec::new();
    for cycle in file.cycles() {
        match cycle {
            Ok(cycle) => found.push(cycle),
            Err(_) => return (found, true),
        }
    }
    (found, false)
}

#[test]
fn flipped_bits_never_give_a_wrong_figure() {
    let (mut random, cases) = (Random::seeded(0x00C0_FFEE), cases(500));
    let mut random = move |below: usize| random.below(below);
    // One trace is recorded as messages, the other in columns.
    for name in ["run", "runs"] {
        flip(name, cases, &mut random);
    }
}

fn flip(name: &str, cases: usize, random: &mut impl FnMut(usize) -> usize) {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), name, PROGRAM, Clock::Virtual, 1.0, |_| {});
    let truth = cycles(&trace);
    let info = TraceFile::open(&trace).expect("a trace").info().clone();
    let bytes = std::fs::read(&trace).expect("its bytes");
    let [damaged, saved, table, page] =
        ["damaged.mcap", "saved.mcap", "t.csv", "p.html"].map(|name| folder.path().join(name));
    let (mut refused, mut unharmed, mut partly) = (0, 0, 0);
    for case in 0..cases {
        let mut copy = bytes.clone();
        // Half of the cases hit the summary, which is small but essential.
        let from = if case % 2 == 0 {
            0
        } else {
            bytes.len() - bytes.len().min(4000)
        };
        let at = from + random(bytes.len() - from);
        copy[at] ^= 1 << random(8);
        std::fs::write(&damaged, &copy).expect("room");
        let (found, failed) = read(&damaged);
        let is_prefix = found
            .iter()
            .zip(&truth)
            .all(|(found, wanted)| same(found, wanted));
        assert!(is_prefix, "case {case}, byte {at}: a wrong figure");
        assert!(
            failed || found.len() == truth.len(),
            "case {case}, byte {at}: a loss that is not told"
        );
        match (failed, found.is_empty()) {
            (true, true) => refused += 1,
            (true, false) => partly += 1,
            (false, _) => unharmed += 1,
        }
        if let Ok(file) = TraceFile::open(&damaged) {
            assert_eq!(file.info().summary, info.summary, "case {case}, byte {at}");
            assert_eq!(file.info().run, info.run, "case {case}, byte {at}");
        }
        // Readers built on it return an error or the same result, without a panic.
        if case % 10 == 0 {
            let all = Selection::default();
            if let Ok(mut file) = TraceFile::open(&damaged) {
                let done = export(&mut file, ExportChannel::Cycles, &all, ExportFormat::Csv, &table);
                assert!(
                    done.is_err() || !failed,
                    "case {case}: a table of a damaged trace without a word"
                );
            }
            let done = write_report(&damaged, &page);
            assert!(
                done.is_err() || !failed,
                "case {case}: a page of a damaged trace without a word"
            );
            let _ = compare(&trace, &damaged);
            let again = verify(&damaged);
            assert!(
                again.is_err() || !failed,
                "case {case}: a damaged trace comes out the same without a word"
            );
        }
        if failed && let Ok(recovered) = recover(&damaged, Some(&saved)) {
            let (kept, failed) = read(&saved);
            let mut rest = truth.iter();
            let in_order = kept.iter().all(|kept| rest.any(|wanted| same(kept, wanted)));
            assert!(in_order, "case {case}, byte {at}: recovery made something up");
            // Without the description of the run nothing can be read, which is reported.
            assert!(!failed || !recovered.has_run, "case {case}, byte {at}");
            let lost = kept.len() < truth.len();
            assert!(
                !lost || recovered.lost_data() || failed,
                "case {case}, byte {at}: a loss that is not told"
            );
        }
    }
    println!(
        "{name}: {refused} refused, {partly} read up to the damage, {unharmed} unharmed (header, unused \
         index)"
    );
    assert!(refused + partly > cases / 2);
}

/// Missing cycles after the last one are not motion. They used to be reported as a chord error of four times
/// the permitted one.
#[test]
fn a_trace_cut_off_in_motion_keeps_its_cycles() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(
        folder.path(),
        "cut",
        &long_program(4),
        Clock::Virtual,
        1.0,
        |_| {},
    );
    let bytes = std::fs::read(&trace).expect("its bytes");
    let [torn, saved] = ["torn.mcap", "saved.mcap"].map(|name| folder.path().join(name));
    let mut in_motion = 0;
    for part in 5..20 {
        std::fs::write(&torn, &bytes[..bytes.len() / 20 * part]).expect("a file");
        if recover(&torn, Some(&saved)).is_err() {
            continue;
        }
        let last = cycles(&saved).last().map(|cycle| cycle.velocity);
        in_motion += u32::from(last.is_some_and(|velocity| velocity != [0.0; 9]));
        let Ok(verified) = verify(&saved) else { continue };
        assert!(
            verified.violations.is_empty(),
            "{part}: {:?}",
            verified.violations
        );
    }
    assert!(in_motion > 4, "{in_motion} of 15 end in motion");
}

#[test]
fn verify_finds_a_change_of_any_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let bytes = std::fs::read(&trace).expect("its bytes");
    let damaged = folder.path().join("damaged.mcap");
    let mut random = Random::seeded(0x0DD_B175);
    // One byte of each hundred, and all of the first ones, few of which have a checksum.
    let sampled = (1..bytes.len() / 100).map(|hundred| 100 * hundred + random.below(100));
    let at: Vec<usize> = (0..100).chain(sampled).collect();
    for at in at {
        let mut copy = bytes.clone();
        copy[at] ^= 1 << (at % 8);
        std::fs::write(&damaged, &copy).expect("room");
        let whole = TraceFile::open(&damaged).and_then(|mut trace| trace.check_whole());
        assert!(whole.is_err(), "byte {at} of {}", bytes.len());
    }
    // The command detects it too, here in the index of a chunk, which it does not need.
    let index = (8..bytes.len() - 9)
        .find(|&at| bytes[at] == 7 && bytes[at + 1..at + 9] == 22_u64.to_le_bytes())
        .expect("an index of one message");
    let mut copy = bytes;
    copy[index + 20] ^= 4;
    std::fs::write(&damaged, &copy).expect("room");
    assert!(verify(&damaged).is_err());
}
