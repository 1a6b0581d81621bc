/** Vertices of a chunk at most, so that indices fit into 16 bits; 65535 is no index of WebGL 2. */
export const CHUNK_VERTICES = 65_535;

/** What limits the motion, by classes of the numbers of `Limiting` in evolvent-analysis: feed word, chord error, joint, nothing; velocity, acceleration, jerk. */
export const LIMITS = ['feed', 'chord', 'joint', 'none', 'velocity', 'acceleration', 'jerk'] as const;
export const LIMIT_COLOURS = ['#26a640', '#8a3ffc', '#00b5c8', '#8c97a1', '#294dd9', '#e69900', '#d9261a'] as const;

/** The class of such a number. Standing still is of no segment. */
export function limitClass(number: number): number {
  if (number < 3) return number;
  return number < 5 ? 3 : 4 + ((number - 5) % 3);
}

/** What of a polyline is drawn: `position` x y z a vertex, `feed` mm/s of the segment that ends there (negative: rapid), `limit` of that segment's motion. */
export interface DrawnChunk {
  position: Float32Array;
  feed: Float32Array;
  /** a number of `LIMITS` */
  limit: Uint8Array;
}

/** A polyline with the line of the program of each vertex. */
export interface PathChunk extends DrawnChunk {
  line: Uint32Array;
}

/** A chunk of the programmed path; its first vertex is the `first`-th of the whole. */
export interface ProgrammedChunk<Chunk extends DrawnChunk = PathChunk> {
  chunk: Chunk;
  first: number;
}

/** The vertex of a programmed chunk from which it is drawn, where the planned path replaces the first `replaced` vertices; one vertex is no line. */
export function drawnFrom({ chunk, first }: ProgrammedChunk<DrawnChunk>, replaced: number): number | null {
  const from = Math.max(0, replaced - 1 - first);
  return from < chunk.feed.length - 1 ? from : null;
}
