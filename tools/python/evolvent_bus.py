"""Layout of Evolvent's messages on iceoryx2, interface version 1, and helpers to read them.

Generated: do not edit, run `cargo run -p evolvent-bus --example generate-bindings`.

Needs `pip install iceoryx2==0.10.0` for the helpers; the structures alone need nothing.
Axes are in the order X Y Z A B C U V W.
"""

from __future__ import annotations

import ctypes
import glob
import os
import stat
import time
from typing import Any, Optional

INTERFACE_VERSION = 1
AXES = 9
DIGITAL_SIGNALS = 64
ANALOG_SIGNALS = 16
SPINDLES = 4
PLACES_FOR_BRIDGES = 4
PLACES_FOR_OPERATORS = 8
ATTRIBUTE_INTERFACE = "evolvent.interface"
ATTRIBUTE_PERIOD = "evolvent.period_ns"
ATTRIBUTE_AXES = "evolvent.axes"

# Values of `state` in Setpoint and Status.
STATE_IDLE = 0
STATE_RUNNING = 1
STATE_HOLDING = 2
STATE_HELD = 3
STATE_STOPPING = 4
STATE_STOPPED = 5
STATE_DWELL = 6
STATE_PROGRAM_STOP = 7
STATE_FAULT = 8
STATE_DONE = 9

# Bits of `flags` in Setpoint and Status.
FLAG_LATE = 1
FLAG_HOLD = 2
FLAG_BLEND = 4
FLAG_RAPID = 8
FLAG_JOINT = 16
FLAG_STARVED = 32
FLAG_GUARD = 64
FLAG_LAST = 128

# Values of `power_request` in Setpoint.
POWER_OFF = 0
POWER_ON = 1
POWER_QUICK_STOP = 2

# Values of `bridge_state` in Feedback.
BRIDGE_WAITING = 0
BRIDGE_FOLLOWING = 1
BRIDGE_BRIDGING = 2
BRIDGE_BRAKING = 3
BRIDGE_HOLDING = 4
BRIDGE_OFF = 5

# Values of `note` in Feedback.
NOTE_NONE = 0
NOTE_GAP = 1
NOTE_SILENCE = 2
NOTE_LATE = 3
NOTE_JUMP = 4
NOTE_RESTART = 5
NOTE_NOT_FINITE = 6
NOTE_VERSION = 7

# Values of `kind` in Load.
LOAD_FORCE_N = 1
LOAD_TORQUE_N_M = 2
LOAD_POWER_W = 3
LOAD_CURRENT_A = 4
LOAD_RATIO_OF_RATED = 5

# Values of `spindle_direction` in MachineOutputs.
DIRECTION_STOPPED = 0
DIRECTION_CLOCKWISE = 1
DIRECTION_COUNTER_CLOCKWISE = 2
DIRECTION_ORIENT = 3

# Values of `spindle_way` in MachineOutputs.
WAY_SHORTER = 0
WAY_CLOCKWISE = 1
WAY_COUNTER_CLOCKWISE = 2

# Values of `probe` in MachineInputs.
PROBE_NONE = 0
PROBE_OPEN = 1
PROBE_TRIPPED = 2

# Bits of `flags` in SpindleFeedback.
SPINDLE_AT_SPEED = 1
SPINDLE_FAULT = 2
SPINDLE_INDEXED = 4
SPINDLE_ORIENTED = 8

# Numbers on the event channel.
EVENT_CORE_OPENED = 1
EVENT_CORE_CLOSED = 2
EVENT_CORE_DIED = 3
EVENT_STARTED = 4
EVENT_HOLD = 5
EVENT_RESUMED = 6
EVENT_STOPPED = 7
EVENT_DONE = 8
EVENT_FAULT = 9
EVENT_RESET = 10
EVENT_STATUS_CHANGED = 11

# Values of `command` in ControlRequest.
COMMAND_ESTOP = 1
COMMAND_ESTOP_RESET = 2
COMMAND_ON = 3
COMMAND_OFF = 4
COMMAND_MODE = 5
COMMAND_LOAD = 6
COMMAND_START = 7
COMMAND_HOLD = 8
COMMAND_RESUME = 9
COMMAND_STEP = 10
COMMAND_STOP = 11
COMMAND_RESET = 12
COMMAND_SINGLE_STEP = 13
COMMAND_OPTIONAL_STOP = 14
COMMAND_BLOCK_DELETE = 15
COMMAND_FEED_OVERRIDE = 16
COMMAND_RAPID_OVERRIDE = 17
COMMAND_SPINDLE_OVERRIDE = 18
COMMAND_MDI = 19
COMMAND_JOG = 20
COMMAND_JOG_KEEP = 21
COMMAND_JOG_STOP = 22
COMMAND_HOME = 23
COMMAND_WORK_OFFSET = 24
COMMAND_TOUCH_OFF = 25
COMMAND_TOOL = 26
COMMAND_CLEAR_ALARMS = 27
COMMAND_SET_OUTPUT = 28
COMMAND_HANDWHEEL = 29
COMMAND_RETURN = 30
COMMAND_RETRACE = 31

# Values of `verdict` in ControlAnswer.
VERDICT_ACCEPTED = 0
VERDICT_REJECTED = 1
VERDICT_STALE = 2

# Values of `machine_state` in Status.
MACHINE_ESTOP = 0
MACHINE_OFF = 1
MACHINE_ON = 2

# Values of `mode` in Status and of the command MODE.
MODE_AUTO = 0
MODE_MANUAL = 1
MODE_MDI = 2

# Values of `activity` in Status.
ACTIVITY_NONE = 0
ACTIVITY_PROGRAM = 1
ACTIVITY_MDI = 2
ACTIVITY_JOG = 3
ACTIVITY_HOMING = 4

# Values of `job_result` in Status.
RESULT_NONE = 0
RESULT_DONE = 1
RESULT_STOPPED = 2
RESULT_FAILED = 3
RESULT_FAULT = 4

