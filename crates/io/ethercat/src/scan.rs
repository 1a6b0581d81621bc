//! Lists the devices on the wire: reads their states first, then EEPROMs and, in PRE-OP, objects. Leaves the
//! devices in INIT.

use core::ops::Deref;
use core::panic::AssertUnwindSafe;

use ethercrab::error::Error;
use ethercrab::{
    Command, MainDevice, MainDeviceConfig, PduStorage, RegisterAddress, SubDevice, SubDeviceRef,
    SubDeviceState,
};
use evolvent_bridge::monotonic_ns;
use thiserror::Error;

use crate::fault_text::fault_text_of;
use crate::found::FoundDevice;
use crate::network::MAX_DEVICES;
use crate::pump::Pump;
use crate::session::{FIRST_STATION, timeouts};
use crate::sii::{HEAD_BYTES, MAX_BYTES, Pdo, PdoEntry, SiiContents, bytes_wanted};
use crate::socket::{InterfaceError, PacketSocket};

const FRAMES: usize = 16;
const FRAME_DATA: usize = PduStorage::element_size(1100);
const IMAGE: usize = 1024;
/// Maximum duration of a scan, ns.
const SCAN_NS: u64 = 60_000_000_000;
/// Maximum number of PDOs read per assignment, and of entries per PDO: four times the largest drive seen.
const MAX_PDOS: u8 = 32;
const MAX_ENTRIES: u8 = 64;

/// Why a scan failed.
#[derive(Debug, Error)]
pub enum ScanError {
    /// The interface cannot be opened.
    #[error(transparent)]
    Interface(#[from] InterfaceError),
    /// No device replies.
    #[error("no device replies: check cable, interface and supply")]
    NoDevices,
    /// More devices than supported.
    #[error("more than {MAX_DEVICES} devices are on the wire: split the network")]
    TooMany,
    /// The network did not come to PRE-OP.
    #[error("{doing}: {why}")]
    Main {
        /// The failed step.
        doing: &'static str,
        /// Why it failed.
        why: String,
    },
    /// The library failed.
    #[error(
        "a device sent data that the EtherCAT library cannot handle (such as a broken EEPROM): {what}; try \
         again, or leave devices out one by one"
    )]
    Library {
        /// Its message.
        what: String,
    },
}

/// The message of a panic.
pub(crate) fn panic_text(panic: &(dyn core::any::Any + Send)) -> String {
    panic
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned())
        .or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_default()
        .replace('\n', " ")
}

/// Examines every device on an interface. It takes devices out of their present state, so it is refused while
/// another MainDevice uses the interface.
///
/// # Errors
/// The interface cannot be opened, no device replies, or the network does not come to PRE-OP. Data that one
/// device does not report are listed in its problems.
pub fn scan(interface: &str) -> Result<Vec<FoundDevice>, ScanError> {
    let socket = PacketSocket::open(interface)?;
    // ethercrab asserts on the replies of devices.
    std::panic::catch_unwind(AssertUnwindSafe(|| scan_socket(&socket))).unwrap_or_else(|panic| {
        Err(ScanError::Library {
            what: panic_text(panic.as_ref()),
        })
    })
}

fn scan_socket(socket: &PacketSocket) -> Result<Vec<FoundDevice>, ScanError> {
    let storage = PduStorage::<FRAMES, FRAME_DATA>::new();
    let failed = |doing, why: String| ScanError::Main { doing, why };
    let Ok((tx, rx, pdus)) = storage.try_split() else {
        return Err(failed(
            "reserving the frame buffer",
            "it is not available".to_owned(),
        ));
    };
    let mut pump = Pump::new(tx, rx, socket, None);
    let config = MainDeviceConfig {
        dc_static_sync_iterations: 0,
        ..MainDeviceConfig::default()
    };
    let main = MainDevice::new(pdus, timeouts(), config);
    let mut devices = pump
        .complete(monotonic_ns() + SCAN_NS, scan_main(&main))
        .unwrap_or_else(|| {
            Err(failed(
                "reading the devices",
                "it took more than a minute".to_owned(),
            ))
        })?;
    for emergency in pump.emergencies() {
        let found = usize::from(emergency.station.wrapping_sub(FIRST_STATION));
        if let Some(device) = devices.get_mut(found) {
            let text = fault_text_of(device.sii.vendor, emergency.code);
            device.problems.push(format!(
                "emergency message {:04X}h: {text} (error register {:02X}h)",
                emergency.code, emergency.register
            ));
        }
    }
    Ok(devices)
}

