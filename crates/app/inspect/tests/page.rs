//! The page in a real browser: drawn, zoomable, without network access, no extreme lost.
//!
//! Requires Chromium (Debian: `apt-get install chromium`), or the browser named by `EVOLVENT_BROWSER`.
//! Without a browser the tests print "not measured".
#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "tests fail and talk as tests do"
)]

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::common::{PROGRAM, altered, cycles, record};
use evolvent_inspect::write_report;
use evolvent_runtime::Clock;
use evolvent_trace::{CONTINUES_AT, Recorder, TraceFile, recover};

fn browser() -> Option<PathBuf> {
    let named = std::env::var_os("EVOLVENT_BROWSER").map(PathBuf::from);
    let found = named.into_iter().chain(
        ["chromium", "chromium-browser", "google-chrome"]
            .iter()
            .flat_map(|name| ["/usr/bin", "/usr/local/bin"].map(|folder| Path::new(folder).join(name))),
    );
    let browser = found.into_iter().find(|path| path.is_file());
    if browser.is_none() {
        println!("not measured: no browser (apt-get install chromium)");
    }
    browser
}

/// Adds a script to a copy of the page, opens it, and returns the resulting document.
fn opened(browser: &Path, page: &Path, script: &str) -> String {
    let text = std::fs::read_to_string(page).expect("a page");
    let probe = page.with_extension("probe.html");
    let script = format!(
        "<pre id=\"probe\"></pre><script>window.onerror = text => \
         {{ document.getElementById('probe').textContent += 'ERROR ' + text; }};\ntry \
         {{ document.getElementById('probe').textContent += (() => {{ {script} }})(); }} catch (e) \
         {{ document.getElementById('probe').textContent += 'ERROR ' + e; }}</script></body>"
    );
    std::fs::write(&probe, text.replace("</body>", &script)).expect("room");
    let profile = tempfile::tempdir().expect("a folder");
    let output = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-dev-shm-usage",
            "--window-size=1280,2400",
            "--virtual-time-budget=3000",
            "--dump-dom",
        ])
        .arg(format!("--user-data-dir={}", profile.path().display()))
        .arg(format!("file://{}", probe.display()))
        .stdin(Stdio::null())
        .stderr(Stdio::null())
        .output()
        .expect("the browser to start");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn probed(document: &str) -> &str {
    let rest = document.split("<pre id=\"probe\">").nth(1).expect("the probe");
    rest.split("</pre>").next().expect("its end")
}

#[test]
fn a_page_needs_no_network_and_opens_with_its_verdict() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let page = folder.path().join("run.html");
    let bytes = write_report(&trace, &page).expect("a page");
    let text = std::fs::read_to_string(&page).expect("the page");
    assert_eq!(bytes, text.len() as u64);
    let lower = text.to_lowercase();
    for foreign in [
        "http://",
        "https://",
        "src=",
        "@import",
        "url(",
        "fetch(",
        "xmlhttprequest",
    ] {
        assert!(!lower.contains(foreign), "{foreign} in the page");
    }
    let verdict = text.find("ran to its end").expect("the verdict");
    assert!(verdict < text.find("<canvas").expect("a picture"), "words first");
    assert!(!text.contains("{{"), "a place was not filled");
    // Text of the program cannot become part of the page.
    assert!(!text.contains("(a <part>"), "the program's text is not escaped");
}

#[test]
fn a_browser_draws_every_picture_and_the_tables() {
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let page = folder.path().join("run.html");
    write_report(&trace, &page).expect("a page");
    let script = "
        const drawn = canvas => {
          const pen = canvas.getContext('2d'), image = pen.getImageData(0, 0, canvas.width, canvas.height).data;
          let count = 0;
          for (let i = 3; i < image.length; i += 4) if (image[i]) count++;
          return count;
        };
        const shown = [...document.querySelectorAll('canvas')].filter(canvas => canvas.clientHeight > 0);
        const blank = shown.filter(canvas => drawn(canvas) < 200).length;
        const rows = document.querySelectorAll('#lines tbody tr').length;
        const links = [...document.querySelectorAll('#lines a')].every(a => document.querySelector(a.getAttribute('href')));
        const lines = document.querySelectorAll('#program li').length;
        const before = evolvent.view.to - evolvent.view.from;
        const chart = document.querySelector('#charts canvas');
        const box = chart.getBoundingClientRect();
        chart.dispatchEvent(new WheelEvent('wheel', { deltaY: -100, clientX: box.left + 400, clientY: box.top + 20, cancelable: true }));
        const after = evolvent.view.to - evolvent.view.from;
        document.querySelector('[data-view=\"3d\"]').click();
        return JSON.stringify({ shown: shown.length, blank, rows, links, lines, zoomed: after < before });
    ";
    let document = opened(&browser, &page, script);
    assert!(
        document.contains("data-ready=\"yes\""),
        "the script came to its end"
    );
    let found: serde_json::Value = serde_json::from_str(probed(&document)).expect("JSON of the probe");
    assert!(found["shown"].as_u64() > Some(13), "{found}");
    assert_eq!(found["blank"], 0, "{found}");
    assert!(found["rows"].as_u64() > Some(5), "{found}");
    assert_eq!(
        (&found["links"], &found["zoomed"]),
        (&true.into(), &true.into()),
        "{found}"
    );
    assert_eq!(found["lines"], PROGRAM.split('\n').count(), "{found}");
}

