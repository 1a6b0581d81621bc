//! A simulated touch probe: surfaces in machine coordinates, a delay, bouncing contacts.

use std::str::FromStr;

use evolvent_bus::{AXES, MachineInputs};

/// Values of the probe's states on the bus.
const OPEN: u32 = 1;
const TRIPPED: u32 = 2;

/// A surface that the probe can touch, in true machine positions, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// Contact above or below a coordinate of one axis.
    Plane {
        /// Index of the axis.
        axis: usize,
        /// Coordinate of the plane.
        at: f64,
        /// Contact is made above it; otherwise below it.
        above: bool,
    },
    /// Contact outside a bore along Z.
    Bore {
        /// X and Y of the centre.
        centre: [f64; 2],
        /// Radius.
        radius: f64,
        /// Z of its edge; there is no contact above it.
        top: f64,
    },
    /// Contact inside a boss along Z.
    Boss {
        /// X and Y of the centre.
        centre: [f64; 2],
        /// Radius.
        radius: f64,
        /// Z of its top face.
        top: f64,
    },
    /// Contact inside a block.
    Block {
        /// Lowest X, Y, Z.
        low: [f64; 3],
        /// Highest X, Y, Z.
        high: [f64; 3],
    },
}

impl Surface {
    /// Whether a point touches the surface.
    #[must_use]
    pub fn touches(&self, position: &[f64; AXES]) -> bool {
        let from = |centre: &[f64; 2]| (position[0] - centre[0]).hypot(position[1] - centre[1]);
        match self {
            Self::Plane { axis, at, above } => {
                if *above {
                    position[*axis] >= *at
                } else {
                    position[*axis] <= *at
                }
            }
            Self::Bore { centre, radius, top } => position[2] <= *top && from(centre) >= *radius,
            Self::Boss { centre, radius, top } => position[2] <= *top && from(centre) <= *radius,
            Self::Block { low, high } => {
                (0..3).all(|axis| (low[axis]..=high[axis]).contains(&position[axis]))
            }
        }
    }
}

/// Settings of a probe.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProbeSettings {
    /// Surfaces that it can touch.
    pub surfaces: Vec<Surface>,
    /// Known part of the delay, ns: the message is sent this long after the time that it contains.
    pub delay_ns: u64,
    /// Unknown part of the delay, ns: the time in the message is this much later than the contact.
    pub unknown_delay_ns: u64,
    /// Whether the drives latch their positions at a contact.
    pub latches: bool,
    /// Number of times that the contact opens and closes again when the probe trips, one period each.
    pub bounces: u32,
    /// Time from the first contact, or from the start before any contact, after which it stops sending, ns.
    pub lost_after_ns: Option<u64>,
}

/// `plane:X>12.5`, `plane:Z<-3`, `bore:CX,CY,DIAMETER,TOP`, `boss:CX,CY,DIAMETER,TOP` or
/// `block:X1,X2,Y1,Y2,Z1,Z2`; several separated by `+`. The other settings follow after a `;`, in any order:
/// `delay=MS`, `late=MS`, `bounces=N`, `lost=MS`, `latched`.
impl FromStr for ProbeSettings {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts = text.split(';');
        let mut settings = Self::default();
        for surface in parts.next().unwrap_or_default().split('+') {
            settings.surfaces.push(surface_of(surface.trim())?);
        }
        for part in parts {
            let part = part.trim();
            let Some((key, value)) = part.split_once('=') else {
                if part == "latched" {
                    settings.latches = true;
                    continue;
                }
                return Err(format!(
                    "{part:?} is not a property of a probe: give delay=MS, late=MS, bounces=N, lost=MS or \
                     latched"
                ));
            };
            let milliseconds = || {
                let number = number(value)?;
                if (0.0..=60_000.0).contains(&number) {
                    Ok((number * 1e6) as u64)
                } else {
                    Err(format!("{value} ms is out of range: choose 0 to 60000"))
                }
            };
            match key {
                "delay" => settings.delay_ns = milliseconds()?,
                "late" => settings.unknown_delay_ns = milliseconds()?,
                "lost" => settings.lost_after_ns = Some(milliseconds()?),
                "bounces" => {
                    settings.bounces = value
                        .parse()
                        .map_err(|_| format!("{value:?} is not a number of bounces"))?;
                }
                _ => {
                    return Err(format!(
                        "{key:?} is not a property of a probe: give delay, late, bounces, lost or latched"
                    ));
                }
            }
        }
        Ok(settings)
    }
}

