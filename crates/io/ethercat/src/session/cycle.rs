//! The cycle of a session in OP.

use core::sync::atomic::Ordering;

use ethercrab::error::Error;
use ethercrab::{Command, MainDevice, RegisterAddress};
use evolvent_bridge::{Incoming, monotonic_ns};
use evolvent_bus::AXES;
use evolvent_drive::GantryEvent;
use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec};

use super::error::{Notice, SessionError};
use super::start::Layouts;
use super::{Devices, Ends, FIRST_STATION, IMAGE, OPERATIONAL_NS, PHASE_GAIN, STOP_NS};
use crate::cycle_times::CycleTime;
use crate::drive_set::DriveSet;
use crate::homing::HomingProgress;
use crate::network::{MAX_DEVICES, Network};
use crate::pump::Pump;
use crate::reference_clock::ReferenceClock;
use crate::signal::NetworkInput;
use crate::signal_set::SignalSet;
use crate::spindle_drive::SpindleDrive;
use crate::time_driver::thread_ns;

/// Maximum time to find the device that does not exchange process data, ns: 64 round trips of 80 us.
const SEARCH_NS: u64 = 5_000_000;

pub(super) struct Exchanged {
    pub(super) working_counter: u16,
    /// Bit i set: device i is in OP.
    pub(super) operational: u32,
    /// The reference's time, as read from its register.
    pub(super) time_ns: Option<u64>,
}

pub(super) struct Cycle<'a, 'm> {
    pub(super) main: &'m MainDevice<'m>,
    pub(super) network: &'a Network,
    pub(super) devices: Devices,
    pub(super) layouts: Layouts,
    pub(super) drives: DriveSet,
    pub(super) signals: SignalSet,
    pub(super) spindles: Vec<SpindleDrive>,
    pub(super) period_ns: u64,
    pub(super) reference: ReferenceClock,
    /// Working counter of all devices.
    pub(super) expected: u16,
    pub(super) lost: u32,
    pub(super) short: u32,
    /// All devices have been in OP.
    pub(super) operational: bool,
    /// Bit i set: device i reports OP, and did not exchange process data when the working counter was short.
    pub(super) silent: u32,
    /// Progress of homing at the last check.
    pub(super) homing: [HomingProgress; MAX_DEVICES],
    /// Fault codes that were reported.
    pub(super) reported: [u16; MAX_DEVICES],
    pub(super) was_apart: [bool; AXES],
}

