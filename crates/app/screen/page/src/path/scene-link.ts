// The scene of the path as the page has it: a worker that draws on the page's canvas, or the same file in the page where a browser cannot.
import sceneWorker from '../workers/scene.worker?worker&url';
import type { SceneReply, SceneRequest } from './scene-message';

export type SceneLink = (request: SceneRequest) => void;

/** Time after which a worker that has not begun is given up: it may never have been loaded. A slow host takes seconds for its first context. */
const BEGIN_MS = 10_000;

export interface OpenedScene {
  link: SceneLink;
  canvas: HTMLCanvasElement;
  /** calls back when the scene has lost its graphics for good */
  onLost: (call: () => void) => void;
}

/** A new scene with its canvas; null without WebGL. */
export async function openScene(): Promise<OpenedScene | null> {
  // A canvas that was handed over is of no further use to the page.
  const ways = 'transferControlToOffscreen' in HTMLCanvasElement.prototype ? [inWorker, inPage] : [inPage];
  for (const open of ways) {
    const canvas = document.createElement('canvas');
    canvas.setAttribute('aria-hidden', 'true');
    canvas.dataset['test'] = 'path-picture';
    let lost = (): void => {};
    const opened = await open(canvas, () => lost()).catch(() => null);
    if (opened === null) continue;
    if (opened.webgl) return { link: opened.link, canvas, onLost: (call) => (lost = call) };
    opened.link({ kind: 'end' });
  }
  return null;
}

interface Opened {
  link: SceneLink;
  webgl: boolean;
}

async function inWorker(canvas: HTMLCanvasElement, lost: () => void): Promise<Opened> {
  const worker = new Worker(sceneWorker, { type: 'module', name: 'scene' });
  const begun = new Promise<boolean>((resolve) => {
    worker.onmessage = (event: MessageEvent<SceneReply>) => {
      if (event.data.kind === 'begun') resolve(event.data.webgl);
      else lost();
    };
    worker.onerror = () => resolve(false);
    setTimeout(() => resolve(false), BEGIN_MS);
  });
  const offscreen = canvas.transferControlToOffscreen();
  worker.postMessage({ kind: 'begin', canvas: offscreen } satisfies SceneRequest, [offscreen]);
  const link: SceneLink = (request) => {
    worker.postMessage(request);
    if (request.kind === 'end') worker.terminate();
  };
  return { link, webgl: await begun };
}

async function inPage(canvas: HTMLCanvasElement, lost: () => void): Promise<Opened> {
  await import(/* @vite-ignore */ sceneWorker);
  const take = (globalThis as unknown as { takeSceneRequest: (request: SceneRequest, reply: (message: SceneReply) => void) => void }).takeSceneRequest;
  const begun = new Promise<boolean>((resolve) =>
    take({ kind: 'begin', canvas }, (reply) => {
      if (reply.kind === 'begun') resolve(reply.webgl);
      else lost();
    }),
  );
  return { link: (request) => take(request, () => {}), webgl: await begun };
}
