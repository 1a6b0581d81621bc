//! The spindles of a session: speed, direction and orientation out, angle and faults back.

use evolvent_bus::{MachineOutputs, SpindleFeedback};
use evolvent_drive::{
    SpindleConditions, SpindleEncoder, SpindleEncoderFault, SpindleOrientation, SpindlePower,
};
use evolvent_machine::Machine;

use crate::axis::MAX_COUNTS;
use crate::axis_set::{level, set};
use crate::board_settings::{
    BoardSettings, BoardSpindle, Pin, SpindleAngleSource, SpindleOrienting, SpindleSpeed,
};
use crate::encoder_index::{EncoderIndex, IndexReading};
use crate::plan::{INDEX_SLOTS, Inputs, Outputs, Plan, SPINDLE_SLOT};

/// Directions of a spindle on the bus.
const STOPPED: u32 = 0;
const CLOCKWISE: u32 = 1;
const COUNTER_CLOCKWISE: u32 = 2;
const ORIENT: u32 = 3;
/// Maximum difference between M19 R and the angle of a drive that orients the spindle itself, degrees.
const SAME_ANGLE_DEG: f64 = 0.05;
/// Periods for which the input of such a drive is ignored: it may still report the previous orientation.
const ORIENTING_PERIODS: u32 = 20;

/// Factor by which a spindle may have been faster than measured or commanded.
const MARGIN: f64 = 1.2;

/// Events of a spindle, for the user.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpindleNotice {
    /// Its encoder has a fault.
    Encoder(SpindleEncoderFault),
    /// Its drive reports a fault.
    DriveFault,
    /// M19 was commanded, and nothing can turn the spindle to an angle; or the drive can only turn it to this
    /// angle.
    NotOriented(Option<f64>),
}

/// A spindle. Only the constructor allocates.
#[derive(Debug)]
struct Spindle {
    settings: BoardSpindle,
    /// Its index in the board file's list.
    listed: usize,
    encoder: Option<SpindleEncoder>,
    index: EncoderIndex,
    orientation: Option<SpindleOrientation>,
    power: SpindlePower,
    /// Whether the machine file has it with feedback.
    is_heard: bool,
    sent: SpindleFeedback,
    /// Command in force: direction, speed, angle, and number of the outputs.
    direction: u32,
    rpm: f64,
    outputs_sequence: u64,
    /// Periods since the drive was commanded to orient it.
    orienting_for: u32,
    is_reached: bool,
    has_drive_fault: bool,
    is_at_speed: Option<bool>,
    /// The last reported event.
    reported: Option<SpindleNotice>,
    news: Option<SpindleNotice>,
}

/// All spindles of a board.
#[derive(Debug)]
pub(crate) struct SpindleSet {
    spindles: Vec<Spindle>,
}

impl SpindleSet {
    /// Spindles that the machine does not have are rejected by [`crate::check_fit`].
    pub(crate) fn new(machine: &Machine, board: &BoardSettings, instance: u64) -> Self {
        let spindle = |(listed, settings): (usize, &BoardSpindle)| {
            let known = machine.signals.spindle(settings.number as u32);
            Spindle {
                settings: *settings,
                listed,
                encoder: settings.angle.map(|angle| SpindleEncoder::new(angle.settings)),
                index: EncoderIndex::default(),
                orientation: match settings.orienting {
                    Some(SpindleOrienting::Loop(orientation)) => Some(SpindleOrientation::new(orientation)),
                    _ => None,
                },
                power: SpindlePower::default(),
                is_heard: known.is_some_and(|known| known.has_feedback()),
                sent: SpindleFeedback {
                    instance,
                    ..SpindleFeedback::default()
                },
                direction: STOPPED,
                rpm: 0.0,
                outputs_sequence: 0,
                orienting_for: 0,
                is_reached: false,
                has_drive_fault: false,
                is_at_speed: None,
                reported: None,
                news: None,
            }
        };
        Self {
            spindles: board.spindles.iter().enumerate().map(spindle).collect(),
        }
    }

    /// The encoders whose control registers the next reading contains.
    pub(crate) fn watch(&self, awaited: &mut [Option<usize>; INDEX_SLOTS]) {
        for spindle in &self.spindles {
            awaited[SPINDLE_SLOT + spindle.listed] = spindle.index.watched();
        }
    }

    /// Evaluates a reading.
    pub(crate) fn take(&mut self, plan: &Plan, inputs: &Inputs, measured_ns: u64) {
        for spindle in &mut self.spindles {
            spindle.take(plan, inputs, measured_ns);
        }
    }

