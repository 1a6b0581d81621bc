// A recorded run, so that time, line and point of the path lead to each other. A cycle's number (`sequence`) stands for its time.

/** A curve: least and greatest of each stretch of `width` cycles, in steps of `scale` above `offset`; 65535 above 0 is a gap. */
export interface Series {
  group: string;
  label: string;
  unit: string;
  width: number;
  offset: number;
  scale: number;
  values: Uint16Array;
}

export interface Job {
  number: number;
  name: string;
  start: number;
  end: number;
}

export interface RunData {
  periodS: number;
  first: number;
  last: number;
  axes: string;
  series: Series[];
  /** cycle and state, in turn */
  states: Float64Array;
  /** cycle, kind, code and text */
  events: [number, number, number, string][];
  trail: { position: Float32Array; feed: Float32Array; sequence: Float64Array; rapid: Uint8Array; fastest: number };
  /** where another line begins */
  runs: { start: Float64Array; line: Uint32Array };
  jobs: Job[];
  /** by job, then by line */
  texts: Record<string, Record<string, string>>;
}

/** At most `most` places from `first` to `last`, of which the middle is as close to `here` as they permit. */
export function around(first: number, last: number, here: number, most: number): { begin: number; end: number } {
  const begin = Math.max(first, Math.min(here - (most >> 1), last - most + 1));
  return { begin, end: Math.min(last, begin + most - 1) };
}

/** The last entry of an ascending list that is not above `value`; -1 where there is none. */
export function lastAt(list: Float64Array, value: number): number {
  let [low, high] = [0, list.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle]! <= value) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** The line that is driven with a cycle; 0 for none. */
export function lineAt(run: RunData, sequence: number): number {
  const at = lastAt(run.runs.start, sequence);
  return at < 0 ? 0 : run.runs.line[at]!;
}

/** The job that a cycle belongs to; null before the first, or where the trace has none. */
export function jobAt(run: RunData, sequence: number): Job | null {
  return run.jobs.findLast((job) => job.start <= sequence) ?? null;
}

/**
 * A cycle with which `line` begins in the cycles from `from` to `to`: the first behind `after`, or the first of all. Null where it was not
 * driven.
 */
export function cycleOfLine(run: RunData, line: number, from: number, to: number, after: number): number | null {
  const { start, line: lines } = run.runs;
  let found: number | null = null;
  for (let i = Math.max(0, lastAt(start, from)); i < start.length && start[i]! <= to; i += 1) {
    if (lines[i] !== line) continue;
    const at = Math.max(from, start[i]!);
    if (at > after) return at;
    found ??= at;
  }
  return found;
}

/** Least and greatest of a curve between two cycles; null for a gap. */
export function rangeOf(run: RunData, series: Series, from: number, to: number): [number, number] | null {
  const { width, values, offset, scale } = series;
  const begin = Math.max(0, Math.floor((from - run.first) / width));
  const end = Math.min(values.length / 2 - 1, Math.floor((to - run.first) / width));
  let [low, high] = [65_535, 0];
  for (let i = begin; i <= end; i += 1) {
    if (values[2 * i]! > values[2 * i + 1]!) continue;
    low = Math.min(low, values[2 * i]!);
    high = Math.max(high, values[2 * i + 1]!);
  }
  return low > high ? null : [offset + low * scale, offset + high * scale];
}

/** The value of a curve at a cycle: the middle of its stretch. */
export function valueAt(run: RunData, series: Series | undefined, sequence: number): number {
  const range = series && rangeOf(run, series, sequence, sequence);
  return range ? (range[0] + range[1]) / 2 : NaN;
}

export function seriesOf(run: RunData, group: string, label?: string): Series | undefined {
  return run.series.find((series) => series.group === group && (label === undefined || series.label === label));
}

/** X, Y and Z of a cycle; an axis that the machine has not is at 0. */
export function placeAt(run: RunData, sequence: number): [number, number, number] {
  const of = (letter: string): number => {
    const value = valueAt(run, seriesOf(run, 'position', letter), sequence);
    return Number.isNaN(value) ? 0 : value;
  };
  return [of('X'), of('Y'), of('Z')];
}

const STATES = ['idle', 'running', 'holding', 'held', 'stopping', 'stopped', 'dwell', 'program_stop', 'fault', 'done'] as const;

export function stateAt(run: RunData, sequence: number): (typeof STATES)[number] {
  // States are few: cycle and number in turn.
  let found = 0;
  for (let i = 0; i < run.states.length && run.states[i]! <= sequence; i += 2) found = run.states[i + 1]!;
  return STATES[found] ?? 'idle';
}
