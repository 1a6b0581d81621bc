//! Torn and damaged files: all complete data are recovered, and losses are reported.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail as tests do"
)]

use std::fs;
use std::path::Path;

use evolvent_random::Random;

use crate::common::{self, assert_same, cycle, info, record, record_into};
use evolvent_trace::{Recorder, RecoverError, Recovered, TraceFile, part_path, recover, recover_leftovers};

const AXES: &str = "XYZ";

/// The ends of all chunk records of a file, with the number of cycles up to there: computed from the
/// reference implementation's view of the file.
fn chunk_ends(bytes: &[u8]) -> Vec<(u64, u64)> {
    let summary = mcap::Summary::read(bytes).expect("summary").expect("a summary");
    let channel = summary
        .channels
        .values()
        .find(|channel| channel.topic == "/cycle")
        .expect("channel")
        .id;
    let mut cycles = 0;
    summary
        .chunk_indexes
        .iter()
        .map(|chunk| {
            let indexes = summary.read_message_indexes(bytes, chunk).expect("message index");
            cycles += indexes
                .iter()
                .filter(|(c, _)| c.id == channel)
                .map(|(_, list)| list.len() as u64)
                .sum::<u64>();
            (chunk.chunk_start_offset + chunk.chunk_length, cycles)
        })
        .collect()
}

/// The recovered file is complete, by both readers, and its cycles are those of the run: `Some(n)` exactly
/// 0..n.
fn check(recovered: &Recovered, wanted: Option<u64>) -> u64 {
    let mut trace = TraceFile::open(&recovered.path).expect("the recovered file opens");
    let reported = trace.info().messages("/cycle");
    let mut found = 0;
    let mut last = None;
    for record in trace.cycles() {
        let record = record.expect("a cycle");
        // Never a wrong value: each cycle equals the one recorded under its number.
        assert_same(&record, &cycle(record.sequence, AXES));
        assert!(last.is_none_or(|last| record.sequence > last));
        last = Some(record.sequence);
        found += 1;
    }
    assert_eq!(
        (found, last),
        (recovered.statistics.cycles, recovered.statistics.last_sequence)
    );
    assert_eq!(found, reported);
    if let Some(wanted) = wanted {
        assert_eq!(found, wanted);
        assert_eq!(recovered.statistics.gaps, 0);
    }
    found
}

fn recover_bytes(folder: &Path, bytes: &[u8]) -> Result<Recovered, RecoverError> {
    let torn = folder.join("torn.mcap");
    fs::write(&torn, bytes).expect("writing");
    recover(&torn, Some(&folder.join("out.mcap")))
}

#[test]
fn complete_chunks_before_any_cut_are_recovered() {
    common::in_both_layouts(check_cuts);
}

fn check_cuts() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    record(&path, 6000, AXES, 250);
    let bytes = fs::read(&path).expect("reading");
    let ends = chunk_ends(&bytes);
    assert!(ends.len() > 20, "{} chunks", ends.len());
    let seed = 0x5eed_0001_u64;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let mut cuts: Vec<u64> = (0..500).map(|_| random.below(bytes.len()) as u64).collect();
    // The critical positions: near the ends of chunks and of the file.
    cuts.extend(ends.iter().take(5).flat_map(|&(end, _)| [end - 1, end, end + 1]));
    cuts.extend([0, 1, 7, 8, 9, 16, 17, 18, bytes.len() as u64 - 1]);
    for cut in cuts {
        let result = recover_bytes(folder.path(), &bytes[..cut as usize]);
        if cut < 8 {
            assert!(
                matches!(result, Err(RecoverError::NotATrace { .. })),
                "cut at {cut}"
            );
            continue;
        }
        let recovered = result.unwrap_or_else(|error| panic!("cut at {cut}: {error}"));
        let wanted = ends
            .iter()
            .take_while(|&&(end, _)| end <= cut)
            .last()
            .map_or(0, |&(_, cycles)| cycles);
        check(&recovered, Some(wanted));
        assert_eq!(recovered.damaged_places, 0, "cut at {cut}");
        assert!(
            recovered.bytes_dropped < 512 * 1024 && !recovered.was_complete,
            "cut at {cut}"
        );
    }
}

#[test]
fn flipped_bits_give_error_or_loss_never_wrong_data() {
    common::in_both_layouts(check_flipped_bits);
}

fn check_flipped_bits() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    record(&path, 3000, AXES, 250);
    let good = fs::read(&path).expect("reading");
    let damaged_path = folder.path().join("damaged.mcap");
    let seed = 0x5eed_0002_u64;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let (mut errors, mut losses, mut harmless) = (0, 0, 0);
    for round in 0..500 {
        let mut bytes = good.clone();
        // Every fourth flip in the first part, where the descriptions are.
        let range = if round % 4 == 0 { 8000 } else { good.len() as u64 };
        for _ in 0..1 + round % 3 {
            let at = random.below(range as usize);
            bytes[at] ^= 1 << random.below(8);
        }
        // The reader: an error, or correct data.
        fs::write(&damaged_path, &bytes).expect("writing");
        if let Ok(mut trace) = TraceFile::open(&damaged_path) {
            for record in trace.cycles() {
                let Ok(record) = record else { break };
                assert_same(&record, &cycle(record.sequence, AXES));
            }
            if let Some(run) = &trace.info().run {
                assert_eq!(run.period_ns, common::PERIOD_NS);
            }
            if let Ok(Some(program)) = trace.attachment("part.ngc") {
                assert_eq!(program, common::PROGRAM);
            }
        }
        // The recovery: an error, a stated loss, or everything.
        match recover_bytes(folder.path(), &bytes) {
            Err(_) => errors += 1,
            Ok(recovered) if !recovered.has_run => {
                assert!(recovered.lost_data());
                losses += 1;
            }
            Ok(recovered) => {
                let found = check(&recovered, None);
                if found < 3000 {
                    assert!(
                        recovered.lost_data(),
                        "round {round}: {found} cycles and no loss reported"
                    );
                    losses += 1;
                } else {
                    harmless += 1;
                }
            }
        }
    }
    println!("{errors} errors, {losses} losses, {harmless} without loss of cycles");
    assert!(
        losses > 200 && harmless > 5,
        "{errors} errors, {losses} losses, {harmless} harmless"
    );
}

