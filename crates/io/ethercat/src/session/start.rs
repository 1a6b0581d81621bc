//! From INIT to OP: identity, startup objects, process data and clocks of every device.

use core::time::Duration;

use ethercrab::error::{Error, MailboxError};
use ethercrab::subdevice_group::{DcConfiguration, HasDc, NoDc, PreOp, PreOpPdi};
use ethercrab::{
    Command, DcSync, DefaultLock, MainDevice, RegisterAddress, SubDeviceGroup, SubDeviceIdentity,
    SubDeviceRef,
};
use evolvent_bridge::monotonic_ns;
use evolvent_drive::InterpolationTime;
use evolvent_machine::Machine;

use super::error::SessionError;
use super::{Devices, FIRST_STATION, IMAGE, SYNC_DELAY};
use crate::drive_limits::{self, LimitNote, ReportedLimits, check_limits};
use crate::homing::HomingOnDrive;
use crate::network::{MAX_DEVICES, Network, NetworkDevice, Startup};
use crate::pdo::{
    Extras, HeldOutputs, Mapped, OUTPUT_MASK, PHYSICAL_OUTPUTS, PdoLayout, wanted_inputs, wanted_outputs,
};
use crate::reference_clock::{ReferenceClock, same_time};
use crate::signal_set::SignalSet;

/// Register 0981h: cyclic operation with SYNC0.
const SYNC0: u8 = 0b11;

/// Process data of the drives of axes, and of those of spindles, in the order of the devices.
#[derive(Debug, Default)]
pub(super) struct Layouts {
    pub(super) axes: Vec<PdoLayout>,
    pub(super) spindles: Vec<PdoLayout>,
    /// Limits of drives that are lower than those of the machine file.
    pub(super) limits: Vec<LimitNote>,
}

type Group<S, C> = SubDeviceGroup<MAX_DEVICES, IMAGE, DefaultLock, S, C>;

/// Brings the network from INIT up to the request of OP.
pub(super) async fn start<'m>(
    main: &'m MainDevice<'m>,
    network: &Network,
    machine: &Machine,
    period_ns: u64,
) -> Result<(Devices, Layouts, ReferenceClock), SessionError> {
    let interpolation = InterpolationTime::from_period_ns(period_ns)?;
    let mut group = find_devices(main, network).await?;
    let layouts = set_up_devices(main, &group, network, machine, interpolation).await?;
    let has_clock = network.distributed_clocks && request_sync(main, &mut group, network);
    let group = group
        .into_pre_op_pdi(main)
        .await
        .map_err(failed("mapping process data"))?;
    let mut reference = ReferenceClock::default();
    let devices = if has_clock {
        let clocks = DcConfiguration {
            start_delay: SYNC_DELAY,
            sync0_period: Duration::from_nanos(period_ns),
            sync0_shift: Duration::from_nanos(period_ns / 2),
        };
        let group = group
            .configure_dc_sync(main, clocks)
            .await
            .map_err(failed("setting SYNC0 up"))?;
        reference = start_clocks(main, &group, network, period_ns).await?;
        let group = group.into_safe_op(main).await.map_err(refused("SAFE-OP"))?;
        Devices::Clocked(group.request_into_op(main).await.map_err(refused("OP"))?)
    } else {
        let group = group.into_safe_op(main).await.map_err(refused("SAFE-OP"))?;
        Devices::Free(group.request_into_op(main).await.map_err(refused("OP"))?)
    };
    Ok((devices, layouts, reference))
}

fn failed(doing: &'static str) -> impl Fn(Error) -> SessionError {
    move |error| SessionError::Main {
        doing,
        why: error.to_string(),
    }
}

/// The error of a state that devices did not reach.
fn refused(wanted: &'static str) -> impl Fn(Error) -> SessionError {
    move |error| match error {
        Error::StateTransition | Error::Timeout(_) | Error::SubDevice(_) => SessionError::State {
            wanted,
            states: String::new(),
        },
        error => failed(wanted)(error),
    }
}

/// Brings the devices to PRE-OP and checks their number.
async fn find_devices(main: &MainDevice<'_>, network: &Network) -> Result<Group<PreOp, NoDc>, SessionError> {
    let answer = Command::brd(RegisterAddress::Type.into())
        .ignore_wkc()
        .receive::<u8>(main)
        .await;
    if answer.is_err() {
        return Err(SessionError::NoDevices);
    }
    let group = main
        .init_single_group::<MAX_DEVICES, IMAGE>(monotonic_ns)
        .await
        .map_err(refused("PRE-OP"))?;
    let (found, expected) = (main.num_subdevices(), network.devices.len());
    if found == 0 {
        return Err(SessionError::NoDevices);
    }
    if found != expected {
        return Err(SessionError::Count { found, expected });
    }
    Ok(group)
}

