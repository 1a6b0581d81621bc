//! The AL state machine: INIT, PRE-OP, SAFE-OP, OP.

/// States, by their numbers in AL control and AL status.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AlState {
    /// No mailbox, no process data.
    Init = 1,
    /// Mailbox.
    PreOp = 2,
    /// Mailbox and inputs.
    SafeOp = 4,
    /// Mailbox, inputs and outputs.
    Op = 8,
}

impl AlState {
    /// The state with this number; `None` for bootstrap, which no device here supports, and for unknown
    /// numbers.
    #[must_use]
    pub const fn from_number(number: u8) -> Option<Self> {
        match number {
            1 => Some(Self::Init),
            2 => Some(Self::PreOp),
            4 => Some(Self::SafeOp),
            8 => Some(Self::Op),
            _ => None,
        }
    }
}

/// AL status codes (ETG.1020) that these devices report.
pub mod status_code {
    /// Invalid requested state change.
    pub const INVALID_CHANGE: u16 = 0x0011;
    /// Unknown requested state.
    pub const UNKNOWN_STATE: u16 = 0x0012;
    /// Bootstrap not supported.
    pub const NO_BOOTSTRAP: u16 = 0x0013;
    /// The SyncManagers of the mailbox are wrong.
    pub const MAILBOX_CONFIGURATION: u16 = 0x0016;
    /// No valid outputs were received.
    pub const NO_VALID_OUTPUTS: u16 = 0x0019;
    /// The watchdog of the process data has expired.
    pub const WATCHDOG: u16 = 0x001B;
    /// The SyncManager of the outputs is wrong.
    pub const OUTPUT_CONFIGURATION: u16 = 0x001D;
    /// The SyncManager of the inputs is wrong.
    pub const INPUT_CONFIGURATION: u16 = 0x001E;
    /// The assigned inputs cannot be mapped.
    pub const INPUT_MAPPING: u16 = 0x0024;
    /// SYNC0 is requested and does not occur.
    pub const NO_SYNC: u16 = 0x002D;
    /// The device does not support the period.
    pub const SYNC_CYCLE_TIME: u16 = 0x0035;
    /// The device does not support the period of SYNC0.
    pub const SYNC_CYCLE: u16 = 0x0036;
}

/// Time for which a device waits for outputs before OP, ns.
const OUTPUTS_TIMEOUT_NS: u64 = 2_000_000_000;

/// Result of the device's check of a requested higher state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Check {
    Fine,
    /// Wait: outputs must be received first.
    Wait,
    Wrong(u16),
}

/// State and last error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ApplicationLayer {
    state: AlState,
    code: u16,
    waiting_since_ns: Option<u64>,
}

impl ApplicationLayer {
    pub(crate) const fn new() -> Self {
        Self {
            state: AlState::Init,
            code: 0,
            waiting_since_ns: None,
        }
    }

    pub(crate) const fn state(&self) -> AlState {
        self.state
    }

    /// AL status: the state, bit 4 for an error.
    pub(crate) const fn status(&self) -> u16 {
        self.state as u16 | if self.code == 0 { 0 } else { 1 << 4 }
    }

    pub(crate) const fn code(&self) -> u16 {
        self.code
    }

    pub(crate) const fn is_waiting(&self) -> bool {
        self.waiting_since_ns.is_some()
    }

    /// Changes to a lower state without a request.
    pub(crate) fn fall_to(&mut self, state: AlState, code: u16) {
        self.state = self.state.min(state);
        self.code = code;
        self.waiting_since_ns = None;
    }

    /// Handles a write of AL control, or a change to OP that is still pending. `check` returns whether the
    /// device may enter a state.
    pub(crate) fn request(&mut self, control: u16, now_ns: u64, check: impl FnOnce(AlState) -> Check) {
        let acknowledges = control >> 4 & 1 == 1;
        let number = (control & 0x0F) as u8;
        let Some(wanted) = AlState::from_number(number) else {
            self.code = if number == 3 {
                status_code::NO_BOOTSTRAP
            } else {
                status_code::UNKNOWN_STATE
            };
            return;
        };
        if acknowledges {
            self.code = 0;
        } else if self.code != 0 && wanted >= self.state && wanted != AlState::Init {
            // An error must be acknowledged before any change other than to a lower state.
            return;
        }
        if wanted <= self.state {
            self.state = wanted;
            self.code = 0;
            self.waiting_since_ns = None;
            return;
        }
        let is_next = matches!(
            (self.state, wanted),
            (AlState::Init, AlState::PreOp)
                | (AlState::PreOp, AlState::SafeOp)
                | (AlState::SafeOp, AlState::Op)
        );
        if !is_next {
            self.code = status_code::INVALID_CHANGE;
            return;
        }
        match check(wanted) {
            Check::Fine => {
                self.state = wanted;
                self.code = 0;
                self.waiting_since_ns = None;
            }
            Check::Wait => {
                let since_ns = *self.waiting_since_ns.get_or_insert(now_ns);
                if now_ns.saturating_sub(since_ns) > OUTPUTS_TIMEOUT_NS {
                    self.code = status_code::NO_VALID_OUTPUTS;
                    self.waiting_since_ns = None;
                }
            }
            Check::Wrong(code) => {
                self.code = code;
                self.waiting_since_ns = None;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn states_are_sequential_and_errors_acknowledged() {
        let mut layer = ApplicationLayer::new();
        layer.request(8, 0, |_| Check::Fine);
        assert_eq!(
            (layer.status(), layer.code()),
            (0x11, status_code::INVALID_CHANGE)
        );
        layer.request(2, 0, |_| Check::Fine);
        assert_eq!(layer.status(), 0x11, "not without an acknowledgement");
        layer.request(0x12, 0, |_| Check::Fine);
        assert_eq!(layer.status(), 0x02);
        layer.request(4, 0, |_| Check::Wrong(status_code::INPUT_CONFIGURATION));
        assert_eq!((layer.status(), layer.code()), (0x12, 0x1E));
        layer.request(0x14, 0, |_| Check::Fine);
        layer.request(8, 0, |_| Check::Wait);
        assert_eq!((layer.status(), layer.is_waiting()), (0x04, true));
        layer.request(8, 3_000_000_000, |_| Check::Wait);
        assert_eq!(
            (layer.status(), layer.code()),
            (0x14, status_code::NO_VALID_OUTPUTS)
        );
        layer.request(1, 0, |_| Check::Fine);
        assert_eq!(layer.status(), 0x01);
    }
}