# Bits of `switches` in Status.
SWITCH_SINGLE_STEP = 1
SWITCH_OPTIONAL_STOP = 2
SWITCH_BLOCK_DELETE = 4
SWITCH_HOLD = 8
SWITCH_CHAIN_OPEN = 16
SWITCH_INPUT_WAIT = 32
SWITCH_PROBE_OPEN = 64
SWITCH_PROBE_TRIPPED = 128
SWITCH_TOOL_UNKNOWN = 256


class Setpoint(ctypes.Structure):
    """Target position of every axis at one instant, and its derivatives.

    Published ahead of time: in a real-time run `due_time_ns` is `lead` periods after publication.
    `sequence` grows by one per setpoint, so a gap is a lost setpoint and is detected as one.
    """

    interface_version: int
    struct_size: int
    sequence: int
    due_time_ns: int
    period_ns: int
    position: ctypes.Array[ctypes.c_double]
    velocity: ctypes.Array[ctypes.c_double]
    acceleration: ctypes.Array[ctypes.c_double]
    position_increments: ctypes.Array[ctypes.c_int64]
    state: int
    flags: int
    line: int
    axes_mask: int
    feed_mm_s: float
    override_ratio: float
    path_mm: float
    power_request: int
    fault_reset: int
    datum: int
    index_request: int
    index_axis: int
    reserved: ctypes.Array[ctypes.c_uint64]

    _fields_ = [
        # Version of the bus contract that the sender was built for; receivers reject another version.
        ("interface_version", ctypes.c_uint32),
        # Size of this payload in bytes.
        ("struct_size", ctypes.c_uint32),
        # Index of the cycle; grows by exactly one.
        ("sequence", ctypes.c_uint64),
        # When the setpoint holds: ns of CLOCK_MONOTONIC (real-time clock) or of path time (virtual clock).
        ("due_time_ns", ctypes.c_uint64),
        # Time from this setpoint to the next, in ns.
        ("period_ns", ctypes.c_uint64),
        # Position in machine coordinates: mm, degrees for A B C.
        ("position", ctypes.c_double * 9),
        # Velocity: mm/s, degrees/s for A B C.
        ("velocity", ctypes.c_double * 9),
        # Acceleration: mm/s2, degrees/s2 for A B C.
        ("acceleration", ctypes.c_double * 9),
        # Position rounded to the machine's increments, counted from machine zero.
        ("position_increments", ctypes.c_int64 * 9),
        # State of the core, a number of the list of states.
        ("state", ctypes.c_uint32),
        # Bits of the list of setpoint flags.
        ("flags", ctypes.c_uint32),
        # Line of the program, counted from 1; 0 if none.
        ("line", ctypes.c_uint32),
        # Bit i set: axis i is driven; the values of the others have no meaning.
        ("axes_mask", ctypes.c_uint32),
        # Speed along the path, in mm/s.
        ("feed_mm_s", ctypes.c_double),
        # Feed override as a ratio: 1 is 100 %.
        ("override_ratio", ctypes.c_double),
        # Distance along the path since the start of the run, in mm.
        ("path_mm", ctypes.c_double),
        # Requested state of the drives' power stages, a number of the list of power requests.
        ("power_request", ctypes.c_uint32),
        # Grows by one to request a reset of the drives' faults.
        ("fault_reset", ctypes.c_uint32),
        # Grows by one when homing assigns new coordinates: the axes are at rest, and the step of position is not a motion.
        ("datum", ctypes.c_uint64),
        # Another number, not 0: the next index pulse of the encoder of axis `index_axis` is to be latched.
        ("index_request", ctypes.c_uint32),
        # The axis of `index_request`, an index into X Y Z A B C U V W.
        ("index_axis", ctypes.c_uint32),
        # Zero; for later versions.
        ("reserved", ctypes.c_uint64 * 2),
    ]

    def __init__(self, **values: Any) -> None:
        super().__init__(interface_version=1, struct_size=400, **values)

    @staticmethod
    def type_name() -> str:
        """Name by which iceoryx2 tells payloads apart."""
        return "evolvent.Setpoint.v1"


