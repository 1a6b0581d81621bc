//! Moves in, the path that is driven out: the first half of the near-optimal planner.

use std::collections::VecDeque;

use evolvent_path::{Move, MoveKind, PathMode};
use evolvent_smooth::{Block, Output, Settings, Smoother, Stretch, Tolerance};
use evolvent_timing::PathLimits;

use crate::planner::PathRules;
use crate::step::{BlockMark, Segment, SegmentMarks, Step};
use crate::straight::Straightener;

/// Receives the path in order.
pub trait PathSink {
    /// Appends a stretch of path; `feed` in the feed metric, mm/s or degrees/s, infinite for rapids.
    fn segment(&mut self, segment: Segment, feed: f64);

    /// Bounds the speed of the path parameter at the present end, per s; 0 is a stop.
    fn cap(&mut self, speed: f64);

    /// Appends the mark of a block's start.
    fn mark(&mut self, mark: BlockMark);

    /// Brings the path to rest, and appends a step there.
    fn rest(&mut self, step: Step);
}

/// What a [`PathSink`] receives, to be passed on: to another thread, for one.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "nearly all are segments")]
pub enum PathItem {
    /// A stretch of path, and its feed.
    Segment(Segment, f64),
    /// A bound of the speed at the end so far.
    Cap(f64),
    /// A block's start.
    Mark(BlockMark),
    /// A step at rest.
    Rest(Step),
}

impl PathItem {
    /// Passes it on.
    pub fn hand_to(self, sink: &mut impl PathSink) {
        match self {
            Self::Segment(segment, feed) => sink.segment(segment, feed),
            Self::Cap(speed) => sink.cap(speed),
            Self::Mark(mark) => sink.mark(mark),
            Self::Rest(step) => sink.rest(step),
        }
    }
}

impl PathSink for Vec<PathItem> {
    fn segment(&mut self, segment: Segment, feed: f64) {
        self.push(PathItem::Segment(segment, feed));
    }

    fn cap(&mut self, speed: f64) {
        self.push(PathItem::Cap(speed));
    }

    fn mark(&mut self, mark: BlockMark) {
        self.push(PathItem::Mark(mark));
    }

    fn rest(&mut self, step: Step) {
        self.push(PathItem::Rest(step));
    }
}

/// Makes a path of the moves of one program. Knows no time: what comes out depends on the moves alone.
#[derive(Debug)]
pub struct PathStage {
    smoother: Smoother,
    straightener: Straightener,
    rules: PathRules,
    out: Vec<Output>,
    /// Blocks whose end has not come out, the oldest first.
    blocks: VecDeque<(u32, u32)>,
    /// Where the next block starts, if the one before has ended.
    start: Option<f64>,
}

impl PathStage {
    /// At rest at the start of the first move.
    #[must_use]
    pub fn new(limits: &PathLimits, rules: PathRules) -> Self {
        let settings = Settings {
            joint_time_s: rules.joint_time_s,
            limits: *limits.axes(),
        };
        Self {
            smoother: Smoother::new(settings),
            straightener: Straightener::default(),
            rules,
            out: Vec::new(),
            blocks: VecDeque::new(),
            start: Some(0.0),
        }
    }

    /// Largest distance of the path so far from the programmed one, mm.
    #[must_use]
    pub fn deviation_mm(&self) -> f64 {
        self.smoother.deviation_mm()
    }

    /// Appends a move that [`MoveValidator`](crate::MoveValidator) has let pass.
    pub fn push(&mut self, motion: &Move, line: u32, block: u32, sink: &mut impl PathSink) {
        let tolerance = match motion.path_mode {
            PathMode::ExactPath => Tolerance::Exact,
            PathMode::ExactStop => Tolerance::Stop,
            PathMode::Blend {
                tolerance_mm,
                merge_mm,
            } => {
                let mm = tolerance_mm.unwrap_or(self.rules.blend_tolerance_mm);
                // Q without a word is P, and no vertex may be farther off than P.
                let merge_mm = merge_mm.unwrap_or(mm).min(mm);
                Tolerance::Within { mm, merge_mm }
            }
        };
        let block = Block {
            curve: motion.curve,
            feed: motion.feed,
            rapid: matches!(motion.kind, MoveKind::Rapid),
            tolerance,
            line,
            block,
        };
        self.blocks.push_back((block.line, block.block));
        self.mark_start(sink);
        self.smoother.push(&block, &mut self.out);
        self.take_out(sink);
    }

    /// Brings the path to rest and appends a step there.
    pub fn rest(&mut self, step: Step, sink: &mut impl PathSink) {
        self.smoother.rest(&mut self.out);
        self.take_out(sink);
        hand_on(sink, self.straightener.flush(), self.blocks.front());
        sink.rest(step);
    }

    /// Marks where the oldest block starts that has not ended, once both are known.
    fn mark_start(&mut self, sink: &mut impl PathSink) {
        if let (Some(start), Some(&(line, block))) = (self.start, self.blocks.front()) {
            sink.mark(BlockMark { start, line, block });
            self.start = None;
        }
    }

    fn take_out(&mut self, sink: &mut impl PathSink) {
        let mut out = std::mem::take(&mut self.out);
        for output in out.drain(..) {
            match output {
                Output::Stretch(stretch) => {
                    let complete = self.straightener.push(stretch);
                    hand_on(sink, complete, self.blocks.front());
                }
                Output::Cap { speed } => {
                    hand_on(sink, self.straightener.flush(), self.blocks.front());
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
}

fn hand_on(sink: &mut impl PathSink, stretch: Option<Stretch>, block: Option<&(u32, u32)>) {
    let Some(stretch) = stretch else { return };
    let (line, block) = block.copied().unwrap_or_default();
    let segment = Segment {
        curve: stretch.curve,
        from: stretch.from,
        length: stretch.length,
        line,
        block,
        marks: SegmentMarks {
            blend: stretch.blend,
            rapid: stretch.rapid,
            joint: stretch.joint,
        },
    };
    sink.segment(segment, stretch.feed);
}
