//! A signal with steps, made smooth.

/// Three moving averages in a row, of `n` periods each, over a signal that is constant within a period.
///
/// In continuous time: what comes out is a function with continuous second derivative and, within each period, constant third one.
/// Where the signal stays within `[-1, 1]`, the magnitudes of its derivatives by the number of periods are at most `1.5/n`,
/// `4/n^2` and `8/n^3`: the total variation of the kernel (a quadratic B-spline) and of its derivatives.
///
/// Computed in integers: exact, so it neither drifts nor depends on the way there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TripleAverage {
    n: usize,
    /// The last `3 n` values.
    past: Box<[i64]>,
    /// Where the oldest of them is.
    oldest: usize,
    /// Times `6 n^3`.
    value: i128,
    /// Times `2 n^3`, by periods.
    first: i128,
    /// Times `n^3`.
    second: i128,
    /// Times `n^3`.
    third: i128,
}

impl TripleAverage {
    /// Of `n` periods each, at least one, after a signal that was `value` for long. Allocates.
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
        this.settle(value);
        this
    }

    /// Forgets the past: the signal was `value` for long. Real-time safe, its cost is `n`.
    pub fn settle(&mut self, value: i64) {
        self.past.fill(value);
        self.value = 6 * self.cube() * i128::from(value);
        (self.first, self.second, self.third) = (0, 0, 0);
    }

    /// Goes on by one period in which the signal is `input`. Real-time safe.
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

    /// Value and three derivatives, by periods. The third is that of the last period.
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
