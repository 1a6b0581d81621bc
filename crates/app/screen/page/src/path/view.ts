// How a point of the machine comes to a point of the screen: parallel projection, Z (on a lathe X) up.

export type Vector = readonly [number, number, number];

export interface Box {
  min: [number, number, number];
  max: [number, number, number];
}

export interface Basis {
  right: Vector;
  up: Vector;
  /** from the scene towards the eye */
  towards: Vector;
}

export function emptyBox(): Box {
  return { min: [Infinity, Infinity, Infinity], max: [-Infinity, -Infinity, -Infinity] };
}

export function isEmpty(box: Box): boolean {
  return !(box.min[0] <= box.max[0]);
}

export class View {
  width = 1;
  height = 1;
  centre: [number, number, number] = [0, 0, 0];
  /** px per mm */
  scale = 1;
  azimuth = -0.7;
  elevation = 0.6;
  plan = false;
  lathe = false;

  get basis(): Basis {
    if (this.lathe && this.plan) return { right: [0, 0, 1], up: [1, 0, 0], towards: [0, 1, 0] };
    const azimuth = this.plan ? 0 : this.azimuth;
    const elevation = this.plan ? Math.PI / 2 : this.elevation;
    const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
    return { right: [ca, sa, 0], up: [-se * sa, se * ca, ce], towards: [ce * sa, -ce * ca, se] };
  }

  project(x: number, y: number, z: number, basis: Basis): [number, number] {
    const { right: r, up: u } = basis;
    const [dx, dy, dz] = [x - this.centre[0], y - this.centre[1], z - this.centre[2]];
    return [
      this.width / 2 + (dx * r[0] + dy * r[1] + dz * r[2]) * this.scale,
      this.height / 2 - (dx * u[0] + dy * u[1] + dz * u[2]) * this.scale,
    ];
  }

  fit(box: Box): void {
    if (isEmpty(box)) return;
    this.centre = [0, 1, 2].map((i) => (box.min[i]! + box.max[i]!) / 2) as [number, number, number];
    const basis = this.basis;
    let [across, high] = [0, 0];
    for (const x of [box.min[0], box.max[0]]) {
      for (const y of [box.min[1], box.max[1]]) {
        for (const z of [box.min[2], box.max[2]]) {
          const d = [x - this.centre[0], y - this.centre[1], z - this.centre[2]];
          const along = (v: Vector): number => Math.abs(d[0]! * v[0] + d[1]! * v[1] + d[2]! * v[2]);
          across = Math.max(across, along(basis.right));
          high = Math.max(high, along(basis.up));
        }
      }
    }
    const margin = 0.88;
    this.scale = Math.min((margin * this.width) / 2 / Math.max(across, 1e-3), (margin * this.height) / 2 / Math.max(high, 1e-3));
  }

  pan(dx: number, dy: number): void {
    const { right: r, up: u } = this.basis;
    for (const i of [0, 1, 2] as const) this.centre[i] += (-dx * r[i] + dy * u[i]) / this.scale;
  }

  orbit(dx: number, dy: number): void {
    if (this.plan) {
      this.pan(dx, dy);
      return;
    }
    this.azimuth -= dx * 0.008;
    this.elevation = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, this.elevation + dy * 0.008));
  }

  /** Zooms by `factor` so that what is at (x, y) stays there. */
  zoom(factor: number, x: number, y: number): void {
    const limited = Math.min(1e5, Math.max(1e-3, this.scale * factor)) / this.scale;
    const [dx, dy] = [x - this.width / 2, y - this.height / 2];
    this.pan(dx * (1 / limited - 1), dy * (1 / limited - 1));
    this.scale *= limited;
  }
}
