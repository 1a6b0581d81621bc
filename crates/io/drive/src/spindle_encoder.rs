//! The encoder of a spindle: converts the counts of a wrapping counter and index pulses to the angle, the
//! speed and the faults on the bus.

use evolvent_wire::{SpindleFeedback, spindle_flags};

/// Directions of a spindle on the bus.
const STOPPED: u32 = 0;
const CLOCKWISE: u32 = 1;
const COUNTER_CLOCKWISE: u32 = 2;
/// Readings kept for the speed. At the shortest spacing they cover [`LONGEST_WINDOW_NS`].
const READINGS: usize = 128;
/// Minimum time between kept readings: shorter periods need no more of them.
const SPACING_NS: u64 = 800_000;
/// The speed is measured over this many counts, which is accurate to 0.4 %, but over at least the shorter and
/// at most the longer time below. A slow spindle is measured from edge to edge, whose times are known to a
/// period of the bridge.
const WINDOW_COUNTS: u64 = 256;
const SHORTEST_WINDOW_NS: u64 = 4_000_000;
const LONGEST_WINDOW_NS: u64 = 100_000_000;
/// Speed below which a spindle is at standstill, rpm: 1 kg m2 at 1 rpm has 5 mJ. The noise of an encoder at
/// rest, a few counts of 2^20 per turn, is a thousandth of this speed.
const STANDING_RPM: f64 = 1.0;
/// Counts in the longest window up to which a coarse encoder is at standstill: a shaft at rest on an edge may
/// toggle between counts.
const STANDING_COUNTS: f64 = 3.0;
/// Index intervals within which a pulse must occur after its latch was armed: it is reported some periods
/// later, which at a high speed is a significant part of a turn.
const INDEX_WITHIN: u64 = 2;
const NS_PER_MINUTE: f64 = 60e9;

/// Source of the index pulse of a spindle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpindleIndex {
    /// No index: speed only, the angle stays unknown.
    None,
    /// Once per turn of the spindle: on the spindle, or on an encoder that turns as fast.
    PerSpindleTurn,
    /// Once per turn of a geared encoder: the first pulse of a session is the zero, and after a restart it
    /// may be another.
    PerEncoderTurn,
    /// The counter is absolute within the turn, and its zero is this count.
    Absolute {
        /// The count at angle 0.
        zero: i64,
    },
}

/// An encoder and its connection to the spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleEncoderSettings {
    /// Bits of the hardware's counter, 8 to 32.
    pub counter_bits: u32,
    /// Counts per turn of the encoder, not 0.
    pub counts_per_turn: u32,
    /// Turns of the encoder, and turns of the spindle in the same time, neither 0.
    pub gear: [u32; 2],
    /// Whether it counts down while the spindle turns clockwise.
    pub inverted: bool,
    /// Source of its index pulse.
    pub index: SpindleIndex,
    /// Maximum deviation of a pulse from its first position, counts: its width, and an uneven coupling.
    pub index_tolerance: u32,
    /// Deviation within which the commanded speed counts as reached, as a fraction of it.
    pub at_speed_fraction: f64,
}

/// Fault of an encoder. It persists until [`SpindleEncoder::reset`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpindleEncoderFault {
    /// Two turns without an index pulse.
    #[error("no index pulse in {counts} counts: check the index of the encoder, counts_per_rev and gear")]
    IndexMissing {
        /// Counts since the latch was armed.
        counts: u64,
    },
    /// A pulse is not a whole number of turns away from the first.
    #[error(
        "the index pulse came {counts} counts from its position: counts were lost or added; check cable, \
         shield and coupling, counts_per_rev and gear"
    )]
    LostCounts {
        /// Deviation in counts, in the direction of the spindle.
        counts: i64,
    },
    /// It turned without a reading for so long that its counter may have wrapped unnoticed.
    #[error(
        "its encoder was not read for {ms} ms, so its angle is unknown; check what suspended this \
         computer's processes (`evolvent doctor`)"
    )]
    Unread {
        /// Time without a reading.
        ms: u64,
    },
}

/// Contents of a message in addition to the encoder's readings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpindleConditions {
    /// Number of the spindle.
    pub spindle: u32,
    /// `spindle_direction`, `spindle_rpm` and `sequence` of the outputs that were in force at the reading.
    pub direction: u32,
    /// Commanded speed, rpm.
    pub rpm: f64,
    /// Number of the outputs.
    pub outputs_sequence: u64,
    /// The drive's at-speed output, if one is connected.
    pub at_speed_input: Option<bool>,
    /// The drive is in fault.
    pub has_drive_fault: bool,
    /// The spindle is at its orientation angle.
    pub is_oriented: bool,
}

