//! The sequence against axes of constant speeds.

use super::*;
use crate::alarm::Alarm;

const AXIS: HomingAxis = HomingAxis {
    axis: AxisLetter::X,
    method: HomingMethod::Switch,
    order: 0,
    direction: -1.0,
    search_velocity: 20.0,
    latch_velocity: 1.0,
    reference: -400.0,
    travel: 800.0,
    home: 0.0,
};

/// An axis at constant speeds with a switch that closes at and below `edge` of the drive's coordinates; one
/// sample per millisecond.
struct Machine {
    position: f64,
    offset: f64,
    target: f64,
    speed: f64,
    edge: f64,
    stuck: bool,
    cut: bool,
    /// Positions of the limit switches.
    limits: [f64; 2],
    /// The home switch presses both limit switches.
    is_shared: bool,
    /// The edge of the home switch of a gantry's second side; each home switch is also the limit switch of
    /// its side.
    second: Option<f64>,
    /// Samples for which a home input must be stable; the limit inputs have no filter.
    filter: u32,
    /// The home input of each side as the bridge sees it, and for how many samples it has been different.
    seen: [(bool, u32); 2],
    /// The home switch of the gantry.
    is_home: bool,
    travels: Vec<f64>,
    /// Index pulses are at `pulse` and every `pitch` from there.
    pulse: f64,
    pitch: f64,
    /// Samples until a request is accepted; `None` if the bridge has no index latch.
    delay: Option<u32>,
    /// The request, samples until it is accepted, and the pulse.
    latch: (u32, u32, Option<f64>),
}

impl Machine {
    fn sample(&self, time_ms: u64) -> HomingSample {
        let [one, other] = self.closed();
        let seen = if self.filter == 0 { one } else { self.seen[0].0 };
        let closed = if self.second.is_some() { self.is_home } else { seen };
        let mut limits = [self.position <= self.limits[0], self.position >= self.limits[1]];
        if self.is_shared {
            limits = [one; 2];
        }
        if self.second.is_some() {
            // As a bridge reports it: a side whose home switch has closed waits for the other one.
            let waits = self.seen.map(|(seen, _)| seen && !self.is_home);
            limits[0] = one && !waits[0] || other && !waits[1];
        }
        let mut position = Axes::zeros();
        position[0] = self.position;
        let (request, left, pulse) = self.latch;
        let is_taken_over = left == 0;
        HomingSample {
            time_ns: time_ms * 1_000_000,
            position,
            switches: AxisMask::one_if(0, closed),
            limits: limits.map(|is_pressed| AxisMask::one_if(0, is_pressed)),
            absolute: AxisMask::NONE,
            index_request: if is_taken_over { request } else { 0 },
            index_position: pulse.filter(|_| is_taken_over),
        }
    }

    /// The home switch of each side of a gantry.
    fn closed(&self) -> [bool; 2] {
        [self.edge, self.second.unwrap_or(self.edge)]
            .map(|edge| (self.position <= edge || self.stuck) && !self.cut)
    }

    /// The filters of the inputs, and the home switch that the bridge makes of two.
    fn filter(&mut self) {
        let closed = self.closed();
        for ((seen, samples), now) in self.seen.iter_mut().zip(closed) {
            *samples = if *seen == now { 0 } else { *samples + 1 };
            if *samples >= self.filter {
                (*seen, *samples) = (now, 0);
            }
        }
        let [one, other] = self.seen.map(|(seen, _)| seen);
        self.is_home = one && other || self.is_home && (one || other);
    }

