/* Layout of Evolvent's messages on iceoryx2, interface version 1.
 * Generated: do not edit, run `cargo run -p evolvent-bus --example generate-bindings`.
 *
 * Services are named evolvent/NAME/setpoint, /status, /feedback, /load, /output, /input, /spindle
 * (publish-subscribe), /event,
 * and /control (request-response of ControlRequest and ControlAnswer).
 * Axes are in the order X Y Z A B C U V W. */
#ifndef EVOLVENT_BUS_H
#define EVOLVENT_BUS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define EVOLVENT_STATIC_ASSERT static_assert
extern "C" {
#else
#define EVOLVENT_STATIC_ASSERT _Static_assert
#endif

#define EVOLVENT_INTERFACE_VERSION 1u
#define EVOLVENT_AXES 9
#define EVOLVENT_DIGITAL_SIGNALS 64
#define EVOLVENT_ANALOG_SIGNALS 16
#define EVOLVENT_SPINDLES 4
#define EVOLVENT_ATTRIBUTE_INTERFACE "evolvent.interface"
#define EVOLVENT_ATTRIBUTE_PERIOD "evolvent.period_ns"
#define EVOLVENT_ATTRIBUTE_AXES "evolvent.axes"

/* Values of `state` in Setpoint and Status. */
#define EVOLVENT_STATE_IDLE 0u
#define EVOLVENT_STATE_RUNNING 1u
#define EVOLVENT_STATE_HOLDING 2u
#define EVOLVENT_STATE_HELD 3u
#define EVOLVENT_STATE_STOPPING 4u
#define EVOLVENT_STATE_STOPPED 5u
#define EVOLVENT_STATE_DWELL 6u
#define EVOLVENT_STATE_PROGRAM_STOP 7u
#define EVOLVENT_STATE_FAULT 8u
#define EVOLVENT_STATE_DONE 9u

/* Bits of `flags` in Setpoint and Status. */
#define EVOLVENT_FLAG_LATE 1u
#define EVOLVENT_FLAG_HOLD 2u
#define EVOLVENT_FLAG_BLEND 4u
#define EVOLVENT_FLAG_RAPID 8u
#define EVOLVENT_FLAG_JOINT 16u
#define EVOLVENT_FLAG_STARVED 32u
#define EVOLVENT_FLAG_GUARD 64u
#define EVOLVENT_FLAG_LAST 128u

/* Values of `power_request` in Setpoint. */
#define EVOLVENT_POWER_OFF 0u
#define EVOLVENT_POWER_ON 1u
#define EVOLVENT_POWER_QUICK_STOP 2u

/* Values of `bridge_state` in Feedback. */
#define EVOLVENT_BRIDGE_WAITING 0u
#define EVOLVENT_BRIDGE_FOLLOWING 1u
#define EVOLVENT_BRIDGE_BRIDGING 2u
#define EVOLVENT_BRIDGE_BRAKING 3u
#define EVOLVENT_BRIDGE_HOLDING 4u
#define EVOLVENT_BRIDGE_OFF 5u

/* Values of `note` in Feedback. */
#define EVOLVENT_NOTE_NONE 0u
#define EVOLVENT_NOTE_GAP 1u
#define EVOLVENT_NOTE_SILENCE 2u
#define EVOLVENT_NOTE_LATE 3u
#define EVOLVENT_NOTE_JUMP 4u
#define EVOLVENT_NOTE_RESTART 5u
#define EVOLVENT_NOTE_NOT_FINITE 6u
#define EVOLVENT_NOTE_VERSION 7u

/* Values of `kind` in Load. */
#define EVOLVENT_LOAD_FORCE_N 1u
#define EVOLVENT_LOAD_TORQUE_N_M 2u
#define EVOLVENT_LOAD_POWER_W 3u
#define EVOLVENT_LOAD_CURRENT_A 4u
#define EVOLVENT_LOAD_RATIO_OF_RATED 5u

/* Values of `spindle_direction` in MachineOutputs. */
#define EVOLVENT_DIRECTION_STOPPED 0u
#define EVOLVENT_DIRECTION_CLOCKWISE 1u
#define EVOLVENT_DIRECTION_COUNTER_CLOCKWISE 2u
#define EVOLVENT_DIRECTION_ORIENT 3u

/* Values of `spindle_way` in MachineOutputs. */
#define EVOLVENT_WAY_SHORTER 0u
#define EVOLVENT_WAY_CLOCKWISE 1u
#define EVOLVENT_WAY_COUNTER_CLOCKWISE 2u

/* Values of `probe` in MachineInputs. */
#define EVOLVENT_PROBE_NONE 0u
#define EVOLVENT_PROBE_OPEN 1u
#define EVOLVENT_PROBE_TRIPPED 2u

/* Bits of `flags` in SpindleFeedback. */
#define EVOLVENT_SPINDLE_AT_SPEED 1u
#define EVOLVENT_SPINDLE_FAULT 2u
#define EVOLVENT_SPINDLE_INDEXED 4u
#define EVOLVENT_SPINDLE_ORIENTED 8u

/* Numbers on the event channel. */
#define EVOLVENT_EVENT_CORE_OPENED 1u
#define EVOLVENT_EVENT_CORE_CLOSED 2u
#define EVOLVENT_EVENT_CORE_DIED 3u
#define EVOLVENT_EVENT_STARTED 4u
#define EVOLVENT_EVENT_HOLD 5u
#define EVOLVENT_EVENT_RESUMED 6u
#define EVOLVENT_EVENT_STOPPED 7u
#define EVOLVENT_EVENT_DONE 8u
#define EVOLVENT_EVENT_FAULT 9u
#define EVOLVENT_EVENT_RESET 10u
#define EVOLVENT_EVENT_STATUS_CHANGED 11u

/* Values of `command` in ControlRequest. */
#define EVOLVENT_COMMAND_ESTOP 1u
#define EVOLVENT_COMMAND_ESTOP_RESET 2u
#define EVOLVENT_COMMAND_ON 3u
#define EVOLVENT_COMMAND_OFF 4u
#define EVOLVENT_COMMAND_MODE 5u
#define EVOLVENT_COMMAND_LOAD 6u
#define EVOLVENT_COMMAND_START 7u
#define EVOLVENT_COMMAND_HOLD 8u
#define EVOLVENT_COMMAND_RESUME 9u
#define EVOLVENT_COMMAND_STEP 10u
#define EVOLVENT_COMMAND_STOP 11u
#define EVOLVENT_COMMAND_RESET 12u
#define EVOLVENT_COMMAND_SINGLE_STEP 13u
#define EVOLVENT_COMMAND_OPTIONAL_STOP 14u
#define EVOLVENT_COMMAND_BLOCK_DELETE 15u
#define EVOLVENT_COMMAND_FEED_OVERRIDE 16u
#define EVOLVENT_COMMAND_RAPID_OVERRIDE 17u
#define EVOLVENT_COMMAND_SPINDLE_OVERRIDE 18u
#define EVOLVENT_COMMAND_MDI 19u
#define EVOLVENT_COMMAND_JOG 20u
#define EVOLVENT_COMMAND_JOG_KEEP 21u
#define EVOLVENT_COMMAND_JOG_STOP 22u
#define EVOLVENT_COMMAND_HOME 23u
#define EVOLVENT_COMMAND_WORK_OFFSET 24u
#define EVOLVENT_COMMAND_TOUCH_OFF 25u
#define EVOLVENT_COMMAND_TOOL 26u
#define EVOLVENT_COMMAND_CLEAR_ALARMS 27u
#define EVOLVENT_COMMAND_SET_OUTPUT 28u
#define EVOLVENT_COMMAND_HANDWHEEL 29u
#define EVOLVENT_COMMAND_RETURN 30u
#define EVOLVENT_COMMAND_RETRACE 31u

/* Values of `verdict` in ControlAnswer. */
#define EVOLVENT_VERDICT_ACCEPTED 0u
#define EVOLVENT_VERDICT_REJECTED 1u
#define EVOLVENT_VERDICT_STALE 2u

/* Values of `machine_state` in Status. */
#define EVOLVENT_MACHINE_ESTOP 0u
#define EVOLVENT_MACHINE_OFF 1u
#define EVOLVENT_MACHINE_ON 2u

/* Values of `mode` in Status and of the command MODE. */
#define EVOLVENT_MODE_AUTO 0u
#define EVOLVENT_MODE_MANUAL 1u
#define EVOLVENT_MODE_MDI 2u

/* Values of `activity` in Status. */
#define EVOLVENT_ACTIVITY_NONE 0u
#define EVOLVENT_ACTIVITY_PROGRAM 1u
#define EVOLVENT_ACTIVITY_MDI 2u
#define EVOLVENT_ACTIVITY_JOG 3u
#define EVOLVENT_ACTIVITY_HOMING 4u

/* Values of `job_result` in Status. */
#define EVOLVENT_RESULT_NONE 0u
#define EVOLVENT_RESULT_DONE 1u
#define EVOLVENT_RESULT_STOPPED 2u
#define EVOLVENT_RESULT_FAILED 3u
#define EVOLVENT_RESULT_FAULT 4u

/* Bits of `switches` in Status. */
#define EVOLVENT_SWITCH_SINGLE_STEP 1u
#define EVOLVENT_SWITCH_OPTIONAL_STOP 2u
#define EVOLVENT_SWITCH_BLOCK_DELETE 4u
#define EVOLVENT_SWITCH_HOLD 8u
#define EVOLVENT_SWITCH_CHAIN_OPEN 16u
#define EVOLVENT_SWITCH_INPUT_WAIT 32u
#define EVOLVENT_SWITCH_PROBE_OPEN 64u
#define EVOLVENT_SWITCH_PROBE_TRIPPED 128u
#define EVOLVENT_SWITCH_TOOL_UNKNOWN 256u

/* Target position of every axis at one instant, and its derivatives.
 *
 * Published ahead of time: in a real-time run `due_time_ns` is `lead` periods after publication.
 * `sequence` grows by one per setpoint, so a gap is a lost setpoint and is detected as one.
 */
#define EVOLVENT_SETPOINT_TYPE_NAME "evolvent.Setpoint.v1"
typedef struct evolvent_setpoint {
    /* Version of the bus contract that the sender was built for; receivers reject another version. */
    uint32_t interface_version;
    /* Size of this payload in bytes. */
    uint32_t struct_size;
    /* Index of the cycle; grows by exactly one. */
    uint64_t sequence;
    /* When the setpoint holds: ns of CLOCK_MONOTONIC (real-time clock) or of path time (virtual clock). */
    uint64_t due_time_ns;
    /* Time from this setpoint to the next, in ns. */
    uint64_t period_ns;
    /* Position in machine coordinates: mm, degrees for A B C. */
    double position[9];
    /* Velocity: mm/s, degrees/s for A B C. */
    double velocity[9];
    /* Acceleration: mm/s2, degrees/s2 for A B C. */
    double acceleration[9];
    /* Position rounded to the machine's increments, counted from machine zero. */
    int64_t position_increments[9];
    /* State of the core, a number of the list of states. */
    uint32_t state;
    /* Bits of the list of setpoint flags. */
    uint32_t flags;
    /* Line of the program, counted from 1; 0 if none. */
    uint32_t line;
    /* Bit i set: axis i is driven; the values of the others have no meaning. */
    uint32_t axes_mask;
    /* Speed along the path, in mm/s. */
    double feed_mm_s;
    /* Feed override as a ratio: 1 is 100 %. */
    double override_ratio;
    /* Distance along the path since the start of the run, in mm. */
    double path_mm;
    /* Requested state of the drives' power stages, a number of the list of power requests. */
    uint32_t power_request;
    /* Grows by one to request a reset of the drives' faults. */
    uint32_t fault_reset;
    /* Grows by one when homing assigns new coordinates: the axes are at rest, and the step of position is not a motion. */
    uint64_t datum;
    /* Another number, not 0: the next index pulse of the encoder of axis `index_axis` is to be latched. */
    uint32_t index_request;
    /* The axis of `index_request`, an index into X Y Z A B C U V W. */
    uint32_t index_axis;
    /* Zero; for later versions. */
    uint64_t reserved[2];
} evolvent_setpoint_t;

EVOLVENT_STATIC_ASSERT(sizeof(evolvent_setpoint_t) == 400, "size of Setpoint");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, interface_version) == 0, "offset of Setpoint.interface_version");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, struct_size) == 4, "offset of Setpoint.struct_size");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, sequence) == 8, "offset of Setpoint.sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, due_time_ns) == 16, "offset of Setpoint.due_time_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, period_ns) == 24, "offset of Setpoint.period_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, position) == 32, "offset of Setpoint.position");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, velocity) == 104, "offset of Setpoint.velocity");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, acceleration) == 176, "offset of Setpoint.acceleration");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, position_increments) == 248, "offset of Setpoint.position_increments");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, state) == 320, "offset of Setpoint.state");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, flags) == 324, "offset of Setpoint.flags");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, line) == 328, "offset of Setpoint.line");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, axes_mask) == 332, "offset of Setpoint.axes_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, feed_mm_s) == 336, "offset of Setpoint.feed_mm_s");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, override_ratio) == 344, "offset of Setpoint.override_ratio");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, path_mm) == 352, "offset of Setpoint.path_mm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, power_request) == 360, "offset of Setpoint.power_request");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, fault_reset) == 364, "offset of Setpoint.fault_reset");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, datum) == 368, "offset of Setpoint.datum");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, index_request) == 376, "offset of Setpoint.index_request");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, index_axis) == 380, "offset of Setpoint.index_axis");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_setpoint_t, reserved) == 384, "offset of Setpoint.reserved");

