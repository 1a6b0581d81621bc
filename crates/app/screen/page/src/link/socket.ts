// A WebSocket that comes back by itself. What was sent on one that is gone is never sent again.

import type { LinkLoss } from './incoming';

const FIRST_PAUSE_MS = 250;
const MAX_PAUSE_MS = 4000;
/** The server sends something at least twice in this time; a link that is silent for it is dead, whatever TCP says. */
const SILENCE_MS = 3000;

export interface SocketEvents {
  opened(): void;
  text(message: string): void;
  binary(message: ArrayBuffer): void;
  /** `final`: the server will not have this page; it is not tried again until the operator reloads. */
  lost(loss: LinkLoss, final: boolean): void;
}

/** After this time without a reply the service has probably ended. */
const SILENT_MS = 10_000;

/** Close codes of RFC 6455 4.4.2 that are an application's own: refused for good. */
const REFUSED_FROM = 4000;

export class Socket {
  readonly #url: string;
  readonly #events: SocketEvents;
  #socket: WebSocket | null = null;
  #pause = FIRST_PAUSE_MS;
  #timer = 0;
  #heard = 0;
  /** since when there is no connection */
  #lostAt: number | null = null;
  #ended: LinkLoss | null = null;

  constructor(url: string, events: SocketEvents) {
    this.#url = url;
    this.#events = events;
    window.addEventListener('online', () => this.#soon());
    document.addEventListener('visibilitychange', () => {
      if (!document.hidden) this.#soon();
    });
    window.setInterval(() => this.#watch(), SILENCE_MS / 3);
  }

  open(): void {
    clearTimeout(this.#timer);
    this.#timer = 0;
    const socket = new WebSocket(this.#url);
    socket.binaryType = 'arraybuffer';
    this.#socket = socket;
    this.#heard = performance.now();
    let isOpen = false;
    socket.onopen = () => {
      isOpen = true;
      this.#ended = null;
      if (socket === this.#socket) this.#events.opened();
    };
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (socket !== this.#socket) return;
      this.#heard = performance.now();
      this.#pause = FIRST_PAUSE_MS;
      this.#lostAt = null;
      if (typeof event.data === 'string') this.#events.text(event.data);
      else this.#events.binary(event.data);
    };
    socket.onclose = (event) => {
      if (socket !== this.#socket) return;
      if (event.code >= REFUSED_FROM) this.#gone('refused', true);
      else if (isOpen || this.#ended === 'run') this.#gone(this.#ended ?? 'closed', this.#ended === 'run');
      else void this.#ask();
    };
  }

  /** Whether it went out. */
  send(message: string): boolean {
    if (this.#socket?.readyState !== WebSocket.OPEN) return false;
    this.#socket.send(message);
    return true;
  }

  /** The server has said that it ends: what it shows is over, or only the service of now. */
  end(loss: 'run' | 'service'): void {
    this.#ended = loss;
  }

  /** A browser tells nothing of a refused handshake. What the page's own address gives tells whether its key is known. */
  async #ask(): Promise<void> {
    const asking = this.#socket;
    let status = 0;
    try {
      status = (await fetch(location.href, { cache: 'no-store', signal: AbortSignal.timeout(SILENCE_MS) })).status;
    } catch {
      // No reply.
    }
    if (asking !== this.#socket) return;
    const isSilent = this.#lostAt !== null && performance.now() - this.#lostAt > SILENT_MS;
    if (status === 404 || status === 403) this.#gone('renewed', true);
    else this.#gone(this.#ended ?? (isSilent ? 'silent' : 'closed'), false);
  }

  #gone(loss: LinkLoss, final: boolean): void {
    this.#socket = null;
    this.#lostAt ??= performance.now();
    this.#events.lost(loss, final);
    if (final) return;
    this.#timer = window.setTimeout(() => this.open(), this.#pause);
    this.#pause = Math.min(MAX_PAUSE_MS, 2 * this.#pause);
  }

  #soon(): void {
    if (this.#timer !== 0) this.open();
  }

  #watch(): void {
    // A hidden page's timers are held back: there silence says nothing.
    if (this.#socket === null || document.hidden || performance.now() - this.#heard < SILENCE_MS) return;
    const silent = this.#socket;
    this.#socket = null;
    silent.close();
    this.#gone('closed', false);
  }
}
