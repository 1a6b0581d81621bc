//! A random program and its fault.

use std::fmt::Write as _;

use evolvent_random::Random;

use super::trouble::Trouble;

/// The program has an error.
const PROGRAM: u32 = 100;
/// Alarms that may accompany any other: a tool change that was broken off, and axes that must be homed.
const CHANGE_BROKEN_OFF: u32 = 103;
const ZERO_MAY_HAVE_MOVED: u32 = 418;

const TROUBLES: [Trouble; 22] = [
    Trouble::Nothing,
    Trouble::Hold,
    Trouble::Hold,
    Trouble::Stop,
    Trouble::Stop,
    Trouble::EmergencyStop,
    Trouble::ProbeEarly,
    Trouble::ProbeTripped,
    Trouble::ProbeStuck,
    Trouble::ProbeLost,
    Trouble::ChangerSilent,
    Trouble::Bridge("spindle-fault", &[440]),
    Trouble::Bridge("spindle-silent", &[440, 100]),
    Trouble::Bridge("spindle-stall", &[440, 100]),
    Trouble::Bridge("spindle-slow", &[440, 100]),
    Trouble::Bridge("silent", &[401]),
    Trouble::Bridge("frozen", &[402]),
    Trouble::Bridge("fault:Y", &[406]),
    Trouble::Bridge("off:X", &[407]),
    Trouble::Bridge("jump:X", &[409]),
    Trouble::BridgeKilled,
    Trouble::BridgeKilled,
];

/// A program and its fault.
#[derive(Clone, Debug)]
pub(super) struct Case {
    pub(super) seed: u64,
    pub(super) program: String,
    pub(super) probes: bool,
    pub(super) changes: bool,
    pub(super) cuts: bool,
    /// Holds and stops act after a tap, when its tool is out of the hole.
    pub(super) taps: bool,
    pub(super) is_operator: bool,
    pub(super) trouble: Trouble,
    /// Time of the fault, s after START; for a fault of the bridge, after its drives became operational.
    pub(super) moment_s: f64,
    pub(super) pause_s: f64,
    pub(super) surface: f64,
}

impl Case {
    pub(super) fn new(seed: u64) -> Self {
        let mut random = Random::mixed(seed);
        let mut case = Self {
            seed,
            program: "G21 G90 G94 G54 G64 P0.01\nG53 G0 Z0\n".to_owned(),
            probes: false,
            changes: false,
            cuts: false,
            taps: false,
            is_operator: random.below(3) == 0,
            trouble: *random.one_of(&TROUBLES),
            moment_s: random.between(0.05, 5.0),
            pause_s: random.between(0.05, 1.0),
            surface: random.between(-9.0, -5.0),
        };
        let parts = 2 + random.below(3);
        for part in 0..parts {
            // The part that fails comes first.
            let kind = match (part, case.trouble) {
                (
                    0,
                    Trouble::ProbeTripped | Trouble::ProbeStuck | Trouble::ProbeLost | Trouble::ProbeEarly,
                ) => 0,
                (0, Trouble::ChangerSilent) => 1,
                (0, Trouble::Bridge(name, _)) if name.starts_with("spindle") => 2 + random.below(2),
                _ => random.below(4),
            };
            match kind {
                0 => case.add_probing(&mut random),
                1 => case.add_change(&mut random, part),
                2 => case.add_cut(&mut random),
                _ => case.add_tap(&mut random),
            }
        }
        case.program += "G0 X2 Y2\nM2\n";
        case
    }

    fn add_probing(&mut self, random: &mut Random) {
        self.probes = true;
        let [fast, slow] = [random.between(150.0, 900.0), random.between(60.0, 200.0)];
        let _written = writeln!(
            self.program,
            "G53 G0 Z0\nG0 X{:.1} Y{:.1}\nG0 Z-1\nG38.2 Z-12 F{fast:.0}\nG0 Z[#5063 + 1]\n\
             G38.2 Z-12 F{slow:.0}\nG53 G0 Z0",
            random.between(-20.0, 20.0),
            random.between(-20.0, 20.0),
        );
    }

    fn add_change(&mut self, random: &mut Random, part: usize) {
        self.changes = true;
        // Another tool each time: there is no prompt for the tool that is in the spindle.
        let tool = 2 + part + if part == 0 { 0 } else { random.below(2) };
        let _written = writeln!(self.program, "G53 G0 Z0\nT{tool} M6\nG43 G0 X3");
        self.program += "G49\n";
    }

    fn add_cut(&mut self, random: &mut Random) {
        self.cuts = true;
        let x = random.between(15.0, 30.0);
        let _written = writeln!(
            self.program,
            "G0 X{x:.2} Y0\nG96 S{:.0} D{:.0} M3\nG95 F{:.2}\nG1 X{:.2} Z-2",
            random.between(60.0, 200.0),
            random.between(900.0, 3000.0),
            random.between(0.3, 2.0),
            x + random.between(5.0, 30.0),
        );
        if random.below(2) == 0 {
            let _written = writeln!(self.program, "G1 X{x:.2} Y{:.2}", random.between(-10.0, 10.0));
        }
        self.program += "G94 G97 S500 M5\nG53 G0 Z0\n";
    }

    fn add_tap(&mut self, random: &mut Random) {
        self.taps = true;
        let _written = writeln!(
            self.program,
            "G0 X{:.1} Y{:.1}\nG0 Z-1\nS{:.0} M3\nG33.1 Z-{:.1} K{:.2}\nM5\nG53 G0 Z0",
            random.between(-20.0, 20.0),
            random.between(-20.0, 20.0),
            random.between(150.0, 700.0),
            random.between(10.0, 18.0),
            random.between(0.5, 1.5),
        );
    }

    /// Options of the first bridge.
    pub(super) fn options(&self) -> Vec<String> {
        let surface = match self.trouble {
            Trouble::ProbeEarly => -1.3,
            Trouble::ProbeTripped => -0.5,
            Trouble::ProbeStuck => -300.0,
            _ => self.surface,
        };
        let mut probe = format!("plane:Z<{surface:.3}");
        if self.trouble == Trouble::ProbeLost {
            // Counted from the start of the bridge if no contact comes first, so after power.
            let _written = write!(probe, ";lost={:.0}", 1000.0 * self.moment_s.min(1.5));
        }
        let mut options = vec![
            "--probe".to_owned(),
            probe,
            "--spindle-acceleration".to_owned(),
            "3000".to_owned(),
        ];
        if self.trouble != Trouble::ChangerSilent {
            options.push("--loopback".to_owned());
        }
        options.extend(self.trouble.fault_options(self.moment_s));
        options
    }

    pub(super) fn healthy(&self) -> Vec<String> {
        let healthy = Self {
            trouble: Trouble::Nothing,
            ..self.clone()
        };
        healthy.options()
    }

    /// Whether the fault may raise this alarm.
    pub(super) fn permits(&self, alarm: u32) -> bool {
        // Silence ends a tap at its depth before it is too long for the drives: nothing shows that the spindle
        // has reversed.
        let is_silent = matches!(self.trouble, Trouble::BridgeKilled | Trouble::Bridge("silent", _));
        self.trouble.alarms().contains(&alarm)
            || self.taps && is_silent && alarm == PROGRAM
            || self.changes && alarm == CHANGE_BROKEN_OFF
            || alarm == ZERO_MAY_HAVE_MOVED
            || alarm == 0
    }
}
