//! Recorded data are read back by this crate's reader and by the reference implementation.

#![allow(
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "helpers of tests fail as tests do"
)]

use std::collections::BTreeMap;
use std::fs;

use crate::common::{self, PROGRAM, assert_same, block, cycle, event, info, record};
use evolvent_trace::{
    CycleRecord, EventKind, EventRecord, ProgramSource, ReadError, RecordError, Recorder, TraceFile,
    TraceMessage, part_path,
};

#[test]
fn every_cycle_comes_back_bit_for_bit() {
    common::in_both_layouts(check_every_cycle);
}

fn check_every_cycle() {
    let folder = common::folder();
    for axes in ["XYZ", "X", "ZX", "XYZABCUVW"] {
        let path = folder.path().join(format!("{axes}.mcap"));
        record(&path, 5000, axes, 250);
        let mut trace = TraceFile::open(&path).expect("opening");
        let mut count = 0;
        for (n, found) in trace.cycles().enumerate() {
            assert_same(&found.expect("a cycle"), &cycle(n as u64, axes));
            count += 1;
        }
        assert_eq!(count, 5000);
        let events: Result<Vec<_>, _> = trace.events().collect();
        assert_eq!(
            events.expect("events"),
            (1..50).map(|n| event(n * 100)).collect::<Vec<_>>()
        );
        let blocks: Result<Vec<_>, _> = trace.blocks().collect();
        assert_eq!(
            blocks.expect("blocks"),
            (1..50).map(|n| block(n * 100)).collect::<Vec<_>>()
        );
    }
}

#[test]
fn reference_implementation_reads_same_with_checksums() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    record(&path, 12_000, "XYZ", 5000);
    let bytes = fs::read(&path).expect("reading");
    // In the order of the file: every chunk's checksum is verified.
    let mut cycles = 0;
    for message in mcap::MessageStream::new(&bytes).expect("stream") {
        let message = message.expect("message");
        let schema = message.channel.schema.as_ref().expect("schema");
        assert_eq!(
            (
                schema.encoding.as_str(),
                message.channel.message_encoding.as_str()
            ),
            ("protobuf", "protobuf")
        );
        if message.channel.topic == "/cycle" {
            assert_eq!(u64::from(message.sequence), cycles);
            assert_eq!(message.log_time, cycle(cycles, "XYZ").due_time_ns);
            cycles += 1;
        }
    }
    assert_eq!(cycles, 12_000);
    // By index.
    let summary = mcap::Summary::read(&bytes).expect("summary").expect("a summary");
    let statistics = summary.stats.as_ref().expect("statistics");
    let by_topic = |topic: &str| {
        let channel = summary
            .channels
            .values()
            .find(|channel| channel.topic == topic)
            .expect("channel");
        statistics
            .channel_message_counts
            .get(&channel.id)
            .copied()
            .unwrap_or(0)
    };
    assert_eq!(
        (by_topic("/cycle"), by_topic("/event"), by_topic("/block")),
        (12_000, 119, 119)
    );
    assert_eq!(by_topic("/timing"), 12, "1000 cycles of 1.000003 ms to each");
    assert_eq!(statistics.chunk_count as usize, summary.chunk_indexes.len());
    let mut through_index = 0;
    for chunk in &summary.chunk_indexes {
        let indexes = summary
            .read_message_indexes(&bytes, chunk)
            .expect("message index");
        for (channel, entries) in indexes {
            for entry in entries {
                let message = summary
                    .seek_message(&bytes, chunk, &entry)
                    .expect("message by index");
                assert_eq!(
                    (message.channel.id, message.log_time),
                    (channel.id, entry.log_time)
                );
                through_index += 1;
            }
        }
        if through_index > 6000 {
            break;
        }
    }
    assert!(through_index > 6000);
    for index in &summary.attachment_indexes {
        mcap::read::attachment(&bytes, index).expect("attachment and its checksum");
    }
    for index in &summary.metadata_indexes {
        mcap::read::metadata(&bytes, index).expect("metadata");
    }
}

