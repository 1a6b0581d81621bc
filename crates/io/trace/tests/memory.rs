//! The memory of a recorder does not grow with its trace: a served machine records for weeks.

#![allow(clippy::expect_used, reason = "tests fail as tests do")]

use evolvent_counting::live_bytes;
use evolvent_trace::{Recorder, TraceFile};

use crate::common::{self, cycle, info};

/// Records `chunks` chunks of 20 cycles. Returns the largest memory of this thread after any of them.
fn record_chunks(recorder: &mut Recorder, from: u64, chunks: u64) -> i64 {
    let mut largest = 0;
    for chunk in from..from + chunks {
        for n in chunk * 20..(chunk + 1) * 20 {
            recorder.cycle(&cycle(n, "XYZ")).expect("cycle");
        }
        recorder.flush().expect("flush");
        if chunk % 100 == 0 {
            let name = format!("job-{chunk}.ngc");
            recorder.attach_text(&name, 0, b"G0 X0\n").expect("attachment");
        }
        largest = largest.max(live_bytes());
    }
    largest
}

#[test]
fn memory_of_a_recorder_does_not_grow_with_its_trace() {
    let folder = common::folder();
    let path = folder.path().join("long.mcap");
    let before = live_bytes();
    let mut recorder = Recorder::create(&path, &info("XYZ")).expect("creating");
    let early = record_chunks(&mut recorder, 0, 1000) - before;
    let late = record_chunks(&mut recorder, 1000, 9000) - before;
    println!("largest of the first 1000 chunks {early} bytes, of 9000 more {late}");
    // An index of each chunk in memory would take more than 2 MB more.
    assert!(late < early + 16 * 1024, "{early} bytes, later {late}");
    recorder.finish(&Default::default()).expect("finishing");
    let trace = TraceFile::open(&path).expect("opening");
    assert!(trace.info().chunks >= 10_000, "{}", trace.info().chunks);
}
