// Turning, moving and zooming a view by fingers, mouse and keys.
import type { View } from './view';

/** How far a press may slip and still choose a point, px. */
const SLIP = 6;
const KEY_STEP = 20;

export class Fingers {
  readonly #view: View;
  readonly #changed: () => void;
  readonly #choose: (x: number, y: number) => void;
  readonly #fit: () => void;
  readonly #down = new Map<number, { x: number; y: number; pans: boolean }>();
  #pressed: { x: number; y: number } | null = null;

  constructor(view: View, on: { changed: () => void; choose: (x: number, y: number) => void; fit: () => void }) {
    this.#view = view;
    this.#changed = on.changed;
    this.#choose = on.choose;
    this.#fit = on.fit;
  }

  readonly down = (event: PointerEvent): void => {
    this.#pressed = this.#down.size === 0 && event.button === 0 ? { x: event.offsetX, y: event.offsetY } : null;
    (event.currentTarget as HTMLElement).setPointerCapture(event.pointerId);
    this.#down.set(event.pointerId, { x: event.offsetX, y: event.offsetY, pans: event.button !== 0 || event.shiftKey });
  };

  // One finger turns (in the plan: moves), two move and zoom.
  readonly move = (event: PointerEvent): void => {
    const view = this.#view;
    const finger = this.#down.get(event.pointerId);
    if (finger === undefined) return;
    const other = [...this.#down].find(([id]) => id !== event.pointerId)?.[1];
    const [dx, dy] = [event.offsetX - finger.x, event.offsetY - finger.y];
    if (this.#pressed !== null) {
      // A finger that trembles neither turns nor moves.
      if (Math.hypot(event.offsetX - this.#pressed.x, event.offsetY - this.#pressed.y) <= SLIP) return;
      this.#pressed = null;
    }
    if (other !== undefined) {
      const before = Math.hypot(finger.x - other.x, finger.y - other.y);
      const after = Math.hypot(event.offsetX - other.x, event.offsetY - other.y);
      view.pan(dx / 2, dy / 2);
      if (before > 10) view.zoom(after / before, (event.offsetX + other.x) / 2, (event.offsetY + other.y) / 2);
    } else if (finger.pans) view.pan(dx, dy);
    else view.orbit(dx, dy);
    [finger.x, finger.y] = [event.offsetX, event.offsetY];
    this.#changed();
  };

  readonly up = (event: PointerEvent): void => {
    this.#down.delete(event.pointerId);
    // A press that did not move chooses what is there.
    if (this.#pressed !== null && event.type === 'pointerup') this.#choose(event.offsetX, event.offsetY);
    this.#pressed = null;
  };

  readonly wheel = (event: WheelEvent): void => {
    event.preventDefault();
    this.#view.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    this.#changed();
  };

  readonly key = (event: KeyboardEvent): void => {
    const view = this.#view;
    const moves: Record<string, () => void> = {
      ArrowLeft: () => (event.shiftKey ? view.pan(KEY_STEP, 0) : view.orbit(-KEY_STEP, 0)),
      ArrowRight: () => (event.shiftKey ? view.pan(-KEY_STEP, 0) : view.orbit(KEY_STEP, 0)),
      ArrowUp: () => (event.shiftKey ? view.pan(0, KEY_STEP) : view.orbit(0, -KEY_STEP)),
      ArrowDown: () => (event.shiftKey ? view.pan(0, -KEY_STEP) : view.orbit(0, KEY_STEP)),
      '+': () => view.zoom(1.2, view.width / 2, view.height / 2),
      '-': () => view.zoom(1 / 1.2, view.width / 2, view.height / 2),
      Home: this.#fit,
    };
    const act = moves[event.key];
    if (act === undefined) return;
    event.preventDefault();
    act();
    this.#changed();
  };
}
