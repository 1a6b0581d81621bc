//! Why lines of a configuration have no effect on a machine file.

use crate::ini::Entry;

/// Sections that belong to other programs of LinuxCNC.
const SECTIONS: &[(&str, &str)] = &[
    ("EMC", "LinuxCNC's own version and messages"),
    ("LINUXCNC", "LinuxCNC's own version and messages"),
    ("DISPLAY", "a screen's settings"),
    (
        "FILTER",
        "a screen's settings: convert the files before they are run",
    ),
    ("MACROS", "a screen's settings"),
    ("MDI_COMMAND_LIST", "a screen's settings"),
    ("TASK", "the task controller's settings"),
    ("HAL", "wiring: the bridge to the drives does this"),
    ("HALUI", "wiring of buttons: a client of the bus does this"),
    ("APPLICATIONS", "programs that LinuxCNC starts"),
    ("PYTHON", "Python in the interpreter is not supported"),
    ("HOSTMOT2", "wiring of a Mesa board: the bridge to it does this"),
];

/// Keys, in sections that start like this.
const KEYS: &[(&str, &str, &str)] = &[
    ("JOINT_", "BACKLASH", "the joint drives no axis"),
    ("JOINT_", "COMP_FILE", "the joint drives no axis"),
    ("JOINT_", "COMP_FILE_TYPE", "the joint drives no axis"),
    (
        "JOINT_",
        "HOME_USE_INDEX",
        "the joint has neither a search nor a latch velocity: it is homed at its present position",
    ),
    ("JOINT_", "HOME_ABSOLUTE_ENCODER", "the joint drives no axis"),
    (
        "JOINT_",
        "HOME_IGNORE_LIMITS",
        "limit switches during homing are the bridge's",
    ),
    (
        "JOINT_",
        "HOME_IS_SHARED",
        "shared home switches are not supported",
    ),
    (
        "JOINT_",
        "HOME_FINAL_VEL",
        "the move to the home position uses the axis's own limits",
    ),
    (
        "JOINT_",
        "HOME_SEQUENCE",
        "the axis has no home switch: it is homed at its present position",
    ),
    (
        "JOINT_",
        "VOLATILE_HOME",
        "the homed state is lost with the link to the drives",
    ),
    ("JOINT_", "LOCKING_INDEXER", "locking indexers are not supported"),
    (
        "JOINT_",
        "TYPE",
        "the axis's letter decides: A, B, C rotary, the others linear",
    ),
    ("AXIS_", "WRAPPED_ROTARY", "linear axes do not wrap"),
    (
        "AXIS_",
        "LOCKING_INDEXER_JOINT",
        "locking indexers are not supported",
    ),
    ("AXIS_", "OFFSET_AV_RATIO", "external offsets are not supported"),
    ("TRAJ", "NO_FORCE_HOMING", "programs need homed axes"),
    (
        "TRAJ",
        "MAX_LINEAR_ACCELERATION",
        "limits hold for each axis, not along the path",
    ),
    (
        "TRAJ",
        "MAX_LINEAR_ACCEL",
        "limits hold for each axis, not along the path",
    ),
    (
        "TRAJ",
        "MAX_LINEAR_JERK",
        "limits hold for each axis, not along the path",
    ),
    (
        "TRAJ",
        "MAX_ANGULAR_VELOCITY",
        "limits hold for each axis, not along the path",
    ),
    (
        "TRAJ",
        "MAX_ANGULAR_ACCELERATION",
        "limits hold for each axis, not along the path",
    ),
    ("TRAJ", "DEFAULT_", "a jog's speed is given with the jog"),
    (
        "TRAJ",
        "ARC_BLEND_",
        "the path's tolerance decides: [path] blend_tolerance_mm",
    ),
    (
        "TRAJ",
        "POSITION_FILE",
        "positions are not kept while the power is off",
    ),
    ("TRAJ", "HOME", "home positions are those of the joints"),
    ("TRAJ", "PLANNER_TYPE", "one planner, limited in jerk"),
    (
        "EMCMOT",
        "BASE_PERIOD",
        "steps are made by the bridge or its board",
    ),
    ("EMCMOT", "", "LinuxCNC's own threads"),
    (
        "EMCIO",
        "RANDOM_TOOLCHANGER",
        "write program.tool_change = \"subroutine\" and magazine = \"random\", and the changer's subroutine",
    ),
    (
        "EMCIO",
        "TOOL_CHANGE_",
        "the position of tool changes: write the moves into a subroutine of program.tool_change \
         = \"subroutine\"",
    ),
    (
        "EMCIO",
        "DB_PROGRAM",
        "tools come from the table, not from a program",
    ),
    ("EMCIO", "", "settings of LinuxCNC's I/O controller"),
    (
        "RS274NGC",
        "REMAP",
        "codes are not remapped: user-defined codes are M100 to M199 and M6",
    ),
    (
        "RS274NGC",
        "DISABLE_G92_PERSISTENCE",
        "the offset of G92 persists from run to run: write G92.1 at the beginning of programs",
    ),
    (
        "RS274NGC",
        "CENTER_ARC_RADIUS_TOLERANCE_",
        "write path.arc_radius_tolerance_mm, which is 2.54 times as much in inch programs",
    ),
    ("RS274NGC", "ON_ABORT_COMMAND", "no program runs after an abort"),
    ("RS274NGC", "OWORD_NARGS", "subroutines are called as usual"),
    ("RS274NGC", "", "settings of LinuxCNC's interpreter"),
    (
        "SPINDLE_",
        "MIN_",
        "a spindle has no minimum speed: a command below it is not raised",
    ),
    ("SPINDLE_", "INCREMENT", "a screen's settings"),
    (
        "SPINDLE_",
        "HOME_",
        "spindles are not homed: M19 turns them to an angle",
    ),
    (
        "SPINDLE_",
        "MAX_",
        "[TRAJ] SPINDLES has no such spindle, or it exceeds the four of a machine file",
    ),
    (
        "JOINT_",
        "",
        "wiring and tuning of the drive: the bridge does this",
    ),
    ("AXIS_", "", "no counterpart"),
];

