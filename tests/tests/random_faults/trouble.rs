//! Troubles of random programs.

/// The fault of a case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Trouble {
    Nothing,
    /// A hold, then a resume.
    Hold,
    Stop,
    EmergencyStop,
    /// The probe makes contact much earlier than expected.
    ProbeEarly,
    /// The probe is tripped before it moves.
    ProbeTripped,
    /// The probe never trips.
    ProbeStuck,
    /// The bridge stops reporting the probe.
    ProbeLost,
    /// The signal of the tool changer does not come, or the operator does not confirm the tool.
    ChangerSilent,
    /// A fault of `bridge sim`, and the alarms that may name it.
    Bridge(&'static str, &'static [u32]),
    /// SIGKILL to the bridge; then another bridge.
    BridgeKilled,
}

impl Trouble {
    /// The alarms that may name the fault.
    pub(crate) fn alarms(self) -> &'static [u32] {
        match self {
            Self::Nothing | Self::Hold | Self::Stop | Self::EmergencyStop | Self::ProbeEarly => &[],
            Self::ProbeTripped | Self::ProbeStuck | Self::ProbeLost | Self::ChangerSilent => &[100],
            Self::Bridge(_, alarms) => alarms,
            // Silence, another bridge under power, or drives without power.
            Self::BridgeKilled => &[401, 405, 407, 408, 412, 413],
        }
    }

    /// A word that the alarm's sentence contains.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::ProbeTripped => "tripped",
            Self::ProbeStuck => "without contact",
            Self::ProbeLost => "probe",
            Self::ChangerSilent => "drawbar",
            Self::Bridge(name, _) if name.starts_with("spindle") => "spindle",
            Self::Bridge(name, _) => name.split_once(':').map_or("", |(_, axis)| axis),
            _ => "",
        }
    }

    /// Whether the bridge causes it by itself.
    pub(crate) fn is_of_bridge(self) -> bool {
        matches!(self, Self::Bridge(..))
    }

    /// The option of `bridge sim` for a fault of the bridge, `moment_s` after its drives became operational.
    pub(crate) fn fault_options(self, moment_s: f64) -> Vec<String> {
        let Self::Bridge(name, _) = self else {
            return Vec::new();
        };
        let (kind, axis) = name
            .split_once(':')
            .map_or((name, String::new()), |(kind, axis)| (kind, format!(":{axis}")));
        vec![
            "--fault".to_owned(),
            format!("{kind}@{:.3}{axis}", 0.5 + moment_s),
        ]
    }
}
