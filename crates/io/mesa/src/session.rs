//! One session with a board: setup, cycle, and the reason of its end.

use core::sync::atomic::{AtomicU64, Ordering};
use core::time::Duration;

use evolvent_bridge::{BusEnds, Incoming, monotonic_ns};
use evolvent_bus::AXES;
use evolvent_drive::{GantryEvent, GantryFault, SettingsError};
use evolvent_machine::Machine;
use thiserror::Error;

use crate::axis_set::AxisSet;
use crate::board_file::MAX_WATCHDOG_MS;
use crate::board_settings::BoardSettings;
use crate::clock::sleep_until;
use crate::description::Description;
use crate::fit::max_velocity;
use crate::link::{Link, LinkError};
use crate::packet::{MAX_PACKET, Packet, PacketFull, Reply};
use crate::plan::{INDEX_SLOTS, Inputs, Outputs, Plan, PlanError};
use crate::signals::Signals;
use crate::smart_serial::{MAX_REMOTES, RemoteError, SmartSerial};
use crate::spindle::{SpindleNotice, SpindleSet};

/// Time for axes to stop at the end of a session, ns.
const STOP_NS: u64 = 1_500_000_000;
/// Periods for which a fault is reported to the core before the feedback ends.
const TELL: u64 = 20;
/// Fraction of a period within which a reply must arrive.
const REPLY: (u64, u64) = (6, 10);

/// Why a session did not start, or why it ended.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SessionError {
    /// The board does not reply, or is not a HostMot2 board.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The board does not support its board file.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A limit of the machine is invalid.
    #[error(transparent)]
    Limits(#[from] SettingsError),
    /// The registers exceed a packet.
    #[error(transparent)]
    Full(#[from] PacketFull),
    /// Replies no longer arrive.
    #[error("{packets} packets in a row did not return in time: check cable, supply and network interface")]
    Lost {
        /// How many.
        packets: u32,
    },
    /// Written packets did not arrive.
    #[error("{packets} packets in a row did not reach the board: check cable and network interface")]
    Unheard {
        /// How many.
        packets: u32,
    },
    /// The watchdog of the board has released its pins.
    #[error(
        "the board's watchdog has tripped: no packet arrived for {watchdog_ms:.0} ms; check what suspended \
         this computer's processes (`evolvent doctor`), or permit more (watchdog_ms; after {most_ms:.0} ms \
         without a reading the axes have to be homed in any case)"
    )]
    Bitten {
        /// Its time.
        watchdog_ms: f64,
        /// The time after which a counter may have turned over.
        most_ms: f64,
    },
    /// A counter was not read for so long that it may have wrapped unnoticed.
    #[error(
        "{what} {unit} was not read for {gap_ms:.0} ms, and at full speed its position is unknown after \
         {most_ms:.0} ms: home again, and check what suspended this computer's processes (`evolvent \
         doctor`)"
    )]
    Unread {
        /// Encoder or step generator.
        what: &'static str,
        /// Its number.
        unit: usize,
        /// How long.
        gap_ms: f64,
        /// How long it may be.
        most_ms: f64,
    },
    /// A smart-serial device cannot be used.
    #[error(transparent)]
    Remote(#[from] RemoteError),
    /// A smart-serial device has failed too often in a row.
    #[error("{device} on smart serial: {what}, {times} times in a row: check its cable and its supply")]
    RemoteLost {
        /// The device.
        device: String,
        /// The failure.
        what: &'static str,
        /// Failed exchanges in a row.
        times: u32,
    },
    /// The board has restarted, or another host writes to it.
    #[error(
        "the board no longer has this session: it has restarted after a loss of its supply, or another \
         program writes to it"
    )]
    Restarted,
}

/// Events of a session for the user.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Notice {
    /// The board is set up.
    Operational,
    /// A drive is in fault; `is_second`: it is the second of a gantry.
    DriveFault { axis: usize, is_second: bool, code: u16 },
    /// The motors of a gantry have to stop.
    Gantry { axis: usize, fault: GantryFault },
    /// A spindle, by its number.
    Spindle { number: usize, notice: SpindleNotice },
    /// A gantry was homed by its switches, and its second motor was this far from square.
    Squared { axis: usize, by: f64 },
}

/// Counters over all sessions.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    /// Number of times that the board was set up.
    pub(crate) ready: AtomicU64,
    pub(crate) cycles: AtomicU64,
    /// Replies that were late or lost.
    pub(crate) lost: AtomicU64,
    /// Writes that did not arrive.
    pub(crate) unheard: AtomicU64,
    /// Replies to packets other than the last one.
    pub(crate) stale: AtomicU64,
}