#[test]
fn a_one_cycle_spike_in_a_long_run_is_drawn() {
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    // Five minutes at 1 kHz of a quiet curve, with a single spike.
    let short = altered(&trace, "short", |_| {}, |_| true);
    let mut file = TraceFile::open(&short).expect("a trace");
    let mut info = file.info().run.clone().expect("a run");
    let text = file
        .attachment(&info.machine_file_name)
        .expect("readable")
        .expect("there");
    info.machine_file = String::from_utf8(text).expect("UTF-8");
    let long = folder.path().join("long.mcap");
    let mut recorder = Recorder::create(&long, &info).expect("a recorder");
    let (count, spike) = (300_000_u64, 123_457_u64);
    for n in 0..count {
        let phase = n as f64 * 1e-4;
        let mut cycle = evolvent_trace::CycleRecord {
            sequence: n,
            due_time_ns: info.start_time_ns + n * info.period_ns,
            state: 1,
            line: 1 + (n / 50_000) as u32,
            feed_mm_s: 10.0 + phase.sin(),
            path_mm: n as f64 * 0.01,
            ..evolvent_trace::CycleRecord::default()
        };
        cycle.position[0] = 50.0 * phase.sin();
        cycle.position[1] = 50.0 * phase.cos();
        cycle.jerk[0] = if n == spike { 123_456.0 } else { phase.sin() };
        recorder.cycle(&cycle).expect("room");
    }
    recorder.finish(&std::collections::BTreeMap::new()).expect("room");
    let page = folder.path().join("long.html");
    let bytes = write_report(&long, &page).expect("a page");
    assert!(bytes < 12_000_000, "{bytes} bytes");
    let script = format!(
        "
        const jerk = evolvent.curves.find(curve => curve.group === 'jerk' && curve.label === 'X');
        const whole = jerk.range(0, evolvent.samples), there = jerk.range({spike}, {spike});
        const before = jerk.range({spike} - 5000, {spike} - 100), after = jerk.range({spike} + 100, {spike} + 5000);
        return JSON.stringify({{ whole: whole[1], there: there[1], before: before[1], after: after[1], width: jerk.width }});
    "
    );
    let document = opened(&browser, &page, &script);
    let found: serde_json::Value = serde_json::from_str(probed(&document)).expect("JSON of the probe");
    let number = |name: &str| found[name].as_f64();
    assert_eq!(
        (number("whole"), number("there")),
        (Some(123_456.0), Some(123_456.0)),
        "{found}"
    );
    assert!(
        found["before"].as_f64() < Some(10.0) && found["after"].as_f64() < Some(10.0),
        "{found}"
    );
    assert!(
        found["width"].as_u64() > Some(1),
        "the run is long enough to be thinned out: {found}"
    );
}

/// The data within a page.
fn data(page: &Path) -> serde_json::Value {
    let text = std::fs::read_to_string(page).expect("a page");
    let rest = text.split("id=\"data\">").nth(1).expect("the data");
    serde_json::from_str(rest.split("</script>").next().expect("its end")).expect("JSON")
}

#[test]
fn colours_of_the_path_are_scaled_by_the_cut() {
    let folder = tempfile::tempdir().expect("a folder");
    let program = "G21 G90 G0 X60 Y20\nG1 X40 Y40 F600\nX0\nG0 X0 Y0 Z5\nM2\n";
    let (trace, _) = record(folder.path(), "run", program, Clock::Virtual, 1.0, |_| {});
    let page = folder.path().join("run.html");
    write_report(&trace, &page).expect("a page");
    let data = data(&page);
    let fastest = data["fastest_cut"].as_f64().expect("a number");
    assert!((fastest - 10.0).abs() < 0.01, "{fastest} mm/s");
    let feed = data["series"][0]["greatest"].as_f64().expect("a number");
    assert!(feed > 100.0, "rapids are {feed} mm/s");
}

