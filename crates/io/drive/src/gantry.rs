//! Two motors of one axis: their beam is squared, and the limit of their difference is watched.

use core::fmt;

use crate::power::PowerRequest;
use crate::status_word::DriveState;

/// A home switch that opens for a shorter time, s, has bounced: its edge is the first one.
const BOUNCE_S: f64 = 0.02;
/// Slower than this, per second, an axis does not move towards a switch.
const STANDING: f64 = 1e-6;

/// The second motor of an axis. Lengths are mm or degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GantrySettings {
    /// Its coordinate minus that of the first motor when the beam is square.
    pub squaring_offset: f64,
    /// Maximum additional difference.
    pub max_difference: f64,
    /// Speed of squaring.
    pub square_velocity: f64,
}

/// Why the motors of a gantry stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GantryFault {
    /// The second motor is so far from where it would be on a square beam, more than `max_difference`.
    Apart {
        /// Positive if it is ahead in the positive direction.
        difference: f64,
    },
    /// The home switch of the other motor has closed, and this one's had not by `max_difference` later.
    SwitchMissing {
        /// 0 for the first motor, 1 for the second.
        side: usize,
    },
}

impl fmt::Display for GantryFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Apart { difference } => write!(
                f,
                "the second drive is {difference:.3} from where it is on a square beam, more than \
                 max_difference: all drives stop; find what holds it, then make the beam square by hand or \
                 home again"
            ),
            Self::SwitchMissing { side } => {
                let [closed, missing] = if side == 0 {
                    ["second", "first"]
                } else {
                    ["first", "second"]
                };
                write!(
                    f,
                    "the home switch of the {missing} drive has not closed within max_difference of that of \
                     the {closed}: all drives stop; check both switches and their wiring, then make the \
                     beam square by hand and home again"
                )
            }
        }
    }
}

/// Readings and commands of one period. Arrays have the first motor, then the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GantryInputs {
    /// Both motors follow their targets.
    pub is_enabled: bool,
    /// The core's request to the power stages.
    pub power: PowerRequest,
    /// The coordinates of the motors.
    pub position: [f64; 2],
    /// The commanded velocity of the axis.
    pub velocity: f64,
    /// Their home switches, where the beam is squared by them.
    pub switches: Option<[bool; 2]>,
    /// The difference of the distances they have moved, while their coordinates do not refer to one zero.
    pub strain: Option<f64>,
    /// Duration of the period, s.
    pub period_s: f64,
}

/// An edge at which a home switch has closed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Edge {
    /// The coordinate of its motor.
    position: f64,
    /// Sign of the velocity; 0 at rest.
    direction: f64,
}

/// The switch of one motor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct SideSwitch {
    was_closed: bool,
    edge: Option<Edge>,
    /// For how long it has been open since that edge.
    open_s: f64,
}

impl SideSwitch {
    fn step(&mut self, is_closed: bool, now: Edge, period_s: f64) {
        if is_closed {
            if !self.was_closed && self.edge.is_none() {
                self.edge = Some(now);
            }
            self.open_s = 0.0;
        } else {
            self.open_s += period_s;
            if self.is_open() {
                self.edge = None;
            }
        }
        self.was_closed = is_closed;
    }

    fn is_open(&self) -> bool {
        self.open_s > BOUNCE_S
    }

    fn rename(&mut self, shift: f64) {
        if let Some(edge) = &mut self.edge {
            edge.position += shift;
        }
    }
}

/// Both edges of one approach.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Found {
    edges: [f64; 2],
    /// The coordinate of the axis in the period in which the second of them came: that of which the core
    /// takes note.
    at: f64,
}

/// Two motors that move one axis. A plain value; may be used by a real-time cycle.
///
/// The core knows the axis only: its coordinate is that of the first motor ([`Gantry::position`]), and its
/// home switch ([`Gantry::home_switch`]) closes when both have closed and opens when both have opened. Each
/// motor's target is the setpoint plus [`Gantry::offset`].
///
/// When power comes on, the second motor moves at `square_velocity` until it is `squaring_offset` above the
/// first. Home switches tell where each motor is: the edges of the approach after which the core assigns
/// machine zero rename both motors ([`Gantry::rename`]), and both move to where their names say.
///
/// ```
/// use evolvent_drive::{Gantry, GantryInputs, GantrySettings, PowerRequest};
///
/// let mut gantry = Gantry::new(GantrySettings {
///     squaring_offset: 0.0,
///     max_difference: 1.0,
///     square_velocity: 2.0,
/// });
/// let mut inputs = GantryInputs {
///     is_enabled: true,
///     power: PowerRequest::On,
///     position: [10.0, 10.003],
///     velocity: 0.0,
///     switches: None,
///     strain: None,
///     period_s: 0.001,
/// };
/// gantry.step(&inputs);
/// assert!((gantry.offset(1) - 0.003).abs() < 1e-9); // it begins where the motor is,
/// gantry.step(&inputs);
/// assert!((gantry.offset(1) - 0.001).abs() < 1e-9); // and goes to zero at 2 mm/s
/// inputs.position[1] = 11.5;
/// gantry.step(&inputs);
/// assert!(gantry.fault().is_some());
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gantry {
    settings: GantrySettings,
    /// Distance of each motor from where it would be on a square beam at the setpoint, as far as it is
    /// intended.
    apart: [f64; 2],
    velocity: [f64; 2],
    is_following: bool,
    switches: [SideSwitch; 2],
    is_closed: bool,
    found: Option<Found>,
    squared: Option<f64>,
    fault: Option<GantryFault>,
}

