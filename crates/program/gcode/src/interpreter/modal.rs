//! The active modes, as numbers for display.

use std::io::BufRead;

use evolvent_path::{Axes, Plane};

use crate::codes::modal_groups::{Compensation, FeedMode, PlaneCode};
use crate::interpreter::Interpreter;
use crate::state::machine_state::ProgrammedSpeed;
use crate::state::machine_state::State;
use crate::state::rotation::{rotate_back, rotation_of};
use crate::{PathMode, SpindleDirection};

/// Modes, offsets and tool after a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Modal {
    /// Active G codes, one per modal group except motion, times ten: 170 is G17, 591 is G59.1. Padded with
    /// zeros.
    pub codes: [u32; 16],
    /// Active work coordinate system, times ten: 540 to 593.
    pub work_system: u32,
    /// Work zero, including G92, in machine coordinates, mm and degrees, without the rotation of the system.
    pub work_offset: Axes,
    /// The contribution of G92 to it.
    pub g92_offset: Axes,
    /// Rotation of X and Y of the system (G10 L2 R), degrees.
    pub rotation_deg: f64,
    /// Active offset of G43, mm and degrees.
    pub tool_offset: Axes,
    /// Tool in the spindle; 0 for none.
    pub tool: u32,
    /// Tool selected by T for the next M6.
    pub selected_tool: Option<u32>,
    /// Speed of spindle 0 in revolutions per minute, negative counter-clockwise; 0 if it is stopped or
    /// follows a surface speed.
    pub spindle_rpm: f64,
    /// The spindle of threads and cycles without `$`.
    pub active_spindle: u32,
    /// Mist coolant is on.
    pub mist: bool,
    /// Flood coolant is on.
    pub flood: bool,
}

impl Modal {
    /// Converts a position of the machine to work coordinates, mm and degrees.
    #[must_use]
    pub fn work_position(&self, machine: Axes) -> Axes {
        if self.rotation_deg == 0.0 {
            return machine - self.work_offset - self.tool_offset;
        }
        // The rotation is about the zero of the system, and G92 is in the rotated coordinates.
        let zero = self.work_offset - self.g92_offset;
        rotate_back(rotation_of(self.rotation_deg), machine - zero - self.tool_offset) - self.g92_offset
    }
}

impl<R: BufRead> Interpreter<R> {
    /// The modes after the lines read so far.
    #[must_use]
    pub fn modal(&self) -> Modal {
        self.state().modal()
    }
}

impl State {
    fn modal(&self) -> Modal {
        let modes = &self.modes;
        let either = |yes: bool, one: u32, other: u32| if yes { one } else { other };
        let work_system = match modes.work_index {
            index @ 0..=5 => 540 + 10 * index as u32,
            index => 590 + index.min(8) as u32 - 5,
        };
        let list = [
            match modes.plane {
                PlaneCode::Main(Plane::Xy) => 170,
                PlaneCode::Main(Plane::Zx) => 180,
                PlaneCode::Main(Plane::Yz) => 190,
                PlaneCode::Secondary(Plane::Xy) => 171,
                PlaneCode::Secondary(Plane::Zx) => 181,
                PlaneCode::Secondary(Plane::Yz) => 191,
            },
            either(modes.inches, 200, 210),
            either(modes.incremental, 910, 900),
            either(modes.arc_centre_absolute, 901, 911),
            match modes.feed_mode {
                FeedMode::InverseTime => 930,
                FeedMode::PerMinute => 940,
                FeedMode::PerRevolution => 950,
            },
            work_system,
            match modes.path_mode {
                PathMode::ExactPath => 610,
                PathMode::ExactStop => 611,
                PathMode::Blend { .. } => 640,
            },
            either(modes.retract_to_initial, 980, 990),
            either(modes.diameter, 70, 80),
            either(self.cutter.code == Compensation::Off, 400, 410),
            either(self.tool_offset == Axes::zeros(), 490, 430),
            either(modes.spindles[0].speed.is_surface(), 960, 970),
        ];
        let mut codes = [0; 16];
        codes[..list.len()].copy_from_slice(&list);
        let turning = match (modes.spindles[0].direction, modes.spindles[0].speed) {
            (SpindleDirection::Clockwise, ProgrammedSpeed::Rpm(rpm)) => rpm,
            (SpindleDirection::CounterClockwise, ProgrammedSpeed::Rpm(rpm)) => -rpm,
            _ => 0.0,
        };
        Modal {
            codes,
            work_system,
            work_offset: self.work + self.g92,
            g92_offset: self.g92,
            rotation_deg: self.rotation[0],
            tool_offset: self.tool_offset,
            tool: self.tool,
            selected_tool: self.selected_tool,
            spindle_rpm: turning,
            active_spindle: modes.active_spindle as u32,
            mist: modes.mist,
            flood: modes.flood,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;

    fn after(text: &str) -> Modal {
        let mut interpreter = Interpreter::new(text.as_bytes(), Settings::default());
        let lines = text.lines().count() as u32;
        interpreter.start_at(lines).unwrap();
        interpreter.modal()
    }

    #[test]
    fn rotated_work_position_is_as_programmed() {
        // 30 degrees about (5, 6): (10, 4) is 10 cos 30 - 4 sin 30 and 10 sin 30 + 4 cos 30 from there.
        let machine = |x: f64, y: f64| Axes::from_fn(|axis, _| [x, y].get(axis).copied().unwrap_or(0.0));
        let modal = after("G10 L2 P1 X5 Y6 R30\n\n");
        assert_eq!(modal.rotation_deg, 30.0);
        let root = 3.0_f64.sqrt();
        let work = modal.work_position(machine(5.0 + 5.0 * root - 2.0, 6.0 + 5.0 + 2.0 * root));
        assert!((work - machine(10.0, 4.0)).amax() < 1e-12, "{work}");
        // G92 X1 at (10, 4) makes it (1, 4).
        let modal = after("G10 L2 P1 X5 Y6 R30\nG0 X10 Y4\nG92 X1\n\n");
        let work = modal.work_position(machine(5.0 + 5.0 * root - 2.0, 6.0 + 5.0 + 2.0 * root));
        assert!((work - machine(1.0, 4.0)).amax() < 1e-12, "{work}");
        // Without a rotation.
        let modal = after("G10 L2 P1 X5 Y6\nG0 X10 Y4\nG92 X1\n\n");
        let work = modal.work_position(machine(15.0, 10.0));
        assert!((work - machine(1.0, 4.0)).amax() < 1e-12, "{work}");
    }

    #[test]
    fn codes_are_those_that_the_program_has_chosen() {
        let modal = after("G18 G20 G91 G93 G61 G59.2 M4 S500 M7\n\n");
        for code in [180, 200, 910, 930, 610, 592, 490] {
            assert!(modal.codes.contains(&code), "{code}: {:?}", modal.codes);
        }
        assert_eq!((modal.work_system, modal.spindle_rpm), (592, -500.0));
        assert!(modal.mist && !modal.flood);
    }

    #[test]
    fn offsets_are_in_millimetres_and_machine_coordinates() {
        let modal = after("G21 G10 L2 P1 X10 Y-5\nG92 X3\nG43.1 Z7\n\n");
        // The machine is at zero, where G92 sets 3 instead of -10.
        assert_eq!(modal.work_offset.as_slice()[..3], [-3.0, -5.0, 0.0]);
        assert_eq!(modal.tool_offset[2], 7.0);
        assert!(modal.codes.contains(&430));
    }
}
