// A machine that exists in the page only, to work on views without a core: `npm run dev`, then `/?made-up`.
import type { Refusal } from '../generated/Refusal';
import type { Answer, Command, Machine, Status } from '../lib/model';
import { programText } from '../lib/program-text.svelte';
import { CHUNK_VERTICES } from '../path/chunk';
import { path } from '../path/store.svelte';
import type { Incoming } from './incoming';
import type { Source } from './source';

const machine: Machine = {
  name: 'mill-3axis',
  description: 'Three-axis mill, made up',
  kind: 'mill',
  axes: [
    { letter: 'X', kind: 'linear', min: -400, max: 400, maxVelocity: 500, isUnlimited: false, hasHomeSwitch: true },
    { letter: 'Y', kind: 'linear', min: -250, max: 250, maxVelocity: 500, isUnlimited: false, hasHomeSwitch: true },
    { letter: 'Z', kind: 'linear', min: -400, max: 100, maxVelocity: 333, isUnlimited: false, hasHomeSwitch: true },
  ],
  periodNs: 1_000_000,
  version: '0.1.0',
  process: null,
  inputs: [
    { name: 'door-closed', kind: 'digital', number: 0, range: [0, 1] },
    { name: 'air-pressure-bar', kind: 'analog', number: 2, range: [0, 16] },
    { name: 'wheel', kind: 'analog', number: 3, range: [-Number.MAX_VALUE, Number.MAX_VALUE] },
  ],
  outputs: [
    { name: 'dust-extraction', kind: 'digital', number: 0, range: [0, 1] },
    { name: 'work-light', kind: 'digital', number: 1, range: [0, 1] },
    { name: 'laser-power', kind: 'analog', number: 0, range: [0, 10] },
  ],
  spindles: [0],
  handwheel: { steps_mm: [0.001, 0.01, 0.1], steps_deg: [0.001, 0.01, 0.1], switches_select_axis: false, switches_select_step: false },
  hasChatter: false,
};

