// What the scope shows, and its trigger. Both outlive the view, which is built again at each change of the tab.
import { parseNumber } from '../lib/format';
import { session, type History } from '../lib/session.svelte';
import { firstAt, type Span } from './envelope';

export type Quantity = 'position' | 'velocity' | 'acceleration' | 'error' | 'feed' | 'load' | 'lateness';
export const PER_AXIS: readonly Quantity[] = ['position', 'velocity', 'acceleration', 'error'];
export const QUANTITIES: readonly Quantity[] = [...PER_AXIS, 'feed', 'load', 'lateness'];

/** How often the trigger looks, ms. */
const LOOK_MS = 50;

class Scope {
  quantity = $state<Quantity>('velocity');
  chosen = $state<string[]>(['X', 'Y', 'Z']);
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

  /** the axes that are shown, of a quantity that each axis has */
  get shown(): { letter: string; index: number }[] {
    if (!PER_AXIS.includes(this.quantity)) return [];
    const axes = session.machine?.axes ?? [];
    return axes.map((axis, index) => ({ letter: axis.letter, index })).filter((axis) => this.chosen.includes(axis.letter));
  }

  get history(): History | null {
    return this.paused ?? session.history;
  }

  lists(history: History): Float32Array[] {
    const { quantity } = this;
    switch (quantity) {
      case 'feed':
      case 'load':
      case 'lateness':
        return [history[quantity]];
      default:
        return this.shown.map((axis) => history[quantity][axis.index]!);
    }
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
