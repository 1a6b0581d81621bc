//! A change of datum changes coordinates only: whatever is lost, late or switched off around it, no axis
//! moves because of it, and bridge and core have the same coordinates afterwards or know that they have not.

#![expect(clippy::expect_used, reason = "helpers of tests fail as tests do")]

use std::collections::VecDeque;

use evolvent_drive::{BridgeState, Follower, FollowerSettings, PowerRequest, Target};
use evolvent_path::AxisMask;
use evolvent_random::{Random, cases};
use evolvent_wire::{AXES, Setpoint};

const PERIOD_NS: u64 = 1_000_000;
const PERIOD_S: f64 = 1e-3;
const BRIDGED: u32 = 10;
const LEAD: u64 = 2;
const SYNC: f64 = 0.02;
/// The core's motion: half its maximum velocity divided by its angular velocity, mm, and the angular
/// velocity, rad/s.
const SIZE: f64 = 0.5;
const TURN: f64 = 60.0;

fn follower() -> Follower {
    Follower::new(FollowerSettings {
        period_ns: PERIOD_NS,
        bridge_cycles: BRIDGED,
        axes: AxisMask::one(0),
        max_velocity: [200.0; AXES],
        max_acceleration: [5_000.0; AXES],
        max_jerk: [200_000.0; AXES],
        sync_tolerance: [SYNC; AXES],
    })
    .expect("limits")
}

/// A follower with an ideal motor.
struct Bench {
    follower: Follower,
    now_ns: u64,
    /// True position of the motor.
    motor: f64,
    /// Coordinate minus position of the motor.
    offset: f64,
    is_enabled: bool,
    /// Maximum distance of the motor per elapsed period.
    longest: f64,
    last: Option<Target>,
}

impl Bench {
    fn new() -> Self {
        Self {
            follower: follower(),
            now_ns: 100_000_000,
            motor: 0.0,
            offset: 0.0,
            is_enabled: true,
            longest: 0.0,
            last: None,
        }
    }

    /// Runs the bridge after `periods` periods; it was suspended in the earlier ones.
    fn step(&mut self, periods: u64) -> Target {
        self.now_ns += periods * PERIOD_NS;
        let mut actual = [0.0; AXES];
        actual[0] = self.motor + self.offset;
        let target = self.follower.step(self.now_ns, self.is_enabled, &actual);
        if let Some(shift) = target.datum_shift {
            self.offset += shift[0];
        }
        let wanted = target.position[0] - self.offset;
        if self.is_enabled {
            let travel = (wanted - self.motor).abs() / periods as f64;
            self.longest = self.longest.max(travel);
            self.motor = wanted;
        } else {
            assert!((wanted - self.motor).abs() < 1e-9, "{target:?}");
        }
        self.last = Some(target);
        target
    }

    fn offer(&mut self, setpoint: &Setpoint) {
        let _noted = self.follower.offer(self.now_ns, setpoint);
    }
}

/// A setpoint at rest, due `LEAD` periods after its number of periods.
fn at_rest(sequence: u64, position: f64, datum: u64) -> Setpoint {
    let mut setpoint = Setpoint {
        sequence,
        due_time_ns: 100_000_000 + (sequence + LEAD) * PERIOD_NS,
        period_ns: PERIOD_NS,
        axes_mask: 1,
        power_request: PowerRequest::On.number(),
        datum,
        ..Setpoint::default()
    };
    setpoint.position[0] = position;
    setpoint
}

/// Runs until the bridge follows at rest. Returns the number of the next setpoint.
fn following(bench: &mut Bench) -> u64 {
    for sequence in 0..20 {
        bench.offer(&at_rest(sequence, 0.0, 0));
        bench.step(1);
    }
    assert_eq!(
        bench.last.map(|target| target.state),
        Some(BridgeState::Following)
    );
    20
}

