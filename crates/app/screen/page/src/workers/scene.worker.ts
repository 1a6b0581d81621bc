// Draws the path on a canvas that the page has handed over: where the graphics side is behind, this thread waits and not the page's.
// A browser whose workers have no WebGL loads this file as a part of the page.
import { PathScene } from '../path/scene';
import type { SceneReply, SceneRequest, SceneView } from '../path/scene-message';

let scene: PathScene | null = null;
const view: SceneView = { width: 1, height: 1, centre: [0, 0, 0], scale: 1, basis: { right: [1, 0, 0], up: [0, 1, 0], towards: [0, 0, 1] } };

function begin(canvas: OffscreenCanvas | HTMLCanvasElement, reply: (message: SceneReply) => void): SceneReply {
  try {
    scene = new PathScene(canvas, view, () => reply({ kind: 'lost' }));
  } catch {
    // Without WebGL the page draws a plan by itself.
  }
  return { kind: 'begun', webgl: scene !== null };
}

function take(request: SceneRequest, reply: (message: SceneReply) => void): void {
  switch (request.kind) {
    case 'begin':
      reply(begin(request.canvas, reply));
      break;
    case 'view':
      Object.assign(view, request.view);
      scene?.invalidate();
      break;
    case 'resize':
      scene?.resize(request.width, request.height);
      break;
    case 'clear':
      scene?.clear();
      break;
    case 'add':
      scene?.add(request.chunk);
      break;
    case 'addProgrammed':
      scene?.addProgrammed(request.programmed);
      break;
    case 'replace':
      scene?.replace(request.count);
      break;
    case 'fastest':
      if (scene) scene.fastest = request.mm_s;
      break;
    case 'box':
      scene?.setBox(request.box);
      break;
    case 'colours':
      scene?.setColours(request.rapid, request.box, request.byLimit);
      break;
    case 'hide':
      scene?.hide(request.isHidden);
      break;
    case 'end':
      scene?.dispose();
      break;
  }
}

if ('document' in globalThis) Object.assign(globalThis, { takeSceneRequest: take });
else onmessage = (event: MessageEvent<SceneRequest>) => take(event.data, (message) => postMessage(message));
