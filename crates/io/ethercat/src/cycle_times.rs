//! Times of the cycle, for benchmarks.

use core::sync::atomic::{AtomicU32, AtomicU64, AtomicUsize, Ordering};

/// One cycle, ns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CycleTime {
    /// Lateness of the wake-up.
    pub late_ns: u32,
    /// Time from then until it sleeps again, without waiting for the frame.
    pub work_ns: u32,
    /// The same including the wait.
    pub whole_ns: u32,
    /// Processor time of the thread; excludes time taken by others.
    pub processor_ns: u32,
}

/// Records the times of a limited number of cycles with all devices in OP. Neither allocates nor waits.
#[derive(Debug)]
pub struct CycleTimes {
    cycles: Vec<[AtomicU32; 4]>,
    count: AtomicUsize,
    counter: fn() -> u64,
    first: AtomicU64,
    last: AtomicU64,
}

impl CycleTimes {
    /// Capacity for this many cycles. `counter` is read on the cycle's thread after each: of allocations, for
    /// example.
    #[must_use]
    pub fn new(cycles: usize, counter: fn() -> u64) -> Self {
        Self {
            cycles: (0..cycles).map(|_| Default::default()).collect(),
            count: AtomicUsize::new(0),
            counter,
            first: AtomicU64::new(0),
            last: AtomicU64::new(0),
        }
    }

    pub(crate) fn take(&self, time: CycleTime) {
        let counted = (self.counter)();
        let count = self.count.load(Ordering::Relaxed);
        if count == 0 {
            self.first.store(counted, Ordering::Relaxed);
        }
        self.last.store(counted, Ordering::Relaxed);
        let Some([late, work, whole, processor]) = self.cycles.get(count) else {
            return;
        };
        late.store(time.late_ns, Ordering::Relaxed);
        work.store(time.work_ns, Ordering::Relaxed);
        whole.store(time.whole_ns, Ordering::Relaxed);
        processor.store(time.processor_ns, Ordering::Relaxed);
        self.count.store(count + 1, Ordering::Release);
    }

    /// The times so far, in order.
    #[must_use]
    pub fn cycles(&self) -> Vec<CycleTime> {
        let count = self.count.load(Ordering::Acquire);
        self.cycles[..count]
            .iter()
            .map(|cycle| {
                let [late_ns, work_ns, whole_ns, processor_ns] =
                    [0, 1, 2, 3].map(|i| cycle[i].load(Ordering::Relaxed));
                CycleTime {
                    late_ns,
                    work_ns,
                    whole_ns,
                    processor_ns,
                }
            })
            .collect()
    }

    /// Growth of the counter since the first cycle.
    #[must_use]
    pub fn counted(&self) -> u64 {
        self.last.load(Ordering::Relaxed) - self.first.load(Ordering::Relaxed)
    }
}