impl Gantry {
    /// A gantry without power.
    #[must_use]
    pub const fn new(settings: GantrySettings) -> Self {
        const OPEN: SideSwitch = SideSwitch {
            was_closed: false,
            edge: None,
            open_s: 0.0,
        };
        Self {
            settings,
            apart: [0.0; 2],
            velocity: [0.0; 2],
            is_following: false,
            switches: [OPEN; 2],
            is_closed: false,
            found: None,
            squared: None,
            fault: None,
        }
    }

    /// What has to be added to the coordinate of the second motor for the beam to count as square.
    #[must_use]
    pub fn alignment(&self, position: [f64; 2]) -> f64 {
        -self.difference(position)
    }

    /// The second motor's distance from where it would be on a square beam.
    fn difference(&self, position: [f64; 2]) -> f64 {
        position[1] - self.settings.squaring_offset - position[0]
    }

    /// The coordinate of the axis, from that of the first motor.
    #[must_use]
    pub fn position(&self, first: f64) -> f64 {
        first - self.apart[0]
    }

    /// What is added to the setpoint for the target of a motor.
    #[must_use]
    pub fn offset(&self, side: usize) -> f64 {
        let squaring_offset = if side == 1 {
            self.settings.squaring_offset
        } else {
            0.0
        };
        self.apart[side] + squaring_offset
    }

    /// The velocity of that addition.
    #[must_use]
    pub const fn velocity(&self, side: usize) -> f64 {
        self.velocity[side]
    }

    /// Whether the axis is at its home switch, for the core: at both, and until both have opened.
    #[must_use]
    pub const fn home_switch(&self) -> bool {
        self.is_closed
    }

    /// The limit switches of a side at the negative and the positive end, as the core has to see them. A home
    /// switch may be the limit switch as well: from its edge until both have closed the one in the direction
    /// of motion is hidden, because the core would stop before the other side has come there. If that does
    /// not come within `max_difference`, that is the fault.
    #[must_use]
    pub fn limits(&self, side: usize, pressed: [bool; 2]) -> [bool; 2] {
        if self.is_closed || self.fault.is_some() {
            return pressed;
        }
        let Some(edge) = self.switches.get(side).and_then(|switch| switch.edge) else {
            return pressed;
        };
        [
            pressed[0] && edge.direction >= 0.0,
            pressed[1] && edge.direction <= 0.0,
        ]
    }

    /// Why both motors have to stop; until the core switches power off.
    #[must_use]
    pub const fn fault(&self) -> Option<GantryFault> {
        self.fault
    }

    /// How far the second motor was from square when the core has homed the axis by both switches: once after
    /// each homing.
    pub const fn take_squared(&mut self) -> Option<f64> {
        self.squared.take()
    }

    /// The core has assigned new coordinates, by `shift` for this axis: its motors are renamed by the result.
    /// `is_homed`: it is the axis that has been homed.
    ///
    /// If both switches have closed on the way, each motor's edge receives the coordinate that the axis had
    /// when the second closed, which is the one that the core has homed by. The names are then true, the
    /// targets stay where they are, and the difference is removed at the squaring velocity.
    #[must_use]
    pub fn rename(&mut self, shift: f64, is_homed: bool) -> [f64; 2] {
        let mut by = [shift; 2];
        if is_homed && let Some(found) = self.found.take() {
            for side in 0..2 {
                let correction = found.at - found.edges[side];
                self.apart[side] += correction;
                by[side] += correction;
            }
            self.squared = Some(self.apart[1] - self.apart[0]);
        }
        for (switch, by) in self.switches.iter_mut().zip(by) {
            switch.rename(by);
        }
        if let Some(found) = &mut self.found {
            found.at += shift;
            found.edges = found.edges.map(|edge| edge + shift);
        }
        by
    }

    /// By how much the second motor is ahead of square, if the switches have closed at `edges` and the motors
    /// are at `position`.
    fn racked(&self, edges: [f64; 2], position: [f64; 2]) -> f64 {
        (position[1] - edges[1] - self.settings.squaring_offset) - (position[0] - edges[0])
    }

