//! Flipped bits give an error or a loss that is told, never a panic and never a wrong figure.
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use evolvent_random::{Random, cases};
use std::path::Path;

use crate::common::{PROGRAM, cycles, record};
use evolvent_inspect::{ExportChannel, ExportFormat, Selection, compare, export, write_report};
use evolvent_replay::verify;
use evolvent_runtime::Clock;
use evolvent_trace::{CycleRecord, TraceFile, recover};

fn same(a: &CycleRecord, b: &CycleRecord) -> bool {
    // NaN is not equal to itself; its bits are.
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

/// What a reader gives of a file: the cycles up to an error.
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
fn five_hundred_flipped_bits_never_give_a_wrong_figure() {
    let (mut random, cases) = (Random::seeded(0x00C0_FFEE), cases(500));
    let mut random = move |below: usize| random.below(below);
    // One is recorded in messages, the other in columns.
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
        // Half of the cases hit the summary, which is small but holds everything together.
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
        // The readers built on it: an error or the same, no panic.
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
            // Without the description of the run nothing can be read, and that is told.
            assert!(!failed || !recovered.has_run, "case {case}, byte {at}");
            let lost = kept.len() < truth.len();
            assert!(
                !lost || recovered.lost_data() || failed,
                "case {case}, byte {at}: a loss that is not told"
            );
        }
    }
    println!(
        "{name}: {refused} refused, {partly} read up to the damage, {unharmed} unharmed (header, unused index)"
    );
    assert!(refused + partly > cases / 2);
}
