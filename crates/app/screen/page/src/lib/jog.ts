// A jog goes on only while somebody holds it. The core stops the axes 90 ms after the last keep-alive of the client that started
// the jog, so nothing here is trusted for safety: what this adds is that the stop is sent at once where the page notices.
import { excursionMoves, isHeldProgram } from './held';
import type { AxisValue, Command, Status } from './model';
import { session } from './session.svelte';

/** Keep-alives come three times in the core's 90 ms. */
const KEEP_MS = 25;
/** A status that comes later than this after the core's answer shows the jog; on one that comes earlier it may not have begun. */
const SETTLE_MS = 150;

interface Held {
  key: string;
  timer: number;
  /** when the core's answer came */
  acceptedAt: number | null;
}

/** What is pressed, and has not been released since. Only a new press of a finger or key sets it. */
let armed: string | null = null;
let held: Held | null = null;

/** A jog by a distance, in manual mode; a held program is left in the mode in which it runs. */
export function order(command: Command): Promise<boolean> {
  return isHeldProgram(session.status) ? session.sendAll([command]) : session.inMode('manual', command);
}

/** A finger or key presses `key`: from here to `release` it may hold jogs. */
export function arm(key: string): void {
  release();
  if (session.mayCommand && !document.hidden) armed = key;
}

export function isArmed(key: string): boolean {
  return armed === key;
}

/** Starts a jog that goes on until `pause` or `release` of what is pressed. */
export async function hold(key: string, values: AxisValue[], speed: number): Promise<void> {
  if (armed !== key || held !== null || !session.mayCommand) return;
  const timer = window.setInterval(() => session.source?.keep(), KEEP_MS);
  const mine: Held = { key, timer, acceptedAt: null };
  held = mine;
  if (session.status?.mode !== 'manual' && !isHeldProgram(session.status)) {
    const { accepted } = await session.send({ name: 'mode', mode: 'manual' });
    // Released while the mode was changing: the jog is not sent.
    if (held !== mine) return;
    if (!accepted) return release(key);
  }
  const { accepted } = await session.send({ name: 'jog', values, speed });
  if (held === mine && !accepted) release(key);
  mine.acceptedAt ??= performance.now();
}

/** Another direction or speed of the jog that is held, without a stop in between. */
export function steer(key: string, values: AxisValue[], speed: number): void {
  const mine = held;
  // The core has to have the jog that is changed.
  if (armed !== key || mine?.key !== key || mine.acceptedAt === null) return;
  // A Stop of somebody else may be on its way here: then the core has no jog that could be changed.
  const steers = performance.now() - mine.acceptedAt > SETTLE_MS;
  void session.send({ name: 'jog', values, speed, steers }).then((answer) => {
    if (!answer.accepted && held === mine) release(key);
  });
}

export function isHeld(key?: string): boolean {
  return key === undefined ? held !== null : held?.key === key;
}

/** Ends the jog that `key` holds; the finger is still on it and may hold another one. */
export function pause(key: string): void {
  if (held?.key !== key) return;
  clearInterval(held.timer);
  held = null;
  void session.send({ name: 'jog_stop' });
}

/** Ends the jog that `key` holds, or any: the next one needs a new press. */
export function release(key?: string): void {
  if (key === undefined || armed === key) armed = null;
  if (held !== null && (key === undefined || held.key === key)) pause(held.key);
}

/**
 * The name of a key that is pressed: of the key itself, because what it means changes while it is down (the 6 of a keypad is an arrow until
 * NumLock or Shift comes).
 */
export function keyOf(event: KeyboardEvent): string {
  return `key-${event.code || event.key}`;
}

/** Ends the jog that a key holds, whichever it is. */
export function releaseKey(): void {
  if (armed?.startsWith('key-') || held?.key.startsWith('key-')) release();
}

/** Who holds a jog that has ended, by Stop of another page or at the end of the travel, starts none by holding on. */
export function follow(status: Status | null): void {
  if (held === null || held.acceptedAt === null || performance.now() - held.acceptedAt < SETTLE_MS) return;
  if (status?.activity !== 'jog' && !excursionMoves(status)) release();
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
  // Not every release of a key is told: macOS tells none while Cmd is down. So any that is released ends the jog, and any other that is pressed.
  window.addEventListener('keyup', releaseKey, { capture: true });
  window.addEventListener(
    'keydown',
    (event) => {
      if (keyOf(event) !== (armed ?? held?.key)) releaseKey();
    },
    { capture: true },
  );
  window.addEventListener('contextmenu', (event) => {
    if (held !== null) event.preventDefault();
  });
}

/** Without a connection there is nobody to send a stop to; the core has stopped by itself. */
export function dropWithoutLink(): void {
  armed = null;
  if (held === null) return;
  clearInterval(held.timer);
  held = null;
}
