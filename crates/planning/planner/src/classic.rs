//! The classic planner: quintic blends at corners, and look-ahead over runs.
//!
//! The fallback planner, and the reference for comparison with the time-optimal one.

use evolvent_path::{Curve, JointKind, JointLimits, Move, MoveKind, PathMode, classify_joint};

use crate::corner::round_corner;
use crate::lookahead::Lookahead;
use crate::move_validator::check_travel;
use crate::planner::PathRules;
use crate::step::{PlanSink, Segment, SegmentMarks, Step};
use evolvent_timing::PathLimits;

/// Minimum length of a segment, parameter units; shorter ones are rounding.
const MIN_LENGTH: f64 = 1e-12;

/// The last move, whose end is not planned yet.
#[derive(Clone, Copy, Debug)]
struct OpenMove {
    motion: Move,
    line: u32,
    block: u32,
    /// Parameter from which it is not planned yet.
    from: f64,
    /// Whether it starts at a joint that is not smooth.
    joint: bool,
}

/// Plans one program: joins moves and looks ahead.
#[derive(Debug)]
pub(crate) struct Classic<S> {
    ahead: Lookahead<S>,
    rules: PathRules,
    held: Option<OpenMove>,
    deviation: f64,
}

impl<S: PlanSink> Classic<S> {
    /// Starts at rest at the beginning of the first move.
    pub(crate) fn new(limits: PathLimits, rules: PathRules, sink: S) -> Self {
        Self {
            ahead: Lookahead::new(limits, sink),
            rules,
            held: None,
            deviation: 0.0,
        }
    }

    /// The sink of the plan.
    pub(crate) fn sink(&self) -> &S {
        self.ahead.sink()
    }

    /// The sink of the plan.
    pub(crate) fn sink_mut(&mut self) -> &mut S {
        self.ahead.sink_mut()
    }

    /// Maximum distance so far between blends and the programmed path, mm.
    pub(crate) fn deviation_mm(&self) -> f64 {
        self.deviation
    }

    /// Appends a move that starts at the end of the last one.
    ///
    /// # Errors
    /// Those of the sink.
    pub(crate) fn push(&mut self, motion: &Move, line: u32, block: u32) -> Result<(), S::Error> {
        let next = OpenMove {
            motion: *motion,
            line,
            block,
            from: 0.0,
            joint: false,
        };
        match self.held.take() {
            Some(held) => self.join(held, next),
            None => {
                self.held = Some(next);
                Ok(())
            }
        }
    }

    /// Stops the path and appends a step at rest.
    ///
    /// # Errors
    /// Those of the sink.
    pub(crate) fn rest(&mut self, step: &Step) -> Result<(), S::Error> {
        self.flush()?;
        self.ahead.rest(step)
    }

    /// Stops the path; everything planned becomes final.
    ///
    /// # Errors
    /// Those of the sink.
    pub(crate) fn finish(&mut self, line: u32) -> Result<(), S::Error> {
        self.flush()?;
        self.ahead.finish(line)
    }

    /// Plans the rest of the open move and stops at its end.
    fn flush(&mut self) -> Result<(), S::Error> {
        if let Some(held) = self.held.take() {
            self.emit(&held, held.motion.curve.domain())?;
            self.ahead.boundary(0.0)?;
        }
        Ok(())
    }

