import type { SignalValues } from '../generated/SignalValues';
import type { EventEntry, Lease, Machine, Macro, ProgramInfo, Status, Tool, WorkOffset } from '../lib/model';

/** One value per axis, in the order of the machine file. */
export interface Sample {
  /** s, of the machine's clock */
  time: number;
  line: number;
  /** no cut */
  rapid: boolean;
  feed: number;
  position: ArrayLike<number>;
  velocity: ArrayLike<number>;
  acceleration: ArrayLike<number>;
  error: ArrayLike<number> | null;
  load: number | null;
  /** what the drives measured */
  actualVelocity?: ArrayLike<number> | null;
  actualPosition?: ArrayLike<number> | null;
  /** torque or force as a ratio of the drive's rated value */
  torque?: ArrayLike<number> | null;
  /** time of the drives' clock minus time of the setpoint, µs */
  phaseError?: number | null;
  /** of each spindle: commanded and measured speed, rpm, and angle, degrees */
  spindles?: ArrayLike<number> | null;
  /** inputs, then outputs of the machine */
  signals?: ArrayLike<number> | null;
}

/**
 * Why there is no connection: `closed` or no reply, `silent` no reply for long, `renewed` the server knows the address no more, `run` and
 * `service`: what it showed has ended, `refused` by the server.
 */
export type LinkLoss = 'closed' | 'silent' | 'renewed' | 'run' | 'service' | 'refused';

/** What a source hands to the session. */
export type Incoming =
  | { kind: 'connection'; state: 'connecting' | 'open' | 'lost' | 'refused'; loss: LinkLoss | null }
  | { kind: 'core'; alive: boolean }
  | { kind: 'machine'; machine: Machine }
  | { kind: 'status'; status: Status }
  | { kind: 'lease'; lease: Lease }
  | { kind: 'program'; program: ProgramInfo | null }
  | { kind: 'offsets'; offsets: WorkOffset[] }
  | { kind: 'tools'; tools: Tool[] }
  | { kind: 'macros'; macros: Macro[]; problem: string | null }
  | { kind: 'log'; entries: Omit<EventEntry, 'id'>[] }
  | { kind: 'signals'; signals: SignalValues }
  | { kind: 'samples'; samples: Sample[] };