class Status(ctypes.Structure):
    """One coherent snapshot of the core. A reader receives the latest, never a mixture of two.

    The publisher sends at least ten per second; a reader that sees no new `sequence` for longer has lost
    its core.
    """

    interface_version: int
    struct_size: int
    sequence: int
    time_ns: int
    cycles: int
    period_ns: int
    state: int
    mode: int
    machine_state: int
    flags: int
    line: int
    axes_mask: int
    homed_mask: int
    tool: int
    work_system: int
    setpoint_subscribers: int
    position_machine: ctypes.Array[ctypes.c_double]
    position_work: ctypes.Array[ctypes.c_double]
    distance_to_go: ctypes.Array[ctypes.c_double]
    velocity: ctypes.Array[ctypes.c_double]
    work_offset: ctypes.Array[ctypes.c_double]
    tool_offset: ctypes.Array[ctypes.c_double]
    path_mm: float
    path_to_go_mm: float
    feed_mm_s: float
    feed_programmed_mm_s: float
    override_ratio: float
    rapid_override_ratio: float
    spindle_override_ratio: float
    spindle_rpm: float
    late_cycles: int
    dropped_records: int
    dropped_setpoints: int
    wake_lateness_ns: int
    wake_lateness_p50_ns: int
    wake_lateness_p999_ns: int
    wake_lateness_max_ns: int
    work_p50_ns: int
    work_p999_ns: int
    work_max_ns: int
    alarm_count: int
    program_length: int
    alarms: ctypes.Array[ctypes.c_uint32]
    program: ctypes.Array[ctypes.c_uint8]
    activity: int
    job_result: int
    job: int
    switches: int
    power: int
    enabled_mask: int
    coolant: int
    modal: ctypes.Array[ctypes.c_uint32]
    home_offset: ctypes.Array[ctypes.c_double]
    position_actual: ctypes.Array[ctypes.c_double]
    following_error: ctypes.Array[ctypes.c_double]
    feedback_age_ns: int
    commands_accepted: int
    commands_rejected: int
    alarm_text_length: int
    message_length: int
    alarm_text: ctypes.Array[ctypes.c_uint8]
    message: ctypes.Array[ctypes.c_uint8]
    tool_change: int
    tool_wanted: int
    longest_stop_mm: float
    longest_stop_s: float
    longest_stop_line: int
    parts: int
    program_time_s: float
    program_held_s: float
    away_mask: int
    away_parts: int
    retrace_blocks: int
    retraced: int
    handwheel_mask: int
    handwheel_enabled: int
    handwheel_step: float
    spindle_mask: int
    spindle_override_off_mask: int
    spindle_command_rpm: ctypes.Array[ctypes.c_float]
    spindle_measured_rpm: ctypes.Array[ctypes.c_float]
    clock_drift_ppm: float
    phase_error_max_ns: float

    _fields_ = [
        # Version of the bus contract that the sender was built for; receivers reject another version.
        ("interface_version", ctypes.c_uint32),
        # Size of this payload in bytes.
        ("struct_size", ctypes.c_uint32),
        # Grows by one per snapshot.
        ("sequence", ctypes.c_uint64),
        # When the snapshot was taken, in ns of CLOCK_MONOTONIC.
        ("time_ns", ctypes.c_uint64),
        # Setpoints computed since the start.
        ("cycles", ctypes.c_uint64),
        # The control period in ns.
        ("period_ns", ctypes.c_uint64),
        # State of the core, a number of the list of states.
        ("state", ctypes.c_uint32),
        # Mode: 0 automatic, 1 manual, 2 MDI.
        ("mode", ctypes.c_uint32),
        # Machine: 0 emergency stop, 1 off, 2 on.
        ("machine_state", ctypes.c_uint32),
        # Bits of the last setpoint's flags.
        ("flags", ctypes.c_uint32),
        # Line of the running program, counted from 1; 0 if none.
        ("line", ctypes.c_uint32),
        # Bit i set: the machine has axis i.
        ("axes_mask", ctypes.c_uint32),
        # Bit i set: axis i has been homed.
        ("homed_mask", ctypes.c_uint32),
        # Tool in the spindle; 0 for none.
        ("tool", ctypes.c_uint32),
        # Selected work coordinate system times ten: 540 is G54, 591 is G59.1.
        ("work_system", ctypes.c_uint32),
        # Subscribers of the setpoint channel.
        ("setpoint_subscribers", ctypes.c_uint32),
        # Position in machine coordinates: mm, degrees for A B C.
        ("position_machine", ctypes.c_double * 9),
        # Position in work coordinates: mm, degrees for A B C.
        ("position_work", ctypes.c_double * 9),
        # Distance to the end of the running block, per axis: mm, degrees for A B C.
        ("distance_to_go", ctypes.c_double * 9),
        # Velocity: mm/s, degrees/s for A B C.
        ("velocity", ctypes.c_double * 9),
        # Work offset in force, G92 included: mm, degrees for A B C.
        ("work_offset", ctypes.c_double * 9),
        # Tool offset in force: mm, degrees for A B C.
        ("tool_offset", ctypes.c_double * 9),
        # Distance along the path since the start of the run, in mm.
        ("path_mm", ctypes.c_double),
        # Distance to the end of the planned path, in mm.
        ("path_to_go_mm", ctypes.c_double),
        # Speed along the path, in mm/s.
        ("feed_mm_s", ctypes.c_double),
        # Programmed speed along the path, in mm/s.
        ("feed_programmed_mm_s", ctypes.c_double),
        # Feed override as a ratio: 1 is 100 %.
        ("override_ratio", ctypes.c_double),
        # Rapid override as a ratio.
        ("rapid_override_ratio", ctypes.c_double),
        # Spindle override as a ratio.
        ("spindle_override_ratio", ctypes.c_double),
        # Spindle speed in revolutions per minute, negative counter-clockwise.
        ("spindle_rpm", ctypes.c_double),
        # Setpoints that were published after their due time.
        ("late_cycles", ctypes.c_uint64),
        # Trace records lost because the queue was full.
        ("dropped_records", ctypes.c_uint64),
        # Setpoints that could not be passed to the bus.
        ("dropped_setpoints", ctypes.c_uint64),
        # Lateness of the last wake-up, in ns.
        ("wake_lateness_ns", ctypes.c_uint64),
        # Median lateness of the wake-ups, in ns.
        ("wake_lateness_p50_ns", ctypes.c_uint64),
        # 99.9 % of the wake-ups were at most this late, in ns.
        ("wake_lateness_p999_ns", ctypes.c_uint64),
        # Maximum lateness of the wake-ups since the start, in ns.
        ("wake_lateness_max_ns", ctypes.c_uint64),
        # Median time of a cycle's own work, in ns.
        ("work_p50_ns", ctypes.c_uint64),
        # Own work of 99.9 % of the cycles was at most this long, in ns.
        ("work_p999_ns", ctypes.c_uint64),
        # Maximum own work of a cycle since the start, in ns.
        ("work_max_ns", ctypes.c_uint64),
        # Number of alarms in force; may exceed the listed ones.
        ("alarm_count", ctypes.c_uint32),
        # Bytes of `program` in use.
        ("program_length", ctypes.c_uint32),
        # Numbers of the alarms in force: their cause first (the first fault, else the job's, else the first warning), then from the oldest.
        ("alarms", ctypes.c_uint32 * 16),
        # Name of the loaded program, UTF-8.
        ("program", ctypes.c_uint8 * 128),
        # What moves the axes, a number of the list of activities.
        ("activity", ctypes.c_uint32),
        # How the last job ended, a number of the list of results.
        ("job_result", ctypes.c_uint32),
        # Number of the job that runs or, at rest, ran last; 0 before the first.
        ("job", ctypes.c_uint64),
        # Bits of the list of switches.
        ("switches", ctypes.c_uint32),
        # Power request to the drives: 0 off, 1 on, 2 quick stop.
        ("power", ctypes.c_uint32),
        # Bit i set: the drive of axis i reports operation enabled.
        ("enabled_mask", ctypes.c_uint32),
        # Bit 0 mist, bit 1 flood.
        ("coolant", ctypes.c_uint32),
        # Modal G codes times ten in no particular order, padded with zeros.
        ("modal", ctypes.c_uint32 * 16),
        # Position of machine zero in the drives' coordinates, as found by homing: mm, degrees for A B C.
        ("home_offset", ctypes.c_double * 9),
        # Actual position in machine coordinates, from the bridge: mm, degrees for A B C.
        ("position_actual", ctypes.c_double * 9),
        # Demanded minus actual position, from the bridge: mm, degrees for A B C.
        ("following_error", ctypes.c_double * 9),
        # Age of the last feedback, in ns; the largest number if none has arrived.
        ("feedback_age_ns", ctypes.c_uint64),
        # Commands that were accepted.
        ("commands_accepted", ctypes.c_uint64),
        # Commands that were rejected, including stale ones.
        ("commands_rejected", ctypes.c_uint64),
        # Bytes of `alarm_text` in use.
        ("alarm_text_length", ctypes.c_uint32),
        # Bytes of `message` in use.
        ("message_length", ctypes.c_uint32),
        # The sentence of the first of `alarms`: the error and its remedy, UTF-8.
        ("alarm_text", ctypes.c_uint8 * 256),
        # The program's last message to the operator, UTF-8.
        ("message", ctypes.c_uint8 * 256),
        # Tool change that the program waits for: 0 none, 1 by the operator (confirmed by RESUME), 2 by the machine's executable or subroutine.
        ("tool_change", ctypes.c_uint32),
        # If `tool_change` is not 0: the tool to put into the spindle; 0 to empty the spindle.
        ("tool_wanted", ctypes.c_uint32),
        # Longest path that a hold needs to stop at any moment of `job` so far, in mm, with a margin; 0 if unknown.
        ("longest_stop_mm", ctypes.c_double),
        # Time of that stop, in s.
        ("longest_stop_s", ctypes.c_double),
        # Line of the program at which that hold starts.
        ("longest_stop_line", ctypes.c_uint32),
        # Number of times that the loaded program has reached its end since it was loaded.
        ("parts", ctypes.c_uint32),
        # Running time of the current or last run of the program, in s.
        ("program_time_s", ctypes.c_double),
        # Time of it spent in holds and program stops, in s, without waits for a spindle, an input or a user-defined M code.
        ("program_held_s", ctypes.c_double),
        # Bit i set: axis i was jogged away from the program that is held.
        ("away_mask", ctypes.c_uint32),
        # Parts of the way back to where the program was left, which `message` tells; 0 where the axes are not away.
        ("away_parts", ctypes.c_uint32),
        # Starts of blocks to which the path of the held program can be driven backwards from here.
        ("retrace_blocks", ctypes.c_uint32),
        # 1 where the axes are, or were before they were jogged, at an earlier place of the path of the held program; else 0.
        ("retraced", ctypes.c_uint32),
        # Bit i set: the handwheel moves axis i; 0 if it moves none.
        ("handwheel_mask", ctypes.c_uint32),
        # 1 where its enabling button is pressed, or where it has none; 0 without a handwheel.
        ("handwheel_enabled", ctypes.c_uint32),
        # Distance of that axis per detent: mm, degrees for A B C; 0 if it moves none.
        ("handwheel_step", ctypes.c_double),
        # Bit i set: the machine has spindle i; 0 from cores that tell only `spindle_rpm`.
        ("spindle_mask", ctypes.c_uint32),
        # Bit i set: the program has switched the spindle override off for spindle i (M49, M51 P0).
        ("spindle_override_off_mask", ctypes.c_uint32),
        # Present command of each spindle in revolutions per minute, on its ramp, with its override; negative counter-clockwise.
        ("spindle_command_rpm", ctypes.c_float * 4),
        # Measured speed of each spindle in revolutions per minute, negative counter-clockwise; not a number if none is known.
        ("spindle_measured_rpm", ctypes.c_float * 4),
        # By how much this computer's clock is faster than the drives', as the phase lock has found, in millionths: the mean of a second.
        ("clock_drift_ppm", ctypes.c_float),
        # Largest magnitude of the phase error in a second, in ns, at least 1; 0 where the core follows no clock of drives.
        ("phase_error_max_ns", ctypes.c_float),
    ]

    def __init__(self, **values: Any) -> None:
        super().__init__(interface_version=1, struct_size=1840, **values)

    @staticmethod
    def type_name() -> str:
        """Name by which iceoryx2 tells payloads apart."""
        return "evolvent.Status.v1"


