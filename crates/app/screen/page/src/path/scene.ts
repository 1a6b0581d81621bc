// The path in WebGL. Vertices come in chunks and stay on the graphics side, which takes one chunk a frame; while the view moves only
// as many of them are drawn as a frame can take, and when it is at rest the rest is drawn in slices, so that no frame takes long.
import {
  BufferAttribute,
  BufferGeometry,
  Color,
  GLSL3,
  Line,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  OrthographicCamera,
  RawShaderMaterial,
  Scene,
  Vector3,
  WebGLRenderer,
} from 'three';
import { CHUNK_VERTICES, drawnFrom, LIMIT_COLOURS, type DrawnChunk, type ProgrammedChunk } from './chunk';
import type { SceneView } from './scene-message';
import type { Box } from './view';

/** What is drawn while the view moves: one run of `RUN` segments in so many. Runs and not every so-manieth vertex, because short segments
 * cost a software renderer 0.6 us each and the long chords between distant vertices 2 to 5 us, and because a run shows the true path. */
const THINNINGS = [1, 2, 4, 8, 16, 32, 64, 128, 256, 512];
const RUN = 64;
/** In WebGL 2 this index begins another polyline. */
const RESTART = 0xffff;
/** tuned: 20k to 100k; a software renderer on two cores draws 30k short segments in 20 ms */
const START_BUDGET = 30_000;
/** A frame that takes longer draws less next time; the same graphics side draws the rest of the page. */
const SLOW_MS = 30;
const FAST_MS = 20;
/** Time after a slow frame in which no more is drawn than in that frame. */
const CALM_MS = 2000;
/** Time without a change after which the view is at rest; the slices of a refinement take longer than a moving view's frames. */
const REST_MS = 150;
/** Time after which a lost context is given up. */
const LOST_MS = 5000;
/** Time within which what the planned path has replaced is removed from a picture at rest: both are nearly the same line. */
const SWEEP_MS = 3000;

const vertexShader = `
precision highp float;
uniform mat4 viewMatrix;
uniform mat4 projectionMatrix;
uniform float fastest;
uniform vec3 rapid;
uniform bool byLimit;
uniform vec3 limits[7];
in vec3 position;
in float feed;
in float limit;
flat out vec3 colour;
vec3 scaled(float t) {
  vec3 a = vec3(0.16, 0.30, 0.85);
  vec3 b = vec3(0.00, 0.60, 0.72);
  vec3 c = vec3(0.15, 0.65, 0.25);
  vec3 d = vec3(0.90, 0.60, 0.00);
  vec3 e = vec3(0.85, 0.15, 0.10);
  float s = clamp(t, 0.0, 1.0) * 4.0;
  if (s < 1.0) return mix(a, b, s);
  if (s < 2.0) return mix(b, c, s - 1.0);
  if (s < 3.0) return mix(c, d, s - 2.0);
  return mix(d, e, s - 3.0);
}
void main() {
  colour = feed < 0.0 ? rapid : byLimit ? limits[int(limit)] : scaled(feed / fastest);
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
}`;
const fragmentShader = `
precision mediump float;
flat in vec3 colour;
out vec4 result;
void main() {
  result = vec4(colour, 1.0);
}`;

/** One run in `thinning`: indices of a chunk of the full length, which all share. A shorter one ends its drawing earlier. */
const indexCache = new Map<number, BufferAttribute>();
function indices(thinning: number): BufferAttribute {
  let found = indexCache.get(thinning);
  if (found === undefined) {
    found = new BufferAttribute(thinning === 1 ? Uint16Array.from({ length: CHUNK_VERTICES }, (_, i) => i) : runs(thinning), 1);
    indexCache.set(thinning, found);
  }
  return found;
}

function runs(thinning: number): Uint16Array {
  const list: number[] = [];
  for (let begin = 0; begin < CHUNK_VERTICES - 1; begin += RUN * thinning) {
    for (let i = begin; i <= Math.min(begin + RUN, CHUNK_VERTICES - 1); i += 1) list.push(i);
    list.push(RESTART);
  }
  return Uint16Array.from(list);
}

