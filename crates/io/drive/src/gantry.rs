//! Two motors of one axis: squares their beam, and monitors the limit of their difference.

use core::fmt;

use crate::power::PowerRequest;
use crate::status_word::DriveState;

/// A home switch that opens for less than this time, s, has bounced: its first edge counts.
const BOUNCE_S: f64 = 0.02;
/// Velocity below which an axis does not count as moving towards a switch, per second.
const STANDING: f64 = 1e-6;

/// The second motor of an axis. Lengths are mm or degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GantrySettings {
    /// Coordinate of the second motor minus that of the first when the beam is square.
    pub squaring_offset: f64,
    /// Maximum additional difference.
    pub max_difference: f64,
    /// Speed of squaring.
    pub square_velocity: f64,
}

/// Why the motors of a gantry stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GantryFault {
    /// The second motor is more than `max_difference` away from its position on a square beam.
    Apart {
        /// Positive if it is ahead in the positive direction.
        difference: f64,
    },
    /// The home switch of the other motor has closed, and this one's had not closed after `max_difference`.
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
    /// Their home switches, if the beam is squared by them.
    pub switches: Option<[bool; 2]>,
    /// The difference of the distances that they have moved, while their coordinates have no common zero.
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
    /// Time for which it has been open since that edge.
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
    /// The coordinate of the axis in the period of the second edge, which the core records.
    at: f64,
}

/// Two motors that move one axis. A plain value; may be used by a real-time cycle.
///
/// The core knows the axis only: its coordinate is that of the first motor ([`Gantry::position`]), and its
/// home switch ([`Gantry::home_switch`]) closes when both have closed and opens when both have opened. Each
/// motor's target is the setpoint plus [`Gantry::offset`].
///
/// When power comes on, the second motor moves at `square_velocity` until it is `squaring_offset` above the
/// first. Home switches locate each motor: after the approach from which the core assigns machine zero, the
/// edges give both motors new coordinates ([`Gantry::rename`]), and both move to them.
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
    /// Intended distance of each motor from its position on a square beam at the setpoint.
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
    /// Creates a gantry without power.
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

    /// The amount to add to the coordinate of the second motor for the beam to count as square.
    #[must_use]
    pub fn alignment(&self, position: [f64; 2]) -> f64 {
        -self.difference(position)
    }

    /// The second motor's distance from its position on a square beam.
    fn difference(&self, position: [f64; 2]) -> f64 {
        position[1] - self.settings.squaring_offset - position[0]
    }

    /// The coordinate of the axis, from that of the first motor.
    #[must_use]
    pub fn position(&self, first: f64) -> f64 {
        first - self.apart[0]
    }

    /// The offset of a motor's target from the setpoint.
    #[must_use]
    pub fn offset(&self, side: usize) -> f64 {
        let squaring_offset = if side == 1 {
            self.settings.squaring_offset
        } else {
            0.0
        };
        self.apart[side] + squaring_offset
    }

    /// The velocity of [`Gantry::offset`].
    #[must_use]
    pub const fn velocity(&self, side: usize) -> f64 {
        self.velocity[side]
    }

    /// Whether the axis is at its home switch, for the core: from the closing of both switches until both
    /// have opened.
    #[must_use]
    pub const fn home_switch(&self) -> bool {
        self.is_closed
    }

    /// The limit switches of a side at the negative and the positive end, as reported to the core. A home
    /// switch may also be the limit switch: from its edge until both have closed, the limit switch in the
    /// direction of motion is hidden, because the core would stop before the other side reaches its switch.
    /// If the other side does not reach it within `max_difference`, the gantry is in fault.
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

    /// Why both motors have to stop, until the core switches power off.
    #[must_use]
    pub const fn fault(&self) -> Option<GantryFault> {
        self.fault
    }

    /// Returns the distance of the second motor from square when the core homed the axis by both switches,
    /// once after each homing.
    pub const fn take_squared(&mut self) -> Option<f64> {
        self.squared.take()
    }

    /// Handles new coordinates of the core, shifted by `shift` for this axis. Returns the shifts of the
    /// motors' coordinates. `is_homed`: this axis has been homed.
    ///
    /// If both switches have closed during the approach, each motor's edge receives the coordinate that the
    /// axis had when the second switch closed, which is the one that the core has homed by. The coordinates
    /// are then true, the targets do not move, and the difference is removed at the squaring velocity.
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

    /// The lead of the second motor relative to a square beam, if the switches have closed at `edges` and the
    /// motors are at `position`.
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

    /// Moves both motors to a square beam, from their positions at power-on.
    fn square(&mut self, inputs: &GantryInputs, difference: f64) {
        let before = self.apart;
        if inputs.is_enabled && self.is_following {
            let max = self.settings.square_velocity * inputs.period_s;
            self.apart = self.apart.map(|apart| apart - apart.clamp(-max, max));
            for side in 0..2 {
                self.velocity[side] = (self.apart[side] - before[side]) / inputs.period_s;
            }
        } else {
            // The axis has the position of its first motor.
            (self.apart, self.velocity) = ([0.0, difference], [0.0; 2]);
        }
        self.is_following = inputs.is_enabled;
    }

    fn watch_switches(&mut self, inputs: &GantryInputs, closed: [bool; 2]) {
        if !inputs.is_enabled {
            // Edges without power were made by hand. A closed switch must open before both are searched for.
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
            // A switch that bounces at its edge must not show the core another edge.
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

    /// Checks how far the beam would be racked if the switch of `side` closed now.
    fn watch_missing(&mut self, inputs: &GantryInputs, side: usize) {
        let Some(edge) = self.switches[1 - side].edge else {
            return;
        };
        let mut edges = inputs.position;
        edges[1 - side] = edge.position;
        let racked = self.racked(edges, inputs.position);
        // Positive if this side lags.
        let behind = edge.direction * if side == 0 { racked } else { -racked };
        if behind > self.settings.max_difference {
            self.fail(inputs.power, GantryFault::SwitchMissing { side });
        }
    }
}

/// Returns the status word of the drive that is farther from operation, of two drives of one axis; faults
/// first.
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

/// Whether a change of datum by `shift` means that the axis with the shift `of_axis` has been homed: the core
/// homes one axis after the other, and a shift of zero is possible.
#[must_use]
pub fn is_homed(shift: &[f64], of_axis: f64) -> bool {
    of_axis != 0.0 || shift.iter().all(|shift| *shift == 0.0)
}