class Feedback(ctypes.Structure):
    """A drive bridge's reply to one setpoint.
    """

    interface_version: int
    struct_size: int
    sequence: int
    time_ns: int
    position: ctypes.Array[ctypes.c_double]
    velocity: ctypes.Array[ctypes.c_double]
    following_error: ctypes.Array[ctypes.c_double]
    torque_ratio: ctypes.Array[ctypes.c_double]
    phase_error_ns: int
    status_word: ctypes.Array[ctypes.c_uint32]
    axes_mask: int
    home_switch_mask: int
    positive_limit_mask: int
    negative_limit_mask: int
    bridge_state: int
    note: int
    error_code: int
    fault_reset_done: int
    missed_setpoints: int
    datum: int
    instance: int
    absolute_mask: int
    index_request: int
    index_position: float

    _fields_ = [
        # Version of the bus contract that the sender was built for; receivers reject another version.
        ("interface_version", ctypes.c_uint32),
        # Size of this payload in bytes.
        ("struct_size", ctypes.c_uint32),
        # The setpoint that it replies to.
        ("sequence", ctypes.c_uint64),
        # When the positions were sampled, in ns of CLOCK_MONOTONIC.
        ("time_ns", ctypes.c_uint64),
        # Actual position in machine coordinates: mm, degrees for A B C.
        ("position", ctypes.c_double * 9),
        # Actual velocity: mm/s, degrees/s for A B C.
        ("velocity", ctypes.c_double * 9),
        # Demanded minus actual position: mm, degrees for A B C.
        ("following_error", ctypes.c_double * 9),
        # Torque or force as a ratio of the drive's rated value.
        ("torque_ratio", ctypes.c_double * 9),
        # Time of the bus clock minus time of the setpoint, in ns: positive if the drives run late.
        ("phase_error_ns", ctypes.c_int64),
        # CiA 402 status word (object 6041h) per axis.
        ("status_word", ctypes.c_uint32 * 9),
        # Bit i set: the values of axis i are valid.
        ("axes_mask", ctypes.c_uint32),
        # Bit i set: the home switch of axis i is actuated.
        ("home_switch_mask", ctypes.c_uint32),
        # Bit i set: the limit switch at the positive end of axis i is actuated.
        ("positive_limit_mask", ctypes.c_uint32),
        # Bit i set: the limit switch at the negative end of axis i is actuated.
        ("negative_limit_mask", ctypes.c_uint32),
        # State of the bridge, a number of the list of bridge states.
        ("bridge_state", ctypes.c_uint32),
        # The last problem with setpoints, a number of the list of notes.
        ("note", ctypes.c_uint32),
        # CiA 402 error code (object 603Fh) of the first axis in fault; 0 if none.
        ("error_code", ctypes.c_uint32),
        # The last `fault_reset` of the setpoints that was executed.
        ("fault_reset_done", ctypes.c_uint32),
        # Setpoints that were missing, late or rejected since the start of the bridge.
        ("missed_setpoints", ctypes.c_uint32),
        # The setpoints' `datum` that the positions refer to.
        ("datum", ctypes.c_uint64),
        # Differs at every start of the bridge.
        ("instance", ctypes.c_uint64),
        # Bit i set: positions of axis i refer to machine zero after every start of bridge or drive.
        ("absolute_mask", ctypes.c_uint32),
        # The setpoints' `index_request` that was taken over last; a bridge that latches no index pulses leaves it 0.
        ("index_request", ctypes.c_uint32),
        # Position of its axis at the index pulse, by the names of `datum`; not a number until the pulse has come.
        ("index_position", ctypes.c_double),
    ]

    def __init__(self, **values: Any) -> None:
        super().__init__(interface_version=1, struct_size=424, **values)

    @staticmethod
    def type_name() -> str:
        """Name by which iceoryx2 tells payloads apart."""
        return "evolvent.Feedback.v1"


