//! **A test simulator**: a ring of EtherCAT SubDevices in a process, connected to a raw socket.
//!
//! ```text
//!   frame ──► PacketSocket ──► Ring ──► SubDevice ──► SubDevice ──► ... ──┐
//!     ◄──────────────────────── faults ◄──────────────────────────────────┘
//!                                SubDevice: controller (registers, FMMUs, SyncManagers, SII, clock),
//!                                           AL states, mailbox with CoE, process data
//!                                           Drive: CiA 402, motor and load     Terminal: inputs, outputs
//! ```
//!
//! A MainDevice, which sees only frames, can find devices, bring them to OP, read and write objects, and turn
//! drives:
//!
//! ```
//! use evolvent_ethercat_ring::{DriveSettings, Ring, SubDevice};
//!
//! let mut ring = Ring::new(vec![SubDevice::drive(DriveSettings::default(), 1, 0.0)], 0);
//! // A broadcast read of one byte of register 0000h, as a MainDevice sends it to count devices.
//! let mut frame = vec![0xFF; 6];
//! frame.extend([2, 0, 0, 0, 0, 1, 0x88, 0xA4, 13, 0x10]);
//! frame.extend([7, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]);
//! let returned = ring.exchange(1_000, frame);
//! assert_eq!(returned[0].frame[27..29], [1, 0], "the working counter");
//! ```
//!
//! [`Ring`] is the complete ring as a pure model: time is an argument. [`run`] connects it to a network
//! interface. Registers follow ETG.1000.4 and Beckhoff's data sheet of the ET1100, objects follow CiA 301 and
//! CiA 402. The ring is made to test MainDevices and was tried with SOEM (`pysoem`), KickCAT and ethercrab;
//! it is not a reference for devices. Not simulated: bootstrap, EoE, FoE, SoE, emergencies other than the
//! simulated fault, SYNC1, latch inputs, redundancy, and devices that branch the line.

mod application_layer;
mod bench;
mod clock;
mod coe;
mod controller;
mod datagram;
mod device_objects;
mod digital_outputs;
mod drive;
mod drive_objects;
mod drive_settings;
mod fault;
mod fmmu;
mod homing;
mod mailbox;
mod motor;
mod namespace;
mod object;
mod probe;
mod process_data;
mod registers;
mod ring;
mod run;
mod sii;
mod socket;
mod subdevice;
mod sync_manager;
mod terminal;

pub use application_layer::{AlState, status_code};
pub use bench::{MAIN_INTERFACE, SharedRing, on_bench};
pub use coe::abort;
pub use drive::Drive;
pub use drive_settings::{DriveSettings, OutputMask};
pub use fault::{Fault, FaultError, FaultKind};
pub use motor::Mechanics;
pub use namespace::{await_carrier, ip, own_namespace};
pub use object::{Dictionary, data_type};
pub use registers::address;
pub use ring::{HOP_NS, Returned, Ring};
pub use run::{monotonic_ns, run};
pub use sii::Identity;
pub use socket::PacketSocket;
pub use subdevice::{DRIVE_PRODUCT, Device, SIMULATED_VENDOR, SubDevice};
pub use terminal::{Terminal, TerminalKind};