/// Writes the objects of every device, and compares the limits of its drives with the machine.
async fn set_up_devices<'m>(
    main: &'m MainDevice<'m>,
    group: &Group<PreOp, NoDc>,
    network: &Network,
    machine: &Machine,
    interpolation: InterpolationTime,
) -> Result<Layouts, SessionError> {
    let mut layouts = Layouts::default();
    // Without a message of the core all outputs are safe.
    let safe = SignalSet::new(machine, network, 0);
    for (i, (subdevice, device)) in group.iter(main).zip(&network.devices).enumerate() {
        check_identity(i + 1, &subdevice.identity(), device)?;
        let objects = Objects {
            subdevice: &subdevice,
            device,
            position: i,
            safe: &safe,
        };
        for entry in &device.startup {
            objects.write(*entry).await?;
        }
        if let Some(axis) = &device.axis {
            layouts.axes.push(
                objects
                    .set_up(axis.homing, axis.extras(), axis.map, interpolation)
                    .await?,
            );
        }
        if let Some(spindle) = &device.spindle {
            layouts.spindles.push(
                objects
                    .set_up(None, spindle.extras(), spindle.map, interpolation)
                    .await?,
            );
        }
        if device.is_drive() {
            let reported = objects.limits().await?;
            (layouts.limits).extend(check_limits(machine, device, &reported)?);
        }
    }
    Ok(layouts)
}

/// Requests SYNC0 of the drives that have a clock; returns whether there is one.
fn request_sync<'m>(main: &'m MainDevice<'m>, group: &mut Group<PreOp, NoDc>, network: &Network) -> bool {
    let mut has_clock = false;
    for (mut subdevice, device) in group.iter_mut(main).zip(&network.devices) {
        if device.is_drive() && subdevice.dc_support().any() {
            subdevice.set_dc_sync(DcSync::Sync0);
            has_clock = true;
        }
    }
    has_clock
}

/// Starts SYNC0 of the drives. The reference is the first device with a clock: SYNC0 occurs at whole periods
/// of its time, also after a wrap.
async fn start_clocks<'m>(
    main: &'m MainDevice<'m>,
    group: &Group<PreOpPdi, HasDc>,
    network: &Network,
    period_ns: u64,
) -> Result<ReferenceClock, SessionError> {
    let has_clock: Vec<bool> = (group.iter(main))
        .map(|device| device.dc_support().any())
        .collect();
    let Some(first) = has_clock.iter().position(|has_clock| *has_clock) else {
        return Ok(ReferenceClock::default());
    };
    let time = clock_of(main, first).await;
    let time_ns = time.map_err(failed("reading the reference clock"))?;
    let reference = ReferenceClock::new(time_ns, monotonic_ns());
    let first_ns = time_ns.wrapping_add(SYNC_DELAY.as_nanos() as u64) / period_ns * period_ns;
    for (device, (listed, has_clock)) in network.devices.iter().zip(has_clock).enumerate() {
        if listed.is_drive() && has_clock {
            let begun = begin_sync(main, device, first_ns).await;
            begun.map_err(failed("setting the start of SYNC0"))?;
        }
    }
    Ok(reference)
}

/// The system time of a device, as its register shows it: of 64 bits or of 32.
async fn clock_of(main: &MainDevice<'_>, device: usize) -> Result<u64, Error> {
    Command::fprd(
        FIRST_STATION + device as u16,
        RegisterAddress::DcSystemTime.into(),
    )
    .receive(main)
    .await
}

/// Starts SYNC0 of a device, whose period is set, when the reference's register shows `first_ns`. The
/// MainDevice has started it by that register alone: with a 32-bit reference this time is in the past of a
/// 64-bit clock, and then SYNC0 never occurs.
async fn begin_sync(main: &MainDevice<'_>, device: usize, first_ns: u64) -> Result<(), Error> {
    let write = |register: RegisterAddress| Command::fpwr(FIRST_STATION + device as u16, register.into());
    let start_ns = same_time(first_ns, clock_of(main, device).await?);
    write(RegisterAddress::DcSyncActive).send(main, 0_u8).await?;
    write(RegisterAddress::DcSyncStartTime)
        .send(main, start_ns)
        .await?;
    write(RegisterAddress::DcSyncActive).send(main, SYNC0).await
}