class Load(ctypes.Structure):
    """A measured cutting load, from a drive or a sensor.
    """

    interface_version: int
    struct_size: int
    sequence: int
    time_ns: int
    kind: int
    source: int
    value: float
    range_min: float
    range_max: float
    reserved: ctypes.Array[ctypes.c_uint64]

    _fields_ = [
        # Version of the bus contract that the sender was built for; receivers reject another version.
        ("interface_version", ctypes.c_uint32),
        # Size of this payload in bytes.
        ("struct_size", ctypes.c_uint32),
        # Grows by one with every value of the same sensor.
        ("sequence", ctypes.c_uint64),
        # When the load was sampled, in ns of CLOCK_MONOTONIC.
        ("time_ns", ctypes.c_uint64),
        # Kind of `value`, a number of the list of load kinds.
        ("kind", ctypes.c_uint32),
        # Where it was measured: 0 to 8 an axis, 9 the spindle, 16 and above user-defined sensors.
        ("source", ctypes.c_uint32),
        # The load in the unit of its kind.
        ("value", ctypes.c_double),
        # The lowest value that the sensor can report.
        ("range_min", ctypes.c_double),
        # The highest value that the sensor can report.
        ("range_max", ctypes.c_double),
        # Zero; for later versions.
        ("reserved", ctypes.c_uint64 * 4),
    ]

    def __init__(self, **values: Any) -> None:
        super().__init__(interface_version=1, struct_size=88, **values)

    @staticmethod
    def type_name() -> str:
        """Name by which iceoryx2 tells payloads apart."""
        return "evolvent.Load.v1"


class MachineOutputs(ctypes.Structure):
    """The commanded state of all peripherals, from one setpoint on.

    Complete in itself: a bridge that has lost a message is correct again with the next. Sent at every
    change and every 50 ms.
    """

    interface_version: int
    struct_size: int
    sequence: int
    cycle: int
    due_time_ns: int
    digital_mask: int
    digital: int
    safe_digital: int
    analog: ctypes.Array[ctypes.c_double]
    safe_analog: ctypes.Array[ctypes.c_double]
    analog_mask: int
    spindle_mask: int
    spindle_direction: ctypes.Array[ctypes.c_uint32]
    spindle_rpm: ctypes.Array[ctypes.c_double]
    coolant: int
    tool_change: int
    tool_wanted: int
    tool: int
    spindle_angle: ctypes.Array[ctypes.c_double]
    spindle_way: ctypes.Array[ctypes.c_uint32]
    reserved: ctypes.Array[ctypes.c_uint64]

    _fields_ = [
        # Version of the bus contract that the sender was built for; receivers reject another version.
        ("interface_version", ctypes.c_uint32),
        # Size of this payload in bytes.
        ("struct_size", ctypes.c_uint32),
        # Grows by one per message.
        ("sequence", ctypes.c_uint64),
        # The setpoint with which these values take effect.
        ("cycle", ctypes.c_uint64),
        # Due time of that setpoint, as its `due_time_ns`.
        ("due_time_ns", ctypes.c_uint64),
        # Bit i set: the machine has digital output i.
        ("digital_mask", ctypes.c_uint64),
        # Bit i: state of digital output i.
        ("digital", ctypes.c_uint64),
        # Bit i: state of digital output i that a bridge sets itself when it has lost its core.
        ("safe_digital", ctypes.c_uint64),
        # Values of the analog outputs.
        ("analog", ctypes.c_double * 16),
        # The same for the analog outputs.
        ("safe_analog", ctypes.c_double * 16),
        # Bit i set: the machine has analog output i.
        ("analog_mask", ctypes.c_uint32),
        # Bit i set: the machine has spindle i.
        ("spindle_mask", ctypes.c_uint32),
        # Command of each spindle, a number of the list of spindle directions.
        ("spindle_direction", ctypes.c_uint32 * 4),
        # Commanded speed of each spindle, rpm, not negative.
        ("spindle_rpm", ctypes.c_double * 4),
        # Bit 0 mist, bit 1 flood.
        ("coolant", ctypes.c_uint32),
        # As `tool_change` of Status.
        ("tool_change", ctypes.c_uint32),
        # As `tool_wanted` of Status.
        ("tool_wanted", ctypes.c_uint32),
        # Tool in the spindle; 0 for none.
        ("tool", ctypes.c_uint32),
        # Orientation angle of a spindle with direction ORIENT, degrees from its index pulse, 0 up to, not including, 360.
        ("spindle_angle", ctypes.c_double * 4),
        # Direction of the orientation, a number of the list of ways.
        ("spindle_way", ctypes.c_uint32 * 4),
        # Zero; for later versions.
        ("reserved", ctypes.c_uint64 * 2),
    ]

    def __init__(self, **values: Any) -> None:
        super().__init__(interface_version=1, struct_size=448, **values)

    @staticmethod
    def type_name() -> str:
        """Name by which iceoryx2 tells payloads apart."""
        return "evolvent.MachineOutputs.v1"


