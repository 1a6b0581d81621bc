//! The motion of one axis: pieces of constant jerk.

use crate::state::AxisState;

/// Maximum number of pieces of one axis: two to brake below the limits and seven of ruckig, or fifteen of a
/// stop-and-go move, and four more if long pieces are divided for the landing.
pub const PIECES: usize = 20;

/// A piece of constant jerk from a known state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JerkSegment {
    /// Start time, s since the start of the transfer.
    pub start_s: f64,
    /// Duration, s.
    pub duration_s: f64,
    /// Position at its start, mm or degrees.
    pub position: f64,
    /// Velocity at its start, per s.
    pub velocity: f64,
    /// Acceleration at its start, per s2.
    pub acceleration: f64,
    /// Jerk, per s3.
    pub jerk: f64,
}

impl JerkSegment {
    pub(crate) fn state(&self) -> AxisState {
        AxisState {
            p: self.position,
            v: self.velocity,
            a: self.acceleration,
        }
    }
}

/// All pieces of one axis in order of time. A fixed-size value without heap that may be copied to the
/// real-time cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Track {
    pieces: [JerkSegment; PIECES],
    count: usize,
    end: AxisState,
    duration_s: f64,
}

impl Track {
    /// An axis that keeps `state` from time 0 on: an axis at rest, or the end of a completed move.
    pub(crate) fn resting(state: AxisState) -> Self {
        Self {
            pieces: [JerkSegment::default(); PIECES],
            count: 0,
            end: state,
            duration_s: 0.0,
        }
    }

    /// The track from `start` through `(duration, jerk)` steps. It ends at exactly `end`, whatever the
    /// rounding of the last piece; `None` for more than [`PIECES`] steps.
    pub(crate) fn through(start: AxisState, end: AxisState, steps: &[(f64, f64)]) -> Option<Self> {
        let mut track = Self::resting(end);
        let mut state = start;
        let mut time = 0.0;
        for &(duration, jerk) in steps {
            if duration <= 0.0 {
                continue;
            }
            *track.pieces.get_mut(track.count)? = JerkSegment {
                start_s: time,
                duration_s: duration,
                position: state.p,
                velocity: state.v,
                acceleration: state.a,
                jerk,
            };
            track.count += 1;
            state = state.after(duration, jerk);
            time += duration;
        }
        track.duration_s = time;
        Some(track)
    }

    /// The pieces in order of time; none for an axis at rest. Real-time safe.
    #[must_use]
    pub fn pieces(&self) -> &[JerkSegment] {
        self.pieces.get(..self.count).unwrap_or(&[])
    }

    /// Time at which this axis reaches its target, s. Real-time safe.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.duration_s
    }

    pub(crate) fn end(&self) -> AxisState {
        self.end
    }

    /// State and jerk at `t` seconds: the start before 0, the target after the end.
    pub(crate) fn at(&self, t: f64) -> (AxisState, f64) {
        // Negated so that NaN counts as the end.
        if !(t < self.duration_s) {
            return (self.end, 0.0);
        }
        let t = t.max(0.0);
        let mut found = None;
        for piece in self.pieces() {
            if piece.start_s > t {
                break;
            }
            found = Some(piece);
        }
        match found {
            Some(piece) => (piece.state().after(t - piece.start_s, piece.jerk), piece.jerk),
            None => (self.end, 0.0),
        }
    }
}
