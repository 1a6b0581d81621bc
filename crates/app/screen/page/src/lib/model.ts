// What the page knows of a machine, in the words that the views use. `link/` makes it from the server's messages.

import type { HandwheelInfo } from '../generated/HandwheelInfo';
import type { LogFact } from '../generated/LogFact';
import type { ProcessInfo } from '../generated/ProcessInfo';
import type { Refusal } from '../generated/Refusal';
import type { SignalInfo } from '../generated/SignalInfo';

export type AxisKind = 'linear' | 'rotary';

export interface Axis {
  letter: string;
  kind: AxisKind;
  /** mm or degrees, machine coordinates */
  min: number;
  max: number;
  /** mm/s or degrees/s */
  maxVelocity: number;
  /** A rotary axis without ends: min and max are a turn. */
  isUnlimited: boolean;
  hasHomeSwitch: boolean;
}

export interface Machine {
  name: string;
  description: string;
  kind: 'mill' | 'lathe';
  /** in the order of the machine file; every list of a status has this order */
  axes: Axis[];
  periodNs: number;
  version: string;
  /** what a cut is like, for turning cycles that find their passes */
  process: ProcessInfo | null;
  inputs: SignalInfo[];
  outputs: SignalInfo[];
  /** numbers of the spindles */
  spindles: number[];
  handwheel: HandwheelInfo | null;
  /** there are limits of chatter to be shown */
  hasChatter: boolean;
}

export type MachineState = 'estop' | 'off' | 'on';
export type Mode = 'auto' | 'manual' | 'mdi';
export type Activity = 'none' | 'program' | 'mdi' | 'jog' | 'homing';
export type RunState =
  | 'idle'
  | 'running'
  | 'holding'
  | 'held'
  | 'stopping'
  | 'stopped'
  | 'dwell'
  | 'program_stop'
  | 'fault'
  | 'done';
export type JobResult = 'none' | 'done' | 'stopped' | 'failed' | 'fault';

export interface Spindle {
  number: number;
  /** present command, rpm, on its ramp, negative counter-clockwise */
  command: number;
  /** rpm, negative counter-clockwise; null where nothing measures it */
  measured: number | null;
  /** false where the program has switched the spindle override off */
  overrideCounts: boolean;
}

/** One coherent moment of the machine. Lengths in mm, angles in degrees, times in s. */
export interface Status {
  time: number;
  machineState: MachineState;
  mode: Mode;
  activity: Activity;
  state: RunState;
  line: number;
  job: number;
  jobResult: JobResult;
  program: string;
  homed: boolean[];
  machine: number[];
  work: number[];
  toGo: number[];
  velocity: number[];
  workOffset: number[];
  toolOffset: number[];
  actual: number[] | null;
  followingError: number[] | null;
  feed: number;
  feedProgrammed: number;
  override: number;
  rapidOverride: number;
  spindleOverride: number;
  spindleRpm: number;
  /** the spindles of the machine, the lowest number first */
  spindles: Spindle[];
  coolant: number;
  tool: number;
  /** a tool change was broken off: `tool` is the one before it */
  toolUnknown: boolean;
  toolChange: 'none' | 'operator' | 'program';
  toolWanted: number;
  workSystem: string;
  modal: string[];
  alarms: number[];
  alarmText: string;
  message: string;
  singleStep: boolean;
  optionalStop: boolean;
  blockDelete: boolean;
  hold: boolean;
  chainOpen: boolean;
  inputWait: boolean;
  pathDone: number;
  pathToGo: number;
  lateCycles: number;
  latenessNs: number;
  longestStopMm: number;
  longestStopS: number;
  /** axes that were jogged away from the held program */
  away: boolean[];
  /** parts of the way back to where the program is held; 0 where the axes are there */
  awayParts: number;
  /** starts of blocks that can be reached backwards along the path of the held program */
  retraceBlocks: number;
  /** how often the program has reached its end since it was loaded */
  parts: number;
  /** of the current or last run of the program, s */
  programTimeS: number;
  /** of it in holds and program stops, s */
  programHeldS: number;
  /** the axis that the handwheel moves, none where it moves none */
  handwheelAxis: number | null;
  /** distance of that axis per detent */
  handwheelStep: number;
  /** its enabling button is pressed, or it has none */
  handwheelEnabled: boolean;
}

