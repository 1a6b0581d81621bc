//! The status: one coherent snapshot of all that a screen needs.

use evolvent_bus::{EventKind, MAX_ALARMS, Status, switches};
use evolvent_drive::PowerRequest;
use evolvent_motion::{MotionState, flags};
use evolvent_path::{AxisMask, angle_within_turn};
use evolvent_signals::ProbeState;
use evolvent_trace::{Histogram, PhaseFigures, PhaseTally};

use super::operator::Operator;
use super::orders::CycleView;
use crate::periphery::Periphery;
use crate::publish_report::PublishReport;
use crate::spindle_command::shown_rpm;
use crate::status_source::{event_of, show_feedback, show_modal};

const SECOND_NS: u64 = 1_000_000_000;

/// Statistics of the cycles so far.
#[derive(Default)]
pub(crate) struct Pulse {
    pub lateness: Histogram,
    pub work: Histogram,
    /// Tally of following the drives' clock, once the lock has settled.
    pub phase: PhaseTally,
    /// The same for the last whole second, settled or not, and for the present one with its number.
    last_second: Option<PhaseFigures>,
    second: PhaseTally,
    second_number: u64,
}

impl Pulse {
    pub(crate) fn count(&mut self, view: &CycleView, period_ns: u64) {
        self.lateness.record(view.lateness_ns as i64);
        self.work.record(view.work_ns as i64);
        let number = view.setpoint.sequence.saturating_mul(period_ns) / SECOND_NS;
        if number != self.second_number {
            self.second_number = number;
            self.last_second = self.second.figures();
            self.second.clear();
        }
        if let Some(phase) = &view.phase {
            self.second.record(phase);
            if phase.is_settled {
                self.phase.record(phase);
            }
        }
    }
}

/// Values whose change makes a snapshot worth sending at once.
#[derive(Clone, Copy, PartialEq)]
pub(crate) struct Mark {
    state: MotionState,
    machine: u32,
    mode: u32,
    activity: u32,
    job: u64,
    result: u32,
    alarms: u32,
    power: PowerRequest,
    switches: u32,
    homed: AxisMask,
    accepted: u64,
    periphery: Periphery,
}

impl Mark {
    pub(crate) fn of(operator: &Operator) -> Self {
        let state = &operator.state;
        Self {
            state: operator.view.setpoint.state,
            machine: state.machine() as u32,
            mode: state.mode() as u32,
            activity: state.activity() as u32,
            job: state.job(),
            result: state.result() as u32,
            alarms: state.alarms().count() as u32,
            power: operator.view.power,
            switches: switches(operator),
            homed: state.homed(),
            accepted: state.counts().0,
            // The status is the only message that switches spindle and coolant, so their changes must not
            // wait.
            periphery: *operator.periphery.now(),
        }
    }

    /// The event that wakes sleeping readers, for a change from `before`.
    pub(crate) fn event(self, before: Self) -> EventKind {
        if self.alarms > before.alarms {
            EventKind::Fault
        } else if self.alarms < before.alarms {
            EventKind::Reset
        } else if self.job > before.job {
            EventKind::Started
        } else if self.state != before.state {
            event_of(before.state, self.state)
        } else {
            EventKind::StatusChanged
        }
    }
}

fn switches(operator: &Operator) -> u32 {
    let state = &operator.state;
    let bits = [
        (state.is_single_step(), switches::SINGLE_STEP),
        (state.is_optional_stop(), switches::OPTIONAL_STOP),
        (state.is_block_delete(), switches::BLOCK_DELETE),
        (operator.is_holding(), switches::HOLD),
        (operator.view.is_chain_open, switches::CHAIN_OPEN),
        (operator.view.at_wait, switches::INPUT_WAIT),
        (operator.view.probe == ProbeState::Open, switches::PROBE_OPEN),
        (
            operator.view.probe == ProbeState::Tripped,
            switches::PROBE_TRIPPED,
        ),
        (operator.is_tool_unknown(), switches::TOOL_UNKNOWN),
    ];
    bits.into_iter()
        .filter(|(on, _)| *on)
        .fold(0, |sum, (_, bit)| sum | bit)
}

