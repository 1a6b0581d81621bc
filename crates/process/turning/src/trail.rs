//! Positions of the tool over the last revolution.

/// Positions of the tip, one per cycle, for a revolution. Memory is allocated once.
#[derive(Clone, Debug)]
pub(crate) struct Trail {
    points: Vec<(f64, f64)>,
    next: usize,
    turn: usize,
}

impl Trail {
    pub(crate) fn new(turn_cycles: f64, at: (f64, f64)) -> Self {
        let turn = turn_cycles.round().max(1.0) as usize;
        Self {
            points: vec![at; turn + 1],
            next: 0,
            turn,
        }
    }

    pub(crate) fn push(&mut self, along: f64, out: f64) {
        self.points[self.next] = (along, out);
        self.next = (self.next + 1) % self.points.len();
    }

    fn ago(&self, cycles: usize) -> (f64, f64) {
        let n = self.points.len();
        self.points[(self.next + n - 1 - cycles % n) % n]
    }

    /// Position of the tip one revolution ago.
    pub(crate) fn turn_ago(&self) -> (f64, f64) {
        self.ago(self.turn)
    }

    /// Advance of the tool over the last revolution, mm.
    pub(crate) fn chip_mm(&self) -> f64 {
        self.ago(0).0 - self.ago(self.turn).0
    }
}