/* One coherent snapshot of the core. A reader receives the latest, never a mixture of two.
 *
 * The publisher sends at least ten per second; a reader that sees no new `sequence` for longer has lost
 * its core.
 */
#define EVOLVENT_STATUS_TYPE_NAME "evolvent.Status.v1"
typedef struct evolvent_status {
    /* Version of the bus contract that the sender was built for; receivers reject another version. */
    uint32_t interface_version;
    /* Size of this payload in bytes. */
    uint32_t struct_size;
    /* Grows by one per snapshot. */
    uint64_t sequence;
    /* When the snapshot was taken, in ns of CLOCK_MONOTONIC. */
    uint64_t time_ns;
    /* Setpoints computed since the start. */
    uint64_t cycles;
    /* The control period in ns. */
    uint64_t period_ns;
    /* State of the core, a number of the list of states. */
    uint32_t state;
    /* Mode: 0 automatic, 1 manual, 2 MDI. */
    uint32_t mode;
    /* Machine: 0 emergency stop, 1 off, 2 on. */
    uint32_t machine_state;
    /* Bits of the last setpoint's flags. */
    uint32_t flags;
    /* Line of the running program, counted from 1; 0 if none. */
    uint32_t line;
    /* Bit i set: the machine has axis i. */
    uint32_t axes_mask;
    /* Bit i set: axis i has been homed. */
    uint32_t homed_mask;
    /* Tool in the spindle; 0 for none. */
    uint32_t tool;
    /* Selected work coordinate system times ten: 540 is G54, 591 is G59.1. */
    uint32_t work_system;
    /* Subscribers of the setpoint channel. */
    uint32_t setpoint_subscribers;
    /* Position in machine coordinates: mm, degrees for A B C. */
    double position_machine[9];
    /* Position in work coordinates: mm, degrees for A B C. */
    double position_work[9];
    /* Distance to the end of the running block, per axis: mm, degrees for A B C. */
    double distance_to_go[9];
    /* Velocity: mm/s, degrees/s for A B C. */
    double velocity[9];
    /* Work offset in force, G92 included: mm, degrees for A B C. */
    double work_offset[9];
    /* Tool offset in force: mm, degrees for A B C. */
    double tool_offset[9];
    /* Distance along the path since the start of the run, in mm. */
    double path_mm;
    /* Distance to the end of the planned path, in mm. */
    double path_to_go_mm;
    /* Speed along the path, in mm/s. */
    double feed_mm_s;
    /* Programmed speed along the path, in mm/s. */
    double feed_programmed_mm_s;
    /* Feed override as a ratio: 1 is 100 %. */
    double override_ratio;
    /* Rapid override as a ratio. */
    double rapid_override_ratio;
    /* Spindle override as a ratio. */
    double spindle_override_ratio;
    /* Spindle speed in revolutions per minute, negative counter-clockwise. */
    double spindle_rpm;
    /* Setpoints that were published after their due time. */
    uint64_t late_cycles;
    /* Trace records lost because the queue was full. */
    uint64_t dropped_records;
    /* Setpoints that could not be passed to the bus. */
    uint64_t dropped_setpoints;
    /* Lateness of the last wake-up, in ns. */
    uint64_t wake_lateness_ns;
    /* Median lateness of the wake-ups, in ns. */
    uint64_t wake_lateness_p50_ns;
    /* 99.9 % of the wake-ups were at most this late, in ns. */
    uint64_t wake_lateness_p999_ns;
    /* Maximum lateness of the wake-ups since the start, in ns. */
    uint64_t wake_lateness_max_ns;
    /* Median time of a cycle's own work, in ns. */
    uint64_t work_p50_ns;
    /* Own work of 99.9 % of the cycles was at most this long, in ns. */
    uint64_t work_p999_ns;
    /* Maximum own work of a cycle since the start, in ns. */
    uint64_t work_max_ns;
    /* Number of alarms in force; may exceed the listed ones. */
    uint32_t alarm_count;
    /* Bytes of `program` in use. */
    uint32_t program_length;
    /* Numbers of the alarms in force: their cause first (the first fault, else the job's, else the first warning), then from the oldest. */
    uint32_t alarms[16];
    /* Name of the loaded program, UTF-8. */
    uint8_t program[128];
    /* What moves the axes, a number of the list of activities. */
    uint32_t activity;
    /* How the last job ended, a number of the list of results. */
    uint32_t job_result;
    /* Number of the job that runs or, at rest, ran last; 0 before the first. */
    uint64_t job;
    /* Bits of the list of switches. */
    uint32_t switches;
    /* Power request to the drives: 0 off, 1 on, 2 quick stop. */
    uint32_t power;
    /* Bit i set: the drive of axis i reports operation enabled. */
    uint32_t enabled_mask;
    /* Bit 0 mist, bit 1 flood. */
    uint32_t coolant;
    /* Modal G codes times ten in no particular order, padded with zeros. */
    uint32_t modal[16];
    /* Position of machine zero in the drives' coordinates, as found by homing: mm, degrees for A B C. */
    double home_offset[9];
    /* Actual position in machine coordinates, from the bridge: mm, degrees for A B C. */
    double position_actual[9];
    /* Demanded minus actual position, from the bridge: mm, degrees for A B C. */
    double following_error[9];
    /* Age of the last feedback, in ns; the largest number if none has arrived. */
    uint64_t feedback_age_ns;
    /* Commands that were accepted. */
    uint64_t commands_accepted;
    /* Commands that were rejected, including stale ones. */
    uint64_t commands_rejected;
    /* Bytes of `alarm_text` in use. */
    uint32_t alarm_text_length;
    /* Bytes of `message` in use. */
    uint32_t message_length;
    /* The sentence of the first of `alarms`: the error and its remedy, UTF-8. */
    uint8_t alarm_text[256];
    /* The program's last message to the operator, UTF-8. */
    uint8_t message[256];
    /* Tool change that the program waits for: 0 none, 1 by the operator (confirmed by RESUME), 2 by the machine's executable or subroutine. */
    uint32_t tool_change;
    /* If `tool_change` is not 0: the tool to put into the spindle; 0 to empty the spindle. */
    uint32_t tool_wanted;
    /* Longest path that a hold needs to stop at any moment of `job` so far, in mm, with a margin; 0 if unknown. */
    double longest_stop_mm;
    /* Time of that stop, in s. */
    double longest_stop_s;
    /* Line of the program at which that hold starts. */
    uint32_t longest_stop_line;
    /* Number of times that the loaded program has reached its end since it was loaded. */
    uint32_t parts;
    /* Running time of the current or last run of the program, in s. */
    double program_time_s;
    /* Time of it spent in holds and program stops, in s, without waits for a spindle, an input or a user-defined M code. */
    double program_held_s;
    /* Bit i set: axis i was jogged away from the program that is held. */
    uint32_t away_mask;
    /* Parts of the way back to where the program was left, which `message` tells; 0 where the axes are not away. */
    uint32_t away_parts;
    /* Starts of blocks to which the path of the held program can be driven backwards from here. */
    uint32_t retrace_blocks;
    /* 1 where the axes are, or were before they were jogged, at an earlier place of the path of the held program; else 0. */
    uint32_t retraced;
    /* Bit i set: the handwheel moves axis i; 0 if it moves none. */
    uint32_t handwheel_mask;
    /* 1 where its enabling button is pressed, or where it has none; 0 without a handwheel. */
    uint32_t handwheel_enabled;
    /* Distance of that axis per detent: mm, degrees for A B C; 0 if it moves none. */
    double handwheel_step;
    /* Bit i set: the machine has spindle i; 0 from cores that tell only `spindle_rpm`. */
    uint32_t spindle_mask;
    /* Bit i set: the program has switched the spindle override off for spindle i (M49, M51 P0). */
    uint32_t spindle_override_off_mask;
    /* Present command of each spindle in revolutions per minute, on its ramp, with its override; negative counter-clockwise. */
    float spindle_command_rpm[4];
    /* Measured speed of each spindle in revolutions per minute, negative counter-clockwise; not a number if none is known. */
    float spindle_measured_rpm[4];
    /* By how much this computer's clock is faster than the drives', as the phase lock has found, in millionths: the mean of a second. */
    float clock_drift_ppm;
    /* Largest magnitude of the phase error in a second, in ns, at least 1; 0 where the core follows no clock of drives. */
    float phase_error_max_ns;
} evolvent_status_t;