/// A snapshot of the present state. `sequence` is its own number.
pub(crate) fn snapshot(
    operator: &Operator,
    pulse: &Pulse,
    published: &(PublishReport, usize),
    sequence: u64,
    now_ns: u64,
) -> Status {
    let (state, view, modal) = (&operator.state, &operator.view, &operator.program.modes.modal);
    let setpoint = &view.setpoint;
    let periphery = operator.periphery.now();
    let (tool_change, tool_wanted) = periphery.change_numbers();
    let (program_time_s, program_held_s) = operator.program.tally.times_s(operator.setup.period_ns);
    let (away_axes, away_parts) = operator.away_numbers();
    let wheel = operator.handwheel.as_ref();
    let (handwheel_mask, handwheel_enabled, handwheel_step) =
        wheel.map_or((0, 0, 0.0), |wheel| wheel.numbers(&view.handwheel));
    let mut status = Status {
        away_mask: away_axes.bits(),
        away_parts,
        retrace_blocks: view.leaving.blocks_before,
        retraced: u32::from(view.leaving.is_retraced),
        handwheel_mask,
        handwheel_enabled,
        handwheel_step,
        parts: operator.program.tally.parts(),
        program_time_s,
        program_held_s,
        sequence,
        time_ns: now_ns,
        cycles: setpoint.sequence + 1,
        period_ns: operator.setup.period_ns,
        state: setpoint.state as u32,
        mode: state.mode() as u32,
        machine_state: state.machine() as u32,
        flags: setpoint.flags & !flags::LATE,
        line: setpoint.line.saturating_sub(operator.program.lines_before),
        axes_mask: operator.present().bits(),
        homed_mask: state.homed().bits(),
        tool: periphery.tool,
        setpoint_subscribers: published.1 as u32,
        position_machine: setpoint.position.into(),
        velocity: setpoint.velocity.into(),
        path_mm: setpoint.path_mm,
        feed_mm_s: setpoint.feed_mm_s,
        override_ratio: state.overrides()[0],
        rapid_override_ratio: state.overrides()[1],
        spindle_override_ratio: state.overrides()[2],
        spindle_rpm: shown_rpm(
            &periphery.outputs,
            setpoint.position[0],
            &view.spindle_overrides,
            &operator.setup.machine.signals,
        ),
        late_cycles: view.late_cycles.max(published.0.late),
        dropped_records: view.dropped_records,
        dropped_setpoints: view.dropped_setpoints + published.0.failed,
        wake_lateness_ns: view.lateness_ns,
        activity: state.activity() as u32,
        job_result: state.result() as u32,
        job: state.job(),
        switches: switches(operator),
        power: view.power.number(),
        coolant: periphery.coolant_bits(),
        tool_change,
        tool_wanted,
        home_offset: operator.drives.home_offset.into(),
        feedback_age_ns: u64::MAX,
        commands_accepted: state.counts().0,
        commands_rejected: state.counts().1 + operator.malformed(),
        ..Status::default()
    };
    show_modal(&mut status, modal, setpoint.position);
    add_timing(&mut status, pulse);
    match (periphery.unplanned(), operator.steered_speed()) {
        (None, Some(speed)) => status.feed_programmed_mm_s = speed,
        (unplanned, _) => operator.program.track.show(&mut status, unplanned, setpoint),
    }
    if let Some(feedback) = &operator.drives.feedback {
        show_feedback(&mut status, feedback, now_ns);
    }
    show_within_turn(&mut status, operator.unlimited);
    status.set_program(state.program().unwrap_or_default());
    status.set_message(operator.message.text());
    for (alarm, _) in state.alarms() {
        status.push_alarm(alarm.number());
    }
    if let Some((_, text)) = state.alarms().next() {
        status.set_alarm_text(text);
    }
    if state.unlisted_alarms() > 0 {
        status.alarm_count = (MAX_ALARMS as u32).saturating_add(state.unlisted_alarms());
    }
    status
}

/// Adds lateness and work since the start, and figures of the drives' clock.
fn add_timing(status: &mut Status, pulse: &Pulse) {
    status.wake_lateness_p50_ns = quantile(&pulse.lateness, 50.0);
    status.wake_lateness_p999_ns = quantile(&pulse.lateness, 99.9);
    status.wake_lateness_max_ns = pulse.lateness.max_ns().max(0) as u64;
    status.work_p50_ns = quantile(&pulse.work, 50.0);
    status.work_p999_ns = quantile(&pulse.work, 99.9);
    status.work_max_ns = pulse.work.max_ns().max(0) as u64;
    if let Some(phase) = &pulse.last_second {
        status.clock_drift_ppm = phase.drift_ppm as f32;
        status.phase_error_max_ns = phase.phase_max_ns.max(1) as f32;
    }
}

/// Shows positions of unlimited rotary axes within one turn.
fn show_within_turn(status: &mut Status, unlimited: AxisMask) {
    for axis in unlimited.axes() {
        for position in [
            &mut status.position_machine[axis],
            &mut status.position_work[axis],
            &mut status.position_actual[axis],
        ] {
            *position = angle_within_turn(*position);
        }
    }
}

fn quantile(histogram: &Histogram, percent: f64) -> u64 {
    if histogram.count() == 0 {
        return 0;
    }
    histogram.percentile_ns(percent).max(0) as u64
}
