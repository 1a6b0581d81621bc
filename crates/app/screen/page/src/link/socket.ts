// A WebSocket that comes back by itself. What was sent on one that is gone is never sent again.

const FIRST_PAUSE_MS = 250;
const MAX_PAUSE_MS = 4000;
/** The server sends something at least twice in this time; a link that is silent for it is dead, whatever TCP says. */
const SILENCE_MS = 3000;

export interface SocketEvents {
  opened(): void;
  text(message: string): void;
  binary(message: ArrayBuffer): void;
  /** `final`: the server will not have this page; it is not tried again until the operator reloads. */
  lost(reason: string, final: boolean): void;
}

/** Close codes of RFC 6455 4.4.2 that are an application's own: refused for good. */
const REFUSED_FROM = 4000;

export class Socket {
  readonly #url: string;
  readonly #events: SocketEvents;
  #socket: WebSocket | null = null;
  #pause = FIRST_PAUSE_MS;
  #timer = 0;
  #heard = 0;

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
    socket.onopen = () => {
      if (socket === this.#socket) this.#events.opened();
    };
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (socket !== this.#socket) return;
      this.#heard = performance.now();
      this.#pause = FIRST_PAUSE_MS;
      if (typeof event.data === 'string') this.#events.text(event.data);
      else this.#events.binary(event.data);
    };
    socket.onclose = (event) => {
      if (socket === this.#socket) this.#gone(event.reason, event.code >= REFUSED_FROM);
    };
  }

  /** Whether it went out. */
  send(message: string): boolean {
    if (this.#socket?.readyState !== WebSocket.OPEN) return false;
    this.#socket.send(message);
    return true;
  }

  #gone(reason: string, final: boolean): void {
    this.#socket = null;
    this.#events.lost(reason, final);
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
    this.#gone('', false);
  }
}