/// Checks that the device at a position of the ring is the one of the network file.
fn check_identity(
    position: usize,
    identity: &SubDeviceIdentity,
    device: &NetworkDevice,
) -> Result<(), SessionError> {
    let revision = device.revision.unwrap_or(identity.revision);
    for (what, found, expected) in [
        ("vendor", identity.vendor_id, device.vendor),
        ("product", identity.product_id, device.product),
        ("revision", identity.revision, revision),
    ] {
        if found != expected {
            return Err(SessionError::Identity {
                position,
                name: device.name.clone(),
                what,
                found,
                expected,
            });
        }
    }
    Ok(())
}

/// Objects of one device.
struct Objects<'a, 'm, S> {
    pub(super) subdevice: &'a SubDeviceRef<'m, S>,
    pub(super) device: &'a NetworkDevice,
    /// Position in the network file.
    position: usize,
    /// The outputs of the machine, all in their safe state.
    safe: &'a SignalSet,
}

impl<S: core::ops::Deref<Target = ethercrab::SubDevice>> Objects<'_, '_, S> {
    fn refused(&self, index: u16, sub_index: u8, action: &'static str, error: Error) -> SessionError {
        let why = match error {
            Error::Mailbox(MailboxError::Aborted { code, .. }) => format!("the device rejects it: {code}"),
            Error::Timeout(_) => "the device does not reply".to_owned(),
            Error::Wire(_) | Error::Mailbox(MailboxError::SdoResponseInvalid { .. }) => {
                "the device replies for another object: its firmware or its mailbox is faulty".to_owned()
            }
            error => error.to_string(),
        };
        SessionError::Object {
            name: self.device.name.clone(),
            index,
            sub_index,
            action,
            why,
        }
    }

    pub(super) async fn write(&self, entry: Startup) -> Result<(), SessionError> {
        let Startup {
            index,
            sub_index,
            bytes,
            value,
        } = entry;
        let written = match bytes {
            1 => self.subdevice.sdo_write(index, sub_index, value as u8).await,
            2 => self.subdevice.sdo_write(index, sub_index, value as u16).await,
            _ => self.subdevice.sdo_write(index, sub_index, value).await,
        };
        written.map_err(|error| self.refused(index, sub_index, "written", error))
    }

    async fn set_up(
        &self,
        homing: Option<HomingOnDrive>,
        extras: Extras,
        map: bool,
        interpolation: InterpolationTime,
    ) -> Result<PdoLayout, SessionError> {
        let extras = Extras {
            digital_outputs: !self.device.outputs.is_empty(),
            ..extras
        };
        for (sub_index, value) in [(1, interpolation.value), (2, interpolation.index as u8)] {
            let written = self.subdevice.sdo_write(0x60C2, sub_index, value).await;
            match written {
                // Drives that take the period from SYNC0 may lack this object.
                Ok(()) | Err(Error::Mailbox(MailboxError::Aborted { .. })) => {}
                Err(error) => return Err(self.refused(0x60C2, sub_index, "written", error)),
            }
        }
        if let Some(homing) = homing {
            let write = |index, sub_index, bytes, value| {
                self.write(Startup {
                    index,
                    sub_index,
                    bytes,
                    value,
                })
            };
            write(0x6098, 0, 1, i32::from(homing.method) as u32).await?;
            write(0x6099, 1, 4, homing.search).await?;
            write(0x6099, 2, 4, homing.latch).await?;
            if let Some(acceleration) = homing.acceleration {
                write(0x609A, 0, 4, acceleration).await?;
            }
            // The network file gives the machine coordinate of the zero that the drive finds.
            write(0x607C, 0, 4, 0).await?;
        }
        if map {
            self.map(0x1C12, 0x1600, &wanted_outputs(extras)).await?;
            self.map(0x1C13, 0x1A00, &wanted_inputs(extras)).await?;
        }
        let (outputs, inputs) = (self.mapped(0x1C12).await?, self.mapped(0x1C13).await?);
        let mut layout =
            PdoLayout::new(&outputs, &inputs, extras).map_err(|why| SessionError::ProcessData {
                name: self.device.name.clone(),
                why,
            })?;
        if layout.writes_digital_outputs() {
            layout.hold_outputs(self.hold_outputs().await?);
        }
        Ok(layout)
    }

