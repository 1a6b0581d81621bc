// What `evolvent chatter CASE.toml --json` gives, as curves over spindle speed.

export interface ChatterAnswer {
  case: string;
  description: string;
  oscillation: {
    speed_m_min: number;
    speed_rpm: number | null;
    sweep: { speed_m_min: number; verdict: string | null; cycles: { amplitude_mm: number; stable: boolean }[] }[];
  } | null;
  lobes: {
    kind: 'turning' | 'milling';
    max_depth_mm: number;
    points: { speed_rpm: number; method: string; limit_mm: number | null; exact_limit_mm: number | null }[];
    notes: string[];
  }[];
}

export interface Curve {
  kind: 'turning' | 'milling' | 'oscillation';
  /** depths up to the curve are stable; else it is how strongly the cut vibrates */
  isLimit: boolean;
  from: number;
  to: number;
  most: number;
  /** rpm and mm; null where there is none */
  points: [number, number | null][];
  /** where it says less than it seems to */
  notes: string[];
}

export function curvesOf(answer: ChatterAnswer): Curve[] {
  const curves: Curve[] = answer.lobes.map(({ kind, max_depth_mm: most, points, notes }) => ({
    kind,
    isLimit: true,
    from: points[0]?.speed_rpm ?? 0,
    to: points.at(-1)?.speed_rpm ?? 1,
    most,
    // Without a limit no depth up to the largest that was looked at chatters.
    points: points.map((point) => [point.speed_rpm, (point.method === 'delay-equation' ? point.exact_limit_mm : point.limit_mm) ?? most]),
    notes,
  }));
  const oscillation = answer.oscillation;
  if (oscillation !== null && oscillation.speed_rpm !== null && oscillation.sweep.length > 1) {
    const perSpeed = oscillation.speed_rpm / oscillation.speed_m_min;
    const points = oscillation.sweep.map(({ speed_m_min: speed, cycles }): [number, number | null] => {
      const stable = cycles.filter((cycle) => cycle.stable).map((cycle) => cycle.amplitude_mm);
      return [speed * perSpeed, stable.length > 0 ? Math.max(...stable) : null];
    });
    const most = Math.max(1e-6, ...points.map(([, value]) => value ?? 0)) * 1.1;
    curves.push({ kind: 'oscillation', isLimit: false, from: points[0]![0], to: points.at(-1)![0], most, points, notes: [] });
  }
  return curves;
}

/** The curve at a speed, straight between its points; null where it has none. */
export function limitAt(curve: Curve, rpm: number): number | null {
  const next = curve.points.findIndex(([speed]) => speed >= rpm);
  if (next < 0 || rpm < curve.from) return null;
  const [x1, y1] = curve.points[next]!;
  const [x0, y0] = curve.points[Math.max(0, next - 1)]!;
  if (y0 === null || y1 === null) return x1 === rpm ? y1 : null;
  // Towards a point without a limit nothing is known of how the limit rises.
  if (curve.isLimit && x1 !== rpm && Math.max(y0, y1) >= curve.most) return Math.min(y0, y1);
  return x1 > x0 ? y0 + ((y1 - y0) * (rpm - x0)) / (x1 - x0) : y1;
}
