//! Orders that bypass the queue, which may be long or full.
//!
//! Each kind has the number of its newest order. All orders are numbered in one series, so the cycle knows
//! which of two came first: an order of the queue that is older than an urgent one does not undo it.

use std::sync::atomic::{AtomicU64, Ordering};

/// An urgent order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Urgent {
    /// Each axis stops on its own, and the drives perform their quick stop.
    Emergency,
    /// Whatever moves the axes stops within the limits.
    Stop,
    /// The drives lose power.
    PowerOff,
}

impl Urgent {
    const ALL: [Self; 3] = [Self::Emergency, Self::Stop, Self::PowerOff];
}

/// From the control thread to the cycle: the number of the newest order of each kind, 0 before the first.
#[derive(Debug, Default)]
pub(crate) struct UrgentOrders {
    newest: [AtomicU64; 3],
}

impl UrgentOrders {
    /// Sends an order. It covers older orders of its kind.
    pub(crate) fn order(&self, what: Urgent, number: u64) {
        // Orders of the queue that were sent after it also follow it for the cycle.
        self.newest[what as usize].store(number, Ordering::Release);
    }

    fn newest(&self) -> [u64; 3] {
        Urgent::ALL.map(|what| self.newest[what as usize].load(Ordering::Acquire))
    }
}

/// The urgent orders that the cycle has taken.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct UrgentTaken {
    taken: [u64; 3],
}

impl UrgentTaken {
    /// Takes the oldest order not taken yet, with its number.
    pub(crate) fn take(&mut self, orders: &UrgentOrders) -> Option<(Urgent, u64)> {
        let newest = orders.newest();
        let what = (Urgent::ALL.into_iter())
            .filter(|what| newest[*what as usize] > self.taken[*what as usize])
            .min_by_key(|what| newest[*what as usize])?;
        let number = newest[what as usize];
        self.taken[what as usize] = number;
        Some((what, number))
    }

    /// Whether an order of one of these kinds was sent after an order of the queue and taken before it.
    /// Orders without a number were never overtaken.
    pub(crate) fn overtook(&self, kinds: &[Urgent], number: u64) -> bool {
        number > 0 && kinds.iter().any(|what| self.taken[*what as usize] > number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_older_of_two_is_taken_first_and_each_once() {
        let (orders, mut taken) = (UrgentOrders::default(), UrgentTaken::default());
        assert_eq!(taken.take(&orders), None);
        orders.order(Urgent::PowerOff, 3);
        orders.order(Urgent::Emergency, 5);
        orders.order(Urgent::Emergency, 6);
        assert_eq!(taken.take(&orders), Some((Urgent::PowerOff, 3)));
        assert_eq!(taken.take(&orders), Some((Urgent::Emergency, 6)));
        assert_eq!(taken.take(&orders), None);
        assert!(taken.overtook(&Urgent::ALL, 4) && !taken.overtook(&Urgent::ALL, 7));
        assert!(!taken.overtook(&[Urgent::PowerOff], 4));
        assert!(!taken.overtook(&Urgent::ALL, 0));
    }
}
