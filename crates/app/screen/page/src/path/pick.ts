import type { PathChunk } from './chunk';
import type { View } from './view';

/** How near to the finger a point of the path has to be, px. */
const REACH = 24;

/** Time after which the page goes on with other work, ms. */
const SLICE_MS = 8;

/** The program line whose path is nearest to a point of the screen as it is now; 0 where none is near, null where `signal` came first. */
export async function pick(chunks: PathChunk[], view: View, x: number, y: number, signal: AbortSignal): Promise<number | null> {
  const { right: r, up: u } = view.basis;
  const [cx, cy, cz] = view.centre;
  // The point in mm from the view's centre, along the screen.
  const px = (x - view.width / 2) / view.scale;
  const py = (view.height / 2 - y) / view.scale;
  let [best, line] = [(REACH / view.scale) ** 2, 0];
  let begun = performance.now();
  for (const { position, feed, line: lines } of chunks) {
    if (performance.now() - begun > SLICE_MS) {
      await new Promise((resolve) => setTimeout(resolve));
      begun = performance.now();
    }
    if (signal.aborted) return null;
    let [ax, ay] = [NaN, NaN];
    for (let i = 0; i < feed.length; i += 1) {
      const dx = position[3 * i]! - cx;
      const dy = position[3 * i + 1]! - cy;
      const dz = position[3 * i + 2]! - cz;
      const bx = dx * r[0] + dy * r[1] + dz * r[2] - px;
      const by = dx * u[0] + dy * u[1] + dz * u[2] - py;
      // The distance to the segment that ends here.
      const [ex, ey] = [bx - ax, by - ay];
      const length = ex * ex + ey * ey;
      const t = length > 0 ? Math.min(1, Math.max(0, -(ax * ex + ay * ey) / length)) : 1;
      const distance = i === 0 ? bx * bx + by * by : (ax + t * ex) ** 2 + (ay + t * ey) ** 2;
      if (distance < best) [best, line] = [distance, lines[i]!];
      [ax, ay] = [bx, by];
    }
  }
  return line;
}

export interface Run {
  chunk: PathChunk;
  /** vertices from `begin` up to and with `end` */
  begin: number;
  end: number;
}

/** Runs of a line at most. */
const MAX_RUNS = 200;

/** Where the path of a program line is. Each chunk is searched once, however often more of the path comes. */
export class LineRuns {
  #line = 0;
  #searched = new Set<PathChunk>();
  #runs: Run[] = [];

  of(chunks: PathChunk[], line: number): Run[] {
    if (line !== this.#line) [this.#line, this.#searched, this.#runs] = [line, new Set(), []];
    if (line <= 0) return [];
    const present = new Set(chunks);
    // What the planned path has replaced is gone.
    this.#runs = this.#runs.filter(({ chunk }) => present.has(chunk));
    for (const chunk of this.#searched) if (!present.has(chunk)) this.#searched.delete(chunk);
    for (const chunk of chunks) {
      if (this.#searched.has(chunk) || this.#runs.length >= MAX_RUNS) continue;
      this.#searched.add(chunk);
      this.#search(chunk);
    }
    return this.#runs;
  }

  #search(chunk: PathChunk): void {
    const line = this.#line;
    for (let at = chunk.line.indexOf(line); at >= 0 && this.#runs.length < MAX_RUNS; ) {
      let end = at;
      while (end + 1 < chunk.line.length && chunk.line[end + 1] === line) end += 1;
      // A segment begins where the one before it ended.
      this.#runs.push({ chunk, begin: Math.max(0, at - 1), end });
      at = chunk.line.indexOf(line, end + 1);
    }
  }
}
