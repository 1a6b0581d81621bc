//! The plan on its way to the cycle, with the planned duration of each block.

use std::collections::VecDeque;

use evolvent_planner::{BlockMark, ExitSpeeds, PlanSink, ReplanReply, ReplanRequest, Segment, Step};

/// Passes the plan on, and sums the planned duration of each block.
pub(crate) struct Tally<S> {
    sink: S,
    /// Parts of steps that are not final: the blocks of each step, and their fractions of its length.
    open: VecDeque<(u32, f64)>,
    parts_of_step: VecDeque<u32>,
    parts: u32,
    /// Blocks whose plan is final, with their seconds.
    pub(crate) finished: VecDeque<(u32, f64)>,
    /// Planned seconds.
    pub(crate) planned_s: f64,
}

impl<S> Tally<S> {
    pub(crate) fn new(sink: S) -> Self {
        Self {
            sink,
            open: VecDeque::new(),
            parts_of_step: VecDeque::new(),
            parts: 0,
            finished: VecDeque::new(),
            planned_s: 0.0,
        }
    }

    /// Number of parts and steps that are not summed yet.
    #[cfg(test)]
    pub(crate) fn lengths(&self) -> (usize, usize) {
        (self.open.len(), self.parts_of_step.len())
    }
}

impl<S: PlanSink> PlanSink for Tally<S> {
    type Error = S::Error;

    fn segment(&mut self, segment: &Segment) -> Result<(), S::Error> {
        match self.open.back_mut() {
            Some(last) if self.parts > 0 && last.0 == segment.block => last.1 += segment.length,
            _ => {
                self.open.push_back((segment.block, segment.length));
                self.parts += 1;
            }
        }
        self.sink.segment(segment)
    }

    fn step(&mut self, step: &Step) -> Result<(), S::Error> {
        if matches!(step, Step::TimedSegment(_) | Step::Wait) {
            // A time-optimal plan reports the durations of its blocks.
            self.open.clear();
            self.parts_of_step.clear();
        } else {
            self.parts_of_step.push_back(self.parts);
        }
        self.parts = 0;
        self.sink.step(step)
    }

    fn exit(&mut self, index: u64, speeds: ExitSpeeds) {
        self.sink.exit(index, speeds);
    }

    fn planned(&mut self, index: u64, duration_s: f64) {
        self.planned_s += duration_s;
        let parts = self.parts_of_step.pop_front().unwrap_or(0) as usize;
        let whole: f64 = self.open.iter().take(parts).map(|part| part.1).sum();
        for (block, length) in self.open.drain(..parts.min(self.open.len())) {
            let share = if whole > 0.0 {
                duration_s * length / whole
            } else {
                0.0
            };
            match self.finished.back_mut() {
                Some(last) if last.0 == block => last.1 += share,
                _ => self.finished.push_back((block, share)),
            }
        }
        self.sink.planned(index, duration_s);
    }

    fn commit(&mut self, count: u64) {
        self.sink.commit(count);
    }

    fn mark(&mut self, mark: &BlockMark) -> Result<(), S::Error> {
        self.sink.mark(mark)
    }

    fn leave_open(&mut self, from: u64) {
        self.sink.leave_open(from);
    }

    fn reserve_link(&mut self) -> Result<(), S::Error> {
        self.sink.reserve_link()
    }

    fn link(&mut self, from: u64, to: u64) -> bool {
        self.sink.link(from, to)
    }

    fn planned_block(&mut self, block: u32, seconds: f64) {
        self.planned_s += seconds;
        match self.finished.back_mut() {
            Some(last) if last.0 == block => last.1 += seconds,
            _ => self.finished.push_back((block, seconds)),
        }
        self.sink.planned_block(block, seconds);
    }

    fn has_capacity(&self, steps: usize, segments: usize, marks: usize) -> bool {
        self.sink.has_capacity(steps, segments, marks)
    }

    fn wait(&mut self) -> Result<(), S::Error> {
        self.sink.wait()
    }

    fn request(&mut self) -> Option<ReplanRequest> {
        self.sink.request()
    }

    fn reply(&mut self, reply: ReplanReply) {
        self.sink.reply(reply);
    }

    fn acknowledged(&self) -> u64 {
        self.sink.acknowledged()
    }

    fn withdrawn(&self) -> u64 {
        self.sink.withdrawn()
    }

    fn reached(&self) -> u64 {
        self.sink.reached()
    }

    fn reached_step(&self) -> u64 {
        self.sink.reached_step()
    }
}
