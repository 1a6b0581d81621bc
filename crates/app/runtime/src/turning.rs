//! Builds the controller of a load-adaptive turning cycle.

use evolvent_gcode::{TurningCycle, TurningKind};
use evolvent_machine::Limits;
use evolvent_path::AxisLetter;
use evolvent_turning::{
    Cone, CutEnd, CutFile, CutKind, ScalarLimits, TurningController, TurningJob, TurningSettings,
};

use crate::job::Setup;
use crate::turning_motion::{TurningFrame, TurningMotion};

/// The controller of a cycle, with tool, law and feeds of the process file, and with position, length and
/// spindle speed of the program. The tool is at the surface of the stock, which must not be higher anywhere.
///
/// # Errors
/// A sentence about what does not fit.
pub(crate) fn turning(cycle: &TurningCycle, setup: &Setup) -> Result<TurningMotion, String> {
    let Some(process) = &setup.process else {
        return Err(
            "load-adaptive passes need tool, force law, load and feeds: name a process file with --process, \
             or leave out Q1"
                .into(),
        );
    };
    if cycle.spindle_rpm <= 0.0 {
        return Err(
            "load-adaptive passes need a spindle that turns at a known speed: write S and M3 before, and G97 \
             where G96 is in force"
                .into(),
        );
    }
    let limits = setup.machine.limits();
    let (x, z) = (AxisLetter::X, AxisLetter::Z);
    let start = (cycle.start[x.index()], cycle.start[z.index()]);
    let (to_x, to_z) = (cycle.x_mm, cycle.z_mm);
    let signs = ((start.0 - to_x).signum(), (start.1 - to_z).signum());
    // The finishing pass removes the allowance from both walls.
    let size = (
        to_x + signs.0 * cycle.allowance_mm,
        to_z + signs.1 * cycle.allowance_mm,
    );
    let (kind, frame) = match cycle.kind {
        TurningKind::Longitudinal => (
            CutKind::Longitudinal,
            TurningFrame {
                start: cycle.start,
                along: (z, start.1, -signs.1),
                out: (x, size.0, signs.0),
            },
        ),
        TurningKind::Facing => (
            CutKind::Facing,
            TurningFrame {
                start: cycle.start,
                along: (x, start.0, -signs.0),
                out: (z, size.1, signs.1),
            },
        ),
    };
    let (step_mm, allowance_max_mm) = match kind {
        CutKind::Longitudinal => ((start.1 - size.1).abs(), (start.0 - size.0).abs()),
        CutKind::Facing => ((start.0 - size.0).abs(), (start.1 - size.1).abs()),
    };
    let cone = match cycle.cone_mm {
        Some([x, z]) => Cone::rising(step_mm, (x - to_x).abs(), (z - to_z).abs()),
        None => None,
    };
    let at_wall_mm = allowance_at_wall(cycle, process, cone.as_ref());
    let mut length_mm = step_mm + at_wall_mm;
    if let (Some(cone), Some([_, z])) = (&cone, cycle.cone_mm) {
        cone.check(&process.settings.tool)
            .map_err(|error| error.to_string())?;
        // Above the corner at which the tool is, there is nothing to cut.
        let end_mm = step_mm + (z - to_z).abs() + at_wall_mm;
        length_mm = end_mm.min(cone.position_mm(allowance_max_mm));
    }
    let diameter_mm = match kind {
        CutKind::Longitudinal => cycle.diameter_mm,
        CutKind::Facing => cycle.diameter_mm + 2.0 * (start.0 - to_x).abs(),
    };
    if kind == CutKind::Facing {
        // With an offset the sum may be beyond the axis by a rounding error.
        length_mm = length_mm.min(0.5 * diameter_mm);
    }
    let cut = CutFile {
        kind,
        diameter_mm: diameter_mm.max(0.1),
        z_mm: start.1,
        length_mm,
        end: process.cut.end,
        cone_from_mm: cone.map(|cone| cone.from_mm),
        cone_deg: cone.map(|cone| cone.angle_deg()),
        allowance_max_mm,
        spindle_rpm: cycle.spindle_rpm,
        speed_diameter_mm: process.cut.speed_diameter_mm,
    };
    let mut job = process.for_cut(cut).map_err(|error| error.to_string())?;
    let of = |axis: AxisLetter| ScalarLimits {
        velocity: limits.velocity[axis.index()],
        acceleration: limits.acceleration[axis.index()],
        jerk: limits.jerk[axis.index()],
    };
    job.drive_with(of(frame.along.0), of(frame.out.0), setup.period_ns as f64 * 1e-9);
    let settings = job.settings;
    check_room(&settings, &frame, &limits, allowance_max_mm)?;
    let (along, out) = frame.start_mm();
    let controller =
        TurningController::starting_at(settings, along, out).map_err(|error| error.to_string())?;
    Ok(TurningMotion::new(controller, frame))
}

/// Additional length of the passes beyond the allowance, mm, so that the finishing pass leaves the wall of
/// the shoulder that the passes have left. It would meet material on the wall with its whole edge at once.
/// The edge leaves the wall along itself, so the wall begins where contour and wall of the finished part
/// intersect, with the contour raised by the allowance.
fn allowance_at_wall(cycle: &TurningCycle, process: &TurningJob, cone: Option<&Cone>) -> f64 {
    if process.cut.end == CutEnd::Open {
        return 0.0;
    }
    let rise = cone.map_or(0.0, |cone| cone.slope);
    let steeper = process.settings.tool.slope() - rise;
    // A cone as steep as the edge is rejected.
    if steeper <= 0.0 {
        return 0.0;
    }
    let more_mm = cycle.allowance_mm * (1.0 + (1.0 + rise) / steeper);
    match cycle.kind {
        TurningKind::Longitudinal => more_mm,
        // At most to the axis of the workpiece.
        TurningKind::Facing => more_mm.min(0.5 * cycle.diameter_mm + cycle.allowance_mm),
    }
}

/// Checks that all positions that the tool may reach are within the travel.
fn check_room(
    settings: &TurningSettings,
    frame: &TurningFrame,
    limits: &Limits,
    allowance_max_mm: f64,
) -> Result<(), String> {
    // All positions that the tool may reach, including when it retracts from the greatest height.
    let before = -settings.tool.overhang_mm() - settings.clear_along_mm;
    let above = allowance_max_mm + settings.clear_out_mm + settings.regime.depth_max_mm;
    // The highest pass extends farthest beyond the end of the cut if a shoulder is to be left.
    let end = settings.length_mm + settings.shoulder_mm();
    for (along, out) in [(before, 0.0), (end, above)] {
        let position = frame.position(along, out);
        for axis in [AxisLetter::X, AxisLetter::Z] {
            let (value, i) = (position[axis.index()], axis.index());
            if !(limits.travel_min[i]..=limits.travel_max[i]).contains(&value) {
                return Err(format!(
                    "the tool needs space as far as {}{value:.3} (machine coordinates) to approach from \
                     outside and to retract, but the travel is {} to {}",
                    axis.letter(),
                    limits.travel_min[i],
                    limits.travel_max[i]
                ));
            }
        }
    }
    Ok(())
}
