// The path on a canvas without WebGL: thinned, and slice by slice, so that the page stays at work while it is drawn.
import type { PathChunk } from './chunk';
import type { View } from './view';

/** vertices of the picture at most */
const MAX_VERTICES = 50_000;
/** vertices that are drawn in one frame */
const SLICE = 6000;

export class FlatPath {
  readonly canvas = document.createElement('canvas');
  readonly #view: View;
  #frame = 0;

  constructor(view: View) {
    this.#view = view;
    this.canvas.setAttribute('aria-hidden', 'true');
    this.canvas.dataset['test'] = 'path-picture';
  }

  resize(ratio: number): void {
    [this.canvas.width, this.canvas.height] = [Math.round(this.#view.width * ratio), Math.round(this.#view.height * ratio)];
    this.canvas.getContext('2d')?.scale(ratio, ratio);
  }

  /** Draws all of it again: the view or the path has changed. */
  draw(chunks: PathChunk[], colour: string): void {
    this.stop();
    const context = this.canvas.getContext('2d');
    if (context === null) return;
    context.clearRect(0, 0, this.canvas.width, this.canvas.height);
    const total = chunks.reduce((sum, chunk) => sum + chunk.feed.length, 0);
    const step = Math.max(1, Math.ceil(total / MAX_VERTICES));
    context.strokeStyle = colour;
    context.lineWidth = 1;
    this.#frame = requestAnimationFrame(() => this.#slice(context, chunks, step, 0, 0));
  }

  stop(): void {
    cancelAnimationFrame(this.#frame);
  }

  #slice(context: CanvasRenderingContext2D, chunks: PathChunk[], step: number, at: number, from: number): void {
    const view = this.#view;
    const basis = view.basis;
    let left = SLICE;
    for (; at < chunks.length && left > 0; at += 1) {
      const { position, feed } = chunks[at]!;
      context.beginPath();
      let i = from;
      for (; i < feed.length && left > 0; i += step) {
        context.lineTo(...view.project(position[3 * i]!, position[3 * i + 1]!, position[3 * i + 2]!, basis));
        left -= 1;
      }
      context.stroke();
      if (i < feed.length) {
        // The next slice begins where this one ended.
        from = i - step;
        break;
      }
      from = 0;
    }
    if (at < chunks.length) this.#frame = requestAnimationFrame(() => this.#slice(context, chunks, step, at, from));
  }
}