fn number(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() && value.abs() <= 1e6 => Ok(value),
        _ => Err(format!("{text:?} is not a number of at most a million")),
    }
}

fn surface_of(text: &str) -> Result<Surface, String> {
    let shapes = "give plane:Z<-3, bore:X,Y,DIAMETER,TOP, boss:X,Y,DIAMETER,TOP or block:X1,X2,Y1,Y2,Z1,Z2";
    let (kind, rest) = text
        .split_once(':')
        .ok_or_else(|| format!("{text:?} is not a surface: {shapes}"))?;
    if kind == "plane" {
        let axis = rest
            .chars()
            .next()
            .and_then(|letter| "XYZABCUVW".find(letter.to_ascii_uppercase()));
        let sign = rest.get(1..2).unwrap_or_default();
        let (Some(axis), "<" | ">") = (axis, sign) else {
            return Err(format!(
                "{rest:?} is not a plane: give an axis, < or >, and a coordinate, as in Z<-3"
            ));
        };
        let at = number(rest.get(2..).unwrap_or_default())?;
        return Ok(Surface::Plane {
            axis,
            at,
            above: sign == ">",
        });
    }
    let numbers = rest.split(',').map(number).collect::<Result<Vec<_>, _>>()?;
    match (kind, &numbers[..]) {
        ("bore", &[x, y, diameter, top]) if diameter > 0.0 => Ok(Surface::Bore {
            centre: [x, y],
            radius: 0.5 * diameter,
            top,
        }),
        ("boss", &[x, y, diameter, top]) if diameter > 0.0 => Ok(Surface::Boss {
            centre: [x, y],
            radius: 0.5 * diameter,
            top,
        }),
        ("block", &[x1, x2, y1, y2, z1, z2]) if x1 < x2 && y1 < y2 && z1 < z2 => Ok(Surface::Block {
            low: [x1, y1, z1],
            high: [x2, y2, z2],
        }),
        _ => Err(format!("{text:?} is not a surface: {shapes}")),
    }
}

/// A change that has not been reported yet.
#[derive(Clone, Copy, Debug)]
struct Change {
    report_ns: u64,
    is_tripped: bool,
    time_ns: u64,
    position: [f64; AXES],
}

/// A probe, simulated over time.
#[derive(Clone, Debug)]
pub struct SimProbe {
    settings: ProbeSettings,
    before: Option<(u64, [f64; AXES], bool)>,
    changes: std::collections::VecDeque<Change>,
    first_contact_ns: Option<u64>,
    begin_ns: Option<u64>,
    now_ns: u64,
    reported: Option<Change>,
    trips: u64,
}

impl SimProbe {
    /// Creates a probe without contact.
    #[must_use]
    pub fn new(settings: ProbeSettings) -> Self {
        Self {
            settings,
            before: None,
            changes: std::collections::VecDeque::new(),
            first_contact_ns: None,
            begin_ns: None,
            now_ns: 0,
            reported: None,
            trips: 0,
        }
    }

