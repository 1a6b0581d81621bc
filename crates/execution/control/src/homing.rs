//! Finding machine zero with the drives' home switches.
//!
//! One axis after the other: search the switch, back off from it, come back slowly, take the place where it closes for
//! its known coordinate, move home. Every way has an end, so a switch that is missing or stuck ends the sequence with
//! an alarm.

use evolvent_path::{AXES, Axes, AxisLetter, AxisMask};

use crate::alarm::Alarm;
use crate::rejection::Rejection;

/// The search goes so much farther than the travel is long.
const SEARCH_FRACTION: f64 = 1.1;
/// Backing off takes at most this share of the travel.
const BACK_FRACTION: f64 = 0.5;

/// How one axis is homed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingAxis {
    /// The axis.
    pub axis: AxisLetter,
    /// Its place in the sequence, the smallest first; equal ones in the order of the axes.
    pub order: u32,
    /// Where the switch is searched: 1 or -1.
    pub direction: f64,
    /// Speed of search, mm/s or degrees/s.
    pub search_speed: f64,
    /// Speed of the second approach.
    pub latch_speed: f64,
    /// Machine coordinate at which the switch closes, coming from the other side.
    pub switch_position: f64,
    /// Length of the travel.
    pub travel: f64,
    /// Where the axis goes in the end, machine coordinate.
    pub home: f64,
}

/// What the drives say, one sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HomingSample {
    /// Actual positions in the drives' own coordinates.
    pub position: Axes,
    /// Bit i set: the home switch of axis i is closed.
    pub switches: AxisMask,
}

/// What is to be done next.
#[derive(Clone, Debug, PartialEq)]
pub enum HomingAction {
    /// Nothing new.
    Wait,
    /// Move one axis by so much at this speed; the axes rest. The soft limits do not count.
    Move {
        /// The axis.
        axis: AxisLetter,
        /// With its sign.
        distance: f64,
        /// Per s.
        speed: f64,
    },
    /// Bring the axis to rest.
    Stop,
    /// The axes rest: machine coordinate `coordinate` is where the drive says `position`.
    SetZero {
        /// The axis.
        axis: AxisLetter,
        /// In the drive's coordinates.
        position: f64,
        /// In machine coordinates.
        coordinate: f64,
    },
    /// Move the axis, whose zero is known, to this machine coordinate.
    Home {
        /// The axis.
        axis: AxisLetter,
        /// Machine coordinate.
        position: f64,
        /// Per s.
        speed: f64,
    },
    /// All are homed.
    Done,
    /// It cannot be done.
    Fail(Rejection),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// The next axis is about to begin.
    Begin,
    Search,
    /// The switch has closed: rest, then back off.
    Found,
    BackOff,
    /// The switch has opened: rest, then come back.
    Left,
    Latch,
    /// The switch has closed at this place of the drive.
    Latched(f64),
    Zeroed,
    GoHome,
}

/// The sequence.
#[derive(Clone, Debug)]
pub struct Homing {
    axes: Vec<HomingAxis>,
    at: usize,
    phase: Phase,
    /// The order to move has been given, so rest means that it has ended.
    moving: bool,
}

impl Homing {
    /// A sequence of these axes.
    #[must_use]
    pub fn new(mut axes: Vec<HomingAxis>) -> Self {
        axes.sort_by_key(|axis| (axis.order, axis.axis.index()));
        Self {
            axes,
            at: 0,
            phase: Phase::Begin,
            moving: false,
        }
    }

    /// The axis at work.
    #[must_use]
    pub fn axis(&self) -> Option<AxisLetter> {
        self.axes.get(self.at).map(|axis| axis.axis)
    }

