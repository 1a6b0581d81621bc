//! Drives the futures of the MainDevice on the calling thread: polls them, sends their frames, and passes on
//! the replies.

use core::future::Future;
use core::pin::pin;
use core::task::{Context, Poll, Waker};

use ethercrab::error::Error;
use ethercrab::{PduRx, PduTx};
use evolvent_bridge::monotonic_ns;

use crate::dump::{Direction, DumpSender};
use crate::emergency::{Emergency, EmergencyFilter, Passage};
use crate::socket::PacketSocket;
use crate::time_driver::{forget_timers, next_timer_ns};

/// Maximum wait for a frame, ns: timers are checked in between.
const PATIENCE_NS: u64 = 1_000_000;

/// One end of the wire. Does not allocate.
pub(crate) struct Pump<'s, 'd> {
    tx: PduTx<'s>,
    rx: PduRx<'s>,
    socket: &'s PacketSocket,
    /// Where frames are recorded.
    dump: Option<&'s mut DumpSender<'d>>,
    buffer: [u8; 1600],
    emergencies: EmergencyFilter,
    /// Time spent waiting for frames, ns.
    waited_ns: u64,
}

impl<'s, 'd> Pump<'s, 'd> {
    pub(crate) const fn new(
        tx: PduTx<'s>,
        rx: PduRx<'s>,
        socket: &'s PacketSocket,
        dump: Option<&'s mut DumpSender<'d>>,
    ) -> Self {
        Self {
            tx,
            rx,
            socket,
            dump,
            buffer: [0; 1600],
            emergencies: EmergencyFilter::new(),
            waited_ns: 0,
        }
    }

    /// Time spent waiting for frames since it was made, ns.
    pub(crate) const fn waited_ns(&self) -> u64 {
        self.waited_ns
    }

    /// The emergency messages received so far, each once.
    pub(crate) fn emergencies(&self) -> impl Iterator<Item = Emergency> + '_ {
        self.emergencies.kept()
    }

    /// Runs a future to its end, or until `until_ns`: then it is dropped, and its replies are lost.
    pub(crate) fn complete<T>(&mut self, until_ns: u64, future: impl Future<Output = T>) -> Option<T> {
        let mut future = pin!(future);
        let mut context = Context::from_waker(Waker::noop());
        loop {
            forget_timers();
            if let Poll::Ready(value) = future.as_mut().poll(&mut context) {
                return Some(value);
            }
            while let Some(frame) = self.tx.next_sendable_frame() {
                // A frame that does not fit is lost, as on any wire; the future runs into its timeout.
                let _lost = frame.send_blocking(|bytes| {
                    if let Some(dump) = &mut self.dump {
                        dump.record(Direction::Out, bytes);
                    }
                    self.emergencies.sent(bytes);
                    self.socket.send(bytes).map_err(|_| Error::SendFrame)
                });
            }
            let now_ns = monotonic_ns();
            if now_ns >= until_ns {
                return None;
            }
            if let Some(bytes) = self.emergencies.take_again(now_ns) {
                if let Some(dump) = &mut self.dump {
                    dump.record(Direction::Out, bytes);
                }
                let _lost = self.socket.send(bytes);
            }
            let again_ns = self.emergencies.again_ns().unwrap_or(u64::MAX);
            let wait_ns = next_timer_ns()
                .min(until_ns)
                .min(again_ns)
                .saturating_sub(now_ns)
                .min(PATIENCE_NS);
            self.socket.wait(wait_ns);
            self.waited_ns += monotonic_ns() - now_ns;
            while let Some(frame) = self.socket.receive(&mut self.buffer) {
                if let Some(dump) = &mut self.dump {
                    dump.record(Direction::In, frame);
                }
                if self.emergencies.came(frame, monotonic_ns()) == Passage::Hold {
                    continue;
                }
                // Late frames of dropped futures, and other traffic.
                let _unknown = self.rx.receive_frame(frame);
            }
        }
    }
}