impl<'m> Cycle<'_, 'm> {
    pub(super) fn run(
        &mut self,
        pump: &mut Pump<'_, '_>,
        ends: &mut Ends<'_, '_>,
    ) -> Result<(), SessionError> {
        self.expected = self.count()?;
        // Setpoints sent while the network came up are void.
        while ends.bus.incoming.pop().is_ok() {}
        let begin_ns = monotonic_ns();
        let mut next_ns = begin_ns + self.period_ns;
        let mut ending: Option<(u64, Result<(), SessionError>)> = None;
        loop {
            sleep_until(next_ns);
            let (woken_ns, waited_ns) = (monotonic_ns(), pump.waited_ns());
            let processor_ns = ends.times.map_or(0, |_| thread_ns());
            let now_ns = next_ns;
            while let Ok(incoming) = ends.bus.incoming.pop() {
                match incoming {
                    Incoming::Setpoint(setpoint) => self.drives.offer(now_ns, &setpoint),
                    Incoming::Outputs(outputs) => self.signals.offer(now_ns, &outputs),
                    Incoming::OtherVersion => self.drives.refuse_version(),
                }
            }
            let outcome = self.cycle(pump, now_ns, ends);
            ends.counters.cycles.fetch_add(1, Ordering::Relaxed);
            let correction_ns = match outcome {
                Ok(correction_ns) => correction_ns,
                Err(error @ SessionError::Broken { .. }) => {
                    // Devices that still reply stop first.
                    self.drives.end();
                    self.signals.end();
                    ending.get_or_insert((now_ns, Err(error)));
                    0
                }
                Err(error) => return Err(error),
            };
            if !self.operational && now_ns.saturating_sub(begin_ns) > OPERATIONAL_NS {
                return Err(SessionError::State {
                    wanted: "OP",
                    states: String::new(),
                });
            }
            let stop_requested = ends.bus.stop.load(Ordering::Relaxed)
                || ends.bus.period_ns.load(Ordering::Relaxed) != self.period_ns;
            if stop_requested && ending.is_none() {
                self.drives.end();
                self.signals.end();
                ending = Some((now_ns, Ok(())));
            }
            if let Some((since_ns, _)) = &ending
                && (now_ns.saturating_sub(*since_ns) > STOP_NS
                    || !self.has_torque() && now_ns.saturating_sub(*since_ns) > 20 * self.period_ns)
                && let Some((_, result)) = ending.take()
            {
                return result;
            }
            if let Some(times) = ends.times.filter(|_| self.operational) {
                let whole_ns = monotonic_ns() - woken_ns;
                let capped = |ns: u64| u32::try_from(ns).unwrap_or(u32::MAX);
                times.take(CycleTime {
                    late_ns: capped(woken_ns.saturating_sub(next_ns)),
                    work_ns: capped(whole_ns.saturating_sub(pump.waited_ns() - waited_ns)),
                    whole_ns: capped(whole_ns),
                    processor_ns: capped(thread_ns() - processor_ns),
                });
            }
            next_ns = next_ns
                .wrapping_add(self.period_ns)
                .wrapping_add_signed(-correction_ns);
            let late_ns = monotonic_ns().saturating_sub(next_ns);
            if late_ns > self.period_ns {
                // Missed cycles are skipped.
                next_ns += late_ns / self.period_ns * self.period_ns;
            }
            self.observe_clocks(pump, next_ns, ends);
        }
    }

    /// Reports of the recording, and of the clocks. Reads the system time difference of a device if one is
    /// due, in the time left until the next cycle.
    fn observe_clocks(&self, pump: &mut Pump<'_, '_>, next_ns: u64, ends: &mut Ends<'_, '_>) {
        if !self.operational {
            return;
        }
        if let Some(trouble) = ends.recorded.take_trouble() {
            let _full = ends.bus.notices.push(Notice::Recording(trouble));
        }
        let now_ns = monotonic_ns();
        if let Some(figures) = ends.clocks.first_report(now_ns) {
            let _full = ends.bus.notices.push(Notice::Clocks { figures });
        }
        // A quarter of the period is enough for a frame, and another quarter is left to be asleep before the
        // next cycle.
        let until_ns = next_ns.saturating_sub(self.period_ns / 4);
        if now_ns + self.period_ns / 4 > until_ns {
            return;
        }
        if let Some(device) = ends.clocks.due(now_ns) {
            let register: u16 = RegisterAddress::DcSystemTimeDifference.into();
            let read = Command::fprd(FIRST_STATION + device as u16, register).receive::<u32>(self.main);
            let value = pump.complete(until_ns, read).and_then(Result::ok);
            ends.clocks.take_difference(device, value, now_ns);
        }
    }

    fn has_torque(&self) -> bool {
        self.drives.has_torque() || self.spindles.iter().any(SpindleDrive::has_torque)
    }

    /// The time of an angle whose frame is due at `now_ns`. Drives with clocks sample at SYNC0, half a period
    /// before the frame, and are at a target one and a half periods after it: half until SYNC0, one of
    /// interpolation. Without clocks they sample at the arrival of the frame and interpolate for a period.
    /// Threading needs the angle at the time at which the axes are at their setpoint.
    const fn sampled_ns(&self, now_ns: u64) -> u64 {
        let periods = if matches!(self.devices, Devices::Clocked(_)) {
            2
        } else {
            1
        };
        now_ns.saturating_sub(periods * self.period_ns)
    }

    /// Bit i set: there is a device i.
    fn all(&self) -> u32 {
        u32::MAX >> (32 - self.network.devices.len() as u32)
    }

    /// The working counter of a frame that reaches every device: 2 for outputs, 1 for inputs.
    fn count(&self) -> Result<u16, SessionError> {
        let mut expected = 0;
        let failed = |error: Error| SessionError::Main {
            doing: "reading process data",
            why: error.to_string(),
        };
        for (device, listed) in self.network.devices.iter().enumerate() {
            let outputs = (self.devices)
                .with_outputs(self.main, device, |image| image.len())
                .map_err(failed)?;
            let inputs = (self.devices)
                .with_inputs(self.main, device, |image| image.len())
                .map_err(failed)?;
            expected += 2 * u16::from(outputs > 0) + u16::from(inputs > 0);
            let read =
                |input: &NetworkInput| input.error_bit.map_or(0, |bit| bit + 1).max(input.channel.end());
            // Those of drives are bits of an object, which is known to be in the process data.
            let is_terminal = !listed.is_drive();
            let written = listed.outputs.iter().filter(|_| is_terminal);
            let was_read = listed.inputs.iter().filter(|_| is_terminal);
            let last = [
                (
                    "output",
                    written.map(|output| output.channel.end()).max(),
                    outputs,
                ),
                ("input", was_read.map(read).max(), inputs),
            ];
            for (direction, end, bytes) in last {
                let bits = 8 * bytes;
                if let Some(end) = end.filter(|end| *end as usize > bits) {
                    return Err(SessionError::SignalPlace {
                        name: listed.name.clone(),
                        direction,
                        bit: end - 1,
                        bits,
                    });
                }
            }
        }
        Ok(expected)
    }

    /// Runs one period. Returns the reduction of the next period to follow the reference clock, ns.
    fn cycle(
        &mut self,
        pump: &mut Pump<'_, '_>,
        now_ns: u64,
        ends: &mut Ends<'_, '_>,
    ) -> Result<i64, SessionError> {
        if self.operational {
            self.drives.step(now_ns);
            self.signals.step(now_ns);
        }
        self.write_outputs(now_ns).map_err(exchange_failed)?;
        let sent_ns = monotonic_ns();
        let answer = pump.complete(now_ns + self.period_ns * 9 / 10, self.devices.exchange(self.main));
        let Some(Ok(exchanged)) = answer else {
            self.count_lost_frame(ends)?;
            return Ok(0);
        };
        self.lost = 0;
        let known = self.known_inputs(&exchanged, pump).map_err(exchange_failed)?;
        self.read_inputs(known, now_ns).map_err(exchange_failed)?;
        let judged = self.judge(&exchanged, ends);
        if self.operational {
            self.publish(ends);
        }
        judged?;
        let Some(register) = exchanged.time_ns else {
            return Ok(0);
        };
        let time_ns = self.reference.take(register, monotonic_ns());
        let phase_ns = self.phase_ns(time_ns);
        if self.operational {
            ends.clocks.take_frame(sent_ns, time_ns, phase_ns);
        }
        // The difference is reduced gradually.
        Ok(phase_ns / PHASE_GAIN)
    }

    /// Writes what is in force to the outputs of every device.
    fn write_outputs(&mut self, now_ns: u64) -> Result<(), Error> {
        let is_silent = self.signals.is_silent(now_ns) || !self.operational;
        let fault_reset = self.drives.fault_reset();
        for (slot, device) in self.network.spindle_devices().enumerate() {
            let (wanted, layout) = (*self.signals.in_force(), self.layouts.spindles[slot]);
            let outputs = self.spindles[slot].outputs(&wanted, is_silent, fault_reset, now_ns);
            (self.devices).with_outputs(self.main, device, |image| layout.write(&outputs, image))?;
        }
        for (axis, device) in self.network.axis_devices().enumerate() {
            let (outputs, layout) = (self.drives.outputs(axis), self.layouts.axes[axis]);
            (self.devices).with_outputs(self.main, device, |image| layout.write(&outputs, image))?;
        }
        for (device, listed) in self.network.devices.iter().enumerate() {
            if !listed.outputs.is_empty() {
                (self.devices).with_outputs(self.main, device, |image| self.signals.write(device, image))?;
            }
        }
        Ok(())
    }

    /// Counts a frame that did not come back.
    fn count_lost_frame(&mut self, ends: &Ends<'_, '_>) -> Result<(), SessionError> {
        ends.counters
            .lost
            .fetch_add(u64::from(self.operational), Ordering::Relaxed);
        self.lost += 1;
        // While the network comes up, a busy host may be late.
        let patience = if self.operational {
            self.network.max_lost_cycles
        } else {
            1000
        };
        if self.lost > patience {
            return Err(SessionError::Lost { frames: self.lost });
        }
        Ok(())
    }

    /// Bit i set: the inputs of device i are valid. If a device is missing, the inputs of the others are; if
    /// none is missing and the working counter is short, it is unknown whose inputs are invalid.
    fn known_inputs(&mut self, exchanged: &Exchanged, pump: &mut Pump<'_, '_>) -> Result<u32, Error> {
        let all = self.all();
        if exchanged.working_counter == self.expected {
            return Ok(all);
        }
        let is_last = self.operational && self.short == self.network.max_lost_cycles;
        if is_last && exchanged.operational & all == all {
            self.silent = self.find_silent(pump)?;
        }
        let lost = !exchanged.operational & all | self.silent;
        Ok(if lost == 0 { 0 } else { !lost })
    }

    /// Takes the inputs of every device; those of devices outside `known` are unknown.
    fn read_inputs(&mut self, known: u32, now_ns: u64) -> Result<(), Error> {
        let is_known = |device: usize| known >> device & 1 == 1;
        for (axis, device) in self.network.axis_devices().enumerate() {
            let layout = self.layouts.axes[axis];
            let inputs = (self.devices).with_inputs(self.main, device, |image| layout.read(image))?;
            if is_known(device) {
                self.drives.take(now_ns, axis, inputs);
            }
        }
        for (device, listed) in self.network.devices.iter().enumerate() {
            if !listed.inputs.is_empty() {
                let signals = &mut self.signals;
                self.devices.with_inputs(self.main, device, |image| {
                    signals.read(device, is_known(device).then_some(image));
                })?;
            }
        }
        let sampled_ns = self.sampled_ns(now_ns);
        for (slot, device) in self.network.spindle_devices().enumerate() {
            let layout = self.layouts.spindles[slot];
            let inputs = (self.devices).with_inputs(self.main, device, |image| layout.read(image))?;
            if is_known(device) {
                self.spindles[slot].take(inputs, sampled_ns);
            }
        }
        Ok(())
    }

    /// Sends the messages of this period to the core. One that does not fit is replaced by the next.
    fn publish(&mut self, ends: &mut Ends<'_, '_>) {
        for message in self.spindles.iter_mut().filter_map(SpindleDrive::feedback) {
            let _full = ends.bus.spindles.push(message);
        }
        if let Some(feedback) = self.drives.feedback(monotonic_ns()) {
            let _full = ends.bus.feedback.push(feedback);
        }
        let read_ns = monotonic_ns();
        self.signals.read_probe(&self.drives.probe(), read_ns);
        if let Some(message) = self.signals.message(read_ns) {
            let _full = ends.bus.inputs.push(message);
        }
    }

    /// Finds devices that do not exchange process data: reads the inputs of each with a separate frame and,
    /// if all reply, writes the outputs with another. Takes one round trip per device, once: the drives are
    /// about to stop.
    fn find_silent(&self, pump: &mut Pump<'_, '_>) -> Result<u32, Error> {
        let (mut inputs, mut outputs) = ([0; MAX_DEVICES], [0; MAX_DEVICES]);
        for device in 0..self.network.devices.len() {
            inputs[device] = (self.devices).with_inputs(self.main, device, |image| image.len())?;
            outputs[device] = (self.devices).with_outputs(self.main, device, |image| image.len())?;
        }
        let search = async {
            let (mut silent, mut address, nothing) = (0, 0_u32, [0_u8; IMAGE]);
            for (device, bytes) in inputs.into_iter().enumerate().filter(|(_, bytes)| *bytes > 0) {
                // A device counts 1 for inputs that are read; nothing is written to them.
                let read = Command::lrw(address).with_wkc(1);
                let read = read.send_receive_slice(self.main, &nothing[..bytes]).await;
                silent |= u32::from(is_silent(read.map(drop))?) << device;
                address += bytes as u32;
            }
            // The outputs of all devices follow the inputs of all.
            for (device, bytes) in outputs.into_iter().enumerate().filter(|(_, bytes)| *bytes > 0) {
                if silent != 0 {
                    break;
                }
                // It counts 2 for outputs that are written: the same as in the frame of this cycle.
                let mut sent = nothing;
                (self.devices)
                    .with_outputs(self.main, device, |image| sent[..bytes].copy_from_slice(image))?;
                let written = Command::lrw(address).with_wkc(2);
                let written = written.send_receive_slice(self.main, &sent[..bytes]).await;
                silent |= u32::from(is_silent(written.map(drop))?) << device;
                address += bytes as u32;
            }
            Ok(silent)
        };
        // If there is no time it stays unknown, as when a frame is lost.
        Ok(pump
            .complete(monotonic_ns() + SEARCH_NS, search)
            .unwrap_or(Ok::<_, Error>(0))
            .unwrap_or(0))
    }

    fn judge(&mut self, exchanged: &Exchanged, ends: &mut Ends<'_, '_>) -> Result<(), SessionError> {
        let all = self.all();
        let is_whole = exchanged.operational & all == all && exchanged.working_counter == self.expected;
        if is_whole {
            (self.short, self.silent) = (0, 0);
            if !self.operational {
                self.operational = true;
                ends.counters.ready.fetch_add(1, Ordering::Relaxed);
                let clocks = matches!(self.devices, Devices::Clocked(_));
                if clocks {
                    let devices = 0..self.network.devices.len();
                    let clocked = devices.filter(|device| self.devices.has_clock(self.main, *device));
                    ends.clocks.begin(clocked, monotonic_ns());
                }
                let _full = ends.bus.notices.push(Notice::Operational { clocks });
                for note in &self.layouts.limits {
                    let _full = ends.bus.notices.push(Notice::Limit(*note));
                }
            }
            self.tell_faults(ends);
            return Ok(());
        }
        if !self.operational {
            return Ok(());
        }
        ends.counters.short.fetch_add(1, Ordering::Relaxed);
        self.short += 1;
        if self.short <= self.network.max_lost_cycles {
            return Ok(());
        }
        let is_first = self.short == self.network.max_lost_cycles + 1;
        if is_first {
            let (found, expected) = (exchanged.working_counter, self.expected);
            // Devices that have only left OP are named below.
            if found != expected {
                let _full = ends.bus.notices.push(Notice::Short { found, expected });
            }
        }
        // If all report OP and each exchanges process data individually, it is unknown whose data are
        // missing.
        let is_unknown = exchanged.operational & all == all && self.silent == 0;
        let (mut axis, mut spindle) = (0, 0);
        for (device, listed) in self.network.devices.iter().enumerate() {
            let (is_gone, is_silent) = (
                exchanged.operational >> device & 1 == 0,
                self.silent >> device & 1 == 1,
            );
            if is_first && is_gone {
                let _full = ends.bus.notices.push(Notice::DeviceLost { device });
            } else if is_first && is_silent {
                let _full = ends.bus.notices.push(Notice::DeviceSilent { device });
            }
            let is_lost = is_gone || is_silent || is_unknown;
            if listed.axis.is_some() {
                if is_lost {
                    self.drives.set_lost(axis);
                }
                axis += 1;
            }
            if listed.spindle.is_some() {
                if is_lost {
                    self.spindles[spindle].set_lost();
                }
                spindle += 1;
            }
        }
        Err(SessionError::Broken {
            states: String::new(),
        })
    }

    fn tell_faults(&mut self, ends: &mut Ends<'_, '_>) {
        for (number, notice) in self.spindles.iter_mut().filter_map(SpindleDrive::take_news) {
            let _full = ends.bus.notices.push(Notice::Spindle { number, notice });
        }
        for GantryEvent { axis, fault, squared } in self.drives.take_gantry_events() {
            if let Some(fault) = fault.filter(|_| !self.was_apart[axis]) {
                let _full = ends.bus.notices.push(Notice::Gantry { axis, fault });
            }
            self.was_apart[axis] = fault.is_some();
            if let Some(by) = squared {
                let _full = ends.bus.notices.push(Notice::Squared { axis, by });
            }
        }
        for (slot, axis) in self.drives.axes().iter().enumerate() {
            let (index, code) = (axis.index(), axis.error_code());
            if code != 0 && self.reported[slot] != code {
                let _full = ends.bus.notices.push(Notice::DriveFault { axis: index, code });
            }
            self.reported[slot] = code;
            let homing = axis.homing();
            if homing != self.homing[slot] {
                let ended = matches!(homing, HomingProgress::Done | HomingProgress::Failed);
                let runs = matches!(self.homing[slot], HomingProgress::Running(_));
                if ended && runs {
                    let found = homing == HomingProgress::Done;
                    let _full = ends.bus.notices.push(Notice::Homed { axis: index, found });
                }
                self.homing[slot] = homing;
            }
        }
    }

    /// Delay of a frame, ns. Frames pass the reference half a period after SYNC0, which occurs at whole
    /// periods of the system time.
    const fn phase_ns(&self, time_ns: u64) -> i64 {
        let half = self.period_ns / 2;
        let phase = (time_ns.wrapping_sub(half)) % self.period_ns;
        if phase > half {
            phase as i64 - self.period_ns as i64
        } else {
            phase as i64
        }
    }
}

fn exchange_failed(error: Error) -> SessionError {
    SessionError::Main {
        doing: "exchanging process data",
        why: error.to_string(),
    }
}

/// Whether a frame for one device came back without its count.
fn is_silent(result: Result<(), Error>) -> Result<bool, Error> {
    match result {
        Ok(()) => Ok(false),
        Err(Error::WorkingCounter { .. }) => Ok(true),
        Err(error) => Err(error),
    }
}

fn sleep_until(at_ns: u64) {
    let at = Timespec {
        tv_sec: (at_ns / 1_000_000_000) as i64,
        tv_nsec: (at_ns % 1_000_000_000) as i64,
    };
    // A signal ends the sleep early: the cycle is early once.
    let _interrupted = clock_nanosleep_absolute(ClockId::Monotonic, &at);
}
