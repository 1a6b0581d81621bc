// A client of the screen's server that looks on: the little of WebSocket that it needs, without a browser.
import { request } from 'node:http';
import { randomBytes } from 'node:crypto';

/** Where position and velocity of X are in a sample: after time, line, flags and feed, and after nine positions. */
const [POSITION_X, VELOCITY_X] = [24, 24 + 9 * 4];

export class Watcher {
  /** time in s of the machine's clock, position of X in mm, its velocity in mm/s */
  samples = [];
  newest = null;
  /** between two samples, s */
  period = 0;
  /** states that came */
  frames = 0;
  isClosed = false;
  /** bytes of a sample, as the server says */
  #sampleBytes = Infinity;
  #socket;
  #rest = Buffer.alloc(0);

  static open(url) {
    return new Promise((resolve, reject) => {
      const key = randomBytes(16).toString('base64');
      const asked = request(new URL('ws', url), { headers: { Connection: 'Upgrade', Upgrade: 'websocket', 'Sec-WebSocket-Version': '13', 'Sec-WebSocket-Key': key } });
      asked.on('upgrade', (_answer, socket, head) => resolve(new Watcher(socket, head)));
      asked.on('response', (answer) => reject(new Error(`${answer.statusCode}`)));
      asked.on('error', reject);
      asked.end();
    });
  }

  constructor(socket, head) {
    this.#socket = socket;
    socket.on('data', (data) => this.#take(data));
    socket.on('close', () => (this.isClosed = true));
    socket.on('error', () => {});
    this.#take(head);
  }

  forget() {
    this.samples = this.samples.slice(-1);
  }

  close() {
    this.#socket.destroy();
  }

  #take(data) {
    let rest = Buffer.concat([this.#rest, data]);
    for (;;) {
      if (rest.length < 2) break;
      let [length, at] = [rest[1] & 127, 2];
      if (length === 126) {
        if (rest.length < 4) break;
        [length, at] = [rest.readUInt16BE(2), 4];
      } else if (length === 127) {
        if (rest.length < 10) break;
        [length, at] = [Number(rest.readBigUInt64BE(2)), 10];
      }
      if (rest.length < at + length) break;
      const kind = rest[0] & 15;
      if (kind === 1) this.#text(rest.subarray(at, at + length));
      else if (kind === 2) this.#samples(rest.subarray(at, at + length));
      rest = rest.subarray(at + length);
    }
    this.#rest = Buffer.from(rest);
  }

  #text(bytes) {
    this.frames += 1;
    if (this.#sampleBytes !== Infinity) return;
    // The first message.
    const message = JSON.parse(bytes.toString());
    if (message.type === 'machine') this.#sampleBytes = message.machine.sample_bytes;
  }

  #samples(bytes) {
    const size = this.#sampleBytes;
    if (bytes.length % size !== 0) throw new Error(`${bytes.length} bytes are no samples of ${size}`);
    for (let at = 0; at < bytes.length; at += size) {
      const sample = { time: bytes.readDoubleLE(at), position: bytes.readFloatLE(at + POSITION_X), velocity: bytes.readFloatLE(at + VELOCITY_X) };
      if (this.newest !== null) this.period = sample.time - this.newest.time;
      this.newest = sample;
      this.samples.push(sample);
    }
    // Who does not forget keeps a minute.
    if (this.samples.length > 60_000) this.samples = this.samples.slice(-30_000);
  }
}
