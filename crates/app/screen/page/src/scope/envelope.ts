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

/** Times relative to `zero`, then a list for each of `series`; at most two points for each of `pixels`. */
export function envelope(times: Float64Array, series: Float32Array[], span: Span, pixels: number, zero: number): Float64Array[] {
  const count = span.end - span.begin;
  const size = times.length;
  if (count <= 2 * pixels) {
    const result = [times, ...series].map(() => new Float64Array(Math.max(0, count)));
    for (let i = 0; i < count; i += 1) {
      const at = (span.begin + i) % size;
      result[0]![i] = times[at]! - zero;
      series.forEach((values, s) => (result[s + 1]![i] = values[at]!));
    }
    return result;
  }
  // Buckets begin at whole multiples of the step, so that a live picture moves and does not flicker.
  const step = Math.ceil(count / pixels);
  const first = Math.ceil(span.begin / step);
  const buckets = Math.floor(span.end / step) - first;
  const result = [times, ...series].map(() => new Float64Array(2 * buckets));
  for (let bucket = 0; bucket < buckets; bucket += 1) {
    const from = (first + bucket) * step;
    result[0]![2 * bucket] = times[from % size]! - zero;
    result[0]![2 * bucket + 1] = times[(from + (step >> 1)) % size]! - zero;
    series.forEach((values, s) => {
      let [low, high, lowAt, highAt] = [Infinity, -Infinity, from, from];
      for (let i = from; i < from + step; i += 1) {
        const value = values[i % size]!;
        if (value < low) [low, lowAt] = [value, i];
        if (value > high) [high, highAt] = [value, i];
      }
      const none = low === Infinity;
      const pair = lowAt <= highAt ? [low, high] : [high, low];
      result[s + 1]![2 * bucket] = none ? NaN : pair[0]!;
      result[s + 1]![2 * bucket + 1] = none ? NaN : pair[1]!;
    });
  }
  return result;
}
