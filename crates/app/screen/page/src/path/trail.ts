// The trail of the tool on a canvas of its own: what is new is drawn to the rest of it.
import type { History } from '../lib/session.svelte';
import type { View } from './view';

/** points of the trail at most */
const MAX_POINTS = 4000;
/** A tool that has moved by less is where it was, px. */
const STILL_PX = 0.5;
/** Time after which the trail is drawn again without what is too old, ms. */
const AGE_MS = 2000;

export class Trail {
  /** from the `from`-th sample on */
  from = 0;
  readonly #view: View;
  #canvas: HTMLCanvasElement | null = null;
  #step = 1;
  /** the next sample that is not drawn, and where the trail ends, px */
  #next = 0;
  #end: [number, number] | null = null;
  /** samples were lost since that end */
  #isBroken = false;
  #wholeAt = -Infinity;
  /** it has grown since it was drawn whole */
  #isGrown = true;

  constructor(view: View) {
    this.#view = view;
  }

  attach(canvas: HTMLCanvasElement): void {
    this.#canvas = canvas;
  }

  /** The view, the size or a colour has changed. */
  invalidate(): void {
    [this.#wholeAt, this.#isGrown] = [-Infinity, true];
  }

  /** Draws what is new of the trail of the axes X, Y, Z (by index, -1: none). */
  draw(history: History | null, axes: number[], colour: string, now: number): void {
    const context = this.#canvas?.getContext('2d');
    if (!context || history === null) return;
    const begin = Math.max(this.from, history.count - history.capacity);
    // Powers of two: the same samples are drawn from frame to frame, and for long.
    const step = 2 ** Math.ceil(Math.log2(Math.max(1, (history.count - begin) / MAX_POINTS)));
    const isOld = now - this.#wholeAt > AGE_MS && this.#isGrown;
    if (isOld || step !== this.#step || this.#next < begin || this.#next > history.count + step) {
      context.clearRect(0, 0, this.#canvas!.width, this.#canvas!.height);
      [this.#step, this.#next, this.#end, this.#isBroken] = [step, Math.ceil(begin / step) * step, null, false];
      [this.#wholeAt, this.#isGrown] = [now, false];
    }
    this.#append(context, history, axes, colour);
  }

  /** Whether samples are missing between the next one that is drawn and the one before. */
  #hasGap(history: History): boolean {
    for (let i = Math.max(0, this.#next - this.#step + 1); i <= this.#next; i += 1) if (history.gap[i % history.capacity] === 1) return true;
    return false;
  }

  #append(context: CanvasRenderingContext2D, history: History, axes: number[], colour: string): void {
    const view = this.#view;
    const { right: r, up: u } = view.basis;
    const [x, y, z] = axes.map((axis) => history.position[axis]);
    const [cx, cy, cz] = view.centre;
    const end = this.#end;
    let [px, py, isDrawn, isBroken] = [end?.[0] ?? NaN, end?.[1] ?? NaN, false, this.#isBroken];
    for (; this.#next < history.count; this.#next += this.#step) {
      const at = this.#next % history.capacity;
      const [dx, dy, dz] = [(x?.[at] ?? 0) - cx, (y?.[at] ?? 0) - cy, (z?.[at] ?? 0) - cz];
      const nx = view.width / 2 + (dx * r[0] + dy * r[1] + dz * r[2]) * view.scale;
      const ny = view.height / 2 - (dx * u[0] + dy * u[1] + dz * u[2]) * view.scale;
      isBroken ||= this.#hasGap(history);
      if (Math.abs(nx - px) < STILL_PX && Math.abs(ny - py) < STILL_PX) continue;
      if (!isDrawn) {
        context.strokeStyle = colour;
        context.lineWidth = 1.5;
        context.beginPath();
        if (!Number.isNaN(px)) context.moveTo(px, py);
        isDrawn = true;
      }
      // Where samples were lost, nobody knows which way the tool went.
      if (isBroken) context.moveTo(nx, ny);
      else context.lineTo(nx, ny);
      isBroken = false;
      [px, py] = [nx, ny];
    }
    this.#isBroken = isBroken;
    if (!isDrawn) return;
    context.stroke();
    [this.#end, this.#isGrown] = [[px, py], true];
  }
}