    /// Goes on with one sample of the drives. `at_rest`: the axes rest and no order of this sequence is under way.
    ///
    /// After [`HomingAction::Done`] and [`HomingAction::Fail`] it is over.
    pub fn step(&mut self, sample: &HomingSample, at_rest: bool) -> HomingAction {
        let Some(axis) = self.axes.get(self.at).copied() else {
            return HomingAction::Done;
        };
        let i = axis.axis.index();
        debug_assert!(i < AXES);
        let closed = sample.switches.contains(i);
        let missing = |what: &str| {
            HomingAction::Fail(Rejection::new(
                Alarm::HomeSwitchMissing,
                format!(
                    "axis {}: the home switch was not found {what}; see its wiring",
                    axis.axis.letter()
                ),
            ))
        };
        match self.phase {
            Phase::Begin if !at_rest => HomingAction::Wait,
            Phase::Begin if closed => self.back_off(&axis),
            Phase::Begin => self.go(
                Phase::Search,
                &axis,
                axis.direction * axis.travel * SEARCH_FRACTION,
                axis.search_speed,
            ),
            Phase::Search if closed => self.halt(Phase::Found),
            Phase::Search if at_rest && self.moving => missing("within the travel"),
            Phase::Found if at_rest => self.back_off(&axis),
            Phase::BackOff if !closed => self.halt(Phase::Left),
            Phase::BackOff if at_rest && self.moving => HomingAction::Fail(Rejection::new(
                Alarm::HomeSwitchStuck,
                format!(
                    "axis {}: the home switch stays closed; see its wiring",
                    axis.axis.letter()
                ),
            )),
            Phase::Left if at_rest => self.go(
                Phase::Latch,
                &axis,
                axis.direction * axis.travel * BACK_FRACTION,
                axis.latch_speed,
            ),
            Phase::Latch if closed => self.halt(Phase::Latched(sample.position[i])),
            Phase::Latch if at_rest && self.moving => missing("again on the way back"),
            Phase::Latched(position) if at_rest => {
                self.phase = Phase::Zeroed;
                HomingAction::SetZero {
                    axis: axis.axis,
                    position,
                    coordinate: axis.switch_position,
                }
            }
            Phase::Zeroed if at_rest => {
                self.phase = Phase::GoHome;
                self.moving = true;
                HomingAction::Home {
                    axis: axis.axis,
                    position: axis.home,
                    speed: axis.search_speed,
                }
            }
            Phase::GoHome if at_rest => {
                self.at += 1;
                self.phase = Phase::Begin;
                self.moving = false;
                if self.at == self.axes.len() {
                    HomingAction::Done
                } else {
                    HomingAction::Wait
                }
            }
            _ => HomingAction::Wait,
        }
    }

    fn go(&mut self, phase: Phase, axis: &HomingAxis, distance: f64, speed: f64) -> HomingAction {
        self.phase = phase;
        self.moving = true;
        HomingAction::Move {
            axis: axis.axis,
            distance,
            speed,
        }
    }

    fn back_off(&mut self, axis: &HomingAxis) -> HomingAction {
        let distance = -axis.direction * axis.travel * BACK_FRACTION;
        self.go(Phase::BackOff, axis, distance, axis.search_speed)
    }

