//! Unlimited rotary axes: when they are at rest far from zero, whole turns are subtracted from their
//! coordinates.

use evolvent_drive::Presence;
use evolvent_motion::MotionState;
use evolvent_path::{AxisLetter, whole_turns};

use super::operator::{Job, Operator};
use crate::news::ExternalEventKind;

/// Largest coordinate of an axis at rest before turns are subtracted, degrees: a hundred turns. There a
/// double resolves 7e-12 degrees.
const FAR_DEG: f64 = 36_000.0;
/// The command of such an event: none.
const NO_COMMAND: u32 = 0;

impl Operator {
    /// Subtracts whole turns from large coordinates while nothing moves and no motion is pending. The drives
    /// take over the new coordinates without motion, as they take over the datum of homing.
    pub(super) fn remove_whole_turns(&mut self) {
        if self.unlimited.is_empty() || !matches!(self.job, Job::None) || !self.is_idle() {
            return;
        }
        let view = &self.view;
        // Earlier orders were carried out, and present drives follow, so that they take over the new
        // coordinates.
        let is_settled = view.datum >= self.drives.datum && matches!(view.setpoint.state, MotionState::Idle);
        let follow = matches!(view.presence, Presence::Operational | Presence::Absent);
        if !is_settled || !follow || self.stops.ending {
            return;
        }
        let here = view.setpoint.position;
        let (mut renamed, mut home_offset) = (here, self.drives.home_offset);
        let mut removed = Vec::new();
        for axis in self.unlimited.axes() {
            if here[axis].abs() > FAR_DEG {
                let turns = whole_turns(here[axis]);
                renamed[axis] -= turns;
                home_offset[axis] += turns;
                removed.push(format!("{turns} degrees off {}", AxisLetter::ALL[axis].letter()));
            }
        }
        if renamed == here {
            return;
        }
        self.drives.renaming = renamed - here;
        self.view.setpoint.position = renamed;
        self.rename(renamed, self.drives.zeroed, home_offset);
        let text = format!("whole turns: {}", removed.join(", "));
        self.record(ExternalEventKind::Command, NO_COMMAND, text, None);
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::mpsc;

    use evolvent_drive::PowerRequest;
    use evolvent_gcode::SPINDLES;
    use evolvent_machine::Machine;
    use evolvent_motion::{MotionState, Setpoint};
    use evolvent_path::Axes;
    use evolvent_signals::ProbeState;
    use rtrb::RingBuffer;

    use super::*;
    use crate::handwheel_view::HandwheelView;
    use crate::job::Setup;
    use crate::serve::operator::OperatorConfig;
    use crate::serve::orders::{CycleCommand, CycleView, LeavingView};
    use crate::serve::state_store::StateStore;

    const C: usize = 5;
    const TABLE: &str = "[[axis]]\nletter = \"C\"\nunlimited = \"shorter\"\nmax_velocity_deg_s = 360\n\
                         max_acceleration_deg_s2 = 720\nmax_jerk_deg_s3 = 7200\n";

    fn setup() -> Setup {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let text = std::fs::read_to_string(&file).unwrap();
        let text = text.replacen(
            "increments_per_mm",
            "increments_per_degree = 1000\nincrements_per_mm",
            1,
        );
        let machine = Machine::parse(&format!("{text}\n{TABLE}"), "table.toml").unwrap();
        Setup::new(machine, file, text, None).unwrap()
    }

    /// The axes at rest, with C at a coordinate.
    fn view(sequence: u64, c_deg: f64, datum: u64) -> CycleView {
        let position = Axes::from_fn(|axis, _| if axis == C { c_deg } else { 0.0 });
        CycleView {
            setpoint: Setpoint {
                sequence,
                position,
                velocity: Axes::zeros(),
                acceleration: Axes::zeros(),
                jerk: Axes::zeros(),
                path_mm: 0.0,
                feed_mm_s: 0.0,
                feed_override: 1.0,
                line: 0,
                block: 0,
                state: MotionState::Idle,
                flags: 0,
                actions: 0,
            },
            shift: None,
            lateness_ns: 0,
            work_ns: 0,
            presence: Presence::Absent,
            power: PowerRequest::On,
            power_order: 0,
            datum,
            late_cycles: 0,
            dropped_records: 0,
            dropped_setpoints: 0,
            at_rest: true,
            at_wait: false,
            is_chain_open: false,
            probe: ProbeState::default(),
            spindle_overrides: [1.0; SPINDLES],
            handwheel: HandwheelView::default(),
            leaving: LeavingView::default(),
            phase: None,
        }
    }

    /// A cycle computed while the order is on its way has the old coordinate; what begins after the order
    /// must use the new one.
    #[test]
    fn commands_before_the_cycle_use_the_new_coordinate() {
        let (orders, mut cycle_orders) = RingBuffer::new(64);
        let (mut to_views, mut views) = RingBuffer::new(4);
        let (_to_events, mut events) = RingBuffer::new(1);
        let (_to_answers, mut answers) = RingBuffer::new(1);
        let (periphery, _publisher) = mpsc::channel();
        let (setup, folder) = (setup(), tempfile::tempdir().unwrap());
        let mut operator = Operator::new(OperatorConfig {
            store: StateStore::open(setup.memory.clone(), folder.path()),
            setup,
            folder: folder.path().to_owned(),
            orders,
            urgent: std::sync::Arc::default(),
            recorder: None,
            periphery,
            view: view(0, 40_000.0, 0),
        })
        .unwrap();
        let mut relocations = Vec::new();
        for seen in [
            view(1, 40_000.0, 0),
            view(2, 40_000.0, 0),
            view(3, 40.0, 1),
            view(4, 40.0, 1),
        ] {
            to_views.push(seen).unwrap();
            operator.tick(0, &mut views, &mut events, &mut answers, |_| {});
            assert_eq!(operator.view.setpoint.position[C], 40.0);
            while let Ok(order) = cycle_orders.pop() {
                if let CycleCommand::Relocate {
                    position,
                    renames: true,
                    ..
                } = order.what
                {
                    relocations.push(position[C]);
                }
            }
        }
        assert_eq!(relocations, [40.0]);
        // The drives' count is larger by 111 turns.
        assert_eq!(operator.drives.home_offset[C], 39_960.0);
    }
}
