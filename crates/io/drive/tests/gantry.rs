//! A beam with two motors and two switches, homed as the core does it: at random racks, with switches that
//! bounce or never close, and with power lost at random moments. Its motors follow at once, so every error is
//! one of the squaring.

#![expect(clippy::panic, reason = "helpers of tests fail as tests do")]

use evolvent_drive::{
    BridgeState, DriveSetpoint, DriveState, FeedbackWatch, Gantry, GantryFault, GantryInputs, GantrySettings,
    PowerRequest, WatchSettings, is_homed, worse_status,
};
use evolvent_path::AxisMask;
use evolvent_random::{Random, cases};
use evolvent_wire::{AXES, Feedback, Setpoint};

const PERIOD_S: f64 = 1e-3;
const STEP: f64 = 1.0 / 320.0;
const SEARCH: f64 = 40.0;
const LATCH: f64 = 4.0;
const ACCELERATION: f64 = 1500.0;
/// Machine coordinate of the edge.
const REFERENCE: f64 = -12.5;
/// Periods from a command to its effect.
const LEAD: usize = 5;

/// The mechanics; the beam is square where both motors have the same true position.
#[derive(Clone, Debug)]
struct Beam {
    motor: [f64; 2],
    /// True positions below which the switches are closed, and above which they are open again.
    switch: [f64; 2],
    hysteresis: f64,
    closed: [bool; 2],
    never: [bool; 2],
    /// Number of periods for which a switch bounces after its edge.
    bounce: u32,
    since_edge: [u32; 2],
}

impl Beam {
    fn read(&mut self) -> [bool; 2] {
        for side in 0..2 {
            let was = self.closed[side];
            let at = self.switch[side] + if was { self.hysteresis } else { 0.0 };
            self.closed[side] = self.motor[side] <= at;
            self.since_edge[side] = if was == self.closed[side] {
                self.since_edge[side].saturating_add(1)
            } else {
                0
            };
        }
        core::array::from_fn(|side| {
            let bounces = self.since_edge[side] < self.bounce && self.since_edge[side] % 2 == 1;
            self.closed[side] && !bounces && !self.never[side]
        })
    }
}

/// Beam, bridge and core.
struct Trial {
    beam: Beam,
    gantry: Gantry,
    settings: GantrySettings,
    /// Offsets of the motors: coordinate minus true position.
    offset: [f64; 2],
    setpoint: f64,
    velocity: f64,
    /// Commands not in effect yet.
    queue: std::collections::VecDeque<(f64, f64)>,
    is_enabled: bool,
    power: PowerRequest,
    /// The core's monitoring of the feedback.
    watch: FeedbackWatch,
    cycle: u64,
    datum: u64,
}

impl Trial {
    fn new(beam: Beam, settings: GantrySettings) -> Self {
        let mut trial = Self {
            gantry: Gantry::new(settings),
            settings,
            offset: [100.0 - beam.motor[0], 100.0 - beam.motor[1]],
            beam,
            setpoint: 100.0,
            velocity: 0.0,
            queue: std::collections::VecDeque::new(),
            is_enabled: false,
            power: PowerRequest::Off,
            watch: FeedbackWatch::new(WatchSettings::new(1_000_000, AxisMask::one(0))),
            cycle: 1000,
            datum: 0,
        };
        trial.offset[1] += trial.gantry.alignment(trial.coordinates());
        trial.switch_on();
        trial
    }

    fn coordinates(&self) -> [f64; 2] {
        core::array::from_fn(|side| self.beam.motor[side] + self.offset[side])
    }

    fn switch_off(&mut self) {
        (self.is_enabled, self.power, self.velocity) = (false, PowerRequest::Off, 0.0);
        self.queue.clear();
        for _ in 0..50 {
            self.period(self.setpoint, 0.0);
        }
    }

    fn switch_on(&mut self) {
        self.power = PowerRequest::On;
        self.period(self.setpoint, 0.0);
        self.setpoint = self.gantry.position(self.coordinates()[0]);
        self.queue = [(self.setpoint, 0.0); LEAD].into();
        self.watch = FeedbackWatch::new(WatchSettings::new(1_000_000, AxisMask::one(0)));
        self.cycle += 100;
        self.is_enabled = true;
    }

