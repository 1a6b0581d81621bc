//! The machine as its file describes it.

use serde::Serialize;
use ts_rs::TS;

use super::{HandwheelInfo, ProcessInfo, SignalInfo};

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
}
