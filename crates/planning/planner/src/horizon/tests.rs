#![allow(clippy::expect_used, reason = "a test may fail")]

use std::convert::Infallible;

use evolvent_path::{Curve, Line};

use super::*;
use crate::recorder::{Recorder, equal_axes, point};
use crate::step::ReplanReply;
use crate::step::{ExitSpeeds, SegmentMarks};

/// A recorder that sends one request, after this many polls.
#[derive(Default)]
struct RequestingSink {
    recorder: Recorder,
    request: Option<ReplanRequest>,
    lookups: u32,
    replies: Vec<ReplanReply>,
}

impl PlanSink for RequestingSink {
    type Error = Infallible;

    fn segment(&mut self, segment: &Segment) -> Result<(), Infallible> {
        self.recorder.segment(segment)
    }

    fn step(&mut self, step: &Step) -> Result<(), Infallible> {
        self.recorder.step(step)
    }

    fn exit(&mut self, index: u64, speeds: ExitSpeeds) {
        self.recorder.exit(index, speeds);
    }

    fn commit(&mut self, count: u64) {
        self.recorder.commit(count);
    }

    fn request(&mut self) -> Option<ReplanRequest> {
        match self.lookups.checked_sub(1) {
            Some(left) => {
                self.lookups = left;
                None
            }
            None => self.request.take(),
        }
    }

    fn reply(&mut self, reply: ReplanReply) {
        self.replies.push(reply);
    }
}

/// Collinear lines of 10 mm, of ten intervals each.
fn horizon(lines: u32) -> Horizon<RequestingSink> {
    let limits = PathLimits::new(equal_axes(100.0, 1000.0, 10_000.0), 1000.0, 1e-3);
    let mut horizon = Horizon::new(&limits, 1.0, RequestingSink::default());
    for k in 0..lines {
        append(&mut horizon, k);
    }
    horizon
}

fn append(horizon: &mut Horizon<RequestingSink>, k: u32) {
    let x = 10.0 * f64::from(k);
    let line = Line::new(point(x, 0.0), point(x + 10.0, 0.0)).expect("line");
    let segment = Segment {
        curve: Curve::Line(line),
        from: 0.0,
        length: 10.0,
        line: k,
        block: k,
        marks: SegmentMarks::default(),
    };
    horizon.segment(segment, (20.0 + f64::from(k % 2)).into());
}

#[test]
fn a_window_waits_until_its_end_is_known() {
    let lines = MAX_INTERVALS as u32 / 10;
    let mut goes_on = horizon(lines);
    goes_on.advance().expect("plan");
    assert_eq!(goes_on.grid.end(), MAX_INTERVALS as u64);
    assert_eq!(goes_on.sink.recorder.committed, 0, "it may rest there or not");
    append(&mut goes_on, lines);
    goes_on.advance().expect("plan");
    let recorder = &goes_on.sink.recorder;
    assert!(recorder.committed > 0 && recorder.steps.last() == Some(&Step::Wait));
    let mut rests = horizon(lines);
    rests.rest(Step::End { line: 1 });
    rests.advance().expect("plan");
    let recorder = &rests.sink.recorder;
    assert_eq!(recorder.committed as usize, recorder.steps.len());
    assert!(!recorder.steps.contains(&Step::Wait), "planned in one window");
}

#[test]
fn a_request_just_before_a_stop_is_answered() {
    let mut horizon = horizon(1);
    horizon.rest(Step::End { line: 1 });
    horizon.advance().expect("plan");
    for rate in [1.0, 0.5] {
        horizon.sink.request = Some(ReplanRequest {
            id: 1,
            step: 0,
            segment: 0,
            offset: 10.0,
            interval: 9,
            v: 1e-9,
            a: -1e-3,
            rests: 0,
            rate,
            feed_factor: 0.5,
        });
        horizon.advance().expect("plan");
        assert_eq!(
            horizon.sink.replies.pop(),
            Some(ReplanReply { id: 1, step: None })
        );
    }
}

#[test]
fn an_impossible_request_keeps_the_solved_window() {
    let lines = MAX_INTERVALS as u32 / 10 + 5;
    let mut undisturbed = horizon(lines);
    undisturbed.rest(Step::End { line: 1 });
    undisturbed.advance().expect("plan");
    for lookups in 0..4 {
        let mut horizon = horizon(lines);
        horizon.rest(Step::End { line: 1 });
        horizon.sink.lookups = lookups;
        horizon.sink.request = Some(ReplanRequest {
            id: 1,
            step: 0,
            segment: 0,
            offset: 5.0,
            interval: 4,
            v: 1e6,
            a: 0.0,
            rests: 0,
            rate: 1.0,
            feed_factor: 1.0,
        });
        horizon.advance().expect("plan");
        assert_eq!(horizon.sink.replies, [ReplanReply { id: 1, step: None }]);
        let (steps, expected) = (&horizon.sink.recorder.steps, &undisturbed.sink.recorder.steps);
        assert!(steps == expected, "asked at look {lookups}");
    }
}

#[test]
fn a_planning_failure_reports_its_line() {
    let mut horizon = horizon(5);
    assert_eq!(horizon.failed_at(), None);
    horizon.failures = MAX_FAILURES + 1;
    horizon.frontier.position.interval = horizon.grid.end() - 1;
    assert_eq!(horizon.failed_at(), Some(4));
    horizon.frontier.position.interval = horizon.grid.end();
    assert_eq!(horizon.failed_at(), Some(0));
}
