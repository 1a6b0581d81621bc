//! The program line at each time.

/// Maximum number of runs kept.
const MAX_RUNS: usize = 200_000;

/// The cycles with which another line begins. If there are too many, the shortest runs are omitted.
#[derive(Clone, Debug)]
pub(crate) struct LineRuns {
    list: Vec<(u64, u32)>,
    /// A run of fewer cycles is replaced with the next one.
    min_cycles: u64,
    max_runs: usize,
}

impl Default for LineRuns {
    fn default() -> Self {
        Self {
            list: Vec::new(),
            min_cycles: 1,
            max_runs: MAX_RUNS,
        }
    }
}

impl LineRuns {
    /// Adds the next cycle.
    pub(crate) fn push(&mut self, sequence: u64, line: u32) {
        match self.list.last_mut() {
            Some((_, last)) if *last == line => return,
            Some((start, last)) if sequence - *start < self.min_cycles => {
                *last = line;
                return;
            }
            _ => self.list.push((sequence, line)),
        }
        while self.list.len() > self.max_runs {
            self.min_cycles *= 2;
            for (sequence, line) in std::mem::take(&mut self.list) {
                self.push(sequence, line);
            }
        }
    }

    /// First cycle and line of each run, in order.
    pub(crate) fn list(&self) -> &[(u64, u32)] {
        &self.list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_lines_are_kept_until_full_then_the_longest() {
        let mut runs = LineRuns::default();
        for (sequence, line) in [(0, 1), (1, 1), (2, 2), (3, 1), (4, 1)] {
            runs.push(sequence, line);
        }
        assert_eq!(runs.list(), [(0, 1), (2, 2), (3, 1)]);

        let mut runs = LineRuns {
            max_runs: 100,
            ..LineRuns::default()
        };
        // Lines of one cycle each, then one of a thousand, and so on.
        let mut sequence = 0;
        for round in 0..20 {
            for line in 0..500 {
                runs.push(sequence, 10 + line);
                sequence += 1;
            }
            for _ in 0..1000 {
                runs.push(sequence, round % 10);
                sequence += 1;
            }
        }
        let list = runs.list();
        assert!(list.len() <= 100, "{}", list.len());
        assert!(
            list.windows(2)
                .all(|pair| pair[0].0 < pair[1].0 && pair[0].1 != pair[1].1)
        );
        // All long runs are kept, and found at their middles.
        for round in 0..20_u64 {
            let middle = round * 1500 + 1000;
            let at = list.partition_point(|(start, _)| *start <= middle);
            assert_eq!(u64::from(list[at - 1].1), round % 10);
        }
    }
}