#[derive(Clone, Copy, Debug, Default)]
struct Reading {
    time_ns: u64,
    counts: i64,
}

/// Computes the angle and speed of a spindle from the readings of its encoder. Neither allocates nor waits.
///
/// ```
/// use evolvent_drive::{SpindleConditions, SpindleEncoder, SpindleEncoderSettings, SpindleIndex};
///
/// let mut encoder = SpindleEncoder::new(SpindleEncoderSettings {
///     counter_bits: 16,
///     counts_per_turn: 4000,
///     gear: [1, 1],
///     inverted: false,
///     index: SpindleIndex::PerSpindleTurn,
///     index_tolerance: 8,
///     at_speed_fraction: 0.02,
/// });
/// // 600 rpm: 40 counts in a millisecond. The pulse is at count 400.
/// for ms in 0..50_u32 {
///     encoder.read(40 * ms, u64::from(ms) * 1_000_000);
///     if ms == 11 {
///         encoder.latch(400);
///     }
/// }
/// assert!(encoder.is_indexed());
/// assert!((encoder.speed_rpm() - 600.0).abs() < 1.0);
/// let message = encoder.feedback(&SpindleConditions { direction: 1, rpm: 600.0, ..Default::default() });
/// // 1960 counts, and half a count: the shaft is somewhere within it.
/// assert_eq!((message.turns, message.fraction), (0, 1560.5 / 4000.0));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct SpindleEncoder {
    settings: SpindleEncoderSettings,
    raw: Option<u32>,
    /// Counts in the direction of the spindle, without wrap-around.
    counts: i64,
    time_ns: u64,
    /// The count of the first pulse.
    zero: Option<i64>,
    /// Minimum and maximum count since the latch was armed.
    swept: Option<[i64; 2]>,
    fault: Option<SpindleEncoderFault>,
    /// Readings at which the count had changed, the oldest at `newest + 1`.
    edges: [Reading; READINGS],
    newest: usize,
    kept: usize,
}

impl SpindleEncoder {
    /// Creates an encoder without a reading. Zeros in the settings count as one.
    #[must_use]
    pub fn new(settings: SpindleEncoderSettings) -> Self {
        let settings = SpindleEncoderSettings {
            counter_bits: settings.counter_bits.clamp(8, 32),
            counts_per_turn: settings.counts_per_turn.max(1),
            gear: settings.gear.map(|turns| turns.max(1)),
            ..settings
        };
        Self {
            settings,
            raw: None,
            counts: 0,
            time_ns: 0,
            zero: None,
            swept: None,
            fault: None,
            edges: [Reading::default(); READINGS],
            newest: 0,
            kept: 0,
        }
    }

    /// The settings.
    #[must_use]
    pub const fn settings(&self) -> &SpindleEncoderSettings {
        &self.settings
    }

    /// Takes a reading of the counter, and the time at which it was read. Between two readings the counter
    /// moves by less than half of its range.
    pub fn read(&mut self, raw: u32, time_ns: u64) {
        let is_first = self.raw.is_none();
        match self.raw {
            Some(last) => self.counts += self.signed(self.difference(raw, last)),
            None => {
                let counts = self.extend(raw);
                // A reading is the count interval of the shaft, in either direction of counting.
                self.counts = if self.settings.inverted {
                    -1 - counts
                } else {
                    counts
                };
                if let SpindleIndex::Absolute { zero } = self.settings.index {
                    self.zero = Some(if self.settings.inverted { -1 - zero } else { zero });
                }
            }
        }
        (self.raw, self.time_ns) = (Some(raw), time_ns);
        if let Some([min, max]) = &mut self.swept {
            (*min, *max) = ((*min).min(self.counts), (*max).max(self.counts));
        }
        self.keep_edge(is_first);
        self.look_for_index();
    }

    /// Reports that the counter may have wrapped since the last reading, `ms` ago.
    pub fn set_unread(&mut self, ms: u64) {
        self.fault.get_or_insert(SpindleEncoderFault::Unread { ms });
    }

    /// Reports that the index latch is armed: from now on a pulse is expected.
    pub const fn set_armed(&mut self) {
        self.swept = Some([self.counts; 2]);
    }

