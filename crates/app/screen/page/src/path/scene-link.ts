// The scene of the path as the page has it: a worker that draws on the page's canvas, or the same file in the page where a browser cannot.
import sceneWorker from '../workers/scene.worker?worker&url';
import type { SceneReply, SceneRequest } from './scene-message';

export type SceneLink = (request: SceneRequest) => void;

/** A new scene with its canvas; null without WebGL. */
export async function openScene(): Promise<{ link: SceneLink; canvas: HTMLCanvasElement } | null> {
  // A canvas that was handed over is of no further use to the page.
  const ways = 'transferControlToOffscreen' in HTMLCanvasElement.prototype ? [inWorker, inPage] : [inPage];
  for (const open of ways) {
    const canvas = document.createElement('canvas');
    canvas.setAttribute('aria-hidden', 'true');
    canvas.dataset['test'] = 'path-picture';
    const { link, begun } = await open(canvas);
    if ((await begun).webgl) return { link, canvas };
    link({ kind: 'end' });
  }
  return null;
}

interface Opened {
  link: SceneLink;
  begun: Promise<SceneReply>;
}

async function inWorker(canvas: HTMLCanvasElement): Promise<Opened> {
  const worker = new Worker(sceneWorker, { type: 'module', name: 'scene' });
  const begun = new Promise<SceneReply>((resolve) => {
    worker.onmessage = (event: MessageEvent<SceneReply>) => resolve(event.data);
  });
  const offscreen = canvas.transferControlToOffscreen();
  worker.postMessage({ kind: 'begin', canvas: offscreen } satisfies SceneRequest, [offscreen]);
  return {
    link: (request) => {
      worker.postMessage(request);
      if (request.kind === 'end') worker.terminate();
    },
    begun,
  };
}

async function inPage(canvas: HTMLCanvasElement): Promise<Opened> {
  await import(/* @vite-ignore */ sceneWorker);
  const take = (globalThis as unknown as { takeSceneRequest: (request: SceneRequest, reply: (message: SceneReply) => void) => void }).takeSceneRequest;
  const begun = new Promise<SceneReply>((resolve) => take({ kind: 'begin', canvas }, resolve));
  return { link: (request) => take(request, () => {}), begun };
}
