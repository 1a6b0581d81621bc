// Holds the text of the program, whatever its length, and gives the lines that are looked at. Nothing of 50 MB comes to the
// thread that draws.

export type TextRequest = { kind: 'load'; url: string } | { kind: 'lines'; from: number; count: number; id: number } | { kind: 'clear' };
export type TextReply =
  | { kind: 'size'; lines: number; bytes: number; complete: boolean }
  | { kind: 'lines'; from: number; lines: string[]; id: number }
  | { kind: 'failed'; text: string };

const NEWLINE = 10;
/** lines are cut there: nothing wider is shown */
const MAX_LINE = 2000;
const REPORT_MS = 200;

let text = new Uint8Array(0);
let used = 0;
/** byte at which each line begins */
let starts = new Uint32Array(1024);
let lines = 0;
let generation = 0;
let reading = new AbortController();
const decoder = new TextDecoder();

function reply(message: TextReply): void {
  postMessage(message);
}

function append(chunk: Uint8Array): void {
  if (used + chunk.length > text.length) {
    const wider = new Uint8Array(Math.max(1 << 20, 2 * text.length, used + chunk.length));
    wider.set(text.subarray(0, used));
    text = wider;
  }
  text.set(chunk, used);
  for (let at = chunk.indexOf(NEWLINE); at >= 0; at = chunk.indexOf(NEWLINE, at + 1)) begin(used + at + 1);
  used += chunk.length;
}

function begin(at: number): void {
  if (lines === starts.length) {
    const wider = new Uint32Array(2 * starts.length);
    wider.set(starts);
    starts = wider;
  }
  starts[lines] = at;
  lines += 1;
}

/** A newline at the end does not begin another line. */
function count(): number {
  return lines > 0 && starts[lines - 1] === used ? lines - 1 : lines;
}

/** Gives up what is being read; the number of what is read from here on. */
function forget(): number {
  reading.abort();
  reading = new AbortController();
  generation += 1;
  return generation;
}

async function load(url: string): Promise<void> {
  const mine = forget();
  [text, used, lines] = [new Uint8Array(0), 0, 0];
  begin(0);
  const response = await fetch(url, { signal: reading.signal }).catch((error: unknown) => error);
  if (mine !== generation) return;
  if (!(response instanceof Response)) throw response;
  if (!response.ok || response.body === null) {
    reply({ kind: 'failed', text: `${response.status} ${response.statusText}` });
    return;
  }
  const reader = response.body.getReader();
  let reported = 0;
  for (;;) {
    const { done, value } = await reader.read().catch((error: unknown) => {
      if (mine === generation) throw error;
      return { done: true, value: undefined };
    });
    if (mine !== generation) return;
    if (value) append(value);
    const now = performance.now();
    if (done || now - reported > REPORT_MS) {
      reported = now;
      reply({ kind: 'size', lines: count(), bytes: used, complete: done });
    }
    if (done) return;
  }
}

onmessage = (event: MessageEvent<TextRequest>) => {
  const request = event.data;
  switch (request.kind) {
    case 'load':
      load(request.url).catch((error: unknown) => reply({ kind: 'failed', text: String(error) }));
      break;
    case 'clear':
      forget();
      [text, used, lines] = [new Uint8Array(0), 0, 0];
      break;
    case 'lines': {
      const result: string[] = [];
      const end = Math.min(count(), request.from + request.count);
      for (let line = request.from; line < end; line += 1) {
        const from = starts[line]!;
        const to = line + 1 < lines ? starts[line + 1]! - 1 : used;
        result.push(decoder.decode(text.subarray(from, Math.min(to, from + MAX_LINE))).replace(/\r$/, ''));
      }
      reply({ kind: 'lines', from: request.from, lines: result, id: request.id });
      break;
    }
  }
};
