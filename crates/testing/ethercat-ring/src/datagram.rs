//! Ethernet frames with EtherCAT datagrams.

/// EtherCAT's Ethernet type.
pub(crate) const ETHER_TYPE: u16 = 0x88A4;
/// Ethernet header and EtherCAT header.
const HEADERS: usize = 16;
/// Header of a datagram; the working counter follows the data.
const DATAGRAM_HEADER: usize = 10;
/// Bit of an Ethernet address that marks it as locally administered. A controller sets it in the source
/// address of every frame.
const LOCAL_ADDRESS: u8 = 0x02;

/// Commands of datagrams (ETG.1000.4, section 5.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Command {
    Nothing,
    PositionRead,
    PositionWrite,
    PositionReadWrite,
    StationRead,
    StationWrite,
    StationReadWrite,
    BroadcastRead,
    BroadcastWrite,
    BroadcastReadWrite,
    LogicalRead,
    LogicalWrite,
    LogicalReadWrite,
    PositionReadMultipleWrite,
    StationReadMultipleWrite,
}

impl Command {
    const ALL: [Self; 15] = [
        Self::Nothing,
        Self::PositionRead,
        Self::PositionWrite,
        Self::PositionReadWrite,
        Self::StationRead,
        Self::StationWrite,
        Self::StationReadWrite,
        Self::BroadcastRead,
        Self::BroadcastWrite,
        Self::BroadcastReadWrite,
        Self::LogicalRead,
        Self::LogicalWrite,
        Self::LogicalReadWrite,
        Self::PositionReadMultipleWrite,
        Self::StationReadMultipleWrite,
    ];

    /// Whether each device increments the position as the datagram passes.
    pub(crate) const fn counts_position(self) -> bool {
        matches!(
            self,
            Self::PositionRead
                | Self::PositionWrite
                | Self::PositionReadWrite
                | Self::BroadcastRead
                | Self::BroadcastWrite
                | Self::BroadcastReadWrite
                | Self::PositionReadMultipleWrite
        )
    }
}

/// One datagram within a frame.
#[derive(Debug)]
pub(crate) struct Datagram<'a> {
    pub(crate) command: Command,
    address: &'a mut [u8; 4],
    pub(crate) data: &'a mut [u8],
    working_counter: &'a mut [u8; 2],
}

impl Datagram<'_> {
    /// Position or station address.
    pub(crate) fn position(&self) -> u16 {
        let [a, b, _, _] = *self.address;
        u16::from_le_bytes([a, b])
    }

    pub(crate) fn set_position(&mut self, position: u16) {
        let [low, high] = position.to_le_bytes();
        (self.address[0], self.address[1]) = (low, high);
    }

    /// Address within the device.
    pub(crate) fn offset(&self) -> u16 {
        let [_, _, a, b] = *self.address;
        u16::from_le_bytes([a, b])
    }

    pub(crate) fn logical(&self) -> u32 {
        u32::from_le_bytes(*self.address)
    }

    pub(crate) fn is_logical(&self) -> bool {
        matches!(
            self.command,
            Command::LogicalRead | Command::LogicalWrite | Command::LogicalReadWrite
        )
    }

    pub(crate) fn count(&mut self, by: u16) {
        let counter = u16::from_le_bytes(*self.working_counter).wrapping_add(by);
        *self.working_counter = counter.to_le_bytes();
    }
}

/// Whether a frame is an EtherCAT frame with datagrams.
pub(crate) fn is_ethercat(frame: &[u8]) -> bool {
    let header = frame.first_chunk::<HEADERS>();
    header.is_some_and(|header| header[12..14] == ETHER_TYPE.to_be_bytes() && header[15] >> 4 == 1)
}

/// Marks a frame as passed on by a device: a MainDevice discards frames with its own address.
pub(crate) fn mark_as_passed(frame: &mut [u8]) {
    if let Some(source) = frame.get_mut(6) {
        *source |= LOCAL_ADDRESS;
    }
}

/// Calls `call` for each datagram of a frame, in order. Stops at the end of a truncated frame.
pub(crate) fn for_each_datagram(frame: &mut [u8], mut call: impl FnMut(&mut Datagram<'_>)) {
    let Some((header, mut rest)) = frame.split_first_chunk_mut::<HEADERS>() else {
        return;
    };
    let length = usize::from(u16::from_le_bytes([header[14], header[15]]) & 0x07FF);
    if let Some(inside) = rest.get_mut(..length) {
        rest = inside;
    } else {
        return;
    }
    while let Some((header, behind)) = core::mem::take(&mut rest).split_first_chunk_mut::<DATAGRAM_HEADER>() {
        let [command, _, a0, a1, a2, a3, l0, l1, _, _] = header;
        let field = u16::from_le_bytes([*l0, *l1]);
        let size = usize::from(field & 0x07FF);
        if behind.len() < size + 2 {
            return;
        }
        let (data, behind) = behind.split_at_mut(size);
        let Some((working_counter, behind)) = behind.split_first_chunk_mut::<2>() else {
            return;
        };
        let mut address = [*a0, *a1, *a2, *a3];
        // An unknown command passes unchanged.
        let known = Command::ALL.get(usize::from(*command)).copied();
        let command = known.unwrap_or(Command::Nothing);
        // A circulating frame is not processed again.
        if field >> 14 & 1 == 0 {
            call(&mut Datagram {
                command,
                address: &mut address,
                data,
                working_counter,
            });
        }
        (*a0, *a1, *a2, *a3) = (address[0], address[1], address[2], address[3]);
        if field >> 15 & 1 == 0 {
            return;
        }
        rest = behind;
    }
}
