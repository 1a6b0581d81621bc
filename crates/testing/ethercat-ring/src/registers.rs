//! The memory of an EtherCAT SubDevice controller: registers below 1000h, process memory above.

/// Addresses of registers, as ETG.1000.4 (section 6) and Beckhoff's data sheet of the ET1100 name them.
pub mod address {
    /// Type of the controller.
    pub const TYPE: u16 = 0x0000;
    /// Station address that the MainDevice has configured.
    pub const STATION_ADDRESS: u16 = 0x0010;
    /// Station alias, from the SII.
    pub const STATION_ALIAS: u16 = 0x0012;
    /// DL control; bit 24 lets the alias address the device.
    pub const DL_CONTROL: u16 = 0x0100;
    /// DL status: links and loops of the ports.
    pub const DL_STATUS: u16 = 0x0110;
    /// AL control: the requested state.
    pub const AL_CONTROL: u16 = 0x0120;
    /// AL status: the state.
    pub const AL_STATUS: u16 = 0x0130;
    /// Why the last change of state was refused.
    pub const AL_STATUS_CODE: u16 = 0x0134;
    /// Divider of the watchdogs: units of 40 ns, minus two.
    pub const WATCHDOG_DIVIDER: u16 = 0x0400;
    /// Watchdog of the process data, in units of the divider.
    pub const WATCHDOG_TIME: u16 = 0x0420;
    /// Bit 0 is clear if the watchdog of the process data has expired.
    pub const WATCHDOG_STATUS: u16 = 0x0440;
    /// Number of times that it has expired.
    pub const WATCHDOG_COUNTER: u16 = 0x0442;
    /// Owner of the SII.
    pub const SII_CONFIG: u16 = 0x0500;
    /// Control and status of the SII.
    pub const SII_CONTROL: u16 = 0x0502;
    /// Word address of the SII.
    pub const SII_ADDRESS: u16 = 0x0504;
    /// Data of the SII.
    pub const SII_DATA: u16 = 0x0508;
    /// First FMMU.
    pub const FMMU: u16 = 0x0600;
    /// First SyncManager.
    pub const SYNC_MANAGER: u16 = 0x0800;
    /// Receive times of the ports; a write latches them.
    pub const DC_RECEIVE_TIMES: u16 = 0x0900;
    /// System time; a write is compared with the local copy.
    pub const DC_SYSTEM_TIME: u16 = 0x0910;
    /// Receive time of the processing unit.
    pub const DC_RECEIVE_TIME: u16 = 0x0918;
    /// System time minus local time.
    pub const DC_OFFSET: u16 = 0x0920;
    /// Propagation time from the reference clock to this device.
    pub const DC_DELAY: u16 = 0x0928;
    /// Mean difference between local copy and received system time; bit 31 its sign.
    pub const DC_DIFFERENCE: u16 = 0x092C;
    /// A write resets the filter of the difference.
    pub const DC_SPEED_START: u16 = 0x0930;
    /// Activation of SYNC0 and SYNC1.
    pub const DC_ACTIVATION: u16 = 0x0981;
    /// System time of the first SYNC0.
    pub const DC_START_TIME: u16 = 0x0990;
    /// Period of SYNC0 in ns.
    pub const DC_SYNC0_CYCLE: u16 = 0x09A0;
    /// First address of the process memory.
    pub const PROCESS_MEMORY: u16 = 0x1000;
}

/// 4 KiB of registers and 8 KiB of process memory.
const SIZE: usize = 0x3000;
/// Registers that the MainDevice only reads.
const READ_ONLY: [(u16, u16); 5] = [
    (0x0000, 0x0010),
    (address::DL_STATUS, address::DL_STATUS + 2),
    (address::AL_STATUS, address::AL_STATUS_CODE + 2),
    (address::WATCHDOG_STATUS, address::WATCHDOG_STATUS + 2),
    (address::DC_RECEIVE_TIME, address::DC_RECEIVE_TIME + 8),
];

/// Bytes by address. Addresses beyond the end read as zero and ignore writes.
#[derive(Clone, Debug)]
pub(crate) struct Registers {
    bytes: Vec<u8>,
}

impl Registers {
    pub(crate) fn new() -> Self {
        Self { bytes: vec![0; SIZE] }
    }

    /// Whether a range is within the memory.
    pub(crate) fn holds(&self, address: u16, length: usize) -> bool {
        usize::from(address) + length <= self.bytes.len()
    }

    pub(crate) fn slice(&self, address: u16, length: usize) -> &[u8] {
        let begin = usize::from(address);
        self.bytes.get(begin..begin + length).unwrap_or(&[])
    }

    pub(crate) fn copy_to(&self, address: u16, target: &mut [u8]) {
        let source = self.slice(address, target.len());
        if source.len() == target.len() {
            target.copy_from_slice(source);
        } else {
            target.fill(0);
        }
    }

    /// Writes from the device's side, at any address.
    pub(crate) fn set(&mut self, address: u16, data: &[u8]) {
        let begin = usize::from(address);
        if let Some(target) = self.bytes.get_mut(begin..begin + data.len()) {
            target.copy_from_slice(data);
        }
    }

    /// Writes from the MainDevice's side: read-only registers keep their values.
    pub(crate) fn write(&mut self, address: u16, data: &[u8]) {
        for (offset, &byte) in (usize::from(address)..).zip(data) {
            let fixed = READ_ONLY
                .iter()
                .any(|&(begin, end)| (usize::from(begin)..usize::from(end)).contains(&offset))
                || is_sync_manager_status(offset);
            if let (false, Some(target)) = (fixed, self.bytes.get_mut(offset)) {
                *target = byte;
            }
        }
    }

    pub(crate) fn u8(&self, address: u16) -> u8 {
        self.bytes.get(usize::from(address)).copied().unwrap_or(0)
    }

    pub(crate) fn u16(&self, address: u16) -> u16 {
        let mut bytes = [0; 2];
        self.copy_to(address, &mut bytes);
        u16::from_le_bytes(bytes)
    }

    pub(crate) fn u32(&self, address: u16) -> u32 {
        let mut bytes = [0; 4];
        self.copy_to(address, &mut bytes);
        u32::from_le_bytes(bytes)
    }

    pub(crate) fn u64(&self, address: u16) -> u64 {
        let mut bytes = [0; 8];
        self.copy_to(address, &mut bytes);
        u64::from_le_bytes(bytes)
    }
}

/// Bytes 5 (status) and 7 (the device's own control) of a SyncManager.
fn is_sync_manager_status(offset: usize) -> bool {
    (0x0800..0x0880).contains(&offset) && matches!(offset % 8, 5 | 7)
}