    /// Runs one period of bridge and beam. Returns position and home switch of the feedback.
    fn period(&mut self, setpoint: f64, velocity: f64) -> (f64, bool) {
        let switches = self.beam.read();
        let position = self.coordinates();
        self.gantry.step(&GantryInputs {
            is_enabled: self.is_enabled,
            power: self.power,
            position,
            velocity,
            switches: Some(switches),
            strain: None,
            period_s: PERIOD_S,
        });
        let shown = (self.gantry.position(position[0]), self.gantry.home_switch());
        if self.is_enabled && self.gantry.fault().is_none() {
            for side in 0..2 {
                let target = setpoint + self.gantry.offset(side) - self.offset[side];
                let before = self.beam.motor[side];
                self.beam.motor[side] = (target / STEP).round() * STEP;
                // Squaring adds to the motion of the axis, and neither jumps.
                let fastest = velocity.abs() + self.settings.square_velocity + ACCELERATION * PERIOD_S;
                let moved = (self.beam.motor[side] - before).abs();
                assert!(
                    moved < fastest * PERIOD_S + 1.01 * STEP,
                    "motor {side} jumps by {moved} mm"
                );
            }
        }
        shown
    }

    /// Runs one period of the core, which moves to `goal` at `speed`, or stops.
    fn core(&mut self, goal: Option<f64>, speed: f64) -> (f64, bool) {
        let left = goal.map_or(0.0, |goal| goal - self.setpoint);
        let max = speed
            .min((2.0 * ACCELERATION * left.abs()).sqrt())
            .min(left.abs() / PERIOD_S);
        let wanted = if goal.is_some() { max * left.signum() } else { 0.0 };
        let change = ACCELERATION * PERIOD_S;
        self.velocity += (wanted - self.velocity).clamp(-change, change);
        self.setpoint += self.velocity * PERIOD_S;
        self.queue.push_back((self.setpoint, self.velocity));
        let due = self.queue.pop_front().unwrap_or((self.setpoint, self.velocity));
        let shown = self.period(due.0, due.1);
        self.monitor(shown.0);
        shown
    }

    /// Asserts that the core raises no alarm because of the squaring motion.
    fn monitor(&mut self, position: f64) {
        self.cycle += 1;
        let mut setpoint = Setpoint {
            sequence: self.cycle,
            power_request: PowerRequest::On.number(),
            datum: self.datum,
            axes_mask: 1,
            ..Setpoint::default()
        };
        (setpoint.position[0], setpoint.velocity[0]) = (self.setpoint, self.velocity);
        let now_ns = self.cycle * 1_000_000;
        let feedback = Feedback {
            sequence: self.cycle - LEAD as u64,
            time_ns: now_ns,
            position: core::array::from_fn::<f64, AXES, _>(|axis| if axis == 0 { position } else { 0.0 }),
            status_word: [u32::from(DriveState::OperationEnabled.code()); AXES],
            axes_mask: 1,
            bridge_state: BridgeState::Following.number(),
            datum: self.datum,
            instance: 1,
            ..Feedback::default()
        };
        if self.gantry.fault().is_none() {
            let result = self
                .watch
                .step(now_ns, &DriveSetpoint::of(&setpoint), Some(&feedback));
            if let Err(alarm) = result {
                panic!("{alarm:?}");
            }
        }
    }

    fn stop(&mut self) -> Option<(f64, bool)> {
        let mut shown = (f64::NAN, false);
        for _ in 0..200 {
            shown = self.core(None, 0.0);
            self.gantry.fault().is_none().then_some(())?;
        }
        Some(shown)
    }

    /// Moves until the home switch has the state `closed`. Returns the position then, or `None` if the gantry
    /// has failed.
    fn until(&mut self, closed: bool, distance: f64, speed: f64, max_periods: u32) -> Option<f64> {
        let goal = self.setpoint + distance;
        for _ in 0..max_periods {
            let (position, switch) = self.core(Some(goal), speed);
            self.gantry.fault().is_none().then_some(())?;
            if switch == closed {
                self.stop()?;
                return Some(position);
            }
        }
        panic!("the switch does not become {closed}");
    }

    /// Search, back off, second approach, zero, home. Returns `None` if the gantry has failed.
    fn home(&mut self) -> Option<()> {
        if !self.stop()?.1 {
            self.until(true, -1000.0, SEARCH, 10_000)?;
        }
        self.until(false, 1000.0, SEARCH, 10_000)?;
        let found = self.until(true, -1000.0, LATCH, 10_000)?;
        let shift = REFERENCE - found;
        let by = self.gantry.rename(shift, is_homed(&[0.0, shift], shift));
        for side in 0..2 {
            self.offset[side] += by[side];
        }
        self.setpoint += shift;
        self.datum += 1;
        self.queue.iter_mut().for_each(|(position, _)| *position += shift);
        for _ in 0..5000 {
            self.core(Some(0.0), SEARCH);
            self.gantry.fault().is_none().then_some(())?;
        }
        Some(())
    }

    /// Errors of the beam's squareness and of the axis's coordinate.
    fn errors(&self) -> (f64, f64) {
        let [first, second] = self.beam.motor;
        let true_coordinate = first - self.beam.switch[0] + REFERENCE;
        let shown = self.gantry.position(self.coordinates()[0]);
        (second - first, shown - true_coordinate)
    }
}