    /// Latches the first pulse between two positions.
    fn pass(&mut self, from: f64, to: f64) {
        let (request, left, pulse) = self.latch;
        if request == 0 || left > 0 || pulse.is_some() || self.pitch <= 0.0 {
            return;
        }
        let (low, high) = (from.min(to), from.max(to));
        let first = if to > from {
            self.pulse + ((low - self.pulse) / self.pitch).ceil() * self.pitch
        } else {
            self.pulse + ((high - self.pulse) / self.pitch).floor() * self.pitch
        };
        if (low..=high).contains(&first) && from != to {
            self.latch.2 = Some(first);
        }
    }
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
            limits: [f64::NEG_INFINITY, f64::INFINITY],
            is_shared: false,
            second: None,
            filter: 0,
            seen: [(false, 0); 2],
            is_home: false,
            travels: Vec::new(),
            pulse: 0.0,
            pitch: 0.0,
            delay: Some(3),
            latch: (0, u32::MAX, None),
        }
    }

    fn run(&mut self, homing: &mut Homing) -> Result<(), Alarm> {
        // An axis on its switch has been there for a long time.
        for _ in 0..=self.filter {
            self.filter();
        }
        for time_ms in 0..10_000_000 {
            self.filter();
            let sample = self.sample(time_ms);
            let at_rest = self.position == self.target;
            // As the cycle does.
            let end = usize::from(self.target > self.position);
            if !at_rest
                && !sample.limits[end]
                    .without(homing.expected_limits()[end])
                    .is_empty()
            {
                return Err(Alarm::LimitSwitch);
            }
            match homing.step(&sample, at_rest) {
                HomingAction::Wait => {}
                HomingAction::Move { distance, speed, .. } => {
                    assert!(at_rest, "an order while it moves");
                    self.travels.push(distance);
                    (self.target, self.speed) = (self.position + distance, speed);
                }
                HomingAction::Stop => self.target = self.position,
                HomingAction::LatchIndex { request, .. } => {
                    self.latch = (request, self.delay.unwrap_or(u32::MAX), None);
                }
                HomingAction::TakePosition { .. } => panic!("it is not absolute"),
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
            let from = self.position;
            self.position += (self.target - self.position).clamp(-step, step);
            if self.latch.1 != u32::MAX {
                self.latch.1 = self.latch.1.saturating_sub(1);
            }
            self.pass(from, self.position);
        }
        panic!("no end");
    }
}

#[test]
fn zero_is_within_one_step_from_either_side_of_switch() {
    for start in [500.0, 0.0, -123.4, -124.0, -130.0] {
        let mut machine = Machine::at(start);
        machine.run(&mut Homing::new(vec![AXIS], 1)).unwrap();
        // The edge is at machine coordinate -400.
        let error = machine.offset - (machine.edge + 400.0);
        assert!((-1e-3..=0.0).contains(&error), "from {start}: {error}");
        assert!((machine.position - machine.offset - AXIS.home).abs() < 1e-9);
    }
}

#[test]
fn a_missing_or_stuck_switch_ends_homing_with_alarm() {
    let mut machine = Machine::at(0.0);
    machine.cut = true;
    assert_eq!(
        machine.run(&mut Homing::new(vec![AXIS], 1)),
        Err(Alarm::HomeSwitchMissing)
    );
    let mut machine = Machine::at(0.0);
    machine.stuck = true;
    assert_eq!(
        machine.run(&mut Homing::new(vec![AXIS], 1)),
        Err(Alarm::HomeSwitchStuck)
    );
    let mut machine = Machine::at(-AXIS.travel);
    machine.edge = 1e9;
    assert_eq!(
        machine.run(&mut Homing::new(vec![AXIS], 1)),
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
        1,
    );
    let letters: String = homing
        .axes
        .iter()
        .map(|axis| axis.settings().axis.letter())
        .collect();
    assert_eq!(letters, "ZXY");
    assert_eq!(homing.axis(), Some(AxisLetter::Z));
}

fn sees(homing: &mut Homing, closed: bool, at_rest: bool) -> HomingAction {
    let sample = HomingSample {
        switches: AxisMask::one_if(0, closed),
        ..Machine::at(0.0).sample(0)
    };
    homing.step(&sample, at_rest)
}

