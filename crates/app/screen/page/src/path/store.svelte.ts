// The path of the loaded program, as it comes in chunks.
import { programText } from '../lib/program-text.svelte';
import { session } from '../lib/session.svelte';
import type { PathReply, PathRequest } from '../workers/path.worker';
import { drawnFrom, type PathChunk, type ProgrammedChunk } from './chunk';
import { RunProgress } from './run-progress';
import { emptyBox, type Box } from './view';

/** The key of nothing. */
const FAILED = 'failed';

class PathStore {
  #worker: Worker | null = null;
  #id = 0;
  #key = '';

  /** the planned path */
  chunks: PathChunk[] = [];
  /** the programmed path, without the chunks that the planned path has replaced */
  programmed: ProgrammedChunk[] = [];
  /** vertices of the programmed path, from the first, that the planned path has replaced */
  replaced = 0;
  /** another number is another path */
  generation = 0;
  box: Box = emptyBox();
  /** whether the box holds all of the path */
  isBoxWhole = false;
  /** grows with every change, so that views notice */
  version = $state(0);
  /** 1 when all of it is here */
  progress = $state(1);
  fastest = $state(0);
  note = $state('');
  #run = $state.raw<RunProgress | null>(null);

  clear(): void {
    [this.chunks, this.programmed, this.replaced] = [[], [], 0];
    this.generation += 1;
    this.box = emptyBox();
    this.isBoxWhole = false;
    this.progress = 0;
    this.fastest = 0;
    this.note = '';
    this.#run = null;
    this.version += 1;
  }

  /** Every chunk that is drawn, the replaced part of the programmed path included. */
  get all(): PathChunk[] {
    return [...this.chunks, ...this.programmed.map(({ chunk }) => chunk)];
  }

  add(chunk: PathChunk, box: Box, fastest: number): void {
    this.chunks.push(chunk);
    this.#grow(box, fastest);
  }

  #grow(box: Box, fastest: number): void {
    for (const i of [0, 1, 2] as const) {
      this.box.min[i] = Math.min(this.box.min[i], box.min[i]);
      this.box.max[i] = Math.max(this.box.max[i], box.max[i]);
    }
    this.fastest = Math.max(this.fastest, fastest);
    this.version += 1;
  }

  #replace(count: number): void {
    this.replaced = count;
    this.programmed = this.programmed.filter((programmed) => drawnFrom(programmed, count) !== null);
  }

  /** Reads the path from `url`, again whenever `key` (program and what it was planned with) is another; an empty one empties it. */
  load(url: string, key: string): void {
    if (key === this.#key) return;
    this.#key = key;
    this.clear();
    this.#id += 1;
    if (this.#worker === null) {
      this.#worker = new Worker(new URL('../workers/path.worker.ts', import.meta.url), { type: 'module', name: 'path' });
      this.#worker.onmessage = (event: MessageEvent<PathReply>) => this.#take(event.data);
    }
    const request: PathRequest = url === '' ? { kind: 'clear', id: this.#id } : { kind: 'load', url: new URL(url, document.baseURI).href, id: this.#id };
    this.#worker.postMessage(request);
    if (url === '') this.progress = 1;
  }

  #take(reply: PathReply): void {
    if (reply.id !== this.#id) return;
    switch (reply.kind) {
      case 'chunk':
        if (!reply.planned) {
          this.programmed.push({ chunk: reply.chunk, first: reply.first });
          this.#grow(reply.box, reply.fastest);
          break;
        }
        this.#replace(reply.replaced);
        this.add(reply.chunk, reply.box, reply.fastest);
        // By lines, because nobody knows the number of vertices before.
        if (programText.lines > 0) this.progress = Math.min(0.99, Math.max(this.progress, reply.chunk.line.at(-1)! / programText.lines));
        break;
      case 'programmed':
        this.isBoxWhole = true;
        this.version += 1;
        break;
      case 'complete':
        this.#replace(reply.replaced);
        this.isBoxWhole = true;
        this.progress = 1;
        this.version += 1;
        this.complete(reply.profile, reply.lines);
        break;
      case 'failed':
        this.progress = 1;
        this.note = reply.text;
        // The same path is read again when the server tells of its program again, as on every connection.
        this.#key = FAILED;
        break;
    }
  }

  /** What is known once all of the planned path is here. */
  complete(profile: Float64Array, lines: Float32Array): void {
    this.#run = new RunProgress(profile, lines);
  }

  /** Seconds that the running program still needs as it was planned, at the present feed override; null where that is not known. */
  get remainingS(): number | null {
    const planned = session.program?.plannedS ?? null;
    const status = session.status;
    // The plan is that of the program that is shown.
    if (planned === null || this.#run === null || status?.activity !== 'program' || session.isOtherProgram || !(status.override > 0)) return null;
    const over = this.#run.timeFraction(status);
    return over === null ? null : (planned * (1 - over)) / status.override;
  }

  /** The travel of X, Y and Z; axes that the machine has not are flat. */
  travel(): Box | null {
    const axes = session.machine?.axes;
    if (!axes) return null;
    const box: Box = { min: [0, 0, 0], max: [0, 0, 0] };
    ['X', 'Y', 'Z'].forEach((letter, i) => {
      const axis = axes.find((entry) => entry.letter === letter);
      if (axis) [box.min[i], box.max[i]] = [axis.min, axis.max];
    });
    return box;
  }
}

export const path = new PathStore();
