//! A SyncManager, which controls the access to a range of process memory.

/// Number of SyncManagers of a controller.
pub(crate) const SYNC_MANAGERS: u16 = 8;
/// Bit 3 of the status: the mailbox is full.
pub(crate) const MAILBOX_FULL: u8 = 1 << 3;

/// The registers of one SyncManager, decoded (ETG.1000.4, section 6.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Channel {
    pub(crate) start: u16,
    pub(crate) length: u16,
    pub(crate) is_mailbox: bool,
    /// The MainDevice writes, the device reads.
    pub(crate) is_written_by_main: bool,
    /// Writes feed the watchdog.
    pub(crate) feeds_watchdog: bool,
    pub(crate) is_enabled: bool,
    pub(crate) repeat_request: bool,
}

impl Channel {
    pub(crate) fn decode(registers: &[u8]) -> Option<Self> {
        let &[s0, s1, l0, l1, control, _, activate, own] = registers else {
            return None;
        };
        Some(Self {
            start: u16::from_le_bytes([s0, s1]),
            length: u16::from_le_bytes([l0, l1]),
            is_mailbox: control & 3 == 2,
            is_written_by_main: control >> 2 & 3 == 1,
            feeds_watchdog: control >> 6 & 1 == 1,
            // The device may also deactivate it.
            is_enabled: activate & 1 == 1 && own & 1 == 0,
            repeat_request: activate >> 1 & 1 == 1,
        })
    }

    pub(crate) fn overlaps(&self, address: u16, length: usize) -> bool {
        let (begin, end) = (
            usize::from(self.start),
            usize::from(self.start) + usize::from(self.length),
        );
        self.is_enabled
            && self.length > 0
            && usize::from(address) < end
            && begin < usize::from(address) + length
    }
}

/// Result of an access by the MainDevice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    /// Refused; the working counter does not increment.
    Refused,
    /// Go on.
    Granted,
    /// Granted, and the buffer or mailbox has been read or written completely.
    Completed,
}

/// State of a SyncManager.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct SyncManager {
    /// A mailbox holds a message.
    pub(crate) is_full: bool,
    /// The MainDevice has accessed the first byte but not the last.
    is_open: bool,
    pub(crate) repeat_acknowledged: bool,
}

impl SyncManager {
    /// Handles an access of the MainDevice to bytes of this channel. A sequence begins with the first byte
    /// and ends with the last.
    pub(crate) fn access(&mut self, channel: &Channel, address: u16, length: usize, writes: bool) -> Access {
        if writes != channel.is_written_by_main {
            return Access::Refused;
        }
        // A mailbox can be written when empty and read when full.
        if channel.is_mailbox && self.is_full == writes {
            return Access::Refused;
        }
        let begins = address <= channel.start;
        if !begins && !self.is_open {
            return Access::Refused;
        }
        let end = usize::from(channel.start) + usize::from(channel.length);
        if usize::from(address) + length < end {
            self.is_open = true;
            return Access::Granted;
        }
        self.is_open = false;
        if channel.is_mailbox {
            self.is_full = writes;
        }
        Access::Completed
    }

    /// The status register.
    pub(crate) const fn status(self) -> u8 {
        if self.is_full { MAILBOX_FULL } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel(control: u8) -> Channel {
        Channel::decode(&[0x00, 0x10, 0x80, 0x00, control, 0, 1, 0]).expect("eight bytes")
    }

    #[test]
    fn a_mailbox_takes_one_message_until_it_is_read() {
        let (channel, mut manager) = (channel(0x26), SyncManager::default());
        assert_eq!(manager.access(&channel, 0x1000, 10, true), Access::Granted);
        assert_eq!(manager.access(&channel, 0x107F, 1, true), Access::Completed);
        assert!(manager.is_full);
        assert_eq!(manager.access(&channel, 0x1000, 128, true), Access::Refused);
        assert_eq!(manager.access(&channel, 0x1000, 128, false), Access::Refused);
    }

    #[test]
    fn an_access_begins_with_the_first_byte() {
        let (channel, mut manager) = (channel(0x24), SyncManager::default());
        assert_eq!(manager.access(&channel, 0x1001, 127, true), Access::Refused);
        assert_eq!(manager.access(&channel, 0x1000, 128, true), Access::Completed);
    }
}
