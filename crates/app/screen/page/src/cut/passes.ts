// Passes of a turning tool, found in what has been recorded: stretches in which it goes along the cut.
import type { History } from '../lib/session.svelte';

export interface Pass {
  /** s, of the machine's clock */
  begin: number;
  end: number;
  /** along the cut, from and to, and across it in the middle: mm, in the work coordinates of the time, X as a radius */
  from: number;
  to: number;
  across: number;
  /** the highest load; NaN where nobody measures it */
  load: number;
}

/** Shorter stretches are none, mm. */
const MIN_MM = 1;
/** A tool that goes slower than this along the cut stands, mm/s. */
const MIN_SPEED = 0.02;
/** Below this part of the load that is held the tool cuts air. */
const AIR = 0.05;
/** Passes that are kept. */
const MAX_PASSES = 40;

/** Follows the history sample by sample. */
export class PassFinder {
  readonly passes: Pass[] = [];
  /** samples of the history that were looked at */
  #next = 0;
  readonly #air: number;
  #open: (Pass & { sum: number; count: number }) | null = null;

  /** `setLoad` is what is held, where somebody measures a load. */
  constructor(setLoad: number | undefined) {
    this.#air = AIR * (setLoad ?? 0);
  }

  /** Goes on to the newest sample. `along` and `across` are axes in the machine's order; the tool cuts towards lower values of `along`. */
  follow(history: History, along: number, across: number): void {
    let i = Math.max(this.#next, history.count - history.capacity);
    for (; i < history.count; i += 1) {
      const at = i % history.capacity;
      const cuts = history.rapid[at] === 0 && history.velocity[along]![at]! < -MIN_SPEED && Math.abs(history.velocity[across]![at]!) < -history.velocity[along]![at]!;
      const place = history.position[along]![at]! - history.zero[along]![at]!;
      if (!cuts) {
        this.#close();
        continue;
      }
      this.#open ??= { begin: history.time[at]!, end: 0, from: place, to: place, across: 0, load: NaN, sum: 0, count: 0 };
      const pass = this.#open;
      const load = history.load[at]!;
      [pass.end, pass.to] = [history.time[at]!, place];
      pass.sum += history.position[across]![at]! - history.zero[across]![at]!;
      pass.count += 1;
      if (!Number.isNaN(load)) pass.load = Number.isNaN(pass.load) ? load : Math.max(pass.load, load);
    }
    this.#next = history.count;
  }

  #close(): void {
    const pass = this.#open;
    this.#open = null;
    if (pass === null || pass.from - pass.to < MIN_MM || pass.load < this.#air) return;
    this.passes.push({ begin: pass.begin, end: pass.end, from: pass.from, to: pass.to, across: pass.sum / pass.count, load: pass.load });
    if (this.passes.length > MAX_PASSES) this.passes.shift();
  }
}