/// Why this entry has no effect, or None if omitting it changes nothing.
pub(crate) fn reason(entry: &Entry) -> Option<&'static str> {
    let has_no_effect = match entry.key.as_str() {
        "BACKLASH" => entry.number().is_ok_and(|value| value == 0.0),
        "HOME_USE_INDEX"
        | "HOME_IGNORE_LIMITS"
        | "HOME_IS_SHARED"
        | "VOLATILE_HOME"
        | "LOCKING_INDEXER"
        | "RANDOM_TOOLCHANGER"
        | "HOME_ABSOLUTE_ENCODER"
        | "WRAPPED_ROTARY" => !entry.is_true() && !entry.value.starts_with('2'),
        "TYPE" => {
            let linear = entry.section.starts_with("JOINT_") || entry.section.starts_with("AXIS_");
            linear && ["LINEAR", "ANGULAR"].contains(&entry.value.to_ascii_uppercase().as_str())
        }
        _ => false,
    };
    if has_no_effect {
        return None;
    }
    let section = |(name, _): &&(&str, &str)| entry.section == *name;
    if let Some((_, reason)) = SECTIONS.iter().find(section) {
        return Some(reason);
    }
    let key = |(section, key, _): &&(&str, &str, &str)| {
        let is_group = key.is_empty() || key.ends_with('_');
        let matches = if is_group {
            entry.key.starts_with(key)
        } else {
            entry.key == *key
        };
        matches && entry.section.starts_with(section)
    };
    Some(
        KEYS.iter()
            .find(key)
            .map_or("no counterpart", |(_, _, reason)| reason),
    )
}
