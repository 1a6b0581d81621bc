// Reads what a trace holds: tens of megabytes of text that must not block the thread that draws.
import type { RunData, Series } from '../traces/run-data';

export interface TraceRequest {
  url: string;
  id: number;
}
export type TraceReply = { id: number; run: RunData } | { id: number; failed: string };

interface Raw {
  period_s: number;
  first: number;
  last: number;
  axes: string;
  series: (Omit<Series, 'values'> & { values: string })[];
  states: [number, number][];
  events: [number, number, number, string][];
  trail: { x: string; y: string; z: string; feed: string; sequence: string; rapid: string };
  fastest_cut: number;
  jobs: [number, string, number, number][];
  line_runs: { start: string; line: string };
  texts: Record<string, Record<string, string>>;
}

function bytes(text: string): ArrayBuffer {
  const raw = atob(text);
  const out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i += 1) out[i] = raw.charCodeAt(i);
  return out.buffer;
}

function decoded(raw: Raw): RunData {
  const floats = (text: string): Float32Array => new Float32Array(bytes(text));
  const [x, y, z] = [floats(raw.trail.x), floats(raw.trail.y), floats(raw.trail.z)];
  const position = new Float32Array(3 * x.length);
  for (let i = 0; i < x.length; i += 1) position.set([x[i]!, y[i]!, z[i]!], 3 * i);
  return {
    periodS: raw.period_s,
    first: raw.first,
    last: raw.last,
    axes: raw.axes,
    series: raw.series.map(({ group, label, unit, width, offset, scale, values }) => ({
      group, label, unit, width, offset, scale, values: new Uint16Array(bytes(values)),
    })),
    states: Float64Array.from(raw.states.flat()),
    events: raw.events,
    trail: {
      position,
      feed: floats(raw.trail.feed),
      sequence: new Float64Array(bytes(raw.trail.sequence)),
      rapid: new Uint8Array(bytes(raw.trail.rapid)),
      fastest: raw.fastest_cut,
    },
    runs: { start: new Float64Array(bytes(raw.line_runs.start)), line: new Uint32Array(bytes(raw.line_runs.line)) },
    jobs: raw.jobs.map(([number, name, start, end]) => ({ number, name, start, end })),
    texts: raw.texts,
  };
}

onmessage = async (event: MessageEvent<TraceRequest>) => {
  const { url, id } = event.data;
  try {
    const response = await fetch(url);
    if (!response.ok) throw new Error((await response.text()) || `${response.status} ${response.statusText}`);
    const run = decoded((await response.json()) as Raw);
    const { trail, runs } = run;
    const transfer = [...run.series.map((series) => series.values), trail.position, trail.feed, trail.sequence, trail.rapid, runs.start, runs.line, run.states];
    postMessage({ id, run } satisfies TraceReply, { transfer: transfer.map((list) => list.buffer) });
  } catch (error) {
    postMessage({ id, failed: error instanceof Error ? error.message : String(error) } satisfies TraceReply);
  }
};