    /// One period.
    pub fn step(&mut self, inputs: &GantryInputs) {
        if inputs.power == PowerRequest::Off {
            self.fault = None;
        }
        let difference = self.difference(inputs.position);
        self.square(inputs, difference);
        if let Some(switches) = inputs.switches {
            self.watch_switches(inputs, switches);
        }
        let strain = inputs.strain.unwrap_or(difference);
        if strain.abs() > self.settings.max_difference {
            self.fail(inputs.power, GantryFault::Apart { difference: strain });
        }
    }

    fn fail(&mut self, power: PowerRequest, fault: GantryFault) {
        if power != PowerRequest::Off {
            self.fault.get_or_insert(fault);
        }
    }

    /// Moves both to where they are on a square beam, from where they are when power comes on.
    fn square(&mut self, inputs: &GantryInputs, difference: f64) {
        let before = self.apart;
        if inputs.is_enabled && self.is_following {
            let most = self.settings.square_velocity * inputs.period_s;
            self.apart = self.apart.map(|apart| apart - apart.clamp(-most, most));
            for side in 0..2 {
                self.velocity[side] = (self.apart[side] - before[side]) / inputs.period_s;
            }
        } else {
            // The axis is where its first motor is.
            (self.apart, self.velocity) = ([0.0, difference], [0.0; 2]);
        }
        self.is_following = inputs.is_enabled;
    }

    fn watch_switches(&mut self, inputs: &GantryInputs, closed: [bool; 2]) {
        if !inputs.is_enabled {
            // Edges without power were made by hand. One that is closed has to open before both are searched
            // for.
            self.switches = closed.map(|was_closed| SideSwitch {
                was_closed,
                ..SideSwitch::default()
            });
            (self.is_closed, self.found) = (closed[0] || closed[1], None);
            return;
        }
        let direction = if inputs.velocity.abs() > STANDING {
            inputs.velocity.signum()
        } else {
            0.0
        };
        for side in 0..2 {
            let now = Edge {
                position: inputs.position[side],
                direction,
            };
            self.switches[side].step(closed[side], now, inputs.period_s);
        }
        if self.is_closed {
            // A switch that bounces at its edge must not give the core another one.
            if self.switches.iter().all(SideSwitch::is_open) {
                (self.is_closed, self.found) = (false, None);
            }
            return;
        }
        match closed {
            [true, true] => {
                self.is_closed = true;
                self.found = self.both_found(inputs.position[0]);
                if let Some(found) = self.found {
                    let racked = self.racked(found.edges, inputs.position);
                    if racked.abs() > self.settings.max_difference {
                        self.fail(inputs.power, GantryFault::Apart { difference: racked });
                    }
                }
            }
            [true, false] => self.watch_missing(inputs, 1),
            [false, true] => self.watch_missing(inputs, 0),
            [false, false] => {}
        }
    }

    /// Edges of one approach, in one direction.
    fn both_found(&self, first: f64) -> Option<Found> {
        let [Some(one), Some(other)] = self.switches.map(|switch| switch.edge) else {
            return None;
        };
        (one.direction == other.direction && one.direction != 0.0).then_some(Found {
            edges: [one.position, other.position],
            at: self.position(first),
        })
    }

    /// If the switch of `side` closed now, the beam would be racked by this much already.
    fn watch_missing(&mut self, inputs: &GantryInputs, side: usize) {
        let Some(edge) = self.switches[1 - side].edge else {
            return;
        };
        let mut edges = inputs.position;
        edges[1 - side] = edge.position;
        let racked = self.racked(edges, inputs.position);
        // Positive where this side is behind.
        let behind = edge.direction * if side == 0 { racked } else { -racked };
        if behind > self.settings.max_difference {
            self.fail(inputs.power, GantryFault::SwitchMissing { side });
        }
    }
}

/// Of the status words of two drives of one axis the one that is farther from operation, faults first.
#[must_use]
pub fn worse_status(one: u16, other: u16) -> u16 {
    if distance_from_operation(other) > distance_from_operation(one) {
        other
    } else {
        one
    }
}

fn distance_from_operation(status_word: u16) -> u8 {
    match DriveState::decode(status_word) {
        Some(DriveState::OperationEnabled) => 0,
        Some(DriveState::SwitchedOn) => 1,
        Some(DriveState::ReadyToSwitchOn) => 2,
        Some(DriveState::SwitchOnDisabled) => 3,
        Some(DriveState::NotReadyToSwitchOn) => 4,
        Some(DriveState::QuickStopActive) => 5,
        None => 6,
        Some(DriveState::FaultReactionActive) => 7,
        Some(DriveState::Fault) => 8,
    }
}

/// Whether a change of datum by `shift` of all axes means that the axis with this one has been homed: the
/// core homes one after the other, and a shift of zero is possible.
#[must_use]
pub fn is_homed(shift: &[f64], of_axis: f64) -> bool {
    of_axis != 0.0 || shift.iter().all(|shift| *shift == 0.0)
}
