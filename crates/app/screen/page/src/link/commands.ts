// Commands as the bus numbers them; docs/contract.md, "Operating".
import { COMMANDS } from '../generated/Commands';
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
      return { command: COMMANDS.mode, index: MODES.indexOf(command.mode) };
    case 'start':
      return { command: COMMANDS.start, index: command.line, text: command.program };
    case 'step':
      return { command: COMMANDS.step, text: command.program };
    case 'single_step':
    case 'optional_stop':
    case 'block_delete':
      return { command: COMMANDS[command.name], index: command.on ? 1 : 0 };
    case 'feed_override':
    case 'rapid_override':
    case 'spindle_override':
      return { command: COMMANDS[command.name], amount: command.ratio };
    case 'mdi':
      return { command: COMMANDS.mdi, text: command.block };
    case 'jog':
      return { command: COMMANDS.jog, index: 0, amount: command.speed, steers: command.steers ?? false, ...valued(machine, command.values) };
    case 'jog_distance':
      return { command: COMMANDS.jog, index: 1, amount: command.speed, ...valued(machine, command.values) };
    case 'return':
      return { command: COMMANDS.return, amount: command.speed };
    case 'retrace':
      return { command: COMMANDS.retrace, index: command.blocks };
    case 'output':
      return { command: COMMANDS.set_output, text: command.output, amount: command.value };
    case 'handwheel':
      return { command: COMMANDS.handwheel, amount: command.step, ...valued(machine, command.axis === null ? [] : [{ axis: command.axis, value: 0 }]) };
    case 'home':
      return { command: COMMANDS.home, ...valued(machine, command.axes.map((axis) => ({ axis, value: 0 }))) };
    case 'work_offset':
      return { command: COMMANDS.work_offset, index: command.system, ...valued(machine, command.values) };
    case 'touch_off':
      return { command: COMMANDS.touch_off, index: command.system, ...valued(machine, command.values) };
    case 'tool':
      return { command: COMMANDS.tool, index: command.tool, amount: command.diameter ?? -1, ...valued(machine, command.values) };
    default:
      return { command: COMMANDS[command.name] };
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