export class MadeUp implements Source {
  #handle: (message: Incoming) => void = () => {};
  #status: Status = {
    time: 0, machineState: 'estop', mode: 'manual', activity: 'none', state: 'idle', line: 0, job: 0, jobResult: 'none',
    program: 'bore-200.ngc', homed: [false, false, false], machine: [0, 0, 0], work: [0, 0, 0], toGo: [0, 0, 0], velocity: [0, 0, 0],
    workOffset: [10, -20, 5.5], toolOffset: [0, 0, 0], actual: null, followingError: null, feed: 0, feedProgrammed: 0,
    override: 1, rapidOverride: 1, spindleOverride: 1, spindleRpm: 0, spindles: [], coolant: 0, tool: 3, toolUnknown: false, toolChange: 'none',
    toolWanted: 0,
    workSystem: 'G54', modal: ['G0', 'G17', 'G21', 'G54', 'G90', 'G94'], alarms: [], alarmText: '', message: '', singleStep: false,
    optionalStop: false, blockDelete: false, hold: false, chainOpen: false, inputWait: false, pathDone: 0, pathToGo: 0, lateCycles: 0,
    latenessNs: 12_000, longestStopMm: 0, longestStopS: 0, away: [false, false, false], awayParts: 0, retraceBlocks: 0,
    parts: 0, programTimeS: 0, programHeldS: 0, handwheelAxis: null, handwheelStep: 0, handwheelEnabled: true,
  };
  #outputs = [0, 1, 2.5];
  /** ms of ticks. Timers of a page that has no time are late together, so a jog whose page stood still goes on. */
  #time = 0;
  #jogUntil = 0;
  /** where the program is held, while the axes are away from it */
  #heldAt: number[] | null = null;
  /** ms until a command takes effect */
  #delays: Partial<Record<Command['name'], number>> = {};
  #sent: string[] = [];
  #orders: Command[] = [];
  #isQuiet = false;
  #refusal: Refusal | null = null;
  /** why every command is rejected; empty where none is */
  #rejection = '';

  start(handle: (message: Incoming) => void): void {
    this.#handle = handle;
    handle({ kind: 'connection', state: 'open', loss: null });
    handle({ kind: 'machine', machine });
    handle({ kind: 'core', alive: true });
    handle({ kind: 'lease', lease: { mine: false, holder: null, readOnly: false } });
    handle({ kind: 'program', program: { name: 'bore-200.ngc', upload: 1, file: 'bore-200.ngc', problem: null, bytes: 1234, lines: 42, errors: [], warnings: [], checked: true, plannedS: 45.2 } });
    this.#path();
    programText.load('./made-up.ngc');
    Object.assign(globalThis, {
      loadMadeUpText: (url: string) => programText.load(url),
      madeUpCommands: this.#sent,
      madeUpOrders: this.#orders,
      delayMadeUp: (name: Command['name'], ms: number) => (this.#delays[name] = ms),
      // As if another page had done it.
      changeMadeUp: (changes: Partial<Status>) => Object.assign(this.#status, changes),
      changeMadeUpMachine: (changes: Partial<Machine>) => handle({ kind: 'machine', machine: { ...machine, ...changes } }),
      tellMadeUp: (message: Incoming) => handle(message),
      rejectMadeUp: (text: string, refusal: Refusal | null = null) => ([this.#rejection, this.#refusal] = [text, refusal]),
      // As if the server or the link stood still.
      quietMadeUp: (on: boolean) => (this.#isQuiet = on),
      raiseMadeUpAlarm: (...alarms: number[]) => Object.assign(this.#status, { alarms, alarmText: 'made up' }),
    });
    setInterval(() => this.#tick(), 16);
  }

  /** Spirals in layers: half a million vertices. */
  #path(): void {
    path.clear();
    for (let layer = 0; layer < 8; layer += 1) {
      const chunk = { position: new Float32Array(3 * CHUNK_VERTICES), feed: new Float32Array(CHUNK_VERTICES), line: new Uint32Array(CHUNK_VERTICES), limit: new Uint8Array(CHUNK_VERTICES) };
      for (let i = 0; i < CHUNK_VERTICES; i += 1) {
        const [t, r] = [i * 0.01, 10 + (i / CHUNK_VERTICES) * 90];
        chunk.position.set([r * Math.cos(t), r * Math.sin(t), -5 * layer], 3 * i);
        chunk.feed[i] = i < 2 ? -1 : 20 + 80 * (r / 100);
        chunk.line[i] = i >> 4;
      }
      path.add(chunk, { min: [-100, -100, -40], max: [100, 100, 0] }, 100);
    }
    path.isBoxWhole = true;
    path.progress = 1;
  }

  #tick(): void {
    const s = this.#status;
    const now = performance.now();
    const dt = 0.016;
    this.#time += 16;
    if (s.activity === 'jog' && this.#time > this.#jogUntil) this.#end();
    if (s.activity === 'program') {
      s.programTimeS += dt;
      if (s.hold) s.programHeldS += dt;
    }
    if (s.activity === 'program' && !s.hold) {
      const t = now / 1000;
      s.machine = [50 * Math.cos(t), 50 * Math.sin(t), -5];
      s.line = 1 + (Math.floor(t) % 42);
      s.feed = 50;
      s.feedProgrammed = 50;
    }
    if (s.activity === 'program' && s.hold && this.#time > this.#jogUntil) s.velocity = [0, 0, 0];
    s.machine = s.machine.map((value, axis) => value + (s.velocity[axis] ?? 0) * dt);
    s.work = s.machine.map((value, axis) => value - (s.workOffset[axis] ?? 0));
    s.time = now / 1000;
    if (this.#isQuiet) return;
    this.#handle({ kind: 'status', status: { ...s } });
    this.#handle({ kind: 'signals', signals: { inputs: [1, 6.25, null], outputs: [...this.#outputs], spindles_rpm: [s.spindleRpm], probe: 'open' } });
    this.#handle({
      kind: 'samples',
      samples: [{ time: this.#time / 1000, line: s.line, rapid: false, feed: s.feed, position: s.machine, velocity: s.velocity, acceleration: [0, 0, 0], error: null, load: null,
        actualVelocity: s.velocity.map((value) => 0.99 * value), actualPosition: s.machine.map((value) => value - 0.01), torque: s.velocity.map((value) => value / 1000), phaseError: -2.5, spindles: [s.spindleRpm, 0.98 * s.spindleRpm, (s.time * 6 * s.spindleRpm) % 360],
        signals: [Math.floor(s.time) % 2, 6.25 + Math.sin(s.time), NaN, ...this.#outputs] }],
    });
  }

  #end(): void {
    this.#heldAt = null;
    Object.assign(this.#status, { activity: 'none', state: 'idle', velocity: [0, 0, 0], feed: 0, awayParts: 0, retraceBlocks: 0 });
  }

  async send(command: Command): Promise<Answer> {
    this.#sent.push(command.name);
    this.#orders.push(command);
    const delay = this.#delays[command.name] ?? 0;
    if (delay > 0) await new Promise((resolve) => setTimeout(resolve, delay));
    const s = this.#status;
    const reject = (alarm: number, text: string): Answer => ({ accepted: false, alarm, text });
    if (this.#rejection !== '') return { ...reject(this.#refusal ? 0 : 901, this.#rejection), refusal: this.#refusal };
    switch (command.name) {
      case 'estop': this.#end(); s.machineState = 'estop'; break;
      case 'estop_reset': s.machineState = 'off'; break;
      case 'on': s.machineState = 'on'; break;
      case 'off': s.machineState = 'off'; break;
      case 'mode': s.mode = command.mode; break;
      case 'home':
        for (const axis of command.axes.length > 0 ? command.axes : [0, 1, 2]) {
          s.homed = s.homed.map((is, at) => is || at === axis);
          if (command.axes.length > 0) s.machine[axis] = 0;
        }
        break;
      case 'jog':
        if (s.machineState !== 'on') return reject(912, 'the machine is off');
        if (s.hold) {
          if (command.values.length > 1) return reject(933, 'while a program is held only one axis is jogged at a time');
          this.#leave(command.values[0]!.axis);
        } else {
          s.activity = 'jog';
          s.state = 'running';
        }
        s.velocity = [0, 0, 0];
        for (const { axis, value } of command.values) s.velocity[axis] = value * command.speed;
        this.#jogUntil = this.#time + 90;
        break;
      case 'jog_distance':
        if (s.hold) this.#leave(command.values[0]!.axis);
        for (const { axis, value } of command.values) s.machine[axis]! += value;
        break;
      case 'jog_stop':
        if (s.activity === 'jog') this.#end();
        s.velocity = [0, 0, 0];
        break;
      case 'return':
        if (this.#heldAt !== null) s.machine = this.#heldAt;
        this.#heldAt = null;
        Object.assign(s, { awayParts: 0, away: [false, false, false], message: '', retraceBlocks: 3 });
        break;
      case 'retrace':
        this.#leave(null);
        s.machine[0]! -= 5;
        s.retraceBlocks -= command.blocks;
        break;
      case 'start':
        if (s.homed.includes(false)) return reject(916, 'axis X is not homed');
        Object.assign(s, { activity: 'program', state: 'running', programTimeS: 0, programHeldS: 0 });
        break;
      case 'clear_alarms': Object.assign(s, { alarms: [], alarmText: '' }); break;
      case 'hold': Object.assign(s, { hold: true, state: 'held', feed: 0, retraceBlocks: 3 }); break;
      case 'resume':
        if (s.awayParts > 0) return reject(932, 'the axes are away from the held program');
        Object.assign(s, { hold: false, state: 'running', toolChange: 'none' });
        break;
      case 'stop': this.#end(); s.hold = false; break;
      case 'feed_override': s.override = command.ratio; break;
      case 'rapid_override': s.rapidOverride = command.ratio; break;
      case 'spindle_override': s.spindleOverride = command.ratio; break;
      case 'output': {
        if (s.machineState === 'estop') return reject(910, 'not in emergency stop');
        const at = machine.outputs.findIndex((output) => output.name === command.output);
        const [low, high] = machine.outputs[at]?.range ?? [0, 0];
        if (command.value < low || command.value > high) return reject(901, `${command.output} takes ${low} to ${high}`);
        this.#outputs[at] = command.value;
        break;
      }
      case 'handwheel': Object.assign(s, { handwheelAxis: command.axis, handwheelStep: command.axis === null ? 0 : command.step || 0.001 }); break;
      case 'reset': Object.assign(s, { modal: ['G0', 'G17', 'G21', 'G54', 'G90', 'G94'], spindleRpm: 0, spindles: [], coolant: 0, alarms: [], alarmText: '', message: '' }); break;
      case 'mdi':
        s.job += 1;
        if (/M3 S(\d+)/.test(command.block)) s.spindleRpm = Number(/M3 S(\d+)/.exec(command.block)![1]);
        if (/G91/.test(command.block)) s.modal = s.modal.map((code) => (code === 'G90' ? 'G91' : code));
        break;
      case 'touch_off': for (const { axis, value } of command.values) s.workOffset[axis] = s.machine[axis]! - value; break;
      default: break;
    }
    return { accepted: true, alarm: 0, text: '' };
  }

  /** The axes leave the held program: by a jog of `axis`, or backwards along the path. */
  #leave(axis: number | null): void {
    const s = this.#status;
    this.#heldAt ??= [...s.machine];
    if (axis !== null) s.away = s.away.map((is, at) => is || at === axis);
    Object.assign(s, { awayParts: 1, message: 'away from the program; the way back: made up' });
  }

  keep(): void {
    this.#jogUntil = this.#time + 90;
  }

  takeLease(): void {
    this.#handle({ kind: 'lease', lease: { mine: true, holder: 1, readOnly: false } });
  }

  releaseLease(): void {
    this.#handle({ kind: 'lease', lease: { mine: false, holder: null, readOnly: false } });
  }

  async upload(): Promise<Answer> {
    return { accepted: true, alarm: 0, text: '' };
  }
}