#[test]
fn info_knows_the_run_from_the_summary_alone() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    record(&path, 3000, "XYZ", 250);
    assert!(!part_path(&path).exists());
    let mut trace = TraceFile::open(&path).expect("opening");
    let found = trace.info().clone();
    let mut wanted = info("XYZ");
    (wanted.program, wanted.machine_file, wanted.tool_table) = (ProgramSource::None, String::new(), None);
    assert_eq!(found.run, Some(wanted));
    assert_eq!((found.messages("/cycle"), found.messages("/event")), (3000, 29));
    assert_eq!(found.start_time_ns, common::START_NS);
    assert_eq!(found.end_time_ns, cycle(2999, "X").due_time_ns);
    let alarms = (100..3000)
        .step_by(100)
        .filter(|&n| event(n).kind == EventKind::Alarm)
        .count();
    assert!(alarms > 0, "the fixture records every kind of event");
    // Cycles 0, 97, 194 ... are late.
    for (key, value) in [
        ("cycles", 3000.0),
        ("gaps", 0.0),
        ("late_cycles", 31.0),
        ("alarms", alarms as f64),
        ("wake_lateness_max_ns", 44_000.0),
        ("wake_lateness_min_ns", -5000.0),
        ("work_max_ns", 600.0),
        ("path_length_mm", 12.5),
    ] {
        assert_eq!(found.summary_number(key), Some(value), "{key}");
    }
    let names: Vec<_> = found.attachments.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["test-mill.toml", "tools.tbl", "part.ngc"]);
    assert_eq!(
        trace.attachment("part.ngc").expect("attachment").expect("there"),
        PROGRAM
    );
    assert!(trace.attachment("other").expect("no error").is_none());
}

#[test]
fn gaps_in_the_numbers_are_told() {
    common::in_both_layouts(check_gaps);
}

fn check_gaps() {
    let folder = common::folder();
    let path = folder.path().join("gaps.mcap");
    let mut recorder = Recorder::create(&path, &info("XYZ")).expect("creating");
    for n in (0..100).chain(150..200).chain(201..300) {
        recorder.cycle(&cycle(n, "XYZ")).expect("cycle");
    }
    recorder.finish(&BTreeMap::new()).expect("finishing");
    let trace = TraceFile::open(&path).expect("opening");
    assert_eq!(trace.info().summary_number("gaps"), Some(2.0));
    assert_eq!(trace.info().summary_number("missing_cycles"), Some(51.0));
}

#[test]
fn program_larger_than_piece_is_attached_from_file() {
    let folder = common::folder();
    let program: Vec<u8> = (0..900_001_u32)
        .map(|n| b"G1X0 \n"[n as usize % 6].wrapping_add((n / 6 % 3) as u8))
        .collect();
    let program_path = folder.path().join("big.ngc");
    fs::write(&program_path, &program).expect("writing");
    let path = folder.path().join("run.mcap");
    let mut run = info("XYZ");
    run.program = ProgramSource::File(program_path);
    Recorder::create(&path, &run)
        .expect("creating")
        .finish(&BTreeMap::new())
        .expect("finishing");
    let mut trace = TraceFile::open(&path).expect("opening");
    assert!(trace.attachment("part.ngc").expect("attachment") == Some(program));
    // A run without cycles is valid.
    assert_eq!(trace.info().messages("/cycle"), 0);
    assert_eq!(trace.cycles().count(), 0);
}

#[test]
fn missing_program_or_invalid_description_is_named() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    let mut run = info("XYZ");
    run.program = ProgramSource::File(folder.path().join("none.ngc"));
    assert!(matches!(
        Recorder::create(&path, &run),
        Err(RecordError::Attach { .. })
    ));
    fs::remove_file(part_path(&path)).ok();
    for (axes, period_ns) in [("", 1000), ("XX", 1000), ("XYZ", 0)] {
        let mut run = info(axes);
        run.period_ns = period_ns;
        assert!(
            matches!(Recorder::create(&path, &run), Err(RecordError::Invalid { .. })),
            "{axes} {period_ns}"
        );
        assert!(!part_path(&path).exists(), "no file for what is refused");
    }
}

#[test]
fn a_left_over_part_file_is_not_overwritten() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    drop(Recorder::create(&path, &info("XYZ")).expect("creating"));
    let before = fs::read(part_path(&path)).expect("part file");
    assert!(matches!(
        Recorder::create(&path, &info("XYZ")),
        Err(RecordError::LeftOver { .. })
    ));
    assert_eq!(fs::read(part_path(&path)).expect("part file"), before);
}

/// It would leave a hidden file in the folder that cannot be renamed at the end.
#[test]
fn a_folder_is_refused_as_the_name_of_a_trace() {
    let folder = common::folder();
    for name in [folder.path().to_owned(), folder.path().join("none/")] {
        let refused = Recorder::create(&name, &info("XYZ")).expect_err("a folder");
        assert!(matches!(refused, RecordError::Folder { .. }), "{refused}");
        assert!(refused.to_string().contains("session.mcap"), "{refused}");
    }
    assert_eq!(fs::read_dir(folder.path()).expect("the folder").count(), 0);
}

#[test]
fn nan_and_long_texts_are_recorded_without_harm() {
    common::in_both_layouts(check_odd_values);
}