class MachineInputs(ctypes.Structure):
    """The machine's inputs at one instant. Sent at every change, and at least four times per
    `signals.input_timeout_ms` of the machine file: older ones are unknown to the core.
    """

    interface_version: int
    struct_size: int
    sequence: int
    time_ns: int
    instance: int
    outputs_sequence: int
    digital_mask: int
    digital: int
    analog: ctypes.Array[ctypes.c_double]
    analog_mask: int
    probe: int
    probe_trips: int
    probe_time_ns: int
    probe_position: ctypes.Array[ctypes.c_double]
    probe_latched_mask: int
    unused: int
    reserved: ctypes.Array[ctypes.c_uint64]

    _fields_ = [
        # Version of the bus contract that the sender was built for; receivers reject another version.
        ("interface_version", ctypes.c_uint32),
        # Size of this payload in bytes.
        ("struct_size", ctypes.c_uint32),
        # Grows by one per message of the same bridge.
        ("sequence", ctypes.c_uint64),
        # When the inputs were read, in ns of CLOCK_MONOTONIC.
        ("time_ns", ctypes.c_uint64),
        # Differs at every start of the bridge.
        ("instance", ctypes.c_uint64),
        # The `sequence` of the last outputs that were set; 0 for none.
        ("outputs_sequence", ctypes.c_uint64),
        # Bit i set: digital input i was read.
        ("digital_mask", ctypes.c_uint64),
        # Bit i: state of digital input i.
        ("digital", ctypes.c_uint64),
        # Values of the analog inputs.
        ("analog", ctypes.c_double * 16),
        # Bit i set: analog input i was read.
        ("analog_mask", ctypes.c_uint32),
        # State of the probe, a number of the list of probe states.
        ("probe", ctypes.c_uint32),
        # Number of times that the probe has tripped since the start of the bridge.
        ("probe_trips", ctypes.c_uint64),
        # When it last tripped or opened, in ns of CLOCK_MONOTONIC; 0 if unknown.
        ("probe_time_ns", ctypes.c_uint64),
        # Positions that the drives latched at that time: mm, degrees for A B C.
        ("probe_position", ctypes.c_double * 9),
        # Bit i set: the drive of axis i has latched its position.
        ("probe_latched_mask", ctypes.c_uint32),
        # Zero; aligns the following fields to 8 bytes.
        ("unused", ctypes.c_uint32),
        # Zero; for later versions.
        ("reserved", ctypes.c_uint64 * 8),
    ]

    def __init__(self, **values: Any) -> None:
        super().__init__(interface_version=1, struct_size=352, **values)

    @staticmethod
    def type_name() -> str:
        """Name by which iceoryx2 tells payloads apart."""
        return "evolvent.MachineInputs.v1"


class SpindleFeedback(ctypes.Structure):
    """Feedback of the encoder and drive of one spindle at one instant.
    """

    interface_version: int
    struct_size: int
    sequence: int
    time_ns: int
    instance: int
    turns: int
    fraction: float
    speed_rpm: float
    spindle: int
    flags: int
    outputs_sequence: int
    reserved: ctypes.Array[ctypes.c_uint64]

    _fields_ = [
        # Version of the bus contract that the sender was built for; receivers reject another version.
        ("interface_version", ctypes.c_uint32),
        # Size of this payload in bytes.
        ("struct_size", ctypes.c_uint32),
        # Grows by one per message of the same spindle and bridge.
        ("sequence", ctypes.c_uint64),
        # When the angle was sampled, in ns of CLOCK_MONOTONIC.
        ("time_ns", ctypes.c_uint64),
        # Differs at every start of the bridge.
        ("instance", ctypes.c_uint64),
        # Whole turns since the start of the bridge, decreasing counter-clockwise.
        ("turns", ctypes.c_int64),
        # The remaining angle as a fraction of a turn: 0 up to, not including, 1; from the index pulse.
        ("fraction", ctypes.c_double),
        # Measured speed, rpm, negative counter-clockwise.
        ("speed_rpm", ctypes.c_double),
        # The spindle, from 0.
        ("spindle", ctypes.c_uint32),
        # Bits of the list of spindle flags.
        ("flags", ctypes.c_uint32),
        # The `sequence` of the outputs that the spindle executes, 0 for none: the flags refer to these.
        ("outputs_sequence", ctypes.c_uint64),
        # Zero; for later versions.
        ("reserved", ctypes.c_uint64 * 5),
    ]

    def __init__(self, **values: Any) -> None:
        super().__init__(interface_version=1, struct_size=112, **values)

    @staticmethod
    def type_name() -> str:
        """Name by which iceoryx2 tells payloads apart."""
        return "evolvent.SpindleFeedback.v1"