/** Commands of the contract, by the names and units of docs/contract.md. */
export type Command =
  | { name: 'estop' | 'estop_reset' | 'on' | 'off' | 'hold' | 'resume' | 'stop' | 'reset' | 'clear_alarms' }
  | { name: 'mode'; mode: Mode }
  | { name: 'start'; line: number; program: string }
  /** `program`: where it starts one; empty where it goes on */
  | { name: 'step'; program: string }
  | { name: 'single_step' | 'optional_stop' | 'block_delete'; on: boolean }
  | { name: 'feed_override' | 'rapid_override' | 'spindle_override'; ratio: number }
  | { name: 'mdi'; block: string }
  | { name: 'home'; axes: number[] }
  | { name: 'work_offset'; system: number; values: AxisValue[] }
  | { name: 'touch_off'; system: number; values: AxisValue[] }
  | { name: 'tool'; tool: number; values: AxisValue[]; diameter: number | null }
  | { name: 'jog_distance'; values: AxisValue[]; speed: number }
  /** `steers`: only changes the jog that is in motion */
  | { name: 'jog'; values: AxisValue[]; speed: number; steers?: boolean }
  | { name: 'output'; output: string; value: number }
  | { name: 'handwheel'; axis: number | null; step: number }
  | { name: 'jog_keep' }
  | { name: 'jog_stop' }
  | { name: 'return'; speed: number }
  | { name: 'retrace'; blocks: number };

/** `axis` counts in the order of the machine file. */
export interface AxisValue {
  axis: number;
  value: number;
}

export interface Answer {
  /** there was no answer: whether the core has carried it out is not known */
  isUnknown?: boolean;
  accepted: boolean;
  alarm: number;
  text: string;
  /** why the server itself refused it, where it has a name for that */
  refusal?: Refusal | null;
}

export interface Lease {
  /** this page may command */
  mine: boolean;
  /** number of the page that may, if any does */
  holder: number | null;
  /** this page may only watch, whatever it asks for */
  readOnly: boolean;
}

export interface EventEntry {
  id: number;
  /** ms since 1970 */
  at: number;
  kind: 'alarm' | 'warning' | 'state' | 'command' | 'message' | 'link';
  number: number | null;
  text: string;
  /** what the text says, where the server said it by code and fields */
  fact?: LogFact | null;
  cure: string | null;
}

export interface Finding {
  line: number;
  column: number;
  length: number;
  code: string;
  message: string;
  help: string;
  file: string | null;
}

export interface ProgramInfo {
  name: string;
  /** another number is another text, even of the same name */
  upload: number;
  /** as START names it and the status tells it, which truncates a long one */
  file: string;
  /** why its text cannot be shown */
  problem: string | null;
  bytes: number;
  lines: number;
  errors: Finding[];
  warnings: Finding[];
  checked: boolean;
  plannedS: number | null;
}

/** G54 to G59.3, counted from 1; `values` in machine coordinates, null where this page has not been told. */
export interface WorkOffset {
  system: number;
  values: (number | null)[];
  /** of X and Y about Z (G10 L2 R), degrees */
  rotation: number;
}

export interface Tool {
  number: number;
  /** an offset per axis */
  offsets: number[];
  diameter: number;
  /** of the tip of a turning tool, 1 to 9; 0 for a mill */
  orientation: number;
  /** front and back angle of a turning tool, degrees */
  angles: [number, number];
  comment: string;
}

/** A button with blocks of MDI. */
export interface Macro {
  name: string;
  note: string;
  blocks: string[];
  /** the operator is asked first */
  confirm: boolean;
}

export const WORK_SYSTEMS = ['G54', 'G55', 'G56', 'G57', 'G58', 'G59', 'G59.1', 'G59.2', 'G59.3'] as const;
