//! The trace of a served machine: the recorder's thread, and the switch to the next file.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::Instant;

use evolvent_trace::{RecordError, Recorder};
use rtrb::{Consumer, Producer, RingBuffer};

use super::config::{ServeConfig, TraceTo};
use super::operator::Operator;
use super::series::{FileProgress, TraceSeries};
use super::summary::ServeSummary;
use crate::cycle_sample::CycleSample;
use crate::leftovers::rescue_leftovers;
use crate::news::FeederEvent;
use crate::recording::{Closing, Further, RecordReport, RecorderLines, Recording};
use crate::run_info::{RunSource, run_info};
use crate::shared::Controls;
use crate::signal_recorder::SignalRecorder;
use crate::start_error::StartError;

/// A running recorder.
pub(super) struct SessionTrace {
    /// The first or only file.
    pub file: PathBuf,
    thread: JoinHandle<RecordReport>,
    closing: Sender<Closing>,
    failures: Receiver<RecordError>,
    files: Option<Files>,
}

/// State of a trace that continues in further files.
struct Files {
    series: TraceSeries,
    progress: Arc<FileProgress>,
    /// When the present file was begun.
    begun: Instant,
    ordered: u64,
}

/// The senders for those who are recorded.
pub(super) struct Recorded {
    /// Of the cycle.
    pub cycles: Producer<CycleSample>,
    /// Of planners and control thread.
    pub news: Sender<FeederEvent>,
}

impl SessionTrace {
    /// Creates the first file and starts the recorder; `None` if no trace is wanted. `note` receives messages
    /// about traces left by killed sessions.
    ///
    /// # Errors
    /// The file cannot be created.
    pub(super) fn start(
        config: &ServeConfig,
        (queue, signals): (usize, Option<SignalRecorder>),
        start_unix_ns: u64,
        note: &mut impl FnMut(&str),
    ) -> Result<Option<(Self, Recorded)>, StartError> {
        let setup = &config.setup;
        let (file, series) = match &config.trace {
            TraceTo::Nowhere => return Ok(None),
            TraceTo::File(path) => (path.clone(), None),
            TraceTo::Folder { folder, limit_bytes } => {
                let series = TraceSeries::new(folder.clone(), &setup.machine.name, *limit_bytes);
                (series.file_of_now(), Some(series))
            }
        };
        for text in rescue_leftovers(&file) {
            note(&text);
        }
        let info = run_info(setup, &RunSource::Served, start_unix_ns);
        let recorder = Recorder::create(&file, &info)?;
        let files = series.map(|series| {
            // If the folder could not be read, creating the file would have failed.
            let _left = series.trim(&file);
            Files {
                series,
                progress: Arc::new(FileProgress::default()),
                begun: Instant::now(),
                ordered: 0,
            }
        });
        let (cycles, queue): (_, Consumer<CycleSample>) = RingBuffer::new(queue);
        let (lines, recorded) = RecorderLines::new();
        let recording = Recording {
            recorder,
            queue,
            signals,
            lines,
            on_full: setup.machine.trace.on_full,
            controls: Arc::new(Controls::new(1.0)),
            program: PathBuf::new(),
            further: files.as_ref().map(|files| Further {
                series: files.series.clone(),
                info,
                progress: Arc::clone(&files.progress),
                finishing: Vec::new(),
            }),
        };
        let period_ns = setup.period_ns;
        let thread = thread::Builder::new()
            .name("recorder".into())
            .spawn(move || recording.run(period_ns))?;
        let trace = Self {
            file,
            thread,
            closing: recorded.closing,
            failures: recorded.failures,
            files,
        };
        let news = recorded.news;
        Ok(Some((trace, Recorded { cycles, news })))
    }

    /// Reports to the operator why the recorder has ended, and begins the next file when it is due.
    pub(super) fn poll(&mut self, operator: &mut Operator) {
        for error in self.failures.try_iter() {
            operator.trace_failed(&error.to_string());
        }
        let Some(files) = &mut self.files else { return };
        let is_begun = files.progress.files.load(Ordering::Acquire) == files.ordered;
        let bytes = files.progress.bytes.load(Ordering::Relaxed);
        if is_begun && files.series.is_due(files.begun, bytes, operator.is_idle()) {
            files.begun = Instant::now();
            files.ordered += 1;
            operator.begin_trace_file();
        }
    }

    /// Ends the last file with the summary. All senders of events must be gone.
    pub(super) fn finish(self, summary: &ServeSummary) -> RecordReport {
        let pairs = [
            ("outcome", "served".to_owned()),
            ("jobs", summary.jobs.to_string()),
            ("commands_accepted", summary.commands_accepted.to_string()),
            ("commands_rejected", summary.commands_rejected.to_string()),
            ("late_cycles", summary.late_cycles.to_string()),
            ("dropped_records", summary.dropped_records.to_string()),
        ];
        let summary: BTreeMap<String, String> = pairs
            .into_iter()
            .map(|(key, value)| (key.to_owned(), value))
            .collect();
        let _gone = self.closing.send(Closing { summary, alarm: None });
        self.thread
            .join()
            .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}