fn random_trial(random: &mut Random, rack: f64) -> Trial {
    let switch = [random.between(-0.4, 0.4), random.between(-0.4, 0.4)];
    let start = random.between(5.0, 30.0);
    let beam = Beam {
        motor: [start, start + rack],
        switch,
        hysteresis: random.between(0.0, 0.5),
        closed: [false; 2],
        never: [false; 2],
        bounce: random.below(6) as u32,
        since_edge: [u32::MAX; 2],
    };
    let settings = GantrySettings {
        // Both edges receive the same coordinate.
        squaring_offset: switch[0] - switch[1],
        max_difference: 1.2,
        square_velocity: random.between(0.5, 5.0),
    };
    Trial::new(beam, settings)
}

/// A step of each motor, plus the distance of the period in which each edge is seen.
const SQUARE: f64 = 2.0 * STEP + LATCH * PERIOD_S;

#[test]
fn a_beam_is_square_after_homing_whatever_its_rack() {
    let mut random = Random::seeded(72);
    let (mut worst, mut worst_zero) = (0.0_f64, 0.0_f64);
    for _ in 0..cases(300) {
        let rack = random.between(-1.0, 1.0);
        let mut trial = random_trial(&mut random, rack);
        trial.home().expect("no fault");
        let (square, zero) = trial.errors();
        assert!(trial.gantry.take_squared().is_some());
        (worst, worst_zero) = (worst.max(square.abs()), worst_zero.max(zero.abs()));
        assert!(square.abs() <= SQUARE, "rack {rack}: {square} mm from square");
        // Its zero is the edge of the first switch, whichever came first.
        assert!(zero.abs() <= SQUARE, "rack {rack}: zero is {zero} mm off");
        // Homed again, it finds the same zero.
        trial.home().expect("no fault");
        assert!(trial.errors().0.abs() <= SQUARE && trial.errors().1.abs() <= SQUARE);
    }
    println!("{worst:.4} mm from square, zero {worst_zero:.4} mm off");
}

#[test]
fn a_beam_that_is_racked_too_far_is_not_squared() {
    let mut random = Random::seeded(73);
    for _ in 0..cases(100) {
        let rack = random.between(1.3, 4.0) * [-1.0, 1.0][random.below(2)];
        let mut trial = random_trial(&mut random, rack);
        assert_eq!(trial.home(), None, "rack {rack}");
        let [first, second] = trial.beam.motor;
        assert!(
            (second - first - rack).abs() < 2.0 * STEP,
            "nothing was moved by {rack}"
        );
        // The first side is beyond its switch by at most the permitted difference plus the distance of a
        // period.
        let beyond = (0..2).map(|side| trial.beam.switch[side] - trial.beam.motor[side]);
        // One period until its edge is seen, and one until the other is found missing.
        let max =
            trial.settings.max_difference + trial.settings.squaring_offset.abs() + 2.0 * SEARCH * PERIOD_S;
        assert!(beyond.fold(0.0, f64::max) <= max + 2.0 * STEP);
        // The fault persists until power is off; then the axis can leave the switch.
        assert!(trial.gantry.fault().is_some());
        trial.switch_off();
        assert!(trial.gantry.fault().is_none());
    }
}

#[test]
fn a_switch_that_never_closes_is_named() {
    let mut random = Random::seeded(74);
    for _ in 0..cases(50) {
        let rack = random.between(-0.5, 0.5);
        for side in 0..2 {
            let mut trial = random_trial(&mut random, rack);
            trial.beam.never[side] = true;
            assert_eq!(trial.home(), None);
            assert_eq!(trial.gantry.fault(), Some(GantryFault::SwitchMissing { side }));
            // At the present position the other switch is closed: the axis leaves it first.
            trial.switch_off();
            trial.switch_on();
            trial.beam.never[side] = false;
            trial.home().expect("no fault");
            assert!(trial.errors().0.abs() <= SQUARE);
        }
    }
}

/// Power is lost at some moment, the beam twists slightly, and the axis is homed again.
#[test]
fn power_that_is_lost_at_any_moment_leaves_no_error() {
    let mut random = Random::seeded(75);
    for _ in 0..cases(200) {
        let rack = random.between(-0.4, 0.4);
        let mut trial = random_trial(&mut random, rack);
        let steps = random.below(3000);
        let goal = trial.setpoint - 1000.0;
        for _ in 0..steps {
            let (_, switch) = trial.core(Some(goal), LATCH * 2.0);
            if switch {
                break;
            }
        }
        if random.below(2) == 1 {
            let _homed = trial.home();
        }
        trial.switch_off();
        trial.beam.motor[random.below(2)] += (random.between(-0.3, 0.3) / STEP).round() * STEP;
        trial.switch_on();
        trial.home().expect("no fault");
        let (square, zero) = trial.errors();
        assert!(square.abs() <= SQUARE && zero.abs() <= SQUARE, "{square} {zero}");
    }
}