/// The setpoint with the new datum is some periods late, or those before it are lost.
#[test]
fn late_datum_or_one_after_losses_moves_nothing() {
    for silent in 1..u64::from(BRIDGED) {
        for is_lost in [false, true] {
            let mut bench = Bench::new();
            let first = following(&mut bench);
            let renamed = |sequence: u64| at_rest(sequence, 300.0, 1);
            bench.step(silent);
            let bridges = bench.step(1);
            if silent + 1 > LEAD + 1 {
                assert_eq!(bridges.state, BridgeState::Bridging);
            }
            for sequence in first..first + 40 {
                // Late setpoints catch up.
                if !is_lost || sequence >= first + silent {
                    bench.offer(&renamed(sequence));
                }
                if sequence > first + silent {
                    let target = bench.step(1);
                    assert!(bench.motor.abs() < 1e-9, "{silent} {is_lost}: {target:?}");
                }
            }
            let target = bench.last.expect("targets");
            assert_eq!(
                (target.state, target.datum),
                (BridgeState::Following, 1),
                "{silent}"
            );
            assert_eq!((bench.offset, target.datums_lost), (300.0, 0));
        }
    }
}

#[test]
fn bridge_suspended_at_datum_change_brakes_in_place() {
    let mut bench = Bench::new();
    let first = following(&mut bench);
    for sequence in first..first + 40 {
        let datum = u64::from(sequence >= first + 5);
        bench.offer(&at_rest(sequence, 300.0 * datum as f64, datum));
    }
    let target = bench.step(30);
    assert_eq!((target.datum, bench.offset), (1, 300.0));
    assert!(bench.motor.abs() < 1e-9, "{target:?}");
    for sequence in first + 40..first + 80 {
        bench.offer(&at_rest(sequence, 300.0, 1));
        bench.step(1);
        assert!(bench.motor.abs() < 1e-9);
    }
    let target = bench.last.expect("targets");
    assert_eq!(
        (target.state, target.position[0]),
        (BridgeState::Following, 300.0)
    );
}

/// An emergency stop between the change of datum and its setpoint.
#[test]
fn drives_that_have_lost_power_are_renamed_too() {
    let mut bench = Bench::new();
    let first = following(&mut bench);
    bench.is_enabled = false;
    for sequence in first..first + 20 {
        let datum = u64::from(sequence >= first + 3);
        bench.offer(&at_rest(sequence, 300.0 * datum as f64, datum));
        let target = bench.step(1);
        assert_eq!(target.state, BridgeState::Off);
        assert_eq!(bench.offset, 300.0 * target.datum as f64);
    }
    assert_eq!(bench.last.map(|target| target.datum), Some(1));
}

/// Two axes homed one after the other, whose setpoints are due in the same period.
#[test]
fn two_changes_in_one_period_add_up() {
    let mut bench = Bench::new();
    let first = following(&mut bench);
    for (i, datum) in [(0, 1), (1, 2), (2, 2), (3, 2)] {
        bench.offer(&at_rest(first + i, [0.0, 300.0, -20.0][datum as usize], datum));
    }
    let target = bench.step(5);
    assert_eq!((target.datum, bench.offset), (2, -20.0));
    assert!(bench.motor.abs() < 1e-9);
}

/// A restarted core knows no datum before it receives feedback, and then takes the position of the drives.
#[test]
fn core_taking_over_bridge_datum_renames_nothing() {
    let mut bench = Bench::new();
    let first = following(&mut bench);
    for sequence in first..first + 20 {
        bench.offer(&at_rest(sequence, 300.0, 3));
        bench.step(1);
    }
    assert_eq!((bench.offset, bench.motor), (300.0, 0.0));
    bench.is_enabled = false;
    for cycle in 0..40_u64 {
        let (position, datum) = if cycle < 4 { (0.0, 0) } else { (300.0, 3) };
        let mut setpoint = at_rest(first + 20 + cycle, position, datum);
        setpoint.sequence = cycle;
        bench.is_enabled = cycle > 20;
        setpoint.power_request = u32::from(cycle > 18);
        bench.offer(&setpoint);
        let target = bench.step(1);
        assert_eq!((bench.offset, target.datums_lost), (300.0, 0));
    }
    let target = bench.last.expect("targets");
    assert_eq!((target.state, target.datum), (BridgeState::Following, 3));
}

