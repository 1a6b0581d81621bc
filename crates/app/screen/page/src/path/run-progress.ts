// How much of the planned path a run has behind it. The core counts the distance since the run began, which is not at the beginning of
// the program after a start at a line, and has the approach in it: the line that runs tells where the distance counts from.

/** The distance is that along the chords of the picture: it differs from the core's by less than this, mm and per mm. */
const TOLERANCE_MM = 1;
const TOLERANCE = 1e-3;

export interface RunPlace {
  job: number;
  line: number;
  /** mm since the run began */
  pathDone: number;
}

export class RunProgress {
  /** path in mm and time in s at some of the vertices, in turn */
  readonly #profile: Float64Array;
  /** path in mm at which a line begins first, and at which it ends last, in turn; NaN for lines without motion */
  readonly #lines: Float32Array;
  #job = -1;
  /** the path at which the distance of the run is 0, mm */
  #begin = 0;
  /** the line of the program at which the distance was set, until the next one: how much of it is behind is not known, nor how long the way there was */
  #from: number | null = null;

  constructor(profile: Float64Array, lines: Float32Array) {
    this.#profile = profile;
    this.#lines = lines;
  }

  /** The fraction of the program's time that is over; null where the path is not here. */
  timeFraction(run: RunPlace): number | null {
    const profile = this.#profile;
    const total = profile.at(-1) ?? 0;
    if (!(total > 0)) return null;
    const mm = this.#place(run);
    let [low, high] = [0, profile.length / 2 - 1];
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (profile[2 * middle]! <= mm) low = middle;
      else high = middle;
    }
    const [from, to] = [profile[2 * low]!, profile[2 * high]!];
    const part = to > from ? Math.min(1, Math.max(0, (mm - from) / (to - from))) : 1;
    return (profile[2 * low + 1]! + part * (profile[2 * high + 1]! - profile[2 * low + 1]!)) / total;
  }

  /** Where on the path a run is. A line that runs several times leaves room for all of its runs. */
  #place({ job, line, pathDone }: RunPlace): number {
    if (job !== this.#job) [this.#job, this.#begin, this.#from] = [job, 0, null];
    const [first, last] = [this.#lines[2 * line] ?? NaN, this.#lines[2 * line + 1] ?? NaN];
    if (this.#from !== null && line !== this.#from && !Number.isNaN(first)) {
      // A line that comes after it begins here, unless it ran before.
      if (first >= this.#lines[2 * this.#from]!) this.#begin = first - pathDone;
      this.#from = null;
    }
    const mm = pathDone + this.#begin;
    const tolerance = TOLERANCE_MM + TOLERANCE * mm;
    if (mm >= first - tolerance && mm <= last + tolerance) return mm;
    if (Number.isNaN(first)) return mm;
    [this.#begin, this.#from] = [first - pathDone, line];
    return first;
  }
}