#[test]
fn a_damaged_chunk_costs_no_other() {
    common::in_both_layouts(check_damaged_chunk);
}

fn check_damaged_chunk() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    record(&path, 5000, AXES, 250);
    let mut bytes = fs::read(&path).expect("reading");
    let ends = chunk_ends(&bytes);
    // A byte within the tenth chunk, and the length of the fifteenth.
    bytes[ends[10].0 as usize - 100] ^= 0x10;
    let summary = mcap::Summary::read(&bytes).expect("summary").expect("a summary");
    bytes[summary.chunk_indexes[15].chunk_start_offset as usize + 4] ^= 0x40;
    let recovered = recover_bytes(folder.path(), &bytes).expect("recovering");
    check(&recovered, None);
    assert_eq!(
        (recovered.statistics.cycles, recovered.statistics.gaps),
        (5000 - 500, 2)
    );
    assert_eq!(
        (recovered.statistics.missing_cycles, recovered.damaged_places),
        (500, 2)
    );
    assert!(recovered.lost_data() && recovered.has_run);
}

#[test]
fn file_without_first_chunk_opens_everywhere() {
    common::in_both_layouts(check_missing_chunk);
}

fn check_missing_chunk() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    record(&path, 1000, AXES, 250);
    let mut bytes = fs::read(&path).expect("reading");
    let first = chunk_ends(&bytes)[0].0 as usize;
    bytes[first - 10] ^= 1;
    let recovered = recover_bytes(folder.path(), &bytes).expect("recovering");
    check(&recovered, Some(1000));
    let bytes = fs::read(&recovered.path).expect("reading");
    let cycles = mcap::MessageStream::new(&bytes)
        .expect("stream")
        .filter(|message| message.as_ref().expect("message").channel.topic == "/cycle")
        .count();
    assert_eq!(cycles, 1000);
}

#[test]
fn recovering_a_whole_file_loses_nothing() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    record(&path, 2000, AXES, 250);
    let recovered = recover(&path, None).expect("recovering");
    assert_eq!(recovered.path, folder.path().join("run.recovered.mcap"));
    assert!(recovered.was_complete && !recovered.lost_data());
    check(&recovered, Some(2000));
    let before = TraceFile::open(&path).expect("opening").info().clone();
    let after = TraceFile::open(&recovered.path).expect("opening").info().clone();
    assert_eq!((before.run, before.channels), (after.run, after.channels));
    assert_eq!(
        (before.summary, before.attachments),
        (after.summary, after.attachments)
    );
    let again = recover(&path, None).expect("recovering");
    assert_eq!(again.path, folder.path().join("run.recovered-2.mcap"));
}

#[test]
fn leftovers_are_recovered_except_of_running_recorder() {
    common::in_both_layouts(check_leftovers);
}

fn check_leftovers() {
    let folder = common::folder();
    let killed = folder.path().join("killed.mcap");
    let mut recorder = Recorder::create(&killed, &info(AXES)).expect("creating");
    record_into(&mut recorder, 1000, AXES, 250);
    // As after SIGKILL: cycles 1000 to 1099 are in memory only.
    for n in 1000..1100 {
        recorder.cycle(&cycle(n, AXES)).expect("cycle");
    }
    let as_killed = fs::read(part_path(&killed)).expect("part file");
    let running = folder.path().join("running.mcap");
    let mut alive = Recorder::create(&running, &info(AXES)).expect("creating");
    alive.cycle(&cycle(0, AXES)).expect("cycle");
    drop(recorder);
    fs::write(part_path(&killed), as_killed).expect("writing");

    let results = recover_leftovers(folder.path()).expect("reading the folder");
    assert_eq!(results.len(), 1, "{results:?}");
    let (part, result) = &results[0];
    assert_eq!(*part, part_path(&killed));
    let recovered = result.as_ref().expect("recovering");
    assert_eq!(recovered.path, killed);
    check(recovered, Some(1000));
    assert!(!part.exists() && part_path(&running).exists());
    assert!(matches!(
        recover(&part_path(&running), None),
        Err(RecoverError::InUse { .. })
    ));
    alive
        .finish(&Default::default())
        .expect("the running one is unharmed");
    assert!(
        recover_leftovers(folder.path())
            .expect("reading the folder")
            .is_empty()
    );
    assert!(
        recover_leftovers(&folder.path().join("none"))
            .expect("no folder is no error")
            .is_empty()
    );
}

#[test]
fn dropped_recorder_leaves_all_in_its_part_file() {
    common::in_both_layouts(check_dropped_recorder);
}

fn check_dropped_recorder() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    let mut recorder = Recorder::create(&path, &info(AXES)).expect("creating");
    for n in 0..700 {
        recorder.cycle(&cycle(n, AXES)).expect("cycle");
    }
    drop(recorder);
    check(&recover(&part_path(&path), None).expect("recovering"), Some(700));
}
