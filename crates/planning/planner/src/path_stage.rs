//! Moves in, driven path out: the first stage of the time-optimal planner.

use std::collections::VecDeque;

use evolvent_path::{Feed, Move, MoveKind, PathMode};
use evolvent_smooth::{Output, PathSegment, ProgramMove, Smoother, SmootherSettings, Tolerance};
use evolvent_timing::PathLimits;

use crate::planner::PathRules;
use crate::speed_step::SpeedStep;
use crate::step::{BlockMark, Segment, SegmentMarks, Step};
use crate::straight::Straightener;

/// Receives the path in order.
pub trait PathSink {
    /// Appends a path segment and its feed.
    fn segment(&mut self, segment: Segment, feed: Feed);

    /// Limits the speed of the path parameter at the present end, per s; 0 is a stop.
    fn cap(&mut self, speed_u_s: f64);

    /// Appends the mark of a block's start.
    fn mark(&mut self, mark: BlockMark);

    /// Stops the path and appends a step at rest.
    fn rest(&mut self, step: Step);
}

/// A call of a [`PathSink`] as a value, for example to send it to another thread.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "nearly all are segments")]
pub enum PathItem {
    /// A path segment and its feed.
    Segment(Segment, Feed),
    /// A limit of the speed at the present end.
    Cap(f64),
    /// The start of a block.
    Mark(BlockMark),
    /// A step at rest.
    Rest(Step),
}

impl PathItem {
    /// Performs the call on a sink.
    pub fn apply_to(self, sink: &mut impl PathSink) {
        match self {
            Self::Segment(segment, feed) => sink.segment(segment, feed),
            Self::Cap(speed_u_s) => sink.cap(speed_u_s),
            Self::Mark(mark) => sink.mark(mark),
            Self::Rest(step) => sink.rest(step),
        }
    }
}

impl PathSink for Vec<PathItem> {
    fn segment(&mut self, segment: Segment, feed: Feed) {
        self.push(PathItem::Segment(segment, feed));
    }

    fn cap(&mut self, speed_u_s: f64) {
        self.push(PathItem::Cap(speed_u_s));
    }

    fn mark(&mut self, mark: BlockMark) {
        self.push(PathItem::Mark(mark));
    }

    fn rest(&mut self, step: Step) {
        self.push(PathItem::Rest(step));
    }
}

/// Converts the moves of one program into a path. Knows no time: the path depends on the moves alone.
#[derive(Debug)]
pub struct PathStage {
    smoother: Smoother,
    straightener: Straightener,
    speed_step: SpeedStep,
    rules: PathRules,
    out: Vec<Output>,
    /// Blocks whose end is not in the output yet, oldest first.
    blocks: VecDeque<(u32, u32)>,
    /// The start of the next block, if the previous one has ended.
    start: Option<f64>,
}

impl PathStage {
    /// Starts at rest at the beginning of the first move.
    #[must_use]
    pub fn new(limits: &PathLimits, rules: PathRules) -> Self {
        let settings = SmootherSettings {
            joint_time_s: rules.joint_time_s,
            limits: *limits.axes(),
        };
        Self {
            smoother: Smoother::new(settings),
            straightener: Straightener::default(),
            speed_step: SpeedStep::new(limits.axes()),
            rules,
            out: Vec::new(),
            blocks: VecDeque::new(),
            start: Some(0.0),
        }
    }

    /// Maximum distance so far between the path and the programmed one, mm.
    #[must_use]
    pub fn deviation_mm(&self) -> f64 {
        self.smoother.deviation_mm()
    }

    /// Appends a move that [`MoveValidator`](crate::MoveValidator) has accepted.
    pub fn push(&mut self, motion: &Move, line: u32, block: u32, sink: &mut impl PathSink) {
        let tolerance = match motion.path_mode {
            PathMode::ExactPath => Tolerance::Exact,
            PathMode::ExactStop => Tolerance::Stop,
            PathMode::Blend {
                tolerance_mm,
                merge_mm,
            } => {
                let mm = tolerance_mm.unwrap_or(self.rules.blend_tolerance_mm);
                // Q without a word equals P, and no vertex may be farther away than P.
                let merge_mm = merge_mm.unwrap_or(mm).min(mm);
                Tolerance::Within { mm, merge_mm }
            }
        };
        let block = ProgramMove {
            curve: motion.curve,
            feed_mm_s: motion.feed_mm_s,
            rapid: matches!(motion.kind, MoveKind::Rapid),
            tolerance,
            line,
            block,
        };
        self.blocks.push_back((block.line, block.block));
        self.mark_start(sink);
        self.smoother.push(&block, &mut self.out);
        self.emit_outputs(sink);
    }

    /// Stops the path and appends a step at rest.
    pub fn rest(&mut self, step: Step, sink: &mut impl PathSink) {
        self.smoother.rest(&mut self.out);
        self.emit_outputs(sink);
        self.flush(None, sink);
        self.speed_step.cap(0.0);
        sink.rest(step);
    }

    /// Marks the start of the oldest block that has not ended, once both are known.
    fn mark_start(&mut self, sink: &mut impl PathSink) {
        if let (Some(start), Some(&(line, block))) = (self.start, self.blocks.front()) {
            sink.mark(BlockMark { start, line, block });
            self.start = None;
        }
    }

    fn emit_outputs(&mut self, sink: &mut impl PathSink) {
        let mut out = std::mem::take(&mut self.out);
        for output in out.drain(..) {
            match output {
                Output::Segment(segment) => {
                    if let Some(complete) = self.straightener.push(segment) {
                        let after = self.speed_step.start_speed(&segment);
                        self.emit(&complete, Some(after), sink);
                    }
                }
                Output::Cap { speed } => {
                    self.flush((speed > 0.0).then_some(speed), sink);
                    self.speed_step.cap(speed);
                    sink.cap(speed);
                }
                Output::Mark(mark) => {
                    self.blocks.pop_front();
                    self.start = Some(mark.end);
                    self.mark_start(sink);
                }
            }
        }
        self.out = out;
    }

    /// Hands over segments that no later segment can join.
    fn flush(&mut self, after: Option<f64>, sink: &mut impl PathSink) {
        if let Some(complete) = self.straightener.flush() {
            self.emit(&complete, after, sink);
        }
    }

    /// `after`: the maximum speed of the parameter after the segment, per s, if known.
    fn emit(&mut self, whole: &PathSegment, after: Option<f64>, sink: &mut impl PathSink) {
        let (line, block) = self.blocks.front().copied().unwrap_or_default();
        for part in self.speed_step.divide(whole, after) {
            let segment = Segment {
                curve: part.curve,
                from: part.from,
                length: part.length,
                line,
                block,
                marks: SegmentMarks {
                    blend: part.blend,
                    rapid: part.rapid,
                    joint: part.joint,
                },
            };
            let feed = Feed {
                mm_s: part.feed_mm_s,
                metric: Some(part.metric),
            };
            sink.segment(segment, feed);
        }
    }
}