    /// Gives the bus the outputs of the network file, and no others: the mask of 60FEh releases the rest, such
    /// as the brake, to the drive. A drive without a mask, or with one that nobody may write, gives the bus
    /// all outputs, or those of its mask; these keep the bits that the drive has now.
    async fn hold_outputs(&self) -> Result<HeldOutputs, SessionError> {
        let Mapped { index, sub_index, .. } = PHYSICAL_OUTPUTS;
        let physical: u32 = self.optional(index, sub_index).await?.unwrap_or(0);
        let mask = (self.device.outputs.iter()).fold(0, |mask, output| mask | 1_u32 << output.channel.bit);
        let mut image = physical.to_le_bytes();
        self.safe.write(self.position, &mut image);
        if mask != 0 {
            // The object may still have what an earlier bridge has set. Drives may refuse to have process data
            // written by other means.
            let written = self
                .subdevice
                .sdo_write(index, sub_index, u32::from_le_bytes(image));
            match written.await {
                Ok(()) | Err(Error::Mailbox(MailboxError::Aborted { .. })) => {}
                Err(error) => return Err(self.refused(index, sub_index, "written", error)),
            }
        }
        let Mapped { index, sub_index, .. } = OUTPUT_MASK;
        if mask == 0 {
            let mask = self.optional(index, sub_index).await?.unwrap_or(0);
            return Ok(HeldOutputs { physical, mask });
        }
        match self.subdevice.sdo_write(index, sub_index, mask).await {
            Ok(()) => Ok(HeldOutputs { physical, mask }),
            Err(error @ Error::Mailbox(MailboxError::Aborted { .. })) => {
                match self.optional(index, sub_index).await? {
                    Some(fixed) if fixed & mask != mask => {
                        Err(self.refused(index, sub_index, "written", error))
                    }
                    fixed => Ok(HeldOutputs {
                        physical,
                        mask: fixed.unwrap_or(mask),
                    }),
                }
            }
            Err(error) => Err(self.refused(index, sub_index, "written", error)),
        }
    }

    /// An object that a drive may lack.
    async fn optional<T: ethercrab::EtherCrabWireReadSized>(
        &self,
        index: u16,
        sub_index: u8,
    ) -> Result<Option<T>, SessionError> {
        match self.subdevice.sdo_read(index, sub_index).await {
            Ok(value) => Ok(Some(value)),
            // Absent, or of another size than in CiA 402, which gives it another meaning.
            Err(Error::Mailbox(MailboxError::Aborted { .. }) | Error::Wire(_)) => Ok(None),
            Err(error) => Err(self.refused(index, sub_index, "read", error)),
        }
    }

    /// The drive's own limits, and their units where there are any.
    async fn limits(&self) -> Result<ReportedLimits, SessionError> {
        let mut limits = ReportedLimits {
            motor_speed: self.optional(drive_limits::MOTOR_SPEED, 0).await?,
            profile_velocity: self.optional(drive_limits::PROFILE_VELOCITY, 0).await?,
            ..ReportedLimits::default()
        };
        if limits.profile_velocity.is_some() {
            limits.velocity_unit = self.optional(drive_limits::VELOCITY_UNIT, 0).await?;
        }
        if self.device.axis.is_some() {
            limits.acceleration = self.optional(drive_limits::ACCELERATION, 0).await?;
            limits.quick_stop = self.optional(drive_limits::QUICK_STOP, 0).await?;
            limits.quick_stop_option = self.optional(drive_limits::QUICK_STOP_OPTION, 0).await?;
            limits.acceleration_unit = self.optional(drive_limits::ACCELERATION_UNIT, 0).await?;
        }
        Ok(limits)
    }

    pub(super) async fn map(&self, assignment: u16, pdo: u16, wanted: &[Mapped]) -> Result<(), SessionError> {
        let entry = |index, sub_index, bytes, value| Startup {
            index,
            sub_index,
            bytes,
            value,
        };
        self.write(entry(assignment, 0, 1, 0)).await?;
        self.write(entry(pdo, 0, 1, 0)).await?;
        for (sub_index, mapped) in (1_u8..).zip(wanted) {
            self.write(entry(pdo, sub_index, 4, mapped.number())).await?;
        }
        self.write(entry(pdo, 0, 1, wanted.len() as u32)).await?;
        self.write(entry(assignment, 1, 2, u32::from(pdo))).await?;
        self.write(entry(assignment, 0, 1, 1)).await
    }

    async fn mapped(&self, assignment: u16) -> Result<Vec<Mapped>, SessionError> {
        let mut mapped = Vec::new();
        let count: u8 = self.read(assignment, 0).await?;
        for sub_index in 1..=count {
            let pdo: u16 = self.read(assignment, sub_index).await?;
            let entries: u8 = self.read(pdo, 0).await?;
            for sub_index in 1..=entries {
                mapped.push(Mapped::from_number(self.read(pdo, sub_index).await?));
            }
        }
        Ok(mapped)
    }

    pub(super) async fn read<T: ethercrab::EtherCrabWireReadSized>(
        &self,
        index: u16,
        sub_index: u8,
    ) -> Result<T, SessionError> {
        self.subdevice
            .sdo_read(index, sub_index)
            .await
            .map_err(|error| self.refused(index, sub_index, "read", error))
    }
}