/// Another axis that is homed meanwhile does not square this one, and passing the switches alone does not
/// either.
#[test]
fn only_homing_of_this_axis_squares_it() {
    let mut random = Random::seeded(76);
    for _ in 0..cases(50) {
        let mut trial = random_trial(&mut random, 0.5);
        trial.until(true, -1000.0, SEARCH, 10_000).expect("no fault");
        let by = trial.gantry.rename(0.0, is_homed(&[7.0, 0.0], 0.0));
        assert_eq!(by, [0.0; 2]);
        trial.until(false, 1000.0, SEARCH, 10_000).expect("no fault");
        trial.until(true, -1000.0, SEARCH, 10_000).expect("no fault");
        let (square, _) = trial.errors();
        assert!((square - 0.5).abs() <= 2.0 * STEP, "{square}");
        assert_eq!(trial.gantry.take_squared(), None);
    }
}

/// Absolute encoders: squaring begins at the positions of the motors and moves to the offset at constant
/// velocity.
#[test]
fn true_coordinates_are_squared_when_power_comes() {
    let mut gantry = Gantry::new(GantrySettings {
        squaring_offset: 0.2,
        max_difference: 0.5,
        square_velocity: 100.0,
    });
    let mut step = |is_enabled: bool, second: f64| {
        gantry.step(&GantryInputs {
            is_enabled,
            power: PowerRequest::On,
            position: [1.0, second],
            velocity: 0.0,
            switches: None,
            strain: None,
            period_s: PERIOD_S,
        });
        gantry.offset(1) - 0.2
    };
    assert!((step(false, 1.5) - 0.3).abs() < 1e-12);
    let path: Vec<f64> = (0..6).map(|_| step(true, 1.45)).collect();
    for (found, expected) in path.iter().zip([0.25, 0.15, 0.05, 0.0, 0.0, 0.0]) {
        assert!((found - expected).abs() < 1e-12, "{path:?}");
    }
    assert!(
        (step(false, 0.9) + 0.3).abs() < 1e-12,
        "without power it is where it is"
    );
    assert_eq!(gantry.fault(), None);
}

/// Home switches that are limit switches as well: the first side does not stop the axis before the other
/// reaches its switch.
#[test]
fn first_side_limit_is_hidden_until_both_closed() {
    let mut gantry = Gantry::new(GantrySettings {
        squaring_offset: 0.0,
        max_difference: 1.0,
        square_velocity: 2.0,
    });
    let mut position = 0.0;
    let mut step = |gantry: &mut Gantry, velocity: f64, switches: [bool; 2]| {
        position += velocity * PERIOD_S;
        gantry.step(&GantryInputs {
            is_enabled: true,
            power: PowerRequest::On,
            position: [position; 2],
            velocity,
            switches: Some(switches),
            strain: None,
            period_s: PERIOD_S,
        });
    };
    let both = [true; 2];
    step(&mut gantry, -SEARCH, [false; 2]);
    assert_eq!(gantry.limits(0, both), both);
    step(&mut gantry, -SEARCH, [true, false]);
    assert_eq!(gantry.limits(0, both), [false, true]);
    assert_eq!(gantry.limits(1, both), both, "its own has not closed");
    step(&mut gantry, -SEARCH, both);
    assert!(gantry.home_switch());
    assert_eq!(gantry.limits(0, both), both);
    // Off both, and on again, but the second switch stays open: farther than max_difference nothing is
    // hidden.
    for _ in 0..100 {
        step(&mut gantry, SEARCH, [false; 2]);
    }
    let mut hidden = 0.0;
    while gantry.fault().is_none() {
        step(&mut gantry, -SEARCH, [true, false]);
        hidden += SEARCH * PERIOD_S;
        assert!(hidden < 1.1, "{hidden} mm");
    }
    assert_eq!(gantry.limits(0, both), both);
}

#[test]
fn the_worse_of_two_drives_is_shown() {
    let order = [
        DriveState::OperationEnabled,
        DriveState::SwitchedOn,
        DriveState::ReadyToSwitchOn,
        DriveState::SwitchOnDisabled,
        DriveState::NotReadyToSwitchOn,
        DriveState::QuickStopActive,
        DriveState::FaultReactionActive,
        DriveState::Fault,
    ];
    for (i, better) in order.iter().enumerate() {
        for worse in &order[i..] {
            assert_eq!(worse_status(better.code(), worse.code()), worse.code());
            assert_eq!(worse_status(worse.code(), better.code()), worse.code());
        }
    }
}
