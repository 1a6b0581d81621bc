//! The encoder of a spindle: counts of a wrapping counter and index pulses to the angle, the speed and the faults of the bus.

use evolvent_wire::{SpindleFeedback, spindle_flags};

/// Directions of a spindle on the bus.
const STOPPED: u32 = 0;
const CLOCKWISE: u32 = 1;
const COUNTER_CLOCKWISE: u32 = 2;
/// Readings kept for the speed. At the shortest spacing they cover [`LONGEST_WINDOW_NS`].
const READINGS: usize = 128;
/// Shortest time between two readings that are kept: shorter periods need no more of them.
const SPACING_NS: u64 = 800_000;
/// The speed is that over this many counts, which is exact to 0.4 %, but over no less than the shorter and no more than the longer time:
/// a slow spindle is measured from edge to edge, whose times are known to a period of the bridge.
const WINDOW_COUNTS: u64 = 256;
const SHORTEST_WINDOW_NS: u64 = 4_000_000;
const LONGEST_WINDOW_NS: u64 = 100_000_000;
/// A spindle that is slower stands, rpm: 1 kg m2 at 1 rpm have 5 mJ. The noise of an encoder at rest, a few counts of 2^20 in a turn, is
/// a thousandth of it.
const STANDING_RPM: f64 = 1.0;
/// A coarse encoder cannot show less than this many counts in the longest window: a shaft at rest on an edge goes to and fro.
const STANDING_COUNTS: f64 = 3.0;
/// Turns of the index in which a pulse has to come after its latch was armed: it is reported some periods later, which at a high speed
/// is a good part of a turn.
const INDEX_WITHIN: u64 = 2;
const NS_PER_MINUTE: f64 = 60e9;

/// Where the index pulse of a spindle comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpindleIndex {
    /// There is none: speed only, the angle stays unknown.
    None,
    /// Once per turn of the spindle: on the spindle, or on an encoder that turns as fast.
    PerSpindleTurn,
    /// Once per turn of an encoder behind a gear: the first pulse of a session is the zero, and after a restart it may be another.
    PerEncoderTurn,
    /// The counter is absolute within the turn, and its zero is this count.
    Absolute {
        /// The count at angle 0.
        zero: i64,
    },
}

/// An encoder and its place at the spindle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleEncoderSettings {
    /// Bits of the hardware's counter, 8 to 32.
    pub counter_bits: u32,
    /// Counts per turn of the encoder, not 0.
    pub counts_per_turn: u32,
    /// Turns of the encoder, and turns of the spindle in the same time, neither 0.
    pub gear: [u32; 2],
    /// It counts down while the spindle turns clockwise.
    pub inverted: bool,
    /// Its index.
    pub index: SpindleIndex,
    /// Counts by which a pulse may be away from where it was first: its width, and an uneven coupling.
    pub index_tolerance: u32,
    /// Of the commanded speed, by which the speed may differ and counts as reached.
    pub at_speed_fraction: f64,
}

/// What is wrong with an encoder. It stays until [`SpindleEncoder::reset`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SpindleEncoderFault {
    /// Two turns without an index pulse.
    #[error("no index pulse in {counts} counts: check the index of the encoder, counts_per_rev and gear")]
    IndexMissing {
        /// Counts since the latch was armed.
        counts: u64,
    },
    /// A pulse that is not whole turns away from the first.
    #[error(
        "the index pulse came {counts} counts from its place: counts were lost, or one was added; check cable, shield and coupling, \
         counts_per_rev and gear"
    )]
    LostCounts {
        /// Counts away, in the direction of the spindle.
        counts: i64,
    },
    /// It turned for so long without a reading that its counter may have turned over unseen.
    #[error(
        "its encoder was not read for {ms} ms, so its angle is unknown; check what suspended this computer's processes (`evolvent \
         doctor`)"
    )]
    Unread {
        /// How long.
        ms: u64,
    },
}

/// What a message says beside the encoder's readings.
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

/// Knows how a spindle turns from the readings of its encoder. Neither allocates nor waits.
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
    /// Least and greatest count since the latch was armed.
    swept: Option<[i64; 2]>,
    fault: Option<SpindleEncoderFault>,
    /// Readings at which the count had changed, the oldest at `newest + 1`.
    edges: [Reading; READINGS],
    newest: usize,
    kept: usize,
}

impl SpindleEncoder {
    /// Without a reading. Zeros among the settings count as one.
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