#[test]
fn the_path_in_space_fills_its_picture() {
    let Some(browser) = browser() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let program = "G21 G90 G1 X80 Y0 F3000\nY20\nX0\nY0 Z-4\nM2\n";
    let (trace, _) = record(folder.path(), "run", program, Clock::Virtual, 1.0, |_| {});
    let page = folder.path().join("run.html");
    write_report(&trace, &page).expect("a page");
    let script = "document.querySelector('[data-view=\"3d\"]').click(); evolvent.refreshNow(); const canvas \
        = document.getElementById('path-canvas'), w = canvas.width, h = canvas.height; const pixels = \
        canvas.getContext('2d').getImageData(0, 0, w, h).data; let l = w, r = 0, t = h, b = 0; /* The scale \
        of colours is in a corner of its own. */ for (let y = 0; y < h; y++) for (let x = 0; x < w; x++) if \
        (pixels[4 * (y * w + x) + 3] && !(y < 40 && x > w - 200)) \
        { l = Math.min(l, x); r = Math.max(r, x); t = Math.min(t, y); b = Math.max(b, y); } return [(r - l) \
        / w, (b - t) / h].join(' ');";
    let document = opened(&browser, &page, script);
    let fractions: Vec<f64> = probed(&document)
        .split(' ')
        .map(|fraction| fraction.parse().expect("two numbers"))
        .collect();
    assert!(
        fractions[0] > 0.8 || fractions[1] > 0.8,
        "{fractions:?} of width and height"
    );
}

#[test]
fn cycles_that_are_missing_at_the_beginning_are_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let (trace, _) = record(folder.path(), "run", PROGRAM, Clock::Virtual, 1.0, |_| {});
    let count = cycles(&trace).len() as u64;
    let page = folder.path().join("run.html");
    let note = |trace: &Path| {
        write_report(trace, &page).expect("a page");
        std::fs::read_to_string(&page).expect("the page")
    };
    let lost = 800;
    let late = altered(&trace, "late", |_| {}, |cycle| cycle.sequence >= lost);
    let text = note(&late);
    let whole = format!("{:.3} s", count as f64 * 1e-3);
    assert!(
        text.contains(&format!("{lost} cycles are missing in 1 gaps")),
        "{lost}"
    );
    assert!(!text.contains("without a gap"));
    assert!(
        text.contains(&format!("ran to its end: {whole} and")),
        "not {whole}"
    );
    assert!(
        text.contains(&format!("<tr><th>duration</th><td>{whole}</td></tr>")),
        "not {whole}"
    );
    let info = TraceFile::open(&late).expect("a trace");
    assert!(
        (info.info().duration_s() - (count - 1) as f64 * 1e-3).abs() < 1e-9,
        "{}",
        info.info().duration_s()
    );
    // A file that continues an earlier one begins there.
    let describe = |run: &mut evolvent_trace::RunInfo| {
        run.extra.insert(CONTINUES_AT.to_owned(), lost.to_string());
    };
    let text = note(&altered(&trace, "next", describe, |cycle| cycle.sequence >= lost));
    let rest = count - lost;
    assert!(
        text.contains(&format!("All {rest} cycles were recorded, without a gap.")),
        "{rest}"
    );
    assert!(text.contains(&format!("ran to its end: {:.3} s and", rest as f64 * 1e-3)));
}

#[test]
fn damage_in_the_middle_is_not_called_a_truncated_end() {
    let folder = tempfile::tempdir().expect("a folder");
    let program = crate::common::long_program(20);
    let (trace, _) = record(folder.path(), "runs", &program, Clock::Virtual, 1.0, |_| {});
    let mut bytes = std::fs::read(&trace).expect("its bytes");
    // In the records of a chunk: an index outside the chunks can be damaged without any loss.
    let summary = mcap::Summary::read(&bytes).expect("a summary").expect("one");
    let chunks = &summary.chunk_indexes;
    let chunk = &chunks[chunks.len() / 2];
    let offset = chunk.chunk_start_offset + chunk.chunk_length - 10;
    bytes[usize::try_from(offset).expect("within the file")] ^= 1;
    let (damaged, saved) = (
        folder.path().join("damaged.mcap"),
        folder.path().join("saved.mcap"),
    );
    std::fs::write(&damaged, bytes).expect("room");
    let recovered = recover(&damaged, Some(&saved)).expect("a recovery");
    assert_eq!(recovered.damaged_places, 1);
    let page = folder.path().join("saved.html");
    write_report(&saved, &page).expect("a page");
    let text = std::fs::read_to_string(&page).expect("the page");
    assert!(text.contains("The file was damaged in one place and has been recovered"));
    assert!(!text.contains("truncated"));
}
