// What a plot of some hundred pixels shows of many samples: the least and the largest value of each pixel's samples, in the
// order in which they came, so that no peak is lost.

export interface Span {
  /** samples ever written, as `History.count` */
  begin: number;
  end: number;
}

/** Index of the first sample in [begin, end) whose time is not before `time`. */
export function firstAt(times: Float64Array, span: Span, time: number): number {
  let [low, high] = [span.begin, span.end];
  while (low < high) {
    const middle = Math.floor((low + high) / 2);
    if (times[middle % times.length]! < time) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** How many samples of a span were lost before one of them: `gaps` has 1 for each that does not follow the one before it. */
export function breaksIn(gaps: Uint8Array, span: Span): number {
  let count = 0;
  for (let i = span.begin + 1; i < span.end; i += 1) count += gaps[i % gaps.length]!;
  return count;
}

/**
 * Times relative to `zero`, then a list for each of `series`; at most two points for each of `pixels`. At each of `gaps` comes a point of
 * NaN, which breaks the line, and a pixel that has one has two points more.
 */
export function envelope(times: Float64Array, series: Float32Array[], span: Span, pixels: number, zero: number, gaps: Uint8Array | null = null): Float64Array[] {
  const count = span.end - span.begin;
  const size = times.length;
  const isGap = (i: number): boolean => gaps !== null && i > span.begin && gaps[i % size] === 1;
  const breakAt = (result: Float64Array[], n: number, i: number): void => {
    result.forEach((list) => (list[n] = NaN));
    result[0]![n] = (times[(i - 1) % size]! + times[i % size]!) / 2 - zero;
  };
  if (count <= 2 * pixels) {
    const breaks = gaps === null ? 0 : breaksIn(gaps, span);
    const result = [times, ...series].map(() => new Float64Array(Math.max(0, count) + breaks));
    for (let [i, n] = [span.begin, 0]; i < span.end; i += 1, n += 1) {
      if (isGap(i)) breakAt(result, n++, i);
      const at = i % size;
      result[0]![n] = times[at]! - zero;
      series.forEach((values, s) => (result[s + 1]![n] = values[at]!));
    }
    return result;
  }
  // Buckets begin at whole multiples of the step, so that a live picture moves and does not flicker.
  const step = Math.ceil(count / pixels);
  const first = Math.ceil(span.begin / step);
  const buckets = Math.floor(span.end / step) - first;
  // A bucket ends where samples are missing, too.
  const begins: number[] = [];
  let breaks = 0;
  const end = (first + buckets) * step;
  for (let i = first * step; i < end; i += 1) {
    const isBroken = isGap(i);
    if (isBroken) breaks += 1;
    if (isBroken || i % step === 0) begins.push(i);
  }
  const result = [times, ...series].map(() => new Float64Array(2 * begins.length + breaks));
  let n = 0;
  begins.forEach((from, part) => {
    const to = begins[part + 1] ?? end;
    if (isGap(from)) breakAt(result, n++, from);
    result[0]![n] = times[from % size]! - zero;
    result[0]![n + 1] = times[(from + ((to - from) >> 1)) % size]! - zero;
    series.forEach((values, s) => {
      let [low, high, lowAt, highAt] = [Infinity, -Infinity, from, from];
      for (let i = from; i < to; i += 1) {
        const value = values[i % size]!;
        if (value < low) [low, lowAt] = [value, i];
        if (value > high) [high, highAt] = [value, i];
      }
      const none = low === Infinity;
      const pair = lowAt <= highAt ? [low, high] : [high, low];
      result[s + 1]![n] = none ? NaN : pair[0]!;
      result[s + 1]![n + 1] = none ? NaN : pair[1]!;
    });
    n += 2;
  });
  return result;
}