fn check_odd_values() {
    let folder = common::folder();
    let path = folder.path().join("odd.mcap");
    let mut recorder = Recorder::create(&path, &info("XYZ")).expect("creating");
    let odd = CycleRecord {
        sequence: u64::MAX,
        due_time_ns: u64::MAX,
        wake_lateness_ns: i64::MIN,
        work_ns: u32::MAX,
        path_mm: f64::NAN,
        position: [
            f64::INFINITY,
            -0.0,
            f64::MIN_POSITIVE,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
        ],
        override_: f64::NEG_INFINITY,
        state: 255,
        ..CycleRecord::default()
    };
    for _ in 0..3 {
        recorder.cycle(&odd).expect("cycle");
        recorder.cycle(&cycle(0, "XYZ")).expect("cycle");
    }
    let text = "\u{b5}".repeat(1_000_000);
    let kind = EventKind::Message;
    let endless = EventRecord {
        time_ns: 1,
        sequence: 0,
        kind,
        code: 0,
        text: text.clone(),
        value: None,
    };
    recorder.event(&endless).expect("event");
    recorder.finish(&BTreeMap::new()).expect("finishing");
    let mut trace = TraceFile::open(&path).expect("opening");
    let mut cycles = 0;
    let mut texts = 0;
    for message in trace.messages() {
        match message.expect("message") {
            TraceMessage::Cycle(found) => {
                assert_same(&found, &if cycles % 2 == 0 { odd } else { cycle(0, "XYZ") });
                cycles += 1;
            }
            TraceMessage::Event(found) => {
                assert!(text.starts_with(&found.text) && found.text.len() >= 60_000);
                texts += 1;
            }
            _ => {}
        }
    }
    assert_eq!((cycles, texts), (6, 1));
}

#[test]
fn what_is_no_finished_trace_is_told_apart() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    record(&path, 100, "XYZ", 50);
    let bytes = fs::read(&path).expect("reading");
    let other = folder.path().join("other");
    assert!(matches!(TraceFile::open(&other), Err(ReadError::Io { .. })));
    for (content, unfinished) in [
        (&b""[..], false),
        (b"G0 X0", false),
        (&bytes[..8], true),
        (&bytes[..bytes.len() - 1], true),
        (&bytes[..bytes.len() / 2], true),
    ] {
        fs::write(&other, content).expect("writing");
        match TraceFile::open(&other) {
            Err(ReadError::Unfinished { is_being_written, .. }) => assert!(unfinished && !is_being_written),
            Err(ReadError::NotATrace { .. }) => assert!(!unfinished),
            result => panic!("{} bytes: {result:?}", content.len()),
        }
    }
}

#[test]
fn trace_being_written_is_distinguished_from_torn_one() {
    let folder = common::folder();
    let path = folder.path().join("run.mcap");
    let recorder = Recorder::create(&path, &info("X")).expect("a recorder");
    let part = part_path(&path);
    let refusal = || TraceFile::open(&part).expect_err("no end").to_string();
    assert!(refusal().contains("still being written"), "{}", refusal());
    drop(recorder);
    assert!(refusal().contains("has no end"), "{}", refusal());
}

/// The summary's data about chunks and attachments are stored on disk in pieces of 8 KiB: here several of
/// each.
#[test]
fn summary_on_disk_lists_all_chunks_and_attachments() {
    let folder = common::folder();
    let path = folder.path().join("long.mcap");
    let (chunks, texts) = (1200, 300);
    let mut recorder = Recorder::create(&path, &info("XYZ")).expect("a recorder");
    for n in 0..chunks {
        recorder.cycle(&cycle(n, "XYZ")).expect("a cycle");
        if n % 4 == 3 {
            // Closes the chunk, as a flush does.
            let name = format!("job-{n}/parameters.var");
            recorder
                .attach_text(&name, cycle(n, "XYZ").due_time_ns, name.as_bytes())
                .expect("an attachment");
        } else {
            recorder.flush().expect("a flush");
        }
    }
    let path = recorder.finish(&BTreeMap::new()).expect("a trace");
    let bytes = fs::read(&path).expect("reading");
    let summary = mcap::Summary::read(&bytes).expect("summary").expect("a summary");
    let attached: Vec<_> = (summary.attachment_indexes.iter())
        .filter(|index| index.name.starts_with("job-"))
        .collect();
    assert_eq!(attached.len(), texts);
    for index in attached {
        let attachment = mcap::read::attachment(&bytes, index).expect("an attachment");
        assert_eq!(attachment.data.as_ref(), index.name.as_bytes());
    }
    let mut found = 0;
    for index in &summary.chunk_indexes {
        for message in summary.stream_chunk(&bytes, index).expect("a chunk") {
            let message = message.expect("a message");
            if message.channel.topic == "/cycle" {
                assert_eq!(u64::from(message.sequence), found);
                found += 1;
            }
        }
    }
    assert_eq!(found, chunks);
}
