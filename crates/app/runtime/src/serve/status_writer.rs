//! When the status of a served machine is sent: periodically, and as soon as something changes.

use rtrb::Producer;

use super::operator::Operator;
use super::served_status::Snapshot;
use super::snapshot::{Mark, Pulse, snapshot};
use crate::publish_report::PublishReport;

/// Time between two snapshots while nothing changes.
const STATUS_EVERY_NS: u64 = 50_000_000;

/// Passes snapshots to the publisher.
pub(super) struct StatusWriter {
    snapshots: Producer<Snapshot>,
    sequence: u64,
    mark: Option<Mark>,
    next_ns: u64,
}

impl StatusWriter {
    pub(super) const fn new(snapshots: Producer<Snapshot>) -> Self {
        Self {
            snapshots,
            sequence: 0,
            mark: None,
            next_ns: 0,
        }
    }

    /// Sends a snapshot if one is due, something has changed, or `is_over`.
    pub(super) fn write(
        &mut self,
        operator: &mut Operator,
        pulse: &Pulse,
        published: &(PublishReport, usize),
        now_ns: u64,
        is_over: bool,
    ) {
        let now_mark = Mark::of(operator);
        let changed = self.mark != Some(now_mark);
        if !changed && !operator.message.is_unsent() && now_ns < self.next_ns && !is_over {
            return;
        }
        // A publisher that lags receives everything new as soon as it has room.
        while self.snapshots.slots() > 1
            && let Some(text) = operator.message.take_replaced()
        {
            self.sequence += 1;
            let mut status = snapshot(operator, pulse, published, self.sequence, now_ns);
            status.set_message(&text);
            let _sent = self.snapshots.push(Snapshot {
                status,
                event: None,
                lines_before: operator.program.lines_before,
            });
        }
        if self.snapshots.is_full() {
            return;
        }
        self.next_ns = now_ns + STATUS_EVERY_NS;
        self.sequence += 1;
        let status = snapshot(operator, pulse, published, self.sequence, now_ns);
        let before = self.mark.filter(|_| changed);
        let event = before.map(|before| now_mark.event(before));
        let _sent = self.snapshots.push(Snapshot {
            status,
            event,
            lines_before: operator.program.lines_before,
        });
        self.mark = Some(now_mark);
        operator.message.is_in_status();
    }
}
