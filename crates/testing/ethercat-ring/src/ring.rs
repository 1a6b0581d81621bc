//! A line of devices, and the path of frames through it.

use crate::application_layer::AlState;
use crate::controller::Passing;
use crate::datagram::{for_each_datagram, is_ethercat, mark_as_passed};
use crate::fault::{Fault, FaultKind};
use crate::subdevice::{SubDevice, Trouble};

/// Delay from one device to the next, ns: a port, a processing unit and a short cable. The return path has
/// the same delay.
pub const HOP_NS: u64 = 600;
/// Delay of the fault `delay`, ns.
const DELAY_NS: u64 = 5_000_000;
/// Maximum time that a frame waits to be overtaken, ns.
const OVERTAKE_NS: u64 = 2_000_000;

/// A returned frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Returned {
    /// Time of arrival, ns of the simulator's time.
    pub due_ns: u64,
    /// The frame.
    pub frame: Vec<u8>,
}

/// The complete ring. Deterministic: the same frames at the same times give the same replies.
#[derive(Clone, Debug)]
pub struct Ring {
    devices: Vec<SubDevice>,
    faults: Vec<Fault>,
    has_supply: Vec<bool>,
    /// Wires from outputs to inputs.
    wires: Vec<[usize; 2]>,
    operating_since_ns: Option<u64>,
    /// A frame that is to be overtaken.
    held: Option<Vec<u8>>,
    frames: u64,
}

impl Ring {
    /// Creates a ring whose devices are supplied from `now_ns` on.
    #[must_use]
    pub fn new(mut devices: Vec<SubDevice>, now_ns: u64) -> Self {
        for device in &mut devices {
            device.power_up(now_ns);
        }
        Self {
            has_supply: vec![true; devices.len()],
            devices,
            faults: Vec::new(),
            wires: Vec::new(),
            operating_since_ns: None,
            held: None,
            frames: 0,
        }
    }

    /// The devices in order.
    #[must_use]
    pub fn devices(&self) -> &[SubDevice] {
        &self.devices
    }

    /// One device, to change its inputs.
    pub fn device_mut(&mut self, position: usize) -> Option<&mut SubDevice> {
        self.devices.get_mut(position)
    }

    /// Wires the outputs of one terminal to the inputs of another, both digital or both analog.
    pub fn wire(&mut self, from: usize, to: usize) {
        self.wires.push([from, to]);
    }

    /// Number of frames received.
    #[must_use]
    pub const fn frames(&self) -> u64 {
        self.frames
    }

    /// First time at which all devices were in OP: time zero of the faults.
    #[must_use]
    pub const fn operating_since_ns(&self) -> Option<u64> {
        self.operating_since_ns
    }

    /// Adds a fault to the schedule.
    pub fn add_fault(&mut self, fault: Fault) {
        self.faults.push(fault);
    }

    /// Adds a fault that begins now, in any state of the devices.
    pub fn begin_fault(&mut self, now_ns: u64, kind: FaultKind, device: usize, duration_ns: Option<u64>) {
        let since_ns = *self.operating_since_ns.get_or_insert(now_ns);
        self.faults.push(Fault {
            kind,
            at_ns: now_ns.saturating_sub(since_ns),
            duration_ns,
            device,
        });
    }

    /// Ends all faults.
    pub fn clear_faults(&mut self) {
        self.faults.clear();
    }

    fn is_active(&self, kind: FaultKind, device: Option<usize>, now_ns: u64) -> bool {
        let Some(since_ns) = self.operating_since_ns else {
            return false;
        };
        self.faults.iter().any(|fault| {
            fault.kind == kind
                && device.is_none_or(|device| device == fault.device)
                && fault.is_active(now_ns.saturating_sub(since_ns))
        })
    }

    /// Advances the time.
    pub fn advance(&mut self, now_ns: u64) {
        if self.operating_since_ns.is_none()
            && !self.devices.is_empty()
            && self.devices.iter().all(|device| device.state() == AlState::Op)
        {
            self.operating_since_ns = Some(now_ns);
        }
        self.apply_faults(now_ns);
        for &[from, to] in &self.wires {
            let outputs = self.devices.get(from).and_then(SubDevice::as_terminal).cloned();
            let inputs = self.devices.get_mut(to).and_then(SubDevice::as_terminal_mut);
            if let (Some(outputs), Some(inputs)) = (outputs, inputs) {
                inputs.receive(&outputs);
            }
        }
        for (device, _) in self
            .devices
            .iter_mut()
            .zip(&self.has_supply)
            .filter(|(_, supplied)| **supplied)
        {
            device.advance(now_ns);
            // Watchdogs expire without frames.
            device.settle(now_ns);
        }
    }

