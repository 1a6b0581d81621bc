//! Emergency messages of devices (CoE, ETG.1000.6, 5.6.4), removed from the wire before ethercrab receives
//! them.
//!
//! A device puts an emergency message into the mailbox in which its reply to an object is expected. ethercrab
//! 0.7 treats any message there as the reply, and asserts that it is no emergency message.
//! [`EmergencyFilter`] records the message and reads the mailbox again until the reply is there:
//!
//! ```text
//!   ethercrab ── request ──► device
//!             ── read ─────►        ◄── emergency   recorded, not passed on
//!               filter ── read ──►  ◄── empty        again, a millisecond later
//!               filter ── read ──►  ◄── reply        passed on
//! ```

/// Header of Ethernet and of EtherCAT.
const DATAGRAM: usize = 16;
/// Header of a datagram.
const DATA: usize = DATAGRAM + 10;
/// Commands of datagrams: read and write by station address.
const FPRD: u8 = 4;
const FPWR: u8 = 5;
/// Start of the memory with the mailboxes, after the registers.
const MEMORY: u16 = 0x1000;
/// Header of the mailbox, of CoE, and an emergency: error code, error register, 5 bytes of data.
const EMERGENCY_BYTES: usize = 6 + 2 + 8;
const COE: u8 = 3;
const EMERGENCY: u8 = 1;
/// Interval between readings of an empty mailbox, ns.
const AGAIN_NS: u64 = 1_000_000;
/// Maximum number of different messages kept until they are reported.
const MAX_KEPT: usize = 32;
/// Longest frame.
const FRAME: usize = 1600;

/// An emergency message of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Emergency {
    /// Station address of the device.
    pub(crate) station: u16,
    /// Error code, as in object 603Fh.
    pub(crate) code: u16,
    /// Error register, object 1001h.
    pub(crate) register: u8,
}

/// One frame with one datagram.
struct Datagram<'a> {
    command: u8,
    station: u16,
    address: u16,
    data: &'a [u8],
    working_counter: u16,
}

impl<'a> Datagram<'a> {
    /// The only datagram of a frame; `None` if there are several, or if it is truncated.
    fn of(frame: &'a [u8]) -> Option<Self> {
        let header = frame.get(DATAGRAM..DATA)?;
        let word = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
        let (length, more) = (usize::from(word(6) & 0x07FF), word(6) & 0x8000 != 0);
        let counter = frame.get(DATA + length..DATA + length + 2)?;
        (!more).then_some(Self {
            command: header[0],
            station: word(2),
            address: word(4),
            data: &frame[DATA..DATA + length],
            working_counter: u16::from_le_bytes([counter[0], counter[1]]),
        })
    }

    /// Whether it writes or reads a mailbox.
    const fn is_of_mailbox(&self, command: u8) -> bool {
        self.command == command && self.address >= MEMORY && self.data.len() >= EMERGENCY_BYTES
    }

    fn emergency(&self) -> Option<Emergency> {
        let data = self.data;
        let is_emergency = self.working_counter > 0 && data[5] & 0x0F == COE && data[7] >> 4 == EMERGENCY;
        is_emergency.then(|| Emergency {
            station: self.station,
            code: u16::from_le_bytes([data[8], data[9]]),
            register: data[10],
        })
    }
}

/// Treatment of a received frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Passage {
    /// Passed on to ethercrab.
    Pass,
    /// Withheld from ethercrab; the mailbox is read again.
    Hold,
}

/// Examines every frame in both directions. Does not allocate.
pub(crate) struct EmergencyFilter {
    /// Station that has a request for an object and has not replied.
    asked: Option<u16>,
    /// The last frame that reads that station's mailbox.
    read: [u8; FRAME],
    read_bytes: usize,
    /// Time at which this frame is sent again.
    again_ns: Option<u64>,
    /// An emergency message arrived instead of the reply.
    is_waiting: bool,
    kept: [Option<Emergency>; MAX_KEPT],
}

impl EmergencyFilter {
    pub(crate) const fn new() -> Self {
        Self {
            asked: None,
            read: [0; FRAME],
            read_bytes: 0,
            again_ns: None,
            is_waiting: false,
            kept: [None; MAX_KEPT],
        }
    }

    /// Examines a frame to be sent.
    pub(crate) fn sent(&mut self, frame: &[u8]) {
        let Some(datagram) = Datagram::of(frame) else {
            return;
        };
        if datagram.is_of_mailbox(FPWR) {
            self.asked = (datagram.data[5] & 0x0F == COE).then_some(datagram.station);
        } else if datagram.is_of_mailbox(FPRD) && self.asked == Some(datagram.station) {
            let bytes = frame.len().min(FRAME);
            self.read[..bytes].copy_from_slice(&frame[..bytes]);
            self.read_bytes = bytes;
        } else {
            return;
        }
        (self.is_waiting, self.again_ns) = (false, None);
    }

    /// Examines a received frame.
    pub(crate) fn came(&mut self, frame: &[u8], now_ns: u64) -> Passage {
        let Some(datagram) = Datagram::of(frame).filter(|datagram| datagram.is_of_mailbox(FPRD)) else {
            return Passage::Pass;
        };
        let is_asked = self.asked == Some(datagram.station);
        if let Some(emergency) = datagram.emergency() {
            self.keep(emergency);
            if !is_asked {
                // ethercrab empties a mailbox before a request, whatever it contains.
                return Passage::Pass;
            }
            (self.is_waiting, self.again_ns) = (true, Some(now_ns));
            return Passage::Hold;
        }
        if is_asked && self.is_waiting && datagram.working_counter == 0 {
            self.again_ns = Some(now_ns + AGAIN_NS);
            return Passage::Hold;
        }
        if is_asked {
            (self.asked, self.is_waiting, self.again_ns) = (None, false, None);
        }
        Passage::Pass
    }