/** The place of a vertex in such indices, or of the run that begins before it. */
export function indexOf(vertex: number, thinning: number): number {
  return thinning === 1 ? vertex : Math.floor(vertex / (RUN * thinning)) * (RUN + 2);
}

/** The number of such indices for a chunk of `count` vertices. */
export function indexCount(count: number, thinning: number): number {
  if (thinning === 1) return count;
  const last = count - 1;
  return indexOf(last, thinning) + Math.min(RUN, last % (RUN * thinning)) + 1;
}

/** Without the index, which others draw with. */
function dispose(geometry: BufferGeometry): void {
  geometry.setIndex(null);
  geometry.dispose();
}

function polyline(chunk: DrawnChunk, material: RawShaderMaterial): Line<BufferGeometry, RawShaderMaterial> {
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', new BufferAttribute(chunk.position, 3));
  geometry.setAttribute('feed', new BufferAttribute(chunk.feed, 1));
  geometry.setAttribute('limit', new BufferAttribute(chunk.limit, 1));
  const line = new Line(geometry, material);
  line.frustumCulled = false;
  line.matrixAutoUpdate = false;
  return line;
}

/** A chunk on the graphics side. */
interface Polyline {
  line: Line<BufferGeometry, RawShaderMaterial>;
  count: number;
  /** the vertex from which it is drawn */
  from: number;
  /** where it is of the programmed path, which the planned path replaces */
  programmed: ProgrammedChunk<DrawnChunk> | null;
}

export class PathScene {
  readonly #renderer: WebGLRenderer;
  readonly #camera = new OrthographicCamera(-1, 1, 1, -1, -1e6, 1e6);
  readonly #path = new Scene();
  readonly #boxes = new Scene();
  readonly #material: RawShaderMaterial;
  readonly #boxMaterial = new LineBasicMaterial({ color: 0x888888 });
  readonly #view: SceneView;
  #lines: Polyline[] = [];
  /** chunks that the graphics side has not got yet */
  #coming: { chunk: DrawnChunk; programmed: ProgrammedChunk<DrawnChunk> | null }[] = [];
  #replaced = 0;
  #vertices = 0;
  /** its shaders are compiled */
  #isReady = false;
  #isHidden = false;
  #budget = START_BUDGET;
  /** how many vertices the newest frame of a moving view drew, and when it began */
  #measured: { vertices: number; at: number } | null = null;
  /** chunks that the refinement at rest has drawn already; -1 while nothing is refined */
  #refined = -1;
  #dirty = true;
  #frame = 0;
  /** begins the refinement */
  #rest: ReturnType<typeof setTimeout> | undefined;
  #calmUntil = 0;
  #lost: ReturnType<typeof setTimeout> | undefined;
  /** The picture lacks nothing but what `replace` has removed; every line of it is drawn with this thinning. */
  #thinned = 1;
  /** draws again without what was replaced */
  #sweep: ReturnType<typeof setTimeout> | undefined;