    fn join(&mut self, held: OpenMove, mut next: OpenMove) -> Result<(), S::Error> {
        let (left, right) = (&held.motion.curve, &next.motion.curve);
        let (end, start) = (left.jet(left.domain()), right.jet(0.0));
        let limits = *self.ahead.limits().axes();
        let joint_limits = JointLimits {
            present: limits.present,
            jerk: limits.jerk,
            joint_time_s: self.rules.joint_time_s,
        };
        let kind = classify_joint(&end, &start, &joint_limits);
        let stop = matches!(held.motion.path_mode, PathMode::ExactStop);
        let mut cap = f64::INFINITY;
        if stop {
            cap = 0.0;
        } else if kind != JointKind::Smooth {
            if let Some(tolerance) = self.tolerance(&held.motion, &next.motion) {
                let max_half = (0.5 * left.domain())
                    .min(left.domain() - held.from)
                    .min(0.5 * right.domain());
                if let Some(rounding) = round_corner(left, right, tolerance, max_half) {
                    let within = check_travel::<()>(&Curve::Blend(rounding.blend), &limits).is_ok();
                    if within {
                        self.emit(&held, left.domain() - rounding.trim)?;
                        let feed = held.motion.feed_mm_s.min(next.motion.feed_mm_s);
                        let marks = SegmentMarks {
                            blend: true,
                            rapid: feed.is_infinite(),
                            joint: false,
                        };
                        let segment = Segment {
                            curve: Curve::Blend(rounding.blend),
                            from: 0.0,
                            length: 2.0 * rounding.trim,
                            line: next.line,
                            block: next.block,
                            marks,
                        };
                        self.ahead.segment(segment, feed)?;
                        self.deviation = self.deviation.max(rounding.deviation);
                        next.from = rounding.trim;
                        self.held = Some(next);
                        return Ok(());
                    }
                }
            }
            cap = kind.max_speed();
            next.joint = cap > 0.0;
        }
        self.emit(&held, left.domain())?;
        if cap.is_finite() {
            self.ahead.boundary(cap)?;
        }
        self.held = Some(next);
        Ok(())
    }

    /// The tolerance of the corner between two moves, if both permit rounding.
    fn tolerance(&self, left: &Move, right: &Move) -> Option<f64> {
        let of = |motion: &Move| match motion.path_mode {
            PathMode::Blend { tolerance_mm, .. } => {
                Some(tolerance_mm.unwrap_or(self.rules.blend_tolerance_mm))
            }
            PathMode::ExactPath | PathMode::ExactStop => None,
        };
        let min = of(left)?.min(of(right)?);
        (min > 0.0).then_some(min)
    }

