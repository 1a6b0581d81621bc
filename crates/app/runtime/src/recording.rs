//! The recorder's thread: writes cycles, events and blocks to the trace.

mod lines;
mod tracks;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use evolvent_machine::OnFull;
use evolvent_trace::{CONTINUES_AT, CycleRecord, RecordError, Recorder, RunInfo};
use rtrb::Consumer;

use self::tracks::Tracks;
use crate::cycle_sample::CycleSample;
use crate::news::FeederEvent;
use crate::serve::{FileProgress, TraceSeries};
use crate::shared::Controls;
use crate::signal_recorder::SignalRecorder;
use evolvent_control::Alarm;

/// A crash loses at most the data of this time.
const FLUSH_EVERY: Duration = Duration::from_millis(250);
/// Codes of the events of turning states are greater than this.
const TURNING_STATES: u32 = 100;
/// Maximum wait for the last events of a feeder.
const LAST_NEWS: Duration = Duration::from_secs(10);
/// Poll interval of an empty queue.
const POLL_INTERVAL: Duration = Duration::from_millis(1);
/// Sleep of the recorder when the queue is empty, in periods, and its maximum: a small part of what the queue
/// holds, also with the virtual clock.
const NAP_CYCLES: u64 = 4;
const MAX_NAP: Duration = Duration::from_millis(4);

/// Records one run.
pub(crate) struct Recording {
    pub recorder: Recorder,
    pub queue: Consumer<CycleSample>,
    /// Changes of inputs and outputs, if the machine has any.
    pub signals: Option<SignalRecorder>,
    pub lines: RecorderLines,
    pub on_full: OnFull,
    pub controls: Arc<Controls>,
    pub program: PathBuf,
    /// How the trace continues in further files; `None` for a single file.
    pub further: Option<Further>,
}

/// The files of a trace after the first.
pub(crate) struct Further {
    pub series: TraceSeries,
    /// Information that each file contains.
    pub info: RunInfo,
    /// Read by the thread that decides when the next file begins.
    pub progress: Arc<FileProgress>,
    /// Threads that finish earlier files.
    pub finishing: Vec<JoinHandle<Result<PathBuf, RecordError>>>,
}

impl Further {
    /// Continues in the next file. A separate thread finishes the present one, because its index and the disk
    /// take time.
    fn go_on(&mut self, recorder: &mut Recorder, sequence: u64) -> Result<(), RecordError> {
        let path = self.series.file_of_now();
        self.info
            .extra
            .insert(CONTINUES_AT.to_owned(), sequence.to_string());
        let next = Recorder::create(&path, &self.info)?;
        let old = std::mem::replace(recorder, next);
        self.progress.bytes.store(0, Ordering::Relaxed);
        self.progress.files.fetch_add(1, Ordering::Release);
        let series = self.series.clone();
        let finished = std::thread::Builder::new()
            .name("finisher".into())
            .spawn(move || {
                let summary = BTreeMap::from([
                    ("outcome".to_owned(), "served".to_owned()),
                    ("continued_in".to_owned(), path.display().to_string()),
                ]);
                let result = old.finish(&summary);
                // If the folder cannot be read, creating the next file reports it.
                let _left = series.trim(&path);
                result
            });
        // Without a thread the file stays a part file, which the next start recovers.
        self.finishing.extend(finished.ok());
        self.finishing.retain(|thread| !thread.is_finished());
        Ok(())
    }
}

/// The recorder's ends of its channels.
pub(crate) struct RecorderLines {
    news: Receiver<FeederEvent>,
    closing: Receiver<Closing>,
    failed: Sender<RecordError>,
}

impl RecorderLines {
    /// Both ends of the channels.
    pub(crate) fn new() -> (Self, RecordedLines) {
        let (news_sender, news) = mpsc::channel();
        let (closing_sender, closing) = mpsc::channel();
        let (failed, failures) = mpsc::channel();
        let recorder = Self {
            news,
            closing,
            failed,
        };
        let recorded = RecordedLines {
            news: news_sender,
            closing: closing_sender,
            failures,
        };
        (recorder, recorded)
    }
}

/// The other ends of the recorder's channels.
pub(crate) struct RecordedLines {
    /// Events of planners.
    pub news: Sender<FeederEvent>,
    /// How the trace ends, once no more events are sent.
    pub closing: Sender<Closing>,
    /// The error that ended the trace early, as soon as it occurs.
    pub failures: Receiver<RecordError>,
}

/// Data about the whole run for the end of the trace.
pub(crate) struct Closing {
    /// Names and values of the metadata.
    pub summary: BTreeMap<String, String>,
    /// The alarm that ended the run early: number and text.
    pub alarm: Option<(Alarm, String)>,
}

/// Result of the recording.
pub(crate) struct RecordReport {
    pub result: Result<PathBuf, RecordError>,
    /// Number of records that came after the trace had failed.
    pub lost: u64,
}