#[test]
fn nothing_is_ordered_while_an_axis_still_moves() {
    let mut homing = Homing::new(vec![AXIS], 1);
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
    let mut homing = Homing::new(vec![AXIS], 1);
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

/// Every action of a sequence of two axes, and no other action, however long an axis takes to stop.
#[test]
fn each_axis_searches_backs_off_latches_and_homes() {
    let y = HomingAxis {
        axis: AxisLetter::Y,
        method: HomingMethod::Switch,
        order: 1,
        direction: 1.0,
        search_velocity: 30.0,
        latch_velocity: 2.0,
        reference: 250.0,
        travel: 500.0,
        home: 10.0,
    };
    let moves = |axis: &HomingAxis, distance: f64, speed: f64| HomingAction::Move {
        axis: axis.axis,
        distance,
        speed,
    };
    let mut homing = Homing::new(vec![y, AXIS], 1);
    // 1.1 of the travel for the search, half of it for backing off.
    for (axis, bit, search, back) in [(AXIS, 0b001, -880.0, 400.0), (y, 0b010, 550.0, -250.0)] {
        let mut step = |closed: bool, at_rest: bool, value: f64| {
            let mut position = Axes::from_element(-7.0);
            position[axis.axis.index()] = value;
            // The switches of other axes have no meaning.
            let switches = if closed { bit } else { !bit };
            homing.step(
                &HomingSample {
                    position,
                    switches: AxisMask::from_bits(switches),
                    ..Machine::at(0.0).sample(0)
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
        assert_eq!(step(true, true, 3.0), moves(&axis, back, axis.search_velocity));
        assert_eq!(step(true, false, 2.0), HomingAction::Wait);
        assert_eq!(step(false, false, 1.0), HomingAction::Stop);
        assert_eq!(step(false, false, 0.0), HomingAction::Wait, "until it rests");
        assert_eq!(step(false, true, 0.0), moves(&axis, -back, axis.latch_velocity));
        assert_eq!(step(true, false, 1.25), HomingAction::Stop);
        assert_eq!(step(true, false, 1.5), HomingAction::Wait, "until it rests");
        let zero = HomingAction::SetZero {
            axis: axis.axis,
            position: 1.25,
            coordinate: axis.reference,
            from_switch: None,
        };
        assert_eq!(step(true, true, 1.5), zero);
        assert_eq!(step(true, false, 1.5), HomingAction::Wait, "until it rests");
        let home = HomingAction::Home {
            axis: axis.axis,
            position: axis.home,
            speed: axis.search_velocity,
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

/// An axis that is homed by the index pulse after the switch; the expected pulse is 2.5 behind the edge.
fn with_index(when_opening: bool, direction: f64) -> (HomingAxis, f64) {
    let method = HomingMethod::SwitchThenIndex {
        when_opening,
        within: 6.0,
    };
    let axis = HomingAxis {
        method,
        direction,
        reference: 33.0,
        ..AXIS
    };
    // Off the switch is towards larger coordinates if the switch is below.
    let step = if when_opening { -direction } else { direction };
    (axis, step * 2.5)
}

#[test]
fn the_first_pulse_after_the_edge_is_zero() {
    for when_opening in [false, true] {
        let (axis, beyond) = with_index(when_opening, -1.0);
        for start in [500.0, 0.0, -123.4, -124.0, -130.0] {
            for delay in [0, 3, 40] {
                let mut machine = Machine::at(start);
                machine.pitch = 5.0;
                machine.pulse = machine.edge + beyond;
                machine.delay = Some(delay);
                machine.run(&mut Homing::new(vec![axis], 7)).unwrap();
                // Latched by the drive: exact, however old the sample is.
                let error = machine.offset - (machine.pulse - 33.0);
                assert!(error.abs() < 1e-9, "{when_opening} from {start}: {error}");
                assert!((machine.position - machine.offset - axis.home).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn a_missing_pulse_is_an_alarm_within_its_distance() {
    for when_opening in [false, true] {
        let (axis, _) = with_index(when_opening, -1.0);
        let mut machine = Machine::at(0.0);
        let ended = machine.run(&mut Homing::new(vec![axis], 1));
        assert_eq!(ended, Err(Alarm::IndexMissing));
        let beyond = (machine.position - machine.edge).abs();
        assert!((5.9..6.1).contains(&beyond), "{when_opening}: {beyond}");
    }
}

#[test]
fn a_bridge_without_latches_has_an_alarm_of_its_own() {
    let (axis, _) = with_index(false, -1.0);
    let method = HomingMethod::SwitchThenIndex {
        when_opening: false,
        within: 300.0,
    };
    let mut machine = Machine::at(0.0);
    machine.delay = None;
    let ended = machine.run(&mut Homing::new(vec![HomingAxis { method, ..axis }], 1));
    assert_eq!(ended, Err(Alarm::IndexMissing));
    // 5 s at 1 mm/s.
    let beyond = (machine.position - machine.edge).abs();
    assert!((4.9..5.1).contains(&beyond), "{beyond}");
    let method = HomingMethod::Index { within: 6.0 };
    let mut machine = Machine::at(0.0);
    machine.delay = None;
    let ended = machine.run(&mut Homing::new(vec![HomingAxis { method, ..axis }], 1));
    assert_eq!((ended, machine.position), (Err(Alarm::IndexMissing), 0.0));
}

#[test]
fn without_a_switch_the_next_armed_pulse_is_zero() {
    for direction in [1.0, -1.0] {
        let axis = HomingAxis {
            method: HomingMethod::Index { within: 6.0 },
            direction,
            reference: 0.0,
            ..AXIS
        };
        let mut machine = Machine::at(12.0);
        (machine.pitch, machine.pulse) = (5.0, 1.0);
        machine.run(&mut Homing::new(vec![axis], 1)).unwrap();
        assert_eq!(machine.offset, if direction > 0.0 { 16.0 } else { 11.0 });
        let mut machine = Machine::at(12.0);
        let ended = machine.run(&mut Homing::new(vec![axis], 1));
        assert_eq!(
            (ended, machine.position),
            (Err(Alarm::IndexMissing), 12.0 + 6.0 * direction)
        );
    }
}

#[test]
fn a_latched_position_off_the_way_is_refused_at_rest() {
    for latched in [-200.0, -100.0, f64::NAN, f64::INFINITY] {
        let (axis, _) = with_index(false, -1.0);
        let mut homing = Homing::new(vec![axis], 1);
        let sample = |closed: bool, position: f64, pulse: Option<f64>| HomingSample {
            position: Axes::repeat(position),
            switches: AxisMask::one_if(0, closed),
            index_request: u32::from(pulse.is_some()),
            index_position: pulse,
            ..Machine::at(0.0).sample(0)
        };
        for (closed, at_rest, position) in [(false, true, 0.0), (true, false, -120.0), (true, true, -121.0)] {
            homing.step(&sample(closed, position, None), at_rest);
        }
        assert_eq!(
            homing.step(&sample(false, -119.0, None), false),
            HomingAction::Stop
        );
        homing.step(&sample(false, -118.0, None), true);
        let request = homing.step(&sample(true, -120.0, None), false);
        assert!(matches!(request, HomingAction::LatchIndex { request: 1, .. }));
        assert_eq!(
            homing.step(&sample(true, -121.0, Some(latched)), false),
            HomingAction::Stop
        );
        assert_eq!(
            homing.step(&sample(true, -121.0, Some(latched)), false),
            HomingAction::Wait
        );
        let HomingAction::Fail(refusal) = homing.step(&sample(true, -121.0, Some(latched)), true) else {
            panic!("{latched} is taken");
        };
        assert_eq!(refusal.alarm, Alarm::IndexMissing);
    }
}

#[test]
fn an_absolute_encoder_homes_without_motion() {
    let axis = HomingAxis {
        method: HomingMethod::Absolute,
        ..AXIS
    };
    let mut sample = Machine::at(5.0).sample(0);
    let mut homing = Homing::new(vec![axis], 1);
    let HomingAction::Fail(refusal) = homing.step(&sample, true) else {
        panic!("it is not valid");
    };
    assert_eq!(refusal.alarm, Alarm::NotAbsolute);
    sample.absolute = AxisMask::one(0);
    let mut homing = Homing::new(vec![axis], 1);
    assert_eq!(homing.step(&sample, false), HomingAction::Wait);
    let axis = AxisLetter::X;
    assert_eq!(homing.step(&sample, true), HomingAction::TakePosition { axis });
    assert_eq!(homing.step(&sample, true), HomingAction::Done);
}

/// A broken wire: the axis must not move on into the hard stop behind the limit switch.
#[test]
fn a_limit_switch_before_the_home_switch_is_an_alarm() {
    for (method, name) in [
        (HomingMethod::Switch, "switch"),
        (with_index(false, -1.0).0.method, "closing"),
        (with_index(true, -1.0).0.method, "opening"),
    ] {
        for start in [0.0, -199.0, -250.0] {
            let mut machine = Machine::at(start);
            (machine.cut, machine.limits[0]) = (true, -200.0);
            let mut homing = Homing::new(vec![HomingAxis { method, ..AXIS }], 1);
            let ended = machine.run(&mut homing);
            assert_eq!(ended, Err(Alarm::HomeSwitchMissing), "{name}");
            // One sample at 20 mm/s, or nothing if it is on the switch.
            let beyond = machine.position - start.min(-200.0);
            assert!((-0.03..=0.0).contains(&beyond), "{name} from {start}: {beyond}");
        }
    }
}

/// The wire breaks after the first edge: the slow approach does not find it again.
#[test]
fn the_slow_approach_ends_at_the_limit_switch_too() {
    let mut machine = Machine::at(0.0);
    machine.limits[0] = -124.0;
    let mut homing = Homing::new(vec![AXIS], 1);
    // Until the axis has left the switch.
    for time_ms in 0.. {
        let at_rest = machine.position == machine.target;
        match homing.step(&machine.sample(time_ms), at_rest) {
            HomingAction::Move { distance, speed, .. } => {
                machine.cut = speed < AXIS.search_velocity;
                (machine.target, machine.speed) = (machine.position + distance, speed);
            }
            HomingAction::Stop => machine.target = machine.position,
            HomingAction::Fail(refusal) => {
                assert!(refusal.text.contains("limit switch"), "{}", refusal.text);
                break;
            }
            _ => {}
        }
        let step = machine.speed * 1e-3;
        machine.position += (machine.target - machine.position).clamp(-step, step);
        assert!(machine.position > -124.1, "{}", machine.position);
    }
}

/// One switch may be both limit and home switch, and its two inputs need not close at the same time: the
/// filter of the home input may be as long as the slow one of a Mesa board.
#[test]
fn a_shared_home_and_limit_switch_may_close_late() {
    for filter in [0, 10, 25, 50] {
        for start in [0.0, -123.4, -130.0] {
            let mut machine = Machine::at(start);
            (machine.limits[0], machine.filter) = (machine.edge, filter);
            let ended = machine.run(&mut Homing::new(vec![AXIS], 1));
            assert_eq!(ended, Ok(()), "{filter} ms from {start}");
            let error = machine.offset - (machine.edge + 400.0);
            assert!((-0.052..=0.0).contains(&error), "{filter} ms: {error}");
            let (axis, beyond) = with_index(false, -1.0);
            let mut machine = Machine::at(start);
            (machine.limits[0], machine.filter) = (machine.edge, filter);
            (machine.pitch, machine.pulse) = (5.0, machine.edge + beyond);
            // Home is off the switch.
            let axis = HomingAxis {
                reference: -400.0,
                ..axis
            };
            let ended = machine.run(&mut Homing::new(vec![axis], 1));
            assert_eq!(ended, Ok(()), "{filter} ms from {start}, by the index");
        }
    }
}

/// A gantry in which each side has one switch as home and limit switch: the limit of the side that arrives
/// first is seen until the home input closes.
#[test]
fn a_gantry_passes_the_limit_of_the_first_side() {
    for filter in [1, 25, 50] {
        for second in [-123.0, -123.456, -124.0] {
            for start in [0.0, -130.0] {
                let mut machine = Machine::at(start);
                (machine.second, machine.filter) = (Some(second), filter);
                let ended = machine.run(&mut Homing::new(vec![AXIS], 1));
                assert_eq!(ended, Ok(()), "{filter} ms, {second}, from {start}");
                let error = machine.offset - (machine.edge.min(second) + 400.0);
                assert!((-0.052..=0.0).contains(&error), "{filter} ms, {second}: {error}");
            }
        }
    }
}

/// One input for the home switch and both limit switches of an axis.
#[test]
fn a_home_switch_wired_to_both_limits_is_found() {
    let methods = [
        HomingMethod::Switch,
        with_index(false, -1.0).0.method,
        with_index(true, -1.0).0.method,
    ];
    for method in methods {
        for start in [0.0, -123.4, -130.0] {
            let mut machine = Machine::at(start);
            machine.is_shared = true;
            (machine.pitch, machine.pulse) = (5.0, machine.edge + 2.5);
            let ended = machine.run(&mut Homing::new(vec![HomingAxis { method, ..AXIS }], 1));
            assert_eq!(ended, Ok(()), "{method:?} from {start}");
        }
    }
    // A separate home switch that is stuck: the limit switch of the other end stops the axis while it leaves
    // the switch.
    for start in [0.0, 50.0] {
        let mut machine = Machine::at(start);
        (machine.stuck, machine.limits[1]) = (true, 50.0);
        let ended = machine.run(&mut Homing::new(vec![AXIS], 1));
        assert_eq!(ended, Err(Alarm::LimitSwitch), "from {start}");
        assert!(machine.position < 50.1, "{}", machine.position);
    }
}

/// Limit switches that the homing sequence does not handle itself stop the axes as always.
#[test]
fn only_the_limit_of_the_search_direction_is_expected() {
    let mut homing = Homing::new(vec![AXIS], 1);
    let none = [AxisMask::NONE; 2];
    let mut seen = vec![homing.expected_limits()];
    let mut machine = Machine::at(0.0);
    for time_ms in 0..1_000_000 {
        let at_rest = machine.position == machine.target;
        let action = homing.step(&machine.sample(time_ms), at_rest);
        if seen.last() != Some(&homing.expected_limits()) {
            seen.push(homing.expected_limits());
        }
        match action {
            HomingAction::Move { distance, speed, .. } => {
                (machine.target, machine.speed) = (machine.position + distance, speed);
            }
            HomingAction::Stop => machine.target = machine.position,
            HomingAction::Home { .. } | HomingAction::SetZero { .. } => {
                assert_eq!(homing.expected_limits(), none);
            }
            HomingAction::Done => break,
            _ => {}
        }
        let step = machine.speed * 1e-3;
        machine.position += (machine.target - machine.position).clamp(-step, step);
    }
    assert_eq!(seen, [none, [AxisMask::one(0), AxisMask::NONE], none]);
    // A pulse without a switch is searched between the limit switches.
    let axis = HomingAxis {
        method: HomingMethod::Index { within: 6.0 },
        ..AXIS
    };
    let mut homing = Homing::new(vec![axis], 1);
    for at_rest in [true, false] {
        homing.step(&Machine::at(0.0).sample(0), at_rest);
        assert_eq!(homing.expected_limits(), none);
    }
}