    /// Takes a pulse at this count, less than half of the counter's range from the last reading.
    pub fn latch(&mut self, raw: u32) {
        self.swept = None;
        let away = self.signed(self.difference(raw, self.raw.unwrap_or(raw)));
        let pulse = self.counts + away;
        let Some(zero) = self.zero else {
            self.zero = Some(pulse);
            return;
        };
        let off = self.counts_from_turn(pulse - zero);
        if off.unsigned_abs() > u64::from(self.settings.index_tolerance) {
            self.fault
                .get_or_insert(SpindleEncoderFault::LostCounts { counts: off });
        }
    }

    /// Clears a fault. The next pulse sets the zero: after lost counts nothing else is reliable.
    pub const fn reset(&mut self) {
        if self.fault.take().is_some() {
            self.swept = None;
            if !matches!(self.settings.index, SpindleIndex::Absolute { .. }) {
                self.zero = None;
            }
        }
    }

    /// The fault, if any.
    #[must_use]
    pub const fn fault(&self) -> Option<SpindleEncoderFault> {
        self.fault
    }

    /// Whether the angle refers to the index.
    #[must_use]
    pub const fn is_indexed(&self) -> bool {
        self.zero.is_some()
    }

    /// Whether it has an index pulse to latch.
    #[must_use]
    pub const fn has_pulse(&self) -> bool {
        matches!(
            self.settings.index,
            SpindleIndex::PerSpindleTurn | SpindleIndex::PerEncoderTurn
        )
    }

    /// Time of the last reading, if there was one.
    #[must_use]
    pub const fn read_at_ns(&self) -> Option<u64> {
        match self.raw {
            Some(_) => Some(self.time_ns),
            None => None,
        }
    }

    /// Whole turns and fraction of a turn of the spindle, from the index, or before it from the start; at the
    /// middle of the count.
    #[must_use]
    pub fn turns(&self) -> (i64, f64) {
        let counts = self.counts - self.zero.unwrap_or(0);
        let [encoder, spindle] = self.settings.gear.map(i128::from);
        let halves = (2 * i128::from(counts) + 1) * spindle;
        let per_turn = 2 * i128::from(self.settings.counts_per_turn) * encoder;
        let (whole, rest) = (halves.div_euclid(per_turn), halves.rem_euclid(per_turn));
        let fraction = rest as f64 / per_turn as f64;
        // A fraction just below a turn may be rounded to one.
        if fraction < 1.0 {
            (whole as i64, fraction)
        } else {
            (whole as i64 + 1, 0.0)
        }
    }

    /// [`SpindleEncoder::turns`] as one number.
    #[must_use]
    pub fn angle(&self) -> f64 {
        let (turns, fraction) = self.turns();
        turns as f64 + fraction
    }

    /// Turns of the spindle per count.
    #[must_use]
    pub fn turns_per_count(&self) -> f64 {
        let [encoder, spindle] = self.settings.gear.map(f64::from);
        spindle / (encoder * f64::from(self.settings.counts_per_turn))
    }

    /// The speed, rpm, negative counter-clockwise, measured over enough counts to be accurate, or over the
    /// longest window.
    #[must_use]
    pub fn speed_rpm(&self) -> f64 {
        let last = self.edge(0);
        if self.kept < 2 {
            return 0.0;
        }
        let mut first = last;
        for back in 1..self.kept {
            let earlier = self.edge(back);
            let span_ns = last.time_ns.saturating_sub(earlier.time_ns);
            if back > 1 && span_ns > LONGEST_WINDOW_NS {
                break;
            }
            first = earlier;
            let is_exact = (last.counts - earlier.counts).unsigned_abs() >= WINDOW_COUNTS;
            if span_ns >= SHORTEST_WINDOW_NS && is_exact || span_ns > LONGEST_WINDOW_NS {
                break;
            }
        }
        let span_ns = last.time_ns.saturating_sub(first.time_ns).max(1) as f64;
        let counts = (last.counts - first.counts) as f64;
        let measured = counts / span_ns;
        // Without an edge the speed is below one count per time since the last.
        let since_ns = self.time_ns.saturating_sub(last.time_ns);
        let bounded = if since_ns > SPACING_NS {
            let max = 1.0 / since_ns as f64;
            measured.clamp(-max, max)
        } else {
            measured
        };
        bounded * NS_PER_MINUTE * self.turns_per_count()
    }