EVOLVENT_STATIC_ASSERT(sizeof(evolvent_status_t) == 1840, "size of Status");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, interface_version) == 0, "offset of Status.interface_version");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, struct_size) == 4, "offset of Status.struct_size");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, sequence) == 8, "offset of Status.sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, time_ns) == 16, "offset of Status.time_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, cycles) == 24, "offset of Status.cycles");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, period_ns) == 32, "offset of Status.period_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, state) == 40, "offset of Status.state");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, mode) == 44, "offset of Status.mode");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, machine_state) == 48, "offset of Status.machine_state");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, flags) == 52, "offset of Status.flags");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, line) == 56, "offset of Status.line");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, axes_mask) == 60, "offset of Status.axes_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, homed_mask) == 64, "offset of Status.homed_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, tool) == 68, "offset of Status.tool");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, work_system) == 72, "offset of Status.work_system");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, setpoint_subscribers) == 76, "offset of Status.setpoint_subscribers");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, position_machine) == 80, "offset of Status.position_machine");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, position_work) == 152, "offset of Status.position_work");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, distance_to_go) == 224, "offset of Status.distance_to_go");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, velocity) == 296, "offset of Status.velocity");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, work_offset) == 368, "offset of Status.work_offset");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, tool_offset) == 440, "offset of Status.tool_offset");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, path_mm) == 512, "offset of Status.path_mm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, path_to_go_mm) == 520, "offset of Status.path_to_go_mm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, feed_mm_s) == 528, "offset of Status.feed_mm_s");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, feed_programmed_mm_s) == 536, "offset of Status.feed_programmed_mm_s");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, override_ratio) == 544, "offset of Status.override_ratio");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, rapid_override_ratio) == 552, "offset of Status.rapid_override_ratio");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, spindle_override_ratio) == 560, "offset of Status.spindle_override_ratio");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, spindle_rpm) == 568, "offset of Status.spindle_rpm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, late_cycles) == 576, "offset of Status.late_cycles");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, dropped_records) == 584, "offset of Status.dropped_records");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, dropped_setpoints) == 592, "offset of Status.dropped_setpoints");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, wake_lateness_ns) == 600, "offset of Status.wake_lateness_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, wake_lateness_p50_ns) == 608, "offset of Status.wake_lateness_p50_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, wake_lateness_p999_ns) == 616, "offset of Status.wake_lateness_p999_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, wake_lateness_max_ns) == 624, "offset of Status.wake_lateness_max_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, work_p50_ns) == 632, "offset of Status.work_p50_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, work_p999_ns) == 640, "offset of Status.work_p999_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, work_max_ns) == 648, "offset of Status.work_max_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, alarm_count) == 656, "offset of Status.alarm_count");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, program_length) == 660, "offset of Status.program_length");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, alarms) == 664, "offset of Status.alarms");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, program) == 728, "offset of Status.program");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, activity) == 856, "offset of Status.activity");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, job_result) == 860, "offset of Status.job_result");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, job) == 864, "offset of Status.job");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, switches) == 872, "offset of Status.switches");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, power) == 876, "offset of Status.power");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, enabled_mask) == 880, "offset of Status.enabled_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, coolant) == 884, "offset of Status.coolant");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, modal) == 888, "offset of Status.modal");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, home_offset) == 952, "offset of Status.home_offset");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, position_actual) == 1024, "offset of Status.position_actual");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, following_error) == 1096, "offset of Status.following_error");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, feedback_age_ns) == 1168, "offset of Status.feedback_age_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, commands_accepted) == 1176, "offset of Status.commands_accepted");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, commands_rejected) == 1184, "offset of Status.commands_rejected");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, alarm_text_length) == 1192, "offset of Status.alarm_text_length");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, message_length) == 1196, "offset of Status.message_length");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, alarm_text) == 1200, "offset of Status.alarm_text");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, message) == 1456, "offset of Status.message");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, tool_change) == 1712, "offset of Status.tool_change");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, tool_wanted) == 1716, "offset of Status.tool_wanted");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, longest_stop_mm) == 1720, "offset of Status.longest_stop_mm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, longest_stop_s) == 1728, "offset of Status.longest_stop_s");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, longest_stop_line) == 1736, "offset of Status.longest_stop_line");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, parts) == 1740, "offset of Status.parts");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, program_time_s) == 1744, "offset of Status.program_time_s");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, program_held_s) == 1752, "offset of Status.program_held_s");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, away_mask) == 1760, "offset of Status.away_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, away_parts) == 1764, "offset of Status.away_parts");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, retrace_blocks) == 1768, "offset of Status.retrace_blocks");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, retraced) == 1772, "offset of Status.retraced");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, handwheel_mask) == 1776, "offset of Status.handwheel_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, handwheel_enabled) == 1780, "offset of Status.handwheel_enabled");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, handwheel_step) == 1784, "offset of Status.handwheel_step");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, spindle_mask) == 1792, "offset of Status.spindle_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, spindle_override_off_mask) == 1796, "offset of Status.spindle_override_off_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, spindle_command_rpm) == 1800, "offset of Status.spindle_command_rpm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, spindle_measured_rpm) == 1816, "offset of Status.spindle_measured_rpm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, clock_drift_ppm) == 1832, "offset of Status.clock_drift_ppm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_status_t, phase_error_max_ns) == 1836, "offset of Status.phase_error_max_ns");