impl Recording {
    /// Records until the cycle has ended and the queue is empty, then finishes the file with the data of
    /// [`Closing`].
    pub(crate) fn run(self, period_ns: u64) -> RecordReport {
        let nap = Duration::from_nanos(period_ns.saturating_mul(NAP_CYCLES)).clamp(POLL_INTERVAL, MAX_NAP);
        let mut underway = RecordingUnderway {
            tracks: Tracks::new(&self.program, period_ns),
            recording: self,
            failure: None,
            lost: 0,
            flushed: Instant::now(),
            last_ns: 0,
            next_file: None,
        };
        loop {
            let over = underway.recording.queue.is_abandoned();
            let count = underway.drain_queue();
            underway.flush_when_due();
            if over && underway.recording.queue.is_empty() {
                break;
            }
            if count == 0 {
                std::thread::sleep(nap);
            }
        }
        underway.finish()
    }
}

/// A recording from its first sample to its last.
struct RecordingUnderway {
    recording: Recording,
    tracks: Tracks,
    /// The error after which nothing is recorded.
    failure: Option<RecordError>,
    /// Number of samples after that error.
    lost: u64,
    flushed: Instant,
    /// Due time of the last sample.
    last_ns: u64,
    /// The next file begins after this setpoint.
    next_file: Option<u64>,
}

impl RecordingUnderway {
    /// Records the samples in the queue. Returns their number.
    fn drain_queue(&mut self) -> usize {
        let mut count = 0;
        while let Ok(sample) = self.recording.queue.pop() {
            count += 1;
            self.last_ns = sample.record.due_time_ns;
            if self.failure.is_some() {
                self.lost += 1;
                continue;
            }
            if let Err(error) = self.begin_file_when_due(&sample.record) {
                self.lost += 1;
                self.fail(error);
                continue;
            }
            // Notices of an action were sent before the action was added to the plan.
            let news = sample.actions > self.tracks.actions || sample.blocks_begun() > self.tracks.blocks;
            if count % 256 == 1 || news {
                self.take_news();
            }
            if let Err(error) = self.record(&sample) {
                self.lost += 1;
                self.stop_if_configured();
                self.fail(error);
            }
        }
        count
    }

    /// Continues in the next file if one was ordered and `cycle` is its first.
    fn begin_file_when_due(&mut self, cycle: &CycleRecord) -> Result<(), RecordError> {
        let Recording {
            recorder,
            signals,
            further: Some(further),
            ..
        } = &mut self.recording
        else {
            return Ok(());
        };
        if self.next_file.is_none_or(|last| cycle.sequence <= last) {
            return Ok(());
        }
        self.next_file = None;
        self.tracks.wait_for_copies();
        self.tracks.attach(recorder, self.last_ns)?;
        further.go_on(recorder, cycle.sequence)?;
        match signals {
            Some(signals) => signals.repeat(recorder, cycle),
            None => Ok(()),
        }
    }

    /// Takes the pending events. Those after the order for a new file belong to that file.
    fn take_news(&mut self) {
        while self.next_file.is_none()
            && let Ok(news) = self.recording.lines.news.try_recv()
        {
            match news {
                FeederEvent::NextFile(last) => {
                    self.next_file = self.recording.further.is_some().then_some(last);
                }
                news => self.tracks.receive(news),
            }
        }
    }

    fn record(&mut self, sample: &CycleSample) -> Result<(), RecordError> {
        let Recording {
            recorder, signals, ..
        } = &mut self.recording;
        self.tracks.record(recorder, sample)?;
        match signals {
            Some(signals) => signals.record(recorder, &sample.record),
            None => Ok(()),
        }
    }

    fn flush_when_due(&mut self) {
        if self.failure.is_some() || self.flushed.elapsed() < FLUSH_EVERY {
            return;
        }
        self.flushed = Instant::now();
        let recorder = &mut self.recording.recorder;
        if let Some(further) = &self.recording.further {
            further.progress.bytes.store(recorder.bytes(), Ordering::Relaxed);
        }
        if let Err(error) = recorder.flush() {
            self.stop_if_configured();
            self.fail(error);
        }
    }

    /// Stops the motion that can no longer be recorded, if the machine file says so.
    fn stop_if_configured(&self) {
        if self.recording.on_full == OnFull::Stop {
            self.recording.controls.stop();
        }
    }

    /// Ends the recording and reports the reason.
    fn fail(&mut self, error: RecordError) {
        let _gone = self.recording.lines.failed.send(error.clone());
        self.failure = Some(error);
    }

    fn finish(mut self) -> RecordReport {
        let Recording {
            mut recorder,
            lines,
            further,
            ..
        } = self.recording;
        // The feeder ends soon after the cycle, and its events with it. A feeder that hangs in a file system
        // is not awaited.
        while let Ok(news) = lines.news.recv_timeout(LAST_NEWS) {
            self.tracks.receive(news);
        }
        let ended = lines.closing.recv().ok();
        if self.failure.is_none() {
            let alarm = ended.as_ref().and_then(|closing| closing.alarm.as_ref());
            self.failure = self.tracks.end(&mut recorder, self.last_ns, alarm).err();
        }
        let summary = ended.map(|closing| closing.summary).unwrap_or_default();
        let result = match self.failure {
            None => recorder.finish(&summary),
            Some(error) => Err(error),
        };
        for thread in further.into_iter().flat_map(|further| further.finishing) {
            // A file that fails here is a part file, which the next start recovers.
            let _result = thread.join();
        }
        RecordReport {
            result,
            lost: self.lost,
        }
    }
}