    /// Takes a reading of the counter, and the time at which it was read. Between two readings the counter moves by less than half of
    /// its range.
    pub fn read(&mut self, raw: u32, time_ns: u64) {
        let is_first = self.raw.is_none();
        match self.raw {
            Some(last) => self.counts += self.signed(self.difference(raw, last)),
            None => {
                let counts = self.extend(raw);
                // A reading is the count that the shaft is within, seen from either side.
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
        if let Some([least, most]) = &mut self.swept {
            (*least, *most) = ((*least).min(self.counts), (*most).max(self.counts));
        }
        self.keep_edge(is_first);
        self.look_for_index();
    }

    /// The counter may have turned over since the last reading, which was so long ago.
    pub fn set_unread(&mut self, ms: u64) {
        self.fault.get_or_insert(SpindleEncoderFault::Unread { ms });
    }

    /// The index latch is armed: from now on a pulse is expected.
    pub const fn set_armed(&mut self) {
        self.swept = Some([self.counts; 2]);
    }

    /// A pulse has come at this count, less than half of the counter's range from the last reading.
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

    /// Forgets a fault. The zero is that of the next pulse: after lost counts nothing else can be trusted.
    pub const fn reset(&mut self) {
        if self.fault.take().is_some() {
            self.swept = None;
            if !matches!(self.settings.index, SpindleIndex::Absolute { .. }) {
                self.zero = None;
            }
        }
    }

    /// What is wrong with it.
    #[must_use]
    pub const fn fault(&self) -> Option<SpindleEncoderFault> {
        self.fault
    }

    /// Whether the angle refers to the index.
    #[must_use]
    pub const fn is_indexed(&self) -> bool {
        self.zero.is_some()
    }

    /// Whether it has an index pulse that is to be latched.
    #[must_use]
    pub const fn has_pulse(&self) -> bool {
        matches!(
            self.settings.index,
            SpindleIndex::PerSpindleTurn | SpindleIndex::PerEncoderTurn
        )
    }

    /// Whether there was a reading, and its time.
    #[must_use]
    pub const fn read_at_ns(&self) -> Option<u64> {
        match self.raw {
            Some(_) => Some(self.time_ns),
            None => None,
        }
    }

    /// Whole turns of the spindle and the rest, from the index or, before it has come, from the start; the middle of the count.
    #[must_use]
    pub fn turns(&self) -> (i64, f64) {
        let counts = self.counts - self.zero.unwrap_or(0);
        let [encoder, spindle] = self.settings.gear.map(i128::from);
        let halves = (2 * i128::from(counts) + 1) * spindle;
        let per_turn = 2 * i128::from(self.settings.counts_per_turn) * encoder;
        let (whole, rest) = (halves.div_euclid(per_turn), halves.rem_euclid(per_turn));
        let fraction = rest as f64 / per_turn as f64;
        // A rest just below a turn may be rounded to one.
        if fraction < 1.0 {
            (whole as i64, fraction)
        } else {
            (whole as i64 + 1, 0.0)
        }
    }

    /// The same as one number.
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

    /// The speed, rpm, negative counter-clockwise: over as many counts as make it exact, or over as long as it takes.
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
        // While no edge comes the speed is below one count in the time since the last.
        let since_ns = self.time_ns.saturating_sub(last.time_ns);
        let bounded = if since_ns > SPACING_NS {
            let most = 1.0 / since_ns as f64;
            measured.clamp(-most, most)
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

    /// A difference of two counts of the counter, either way by less than half of its range.
    const fn difference(&self, raw: u32, from: u32) -> i64 {
        self.extend(raw.wrapping_sub(from))
    }

    /// The low bits of a counter as a number with a sign.
    const fn extend(&self, raw: u32) -> i64 {
        let unused = 32 - self.settings.counter_bits;
        ((raw << unused) as i32 >> unused) as i64
    }

    const fn signed(&self, counts: i64) -> i64 {
        if self.settings.inverted { -counts } else { counts }
    }

    /// How many counts are between a distance and the next whole number of intervals of the index.
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
        if let Some([least, most]) = self.swept {
            let counts = most.abs_diff(least);
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
mod tests {
    use evolvent_random::Random;

    use super::*;

    const MS: u64 = 1_000_000;

    const SETTINGS: SpindleEncoderSettings = SpindleEncoderSettings {
        counter_bits: 16,
        counts_per_turn: 4096,
        gear: [1, 1],
        inverted: false,
        index: SpindleIndex::PerSpindleTurn,
        index_tolerance: 8,
        at_speed_fraction: 0.02,
    };

    /// A shaft whose encoder is read by a bridge that arms the index latch again and again.
    struct Shaft {
        encoder: SpindleEncoder,
        /// True turns of the spindle.
        turns: f64,
        /// Counts the counter has lost.
        lost: i64,
        has_index: bool,
        time_ns: u64,
        /// The true angle of the first pulse.
        first_pulse: Option<f64>,
        /// Where a pulse is, turns.
        index_at: f64,
    }

    impl Shaft {
        fn new(settings: SpindleEncoderSettings, turns: f64) -> Self {
            Self {
                encoder: SpindleEncoder::new(settings),
                turns,
                lost: 0,
                has_index: true,
                time_ns: 5 * MS,
                first_pulse: None,
                index_at: 0.3,
            }
        }

        fn raw(&self, turns: f64) -> u32 {
            let settings = self.encoder.settings();
            let counts = turns * f64::from(settings.counts_per_turn) * f64::from(settings.gear[0])
                / f64::from(settings.gear[1]);
            let counts = if settings.inverted { -counts } else { counts };
            let mask = if settings.counter_bits == 32 {
                u32::MAX
            } else {
                (1 << settings.counter_bits) - 1
            };
            (counts.floor() as i64 + self.lost) as u32 & mask
        }

        /// Goes on by one period at a speed; the pulse is latched where it truly is.
        fn step(&mut self, rpm: f64, period_ns: u64) {
            let before = self.turns;
            self.turns += rpm / NS_PER_MINUTE * period_ns as f64;
            self.time_ns += period_ns;
            let (low, high) = (before.min(self.turns), before.max(self.turns));
            let pulse = (high - self.index_at).floor() + self.index_at;
            self.encoder.read(self.raw(self.turns), self.time_ns);
            if self.has_index && self.encoder.has_pulse() && pulse > low && pulse <= high {
                // The count that the shaft is in behind the edge.
                let behind = pulse + (self.turns - before).signum() * 1e-6;
                self.encoder.latch(self.raw(behind));
                self.first_pulse.get_or_insert(pulse);
            }
            if self.encoder.swept.is_none() && self.encoder.has_pulse() {
                self.encoder.set_armed();
            }
        }

        /// By how many counts the reported angle is off.
        fn error_counts(&self) -> f64 {
            let zero = self.first_pulse.unwrap_or(0.0);
            (self.encoder.angle() - (self.turns - zero)) / self.encoder.turns_per_count()
        }
    }

    /// Random speeds and reversals, counters of 16 and 32 bits that wrap round, both directions of counting, gears: the angle is the
    /// true one within a count, from the first pulse on.
    #[test]
    fn the_angle_is_that_since_the_pulse_whatever_the_counter_does() {
        let mut random = Random::new();
        for round in 0..300 {
            let gear = [[1, 1], [2, 1], [1, 2], [3, 2], [40, 17]][random.bits() as usize % 5];
            let settings = SpindleEncoderSettings {
                counter_bits: if round % 2 == 0 { 16 } else { 32 },
                counts_per_turn: [400, 4096, 10_000][random.bits() as usize % 3],
                gear,
                inverted: random.bits().is_multiple_of(2),
                ..SETTINGS
            };
            // Near the end of the counter, wherever that is.
            let edge = [0.0, 65_536.0, 2_147_483_648.0, -65_536.0][random.bits() as usize % 4];
            let per_turn = f64::from(settings.counts_per_turn) * f64::from(gear[0]) / f64::from(gear[1]);
            let mut shaft = Shaft::new(settings, edge / per_turn + random.between(-1.0, 1.0));
            let mut speed = 0.0;
            for period in 0..2000 {
                if period % 100 == 0 {
                    speed = random.between(-3000.0, 3000.0);
                }
                shaft.step(speed, MS);
                if shaft.first_pulse.is_some() {
                    let error = shaft.error_counts();
                    assert!(error.abs() <= 1.6, "{settings:?}: {error} counts at {period}");
                    assert!(shaft.encoder.is_indexed());
                }
                assert_eq!(shaft.encoder.fault(), None, "{settings:?} at {period}");
            }
            assert!(shaft.first_pulse.is_some());
        }
    }

    #[test]
    fn the_angle_is_unknown_before_the_first_pulse_and_always_without_one() {
        let mut shaft = Shaft::new(SETTINGS, 0.4);
        for _ in 0..80 {
            shaft.step(600.0, MS);
        }
        assert!(!shaft.encoder.is_indexed());
        for _ in 0..20 {
            shaft.step(600.0, MS);
        }
        assert!(shaft.encoder.is_indexed());
        let none = SpindleEncoderSettings {
            index: SpindleIndex::None,
            ..SETTINGS
        };
        let mut shaft = Shaft::new(none, 0.0);
        for _ in 0..1000 {
            shaft.step(600.0, MS);
        }
        assert!(!shaft.encoder.is_indexed() && shaft.encoder.fault().is_none());
        assert!((shaft.encoder.speed_rpm() - 600.0).abs() < 3.0);
    }

    /// The angle of the time before is worth nothing: the zero is that of the next pulse.
    #[test]
    fn an_encoder_that_was_not_read_for_too_long_looks_for_its_zero_again() {
        let mut shaft = Shaft::new(SETTINGS, 0.0);
        for _ in 0..300 {
            shaft.step(600.0, MS);
        }
        assert!(shaft.encoder.is_indexed());
        shaft.encoder.set_unread(80);
        shaft.step(600.0, MS);
        assert_eq!(
            shaft.encoder.fault(),
            Some(SpindleEncoderFault::Unread { ms: 80 })
        );
        shaft.encoder.reset();
        assert!(shaft.encoder.fault().is_none() && !shaft.encoder.is_indexed());
    }

    /// Three turns of the encoder per turn of the spindle: a pulse each third of a turn, and the zero is the first of them.
    #[test]
    fn pulses_of_an_encoder_behind_a_gear_are_compared_by_its_own_turn() {
        let mut encoder = SpindleEncoder::new(SpindleEncoderSettings {
            counts_per_turn: 400,
            gear: [3, 1],
            index: SpindleIndex::PerEncoderTurn,
            ..SETTINGS
        });
        let pulses = [100, 500, 900, 1300, 2500];
        for (period, pulse) in (0_u64..).zip(pulses) {
            encoder.read(pulse + 3, period * MS);
            encoder.latch(pulse);
            assert_eq!(encoder.fault(), None, "{pulse}");
        }
        // Two turns of the spindle from the first pulse.
        assert_eq!(encoder.turns(), (2, 3.5 / 1200.0));
        encoder.read(2950, 9 * MS);
        encoder.latch(2940);
        assert_eq!(
            encoder.fault(),
            Some(SpindleEncoderFault::LostCounts { counts: 40 })
        );
    }

    #[test]
    fn an_absolute_counter_is_known_with_its_first_reading() {
        let absolute = SpindleEncoderSettings {
            counter_bits: 32,
            index: SpindleIndex::Absolute { zero: 1024 },
            ..SETTINGS
        };
        let mut encoder = SpindleEncoder::new(absolute);
        encoder.read(2048, MS);
        assert!(encoder.is_indexed());
        assert!(
            (encoder.angle() - 0.25).abs() <= 1.0 / 4096.0,
            "{}",
            encoder.angle()
        );
    }

    #[test]
    fn the_speed_is_exact_at_any_speed() {
        for (counts_per_turn, rpm, most) in [
            (4096, 3000.0, 0.001),
            (4096, 300.0, 0.01),
            (4096, 30.0, 0.015),
            (4096, 2.0, 0.03),
            (400, 60.0, 0.02),
            (400, 12.0, 0.03),
        ] {
            for sign in [1.0, -1.0] {
                let settings = SpindleEncoderSettings {
                    counts_per_turn,
                    ..SETTINGS
                };
                let mut shaft = Shaft::new(settings, 0.17);
                let mut worst: f64 = 0.0;
                for period in 0..3000 {
                    shaft.step(sign * rpm, MS);
                    if period > 200 {
                        worst = worst.max((shaft.encoder.speed_rpm() / (sign * rpm) - 1.0).abs());
                    }
                }
                assert!(worst <= most, "{counts_per_turn} counts, {rpm} rpm: {worst}");
            }
        }
    }

    #[test]
    fn a_spindle_that_stops_is_standing_soon_and_one_on_an_edge_too() {
        let mut shaft = Shaft::new(SETTINGS, 0.0);
        for _ in 0..300 {
            shaft.step(1000.0, MS);
        }
        assert!(!shaft.encoder.is_standing());
        let mut after = 0;
        while !shaft.encoder.is_standing() {
            shaft.step(0.0, MS);
            after += 1;
        }
        assert!(after <= 40, "{after} ms");
        for period in 0..400 {
            // To and fro by a count.
            let rpm = if period % 2 == 0 { 10.0 } else { -10.0 };
            shaft.step(rpm, MS);
            assert!(period < 120 || shaft.encoder.is_standing(), "{period}");
        }
    }

    #[test]
    fn the_noise_of_a_fine_encoder_is_no_motion_and_a_slow_turn_is() {
        let fine = SpindleEncoderSettings {
            counter_bits: 32,
            counts_per_turn: 1 << 20,
            index: SpindleIndex::None,
            ..SETTINGS
        };
        let mut random = Random::new();
        let mut encoder = SpindleEncoder::new(fine);
        for ms in 0..2000 {
            encoder.read((1000.0 + random.between(-2.0, 2.0)) as u32, ms * MS);
            assert!(encoder.is_standing(), "{ms} ms: {} rpm", encoder.speed_rpm());
        }
        let mut shaft = Shaft::new(fine, 0.0);
        for _ in 0..200 {
            shaft.step(2.0, MS);
        }
        assert!(!shaft.encoder.is_standing());
    }

    #[test]
    fn lost_counts_are_a_fault_until_it_is_reset_at_any_of_them() {
        let mut random = Random::new();
        for _ in 0..200 {
            let mut shaft = Shaft::new(SETTINGS, random.between(-3.0, 3.0));
            let sign = if random.bits().is_multiple_of(2) {
                1.0
            } else {
                -1.0
            };
            let rpm = sign * random.between(50.0, 3000.0);
            let turn = (60_000.0 / rpm.abs()) as u64 + 3;
            for _ in 0..2 * turn {
                shaft.step(rpm, MS);
            }
            assert_eq!(shaft.encoder.fault(), None);
            let lost = [-1, 1][random.bits() as usize % 2] * random.between(10.0, 2000.0) as i64;
            shaft.lost += lost;
            for _ in 0..turn {
                shaft.step(rpm, MS);
            }
            let Some(SpindleEncoderFault::LostCounts { counts }) = shaft.encoder.fault() else {
                panic!("{:?}", shaft.encoder.fault());
            };
            assert!((counts - lost).abs() <= 1, "{counts} of {lost}");
            let flags = shaft.encoder.feedback(&SpindleConditions::default()).flags;
            assert_ne!(flags & spindle_flags::FAULT, 0);
            shaft.encoder.reset();
            assert!(!shaft.encoder.is_indexed());
            shaft.first_pulse = None;
            for _ in 0..2 * turn {
                shaft.step(rpm, MS);
            }
            assert!(shaft.encoder.is_indexed() && shaft.encoder.fault().is_none());
            assert!(shaft.error_counts().abs() < 1.6 + lost.abs() as f64);
        }
    }

    #[test]
    fn an_index_that_does_not_come_again_is_a_fault_after_two_turns() {
        for seen_before in [true, false] {
            let mut shaft = Shaft::new(SETTINGS, 0.5);
            shaft.has_index = seen_before;
            for _ in 0..if seen_before { 300 } else { 80 } {
                shaft.step(600.0, MS);
            }
            assert_eq!(shaft.encoder.fault(), None);
            shaft.has_index = false;
            let mut turned = 0.0;
            while shaft.encoder.fault().is_none() {
                shaft.step(600.0, MS);
                turned += 0.01;
                assert!(turned < 2.1, "no fault");
            }
            assert!(matches!(
                shaft.encoder.fault(),
                Some(SpindleEncoderFault::IndexMissing { .. })
            ));
            assert!(turned > 1.0, "{turned} turns");
            // To and fro within a turn is none.
            shaft.encoder.reset();
            for period in 0..1000 {
                let rpm = if period % 100 < 50 { 600.0 } else { -600.0 };
                shaft.step(rpm, MS);
            }
            assert_eq!(shaft.encoder.fault(), None);
        }
    }

    #[test]
    fn a_speed_is_reached_within_its_tolerance_and_with_the_input_of_the_drive() {
        let mut shaft = Shaft::new(SETTINGS, 0.0);
        for _ in 0..300 {
            shaft.step(-990.0, MS);
        }
        let reached = |direction, rpm, at_speed_input| {
            let message = shaft.encoder.feedback(&SpindleConditions {
                direction,
                rpm,
                at_speed_input,
                outputs_sequence: 5,
                spindle: 2,
                ..SpindleConditions::default()
            });
            assert_eq!((message.outputs_sequence, message.spindle), (5, 2));
            assert!(message.is_valid());
            message.flags & spindle_flags::AT_SPEED != 0
        };
        assert!(reached(2, 1000.0, None) && reached(2, 1000.0, Some(true)));
        assert!(!reached(2, 1000.0, Some(false)));
        assert!(!reached(2, 1020.0, None) && !reached(1, 1000.0, None));
        assert!(!reached(0, 0.0, None) && !reached(3, 0.0, None));
    }
}