    /// Time at which a mailbox is to be read again.
    pub(crate) const fn again_ns(&self) -> Option<u64> {
        self.again_ns
    }

    /// Returns the frame that reads the mailbox again, if it is due.
    pub(crate) fn take_again(&mut self, now_ns: u64) -> Option<&[u8]> {
        self.again_ns.filter(|at_ns| *at_ns <= now_ns)?;
        self.again_ns = None;
        Some(&self.read[..self.read_bytes])
    }

    /// Devices repeat messages: each is kept once.
    fn keep(&mut self, emergency: Emergency) {
        if self.kept.contains(&Some(emergency)) {
            return;
        }
        if let Some(free) = self.kept.iter_mut().find(|kept| kept.is_none()) {
            *free = Some(emergency);
        }
    }

    /// The messages received.
    pub(crate) fn kept(&self) -> impl Iterator<Item = Emergency> + '_ {
        self.kept.iter().flatten().copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(command: u8, station: u16, address: u16, data: &[u8], working_counter: u16) -> Vec<u8> {
        let mut frame = vec![0xFF; 12];
        frame.extend([0x88, 0xA4, 0, 0x10, command, 3]);
        frame.extend(station.to_le_bytes());
        frame.extend(address.to_le_bytes());
        frame.extend((data.len() as u16).to_le_bytes());
        frame.extend([0, 0]);
        frame.extend(data);
        frame.extend(working_counter.to_le_bytes());
        frame
    }

    /// A mailbox with CoE data of this service.
    fn mailbox(service: u8) -> Vec<u8> {
        let mut data = vec![
            10,
            0,
            0,
            0,
            0,
            0x13,
            0,
            service << 4,
            0x21,
            0x71,
            0x04,
            0,
            0,
            0,
            0,
            0,
        ];
        data.resize(128, 0);
        data
    }

    const BLOCKED: Emergency = Emergency {
        station: 0x1002,
        code: 0x7121,
        register: 4,
    };

    #[test]
    fn early_emergency_is_kept_and_mailbox_emptied() {
        let mut filter = EmergencyFilter::new();
        filter.sent(&frame(FPRD, 0x1002, 0x1080, &[0; 128], 0));
        let came = frame(FPRD, 0x1002, 0x1080, &mailbox(1), 1);
        assert_eq!(filter.came(&came, 5), Passage::Pass);
        assert_eq!(filter.again_ns(), None);
        assert_eq!(filter.kept().collect::<Vec<_>>(), [BLOCKED]);
    }

    #[test]
    fn emergencies_before_reply_are_kept() {
        let mut filter = EmergencyFilter::new();
        let read = frame(FPRD, 0x1002, 0x1080, &[0; 128], 0);
        filter.sent(&frame(FPWR, 0x1002, 0x1000, &mailbox(2), 0));
        filter.sent(&read);
        for _ in 0..2 {
            let came = frame(FPRD, 0x1002, 0x1080, &mailbox(1), 1);
            assert_eq!(filter.came(&came, 5), Passage::Hold);
            assert_eq!(filter.take_again(5).expect("at once"), read);
            let empty = frame(FPRD, 0x1002, 0x1080, &[0; 128], 0);
            assert_eq!(filter.came(&empty, 5), Passage::Hold);
            assert_eq!(filter.take_again(5), None, "a millisecond later");
            assert_eq!(filter.take_again(5 + AGAIN_NS).expect("then"), read);
        }
        let reply = frame(FPRD, 0x1002, 0x1080, &mailbox(3), 1);
        assert_eq!(filter.came(&reply, 5), Passage::Pass);
        assert_eq!(filter.take_again(u64::MAX), None);
        assert_eq!(filter.kept().count(), 1, "each is kept once");
        // The mailbox of a device without a message: handled by ethercrab.
        let empty = frame(FPRD, 0x1002, 0x1080, &[0; 128], 0);
        assert_eq!(filter.came(&empty, 5), Passage::Pass);
    }

    #[test]
    fn other_frames_pass_whatever_is_in_them() {
        let mut filter = EmergencyFilter::new();
        filter.sent(&frame(FPWR, 0x1002, 0x1000, &mailbox(2), 0));
        // Another device, a register, a mailbox that is too short, and truncated frames.
        let whole = frame(FPRD, 0x1003, 0x1080, &mailbox(3), 1);
        assert_eq!(filter.came(&whole, 5), Passage::Pass);
        for came in [
            frame(FPRD, 0x1002, 0x0130, &mailbox(1), 1),
            frame(FPRD, 0x1002, 0x1080, &mailbox(1)[..15], 1),
            frame(12, 0x1002, 0x1080, &mailbox(1), 1),
        ] {
            assert_eq!(filter.came(&came, 5), Passage::Pass);
        }
        for bytes in 0..whole.len() {
            assert_eq!(filter.came(&whole[..bytes], 5), Passage::Pass);
            filter.sent(&whole[..bytes]);
        }
        assert_eq!(filter.kept().count(), 0);
    }
}
