//! The machine as its file describes it.

use evolvent_machine::MachineKind;
use evolvent_runtime::Setup;
use serde::Serialize;
use ts_rs::TS;

use super::{HandwheelInfo, ProcessInfo, SAMPLE_BYTES, SignalInfo};
use crate::sampled_signals::values_of;

/// One axis.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct AxisInfo {
    /// X Y Z A B C U V W.
    pub letter: String,
    /// `linear` or `rotary`.
    #[ts(type = "'linear' | 'rotary'")]
    pub kind: &'static str,
    /// Travel, mm or degrees.
    pub min: f64,
    /// Travel, mm or degrees.
    pub max: f64,
    /// mm/s or degrees/s.
    pub max_velocity: f64,
    /// Whether it is an unlimited rotary axis: positions are angles of a turn, and have no ends.
    pub is_unlimited: bool,
    /// It is homed by a switch.
    pub has_home_switch: bool,
}

/// The machine.
#[derive(Clone, Debug, PartialEq, Serialize, TS)]
pub struct MachineInfo {
    /// Its name.
    pub name: String,
    /// One line.
    pub description: String,
    /// `mill` or `lathe`.
    #[ts(type = "'mill' | 'lathe'")]
    pub kind: &'static str,
    /// In the order of the machine file.
    pub axes: Vec<AxisInfo>,
    /// What a cut is like, where the service was given a process file.
    pub process: Option<ProcessInfo>,
    /// Its inputs, in the order of the machine file.
    pub inputs: Vec<SignalInfo>,
    /// Its outputs, in the order of the machine file.
    pub outputs: Vec<SignalInfo>,
    /// Numbers of its spindles.
    pub spindles: Vec<u32>,
    /// The handwheel, if there is one.
    pub handwheel: Option<HandwheelInfo>,
    /// The service was given a chatter case.
    pub has_chatter: bool,
    /// Bytes of a sample of this machine.
    pub sample_bytes: u32,
}

impl MachineInfo {
    pub(crate) fn new(setup: &Setup, has_chatter: bool) -> Self {
        let machine = &setup.machine;
        let axes = machine.axes.iter().map(|axis| AxisInfo {
            letter: axis.letter.letter().to_string(),
            kind: if axis.letter.is_rotary() {
                "rotary"
            } else {
                "linear"
            },
            // The positions of an unlimited axis are shown within one turn.
            min: axis.unlimited.map_or(axis.travel_min, |_| 0.0),
            max: axis.unlimited.map_or(axis.travel_max, |_| 360.0),
            max_velocity: axis.max_velocity,
            is_unlimited: axis.unlimited.is_some(),
            has_home_switch: machine.homing.iter().any(|homing| homing.axis == axis.letter),
        });
        Self {
            name: machine.name.clone(),
            description: machine.description.clone(),
            kind: match machine.kind {
                MachineKind::Mill => "mill",
                MachineKind::Lathe => "lathe",
            },
            axes: axes.collect(),
            process: setup.process.as_deref().map(ProcessInfo::from),
            inputs: machine.signals.inputs.iter().map(SignalInfo::from).collect(),
            outputs: machine.signals.outputs.iter().map(SignalInfo::from).collect(),
            spindles: machine
                .signals
                .spindles
                .iter()
                .map(|spindle| spindle.number)
                .collect(),
            handwheel: machine.handwheel.as_ref().map(HandwheelInfo::from),
            has_chatter,
            sample_bytes: (SAMPLE_BYTES + 4 * values_of(&machine.signals)) as u32,
        }
    }
}