class ControlRequest(ctypes.Structure):
    """A command to the core. A client chooses its number once, at random, and counts its commands from 1: a
    command that is not newer than the client's last one has no effect.
    """

    interface_version: int
    struct_size: int
    client: int
    serial: int
    command: int
    axes_mask: int
    index: int
    text_length: int
    amount: float
    values: ctypes.Array[ctypes.c_double]
    text: ctypes.Array[ctypes.c_uint8]
    reserved: ctypes.Array[ctypes.c_uint64]

    _fields_ = [
        # Version of the bus contract that the sender was built for; receivers reject another version.
        ("interface_version", ctypes.c_uint32),
        # Size of this payload in bytes.
        ("struct_size", ctypes.c_uint32),
        # The client's number, not 0.
        ("client", ctypes.c_uint64),
        # Number of the command, growing from 1 for each client.
        ("serial", ctypes.c_uint64),
        # The command, a number of the list of commands.
        ("command", ctypes.c_uint32),
        # Bit i set: the command is about axis i.
        ("axes_mask", ctypes.c_uint32),
        # A whole number: line to start from, work coordinate system, tool, mode, or 0 and 1 for off and on.
        ("index", ctypes.c_uint32),
        # Bytes of `text` in use.
        ("text_length", ctypes.c_uint32),
        # A ratio (overrides), a speed in mm/s or degrees/s (jog), or a diameter in mm (tool).
        ("amount", ctypes.c_double),
        # A number for each axis: mm, degrees for A B C.
        ("values", ctypes.c_double * 9),
        # A file name or a block of MDI, UTF-8.
        ("text", ctypes.c_uint8 * 1024),
        # Zero; for later versions.
        ("reserved", ctypes.c_uint64 * 8),
    ]

    def __init__(self, **values: Any) -> None:
        super().__init__(interface_version=1, struct_size=1208, **values)

    @staticmethod
    def type_name() -> str:
        """Name by which iceoryx2 tells payloads apart."""
        return "evolvent.ControlRequest.v1"


class ControlAnswer(ctypes.Structure):
    """The core's answer to one command.
    """

    interface_version: int
    struct_size: int
    client: int
    serial: int
    verdict: int
    alarm: int
    sequence: int
    job: int
    text_length: int
    command: int
    text: ctypes.Array[ctypes.c_uint8]
    reserved: ctypes.Array[ctypes.c_uint64]

    _fields_ = [
        # Version of the bus contract that the sender was built for; receivers reject another version.
        ("interface_version", ctypes.c_uint32),
        # Size of this payload in bytes.
        ("struct_size", ctypes.c_uint32),
        # The client's number, as received.
        ("client", ctypes.c_uint64),
        # The command's number, as received.
        ("serial", ctypes.c_uint64),
        # 0 accepted, 1 rejected, 2 not newer than an earlier command and without effect.
        ("verdict", ctypes.c_uint32),
        # Why it was rejected, a number of the list of alarms; 0 if it was accepted.
        ("alarm", ctypes.c_uint32),
        # The last setpoint computed when the command was evaluated.
        ("sequence", ctypes.c_uint64),
        # Number of the job that the command has started; 0 if none.
        ("job", ctypes.c_uint64),
        # Bytes of `text` in use.
        ("text_length", ctypes.c_uint32),
        # The command that `verdict` refers to, as received.
        ("command", ctypes.c_uint32),
        # The error and its remedy, UTF-8.
        ("text", ctypes.c_uint8 * 512),
        # Zero; for later versions.
        ("reserved", ctypes.c_uint64 * 8),
    ]

    def __init__(self, **values: Any) -> None:
        super().__init__(interface_version=1, struct_size=632, **values)

    @staticmethod
    def type_name() -> str:
        """Name by which iceoryx2 tells payloads apart."""
        return "evolvent.ControlAnswer.v1"


def bus_folders() -> list[str]:
    """Folders in which a core of this user may have opened its bus, the usual one first. Not all need be there."""
    if os.environ.get("EVOLVENT_RUNTIME_DIR"):
        return [os.environ["EVOLVENT_RUNTIME_DIR"]]

    def is_ours(path: Optional[str]) -> bool:
        return bool(path) and os.path.isdir(str(path)) and os.lstat(str(path)).st_uid == os.geteuid()

    folders = ["/run/evolvent"] if is_ours("/run/evolvent") else []
    for session in (os.environ.get("XDG_RUNTIME_DIR"), f"/run/user/{os.geteuid()}"):
        if session and is_ours(session):
            folders.append(f"{session.rstrip('/')}/evolvent")
            break
    return folders + [f"/dev/shm/evolvent-{os.geteuid()}"]


def full_prefix(folder: str, prefix: Optional[str] = None) -> str:
    """What names of segments begin with: the prefix, and a number of this very folder (FNV-1a of path, device, inode).

    Raises PermissionError where the folder is not this user's alone.
    """
    facts = os.lstat(folder)
    if not stat.S_ISDIR(facts.st_mode) or facts.st_uid != os.geteuid() or facts.st_mode & 0o022:
        raise PermissionError(f"the bus's folder {folder} must be a folder of this user to which nobody else may write")
    number = 0x811C9DC5
    for byte in f"{folder}:{facts.st_dev}:{facts.st_ino}".encode():
        number = (number ^ byte) * 0x01000193 & 0xFFFFFFFF
    return f"{'evolvent-' if prefix is None else prefix}{number:08x}-"


