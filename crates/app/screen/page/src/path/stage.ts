// The canvas of the path with its scene and view. It outlives the view of the page that shows it: a graphics context and a path on the
// graphics side take long to set up, and an operator changes between views all the time.
import type { DrawnChunk, PathChunk } from './chunk';
import { openScene, type SceneLink } from './scene-link';
import type { path } from './store.svelte';
import { View } from './view';

/** Chunks that the scene gets in one frame, 0.9 MB each. */
const CHUNKS_OF_FRAME = 2;

/** Nobody draws the numbers of lines. */
function drawnOf({ position, feed, limit }: PathChunk): DrawnChunk {
  return { position, feed, limit };
}

export class PathStage {
  readonly view = new View();
  /** null without WebGL */
  scene = openScene();
  /** the operator has turned, moved or zoomed the view */
  isTouched = false;
  /** the whole path was fitted into the view */
  isFitted = false;
  #generation = -1;
  #planned = 0;
  /** number of the first vertex of the programmed path that the scene has not got */
  #programmed = 0;
  #frame = 0;

  /** A new scene instead of one that has lost its graphics. */
  renew(): void {
    this.rest();
    void this.scene.then((lost) => lost?.link({ kind: 'end' }));
    this.scene = openScene();
    [this.#generation, this.#planned, this.#programmed] = [-1, 0, 0];
  }

  /** Gives the scene what is new of the path. */
  update(link: SceneLink | null, from: typeof path): void {
    if (from.generation !== this.#generation) {
      link?.({ kind: 'clear' });
      [this.#generation, this.#planned, this.#programmed] = [from.generation, 0, 0];
      [this.isTouched, this.isFitted] = [false, false];
    }
    if (link === null) return;
    link({ kind: 'replace', count: from.replaced });
    link({ kind: 'fastest', mm_s: from.fastest });
    if (this.#frame === 0) this.#send(link, from);
  }

  /** Nobody looks any more; `update` goes on with what the scene has not got. */
  rest(): void {
    cancelAnimationFrame(this.#frame);
    this.#frame = 0;
  }

  // A few in each frame: each is copied, and a long path is a few hundred.
  #send(link: SceneLink, from: typeof path): void {
    this.#frame = 0;
    if (from.generation !== this.#generation) return;
    let left = CHUNKS_OF_FRAME;
    for (const { chunk, first } of from.programmed) {
      if (first < this.#programmed) continue;
      if (left === 0) break;
      link({ kind: 'addProgrammed', programmed: { chunk: drawnOf(chunk), first } });
      this.#programmed = first + 1;
      left -= 1;
    }
    for (; this.#planned < from.chunks.length && left > 0; this.#planned += 1) {
      link({ kind: 'add', chunk: drawnOf(from.chunks[this.#planned]!) });
      left -= 1;
    }
    if (left === 0) this.#frame = requestAnimationFrame(() => this.#send(link, from));
  }
}

let spare: PathStage | null = null;

/** Sets one up while the page has nothing else to do. */
export function prepareStage(): void {
  const prepare = (): void => {
    spare ??= new PathStage();
  };
  if ('requestIdleCallback' in globalThis) requestIdleCallback(prepare, { timeout: 5000 });
  else setTimeout(prepare, 1000);
}

export function takeStage(): PathStage {
  const stage = spare ?? new PathStage();
  spare = null;
  return stage;
}

export function returnStage(stage: PathStage): void {
  stage.rest();
  if (spare === null) spare = stage;
  else void stage.scene.then((scene) => scene?.link({ kind: 'end' }));
}