/// The setpoint before the new datum was lost, and axes without power may have moved: the amount is unknown.
#[test]
fn a_change_by_an_unknown_amount_is_another_instance() {
    let mut bench = Bench::new();
    let first = following(&mut bench);
    bench.is_enabled = false;
    bench.offer(&at_rest(first, 0.0, 0));
    let before = bench.step(1).instance(77);
    assert_eq!(before, 77);
    for sequence in first + 3..first + 20 {
        bench.offer(&at_rest(sequence, 300.0, 1));
        bench.step(1);
    }
    let target = bench.last.expect("targets");
    assert_eq!((target.datum, bench.offset), (1, 0.0));
    assert_ne!(target.instance(77), before);
}

/// The parts of a core that affect the datum: it moves, homes, loses power when the bridge does not follow,
/// and then takes the position of the drives.
struct Core {
    sequence: u64,
    datum: u64,
    position: f64,
    /// Sum of its changes of datum.
    renamed: f64,
    /// Periods since a motion began, and its direction.
    motion: Option<(f64, u64)>,
    power: PowerRequest,
    /// End of its standstill.
    stands_until: u64,
    /// Whether it has been followed; before that it homes nothing.
    is_tied: bool,
    instance: u64,
}

impl Core {
    fn step(&mut self, random: &mut Random, feedback: Option<(f64, Target)>) -> Setpoint {
        let follows = feedback.is_some_and(|(_, target)| {
            matches!(target.state, BridgeState::Following | BridgeState::Bridging)
                && target.datum == self.datum
                && target.instance(7) == self.instance
        });
        if self.power == PowerRequest::On && !follows && self.sequence > self.stands_until + 60 {
            (self.power, self.motion) = (PowerRequest::Off, None);
            self.stands_until = self.sequence + 30 + random.below(30) as u64;
        }
        self.is_tied |= follows;
        let mut renames = false;
        if self.motion.is_none() && self.sequence > self.stands_until && follows {
            match random.below(40) {
                0 => {
                    let direction = if random.below(2) == 0 { 1.0 } else { -1.0 };
                    self.motion = Some((direction, 0));
                }
                1..=3 => renames = true,
                _ => {}
            }
        }
        // Also at an emergency stop.
        renames |= self.is_tied && self.power == PowerRequest::Off && random.below(100) == 0;
        if renames {
            let shift = random.between(-300.0, 300.0);
            self.datum += 1;
            self.position += shift;
            self.renamed += shift;
        } else if let (PowerRequest::Off, Some((position, target))) = (self.power, feedback) {
            if target.datum == self.datum {
                self.position = position;
            }
            if self.sequence > self.stands_until && random.below(10) == 0 {
                (self.power, self.stands_until) = (PowerRequest::On, self.sequence);
            }
        }
        let mut setpoint = at_rest(self.sequence, self.position, self.datum);
        setpoint.power_request = self.power.number();
        if let Some((direction, periods)) = &mut self.motion {
            *periods += 1;
            let angle = (TURN * *periods as f64 * PERIOD_S).min(std::f64::consts::TAU);
            setpoint.position[0] += *direction * SIZE * (angle - angle.sin());
            setpoint.velocity[0] = *direction * SIZE * TURN * (1.0 - angle.cos());
            setpoint.acceleration[0] = *direction * SIZE * TURN * TURN * angle.sin();
            if angle >= std::f64::consts::TAU {
                (setpoint.velocity[0], setpoint.acceleration[0]) = (0.0, 0.0);
                self.position = setpoint.position[0];
                (self.motion, self.stands_until) = (None, self.sequence);
            }
        }
        self.sequence += 1;
        setpoint
    }
}

