//! Touch probe 1 of a drive (60B8h, 60B9h, 60BAh), always armed for the next rising edge, and touches latched
//! by several drives.

use evolvent_bus::AXES;
use evolvent_path::AxisMask;

/// Edges of all drives within this time belong to one touch, ns: a contact bounces for some ms, and no touch
/// ends and recurs sooner.
const TOUCH_NS: u64 = 20_000_000;

/// Enabled, first event, probe input, rising edge.
const ARM: u16 = 1 | 1 << 4;
/// Bits of 60B9h.
const ENABLED: u16 = 1;
const STORED: u16 = 1 << 1;

/// Latched data of one drive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TouchProbe {
    pub(crate) is_armed: bool,
    /// Increments at the last one.
    pub(crate) latched: i32,
}

impl TouchProbe {
    /// One period: status and latched position of the drive. Returns whether an edge has occurred.
    pub(crate) fn step(&mut self, status: u16, latched: i32) -> bool {
        if !self.is_armed {
            // The last edge is stored until the function has been off.
            self.is_armed = status & (ENABLED | STORED) == 0;
            return false;
        }
        if status & (ENABLED | STORED) != ENABLED | STORED {
            return false;
        }
        (self.is_armed, self.latched) = (false, latched);
        true
    }

    /// Object 60B8h.
    pub(crate) const fn function(&self) -> u16 {
        if self.is_armed { ARM } else { 0 }
    }
}

/// The touches of a probe that is wired to several drives. A drive that has latched a bounce, or nothing, is
/// wrong for this touch only.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Touches {
    /// Touches since the start of the session.
    pub(crate) count: u64,
    begun_ns: u64,
    /// Axes that have latched the last touch, and the positions.
    pub(crate) axes: AxisMask,
    pub(crate) position: [f64; AXES],
}

impl Touches {
    /// Takes an edge that a drive has latched at this machine coordinate of its axis.
    pub(crate) fn take(&mut self, now_ns: u64, axis: usize, position: f64) {
        if self.count == 0 || now_ns.saturating_sub(self.begun_ns) > TOUCH_NS {
            self.count += 1;
            (self.begun_ns, self.axes) = (now_ns, AxisMask::NONE);
        }
        // A second edge of the same touch is a bounce: the first edge is the contact.
        if !self.axes.contains(axis) {
            self.axes |= AxisMask::one(axis);
            self.position[axis] = position;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive according to CiA 402: the latched data persist until the function is off, and are cleared when
    /// it is on again.
    #[test]
    fn each_edge_counts_once_and_it_is_armed_again() {
        let (mut probe, mut stored) = (TouchProbe::default(), Some(5));
        let mut seen = Vec::new();
        for period in 0..40 {
            let mut enabled = period < 2;
            if probe.function() == 0 && period >= 2 {
                stored = None;
            } else {
                enabled = true;
                if [10, 11, 20].contains(&period) && stored.is_none() {
                    stored = Some(100 + period);
                }
            }
            let status = u16::from(enabled) | u16::from(stored.is_some()) << 1;
            if probe.step(status, stored.unwrap_or(0)) {
                seen.push(probe.latched);
            }
        }
        assert_eq!(seen, [110, 120], "one of a session before counts not");
    }
}