    fn apply_faults(&mut self, now_ns: u64) {
        for position in 0..self.devices.len() {
            let is = |kind| self.is_active(kind, Some(position), now_ns);
            let (gone, trouble) = (
                is(FaultKind::Gone),
                Trouble {
                    ignores_logical: is(FaultKind::WorkingCounter),
                    ignores_reference: is(FaultKind::ClockFree),
                    aborts_sdo: is(FaultKind::SdoAbort),
                    answers_wrong: is(FaultKind::SdoWrong),
                    slow_mailbox: is(FaultKind::SlowMailbox),
                    sends_emergencies: is(FaultKind::Emergency),
                    refuses_safe_op: is(FaultKind::RefuseSafeOp),
                    refuses_op: is(FaultKind::RefuseOp),
                },
            );
            let fault = if is(FaultKind::Drive) {
                Some(0x2310)
            } else {
                is(FaultKind::Temperature).then_some(0x4310)
            };
            let (torque_off, blocked, limit, no_index) = (
                is(FaultKind::TorqueOff),
                is(FaultKind::Blocked),
                is(FaultKind::Limit),
                is(FaultKind::IndexMissing),
            );
            let device = &mut self.devices[position];
            device.trouble = trouble;
            if let Some(drive) = device.as_drive_mut() {
                drive.trouble = crate::drive::DriveTrouble {
                    fault,
                    torque_off,
                    blocked,
                    limit,
                    no_index,
                };
            }
            let supplied = core::mem::replace(&mut self.has_supply[position], !gone);
            if !supplied && !gone {
                device.power_up(now_ns);
            }
        }
        let reached = self.reached(now_ns);
        for (position, device) in self.devices.iter_mut().enumerate() {
            device.set_links(position + 1 < reached);
        }
    }

    /// Number of devices that frames reach.
    fn reached(&self, now_ns: u64) -> usize {
        let cuts = |position: &usize| {
            self.is_active(FaultKind::Break, Some(*position), now_ns)
                || self.is_active(FaultKind::Gone, Some(*position), now_ns)
        };
        (0..self.devices.len()).find(cuts).unwrap_or(self.devices.len())
    }

    /// Sends a frame through the ring. Returns the frames that come back with their times, if any.
    pub fn exchange(&mut self, now_ns: u64, mut frame: Vec<u8>) -> Vec<Returned> {
        self.advance(now_ns);
        if !is_ethercat(&frame) {
            return Vec::new();
        }
        self.frames += 1;
        let reached = self.reached(now_ns);
        let last = reached.saturating_sub(1) as u64;
        for (position, device) in self.devices.iter_mut().take(reached).enumerate() {
            let index = position as u64;
            let passing = Passing {
                now_ns: now_ns + index * HOP_NS,
                return_ns: (index < last).then_some(now_ns + (2 * last - index) * HOP_NS),
            };
            for_each_datagram(&mut frame, |datagram| device.process(datagram, passing));
            device.settle(passing.now_ns);
        }
        if reached == 0 || self.is_active(FaultKind::Loss, None, now_ns) {
            return Vec::new();
        }
        mark_as_passed(&mut frame);
        let due_ns = now_ns
            + if self.is_active(FaultKind::Delay, None, now_ns) {
                DELAY_NS
            } else {
                0
            };
        if !self.is_active(FaultKind::Reorder, None, now_ns) {
            let held = self.held.take().into_iter().chain([frame]);
            return held.map(|frame| Returned { due_ns, frame }).collect();
        }
        match self.held.take() {
            Some(held) => vec![Returned { due_ns, frame }, Returned { due_ns, frame: held }],
            None => {
                self.held = Some(frame);
                Vec::new()
            }
        }
    }

    /// Returns the frame that waits to be overtaken, if it has waited for too long.
    pub fn release(&mut self, waited_ns: u64) -> Option<Vec<u8>> {
        if waited_ns < OVERTAKE_NS {
            None
        } else {
            self.held.take()
        }
    }
}
