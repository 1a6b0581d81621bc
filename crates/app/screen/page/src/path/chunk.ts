/** Vertices of a chunk at most, so that indices fit into 16 bits. */
export const CHUNK_VERTICES = 65_536;

/** A polyline: `position` x y z a vertex, `feed` mm/s of the segment that ends there (negative: rapid), `line` of the program. */
export interface PathChunk {
  position: Float32Array;
  feed: Float32Array;
  line: Uint32Array;
}
