// What the scope shows, and its trigger. Both outlive the view, which is built again at each change of the tab.
import { parseNumber } from '../lib/format';
import { session, type History } from '../lib/session.svelte';
import { firstAt, type Span } from './envelope';

const PER_AXIS = ['position', 'actualPosition', 'velocity', 'actualVelocity', 'acceleration', 'jerk', 'error', 'torque'] as const;
const SINGLE = ['feed', 'load', 'phaseError', 'lateness'] as const;
const OF_SIGNALS = ['spindleSpeed', 'spindleAngle', 'digital', 'analog'] as const;
type PerAxis = (typeof PER_AXIS)[number];
type Single = (typeof SINGLE)[number];
export type Quantity = PerAxis | Single | (typeof OF_SIGNALS)[number];

const isPerAxis = (quantity: Quantity): quantity is PerAxis => (PER_AXIS as readonly string[]).includes(quantity);
const isSingle = (quantity: Quantity): quantity is Single => (SINGLE as readonly string[]).includes(quantity);

/** One of the lines that a quantity can have. */
export interface Line {
  /** a letter, or the name of a signal; empty where the quantity has one line only */
  name: string;
  /** among the lists of the history */
  index: number;
  kind: 'single' | 'axis' | 'commanded' | 'measured' | 'angle' | 'input' | 'output';
}

/** Signals that are shown without a choice, at most. */
const MAX_SIGNALS = 8;

/** How often the trigger looks, ms. */
const LOOK_MS = 50;

class Scope {
  quantity = $state<Quantity>('velocity');
  chosen = $state<string[]>(['X', 'Y', 'Z']);
  /** signals, by kind and name; null before a choice */
  chosenSignals = $state<string[] | null>(null);
  seconds = $state(10);
  /** What a picture that stands shows: a copy, because the ring goes on and would run out of it. */
  paused = $state.raw<History | null>(null);
  edge = $state<'off' | 'rising' | 'falling'>('off');
  levelText = $state('0');
  /** the sample at which the trigger's condition came true */
  #triggered = -1;
  /** samples that the trigger has looked at */
  #watched = 0;
  #timer = 0;

  /** the quantities that this machine has */
  get quantities(): Quantity[] {
    const machine = session.machine;
    const kinds = [...(machine?.inputs ?? []), ...(machine?.outputs ?? [])].map((signal) => signal.kind);
    const has = { spindleSpeed: (machine?.spindles.length ?? 0) > 0, spindleAngle: (machine?.spindles.length ?? 0) > 0, digital: kinds.includes('digital'), analog: kinds.includes('analog') };
    return [...PER_AXIS, ...SINGLE, ...OF_SIGNALS.filter((quantity) => has[quantity])];
  }

  /** the lines that the quantity can have */
  get lines(): Line[] {
    const { quantity } = this;
    const machine = session.machine;
    if (isSingle(quantity) || machine === null) return [{ name: '', index: 0, kind: 'single' }];
    if (isPerAxis(quantity)) return machine.axes.map((axis, index) => ({ name: axis.letter, index, kind: 'axis' }));
    const spindle = (number: number): string => (machine.spindles.length > 1 ? `S${number}` : 'S');
    if (quantity === 'spindleSpeed') {
      return machine.spindles.flatMap((number, i) => [
        { name: spindle(number), index: 3 * i, kind: 'commanded' } as const,
        { name: spindle(number), index: 3 * i + 1, kind: 'measured' } as const,
      ]);
    }
    if (quantity === 'spindleAngle') return machine.spindles.map((number, i) => ({ name: spindle(number), index: 3 * i + 2, kind: 'angle' }));
    const of = (signals: typeof machine.inputs, first: number, kind: 'input' | 'output'): Line[] =>
      signals.map((signal, i) => ({ signal, line: { name: signal.name, index: first + i, kind } })).filter(({ signal }) => signal.kind === quantity).map(({ line }) => line);
    return [...of(machine.inputs, 0, 'input'), ...of(machine.outputs, machine.inputs.length, 'output')];
  }

