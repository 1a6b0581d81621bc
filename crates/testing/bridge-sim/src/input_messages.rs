//! Messages of the machine's inputs, those of the probe included.

use evolvent_bus::{InputSender, MachineInputs, MachineOutputs, Setpoint};

use crate::probe::SimProbe;

/// Interval between messages while the inputs do not change, ns.
const INPUTS_EVERY_NS: u64 = 5_000_000;

/// Returns the machine's inputs for the last setpoint and the outputs in force; called every period. The
/// bridge sets sequence number, time and instance of the message.
pub type Signalling = Box<dyn FnMut(Option<&Setpoint>, &MachineOutputs) -> MachineInputs>;

/// The newest message, and the source of the next one.
pub(crate) struct InputMessages {
    read: Signalling,
    instance: u64,
    sent: MachineInputs,
}

impl InputMessages {
    pub(crate) fn new(read: Signalling, instance: u64) -> Self {
        Self {
            read,
            instance,
            sent: MachineInputs::default(),
        }
    }

    /// Sends the inputs if they have changed or were sent too long ago. Returns the number of messages sent.
    pub(crate) fn send(
        &mut self,
        now_ns: u64,
        setpoint: Option<&Setpoint>,
        outputs: &MachineOutputs,
        mut probe: Option<&mut SimProbe>,
        sender: &mut InputSender,
    ) -> u64 {
        let mut count = 0;
        // Each change of the probe needs its own message.
        while let Some(probe) = &mut probe
            && probe.advance()
        {
            let message = self.message(setpoint, outputs, Some(probe));
            count += self.send_next(now_ns, message, sender);
        }
        let mut message = self.message(setpoint, outputs, probe.as_deref());
        (message.sequence, message.time_ns) = (self.sent.sequence, self.sent.time_ns);
        let is_old = now_ns.saturating_sub(self.sent.time_ns) >= INPUTS_EVERY_NS;
        if message != self.sent || is_old {
            count += self.send_next(now_ns, message, sender);
        }
        count
    }

    fn message(
        &mut self,
        setpoint: Option<&Setpoint>,
        outputs: &MachineOutputs,
        probe: Option<&SimProbe>,
    ) -> MachineInputs {
        let mut message = (self.read)(setpoint, outputs);
        if let Some(probe) = probe {
            probe.describe(&mut message);
        }
        (message.instance, message.outputs_sequence) = (self.instance, outputs.sequence);
        message
    }

    fn send_next(&mut self, now_ns: u64, mut message: MachineInputs, sender: &mut InputSender) -> u64 {
        (message.sequence, message.time_ns) = (self.sent.sequence + 1, now_ns);
        self.sent = message;
        u64::from(sender.send(&message).is_ok())
    }
}
