//! A recording of the wire, read by tshark if it is installed.
//!
//! Needs the right to create a network namespace.

use std::process::Command;

use evolvent_disturbance::unless_disturbed;
use evolvent_ethercat::{DumpSettings, MIN_DUMP_BYTES};
use evolvent_ethercat_ring::on_bench;

use crate::support::*;

#[test]
fn tshark_reads_what_went_over_the_wire() {
    unless_disturbed(|| {
        on_bench(devices(), |ring| {
            let folder = tempfile::tempdir().expect("a folder");
            let path = folder.path().join("wire.pcapng");
            let report = with_settings(
                |settings| {
                    settings.dump = Some(DumpSettings {
                        path: path.clone(),
                        max_bytes: 32 * MIN_DUMP_BYTES,
                    });
                },
                ring,
                |core, _, _| {
                    core.bring_up();
                    for _ in 0..200 {
                        core.cycle();
                    }
                },
            );
            assert!(
                report.recorded_frames > 2 * report.cycles,
                "both ways, and the start: {report:?}"
            );
            assert_eq!(report.unrecorded_frames, 0, "{report:?}");
            let fields = [
                "frame.time_epoch",
                "frame.packet_flags_direction",
                "ecat.cmd",
                "eth.src",
            ];
            let mut tshark = Command::new("tshark");
            tshark.arg("-r").arg(&path).args(["-T", "fields"]);
            for field in fields {
                tshark.args(["-e", field]);
            }
            let Ok(output) = tshark.output() else {
                println!("not measured: tshark is not installed");
                return;
            };
            let stdout = String::from_utf8_lossy(&output.stdout);
            assert!(
                output.status.success(),
                "{}",
                String::from_utf8_lossy(&output.stderr)
            );
            let lines: Vec<Vec<&str>> = stdout.lines().map(|line| line.split('\t').collect()).collect();
            assert_eq!(lines.len() as u64, report.recorded_frames);
            let now = std::time::SystemTime::now()
                .duration_since(std::time::UNIX_EPOCH)
                .expect("a clock")
                .as_secs_f64();
            let (mut last, mut counts) = (0.0, [0, 0]);
            for line in &lines {
                let time: f64 = line[0].parse().expect("a time");
                assert!(
                    time >= last && now - time < 600.0 && time <= now,
                    "{line:?} after {last}"
                );
                last = time;
                let direction: usize = line[1].trim_start_matches("0x").parse().expect("a direction");
                counts[direction - 1] += 1;
                assert!(!line[2].is_empty(), "EtherCAT by tshark's reading: {line:?}");
                // The ring sets the local bit on the way back.
                let is_local = u8::from_str_radix(&line[3][..2], 16).expect("an address") & 2 != 0;
                assert!(direction == 2 || is_local, "{line:?}");
            }
            assert!(counts[0] > 200 && counts[1] >= counts[0], "{counts:?}");
        });
    });
}
