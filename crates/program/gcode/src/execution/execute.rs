//! Executes a line in the order of RS274/NGC, table 8, as LinuxCNC does.

mod periphery;
mod tools;

use std::collections::VecDeque;

use evolvent_path::AxisLetter;

pub(crate) use self::tools::ToolChangeCall;
use crate::codes::modal_groups::{FeedMode, GCode, Group, MCode, Motion, NonModal, PathControl};
use crate::diagnostics::diagnostic::{Fault, Span};
use crate::execution::compensation::ChangedCommand;
use crate::execution::contour_checker::ContourChecker;
use crate::execution::cycles::roughing::RoughCall;
use crate::parameters::values::{Parameters, WORK_OFFSET};
use crate::state::machine_state::{ProgrammedFeed, ProgrammedSpeed, State};
use crate::syntax::statement::Statement;
use crate::{
    Action, CallChain, CanonicalCommand, Code, Origin, PathMode, SPINDLES, Settings, SpindleDirection,
    ToolTable,
};

/// Maximum number of commands that wait for cutter compensation or that one line produces: a few hundred
/// megabytes.
pub(crate) const MAX_HELD_COMMANDS: usize = 1_000_000;

/// Integral duration from which a dwell is probably meant in milliseconds. Tuned: spindles reach their speed
/// within a minute, and dialects with milliseconds rarely dwell less than 100 of them.
const MIN_SUSPICIOUS_DWELL_S: f64 = 100.0;

/// Everything that a line can change.
pub(crate) struct Executor<'a> {
    pub(crate) state: &'a mut State,
    pub(crate) line: &'a Statement,
    pub(crate) settings: &'a Settings,
    pub(crate) tools: &'a mut Option<ToolTable>,
    pub(crate) parameters: &'a mut Parameters,
    /// Control points of a NURBS: X, Y in mm of program coordinates, and weight.
    pub(crate) control_points: &'a mut Vec<[f64; 3]>,
    pub(crate) commands: &'a mut VecDeque<CanonicalCommand>,
    /// Commands that cutter compensation has changed.
    pub(crate) changed: &'a mut Vec<ChangedCommand>,
    /// Contours whose parts may be too close to each other.
    pub(crate) contour_checker: &'a mut ContourChecker,
    /// Skips an M2 or M30 that is reached or not depending on an assumed contact.
    pub(crate) skips_end: bool,
    /// Line number for commands.
    pub(crate) number: u32,
    /// The line if it is in a subroutine file.
    pub(crate) origin: Option<Origin>,
    /// The calls that led to it.
    pub(crate) calls: CallChain,
}

/// A request of a line to the control flow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Request {
    /// M98.
    Call { number: u32, times: u32, span: Span },
    /// M99.
    Return,
    /// M70 to M73.
    Modes(MCode),
    /// G70 to G72.2: the profile has to be read from a subroutine first.
    Profile(RoughCall),
    /// M6 by a subroutine.
    ToolChange(ToolChangeCall, Span),
}

