//! The status of a run: one program, and no operator.

use std::sync::Arc;
use std::sync::mpsc::Receiver;

use evolvent_bus::{EventKind, Feedback, Setpoint, Status};
use evolvent_drive::FeedbackBounds;
use evolvent_gcode::{Interpreter, Modal, SPINDLES};
use evolvent_machine::SignalSettings;
use evolvent_motion::MotionState;
use evolvent_path::{Axes, AxisMask, angle_within_turn};

use crate::block_track::BlockTrack;
use crate::drive_report::DriveReport;
use crate::drives::feedback_bounds;
use crate::due_setpoint::DueSetpoint;
use crate::job::Job;
use crate::joined_messages::{is_same_stop, joined};
use crate::news::FeederEvent;
use crate::periphery::Periphery;
use crate::publishing::Publishing;
use crate::rt::MonotonicClock;
use crate::shared::Controls;
use crate::spindle_command::shown_rpm;
use crate::status_source::{StatusPort, StatusSource, event_of, show_feedback, show_modal};

/// Numbers in [`evolvent_bus::MACHINE_STATES`] and [`evolvent_bus::ACTIVITIES`], and of the power, of a
/// machine that runs a program.
const READY: u32 = 2;
const PROGRAM: u32 = 1;
const POWER_ON: u32 = 1;

/// Makes the status of a run.
pub(crate) struct RunStatus {
    status: Status,
    /// The last published setpoint.
    last: Setpoint,
    /// The same as planned, once there is one.
    planned: Option<evolvent_motion::Setpoint>,
    /// The setpoint of the last message.
    stop: Option<evolvent_motion::Setpoint>,
    /// The planner's reports, and the blocks ahead.
    news: Receiver<FeederEvent>,
    track: BlockTrack,
    modal: Modal,
    state: MotionState,
    has_started: bool,
    controls: Arc<Controls>,
    signals: SignalSettings,
    bounds: FeedbackBounds,
    /// The newest plausible feedback.
    feedback: Option<Feedback>,
    /// The correction of the last setpoint for the errors of the machine.
    shift: Axes,
    /// Unlimited rotary axes.
    unlimited: AxisMask,
}

impl RunStatus {
    /// For this job, before its first setpoint; `news` is what its planner reports.
    pub(crate) fn new(job: &Job, publishing: &Publishing, news: Receiver<FeederEvent>) -> Self {
        let mut status = Status {
            machine_state: READY,
            activity: PROGRAM,
            power: POWER_ON,
            axes_mask: publishing.axes_mask,
            rapid_override_ratio: 1.0,
            spindle_override_ratio: 1.0,
            feedback_age_ns: u64::MAX,
            ..Status::default()
        };
        status.set_program(&job.program.display().to_string());
        let controls = Arc::clone(&publishing.controls);
        Self {
            status,
            last: Setpoint {
                period_ns: publishing.config.period_ns,
                position: job.setup.machine.limits().home.into(),
                override_ratio: controls.feed_override(),
                ..Setpoint::default()
            },
            planned: None,
            stop: None,
            news,
            track: BlockTrack::default(),
            modal: Interpreter::new(&b""[..], job.setup.interpreter_settings()).modal(),
            state: MotionState::Idle,
            has_started: false,
            controls,
            signals: job.setup.machine.signals.clone(),
            bounds: feedback_bounds(&job.setup.machine),
            feedback: None,
            shift: Axes::zeros(),
            unlimited: job.setup.machine.unlimited(),
        }
    }

    /// Writes the commanded spindle speed at the present position of the axes.
    fn show_speed(&mut self, periphery: &Periphery) {
        let x_mm = self.last.position[0];
        self.status.spindle_rpm = shown_rpm(&periphery.outputs, x_mm, &[1.0; SPINDLES], &self.signals);
    }

