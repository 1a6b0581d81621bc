// A jog goes on only while somebody holds it. The core stops the axes 90 ms after the last keep-alive of the client that started
// the jog, so nothing here is trusted for safety: what this adds is that the stop is sent at once where the page notices.
import { isHeldProgram } from './held';
import type { AxisValue, Command } from './model';
import { session } from './session.svelte';

/** Keep-alives come three times in the core's 90 ms. */
const KEEP_MS = 25;

let held: { key: string; timer: number } | null = null;

/** A jog, in manual mode; a held program is left in the mode in which it runs. */
export function order(command: Command): Promise<boolean> {
  return isHeldProgram(session.status) ? session.sendAll([command]) : session.inMode('manual', command);
}

/** Starts a jog that goes on until `release`. `key` says what holds it: a button, a key, the pad. */
export async function hold(key: string, values: AxisValue[], speed: number): Promise<void> {
  if (!session.mayCommand || document.hidden) return;
  if (held !== null && held.key !== key) release(held.key);
  if (held === null) {
    const timer = window.setInterval(() => session.source?.keep(), KEEP_MS);
    held = { key, timer };
  }
  const mine = held;
  const started = await order({ name: 'jog', values, speed });
  // Released while the mode was changing: the core has the jog now and must lose it.
  if (held !== mine) void session.send({ name: 'jog_stop' });
  else if (!started) release(key);
}

/** Another direction or speed of the jog that is held, without a stop in between. */
export function steer(key: string, values: AxisValue[], speed: number): void {
  if (held?.key !== key) return;
  void session.send({ name: 'jog', values, speed }).then((answer) => {
    if (!answer.accepted) release(key);
  });
}

export function isHeld(key?: string): boolean {
  return key === undefined ? held !== null : held?.key === key;
}

/** Ends the jog that `key` holds, or any. */
export function release(key?: string): void {
  if (held === null || (key !== undefined && held.key !== key)) return;
  clearInterval(held.timer);
  held = null;
  void session.send({ name: 'jog_stop' });
}

/** Whatever takes the operator's eyes or fingers off the page ends a jog. */
export function watchForLoss(): void {
  window.addEventListener('blur', () => release());
  window.addEventListener('pagehide', () => release());
  window.addEventListener('freeze', () => release());
  document.addEventListener('visibilitychange', () => {
    if (document.hidden) release();
  });
  // Wherever the finger is lifted, and whether or not what it pressed still hears of it.
  for (const type of ['pointerup', 'pointercancel'] as const) {
    window.addEventListener(type, (event) => release(`button-${event.pointerId}`), { capture: true });
  }
  window.addEventListener('contextmenu', (event) => {
    if (held !== null) event.preventDefault();
  });
}

/** Without a connection there is nobody to send a stop to; the core has stopped by itself. */
export function dropWithoutLink(): void {
  if (held === null) return;
  clearInterval(held.timer);
  held = null;
}
