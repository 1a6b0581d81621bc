// Reads the path of a program, first as it is programmed, then as it is planned, and hands it on in chunks that the graphics side
// takes as they are.
import { ChunkBuilder, type BuiltChunk } from '../path/chunk-builder';
import { ChunkReader } from '../path/chunk-reader';

export type PathRequest = { kind: 'load'; url: string; id: number } | { kind: 'clear'; id: number };
export type PathReply =
  /** `replaced`: vertices of the programmed path, from the first, that the planned path up to this chunk replaces */
  | ({ kind: 'chunk'; id: number; planned: boolean; replaced: number } & BuiltChunk)
  /** all of the programmed path is here */
  | { kind: 'programmed'; id: number }
  /** `profile` and `lines` of the planned path: see `RunProgress` */
  | { kind: 'complete'; id: number; replaced: number; profile: Float64Array; lines: Float32Array }
  | { kind: 'failed'; id: number; text: string };

let present = 0;
let reading = new AbortController();

function reply(message: PathReply, transfer: Transferable[] = []): void {
  postMessage(message, { transfer });
}

async function load(url: string, id: number): Promise<void> {
  const response = await fetch(url, { signal: reading.signal });
  if (!response.ok || response.body === null) throw new Error(`${response.status} ${response.statusText}`);
  const body = response.body.getReader();
  const reader = new ChunkReader();
  let replaced = 0;
  const builder = (planned: boolean): ChunkBuilder =>
    new ChunkBuilder((built) => {
      const { position, feed, line, limit } = built.chunk;
      reply({ kind: 'chunk', id, planned, replaced, ...built }, [position.buffer, feed.buffer, line.buffer, limit.buffer]);
    });
  const programmed = builder(false);
  let planned: ChunkBuilder | null = null;
  for (;;) {
    const { done, value } = await body.read();
    if (id !== present) {
      await body.cancel();
      return;
    }
    if (done) break;
    reader.read(value, (chunk) => {
      if (chunk.planned && planned === null) {
        programmed.finish();
        reply({ kind: 'programmed', id });
        planned = builder(true);
      }
      (planned ?? programmed).append(chunk);
      replaced = chunk.replaced;
    });
    ((planned as ChunkBuilder | null) ?? programmed).tick();
  }
  const whole = (planned as ChunkBuilder | null) ?? programmed;
  whole.finish();
  reply({ kind: 'complete', id, replaced, profile: new Float64Array(whole.profile), lines: whole.lines }, [whole.lines.buffer]);
}

onmessage = (event: MessageEvent<PathRequest>) => {
  const request = event.data;
  present = request.id;
  // The server plans for nobody else than who reads.
  reading.abort();
  reading = new AbortController();
  if (request.kind === 'load') {
    load(request.url, request.id).catch((error: unknown) => {
      if (request.id === present) reply({ kind: 'failed', id: request.id, text: String(error) });
    });
  }
};