    /// Takes the true positions after one period, and the positions `shown` by the encoders. Axes move along
    /// a straight line between two periods, and the contact is located on this line.
    pub fn step(&mut self, now_ns: u64, position: &[f64; AXES], shown: &[f64; AXES]) {
        self.begin_ns.get_or_insert(now_ns);
        self.now_ns = now_ns;
        let touches = |at: &[f64; AXES]| self.settings.surfaces.iter().any(|surface| surface.touches(at));
        let is_now = touches(position);
        if let Some((time_ns, from, was)) = self.before
            && was != is_now
        {
            let at = |fraction: f64| -> [f64; AXES] {
                std::array::from_fn(|axis| from[axis] + fraction * (position[axis] - from[axis]))
            };
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if touches(&at(middle)) == was {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            let contact_ns = time_ns + ((now_ns - time_ns) as f64 * high) as u64;
            let truly = at(high);
            let offset: [f64; AXES] = std::array::from_fn(|axis| shown[axis] - position[axis]);
            let named: [f64; AXES] = std::array::from_fn(|axis| truly[axis] + offset[axis]);
            let period_ns = now_ns - time_ns;
            let change = |number: u64, is_tripped| Change {
                report_ns: contact_ns
                    + self.settings.delay_ns
                    + self.settings.unknown_delay_ns
                    + number * period_ns,
                is_tripped,
                time_ns: contact_ns + self.settings.unknown_delay_ns + number * period_ns,
                position: named,
            };
            self.changes.push_back(change(0, is_now));
            if is_now {
                self.first_contact_ns.get_or_insert(contact_ns);
                for bounce in 0..u64::from(self.settings.bounces) {
                    self.changes.push_back(change(2 * bounce + 1, false));
                    self.changes.push_back(change(2 * bounce + 2, true));
                }
            }
        } else if self.before.is_none() && is_now {
            self.changes.push_back(Change {
                report_ns: now_ns,
                is_tripped: true,
                time_ns: now_ns,
                position: *shown,
            });
        }
        self.before = Some((now_ns, *position, is_now));
    }

    /// Advances to the next change that is due to be reported. Returns whether there was one.
    pub fn advance(&mut self) -> bool {
        let is_due = self
            .changes
            .front()
            .is_some_and(|change| change.report_ns <= self.now_ns);
        if is_due {
            self.reported = self.changes.pop_front();
            self.trips += u64::from(self.reported.is_some_and(|change| change.is_tripped));
        }
        is_due
    }

    /// Writes the state of the probe into a message.
    pub fn describe(&self, message: &mut MachineInputs) {
        let since = if self.settings.surfaces.is_empty() {
            self.begin_ns
        } else {
            self.first_contact_ns.or(self.begin_ns)
        };
        let is_lost = match (self.settings.lost_after_ns, since) {
            (Some(after_ns), Some(since_ns)) => self.now_ns >= since_ns + after_ns,
            _ => false,
        };
        if is_lost {
            message.probe = 0;
            return;
        }
        message.probe = OPEN;
        message.probe_trips = self.trips;
        if let Some(reported) = &self.reported {
            message.probe = if reported.is_tripped { TRIPPED } else { OPEN };
            message.probe_time_ns = reported.time_ns;
            if self.settings.latches {
                message.probe_position = reported.position;
                message.probe_latched_mask = (1 << AXES) - 1;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contact_is_interpolated_and_delayed() {
        let settings: ProbeSettings = "plane:Z<-3;delay=2;latched".parse().unwrap();
        let mut probe = SimProbe::new(settings);
        let mut message = MachineInputs::default();
        let at = |z: f64| {
            let mut position = [0.0; AXES];
            position[2] = z;
            position
        };
        for (period, z) in [(0, -2.0), (1, -2.5), (2, -3.25), (3, -3.25)] {
            probe.step(period * 1_000_000, &at(z), &at(z + 10.0));
            assert!(!probe.advance());
            probe.describe(&mut message);
            assert_eq!(message.probe, OPEN);
        }
        probe.step(4_000_000, &at(-3.25), &at(6.75));
        assert!(probe.advance());
        probe.describe(&mut message);
        assert_eq!((message.probe, message.probe_trips), (TRIPPED, 1));
        assert!(
            message.probe_time_ns.abs_diff(1_666_667) <= 1,
            "{}",
            message.probe_time_ns
        );
        // In the coordinates that the encoders show.
        assert!((message.probe_position[2] - 7.0).abs() < 1e-9);
    }

    #[test]
    fn what_is_no_probe_is_refused_with_a_cure() {
        for text in [
            "",
            "plane:Q<1",
            "plane:Z=1",
            "bore:1,2,0,4",
            "ball:1",
            "plane:Z<1;delay=-1",
            "plane:Z<1;slow",
        ] {
            let message = text.parse::<ProbeSettings>().unwrap_err();
            assert!(
                ["give", "choose"].iter().any(|cure| message.contains(cure)),
                "{text}: {message}"
            );
        }
    }
}