/* A drive bridge's reply to one setpoint.
 */
#define EVOLVENT_FEEDBACK_TYPE_NAME "evolvent.Feedback.v1"
typedef struct evolvent_feedback {
    /* Version of the bus contract that the sender was built for; receivers reject another version. */
    uint32_t interface_version;
    /* Size of this payload in bytes. */
    uint32_t struct_size;
    /* The setpoint that it replies to. */
    uint64_t sequence;
    /* When the positions were sampled, in ns of CLOCK_MONOTONIC. */
    uint64_t time_ns;
    /* Actual position in machine coordinates: mm, degrees for A B C. */
    double position[9];
    /* Actual velocity: mm/s, degrees/s for A B C. */
    double velocity[9];
    /* Demanded minus actual position: mm, degrees for A B C. */
    double following_error[9];
    /* Torque or force as a ratio of the drive's rated value. */
    double torque_ratio[9];
    /* Time of the bus clock minus time of the setpoint, in ns: positive if the drives run late. */
    int64_t phase_error_ns;
    /* CiA 402 status word (object 6041h) per axis. */
    uint32_t status_word[9];
    /* Bit i set: the values of axis i are valid. */
    uint32_t axes_mask;
    /* Bit i set: the home switch of axis i is actuated. */
    uint32_t home_switch_mask;
    /* Bit i set: the limit switch at the positive end of axis i is actuated. */
    uint32_t positive_limit_mask;
    /* Bit i set: the limit switch at the negative end of axis i is actuated. */
    uint32_t negative_limit_mask;
    /* State of the bridge, a number of the list of bridge states. */
    uint32_t bridge_state;
    /* The last problem with setpoints, a number of the list of notes. */
    uint32_t note;
    /* CiA 402 error code (object 603Fh) of the first axis in fault; 0 if none. */
    uint32_t error_code;
    /* The last `fault_reset` of the setpoints that was executed. */
    uint32_t fault_reset_done;
    /* Setpoints that were missing, late or rejected since the start of the bridge. */
    uint32_t missed_setpoints;
    /* The setpoints' `datum` that the positions refer to. */
    uint64_t datum;
    /* Differs at every start of the bridge. */
    uint64_t instance;
    /* Bit i set: positions of axis i refer to machine zero after every start of bridge or drive. */
    uint32_t absolute_mask;
    /* The setpoints' `index_request` that was taken over last; a bridge that latches no index pulses leaves it 0. */
    uint32_t index_request;
    /* Position of its axis at the index pulse, by the names of `datum`; not a number until the pulse has come. */
    double index_position;
} evolvent_feedback_t;