    /// Shows a message of the program, after those before it at the same stop.
    fn pass_on(&mut self, text: &str, setpoint: &evolvent_motion::Setpoint) {
        let is_same = (self.stop.as_ref()).is_some_and(|before| is_same_stop(before, setpoint));
        let before = if is_same {
            self.status.operator_message()
        } else {
            ""
        };
        let whole = joined(before, text).unwrap_or_else(|| text.to_owned());
        self.status.set_message(&whole);
        self.stop = Some(*setpoint);
    }

    fn show(&mut self, periphery: &Periphery) {
        let status = &mut self.status;
        status.coolant = periphery.coolant_bits();
        status.tool = periphery.tool;
        (status.tool_change, status.tool_wanted) = periphery.change_numbers();
    }
}

impl StatusSource for RunStatus {
    fn begin(&mut self, port: &mut StatusPort<'_>) {
        self.show(port.periphery);
        self.refresh(port);
    }

    fn follow(
        &mut self,
        port: &mut StatusPort<'_>,
        due: &DueSetpoint,
        message: &Setpoint,
        is_switched: bool,
    ) {
        if !self.has_started {
            self.has_started = true;
            port.notify(EventKind::Started);
        }
        self.last = *message;
        // The status shows positions without the machine's errors.
        let [sent, ..] = due.sent();
        self.shift = sent - due.setpoint.position;
        self.last.position = due.setpoint.position.into();
        self.last.velocity = due.setpoint.velocity.into();
        self.planned = Some(due.setpoint);
        // A block is reported before it is added to the plan.
        self.track.receive(&self.news);
        let mut messages = Vec::new();
        let modal = self.track.reach(&due.setpoint, |notice| {
            if notice.is_message {
                messages.push(notice.text.clone());
            }
        });
        self.modal = modal.unwrap_or(self.modal);
        for text in messages {
            self.pass_on(&text, &due.setpoint);
            // Each has a status, however soon the next replaces it.
            self.refresh(port);
            port.notify(EventKind::StatusChanged);
        }
        if is_switched {
            self.show(port.periphery);
        }
        let state = due.setpoint.state;
        if state != self.state || is_switched {
            let event = event_of(self.state, state);
            self.state = state;
            // The status is sent first, so that a reader that is woken finds the reason in it.
            self.refresh(port);
            port.notify(event);
        }
    }

    /// Notes whether the drives follow. Nothing else of the feedback affects the run: see its note.
    fn receive(&mut self, feedback: &Feedback) {
        self.controls.set_drives(DriveReport::of(feedback));
        if self.bounds.check(MonotonicClock::now_ns(), feedback).is_ok() {
            self.feedback = Some(*feedback);
        }
    }

    fn poll(&mut self, _: &mut StatusPort<'_>) {}

    fn refresh(&mut self, port: &mut StatusPort<'_>) {
        self.show_speed(port.periphery);
        let unlimited = self.unlimited;
        let status = &mut self.status;
        status.sequence += 1;
        status.time_ns = MonotonicClock::now_ns();
        status.cycles = self.controls.progress().cycles;
        status.period_ns = self.last.period_ns;
        status.follow(&self.last);
        show_modal(status, &self.modal, self.last.position.into());
        if let Some(setpoint) = &self.planned {
            self.track.show(status, port.periphery.unplanned(), setpoint);
        }
        if let Some(feedback) = &self.feedback {
            show_feedback(status, feedback, status.time_ns);
            for (position, shift) in status.position_actual.iter_mut().zip(&self.shift) {
                *position -= shift;
            }
        }
        for axis in unlimited.axes() {
            for position in [
                &mut status.position_machine[axis],
                &mut status.position_work[axis],
                &mut status.position_actual[axis],
            ] {
                *position = angle_within_turn(*position);
            }
        }
        status.late_cycles = port.report.late;
        status.dropped_setpoints = port.report.failed;
        status.setpoint_subscribers = port.subscribers() as u32;
        let alarm = self.controls.alarm();
        if alarm != 0 && status.alarm_count == 0 {
            status.push_alarm(alarm);
        }
        port.publish(status, 0);
    }

    fn is_over(&self) -> bool {
        true
    }
}