    /// The message of each spindle that the machine measures, from the newest reading.
    pub(crate) fn feedback(&mut self) -> impl Iterator<Item = SpindleFeedback> + '_ {
        self.spindles.iter_mut().filter_map(Spindle::feedback)
    }

    /// Returns the events for the user, once each.
    pub(crate) fn take_news(&mut self) -> impl Iterator<Item = (usize, SpindleNotice)> + '_ {
        self.spindles
            .iter_mut()
            .filter_map(|spindle| Some((spindle.settings.number, spindle.news.take()?)))
    }

    /// Runs one period with the outputs in force; `None` switches everything off at once.
    pub(crate) fn step(
        &mut self,
        wanted: Option<&MachineOutputs>,
        now_ns: u64,
        plan: &Plan,
        outputs: &mut Outputs,
    ) {
        for spindle in &mut self.spindles {
            outputs.index[SPINDLE_SLOT + spindle.listed] = spindle.index.command();
            spindle.step(wanted, now_ns, plan, outputs);
        }
    }
}

impl Spindle {
    fn take(&mut self, plan: &Plan, inputs: &Inputs, measured_ns: u64) {
        let Some(angle) = self.settings.angle else { return };
        let is_on = |pin: Option<Pin>| pin.map(|pin| level(plan, inputs, pin));
        self.has_drive_fault = is_on(self.settings.fault) == Some(true);
        self.is_at_speed = is_on(self.settings.at_speed);
        if let Some(SpindleOrienting::Drive { reached, .. }) = self.settings.orienting {
            self.is_reached = level(plan, inputs, reached);
        }
        let Some(encoder) = &mut self.encoder else { return };
        let gap_ns = encoder
            .read_at_ns()
            .map_or(0, |read_ns| measured_ns.saturating_sub(read_ns));
        // Meanwhile it may have changed from its speed to the commanded one.
        let rpm = encoder.speed_rpm().abs().max(self.rpm.abs());
        if is_unread(&angle, rpm, gap_ns as f64 * 1e-9) {
            encoder.set_unread(gap_ns / 1_000_000);
        }
        encoder.read(inputs.counts[angle.encoder], measured_ns);
        let slot = SPINDLE_SLOT + self.listed;
        match self
            .index
            .take(inputs.index_numbers[slot], inputs.index_controls[slot])
        {
            IndexReading::Nothing => {}
            IndexReading::Armed => encoder.set_armed(),
            IndexReading::At(count) => encoder.latch(u32::from(count)),
        }
        // Every pulse is compared with the first.
        if encoder.has_pulse() && self.index.watched().is_none() {
            self.index.arm(angle.encoder, angle.index_rising);
        }
        let news = match (encoder.fault(), self.has_drive_fault) {
            (Some(fault), _) => Some(SpindleNotice::Encoder(fault)),
            (None, true) => Some(SpindleNotice::DriveFault),
            (None, false) => None,
        };
        self.tell(news);
    }

    /// Reports a persistent condition once.
    fn tell(&mut self, news: Option<SpindleNotice>) {
        let is_same = match (&self.reported, &news) {
            (Some(SpindleNotice::Encoder(_)), Some(SpindleNotice::Encoder(_))) => true,
            // The angle of M19 is dropped with its command.
            (Some(SpindleNotice::NotOriented(_)), None) => true,
            (reported, news) => reported == news,
        };
        if !is_same {
            (self.reported, self.news) = (news, news.or(self.news));
        }
    }

    fn feedback(&mut self) -> Option<SpindleFeedback> {
        let encoder = self.encoder.as_ref().filter(|_| self.is_heard)?;
        let time_ns = encoder.read_at_ns()?;
        if self.sent.sequence > 0 && time_ns <= self.sent.time_ns {
            return None;
        }
        let message = encoder.feedback(&SpindleConditions {
            spindle: self.settings.number as u32,
            direction: self.direction,
            rpm: self.rpm,
            outputs_sequence: self.outputs_sequence,
            at_speed_input: self.is_at_speed,
            has_drive_fault: self.has_drive_fault,
            is_oriented: self.is_oriented(),
        });
        self.sent = SpindleFeedback {
            sequence: self.sent.sequence + 1,
            instance: self.sent.instance,
            ..message
        };
        Some(self.sent)
    }

    fn is_oriented(&self) -> bool {
        if self.direction != ORIENT {
            return false;
        }
        match self.settings.orienting {
            Some(SpindleOrienting::Loop(_)) => self
                .orientation
                .is_some_and(|orientation| orientation.is_oriented()),
            Some(SpindleOrienting::Drive { .. }) => self.is_reached && self.orienting_for > ORIENTING_PERIODS,
            None => false,
        }
    }