/// Counts of situations in a random run.
#[derive(Default)]
struct Met {
    renamed_on: u64,
    renamed_off: u64,
    lost: u32,
    braked: u64,
}

fn run(random: &mut Random, met: &mut Met) {
    let mut bench = Bench::new();
    let mut core = Core {
        sequence: 0,
        datum: 0,
        position: 0.0,
        renamed: 0.0,
        motion: None,
        power: PowerRequest::Off,
        stands_until: 10,
        is_tied: false,
        instance: 7,
    };
    let mut in_transit: VecDeque<(f64, Target)> = VecDeque::new();
    let mut wire: VecDeque<Setpoint> = VecDeque::new();
    // Permitted difference of their coordinates: none before the bridge has reported an unknown change.
    let (mut alike, mut homes_again) = (0.0, false);
    let (mut held_back, mut pause, mut off) = (0_u64, 0_u64, 0_u64);
    for _ in 0..4000 {
        let sent = core.step(random, in_transit.front().copied());
        // Faults are more frequent near changes of datum.
        let is_near = sent.datum != in_transit.back().map_or(0, |(_, target)| target.datum);
        let chance = if is_near { 6 } else { 300 };
        let trouble = random.below(chance) == 0;
        match random.below(5) {
            0 if trouble => held_back = 1 + random.below(14) as u64,
            1 if trouble => pause = 1 + random.below(25) as u64,
            2 if trouble => off = 1 + random.below(80) as u64,
            3 if trouble => {}
            _ => wire.push_back(sent),
        }
        if held_back > 0 {
            held_back -= 1;
        } else {
            for setpoint in wire.drain(..) {
                bench.offer(&setpoint);
            }
        }
        off = off.saturating_sub(1);
        bench.is_enabled = off == 0
            && in_transit
                .back()
                .is_none_or(|(_, target)| target.power == PowerRequest::On);
        if !bench.is_enabled {
            // Moved by hand.
            bench.motor += random.between(-0.01, 0.01);
        }
        if pause > 1 {
            pause -= 1;
            continue;
        }
        let behind = 100_000_000 + core.sequence * PERIOD_NS - bench.now_ns;
        let target = bench.step((behind / PERIOD_NS).max(1));
        if target.datum_shift.is_some() {
            *(if bench.is_enabled {
                &mut met.renamed_on
            } else {
                &mut met.renamed_off
            }) += 1;
        }
        met.braked += u64::from(target.state == BridgeState::Braking);
        if target.instance(7) != core.instance {
            met.lost += 1;
            core.instance = target.instance(7);
            (core.motion, core.power) = (None, PowerRequest::Off);
            core.stands_until = core.sequence + 40;
            homes_again = true;
        }
        if target.datum == core.datum && target.state != BridgeState::Braking {
            let off_by = bench.offset - core.renamed;
            if homes_again {
                alike = off_by;
                homes_again = target.state != BridgeState::Following;
            }
            assert!(
                (off_by - alike).abs() < 1e-6,
                "coordinates differ by {}",
                off_by - alike
            );
        }
        in_transit.push_back((bench.motor + bench.offset, target));
        if in_transit.len() > 3 {
            in_transit.pop_front();
        }
    }
    // Twice the motion's velocity while setpoints are bridged, and when following begins.
    let max = 2.0 * 2.0 * SIZE * TURN * PERIOD_S + SYNC;
    assert!(bench.longest <= max, "{} mm in a period, of {max}", bench.longest);
}

#[test]
fn random_faults_with_datum_changes_move_no_axis() {
    let mut random = Random::new();
    let mut met = Met::default();
    for _ in 0..cases(60) {
        run(&mut random, &mut met);
    }
    assert!(
        met.renamed_on > 100 && met.renamed_off > 20,
        "{} {}",
        met.renamed_on,
        met.renamed_off
    );
    assert!(met.braked > 20 && met.lost > 0, "{} {}", met.braked, met.lost);
}