EVOLVENT_STATIC_ASSERT(sizeof(evolvent_feedback_t) == 424, "size of Feedback");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, interface_version) == 0, "offset of Feedback.interface_version");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, struct_size) == 4, "offset of Feedback.struct_size");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, sequence) == 8, "offset of Feedback.sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, time_ns) == 16, "offset of Feedback.time_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, position) == 24, "offset of Feedback.position");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, velocity) == 96, "offset of Feedback.velocity");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, following_error) == 168, "offset of Feedback.following_error");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, torque_ratio) == 240, "offset of Feedback.torque_ratio");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, phase_error_ns) == 312, "offset of Feedback.phase_error_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, status_word) == 320, "offset of Feedback.status_word");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, axes_mask) == 356, "offset of Feedback.axes_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, home_switch_mask) == 360, "offset of Feedback.home_switch_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, positive_limit_mask) == 364, "offset of Feedback.positive_limit_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, negative_limit_mask) == 368, "offset of Feedback.negative_limit_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, bridge_state) == 372, "offset of Feedback.bridge_state");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, note) == 376, "offset of Feedback.note");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, error_code) == 380, "offset of Feedback.error_code");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, fault_reset_done) == 384, "offset of Feedback.fault_reset_done");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, missed_setpoints) == 388, "offset of Feedback.missed_setpoints");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, datum) == 392, "offset of Feedback.datum");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, instance) == 400, "offset of Feedback.instance");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, absolute_mask) == 408, "offset of Feedback.absolute_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, index_request) == 412, "offset of Feedback.index_request");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_feedback_t, index_position) == 416, "offset of Feedback.index_position");

