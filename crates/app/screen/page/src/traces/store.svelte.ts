// The traces of the machine, the one that is looked into, and where in it.
import type { TraceEntry } from '../generated/TraceEntry';
import type { TraceJob } from '../generated/TraceJob';
import type { TraceReply, TraceRequest } from '../workers/trace.worker';
import { cycleOfLine, lineAt, type Job, type RunData } from './run-data';

/** What `evolvent trace compare --json` gives. */
export interface Comparison {
  common_path_mm: number;
  path_mm: [number, number];
  duration_s: [number, number];
  common_s: [number, number];
  max_deviation_mm: number;
  max_rotary_deviation_deg: number | null;
  rotary_deviation_line: number;
  deviation_at_mm: number;
  deviation_line: number;
  first_deviation: [number, number] | null;
  lines: { line: number; text: string; b_text?: string; a_s: number; b_s: number; a_limit: string; b_limit: string; why: string }[];
  lag: [number, number][];
  notes: string[];
}

async function fetched<T>(url: string): Promise<T> {
  const response = await fetch(url);
  if (!response.ok) throw new Error((await response.text()) || `${response.status} ${response.statusText}`);
  return (await response.json()) as T;
}

const enc = encodeURIComponent;
export const reportOf = (name: string): string => `traces/${enc(name)}/report`;

class Traces {
  list = $state.raw<TraceEntry[]>([]);
  failed = $state('');
  /** name of the trace that is looked into */
  name = $state('');
  run = $state.raw<RunData | null>(null);
  loading = $state(false);
  /** the cycle that is shown */
  sequence = $state(0);
  /** number of the job that is looked at; 0 for all */
  job = $state(0);
  #worker: Worker | null = null;
  #id = 0;

  async refresh(): Promise<void> {
    try {
      this.list = await fetched<TraceEntry[]>('traces');
      this.failed = '';
    } catch (error) {
      this.failed = error instanceof Error ? error.message : String(error);
    }
  }

  jobs(name: string): Promise<TraceJob[]> {
    return fetched<TraceJob[]>(`traces/${enc(name)}/jobs`);
  }

  compare(a: string, jobA: number, b: string, jobB: number): Promise<Comparison> {
    return fetched<Comparison>(`comparison/${enc(a)}/${jobA}/${enc(b)}/${jobB}`);
  }

  /** Looks into a trace. */
  open(name: string): void {
    this.#id += 1;
    [this.name, this.run, this.loading, this.failed] = [name, null, true, ''];
    if (this.#worker === null) {
      this.#worker = new Worker(new URL('../workers/trace.worker.ts', import.meta.url), { type: 'module', name: 'trace' });
      this.#worker.onmessage = (event: MessageEvent<TraceReply>) => this.#take(event.data);
    }
    const url = new URL(`traces/${enc(name)}/data`, document.baseURI).href;
    this.#worker.postMessage({ url, id: this.#id } satisfies TraceRequest);
  }

  #take(reply: TraceReply): void {
    if (reply.id !== this.#id) return;
    this.loading = false;
    if ('failed' in reply) {
      this.failed = reply.failed;
      return;
    }
    this.run = reply.run;
    // What was run last is what somebody wants to see.
    this.show(reply.run.jobs.findLast((job) => job.name.startsWith('program '))?.number ?? 0);
  }

  /** Looks at one job, or at all of the trace. */
  show(job: number): void {
    this.job = job;
    this.sequence = this.from;
  }

  get #part(): Job | undefined {
    return this.run?.jobs.find((job) => job.number === this.job);
  }

  /** First and last cycle that are looked at. */
  get from(): number {
    return this.#part?.start ?? this.run?.first ?? 0;
  }

  get to(): number {
    return this.#part?.end ?? this.run?.last ?? 0;
  }

  seek(sequence: number): void {
    this.sequence = Math.min(this.to, Math.max(this.from, Math.round(sequence)));
  }

  /** Goes to where a line was driven; to its next time where it is shown already. */
  seekLine(line: number): void {
    const run = this.run;
    if (run === null) return;
    const after = lineAt(run, this.sequence) === line ? this.sequence : this.from - 1;
    const found = cycleOfLine(run, line, this.from, this.to, after);
    if (found !== null) this.seek(found);
  }

  get line(): number {
    return this.run === null ? 0 : lineAt(this.run, this.sequence);
  }
}

export const traces = new Traces();
