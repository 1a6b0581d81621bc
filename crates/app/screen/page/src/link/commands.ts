// Commands as the bus numbers them; docs/contract.md, "Operating".
import { WORK_SYSTEMS, type AxisValue, type Command, type Machine } from '../lib/model';

/** Arguments of a ControlRequest; axes in the order X Y Z A B C U V W. */
export interface Request {
  command: number;
  axes_mask?: number;
  index?: number;
  amount?: number;
  values?: Record<number, number>;
  text?: string;
  /** a jog that only changes the one in motion */
  steers?: boolean;
}

export const AXES = 'XYZABCUVW';
const MODES = ['auto', 'manual', 'mdi'];

const plain = {
  estop: 1, estop_reset: 2, on: 3, off: 4, hold: 8, resume: 9, step: 10, stop: 11, reset: 12, clear_alarms: 27, jog_keep: 21, jog_stop: 22,
} as const;
const switches = { single_step: 13, optional_stop: 14, block_delete: 15 } as const;
const overrides = { feed_override: 16, rapid_override: 17, spindle_override: 18 } as const;

function valued(machine: Machine, list: AxisValue[]): Pick<Request, 'axes_mask' | 'values'> {
  const values: Record<number, number> = {};
  let mask = 0;
  for (const { axis, value } of list) {
    const bit = AXES.indexOf(machine.axes[axis]?.letter ?? '?');
    if (bit < 0) continue;
    mask |= 1 << bit;
    values[bit] = value;
  }
  return { axes_mask: mask, values };
}

export function encode(machine: Machine, command: Command): Request {
  switch (command.name) {
    case 'mode':
      return { command: 5, index: MODES.indexOf(command.mode) };
    case 'start':
      return { command: 7, index: command.line, text: command.program };
    case 'step':
      return { command: 10, text: command.program };
    case 'single_step':
    case 'optional_stop':
    case 'block_delete':
      return { command: switches[command.name], index: command.on ? 1 : 0 };
    case 'feed_override':
    case 'rapid_override':
    case 'spindle_override':
      return { command: overrides[command.name], amount: command.ratio };
    case 'mdi':
      return { command: 19, text: command.block };
    case 'jog':
      return { command: 20, index: 0, amount: command.speed, steers: command.steers ?? false, ...valued(machine, command.values) };
    case 'jog_distance':
      return { command: 20, index: 1, amount: command.speed, ...valued(machine, command.values) };
    case 'return':
      return { command: 30, amount: command.speed };
    case 'retrace':
      return { command: 31, index: command.blocks };
    case 'output':
      return { command: 28, text: command.output, amount: command.value };
    case 'handwheel':
      return { command: 29, amount: command.step, ...valued(machine, command.axis === null ? [] : [{ axis: command.axis, value: 0 }]) };
    case 'home':
      return { command: 23, ...valued(machine, command.axes.map((axis) => ({ axis, value: 0 }))) };
    case 'work_offset':
      return { command: 24, index: command.system, ...valued(machine, command.values) };
    case 'touch_off':
      return { command: 25, index: command.system, ...valued(machine, command.values) };
    case 'tool':
      return { command: 26, index: command.tool, amount: command.diameter ?? -1, ...valued(machine, command.values) };
    default:
      return { command: plain[command.name] };
  }
}

/** G54 as 540 on the bus. */
export function systemName(number: number): string {
  const name = number % 10 === 0 ? `G${number / 10}` : `G${(number / 10).toFixed(1)}`;
  return WORK_SYSTEMS.find((known) => known === name) ?? name;
}

export function codeName(number: number): string {
  return number % 10 === 0 ? `G${number / 10}` : `G${(number / 10).toFixed(1)}`;
}
