//! Recorded cycles in order, from the thread that reads them.

use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::Scope;

use evolvent_trace::{CycleRecord, ReadError, TraceFile};

/// Number of cycles that the reader passes on at once, and maximum number of waiting lots.
const LOT: usize = 4096;
const LOTS: usize = 8;

type Lot = Arc<Vec<CycleRecord>>;

/// Reads on a separate thread, for the thread that computes and the thread that checks.
pub(super) fn read<'scope, 'env>(
    scope: &'scope Scope<'scope, 'env>,
    trace: &'env mut TraceFile,
) -> (Records, Receiver<Lot>) {
    let (to_compute, lots) = sync_channel(LOTS);
    let (to_check, checked) = sync_channel(LOTS);
    scope.spawn(move || send(trace, &to_compute, &to_check));
    let records = Records {
        lots,
        lot: Lot::default(),
        at: 0,
        failure: None,
    };
    (records, checked)
}

fn send(trace: &mut TraceFile, to_compute: &SyncSender<Result<Lot, ReadError>>, to_check: &SyncSender<Lot>) {
    let pass_on = |lot: &mut Vec<CycleRecord>| {
        let whole = Lot::new(std::mem::replace(lot, Vec::with_capacity(LOT)));
        let computes = to_compute.send(Ok(Arc::clone(&whole))).is_ok();
        let checks = to_check.send(whole).is_ok();
        computes || checks
    };
    let mut lot = Vec::with_capacity(LOT);
    let read = trace.each_cycle(0, u64::MAX, |record| -> Result<_, ReadError> {
        lot.push(*record);
        Ok(if lot.len() == LOT && !pass_on(&mut lot) {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        })
    });
    // An error follows the intact part.
    pass_on(&mut lot);
    if let Err(error) = read {
        let _gone = to_compute.send(Err(error));
    }
}

/// Recorded cycles in order.
pub(super) struct Records {
    lots: Receiver<Result<Lot, ReadError>>,
    lot: Lot,
    at: usize,
    failure: Option<ReadError>,
}

impl Records {
    /// The next record, without consuming it.
    pub(super) fn peek(&mut self) -> Option<&CycleRecord> {
        while self.at >= self.lot.len() {
            match self.lots.recv() {
                Ok(Ok(lot)) => (self.lot, self.at) = (lot, 0),
                Ok(Err(error)) => {
                    self.failure = Some(error);
                    return None;
                }
                Err(_) => return None,
            }
        }
        self.lot.get(self.at)
    }

    /// The next record.
    pub(super) fn next(&mut self) -> Option<CycleRecord> {
        let record = *self.peek()?;
        self.at += 1;
        Some(record)
    }

    /// The record of cycle `sequence`: `Some(None)` if it was lost, `None` at the end.
    pub(super) fn advance(&mut self, sequence: u64) -> Option<Option<CycleRecord>> {
        let next = self.peek()?.sequence;
        Some(if next <= sequence { self.next() } else { None })
    }

    /// Why reading ended early.
    pub(super) fn failure(self) -> Option<ReadError> {
        self.failure
    }
}