    fn step(&mut self, wanted: Option<&MachineOutputs>, now_ns: u64, plan: &Plan, outputs: &mut Outputs) {
        let number = self.settings.number;
        let (direction, rpm) = wanted.map_or((STOPPED, 0.0), |wanted| {
            (wanted.spindle_direction[number], wanted.spindle_rpm[number])
        });
        (self.direction, self.rpm) = (direction, rpm);
        self.outputs_sequence = wanted.map_or(0, |wanted| wanted.sequence);
        let (angle_deg, way) = wanted.map_or((0.0, 0), |wanted| {
            (wanted.spindle_angle[number], wanted.spindle_way[number])
        });
        if direction != ORIENT {
            self.orienting_for = 0;
            if let Some(orientation) = &mut self.orientation {
                orientation.end();
            }
            if matches!(self.reported, Some(SpindleNotice::NotOriented(_))) {
                self.reported = None;
            }
        }
        let stands = self.encoder.is_none_or(|encoder| encoder.is_standing());
        if direction == STOPPED
            && stands
            && let Some(encoder) = &mut self.encoder
            && encoder.fault().is_some()
        {
            // The alarm has stopped it: the next motion begins with a new zero.
            encoder.reset();
            self.index.disarm();
        }
        let mut by_drive = false;
        let commanded_rpm = match (direction, self.settings.orienting) {
            (CLOCKWISE, _) => rpm,
            (COUNTER_CLOCKWISE, _) => -rpm,
            (ORIENT, Some(SpindleOrienting::Loop(_))) => match (&mut self.orientation, &self.encoder) {
                (Some(orientation), Some(encoder)) => orientation.step(angle_deg, way, encoder, now_ns),
                _ => 0.0,
            },
            (ORIENT, Some(SpindleOrienting::Drive { angle_deg: only, .. })) => {
                let off = (angle_deg - only).rem_euclid(360.0);
                by_drive = off.min(360.0 - off) <= SAME_ANGLE_DEG;
                if !by_drive {
                    self.tell(Some(SpindleNotice::NotOriented(Some(only))));
                }
                0.0
            }
            (ORIENT, None) => {
                self.tell(Some(SpindleNotice::NotOriented(None)));
                0.0
            }
            _ => 0.0,
        };
        self.orienting_for = if by_drive {
            self.orienting_for.saturating_add(1)
        } else {
            0
        };
        let by_loop = direction == ORIENT && self.orientation.is_some();
        let turns = matches!(direction, CLOCKWISE | COUNTER_CLOCKWISE) || by_loop;
        let backwards = direction == COUNTER_CLOCKWISE || by_loop && commanded_rpm < 0.0;
        let may_run = wanted.is_some() && !self.has_drive_fault;
        let is_enabled = self.power.step(may_run && (turns || by_drive), stands, may_run);
        for (pin, on) in [
            (self.settings.forward, turns && !backwards),
            (self.settings.reverse, turns && backwards),
            (self.settings.enable, is_enabled),
            (self.orient_pin(), by_drive),
        ] {
            if let Some(pin) = pin {
                set(plan, outputs, pin, on);
            }
        }
        match self.settings.speed {
            None => {}
            Some(SpindleSpeed::Remote { full_rpm, .. }) => {
                if let Some(output) = plan.spindle(self.listed) {
                    output.put(outputs, commanded_rpm.abs() / full_rpm, turns, backwards);
                }
            }
            Some(SpindleSpeed::Pwm {
                unit,
                full_rpm,
                signed,
            }) => {
                let rpm = if signed {
                    commanded_rpm
                } else {
                    commanded_rpm.abs()
                };
                let is_on = turns || signed && is_enabled;
                put_duty(outputs, unit, if turns { rpm / full_rpm } else { 0.0 }, is_on);
            }
        }
    }

    const fn orient_pin(&self) -> Option<Pin> {
        match self.settings.orienting {
            Some(SpindleOrienting::Drive { command, .. }) => Some(command),
            _ => None,
        }
    }
}

/// Whether a counter may have wrapped unnoticed in a gap between two readings, if the speed of the spindle
/// was at most `rpm`.
fn is_unread(angle: &SpindleAngleSource, rpm: f64, gap_s: f64) -> bool {
    MARGIN * rpm / 60.0 * angle.counts_per_turn() * gap_s > MAX_COUNTS
}

/// Sets a PWM generator: its duty, and whether it is enabled.
pub(crate) fn put_duty(outputs: &mut Outputs, unit: usize, duty: f64, is_enabled: bool) {
    outputs.duties[unit] = duty.clamp(-1.0, 1.0);
    outputs.pwm_enable &= !(1 << unit);
    outputs.pwm_enable |= u32::from(is_enabled) << unit;
}

#[cfg(test)]
mod tests {
    use evolvent_drive::{SpindleEncoderSettings, SpindleIndex};

    use super::*;

    /// 30 000 counts take 73 ms at 6000 rpm and 4096 counts per turn, less a fifth because the speed may be
    /// higher by `MARGIN`.
    #[test]
    fn unread_time_is_limited_by_half_the_counter_range() {
        let angle = SpindleAngleSource {
            encoder: 0,
            index_rising: true,
            settings: SpindleEncoderSettings {
                counter_bits: 16,
                counts_per_turn: 2048,
                gear: [2, 1],
                inverted: false,
                index: SpindleIndex::PerSpindleTurn,
                index_tolerance: 8,
                at_speed_fraction: 0.02,
            },
        };
        assert!(is_unread(&angle, 6000.0, 0.0611) && !is_unread(&angle, 6000.0, 0.0610));
        assert!(!is_unread(&angle, 0.0, 10.0), "one that stands keeps its place");
    }
}