  /** whether lines can be chosen */
  get hasChoice(): boolean {
    return isPerAxis(this.quantity) || this.quantity === 'digital' || this.quantity === 'analog';
  }

  /** how a signal is named among those chosen: an input may have the name of an output */
  key(line: Line): string {
    return line.kind === 'axis' ? line.name : `${line.kind} ${line.name}`;
  }

  isChosen(line: Line): boolean {
    if (line.kind === 'axis') return this.chosen.includes(line.name);
    if (line.kind !== 'input' && line.kind !== 'output') return true;
    return this.chosenSignals?.includes(this.key(line)) ?? this.lines.slice(0, MAX_SIGNALS).some((other) => this.key(other) === this.key(line));
  }

  choose(line: Line, on: boolean): void {
    const key = this.key(line);
    const but = (list: string[]): string[] => list.filter((other) => other !== key);
    if (line.kind === 'axis') {
      this.chosen = on ? [...but(this.chosen), key] : but(this.chosen);
      return;
    }
    const now = this.chosenSignals ?? this.lines.filter((other) => this.isChosen(other)).map((other) => this.key(other));
    this.chosenSignals = on ? [...but(now), key] : but(now);
  }

  /** the lines that are shown */
  get shown(): Line[] {
    return this.lines.filter((line) => this.isChosen(line));
  }

  get history(): History | null {
    return this.paused ?? session.history;
  }

  lists(history: History): Float32Array[] {
    const { quantity } = this;
    if (isSingle(quantity)) return [history[quantity]];
    const lists = isPerAxis(quantity) ? history[quantity] : quantity === 'digital' || quantity === 'analog' ? history.signals : history.spindles;
    // A picture that stands is as it was, also of a machine whose file was changed since.
    return this.shown.map((line) => lists[line.index] ?? new Float32Array(history.capacity).fill(NaN));
  }

  /** The samples that are shown. */
  span(history: History): Span {
    const end = history.count;
    const all = { begin: Math.max(0, end - history.capacity), end };
    if (end === 0) return all;
    return { begin: firstAt(history.time, all, history.time[(end - 1) % history.capacity]! - this.seconds), end };
  }

  /** The picture stands, with all quantities up to the sample before `end`. */
  pause(end = session.history?.count ?? 0): void {
    const history = session.history;
    this.#triggered = -1;
    if (history !== null) this.paused = history.copy(Math.min(end, history.capacity), end);
  }

  goOn(): void {
    this.paused = null;
  }

  /** The trigger waits from now on, for `edge`. */
  arm(): void {
    [this.#triggered, this.#watched, this.paused] = [-1, session.history?.count ?? 0, null];
    if (this.#timer === 0) this.#timer = window.setInterval(() => this.#watch(), LOOK_MS);
  }

  // The first of the shown quantities crosses the level: half of the window is still recorded, then the picture stands.
  #watch(): void {
    const history = session.history;
    const level = parseNumber(this.levelText);
    if (history === null || level === undefined || this.paused !== null || this.edge === 'off') return;
    const values = this.lists(history)[0];
    if (values === undefined) return;
    for (let i = Math.max(this.#watched, 1, history.count - history.capacity + 1); i < history.count && this.#triggered < 0; i += 1) {
      const [before, now] = [values[(i - 1) % history.capacity]!, values[i % history.capacity]!];
      if (this.edge === 'rising' ? before < level && now >= level : before > level && now <= level) this.#triggered = i;
    }
    this.#watched = history.count;
    if (this.#triggered < 0) return;
    const at = history.time[this.#triggered % history.capacity]!;
    if (history.time[(history.count - 1) % history.capacity]! - at < this.seconds / 2) return;
    // However late this is noticed, the crossing is in the middle.
    const all = { begin: Math.max(0, history.count - history.capacity), end: history.count };
    this.pause(firstAt(history.time, all, at + this.seconds / 2) + 1);
    this.edge = 'off';
  }
}

export const scope = new Scope();