impl Executor<'_> {
    #[inline]
    pub(crate) fn emit(&mut self, action: Action) {
        self.commands.push_back(CanonicalCommand {
            line: self.number,
            action,
            origin: self.origin.clone(),
            calls: self.calls.clone(),
            feed_mm_rev: None,
            feed_spindle: 0,
            continues: false,
        });
    }

    /// Executes the line.
    pub(crate) fn run(&mut self) -> Result<Option<Request>, Fault> {
        let line = self.line;
        if let Some(GCode::FeedMode(mode)) = line.g(Group::FeedMode) {
            // The preamble of an MDI block does not change it.
            let is_restored = self.number <= self.settings.preamble.lines && self.calls.is_empty();
            let modes = &mut self.state.modes;
            if !is_restored {
                modes.active_spindle = line.spindle();
            }
            let spindle = if mode == FeedMode::PerRevolution {
                line.spindle()
            } else {
                0
            };
            if (mode, spindle) != (modes.feed_mode, modes.feed_spindle) {
                // The meaning of F changes.
                (modes.feed_mode, modes.feed_spindle) = (mode, spindle);
                modes.feed = None;
            }
        }
        if let Some(feed) = line.word(b'F') {
            self.set_feed(feed)?;
        }
        let mut request = None;
        if self.has_periphery() {
            request = self.periphery()?;
        }
        if let (Some(NonModal::Dwell), Some(seconds)) = (line.non_modal(), line.word(b'P')) {
            self.warn_of_dwell("G4", seconds);
            self.emit(Action::Dwell { seconds });
        }
        self.modes()?;
        self.data()?;
        if let Some(motion) = line.motion_code() {
            self.state.motion = motion;
        }
        if !matches!(self.state.motion, Motion::Cycle(_)) {
            self.state.cycle.active = None;
        }
        let mut subroutine_call = self.subroutine_call()?;
        self.update_surface_centre();
        if let Some(motion) = line.motion() {
            self.motion(motion)?;
            if let Motion::Rough(rough) = motion {
                if subroutine_call.is_some() {
                    let message = format!("{} and a call on one line", motion.name());
                    return Err(Fault::new(Code::TwoUsers, line.motion_span(), message)
                        .help("write them on two lines"));
                }
                subroutine_call = Some(self.roughing(rough)?);
            }
        } else if line.motion_code() == Some(Motion::None) {
            self.state.cycle.active = None;
        } else if line.non_modal() == Some(NonModal::MachineCoordinates) {
            let span = line.group_span(Group::NonModal);
            return Err(
                Fault::new(Code::MachineCoordinatesMotion, span, "G53 needs G0 or G1")
                    .help("write G53 G0 X.. or G53 G1 X.. on one line; delete G53 if the line moves nothing"),
            );
        }
        self.stop();
        Ok(subroutine_call.or(request))
    }

    /// Warns of a dwell that is probably meant in milliseconds.
    pub(crate) fn warn_of_dwell(&mut self, code: &str, seconds: f64) {
        if seconds >= MIN_SUSPICIOUS_DWELL_S && seconds.fract() == 0.0 {
            self.emit(Action::Warning(format!(
                "{code} P{seconds} waits {seconds} seconds, because P is in seconds in this dialect; \
                 {seconds} milliseconds are P{}",
                seconds / 1000.0
            )));
        }
    }

    /// M98, M99.
    fn subroutine_call(&self) -> Result<Option<Request>, Fault> {
        let line = self.line;
        match line.m(Group::Stop) {
            Some(MCode::Call) => {
                let span = line.group_span(Group::Stop);
                let Some(number) = line.integer(b'P')? else {
                    return Err(Fault::new(
                        Code::WordMissing,
                        span,
                        "M98 needs P, the number of the subroutine",
                    ));
                };
                let times = line.integer(b'L')?.unwrap_or(1);
                Ok(Some(Request::Call { number, times, span }))
            }
            Some(MCode::Return) => Ok(Some(Request::Return)),
            _ => Ok(None),
        }
    }

    fn stop(&mut self) {
        let stop = |optional, pallet| Action::ProgramStop { optional, pallet };
        match self.line.m(Group::Stop) {
            None | Some(MCode::Call | MCode::Return) => {}
            Some(MCode::Stop) => self.emit(stop(false, false)),
            Some(MCode::OptionalStop) => self.emit(stop(true, false)),
            Some(MCode::PalletStop) => self.emit(stop(false, true)),
            Some(_) if self.skips_end => {}
            Some(_) => self.end(),
        }
    }

    /// The end of an MDI block: spindle and coolant keep their state.
    pub(crate) fn end_mdi(&mut self) {
        self.end_compensation();
        self.state.ended = true;
        self.emit(Action::ProgramEnd);
    }

    /// M2: spindle and coolant off, back to G54, then the end.
    pub(crate) fn end(&mut self) {
        self.end_compensation();
        if self.state.nurbs_order.is_some() {
            self.emit(Action::Warning(
                "the program ends between G5.2 and G5.3, so its last NURBS is not executed; write G5.3 at \
                 the end of it"
                    .to_owned(),
            ));
        }
        if self.state.modes.work_index != 0 {
            self.select_work(0);
        }
        let modes = &mut self.state.modes;
        let has_coolant = modes.mist || modes.flood;
        (modes.mist, modes.flood) = (false, false);
        for number in 0..SPINDLES {
            let spindle = &mut self.state.modes.spindles[number];
            // This also releases an oriented spindle.
            let is_active = spindle.is_rotating() || spindle.orientation.is_some();
            spindle.direction = SpindleDirection::Stopped;
            // The following program starts in G97, where metres per minute are not a speed; an MDI block
            // takes the speed from the outputs.
            let is_surface = spindle.speed.is_surface();
            if is_surface {
                spindle.speed = ProgrammedSpeed::Rpm(0.0);
            }
            if is_active || is_surface {
                self.emit_spindle(number);
            }
        }
        if has_coolant {
            self.emit(Action::Coolant {
                mist: false,
                flood: false,
            });
        }
        self.state.ended = true;
        self.emit(Action::ProgramEnd);
    }

    fn select_work(&mut self, index: usize) {
        self.state.modes.work_index = index;
        self.parameters.set_numbered(WORK_OFFSET, (index + 1) as f64);
        self.state.load_work(self.parameters);
    }

    fn set_feed(&mut self, feed: f64) -> Result<(), Fault> {
        let unit = self.state.unit_mm();
        if self.line.motion() == Some(Motion::Thread) || self.line.motion() == Some(Motion::RigidTap) {
            let message = "F with G33: the pitch K and the spindle give the feed";
            return Err(Fault::new(Code::UnusedWord, self.line.span(b'F'), message).help("leave F out"));
        }
        if matches!(
            self.line.motion(),
            Some(Motion::FanucThread | Motion::FanucThreadCycle)
        ) {
            // F is the lead of this thread, not a feed.
            return Ok(());
        }
        self.state.fanuc_thread.clear_lead();
        self.state.modes.feed = match self.state.modes.feed_mode {
            // F is valid for its own line only.
            FeedMode::InverseTime => None,
            FeedMode::PerMinute => Some(ProgrammedFeed::PerMinute {
                word: feed,
                linear_mm_s: feed * unit / 60.0,
            }),
            FeedMode::PerRevolution => Some(ProgrammedFeed::PerRevolution {
                word: feed,
                linear_mm_rev: feed * unit,
            }),
        };
        Ok(())
    }

    fn overrides(&mut self) -> Result<(), Fault> {
        let line = self.line;
        let Some(code) = line.m(Group::Override) else {
            return Ok(());
        };
        let on = line.word(b'P').is_none_or(|p| p != 0.0);
        let modes = &mut self.state.modes;
        match code {
            MCode::Overrides(on) => (modes.feed_override, modes.spindle_override) = (on, [on; SPINDLES]),
            MCode::FeedOverride => modes.feed_override = on,
            MCode::SpindleOverride if line.has(b'$') => modes.spindle_override[line.spindle()] = on,
            MCode::SpindleOverride => modes.spindle_override = [on; SPINDLES],
            MCode::AdaptiveFeed => modes.adaptive = Some(on),
            _ => modes.feed_stop = on,
        }
        self.emit_overrides(None);
        Ok(())
    }

    pub(crate) fn emit_overrides(&mut self, cycle: Option<&'static str>) {
        let modes = self.state.modes;
        self.emit(Action::Overrides {
            feed: modes.feed_override,
            spindles: modes.spindle_override,
            adaptive: modes.adaptive,
            feed_stop: modes.feed_stop,
            cycle,
        });
    }

    fn modes(&mut self) -> Result<(), Fault> {
        let line = self.line;
        if !line.has_g_modes() {
            return Ok(());
        }
        if let Some(GCode::Plane(plane)) = line.g(Group::Plane) {
            if self.state.cutter.is_on() && self.state.modes.plane != plane {
                let span = line.group_span(Group::Plane);
                return Err(Fault::new(
                    Code::CompensationActive,
                    span,
                    "a change of plane while cutter compensation is on",
                )
                .help("write G40 first"));
            }
            self.state.modes.plane = plane;
        }
        if let Some(GCode::Inches(inches)) = line.g(Group::Units) {
            self.state.modes.inches = inches;
        }
        // Before the codes that read X words.
        if let Some(GCode::Diameter(diameter)) = line.g(Group::Diameter) {
            self.state.modes.diameter = diameter;
        }
        if let Some(code) = line.compensation() {
            self.compensation(code)?;
        }
        self.length_offset()?;
        if let Some(GCode::WorkOffset(index)) = line.g(Group::WorkOffset) {
            if self.state.cutter.is_on() && index != self.state.modes.work_index {
                let span = line.group_span(Group::WorkOffset);
                return Err(Fault::new(
                    Code::CompensationActive,
                    span,
                    "a change of work offset while cutter compensation is on",
                )
                .help("write G40 first"));
            }
            self.select_work(index);
        }
        let unit = self.state.unit_mm();
        let modes = &mut self.state.modes;
        if let Some(GCode::Path(control)) = line.g(Group::PathControl) {
            modes.path_mode = match control {
                PathControl::ExactPath => PathMode::ExactPath,
                PathControl::ExactStop => PathMode::ExactStop,
                PathControl::Blend => PathMode::Blend {
                    tolerance_mm: line.word(b'P').map(|p| p * unit),
                    merge_mm: line.word(b'Q').map(|q| q * unit),
                },
            };
        }
        if let Some(GCode::Incremental(incremental)) = line.g(Group::Distance) {
            modes.incremental = incremental;
        }
        if let Some(GCode::ArcCentreAbsolute(absolute)) = line.g(Group::ArcDistance) {
            modes.arc_centre_absolute = absolute;
        }
        if let Some(GCode::RetractToInitial(to_initial)) = line.g(Group::Retract) {
            modes.retract_to_initial = to_initial;
        }
        Ok(())
    }

    /// Executes the motion of the line.
    fn motion(&mut self, motion: Motion) -> Result<(), Fault> {
        if self.line.has(b'$') && motion.uses_spindle() {
            self.state.modes.active_spindle = self.line.spindle();
        }
        if motion != Motion::CubicSpline {
            self.state.spline_end = None;
        }
        if motion != Motion::FanucThreadCycle {
            self.state.fanuc_thread.end_cycle();
        }
        if self.state.nurbs_order.is_some() && !matches!(motion, Motion::Nurbs | Motion::NurbsEnd) {
            let message = format!("{} between G5.2 and G5.3", motion.name());
            return Err(Fault::new(Code::SplineOpen, self.line.motion_span(), message)
                .help("write G5.3 at the end of the NURBS"));
        }
        if self.line.non_modal() == Some(NonModal::MachineCoordinates)
            && !matches!(motion, Motion::Rapid | Motion::Linear)
        {
            let span = self.line.group_span(Group::NonModal);
            return Err(
                Fault::new(Code::MachineCoordinatesMotion, span, "G53 needs G0 or G1")
                    .help("write G53 G0 X.. or G53 G1 X.. on one line"),
            );
        }
        if self.state.cutter.is_on() && !matches!(motion, Motion::Rapid | Motion::Linear | Motion::Arc(_)) {
            let message = format!("{} while cutter compensation is on", motion.name());
            return Err(
                Fault::new(Code::CompensationActive, self.line.motion_span(), message)
                    .help("write G40 first"),
            );
        }
        match motion {
            Motion::Rapid | Motion::Linear => self.straight(motion),
            Motion::Arc(sense) => self.arc(sense),
            Motion::Involute(sense) => self.involute(sense),
            Motion::CubicSpline => self.cubic_spline(),
            Motion::QuadraticSpline => self.quadratic_spline(),
            Motion::Nurbs => self.control_point(),
            Motion::NurbsEnd => self.nurbs(),
            Motion::Hole(sense) => self.hole(sense),
            Motion::Thread => self.thread(),
            Motion::FanucThread => self.fanuc_thread(),
            Motion::FanucThreadCycle => self.fanuc_thread_cycle(),
            Motion::RigidTap => self.rigid_tap(),
            Motion::Probe { toward, must } => self.probe(toward, must),
            Motion::Cycle(cycle) => self.cycle(cycle),
            Motion::ThreadCycle => self.thread_cycle(),
            Motion::Turning(turning) => self.turning(turning),
            // It continues when its profile has been read.
            Motion::Rough(_) | Motion::None => Ok(()),
        }
    }

    /// The error of a cycle, spline or arc in a plane that does not support it.
    pub(crate) fn wrong_plane(&self, what: &str) -> Fault {
        let message = format!("{what} is not available in the active plane");
        Fault::new(Code::WrongPlane, self.line.motion_span(), message)
            .help("select the plane with G17, G18 or G19")
    }

    pub(crate) fn allow_only_axes(&self, allowed: &[u8], what: &str) -> Result<(), Fault> {
        for axis in AxisLetter::ALL {
            let letter = axis.letter() as u8;
            if self.line.has(letter) && !allowed.contains(&letter) {
                let message = format!("{} cannot be combined with {what}", axis.letter());
                return Err(Fault::new(Code::UnusedWord, self.line.span(letter), message));
            }
        }
        Ok(())
    }
}