  /** `onLost`: the graphics side is gone and does not come back. */
  constructor(canvas: HTMLCanvasElement | OffscreenCanvas, view: SceneView, onLost: () => void) {
    this.#view = view;
    this.#renderer = new WebGLRenderer({ canvas, antialias: false, alpha: true, preserveDrawingBuffer: true, powerPreference: 'low-power' });
    this.#renderer.autoClear = false;
    this.#renderer.setPixelRatio(1);
    this.#renderer.setClearColor(0, 0);
    this.#material = new RawShaderMaterial({
      glslVersion: GLSL3,
      vertexShader,
      fragmentShader,
      uniforms: { fastest: { value: 1 }, rapid: { value: new Color(0.6, 0.6, 0.6) }, byLimit: { value: false }, limits: { value: LIMIT_COLOURS.map((colour) => new Color(colour).convertLinearToSRGB()) } },
    });
    this.#camera.matrixAutoUpdate = false;
    // Where it fails the first frame compiles them.
    void this.#compile()
      .catch(() => {})
      .then(() => {
        this.#isReady = true;
        this.invalidate();
      });
    canvas.addEventListener('webglcontextlost', () => {
      clearTimeout(this.#lost);
      this.#lost = setTimeout(onLost, LOST_MS);
    });
    canvas.addEventListener('webglcontextrestored', () => {
      clearTimeout(this.#lost);
      this.invalidate();
    });
  }

  // While nobody waits for it: the shaders are compiled elsewhere, but the graphics side finishes a pipeline only when it first draws.
  async #compile(): Promise<void> {
    const sample = new Scene();
    const lines = polyline({ position: new Float32Array(6), feed: new Float32Array(2), limit: new Uint8Array(2) }, this.#material);
    lines.geometry.setIndex(indices(1));
    lines.geometry.setDrawRange(0, 2);
    sample.add(lines, new LineSegments(lines.geometry, this.#boxMaterial));
    await this.#renderer.compileAsync(sample, this.#camera);
    this.#renderer.render(sample, this.#camera);
    dispose(lines.geometry);
  }

  clear(): void {
    for (const { line } of this.#lines) dispose(line.geometry);
    this.#path.clear();
    [this.#lines, this.#coming] = [[], []];
    [this.#vertices, this.#replaced] = [0, 0];
    this.invalidate();
  }

  /** What nobody sees is not drawn. */
  hide(isHidden: boolean): void {
    this.#isHidden = isHidden;
    if (!isHidden) this.invalidate();
  }

  add(chunk: DrawnChunk): void {
    if (chunk.feed.length >= 2) this.#coming.push({ chunk, programmed: null });
    this.#wake();
  }

  /** A chunk of the programmed path: under the planned path, until that replaces it. */
  addProgrammed(programmed: ProgrammedChunk<DrawnChunk>): void {
    this.#coming.push({ chunk: programmed.chunk, programmed });
    this.#wake();
  }

  /** The planned path replaces that many vertices of the programmed one. */
  replace(count: number): void {
    if (count === this.#replaced) return;
    this.#replaced = count;
    this.#coming = this.#coming.filter(({ programmed }) => programmed === null || drawnFrom(programmed, count) !== null);
    this.#lines = this.#lines.filter((polyline) => {
      if (polyline.programmed === null) return true;
      const from = drawnFrom(polyline.programmed, count);
      this.#vertices -= (from ?? polyline.count) - polyline.from;
      if (from !== null) {
        polyline.from = from;
        return true;
      }
      this.#path.remove(polyline.line);
      dispose(polyline.line.geometry);
      return false;
    });
    this.#sweep ??= setTimeout(() => this.invalidate(), SWEEP_MS);
  }

  set fastest(mm_s: number) {
    this.#material.uniforms['fastest']!.value = Math.max(1e-3, mm_s);
  }

  #upload({ chunk, programmed }: { chunk: DrawnChunk; programmed: ProgrammedChunk<DrawnChunk> | null }): void {
    const count = chunk.feed.length;
    const line = polyline(chunk, this.#material);
    // The planned path is drawn over the programmed one.
    line.renderOrder = programmed === null ? 1 : 0;
    const from = programmed === null ? 0 : (drawnFrom(programmed, this.#replaced) ?? 0);
    this.#lines.push({ line, count, from, programmed });
    this.#path.add(line);
    this.#vertices += count - from;
  }

  setBox(box: Box | null): void {
    this.#boxes.clear();
    if (box === null) return;
    const [a, b] = [box.min, box.max];
    const corner = (i: number): [number, number, number] => [i & 1 ? b[0] : a[0], i & 2 ? b[1] : a[1], i & 4 ? b[2] : a[2]];
    const edges: number[] = [];
    for (const [from, to] of [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]] as const) {
      edges.push(...corner(from), ...corner(to));
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(new Float32Array(edges), 3));
    const segments = new LineSegments(geometry, this.#boxMaterial);
    segments.frustumCulled = false;
    this.#boxes.add(segments);
    this.invalidate();
  }

  /** Colours by feed, or by what limits the motion. */
  setColours(rapid: string, box: string, byLimit: boolean): void {
    this.#material.uniforms['byLimit']!.value = byLimit;
    this.#material.uniforms['rapid']!.value = new Color(rapid).convertLinearToSRGB();
    this.#boxMaterial.color = new Color(box);
    this.invalidate();
  }

  resize(width: number, height: number): void {
    this.#renderer.setSize(width, height, false);
    this.invalidate();
  }

  /** The view, the size or the path has changed. */
  invalidate(): void {
    this.#dirty = true;
    this.#refined = -1;
    clearTimeout(this.#rest);
    clearTimeout(this.#sweep);
    this.#sweep = undefined;
    this.#wake();
  }

  /** There is something to draw. */
  #wake(): void {
    if (this.#frame === 0 && this.#isReady && !this.#isHidden) this.#frame = requestAnimationFrame(() => this.#draw());
  }

  dispose(): void {
    this.#isHidden = true;
    cancelAnimationFrame(this.#frame);
    this.clear();
    for (const timer of [this.#rest, this.#sweep, this.#lost]) clearTimeout(timer);
    this.#material.dispose();
    this.#boxMaterial.dispose();
    this.#renderer.dispose();
  }

  #place(): void {
    const { width, height, scale, centre, basis } = this.#view;
    const camera = this.#camera;
    [camera.left, camera.right] = [-width / 2 / scale, width / 2 / scale];
    [camera.bottom, camera.top] = [-height / 2 / scale, height / 2 / scale];
    camera.updateProjectionMatrix();
    const axis = (v: readonly [number, number, number]): Vector3 => new Vector3(...v);
    camera.matrix.copy(new Matrix4().makeBasis(axis(basis.right), axis(basis.up), axis(basis.towards)));
    camera.matrix.setPosition(...centre);
    camera.matrixWorldNeedsUpdate = true;
    camera.updateMatrixWorld(true);
  }

  #thinning(): number {
    return THINNINGS.find((thinning) => this.#vertices / thinning <= this.#budget) ?? THINNINGS.at(-1)!;
  }

  #draw(): void {
    this.#frame = 0;
    const now = performance.now();
    // What the last frame of a moving view took tells how many vertices the next one may have.
    if (this.#measured !== null) {
      const took = now - this.#measured.at;
      if (took > SLOW_MS) [this.#budget, this.#calmUntil] = [Math.max(5_000, this.#budget * 0.7), now + CALM_MS];
      else if (took < FAST_MS && now > this.#calmUntil && this.#measured.vertices > 0.5 * this.#budget) this.#budget = Math.min(2e6, this.#budget * 1.3);
      this.#measured = null;
    }
    const renderer = this.#renderer;
    const next = this.#coming.shift();
    if (next !== undefined) this.#upload(next);
    this.#place();
    if (this.#dirty) {
      this.#dirty = false;
      renderer.clear();
      renderer.render(this.#boxes, this.#camera);
      const thinning = this.#thinning();
      this.#thinned = thinning;
      this.#show(0, this.#lines.length, thinning);
      this.#measured = { vertices: this.#vertices / thinning, at: now };
      clearTimeout(this.#rest);
      if (thinning > 1) this.#rest = setTimeout(() => this.#refine(), REST_MS);
    } else if (this.#refined >= 0) {
      let count = 0;
      let end = this.#refined;
      while (end < this.#lines.length && count < this.#budget) {
        count += this.#lines[end]!.count;
        end += 1;
      }
      this.#show(this.#refined, end, 1);
      this.#refined = end < this.#lines.length ? end : -1;
      if (this.#refined < 0) this.#thinned = 1;
    } else if (next !== undefined) {
      // A picture at rest gets what is new, and keeps the rest.
      this.#show(this.#lines.length - 1, this.#lines.length, this.#thinned);
    } else {
      return;
    }
    const isDone = this.#refined < 0 && this.#measured === null && this.#coming.length === 0;
    if (!isDone && !this.#isHidden) this.#frame = requestAnimationFrame(() => this.#draw());
  }

  #refine(): void {
    this.#refined = 0;
    if (this.#frame === 0 && !this.#isHidden) this.#frame = requestAnimationFrame(() => this.#draw());
  }

  #show(begin: number, end: number, thinning: number): void {
    this.#lines.forEach(({ line, count, from }, at) => {
      line.visible = at >= begin && at < end;
      if (!line.visible) return;
      const first = indexOf(from, thinning);
      line.geometry.setIndex(indices(thinning));
      line.geometry.setDrawRange(first, indexCount(count, thinning) - first);
    });
    this.#renderer.render(this.#path, this.#camera);
  }
}