/// Bus endpoints and counters of a session.
pub(crate) struct Ends<'a, 'b> {
    pub(crate) bus: &'a mut BusEnds<'b, Notice>,
    pub(crate) counters: &'a Counters,
    /// Receives the computing time of each cycle, ns: without sleep, and without the wait for the reply.
    pub(crate) measure: Option<&'a mut dyn FnMut(u64)>,
}

/// Sets the board up and runs the cycle until the session ends; `Ok` if a stop was requested.
pub(crate) fn run_session(
    link: &Link,
    board: &Description,
    settings: &BoardSettings,
    machine: &Machine,
    ends: &mut Ends<'_, '_>,
) -> Result<(), SessionError> {
    let period_ns = ends.bus.period_ns.load(Ordering::Relaxed);
    let max_velocity: Vec<f64> = settings
        .axes
        .iter()
        .map(|axis| max_velocity(machine, settings, axis.axis))
        .collect();
    let serial = SmartSerial::discover(link, board, &settings.remotes)?;
    let max_rpm = machine.signals.max_rpm();
    let plan = Plan::new(
        board,
        settings,
        serial,
        &max_velocity,
        &max_rpm,
        period_ns as f64 * 1e-9,
    )?;
    let instance = monotonic_ns();
    // Never zero: a board that has just started reads zero.
    let session = (instance / 1000) as u16 | 1;
    let mut cycle = Cycle {
        link,
        settings,
        axes: AxisSet::new(machine, settings, period_ns, instance)?,
        signals: Signals::new(machine, settings, instance),
        spindles: SpindleSet::new(machine, settings, instance),
        awaited: [None; INDEX_SLOTS],
        plan,
        period_ns,
        session,
        outputs: Outputs::default(),
        packet: Packet::new(),
        buffer: [0; MAX_PACKET + 8],
        read_number: 0,
        write_number: 0,
        lost: 0,
        unheard: 0,
        failed: [0; MAX_REMOTES],
        reported: [0; 2 * AXES],
        was_apart: [false; AXES],
    };
    cycle.set_up()?;
    // Earlier messages are void: without a board the queue has kept the oldest ones.
    while ends.bus.incoming.pop().is_ok() {}
    ends.counters.ready.fetch_add(1, Ordering::Relaxed);
    let _full = ends.bus.notices.push(Notice::Operational);
    cycle.run(ends)
}

struct Cycle<'a> {
    link: &'a Link,
    settings: &'a BoardSettings,
    plan: Plan,
    axes: AxisSet,
    signals: Signals,
    spindles: SpindleSet,
    /// Encoders whose control registers the last reading contains.
    awaited: [Option<usize>; INDEX_SLOTS],
    period_ns: u64,
    session: u16,
    outputs: Outputs,
    packet: Packet,
    buffer: [u8; MAX_PACKET + 8],
    read_number: u16,
    write_number: u16,
    lost: u32,
    unheard: u32,
    /// Failed exchanges in a row, by smart-serial device.
    failed: [u32; MAX_REMOTES],
    /// Fault codes already reported, in the order of the board file's axes.
    reported: [u16; 2 * AXES],
    /// Axes whose gantry fault was reported.
    was_apart: [bool; AXES],
}

