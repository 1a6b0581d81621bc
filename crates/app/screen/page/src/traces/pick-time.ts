import type { View } from '../path/view';
import type { RunData } from './run-data';

/** How near to the finger a point of the path has to be, px. */
const REACH = 24;
/** Places whose distances differ by less are one place: then the time counts, px. */
const SAME = 2;

/**
 * The cycle at the point of the trail, from entry `begin` up to `end`, that is nearest to a point of the screen. Where the tool came by
 * several times, the time nearest to `present` is meant. Null where nothing is near.
 */
export function nearest(trail: RunData['trail'], begin: number, end: number, view: View, x: number, y: number, present: number): number | null {
  const basis = view.basis;
  let [best, found]: [number, number | null] = [Infinity, null];
  let [ax, ay] = [NaN, NaN];
  for (let i = begin; i < end; i += 1) {
    const [bx, by] = view.project(trail.position[3 * i]!, trail.position[3 * i + 1]!, trail.position[3 * i + 2]!, basis);
    if (i > begin) {
      const [ex, ey] = [bx - ax, by - ay];
      const length = ex * ex + ey * ey;
      const part = length > 0 ? Math.min(1, Math.max(0, ((x - ax) * ex + (y - ay) * ey) / length)) : 1;
      const distance = Math.hypot(ax + part * ex - x, ay + part * ey - y);
      if (distance <= REACH) {
        const at = trail.sequence[i - 1]! + part * (trail.sequence[i]! - trail.sequence[i - 1]!);
        const isNearer: boolean = distance < best - SAME;
        const isSame: boolean = Math.abs(distance - best) <= SAME && found !== null;
        if (found === null || isNearer || (isSame && Math.abs(at - present) < Math.abs(found - present))) {
          [best, found] = [isSame ? Math.min(best, distance) : distance, at];
        }
      }
    }
    [ax, ay] = [bx, by];
  }
  return found;
}