    /// Whether it is at rest.
    #[must_use]
    pub fn is_standing(&self) -> bool {
        let shown = STANDING_COUNTS / LONGEST_WINDOW_NS as f64 * NS_PER_MINUTE * self.turns_per_count();
        self.speed_rpm().abs() < STANDING_RPM.max(shown)
    }

    /// The message of the last reading. The bridge adds number and instance.
    #[must_use]
    pub fn feedback(&self, conditions: &SpindleConditions) -> SpindleFeedback {
        let speed_rpm = self.speed_rpm();
        let commanded = match conditions.direction {
            CLOCKWISE => Some(conditions.rpm),
            COUNTER_CLOCKWISE => Some(-conditions.rpm),
            _ => None,
        };
        let reached = match commanded {
            Some(rpm) => (speed_rpm - rpm).abs() <= self.settings.at_speed_fraction * rpm.abs(),
            None => conditions.direction == STOPPED && self.is_standing(),
        };
        let is_at_speed = reached && (commanded.is_none() || conditions.at_speed_input != Some(false));
        let flags = [
            (is_at_speed, spindle_flags::AT_SPEED),
            (
                conditions.has_drive_fault || self.fault.is_some(),
                spindle_flags::FAULT,
            ),
            (self.is_indexed(), spindle_flags::INDEXED),
            (conditions.is_oriented, spindle_flags::ORIENTED),
        ];
        let flags = flags.into_iter().filter(|(is_set, _)| *is_set);
        let (turns, fraction) = self.turns();
        SpindleFeedback {
            time_ns: self.time_ns,
            turns,
            fraction,
            speed_rpm,
            spindle: conditions.spindle,
            flags: flags.fold(0, |sum, (_, bit)| sum | bit),
            outputs_sequence: conditions.outputs_sequence,
            ..SpindleFeedback::default()
        }
    }

    /// A difference of two counter readings, with a magnitude below half of its range.
    const fn difference(&self, raw: u32, from: u32) -> i64 {
        self.extend(raw.wrapping_sub(from))
    }

    /// The low bits of a counter as a signed number.
    const fn extend(&self, raw: u32) -> i64 {
        let unused = 32 - self.settings.counter_bits;
        ((raw << unused) as i32 >> unused) as i64
    }

    const fn signed(&self, counts: i64) -> i64 {
        if self.settings.inverted { -counts } else { counts }
    }

    /// Counts between a distance and the nearest whole number of index intervals.
    fn counts_from_turn(&self, counts: i64) -> i64 {
        let [encoder, spindle] = match self.settings.index {
            SpindleIndex::PerEncoderTurn => [1, 1],
            _ => self.settings.gear.map(i128::from),
        };
        // In fractions of a count: a gear may put the pulses between two counts.
        let interval = i128::from(self.settings.counts_per_turn) * encoder;
        let rest = (i128::from(counts) * spindle).rem_euclid(interval);
        let nearest = if 2 * rest > interval {
            rest - interval
        } else {
            rest
        };
        (nearest as f64 / spindle as f64).round() as i64
    }

    /// Counts between two pulses, rounded up.
    fn index_interval(&self) -> u64 {
        let counts = u64::from(self.settings.counts_per_turn);
        match self.settings.index {
            SpindleIndex::PerEncoderTurn => counts,
            _ => (counts * u64::from(self.settings.gear[0])).div_ceil(u64::from(self.settings.gear[1])),
        }
    }

    fn look_for_index(&mut self) {
        if let Some([min, max]) = self.swept {
            let counts = max.abs_diff(min);
            if counts > INDEX_WITHIN * self.index_interval() + u64::from(self.settings.index_tolerance) {
                self.fault
                    .get_or_insert(SpindleEncoderFault::IndexMissing { counts });
            }
        }
    }

    fn edge(&self, back: usize) -> Reading {
        self.edges[(self.newest + READINGS - back) % READINGS]
    }

    fn keep_edge(&mut self, is_first: bool) {
        let here = Reading {
            time_ns: self.time_ns,
            counts: self.counts,
        };
        let last = self.edge(0);
        if !is_first && here.counts == last.counts {
            return;
        }
        // The newest is replaced while it is younger than the spacing from the one before.
        let is_close = self.kept >= 2 && here.time_ns.saturating_sub(self.edge(1).time_ns) < SPACING_NS;
        if !is_close {
            self.newest = (self.newest + 1) % READINGS;
            self.kept = (self.kept + 1).min(READINGS);
        }
        self.edges[self.newest] = here;
    }
}

#[cfg(test)]
mod tests;