    fn halt(&mut self, phase: Phase) -> HomingAction {
        self.phase = phase;
        self.moving = false;
        HomingAction::Stop
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const AXIS: HomingAxis = HomingAxis {
        axis: AxisLetter::X,
        order: 0,
        direction: -1.0,
        search_speed: 20.0,
        latch_speed: 1.0,
        switch_position: -400.0,
        travel: 800.0,
        home: 0.0,
    };

    /// An axis with a switch that closes at and below `edge` of the drive's coordinates, at constant speeds, a sample
    /// a millisecond.
    struct Machine {
        position: f64,
        offset: f64,
        target: f64,
        speed: f64,
        edge: f64,
        stuck: bool,
        cut: bool,
        ways: Vec<f64>,
    }

    impl Machine {
        fn at(position: f64) -> Self {
            Self {
                position,
                offset: 0.0,
                target: position,
                speed: 0.0,
                edge: -123.456,
                stuck: false,
                cut: false,
                ways: Vec::new(),
            }
        }

        fn run(&mut self, homing: &mut Homing) -> Result<(), Alarm> {
            for _ in 0..10_000_000 {
                let closed = (self.position <= self.edge || self.stuck) && !self.cut;
                let mut position = Axes::zeros();
                position[0] = self.position;
                let sample = HomingSample {
                    position,
                    switches: AxisMask::one_if(0, closed),
                };
                let at_rest = self.position == self.target;
                match homing.step(&sample, at_rest) {
                    HomingAction::Wait => {}
                    HomingAction::Move { distance, speed, .. } => {
                        assert!(at_rest, "an order while it moves");
                        self.ways.push(distance);
                        (self.target, self.speed) = (self.position + distance, speed);
                    }
                    HomingAction::Stop => self.target = self.position,
                    HomingAction::SetZero {
                        position, coordinate, ..
                    } => self.offset = position - coordinate,
                    HomingAction::Home { position, speed, .. } => {
                        (self.target, self.speed) = (position + self.offset, speed);
                    }
                    HomingAction::Done => return Ok(()),
                    HomingAction::Fail(refusal) => return Err(refusal.alarm),
                }
                let step = self.speed * 1e-3;
                self.position += (self.target - self.position).clamp(-step, step);
            }
            panic!("no end");
        }
    }

    #[test]
    fn zero_is_found_to_a_step_of_the_latch_speed_from_either_side_of_the_switch() {
        for start in [500.0, 0.0, -123.4, -124.0, -130.0] {
            let mut machine = Machine::at(start);
            machine.run(&mut Homing::new(vec![AXIS])).unwrap();
            // The edge is at machine coordinate -400.
            let error = machine.offset - (machine.edge + 400.0);
            assert!((-1e-3..=0.0).contains(&error), "from {start}: {error}");
            assert!((machine.position - machine.offset - AXIS.home).abs() < 1e-9);
        }
    }

    #[test]
    fn a_switch_that_is_missing_or_stuck_ends_the_sequence_with_its_alarm() {
        let mut machine = Machine::at(0.0);
        machine.cut = true;
        assert_eq!(
            machine.run(&mut Homing::new(vec![AXIS])),
            Err(Alarm::HomeSwitchMissing)
        );
        let mut machine = Machine::at(0.0);
        machine.stuck = true;
        assert_eq!(
            machine.run(&mut Homing::new(vec![AXIS])),
            Err(Alarm::HomeSwitchStuck)
        );
        let mut machine = Machine::at(-AXIS.travel);
        machine.edge = 1e9;
        assert_eq!(
            machine.run(&mut Homing::new(vec![AXIS])),
            Err(Alarm::HomeSwitchStuck)
        );
    }

    #[test]
    fn axes_come_in_the_order_that_the_machine_file_gives() {
        let axes = [(AxisLetter::X, 2), (AxisLetter::Y, 2), (AxisLetter::Z, 1)];
        let homing = Homing::new(
            axes.iter()
                .map(|&(axis, order)| HomingAxis { axis, order, ..AXIS })
                .collect(),
        );
        let letters: String = homing.axes.iter().map(|axis| axis.axis.letter()).collect();
        assert_eq!(letters, "ZXY");
        assert_eq!(homing.axis(), Some(AxisLetter::Z));
    }

    fn sees(homing: &mut Homing, closed: bool, at_rest: bool) -> HomingAction {
        let sample = HomingSample {
            position: Axes::zeros(),
            switches: AxisMask::one_if(0, closed),
        };
        homing.step(&sample, at_rest)
    }

    #[test]
    fn nothing_is_ordered_while_an_axis_still_moves() {
        let mut homing = Homing::new(vec![AXIS]);
        for closed in [false, true] {
            assert_eq!(sees(&mut homing, closed, false), HomingAction::Wait);
        }
        assert!(matches!(
            sees(&mut homing, false, true),
            HomingAction::Move { .. }
        ));
    }

    #[test]
    fn a_switch_that_is_not_found_again_is_told() {
        let mut homing = Homing::new(vec![AXIS]);
        assert!(matches!(sees(&mut homing, true, true), HomingAction::Move { .. }));
        assert_eq!(sees(&mut homing, false, false), HomingAction::Stop);
        assert!(matches!(
            sees(&mut homing, false, true),
            HomingAction::Move { .. }
        ));
        assert_eq!(sees(&mut homing, false, false), HomingAction::Wait);
        let HomingAction::Fail(refusal) = sees(&mut homing, false, true) else {
            panic!("it goes on");
        };
        assert_eq!(refusal.alarm, Alarm::HomeSwitchMissing);
    }

    /// Every order of a sequence of two axes, and nothing else however long an axis takes to come to rest.
    #[test]
    fn each_axis_searches_backs_off_latches_and_goes_home_at_rest_only() {
        let y = HomingAxis {
            axis: AxisLetter::Y,
            order: 1,
            direction: 1.0,
            search_speed: 30.0,
            latch_speed: 2.0,
            switch_position: 250.0,
            travel: 500.0,
            home: 10.0,
        };
        let moves = |axis: &HomingAxis, distance: f64, speed: f64| HomingAction::Move {
            axis: axis.axis,
            distance,
            speed,
        };
        let mut homing = Homing::new(vec![y, AXIS]);
        // 1.1 of the travel for the search, half of it for the ways back.
        for (axis, bit, search, back) in [(AXIS, 0b001, -880.0, 400.0), (y, 0b010, 550.0, -250.0)] {
            let mut step = |closed: bool, at_rest: bool, place: f64| {
                let mut position = Axes::from_element(-7.0);
                position[axis.axis.index()] = place;
                // The other axes' switches mean nothing.
                let switches = if closed { bit } else { !bit };
                homing.step(
                    &HomingSample {
                        position,
                        switches: AxisMask::from_bits(switches),
                    },
                    at_rest,
                )
            };
            assert_eq!(step(false, false, 0.0), HomingAction::Wait);
            let HomingAction::Move { distance, .. } = step(false, true, 0.0) else {
                panic!("no search");
            };
            assert!((distance - search).abs() < 1e-9, "{distance}");
            assert_eq!(step(false, false, 0.0), HomingAction::Wait);
            assert_eq!(step(true, false, 1.0), HomingAction::Stop);
            assert_eq!(step(true, false, 2.0), HomingAction::Wait, "until it rests");
            assert_eq!(step(true, true, 3.0), moves(&axis, back, axis.search_speed));
            assert_eq!(step(true, false, 2.0), HomingAction::Wait);
            assert_eq!(step(false, false, 1.0), HomingAction::Stop);
            assert_eq!(step(false, false, 0.0), HomingAction::Wait, "until it rests");
            assert_eq!(step(false, true, 0.0), moves(&axis, -back, axis.latch_speed));
            assert_eq!(step(true, false, 1.25), HomingAction::Stop);
            assert_eq!(step(true, false, 1.5), HomingAction::Wait, "until it rests");
            let zero = HomingAction::SetZero {
                axis: axis.axis,
                position: 1.25,
                coordinate: axis.switch_position,
            };
            assert_eq!(step(true, true, 1.5), zero);
            assert_eq!(step(true, false, 1.5), HomingAction::Wait, "until it rests");
            let home = HomingAction::Home {
                axis: axis.axis,
                position: axis.home,
                speed: axis.search_speed,
            };
            assert_eq!(step(true, true, 1.5), home);
            assert_eq!(step(false, false, 5.0), HomingAction::Wait);
            let over = step(false, true, 9.0);
            let expected = if bit == 0b010 {
                HomingAction::Done
            } else {
                HomingAction::Wait
            };
            assert_eq!(over, expected);
        }
        assert_eq!(homing.axis(), None);
    }
}
