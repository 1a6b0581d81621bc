// Numbers of the scope: with as many digits as tell them apart, however small they are.

/** Digits behind the point beyond which a power of ten is shorter. */
const MAX_DIGITS = 6;

/** Texts of marks at multiples of `step`. */
export function tickTexts(marks: number[], step: number): string[] {
  // A step is 1, 2, 2.5 or 5 times a power of ten.
  const digits = Math.max(0, -Math.floor(Math.log10(step)) + (/^2\.5/.test(step.toExponential()) ? 1 : 0));
  return marks.map((mark) => {
    // Rounded, zero may have a sign.
    if (Math.abs(mark) < step / 2) return '0';
    return digits > MAX_DIGITS ? String(Number(mark.toPrecision(3))) : mark.toFixed(digits);
  });
}

/** A value of a sample, which is an f32. */
export function valueText(value: number | null): string {
  return value === null || Number.isNaN(value) ? '–' : String(Number(value.toPrecision(6)));
}