async fn scan_main<'m>(main: &'m MainDevice<'m>) -> Result<Vec<FoundDevice>, ScanError> {
    let failed = |doing: &'static str| {
        move |error: Error| ScanError::Main {
            doing,
            why: error.to_string(),
        }
    };
    // States before anything is changed.
    let mut devices = Vec::new();
    loop {
        let position = devices.len();
        let read = Command::aprd(position as u16, RegisterAddress::AlStatus.into())
            .receive::<u8>(main)
            .await;
        let state = match read {
            Ok(_) if position == MAX_DEVICES => return Err(ScanError::TooMany),
            Ok(state) => state,
            Err(Error::WorkingCounter { received: 0, .. }) if position > 0 => break,
            Err(Error::WorkingCounter { .. } | Error::Timeout(_)) if position == 0 => {
                return Err(ScanError::NoDevices);
            }
            Err(error) => return Err(failed("reading states")(error)),
        };
        let status_code = Command::aprd(position as u16, RegisterAddress::AlStatusCode.into())
            .receive::<u16>(main)
            .await
            .map_err(failed("reading states"))?;
        let features = Command::aprd(position as u16, RegisterAddress::SupportFlags.into())
            .receive::<u16>(main)
            .await
            .map_err(failed("reading features"))?;
        devices.push(FoundDevice {
            // Bit 2: it has a clock; bit 3: of 64 bits. ethercrab's `DcSupport` tests bit 8, which concerns
            // options of SYNC0.
            clock: match features >> 2 & 0b11 {
                0b01 => "32 bits",
                0b11 => "64 bits",
                _ => "none",
            },
            state: SubDeviceState::from(state & 0x0F).to_string(),
            status_code: if state & 0x10 == 0 { 0 } else { status_code },
            ..FoundDevice::default()
        });
    }
    let group = main
        .init_single_group::<MAX_DEVICES, IMAGE>(monotonic_ns)
        .await
        .map_err(failed("bringing devices to PRE-OP"))?;
    for (subdevice, device) in group.iter(main).zip(&mut devices) {
        match read_sii(main, &subdevice).await {
            Ok(image) => device.sii = SiiContents::parse(&image),
            Err(error) => device.problems.push(format!("EEPROM: {error}")),
        }
        // The values that the library compares with the network file.
        let identity = subdevice.identity();
        device.sii.vendor = identity.vendor_id;
        device.sii.product = identity.product_id;
        device.sii.revision = identity.revision;
        if device.sii.has_coe {
            read_objects(&subdevice, device).await;
        }
    }
    group
        .into_init(main)
        .await
        .map_err(failed("bringing devices back to INIT"))?;
    Ok(devices)
}

async fn read_sii<S: Deref<Target = SubDevice>>(
    main: &MainDevice<'_>,
    subdevice: &SubDeviceRef<'_, S>,
) -> Result<Vec<u8>, Error> {
    let mut image = vec![0; HEAD_BYTES];
    let mut filled = 0;
    loop {
        while filled < image.len() {
            // Copied in blocks of 16 words: an end within a word is read together with the word.
            let begin = filled & !1;
            let end = (begin + 32).min(image.len());
            let read = subdevice
                .eeprom_read_raw(main, (begin / 2) as u16, &mut image[begin..end])
                .await?;
            if read == 0 {
                image.truncate(filled);
                return Ok(image);
            }
            filled = begin + read;
        }
        match bytes_wanted(&image) {
            Some(wanted) if wanted > image.len() => image.resize(wanted.min(MAX_BYTES), 0),
            _ => return Ok(image),
        }
    }
}

/// Reads the data of a device with CoE; missing ones are listed in its problems.
async fn read_objects<S: Deref<Target = SubDevice>>(
    subdevice: &SubDeviceRef<'_, S>,
    device: &mut FoundDevice,
) {
    match subdevice.sdo_read::<u32>(0x1000, 0).await {
        Ok(device_type) => device.device_type = Some(device_type),
        Err(error) => device.problems.push(format!("object 1000h: {error}")),
    }
    for (assignment, is_output) in [(0x1C12, true), (0x1C13, false)] {
        match read_assignment(subdevice, assignment).await {
            Ok(mut pdos) => {
                let known = if is_output {
                    &device.sii.outputs
                } else {
                    &device.sii.inputs
                };
                name_from(&mut pdos, known);
                if is_output {
                    device.outputs = Some(pdos);
                } else {
                    device.inputs = Some(pdos);
                }
            }
            Err(error) => device
                .problems
                .push(format!("assignment {assignment:04X}h: {error}")),
        }
    }
    if device.is_drive() {
        // Both are optional.
        device.resolution = read_pair(subdevice, 0x608F).await;
        device.gear = read_pair(subdevice, 0x6091).await;
    }
}

async fn read_pair<S: Deref<Target = SubDevice>>(
    subdevice: &SubDeviceRef<'_, S>,
    index: u16,
) -> Option<[u32; 2]> {
    let first = subdevice.sdo_read(index, 1).await.ok()?;
    Some([first, subdevice.sdo_read(index, 2).await.ok()?])
}

async fn read_assignment<S: Deref<Target = SubDevice>>(
    subdevice: &SubDeviceRef<'_, S>,
    assignment: u16,
) -> Result<Vec<Pdo>, Error> {
    let mut pdos = Vec::new();
    let count: u8 = subdevice.sdo_read(assignment, 0).await?;
    for slot in 1..=count.min(MAX_PDOS) {
        let index: u16 = subdevice.sdo_read(assignment, slot).await?;
        let mut pdo = Pdo {
            index,
            ..Pdo::default()
        };
        let entries: u8 = subdevice.sdo_read(index, 0).await?;
        for slot in 1..=entries.min(MAX_ENTRIES) {
            let number: u32 = subdevice.sdo_read(index, slot).await?;
            pdo.entries.push(PdoEntry {
                index: (number >> 16) as u16,
                sub_index: (number >> 8) as u8,
                bits: number as u8,
                ..PdoEntry::default()
            });
        }
        pdos.push(pdo);
    }
    Ok(pdos)
}

/// Adds the EEPROM's names of the same objects.
fn name_from(pdos: &mut [Pdo], known: &[Pdo]) {
    for pdo in pdos {
        if let Some(same) = known.iter().find(|other| other.index == pdo.index) {
            pdo.name.clone_from(&same.name);
        }
        for entry in &mut pdo.entries {
            let mut others = known.iter().flat_map(|pdo| &pdo.entries);
            let same = others.find(|other| (other.index, other.sub_index) == (entry.index, entry.sub_index));
            if let Some(same) = same {
                entry.name.clone_from(&same.name);
            }
        }
    }
}
