// Reads the programmed path and hands it on in chunks that the graphics side takes as they are. Chunks of the server follow each
// other as u32 count, then for all vertices x y z (f32), feed of the segment that ends there in mm/s (f32, negative: rapid), line (u32), what
// limits it (u8).
import { CHUNK_VERTICES, limitClass, type PathChunk } from '../path/chunk';
import { emptyBox, type Box } from '../path/view';

export type PathRequest = { kind: 'load'; url: string; id: number } | { kind: 'clear'; id: number };
export type PathReply =
  | { kind: 'chunk'; id: number; chunk: PathChunk; box: Box; fastest: number; read: number }
  /** `profile`: path in mm and time in s at some of the vertices, in turn */
  | { kind: 'complete'; id: number; vertices: number; profile: Float64Array }
  | { kind: 'failed'; id: number; text: string };

/** A server that sent more in one chunk would be none of ours. */
const MAX_COUNT = 1 << 20;
const VERTEX_BYTES = 21;
/** vertices between two entries of the profile */
const PROFILE_STEP = 128;

let present = 0;

class Builder {
  readonly #id: number;
  #chunk = this.#fresh();
  #count = 0;
  #box = emptyBox();
  #fastest = 0;
  #mm = 0;
  #s = 0;
  #before = 0;
  vertices = 0;
  readonly profile: number[] = [];
  readonly #begun = performance.now();
  #flushAt = 0;

  constructor(id: number) {
    this.#id = id;
  }

  #fresh(): PathChunk {
    return { position: new Float32Array(3 * CHUNK_VERTICES), feed: new Float32Array(CHUNK_VERTICES), line: new Uint32Array(CHUNK_VERTICES), limit: new Uint8Array(CHUNK_VERTICES) };
  }

  add(x: number, y: number, z: number, feed: number, line: number, limit: number): void {
    const at = this.#count;
    this.#chunk.position[3 * at] = x;
    this.#chunk.position[3 * at + 1] = y;
    this.#chunk.position[3 * at + 2] = z;
    this.#chunk.feed[at] = feed;
    this.#chunk.line[at] = line;
    this.#chunk.limit[at] = limit;
    if (at > 0) {
      const p = this.#chunk.position;
      const length = Math.hypot(x - p[3 * at - 3]!, y - p[3 * at - 2]!, z - p[3 * at - 1]!);
      const speed = (Math.abs(feed) + Math.abs(this.#before)) / 2;
      this.#mm += length;
      if (speed > 0) this.#s += length / speed;
    }
    this.#before = feed;
    if (this.vertices % PROFILE_STEP === 0) this.profile.push(this.#mm, this.#s);
    this.#count += 1;
    this.vertices += 1;
    const { min, max } = this.#box;
    if (x < min[0]) min[0] = x;
    if (y < min[1]) min[1] = y;
    if (z < min[2]) min[2] = z;
    if (x > max[0]) max[0] = x;
    if (y > max[1]) max[1] = y;
    if (z > max[2]) max[2] = z;
    if (feed > this.#fastest) this.#fastest = feed;
    if (this.#count === CHUNK_VERTICES) {
      this.flush(0);
      // The next chunk begins where this one ended.
      this.#count = 0;
      this.vertices -= 1;
      this.add(x, y, z, feed, line, limit);
    }
  }

  finish(): void {
    this.flush(1);
    this.profile.push(this.#mm, this.#s);
  }

  /** Hands on what is here, where enough time has passed: at once at first, then in ever longer intervals, so that there are few chunks. */
  tick(): void {
    const now = performance.now();
    if (now < this.#flushAt || this.#count < 2) return;
    this.#flushAt = now + Math.max(250, now - this.#begun);
    if (this.#count === CHUNK_VERTICES) return;
    const at = this.#count - 1;
    const [p, feed, line, limit] = [this.#chunk.position, this.#chunk.feed[at]!, this.#chunk.line[at]!, this.#chunk.limit[at]!];
    const [x, y, z] = [p[3 * at]!, p[3 * at + 1]!, p[3 * at + 2]!];
    this.flush(0);
    // The next chunk begins where this one ended; what it was copied from is free again.
    this.#count = 0;
    this.vertices -= 1;
    this.add(x, y, z, feed, line, limit);
  }

  flush(read: number): void {
    if (this.#count < 2) return;
    const whole = this.#count === CHUNK_VERTICES;
    const chunk = whole
      ? this.#chunk
      : { position: this.#chunk.position.slice(0, 3 * this.#count), feed: this.#chunk.feed.slice(0, this.#count), line: this.#chunk.line.slice(0, this.#count), limit: this.#chunk.limit.slice(0, this.#count) };
    const reply: PathReply = { kind: 'chunk', id: this.#id, chunk, box: this.#box, fastest: this.#fastest, read };
    postMessage(reply, { transfer: [chunk.position.buffer, chunk.feed.buffer, chunk.line.buffer, chunk.limit.buffer] });
    if (whole) this.#chunk = this.#fresh();
    this.#box = emptyBox();
  }
}

async function load(url: string, id: number): Promise<void> {
  const response = await fetch(url);
  if (!response.ok || response.body === null) throw new Error(`${response.status} ${response.statusText}`);
  const reader = response.body.getReader();
  const builder = new Builder(id);
  let rest = new Uint8Array(0);
  for (;;) {
    const { done, value } = await reader.read();
    if (id !== present) {
      await reader.cancel();
      return;
    }
    if (done) break;
    const bytes = new Uint8Array(rest.length + value.length);
    bytes.set(rest);
    bytes.set(value, rest.length);
    const view = new DataView(bytes.buffer);
    let at = 0;
    while (at + 4 <= bytes.length) {
      const count = view.getUint32(at, true);
      if (count > MAX_COUNT) throw new Error(`a chunk of ${count} vertices`);
      if (at + 4 + count * VERTEX_BYTES > bytes.length) break;
      const [positions, feeds, lines, limits] = [at + 4, at + 4 + 12 * count, at + 4 + 16 * count, at + 4 + 20 * count];
      for (let i = 0; i < count; i += 1) {
        const p = positions + 12 * i;
        const feed = view.getFloat32(feeds + 4 * i, true);
        builder.add(view.getFloat32(p, true), view.getFloat32(p + 4, true), view.getFloat32(p + 8, true), feed, view.getUint32(lines + 4 * i, true), limitClass(view.getUint8(limits + i)));
      }
      at += 4 + count * VERTEX_BYTES;
    }
    builder.tick();
    rest = bytes.slice(at);
  }
  builder.finish();
  postMessage({ kind: 'complete', id, vertices: builder.vertices, profile: new Float64Array(builder.profile) } satisfies PathReply);
}

onmessage = (event: MessageEvent<PathRequest>) => {
  const request = event.data;
  present = request.id;
  if (request.kind === 'load') {
    load(request.url, request.id).catch((error: unknown) => {
      postMessage({ kind: 'failed', id: request.id, text: String(error) } satisfies PathReply);
    });
  }
};