/* A measured cutting load, from a drive or a sensor.
 */
#define EVOLVENT_LOAD_TYPE_NAME "evolvent.Load.v1"
typedef struct evolvent_load {
    /* Version of the bus contract that the sender was built for; receivers reject another version. */
    uint32_t interface_version;
    /* Size of this payload in bytes. */
    uint32_t struct_size;
    /* Grows by one with every value of the same sensor. */
    uint64_t sequence;
    /* When the load was sampled, in ns of CLOCK_MONOTONIC. */
    uint64_t time_ns;
    /* Kind of `value`, a number of the list of load kinds. */
    uint32_t kind;
    /* Where it was measured: 0 to 8 an axis, 9 the spindle, 16 and above user-defined sensors. */
    uint32_t source;
    /* The load in the unit of its kind. */
    double value;
    /* The lowest value that the sensor can report. */
    double range_min;
    /* The highest value that the sensor can report. */
    double range_max;
    /* Zero; for later versions. */
    uint64_t reserved[4];
} evolvent_load_t;

EVOLVENT_STATIC_ASSERT(sizeof(evolvent_load_t) == 88, "size of Load");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, interface_version) == 0, "offset of Load.interface_version");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, struct_size) == 4, "offset of Load.struct_size");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, sequence) == 8, "offset of Load.sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, time_ns) == 16, "offset of Load.time_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, kind) == 24, "offset of Load.kind");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, source) == 28, "offset of Load.source");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, value) == 32, "offset of Load.value");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, range_min) == 40, "offset of Load.range_min");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, range_max) == 48, "offset of Load.range_max");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_load_t, reserved) == 56, "offset of Load.reserved");

/* The commanded state of all peripherals, from one setpoint on.
 *
 * Complete in itself: a bridge that has lost a message is correct again with the next. Sent at every
 * change and every 50 ms.
 */
#define EVOLVENT_MACHINEOUTPUTS_TYPE_NAME "evolvent.MachineOutputs.v1"
typedef struct evolvent_machineoutputs {
    /* Version of the bus contract that the sender was built for; receivers reject another version. */
    uint32_t interface_version;
    /* Size of this payload in bytes. */
    uint32_t struct_size;
    /* Grows by one per message. */
    uint64_t sequence;
    /* The setpoint with which these values take effect. */
    uint64_t cycle;
    /* Due time of that setpoint, as its `due_time_ns`. */
    uint64_t due_time_ns;
    /* Bit i set: the machine has digital output i. */
    uint64_t digital_mask;
    /* Bit i: state of digital output i. */
    uint64_t digital;
    /* Bit i: state of digital output i that a bridge sets itself when it has lost its core. */
    uint64_t safe_digital;
    /* Values of the analog outputs. */
    double analog[16];
    /* The same for the analog outputs. */
    double safe_analog[16];
    /* Bit i set: the machine has analog output i. */
    uint32_t analog_mask;
    /* Bit i set: the machine has spindle i. */
    uint32_t spindle_mask;
    /* Command of each spindle, a number of the list of spindle directions. */
    uint32_t spindle_direction[4];
    /* Commanded speed of each spindle, rpm, not negative. */
    double spindle_rpm[4];
    /* Bit 0 mist, bit 1 flood. */
    uint32_t coolant;
    /* As `tool_change` of Status. */
    uint32_t tool_change;
    /* As `tool_wanted` of Status. */
    uint32_t tool_wanted;
    /* Tool in the spindle; 0 for none. */
    uint32_t tool;
    /* Orientation angle of a spindle with direction ORIENT, degrees from its index pulse, 0 up to, not including, 360. */
    double spindle_angle[4];
    /* Direction of the orientation, a number of the list of ways. */
    uint32_t spindle_way[4];
    /* Zero; for later versions. */
    uint64_t reserved[2];
} evolvent_machineoutputs_t;

