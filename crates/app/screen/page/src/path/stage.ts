// The canvas of the path with its scene and view. It outlives the view of the page that shows it: a graphics context and a path on the
// graphics side take long to set up, and an operator changes between views all the time.
import { openScene, type SceneLink } from './scene-link';
import type { path } from './store.svelte';
import { View } from './view';

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

  /** A new scene instead of one that has lost its graphics. */
  renew(): void {
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
    for (const programmed of from.programmed) {
      if (programmed.first < this.#programmed) continue;
      link({ kind: 'addProgrammed', programmed });
      this.#programmed = programmed.first + 1;
    }
    for (; this.#planned < from.chunks.length; this.#planned += 1) link({ kind: 'add', chunk: from.chunks[this.#planned]! });
    link({ kind: 'fastest', mm_s: from.fastest });
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
  if (spare === null) spare = stage;
  else void stage.scene.then((scene) => scene?.link({ kind: 'end' }));
}
