//! A served machine records every cycle by default, in files of bounded size, and reports what it does.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use evolvent_inspect::write_report;
use evolvent_replay::verify;
use evolvent_tests::job_result::DONE;
use evolvent_tests::{Operator, Scene, unless_disturbed};
use evolvent_trace::TraceFile;

/// Complete traces in a folder, in order of their start.
fn traces(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder of traces");
    let mut files: Vec<PathBuf> = entries
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|ending| ending == "mcap"))
        .collect();
    files.sort();
    files
}

fn block(operator: &mut Operator, text: &str) {
    let job = operator.says_text("MDI", text).job;
    assert_eq!(operator.sees_end(job).job_result, DONE, "{text}");
}

#[test]
fn serving_records_every_cycle_and_says_how_to_go_on() {
    unless_disturbed(|| {
        let mut scene = Scene::with("records", &["--trace-limit", "1"]);
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 2);
        block(&mut operator, "G0 X20 Y5");
        block(&mut operator, "G1 X30 Y5 F600");
        drop(operator);
        let finished = scene.served.take().expect("a core").end().expect_code(&[0, 3]);
        for words in [
            "serving records: axes XYZ",
            "evolvent ctl --machine-name records",
            "evolvent top records",
            "recording to",
        ] {
            assert!(finished.err.contains(words), "{words}: {}", finished.err);
        }
        let files = traces(&scene.workshop.path("state/traces"));
        let summary = finished.json();
        assert_eq!(summary["trace"], files[0].display().to_string());
        let verified = verify(&files[0]).expect("a trace");
        assert_eq!(Some(verified.cycles), summary["cycles"].as_u64());
        assert!(verified.holds() && !verified.lacks_data(), "{verified:?}");
        assert_eq!(verified.jobs, 2);
        // The page distinguishes the two blocks, which have the same line number.
        let page = scene.workshop.path("page.html");
        write_report(&files[0], &page).expect("a page");
        let text = std::fs::read_to_string(&page).expect("the page");
        let data = text.split("id=\"data\">").nth(1).expect("the data");
        let data: serde_json::Value =
            serde_json::from_str(data.split("</script>").next().expect("its end")).expect("JSON");
        let texts = |job: u64| -> Vec<&str> {
            let rows = data["slowest"].as_array().expect("rows");
            let own = rows.iter().filter(|row| row["job"] == job);
            own.filter_map(|row| row["text"].as_str()).collect()
        };
        assert_eq!((texts(1), texts(2)), (vec!["G0 X20 Y5"], vec!["G1 X30 Y5 F600"]));
        assert_eq!(data["jobs"][1][1], "MDI");
        assert!((data["fastest_cut"].as_f64().expect("a number") - 10.0).abs() < 0.01);
    });
}

#[test]
fn traces_of_a_session_keep_their_bound_without_a_gap() {
    unless_disturbed(|| {
        // A limit of 10 MiB: each file gets a quarter of it.
        let limit = 0.01;
        let mut scene = Scene::with("bounded", &["--trace-limit", "0.01", "--rate", "8000"]);
        let folder = scene.workshop.path("state/traces");
        let mut operator = scene.operator();
        operator.brings_up();
        operator.says_number("MODE", 2);
        let begin = Instant::now();
        let mut first = None;
        // Until the first file has been removed.
        while first.as_ref().is_none_or(|file: &PathBuf| file.exists()) {
            assert!(
                begin.elapsed() < Duration::from_secs(240),
                "{:?}",
                traces(&folder)
            );
            for text in ["G0 X20 Y5", "G0 X0 Y0", "G2 X0 Y0 I7 F4000"] {
                block(&mut operator, text);
            }
            first = first.or_else(|| traces(&folder).first().cloned());
        }
        drop(operator);
        let finished = scene.served.take().expect("a core").end().expect_code(&[0, 3]);
        assert_eq!(finished.json()["dropped_records"], 0);
        let files = traces(&folder);
        let bytes: u64 = files
            .iter()
            .map(|file| file.metadata().expect("a file").len())
            .sum();
        assert!((bytes as f64) < limit * f64::from(1 << 30), "{bytes} bytes");
        assert!(files.len() > 1, "{files:?}");
        let mut next = None;
        for file in &files {
            let mut trace = TraceFile::open(file).expect("a trace");
            let cycles = trace.cycles().map(|cycle| cycle.expect("a cycle").sequence);
            for sequence in cycles {
                assert!(
                    next.is_none_or(|next| next == sequence),
                    "a gap before {sequence}"
                );
                next = Some(sequence + 1);
            }
            let verified = verify(file).expect("a trace");
            assert!(verified.holds(), "{}: {verified:?}", file.display());
            assert_eq!(verified.missing, 0, "{}", file.display());
        }
    });
}
