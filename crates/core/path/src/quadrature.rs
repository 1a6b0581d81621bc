//! Numerical integration and inversion of smooth functions.

/// Half of the 16-point Gauss-Legendre rule on -1..1 (Abramowitz and Stegun, table 25.4): abscissa, weight.
const GAUSS_16: [(f64, f64); 8] = [
    (0.095_012_509_837_637_44, 0.189_450_610_455_068_5),
    (0.281_603_550_779_258_9, 0.182_603_415_044_923_6),
    (0.458_016_777_657_227_4, 0.169_156_519_395_002_54),
    (0.617_876_244_402_643_7, 0.149_595_988_816_576_73),
    (0.755_404_408_355_003, 0.124_628_971_255_533_87),
    (0.865_631_202_387_831_7, 0.095_158_511_682_492_78),
    (0.944_575_023_073_232_6, 0.062_253_523_938_647_89),
    (0.989_400_934_991_649_9, 0.027_152_459_411_754_095),
];

fn gauss_16(f: &impl Fn(f64) -> f64, a: f64, b: f64) -> f64 {
    let (middle, half) = (0.5 * (a + b), 0.5 * (b - a));
    let sum: f64 = GAUSS_16
        .iter()
        .map(|&(x, weight)| weight * (f(middle - half * x) + f(middle + half * x)))
        .sum();
    sum * half
}

/// Integral of `f` over `a..b` by the 16-point Gauss-Legendre rule. Intervals are bisected until two levels
/// agree to `accuracy`, relative to the whole integral, at most `depth` times.
pub(crate) fn integrate(f: &impl Fn(f64) -> f64, a: f64, b: f64, accuracy: f64, depth: u32) -> f64 {
    let whole = gauss_16(f, a, b);
    refine(f, a, b, whole, accuracy * whole.abs(), depth)
}

fn refine(f: &impl Fn(f64) -> f64, a: f64, b: f64, whole: f64, tolerance: f64, depth: u32) -> f64 {
    let middle = 0.5 * (a + b);
    let (left, right) = (gauss_16(f, a, middle), gauss_16(f, middle, b));
    if depth == 0 || (left + right - whole).abs() <= tolerance {
        return left + right;
    }
    refine(f, a, middle, left, 0.5 * tolerance, depth - 1)
        + refine(f, middle, b, right, 0.5 * tolerance, depth - 1)
}

/// The argument in `0..=upper` at which an increasing function with `f(0) = 0` reaches `target`, accurate to
/// a few roundings of `upper`: Newton's method inside a shrinking bracket, at most 64 iterations.
pub(crate) fn invert(
    f: &impl Fn(f64) -> f64,
    derivative: &impl Fn(f64) -> f64,
    target: f64,
    upper: f64,
    guess: f64,
) -> f64 {
    let (mut low, mut high) = (0.0, upper);
    let mut x = guess.max(low).min(high);
    for _ in 0..64 {
        let error = f(x) - target;
        let step = -error / derivative(x);
        if step.abs() <= 2.0 * f64::EPSILON * upper {
            return (x + step).max(0.0).min(upper);
        }
        if error > 0.0 {
            high = x;
        } else {
            low = x;
        }
        let newton = x + step;
        x = if newton > low && newton < high {
            newton
        } else {
            0.5 * (low + high)
        };
    }
    x
}