EVOLVENT_STATIC_ASSERT(sizeof(evolvent_machineoutputs_t) == 448, "size of MachineOutputs");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, interface_version) == 0, "offset of MachineOutputs.interface_version");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, struct_size) == 4, "offset of MachineOutputs.struct_size");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, sequence) == 8, "offset of MachineOutputs.sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, cycle) == 16, "offset of MachineOutputs.cycle");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, due_time_ns) == 24, "offset of MachineOutputs.due_time_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, digital_mask) == 32, "offset of MachineOutputs.digital_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, digital) == 40, "offset of MachineOutputs.digital");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, safe_digital) == 48, "offset of MachineOutputs.safe_digital");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, analog) == 56, "offset of MachineOutputs.analog");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, safe_analog) == 184, "offset of MachineOutputs.safe_analog");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, analog_mask) == 312, "offset of MachineOutputs.analog_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, spindle_mask) == 316, "offset of MachineOutputs.spindle_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, spindle_direction) == 320, "offset of MachineOutputs.spindle_direction");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, spindle_rpm) == 336, "offset of MachineOutputs.spindle_rpm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, coolant) == 368, "offset of MachineOutputs.coolant");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, tool_change) == 372, "offset of MachineOutputs.tool_change");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, tool_wanted) == 376, "offset of MachineOutputs.tool_wanted");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, tool) == 380, "offset of MachineOutputs.tool");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, spindle_angle) == 384, "offset of MachineOutputs.spindle_angle");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, spindle_way) == 416, "offset of MachineOutputs.spindle_way");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineoutputs_t, reserved) == 432, "offset of MachineOutputs.reserved");

/* The machine's inputs at one instant. Sent at every change, and at least four times per
 * `signals.input_timeout_ms` of the machine file: older ones are unknown to the core.
 */
#define EVOLVENT_MACHINEINPUTS_TYPE_NAME "evolvent.MachineInputs.v1"
typedef struct evolvent_machineinputs {
    /* Version of the bus contract that the sender was built for; receivers reject another version. */
    uint32_t interface_version;
    /* Size of this payload in bytes. */
    uint32_t struct_size;
    /* Grows by one per message of the same bridge. */
    uint64_t sequence;
    /* When the inputs were read, in ns of CLOCK_MONOTONIC. */
    uint64_t time_ns;
    /* Differs at every start of the bridge. */
    uint64_t instance;
    /* The `sequence` of the last outputs that were set; 0 for none. */
    uint64_t outputs_sequence;
    /* Bit i set: digital input i was read. */
    uint64_t digital_mask;
    /* Bit i: state of digital input i. */
    uint64_t digital;
    /* Values of the analog inputs. */
    double analog[16];
    /* Bit i set: analog input i was read. */
    uint32_t analog_mask;
    /* State of the probe, a number of the list of probe states. */
    uint32_t probe;
    /* Number of times that the probe has tripped since the start of the bridge. */
    uint64_t probe_trips;
    /* When it last tripped or opened, in ns of CLOCK_MONOTONIC; 0 if unknown. */
    uint64_t probe_time_ns;
    /* Positions that the drives latched at that time: mm, degrees for A B C. */
    double probe_position[9];
    /* Bit i set: the drive of axis i has latched its position. */
    uint32_t probe_latched_mask;
    /* Zero; aligns the following fields to 8 bytes. */
    uint32_t unused;
    /* Zero; for later versions. */
    uint64_t reserved[8];
} evolvent_machineinputs_t;

EVOLVENT_STATIC_ASSERT(sizeof(evolvent_machineinputs_t) == 352, "size of MachineInputs");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, interface_version) == 0, "offset of MachineInputs.interface_version");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, struct_size) == 4, "offset of MachineInputs.struct_size");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, sequence) == 8, "offset of MachineInputs.sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, time_ns) == 16, "offset of MachineInputs.time_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, instance) == 24, "offset of MachineInputs.instance");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, outputs_sequence) == 32, "offset of MachineInputs.outputs_sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, digital_mask) == 40, "offset of MachineInputs.digital_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, digital) == 48, "offset of MachineInputs.digital");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, analog) == 56, "offset of MachineInputs.analog");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, analog_mask) == 184, "offset of MachineInputs.analog_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, probe) == 188, "offset of MachineInputs.probe");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, probe_trips) == 192, "offset of MachineInputs.probe_trips");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, probe_time_ns) == 200, "offset of MachineInputs.probe_time_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, probe_position) == 208, "offset of MachineInputs.probe_position");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, probe_latched_mask) == 280, "offset of MachineInputs.probe_latched_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, unused) == 284, "offset of MachineInputs.unused");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_machineinputs_t, reserved) == 288, "offset of MachineInputs.reserved");

/* Feedback of the encoder and drive of one spindle at one instant.
 */
#define EVOLVENT_SPINDLEFEEDBACK_TYPE_NAME "evolvent.SpindleFeedback.v1"
typedef struct evolvent_spindlefeedback {
    /* Version of the bus contract that the sender was built for; receivers reject another version. */
    uint32_t interface_version;
    /* Size of this payload in bytes. */
    uint32_t struct_size;
    /* Grows by one per message of the same spindle and bridge. */
    uint64_t sequence;
    /* When the angle was sampled, in ns of CLOCK_MONOTONIC. */
    uint64_t time_ns;
    /* Differs at every start of the bridge. */
    uint64_t instance;
    /* Whole turns since the start of the bridge, decreasing counter-clockwise. */
    int64_t turns;
    /* The remaining angle as a fraction of a turn: 0 up to, not including, 1; from the index pulse. */
    double fraction;
    /* Measured speed, rpm, negative counter-clockwise. */
    double speed_rpm;
    /* The spindle, from 0. */
    uint32_t spindle;
    /* Bits of the list of spindle flags. */
    uint32_t flags;
    /* The `sequence` of the outputs that the spindle executes, 0 for none: the flags refer to these. */
    uint64_t outputs_sequence;
    /* Zero; for later versions. */
    uint64_t reserved[5];
} evolvent_spindlefeedback_t;

