// What the page says to the scene of the path, which lives in a worker.
import type { DrawnChunk, ProgrammedChunk } from './chunk';
import type { Basis, Box } from './view';

/** How the scene is seen; `View` is one. */
export interface SceneView {
  width: number;
  height: number;
  centre: readonly [number, number, number];
  /** px per mm */
  scale: number;
  basis: Basis;
}

export type SceneRequest =
  | { kind: 'begin'; canvas: OffscreenCanvas | HTMLCanvasElement }
  | { kind: 'view'; view: SceneView }
  | { kind: 'resize'; width: number; height: number }
  | { kind: 'clear' }
  | { kind: 'add'; chunk: DrawnChunk }
  | { kind: 'addProgrammed'; programmed: ProgrammedChunk<DrawnChunk> }
  | { kind: 'replace'; count: number }
  | { kind: 'fastest'; mm_s: number }
  | { kind: 'box'; box: Box | null }
  | { kind: 'colours'; rapid: string; box: string; byLimit: boolean }
  | { kind: 'hide'; isHidden: boolean }
  | { kind: 'end' };

/** `lost`: the graphics side is gone, and the scene with it. */
export type SceneReply = { kind: 'begun'; webgl: boolean } | { kind: 'lost' };
