// Merges the server's chunks into fewer and longer ones, which cost the graphics side less.
import { CHUNK_VERTICES, limitClass, type PathChunk } from './chunk';
import { emptyBox, type Box } from './view';

/** vertices between two entries of the profile */
const PROFILE_STEP = 128;
/** Lines whose place on the path is kept: beyond them the distance of the run alone tells it. */
const MAX_LINE = 1 << 23;

export interface BuiltChunk {
  chunk: PathChunk;
  /** number of its first vertex */
  first: number;
  box: Box;
  /** of all chunks so far, mm/s */
  fastest: number;
}

export class ChunkBuilder {
  readonly #put: (built: BuiltChunk) => void;
  #chunk = fresh();
  #count = 0;
  #box = emptyBox();
  #fastest = 0;
  #mm = 0;
  #s = 0;
  vertices = 0;
  /** path in mm and time in s at some of the vertices, in turn */
  readonly profile: number[] = [];
  /** path in mm at which a line begins first, and at which it ends last, in turn; NaN for lines without motion */
  lines = new Float32Array(2 << 10).fill(NaN);
  readonly #begun = performance.now();
  #flushAt = 0;

  constructor(put: (built: BuiltChunk) => void) {
    this.#put = put;
  }

  append(source: PathChunk): void {
    const total = source.feed.length;
    for (let from = 0; from < total; ) {
      const at = this.#count;
      const count = Math.min(CHUNK_VERTICES - at, total - from);
      const { position, feed, line, limit } = this.#chunk;
      position.set(source.position.subarray(3 * from, 3 * (from + count)), 3 * at);
      feed.set(source.feed.subarray(from, from + count), at);
      line.set(source.line.subarray(from, from + count), at);
      for (let i = 0; i < count; i += 1) limit[at + i] = limitClass(source.limit[from + i]!);
      this.#count += count;
      this.#measure(at);
      this.vertices += count;
      from += count;
      if (this.#count === CHUNK_VERTICES) this.#flush();
    }
  }

  /** Hands on what is here, where enough time has passed: at once at first, then in ever longer intervals, so that there are few chunks. */
  tick(): void {
    const now = performance.now();
    if (now < this.#flushAt || this.#count < 2) return;
    this.#flushAt = now + Math.max(250, now - this.#begun);
    this.#flush();
  }

  finish(): void {
    this.#flush();
    this.profile.push(this.#mm, this.#s);
  }

  /** Length, time and box of the vertices from `begin` on. */
  #measure(begin: number): void {
    const { position, feed } = this.#chunk;
    const { min, max } = this.#box;
    for (let i = begin; i < this.#count; i += 1) {
      const [x, y, z] = [position[3 * i]!, position[3 * i + 1]!, position[3 * i + 2]!];
      if (i > 0) {
        const length = Math.hypot(x - position[3 * i - 3]!, y - position[3 * i - 2]!, z - position[3 * i - 1]!);
        const speed = (Math.abs(feed[i]!) + Math.abs(feed[i - 1]!)) / 2;
        const from = this.#mm;
        this.#mm += length;
        if (length > 0) this.#note(this.#chunk.line[i]!, from);
        if (speed > 0) this.#s += length / speed;
      }
      if ((this.vertices + i - begin) % PROFILE_STEP === 0) this.profile.push(this.#mm, this.#s);
      if (x < min[0]) min[0] = x;
      if (y < min[1]) min[1] = y;
      if (z < min[2]) min[2] = z;
      if (x > max[0]) max[0] = x;
      if (y > max[1]) max[1] = y;
      if (z > max[2]) max[2] = z;
      if (feed[i]! > this.#fastest) this.#fastest = feed[i]!;
    }
  }

  /** The path from `from` on to here is of `line`. */
  #note(line: number, from: number): void {
    if (line > MAX_LINE) return;
    if (2 * line >= this.lines.length) {
      const longer = new Float32Array(2 * Math.max(2 * line, this.lines.length)).fill(NaN);
      longer.set(this.lines);
      this.lines = longer;
    }
    if (Number.isNaN(this.lines[2 * line]!)) this.lines[2 * line] = from;
    this.lines[2 * line + 1] = this.#mm;
  }

  #flush(): void {
    const count = this.#count;
    if (count < 2) return;
    const full = this.#chunk;
    const [box, first] = [this.#box, this.vertices - count];
    const chunk = count === CHUNK_VERTICES ? full : slice(full, 0, count);
    // The next chunk begins where this one ended.
    const last = slice(full, count - 1, count);
    if (count === CHUNK_VERTICES) this.#chunk = fresh();
    [this.#count, this.#box] = [0, emptyBox()];
    this.#put({ chunk, first, box, fastest: this.#fastest });
    this.#chunk.position.set(last.position);
    this.#chunk.feed.set(last.feed);
    this.#chunk.line.set(last.line);
    this.#chunk.limit.set(last.limit);
    this.#count = 1;
  }
}

function fresh(): PathChunk {
  return { position: new Float32Array(3 * CHUNK_VERTICES), feed: new Float32Array(CHUNK_VERTICES), line: new Uint32Array(CHUNK_VERTICES), limit: new Uint8Array(CHUNK_VERTICES) };
}

function slice({ position, feed, line, limit }: PathChunk, from: number, to: number): PathChunk {
  return { position: position.slice(3 * from, 3 * to), feed: feed.slice(from, to), line: line.slice(from, to), limit: limit.slice(from, to) };
}
