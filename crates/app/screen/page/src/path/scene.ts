// The programmed path in WebGL. Vertices come in chunks and stay on the graphics side; while the view moves only as many of
// them are drawn as a frame can take, and when it is at rest the rest is drawn in slices, so that no frame takes long.
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
import { LIMIT_COLOURS, type PathChunk } from './chunk';
import type { Box, View } from './view';

const STRIDES = [1, 4, 16, 64, 256];
/** tuned: 20k to 500k; at 100k a software renderer on two cores takes 15 to 30 ms a frame */
const START_BUDGET = 100_000;
const FRAME_MS = 28;

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

/** Every `stride`-th vertex and the last: indices are shared by all chunks of a length. */
const indexCache = new Map<string, BufferAttribute>();
function indices(count: number, stride: number): BufferAttribute {
  const key = `${count}/${stride}`;
  let found = indexCache.get(key);
  if (found === undefined) {
    const length = Math.floor((count - 1) / stride) + 1;
    const list = new Uint16Array((count - 1) % stride === 0 ? length : length + 1);
    for (let i = 0; i < length; i += 1) list[i] = i * stride;
    list[list.length - 1] = count - 1;
    found = new BufferAttribute(list, 1);
    indexCache.set(key, found);
  }
  return found;
}

export class PathScene {
  readonly #renderer: WebGLRenderer;
  readonly #camera = new OrthographicCamera(-1, 1, 1, -1, -1e6, 1e6);
  readonly #path = new Scene();
  readonly #boxes = new Scene();
  readonly #material: RawShaderMaterial;
  readonly #boxMaterial = new LineBasicMaterial({ color: 0x888888 });
  readonly #view: View;
  #lines: Line<BufferGeometry, RawShaderMaterial>[] = [];
  #vertices = 0;
  #fastest = 1e-3;
  #budget = START_BUDGET;
  /** how many vertices the newest slice drew, and when it began */
  #measured: { vertices: number; at: number } | null = null;
  /** chunks that the refinement at rest has drawn already; -1 while nothing is refined */
  #refined = -1;
  #dirty = true;
  #frame = 0;
  readonly #drawn: () => void;

  constructor(canvas: HTMLCanvasElement, view: View, drawn: () => void) {
    this.#view = view;
    this.#drawn = drawn;
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
  }

  get fastest(): number {
    return this.#fastest;
  }

  get vertices(): number {
    return this.#vertices;
  }

  clear(): void {
    for (const line of this.#lines) line.geometry.dispose();
    this.#path.clear();
    this.#lines = [];
    this.#vertices = 0;
    this.#fastest = 1e-3;
    this.invalidate();
  }

  add(chunk: PathChunk): void {
    const count = chunk.feed.length;
    if (count < 2) return;
    const geometry = new BufferGeometry();
    geometry.setAttribute('position', new BufferAttribute(chunk.position, 3));
    geometry.setAttribute('feed', new BufferAttribute(chunk.feed, 1));
    geometry.setAttribute('limit', new BufferAttribute(chunk.limit, 1));
    geometry.setIndex(indices(count, 1));
    const line = new Line(geometry, this.#material);
    line.frustumCulled = false;
    line.matrixAutoUpdate = false;
    for (const feed of chunk.feed) if (feed > this.#fastest) this.#fastest = feed;
    this.#material.uniforms['fastest']!.value = this.#fastest;
    this.#lines.push(line);
    this.#path.add(line);
    this.#vertices += count;
    this.invalidate();
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

  /** Colours by what limits the motion, or by feed. */
  colourByLimit(on: boolean): void {
    this.#material.uniforms['byLimit']!.value = on;
    this.invalidate();
  }

  setColours(rapid: string, box: string): void {
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
    if (this.#frame === 0) this.#frame = requestAnimationFrame(() => this.#draw());
  }

  dispose(): void {
    cancelAnimationFrame(this.#frame);
    this.clear();
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

  #stride(): number {
    return STRIDES.find((stride) => this.#vertices / stride <= this.#budget) ?? STRIDES.at(-1)!;
  }

  #draw(): void {
    this.#frame = 0;
    const now = performance.now();
    // What the last slice took tells how many vertices the next one may have.
    if (this.#measured !== null) {
      const took = now - this.#measured.at;
      if (took < 200) {
        if (took > FRAME_MS * 1.3) this.#budget = Math.max(10_000, this.#budget * 0.7);
        else if (took < FRAME_MS && this.#measured.vertices > 0.5 * this.#budget) this.#budget = Math.min(2e6, this.#budget * 1.3);
      }
      this.#measured = null;
    }
    const renderer = this.#renderer;
    this.#place();
    if (this.#dirty) {
      this.#dirty = false;
      renderer.clear();
      renderer.render(this.#boxes, this.#camera);
      const stride = this.#stride();
      this.#show(0, this.#lines.length, stride);
      this.#measured = { vertices: this.#vertices / stride, at: now };
      this.#refined = stride === 1 ? -1 : 0;
      this.#drawn();
    } else if (this.#refined >= 0) {
      let count = 0;
      let end = this.#refined;
      while (end < this.#lines.length && count < this.#budget) {
        count += this.#lines[end]!.geometry.getAttribute('position').count;
        end += 1;
      }
      this.#show(this.#refined, end, 1);
      this.#measured = { vertices: count, at: now };
      this.#refined = end < this.#lines.length ? end : -1;
    } else {
      return;
    }
    if (this.#refined >= 0 || this.#measured !== null) this.#frame = requestAnimationFrame(() => this.#draw());
  }

  #show(begin: number, end: number, stride: number): void {
    this.#lines.forEach((line, at) => {
      line.visible = at >= begin && at < end;
      if (!line.visible) return;
      const count = line.geometry.getAttribute('position').count;
      line.geometry.setIndex(indices(count, stride));
    });
    this.#renderer.render(this.#path, this.#camera);
  }
}
