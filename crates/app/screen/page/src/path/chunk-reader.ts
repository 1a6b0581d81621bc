// Chunks of the path in the pieces of a response, as the server's PROTOCOL.md describes them.
import type { PathChunk } from './chunk';

export interface ServerChunk extends PathChunk {
  count: number;
  planned: boolean;
  /** vertices of the programmed path, from the first, that the planned path so far replaces */
  replaced: number;
}

/** A server that sent more in one chunk would be none of ours. */
const MAX_COUNT = 1 << 20;
const HEADER_BYTES = 12;
const VERTEX_BYTES = 21;

export class ChunkReader {
  #part = new Uint8Array(HEADER_BYTES);
  #filled = 0;
  #header: { count: number; planned: boolean; replaced: number } | null = null;

  /** Takes the next piece; calls `take` with each chunk that is whole. */
  read(piece: Uint8Array, take: (chunk: ServerChunk) => void): void {
    for (let at = 0; at < piece.length; ) {
      const count = Math.min(piece.length - at, this.#part.length - this.#filled);
      this.#part.set(piece.subarray(at, at + count), this.#filled);
      this.#filled += count;
      at += count;
      if (this.#filled < this.#part.length) return;
      if (this.#header === null) this.#begin();
      if (this.#header !== null && this.#filled === this.#part.length) this.#end(this.#header, take);
    }
  }

  #begin(): void {
    const view = new DataView(this.#part.buffer);
    const [count, kind, replaced] = [view.getUint32(0, true), view.getUint32(4, true), view.getUint32(8, true)];
    if (count > MAX_COUNT || kind > 1) throw new Error(`a chunk of ${count} vertices of kind ${kind}`);
    this.#header = { count, planned: kind === 1, replaced };
    [this.#part, this.#filled] = [new Uint8Array(count * VERTEX_BYTES), 0];
  }

  // Browsers run on little-endian processors: the arrays are taken as they are.
  #end(header: { count: number; planned: boolean; replaced: number }, take: (chunk: ServerChunk) => void): void {
    const { count } = header;
    const { buffer } = this.#part;
    take({
      ...header,
      position: new Float32Array(buffer, 0, 3 * count),
      feed: new Float32Array(buffer, 12 * count, count),
      line: new Uint32Array(buffer, 16 * count, count),
      limit: new Uint8Array(buffer, 20 * count, count),
    });
    this.#header = null;
    [this.#part, this.#filled] = [new Uint8Array(HEADER_BYTES), 0];
  }
}