def find_core(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> tuple[str, str]:
    """Folder and full prefix of the bus that a machine's core has opened, waiting for it.

    Fails with TimeoutError where there is no core.
    """
    # A single name may be a prefix too, as `open_node` took it up to version 0.1.
    searches = [(f"evolvent/{machine_name}/setpoint".encode(), prefix)]
    if prefix is None:
        searches.append((b"/setpoint", machine_name))
    deadline = time.monotonic() + timeout_s
    while True:
        for folder in filter(os.path.isdir, bus_folders()):
            for wanted, of_prefix in searches:
                full = full_prefix(folder, of_prefix)
                for service in glob.glob(f"{glob.escape(folder)}/services/{full}*.service"):
                    try:
                        with open(service, "rb") as file:
                            if wanted in file.read():
                                return folder, full
                    except OSError:
                        pass  # It is just being made or removed.
        if time.monotonic() >= deadline:
            raise TimeoutError(f"no core of machine {machine_name} of this user within {timeout_s} s")
        time.sleep(0.005)


def open_node(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Any:
    """An iceoryx2 node where a machine's core has its bus, waiting for it. `open_node(PREFIX)` takes the only core of a prefix."""
    import iceoryx2 as iox2

    folder, full = find_core(machine_name, prefix, timeout_s)
    # Waiting for a core that is not up yet is no error worth a line.
    iox2.set_log_level_from_env_or(iox2.LogLevel.Fatal)
    config = iox2.config.global_config()
    config.global_cfg.root_path = iox2.Path.new(folder + "/")
    config.global_cfg.prefix = iox2.FileName.new(full)
    # Signals are the caller's affair.
    return iox2.NodeBuilder.new().config(config).signal_handling_mode(
        iox2.SignalHandlingMode.Disabled
    ).create(iox2.ServiceType.Ipc)


def open_service(node: Any, machine_name: str, channel: str, payload: type, timeout_s: float = 10.0) -> Any:
    """The publish-subscribe service `evolvent/MACHINE_NAME/CHANNEL`, waiting for its core to come up.

    Fails with TimeoutError where there is no core, with RuntimeError where it speaks another version.
    """
    import iceoryx2 as iox2

    name = iox2.ServiceName.new(f"evolvent/{machine_name}/{channel}")
    wanted = iox2.AttributeVerifier.new().require(
        iox2.AttributeKey.new(ATTRIBUTE_INTERFACE), iox2.AttributeValue.new(str(INTERFACE_VERSION))
    )
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return node.service_builder(name).publish_subscribe(payload).open_with_attributes(wanted)
        except iox2.PublishSubscribeOpenError as error:
            reason = str(error)
        if "Incompatible" in reason or "DoesNotSupport" in reason:
            raise RuntimeError(f"{name}: the core does not fit this module ({reason})")
        if time.monotonic() >= deadline:
            raise TimeoutError(f"{name}: no core within {timeout_s} s ({reason})")
        time.sleep(0.005)


class Reader:
    """Messages of one channel, in order."""

    def __init__(
        self,
        machine_name: str,
        channel: str,
        payload: type,
        prefix: Optional[str] = None,
        timeout_s: float = 10.0,
        places_left: int = 0,
        buffer: Optional[int] = None,
    ) -> None:
        """`places_left` are left to others: `RuntimeError` where no more than these are free. `buffer` messages wait, else as many as the channel permits."""
        self._payload: Any = payload
        self._node = open_node(machine_name, prefix, timeout_s)
        self._service = open_service(self._node, machine_name, channel, payload, timeout_s)
        taken = self._service.dynamic_config.number_of_subscribers
        if taken + places_left >= self._service.static_config.max_subscribers:
            raise RuntimeError(f"{channel} of {machine_name} has no place for another reader: close one")
        builder = self._service.subscriber_builder()
        self._subscriber = (builder if buffer is None else builder.buffer_size(buffer)).create()

    @property
    def attributes(self) -> dict[str, str]:
        """The service's attributes as a dict of texts."""
        return {a.key.to_string(): a.value.to_string() for a in self._service.attributes.values}

    def receive(self) -> Any:
        """A copy of the oldest message not read yet, or None. Does not wait."""
        sample = self._subscriber.receive()
        if sample is None:
            return None
        try:
            message = self._payload.from_buffer_copy(sample.payload().contents)
        finally:
            sample.delete()
        if message.interface_version != INTERFACE_VERSION or message.struct_size != ctypes.sizeof(self._payload):
            raise RuntimeError(f"a message of interface version {message.interface_version}: update the older side")
        return message


def open_setpoints(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Reader:
    """A reader of every setpoint from now on; more than the buffer behind, it loses the oldest."""
    return Reader(machine_name, "setpoint", Setpoint, prefix, timeout_s, places_left=PLACES_FOR_BRIDGES)


def open_setpoints_of_bridge(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Reader:
    """The same for a drive bridge, for which readers leave a place."""
    return Reader(machine_name, "setpoint", Setpoint, prefix, timeout_s)


def open_status(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Reader:
    """A reader of the latest status."""
    return Reader(machine_name, "status", Status, prefix, timeout_s, places_left=PLACES_FOR_OPERATORS, buffer=1)


def open_outputs(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Reader:
    """A reader of the machine's outputs: those in force, then every change."""
    return Reader(machine_name, "output", MachineOutputs, prefix, timeout_s)


class Sender:
    """Sends messages of one channel."""

    def __init__(
        self, machine_name: str, channel: str, payload: type, prefix: Optional[str] = None, timeout_s: float = 10.0
    ) -> None:
        self._payload: Any = payload
        self._node = open_node(machine_name, prefix, timeout_s)
        self._service = open_service(self._node, machine_name, channel, payload, timeout_s)
        self._publisher = self._service.publisher_builder().create()

    def send(self, message: Any) -> None:
        """Sends a copy of a message. Never waits."""
        sample = self._publisher.loan_uninit()
        sample.write_payload(message).send()


def open_inputs(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Sender:
    """A sender of MachineInputs. Send at least four times in the machine file's `signals.input_timeout_ms`."""
    return Sender(machine_name, "input", MachineInputs, prefix, timeout_s)


def open_spindle(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Sender:
    """A sender of SpindleFeedback."""
    return Sender(machine_name, "spindle", SpindleFeedback, prefix, timeout_s)
