//! Smooths a step signal.

/// Three consecutive moving averages of `n` periods each over a signal that is constant within a period.
///
/// In continuous time the output has a continuous second derivative and a third derivative that is constant
/// within each period. For a signal within `[-1, 1]` the derivatives by the number of periods are at most
/// `1.5/n`, `4/n^2` and `8/n^3` in magnitude: the total variation of the kernel (a quadratic B-spline) and of
/// its derivatives.
///
/// The computation uses integers: it is exact, so it neither drifts nor depends on the history.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TripleAverage {
    n: usize,
    /// The last `3 n` input values.
    past: Box<[i64]>,
    /// Index of the oldest of them.
    oldest: usize,
    /// Value times `6 n^3`.
    value: i128,
    /// First derivative by periods times `2 n^3`.
    first: i128,
    /// Second derivative times `n^3`.
    second: i128,
    /// Third derivative times `n^3`.
    third: i128,
}

impl TripleAverage {
    /// Averages of `n` periods each, at least one, settled at the input `value`. Allocates.
    #[must_use]
    pub fn new(n: usize, value: i64) -> Self {
        let n = n.max(1);
        let mut this = Self {
            n,
            past: vec![value; 3 * n].into_boxed_slice(),
            oldest: 0,
            value: 0,
            first: 0,
            second: 0,
            third: 0,
        };
        this.reset(value);
        this
    }

    /// Resets to a signal that has been `value` for a long time. Real-time safe, in O(n).
    pub fn reset(&mut self, value: i64) {
        self.past.fill(value);
        self.value = 6 * self.cube() * i128::from(value);
        (self.first, self.second, self.third) = (0, 0, 0);
    }

    /// Advances by one period with this input. Real-time safe.
    pub fn step(&mut self, input: i64) {
        let length = self.past.len();
        let back = |periods: usize| {
            let index = self.oldest + (length - periods);
            i128::from(self.past[if index < length { index } else { index - length }])
        };
        let third = i128::from(input) - 3 * back(self.n) + 3 * back(2 * self.n) - back(3 * self.n);
        self.value += 3 * (self.first + self.second) + third;
        self.first += 2 * self.second + third;
        self.second += third;
        self.third = third;
        self.past[self.oldest] = input;
        self.oldest = if self.oldest + 1 == length {
            0
        } else {
            self.oldest + 1
        };
    }

    /// Value and three derivatives by periods; the third is that of the last period.
    #[must_use]
    pub fn at(&self) -> [f64; 4] {
        let cube = self.cube() as f64;
        [
            self.value as f64 / (6.0 * cube),
            self.first as f64 / (2.0 * cube),
            self.second as f64 / cube,
            self.third as f64 / cube,
        ]
    }

    fn cube(&self) -> i128 {
        let n = self.n as i128;
        n * n * n
    }
}
