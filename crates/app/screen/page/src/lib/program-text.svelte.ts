// The lines of the loaded program that are in sight; a worker holds all of them.
import type { TextReply, TextRequest } from '../workers/text.worker';

/** lines that are kept around those in sight */
const MARGIN = 60;

class ProgramText {
  lines = $state(0);
  bytes = $state(0);
  complete = $state(true);
  failed = $state('');
  #window = $state.raw<{ from: number; lines: string[] }>({ from: 0, lines: [] });
  #worker: Worker | null = null;
  #url = '';
  #id = 0;
  #wanted = { from: 0, count: 0 };

  /** Loads the text from `url`; an empty one empties the list. */
  load(url: string): void {
    if (url === this.#url && url !== '') return;
    this.#url = url;
    [this.lines, this.bytes, this.failed] = [0, 0, ''];
    this.#window = { from: 0, lines: [] };
    this.complete = url === '';
    this.#send(url === '' ? { kind: 'clear' } : { kind: 'load', url: new URL(url, document.baseURI).href });
  }

  /** Lines that are in sight, counted from 0. */
  want(from: number, count: number): void {
    const { from: have, lines } = this.#window;
    this.#wanted = { from, count };
    const end = Math.min(this.lines, from + count);
    if (from >= have && end <= have + lines.length) return;
    this.#id += 1;
    this.#send({ kind: 'lines', from: Math.max(0, from - MARGIN), count: count + 2 * MARGIN, id: this.#id });
  }

  /** Text of a line, counted from 1; empty until it is here. */
  text(line: number): string {
    return this.#window.lines[line - 1 - this.#window.from] ?? '';
  }

  #send(request: TextRequest): void {
    if (this.#worker === null) {
      this.#worker = new Worker(new URL('../workers/text.worker.ts', import.meta.url), { type: 'module', name: 'text' });
      this.#worker.onmessage = (event: MessageEvent<TextReply>) => this.#take(event.data);
    }
    this.#worker.postMessage(request);
  }

  #take(reply: TextReply): void {
    switch (reply.kind) {
      case 'size':
        [this.lines, this.bytes, this.complete] = [reply.lines, reply.bytes, reply.complete];
        this.want(this.#wanted.from, this.#wanted.count);
        break;
      case 'lines':
        if (reply.id === this.#id) this.#window = { from: reply.from, lines: reply.lines };
        break;
      case 'failed':
        this.failed = reply.text;
        this.complete = true;
        // The same text is read again when the server tells of it again, as on every connection.
        this.#url = '';
        break;
    }
  }
}

export const programText = new ProgramText();