EVOLVENT_STATIC_ASSERT(sizeof(evolvent_spindlefeedback_t) == 112, "size of SpindleFeedback");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, interface_version) == 0, "offset of SpindleFeedback.interface_version");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, struct_size) == 4, "offset of SpindleFeedback.struct_size");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, sequence) == 8, "offset of SpindleFeedback.sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, time_ns) == 16, "offset of SpindleFeedback.time_ns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, instance) == 24, "offset of SpindleFeedback.instance");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, turns) == 32, "offset of SpindleFeedback.turns");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, fraction) == 40, "offset of SpindleFeedback.fraction");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, speed_rpm) == 48, "offset of SpindleFeedback.speed_rpm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, spindle) == 56, "offset of SpindleFeedback.spindle");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, flags) == 60, "offset of SpindleFeedback.flags");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, outputs_sequence) == 64, "offset of SpindleFeedback.outputs_sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_spindlefeedback_t, reserved) == 72, "offset of SpindleFeedback.reserved");

/* A command to the core. A client chooses its number once, at random, and counts its commands from 1: a
 * command that is not newer than the client's last one has no effect.
 */
#define EVOLVENT_CONTROLREQUEST_TYPE_NAME "evolvent.ControlRequest.v1"
typedef struct evolvent_controlrequest {
    /* Version of the bus contract that the sender was built for; receivers reject another version. */
    uint32_t interface_version;
    /* Size of this payload in bytes. */
    uint32_t struct_size;
    /* The client's number, not 0. */
    uint64_t client;
    /* Number of the command, growing from 1 for each client. */
    uint64_t serial;
    /* The command, a number of the list of commands. */
    uint32_t command;
    /* Bit i set: the command is about axis i. */
    uint32_t axes_mask;
    /* A whole number: line to start from, work coordinate system, tool, mode, or 0 and 1 for off and on. */
    uint32_t index;
    /* Bytes of `text` in use. */
    uint32_t text_length;
    /* A ratio (overrides), a speed in mm/s or degrees/s (jog), or a diameter in mm (tool). */
    double amount;
    /* A number for each axis: mm, degrees for A B C. */
    double values[9];
    /* A file name or a block of MDI, UTF-8. */
    uint8_t text[1024];
    /* Zero; for later versions. */
    uint64_t reserved[8];
} evolvent_controlrequest_t;

EVOLVENT_STATIC_ASSERT(sizeof(evolvent_controlrequest_t) == 1208, "size of ControlRequest");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, interface_version) == 0, "offset of ControlRequest.interface_version");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, struct_size) == 4, "offset of ControlRequest.struct_size");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, client) == 8, "offset of ControlRequest.client");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, serial) == 16, "offset of ControlRequest.serial");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, command) == 24, "offset of ControlRequest.command");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, axes_mask) == 28, "offset of ControlRequest.axes_mask");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, index) == 32, "offset of ControlRequest.index");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, text_length) == 36, "offset of ControlRequest.text_length");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, amount) == 40, "offset of ControlRequest.amount");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, values) == 48, "offset of ControlRequest.values");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, text) == 120, "offset of ControlRequest.text");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlrequest_t, reserved) == 1144, "offset of ControlRequest.reserved");

/* The core's answer to one command.
 */
#define EVOLVENT_CONTROLANSWER_TYPE_NAME "evolvent.ControlAnswer.v1"
typedef struct evolvent_controlanswer {
    /* Version of the bus contract that the sender was built for; receivers reject another version. */
    uint32_t interface_version;
    /* Size of this payload in bytes. */
    uint32_t struct_size;
    /* The client's number, as received. */
    uint64_t client;
    /* The command's number, as received. */
    uint64_t serial;
    /* 0 accepted, 1 rejected, 2 not newer than an earlier command and without effect. */
    uint32_t verdict;
    /* Why it was rejected, a number of the list of alarms; 0 if it was accepted. */
    uint32_t alarm;
    /* The last setpoint computed when the command was evaluated. */
    uint64_t sequence;
    /* Number of the job that the command has started; 0 if none. */
    uint64_t job;
    /* Bytes of `text` in use. */
    uint32_t text_length;
    /* The command that `verdict` refers to, as received. */
    uint32_t command;
    /* The error and its remedy, UTF-8. */
    uint8_t text[512];
    /* Zero; for later versions. */
    uint64_t reserved[8];
} evolvent_controlanswer_t;

EVOLVENT_STATIC_ASSERT(sizeof(evolvent_controlanswer_t) == 632, "size of ControlAnswer");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, interface_version) == 0, "offset of ControlAnswer.interface_version");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, struct_size) == 4, "offset of ControlAnswer.struct_size");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, client) == 8, "offset of ControlAnswer.client");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, serial) == 16, "offset of ControlAnswer.serial");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, verdict) == 24, "offset of ControlAnswer.verdict");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, alarm) == 28, "offset of ControlAnswer.alarm");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, sequence) == 32, "offset of ControlAnswer.sequence");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, job) == 40, "offset of ControlAnswer.job");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, text_length) == 48, "offset of ControlAnswer.text_length");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, command) == 52, "offset of ControlAnswer.command");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, text) == 56, "offset of ControlAnswer.text");
EVOLVENT_STATIC_ASSERT(offsetof(evolvent_controlanswer_t, reserved) == 568, "offset of ControlAnswer.reserved");

#ifdef __cplusplus
}
#endif

#endif