impl Cycle<'_> {
    fn set_up(&mut self) -> Result<(), SessionError> {
        // All outputs off, with the polarity of their pins.
        self.switch_off();
        for axis in self.axes.axes() {
            if let Some(pin) = axis.settings().enable {
                crate::axis_set::set(&self.plan, &mut self.outputs, pin, false);
            }
        }
        let packets = self.plan.set_up(self.settings, &self.outputs, self.session)?;
        let mut check = Packet::new();
        for packet in &packets {
            self.link.send(packet);
        }
        // A reading with the session number shows that all writes have arrived; otherwise they are repeated.
        let none = [None; INDEX_SLOTS];
        self.plan.read(&mut check, 0, &none)?;
        for attempt in 0..3 {
            let mut found = Inputs::default();
            let plan = &self.plan;
            self.link
                .request(&check, |reply| found = plan.take_reply(reply, &none))?;
            if found.session == self.session && !found.has_bitten {
                return Ok(());
            }
            if attempt < 2 {
                for packet in &packets {
                    self.link.send(packet);
                }
            }
        }
        Err(SessionError::Restarted)
    }

    fn run(&mut self, ends: &mut Ends<'_, '_>) -> Result<(), SessionError> {
        let mut next_ns = monotonic_ns() + self.period_ns;
        let mut ending: Option<(u64, Result<(), SessionError>)> = None;
        // The first write stores the number that the first reading must return.
        self.plan.write(&mut self.packet, &self.outputs, 0)?;
        self.link.send(&self.packet);
        loop {
            sleep_until(next_ns);
            let now_ns = next_ns;
            while let Ok(incoming) = ends.bus.incoming.pop() {
                match incoming {
                    Incoming::Setpoint(setpoint) => self.axes.offer(now_ns, &setpoint),
                    Incoming::Outputs(outputs) => self.signals.offer(now_ns, &outputs),
                    Incoming::OtherVersion => self.axes.refuse_version(),
                }
            }
            let outcome = self.cycle(now_ns, ends, ending.is_some());
            ends.counters.cycles.fetch_add(1, Ordering::Relaxed);
            if let Err(error) = outcome
                && ending.is_none()
            {
                // Axes that can still be commanded decelerate within their limits.
                self.axes.set_lost();
                self.end();
                ending = Some((now_ns, Err(error)));
            }
            let stop_requested = ends.bus.stop.load(Ordering::Relaxed)
                || ends.bus.period_ns.load(Ordering::Relaxed) != self.period_ns;
            if stop_requested && ending.is_none() {
                self.end();
                ending = Some((now_ns, Ok(())));
            }
            if let Some((since_ns, _)) = &ending {
                let passed_ns = now_ns.saturating_sub(*since_ns);
                let is_over =
                    passed_ns > STOP_NS || !self.axes.has_torque() && passed_ns > TELL * self.period_ns;
                if is_over && let Some((_, result)) = ending.take() {
                    self.give_back()?;
                    return result;
                }
            }
            next_ns += self.period_ns;
            let late_ns = monotonic_ns().saturating_sub(next_ns);
            if late_ns > self.period_ns {
                // Missed cycles are skipped.
                next_ns += late_ns / self.period_ns * self.period_ns;
            }
        }
    }

    /// Ends the session: axes stop and outputs are safe from the next command on; the axes keep their torque
    /// until they have stopped.
    const fn end(&mut self) {
        self.axes.end();
        self.signals.end();
    }

    /// Sets outputs to their safe values, then makes the pins inputs.
    fn give_back(&mut self) -> Result<(), SessionError> {
        self.switch_off();
        self.plan
            .write(&mut self.packet, &self.outputs, self.write_number)?;
        self.link.send(&self.packet);
        self.plan.release(&mut self.packet)?;
        self.link.send(&self.packet);
        Ok(())
    }

    /// Makes outputs safe and switches spindles off.
    fn switch_off(&mut self) {
        let _safe = self.signals.step(u64::MAX, &self.plan, &mut self.outputs);
        self.spindles.step(None, 0, &self.plan, &mut self.outputs);
        self.outputs.index = [None; INDEX_SLOTS];
    }

    /// Runs one period: read, compute, write.
    fn cycle(&mut self, now_ns: u64, ends: &mut Ends<'_, '_>, is_ending: bool) -> Result<(), SessionError> {
        let begin_ns = monotonic_ns();
        self.read_number = self.read_number.wrapping_add(1);
        self.awaited[0] = self.axes.awaited_encoder();
        self.spindles.watch(&mut self.awaited);
        self.plan
            .read(&mut self.packet, self.read_number, &self.awaited)?;
        self.link.send(&self.packet);
        let sent_ns = monotonic_ns();
        let mut waited_ns = 0;
        let found = self.collect(ends, sent_ns, &mut waited_ns);
        let judged = match found {
            Some((inputs, measured_ns)) => self.judge(&inputs, measured_ns, ends),
            None => self.miss(ends),
        };
        if let Err(error) = judged
            && !is_ending
        {
            // From here on the axes are lost, and decelerate.
            self.axes.set_lost();
            self.end();
            self.command(now_ns)?;
            return Err(error);
        }
        self.command(now_ns)?;
        let feedback = if is_ending {
            self.axes.lost_feedback(now_ns)
        } else if found.is_some() {
            self.axes.feedback()
        } else {
            None
        };
        // A sample that does not fit into the queue is replaced by the next.
        if let Some(feedback) = feedback {
            let _full = ends.bus.feedback.push(feedback);
        }
        if let Some((inputs, measured_ns)) = found
            && let Some(message) = self.signals.read(measured_ns, &self.plan, &inputs)
        {
            let _full = ends.bus.inputs.push(message);
        }
        if found.is_some() && !is_ending {
            for message in self.spindles.feedback() {
                let _full = ends.bus.spindles.push(message);
            }
        }
        self.tell_faults(ends);
        if let Some(measure) = &mut ends.measure {
            measure((monotonic_ns() - begin_ns).saturating_sub(waited_ns));
        }
        Ok(())
    }

    fn command(&mut self, now_ns: u64) -> Result<(), PacketFull> {
        self.axes.step(now_ns, &self.plan, &mut self.outputs);
        let wanted = self.signals.step(now_ns, &self.plan, &mut self.outputs);
        self.spindles
            .step(Some(&wanted), now_ns, &self.plan, &mut self.outputs);
        self.write_number = self.write_number.wrapping_add(1);
        self.plan
            .write(&mut self.packet, &self.outputs, self.write_number)?;
        self.link.send(&self.packet);
        Ok(())
    }

    /// Returns the reply to the last read packet, and the time at which the board executed it.
    fn collect(&mut self, ends: &Ends<'_, '_>, sent_ns: u64, waited_ns: &mut u64) -> Option<(Inputs, u64)> {
        let until_ns = sent_ns + self.period_ns * REPLY.0 / REPLY.1;
        loop {
            let before_ns = monotonic_ns();
            if let Some(bytes) = self.link.receive(&mut self.buffer) {
                if bytes.len() == self.packet.reply_bytes() {
                    let inputs = self.plan.take_reply(Reply::new(bytes), &self.awaited);
                    if inputs.read_number == self.read_number {
                        // Half of the round-trip time.
                        return Some((inputs, sent_ns + (before_ns - sent_ns) / 2));
                    }
                }
                ends.counters.stale.fetch_add(1, Ordering::Relaxed);
                continue;
            }
            let left_ns = until_ns.saturating_sub(before_ns);
            if left_ns == 0 {
                return None;
            }
            self.link.wait(Duration::from_nanos(left_ns));
            *waited_ns += monotonic_ns() - before_ns;
        }
    }

    fn judge(&mut self, inputs: &Inputs, measured_ns: u64, ends: &Ends<'_, '_>) -> Result<(), SessionError> {
        self.lost = 0;
        if inputs.session != self.session {
            return Err(SessionError::Restarted);
        }
        if inputs.has_bitten {
            return Err(SessionError::Bitten {
                watchdog_ms: self.settings.watchdog_s * 1e3,
                most_ms: (self.axes.longest_gap_s() * 1e3).min(MAX_WATCHDOG_MS),
            });
        }
        let read = self.axes.take(&self.plan, inputs, measured_ns);
        self.spindles.take(&self.plan, inputs, measured_ns);
        read?;
        self.judge_remotes(inputs)?;
        if inputs.write_number == self.write_number {
            self.unheard = 0;
            return Ok(());
        }
        ends.counters.unheard.fetch_add(1, Ordering::Relaxed);
        self.unheard += 1;
        if self.unheard > self.settings.max_lost_packets {
            return Err(SessionError::Unheard {
                packets: self.unheard,
            });
        }
        Ok(())
    }

    fn judge_remotes(&mut self, inputs: &Inputs) -> Result<(), SessionError> {
        let Some(serial) = self.plan.serial() else {
            return Ok(());
        };
        self.outputs.serial.is_free = serial.free_ports(&inputs.serial);
        for (i, device) in serial.remotes.iter().enumerate() {
            let Some(what) = serial.failure(i, &inputs.serial) else {
                self.failed[i] = 0;
                continue;
            };
            self.failed[i] += 1;
            if self.failed[i] > self.settings.max_lost_packets {
                return Err(SessionError::RemoteLost {
                    device: device.name.clone(),
                    what,
                    times: self.failed[i],
                });
            }
        }
        Ok(())
    }

    fn miss(&mut self, ends: &Ends<'_, '_>) -> Result<(), SessionError> {
        ends.counters.lost.fetch_add(1, Ordering::Relaxed);
        // The state of the last smart-serial exchange is unknown.
        self.outputs.serial.is_free = 0;
        self.lost += 1;
        if self.lost > self.settings.max_lost_packets {
            return Err(SessionError::Lost { packets: self.lost });
        }
        Ok(())
    }

    fn tell_faults(&mut self, ends: &mut Ends<'_, '_>) {
        for (number, notice) in self.spindles.take_news() {
            let _full = ends.bus.notices.push(Notice::Spindle { number, notice });
        }
        for GantryEvent { axis, fault, squared } in self.axes.take_gantry_events() {
            if let Some(fault) = fault.filter(|_| !self.was_apart[axis]) {
                let _full = ends.bus.notices.push(Notice::Gantry { axis, fault });
            }
            self.was_apart[axis] = fault.is_some();
            if let Some(by) = squared {
                let _full = ends.bus.notices.push(Notice::Squared { axis, by });
            }
        }
        for (axis, reported) in self.axes.axes().iter().zip(&mut self.reported) {
            let code = axis.error_code();
            if code != 0 && *reported != code {
                let _full = ends.bus.notices.push(Notice::DriveFault {
                    axis: axis.index(),
                    is_second: axis.settings().gantry.is_some(),
                    code,
                });
            }
            *reported = code;
        }
    }
}