    fn emit(&mut self, held: &OpenMove, to: f64) -> Result<(), S::Error> {
        let length = to - held.from;
        if length.is_nan() || length <= MIN_LENGTH {
            return Ok(());
        }
        let rapid = matches!(held.motion.kind, MoveKind::Rapid);
        let marks = SegmentMarks {
            blend: false,
            rapid,
            joint: held.joint,
        };
        let (line, block) = (held.line, held.block);
        let segment = Segment {
            curve: held.motion.curve,
            from: held.from,
            length,
            line,
            block,
            marks,
        };
        self.ahead.segment(segment, held.motion.feed_mm_s)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::expect_used, reason = "a test may fail")]

    use std::convert::Infallible;

    use evolvent_path::{Axes, Line};

    use evolvent_machine::PlannerKind;
    use evolvent_path::AxisLetter;

    use super::*;
    use crate::recorder::{Recorder, equal_axes, point};
    use crate::{PlanError, Planner};

    const RULES: PathRules = PathRules {
        blend_tolerance_mm: 0.05,
        joint_time_s: 0.002,
        planner: PlannerKind::Classic,
        feed_override: 1.0,
    };

    fn planner() -> Planner<Recorder> {
        let limits = PathLimits::new(equal_axes(500.0, 2000.0, 50_000.0), 1000.0, 1e-3);
        Planner::new(limits, RULES, Recorder::default())
    }

    fn line(from: Axes, to: Axes, path_mode: PathMode) -> Move {
        Move {
            curve: Curve::Line(Line::new(from, to).expect("line")),
            kind: MoveKind::Feed,
            feed_mm_s: 100.0,
            path_mode,
        }
    }

    /// Right, then up, planned in the two modes.
    fn corner(first: PathMode, second: PathMode) -> Planner<Recorder> {
        let mut planner = planner();
        let moves = [
            line(point(0.0, 0.0), point(20.0, 0.0), first),
            line(point(20.0, 0.0), point(20.0, 20.0), second),
        ];
        for (k, one) in moves.iter().enumerate() {
            planner.push(one, 10 + k as u32, k as u32).expect("plan");
        }
        planner.finish(12).expect("finish");
        planner
    }

    #[test]
    fn a_rejected_move_leaves_the_plan_unchanged() {
        type Error = PlanError<Infallible>;
        let mut planner = planner();
        let start = line(point(0.0, 0.0), point(20.0, 0.0), PathMode::ExactPath);
        planner.push(&start, 1, 0).expect("plan");
        let beyond = line(point(20.0, 0.0), point(20.0, 10_000.5), PathMode::ExactPath);
        assert!(
            matches!(planner.push(&beyond, 2, 1), Err(Error::Travel { axis: AxisLetter::Y, reached, limit })
                if (reached - 10_000.5).abs() < 1e-9 && (limit - 1e4).abs() < 1e-9)
        );
        let below = line(point(20.0, 0.0), point(-10_000.5, 0.0), PathMode::ExactPath);
        assert!(
            matches!(planner.push(&below, 2, 1), Err(Error::Travel { axis: AxisLetter::X, reached, limit })
                if (reached + 10_000.5).abs() < 1e-9 && (limit + 1e4).abs() < 1e-9)
        );
        for feed in [0.0, -1.0, f64::NAN] {
            let still = Move {
                feed_mm_s: feed,
                ..start
            };
            assert!(
                matches!(planner.push(&still, 2, 1), Err(Error::Feed { .. })),
                "{feed}"
            );
        }
        let apart = line(point(20.0, 2e-6), point(30.0, 0.0), PathMode::ExactPath);
        assert!(
            matches!(planner.push(&apart, 2, 1), Err(Error::Gap { axis: AxisLetter::Y, distance })
                if (distance - 2e-6).abs() < 1e-15)
        );
        // Exactly to the limit, from within rounding of the end of the last move.
        let last = line(point(20.0, 5e-7), point(1e4, 0.0), PathMode::ExactPath);
        planner.push(&last, 2, 1).expect("within travel");
        planner.finish(3).expect("finish");
        let blocks: Vec<u32> = planner.sink().segments.iter().map(|s| s.block).collect();
        assert_eq!(blocks, [0, 1]);
    }

    #[test]
    fn an_absent_axis_has_no_travel() {
        let mut limits = equal_axes(500.0, 2000.0, 50_000.0);
        limits.present[1] = false;
        let limits = PathLimits::new(limits, 1000.0, 1e-3);
        let mut planner = Planner::new(limits, RULES, Recorder::default());
        let far = line(point(0.0, 0.0), point(0.0, 20_000.0), PathMode::ExactPath);
        planner.push(&far, 1, 0).expect("plan");
    }

    #[test]
    fn exact_stop_mode_stops_at_collinear_joints() {
        for (mode, stops) in [(PathMode::ExactStop, true), (PathMode::ExactPath, false)] {
            let mut planner = planner();
            for k in 0..4 {
                let x = 50.0 * f64::from(k);
                let one = line(point(x, 0.0), point(x + 50.0, 0.0), mode);
                planner.push(&one, k, k).expect("plan");
            }
            planner.finish(9).expect("finish");
            let plan = planner.sink();
            let inner: Vec<f64> = plan
                .runs()
                .iter()
                .map(|run| run.2)
                .take(plan.runs().len() - 1)
                .collect();
            assert!(inner.iter().all(|&exit| if stops {
                exit == 0.0
            } else {
                (exit - 100.0).abs() < 1e-9
            }));
            assert!(!inner.is_empty(), "one run contains everything");
        }
    }

    #[test]
    fn exact_corners_stop_and_near_tangent_joints_do_not() {
        let sharp = corner(PathMode::ExactPath, PathMode::ExactPath);
        let runs = sharp.sink().runs();
        assert_eq!((runs.len(), runs[0].2), (2, 0.0));
        assert!(!sharp.sink().segments[1].marks.joint);

        // Y's velocity steps by 0.005 of the speed, which J t^2 / 2 = 0.1 mm/s compensates: 20 mm/s.
        let mut planner = planner();
        let turn = 0.005_f64.asin();
        let end = point(20.0 + 20.0 * turn.cos(), 20.0 * turn.sin());
        planner
            .push(
                &line(point(0.0, 0.0), point(20.0, 0.0), PathMode::ExactPath),
                10,
                0,
            )
            .expect("plan");
        planner
            .push(&line(point(20.0, 0.0), end, PathMode::ExactPath), 11, 1)
            .expect("plan");
        planner.finish(12).expect("finish");
        let plan = planner.sink();
        let runs = plan.runs();
        assert_eq!(runs.len(), 2);
        assert!((runs[0].2 - 20.0).abs() < 1e-6, "{}", runs[0].2);
        assert!(plan.segments[1].marks.joint && !plan.segments[0].marks.joint);
        assert_eq!(planner.deviation_mm(), 0.0);
    }

    #[test]
    fn corners_are_blended_if_both_moves_permit_it() {
        let blend = |tolerance_mm| PathMode::Blend {
            tolerance_mm,
            merge_mm: None,
        };
        let (fine, coarse) = (blend(Some(0.01)), blend(Some(0.4)));
        for (first, second, tolerance) in [
            (fine, coarse, 0.01),
            (coarse, fine, 0.01),
            (blend(None), coarse, 0.05),
            (blend(None), fine, 0.01),
        ] {
            let planner = corner(first, second);
            let segments = &planner.sink().segments;
            assert_eq!(segments.len(), 3);
            let (before, middle, after) = (&segments[0], &segments[1], &segments[2]);
            assert!(middle.marks.blend && !before.marks.blend && !after.marks.blend);
            // The middle of the blend is 3/16 h sqrt(2) from the corner.
            let h = 0.5 * middle.length;
            let off = (middle.jet(h).position - point(20.0, 0.0)).norm();
            assert!((off - 3.0 / 16.0 * h * 2.0_f64.sqrt()).abs() < 1e-9);
            assert!(off <= tolerance && off > 0.9 * tolerance, "{off} of {tolerance}");
            assert!((planner.deviation_mm() - off).abs() < 1e-9);
            // The remaining lines meet the blend, and the total length is unchanged.
            assert!((before.length - (20.0 - h)).abs() < 1e-12 && (after.length - (20.0 - h)).abs() < 1e-12);
            assert!((after.from - h).abs() < 1e-12 && before.from == 0.0);
            assert!((before.jet(before.length).position - middle.jet(0.0).position).amax() < 1e-12);
            assert!((middle.jet(2.0 * h).position - after.jet(0.0).position).amax() < 1e-12);
            assert_eq!((before.block, middle.block, after.block), (0, 1, 1));
            assert_eq!((before.line, middle.line, after.line), (10, 11, 11));
            assert!(!middle.marks.rapid);
        }
        for (first, second) in [
            (coarse, PathMode::ExactPath),
            (PathMode::ExactPath, coarse),
            (PathMode::ExactStop, coarse),
            (blend(Some(0.0)), coarse),
        ] {
            let planner = corner(first, second);
            assert_eq!(planner.sink().segments.len(), 2);
            assert_eq!(
                planner.sink().runs()[0].2,
                0.0,
                "a corner that is not blended is a stop"
            );
        }
    }

    #[test]
    fn blends_take_at_most_half_of_each_move() {
        let mode = PathMode::Blend {
            tolerance_mm: Some(5.0),
            merge_mm: None,
        };
        let mut planner = planner();
        let mut at = point(0.0, 0.0);
        for k in 0..6_u32 {
            let to = at
                + if k % 2 == 0 {
                    point(1.0, 0.0)
                } else {
                    point(0.0, 1.0)
                };
            planner.push(&line(at, to, mode), k, k).expect("plan");
            at = to;
        }
        planner.finish(9).expect("finish");
        let segments = &planner.sink().segments;
        let total: f64 = segments.iter().map(|one| one.length).sum();
        assert!((total - 6.0).abs() < 1e-12, "{total}");
        for one in segments.iter().filter(|one| one.marks.blend) {
            assert!((one.length - 1.0).abs() < 1e-12, "{}", one.length);
        }
        assert_eq!(segments.iter().filter(|one| one.marks.blend).count(), 5);
    }

    #[test]
    fn steps_at_rest_are_in_order() {
        let mut planner = planner();
        let dwell = Step::Dwell {
            seconds: 0.5,
            line: 2,
        };
        let there = line(point(0.0, 0.0), point(20.0, 0.0), PathMode::ExactPath);
        let on = line(point(20.0, 0.0), point(40.0, 0.0), PathMode::ExactPath);
        planner.push(&there, 1, 0).expect("plan");
        planner.rest(&dwell).expect("rest");
        planner.push(&on, 3, 1).expect("plan");
        planner.finish(4).expect("finish");
        let plan = planner.sink();
        assert!(matches!(
            plan.steps[..],
            [
                Step::Run(_),
                Step::Dwell { .. },
                Step::Run(_),
                Step::End { line: 4 }
            ]
        ));
        assert!(plan.exits.iter().all(|exit| *exit == crate::ExitSpeeds::REST));
        assert_eq!(plan.committed, 4);
    }
}
