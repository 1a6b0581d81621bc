//! A core that holds its axes or moves X at a constant velocity.

use core::f64::consts::{FRAC_PI_2, PI};
use core::time::Duration;
use std::time::Instant;

use evolvent_bridge_sim::monotonic_ns;
use evolvent_bus::{AXES, BusConfig, CoreBus, Feedback, MachineInputs, Setpoint};
use evolvent_drive::{DriveState, PowerRequest};

/// The core's period: slow enough for a busy machine.
pub const PERIOD_NS: u64 = 2_000_000;
const PERIOD_S: f64 = PERIOD_NS as f64 * 1e-9;
/// Periods between sending a setpoint and its due time.
const LEAD: u64 = 50;
/// Maximum age of feedback that is used.
const FRESH: Duration = Duration::from_millis(100);
/// Acceleration of every motion, mm/s2: within the limits of the machines of trials.
pub const ACCELERATION: f64 = 800.0;
/// Time limit of every wait: a busy host may need that.
pub(crate) const LATEST: Duration = Duration::from_secs(30);

/// The core of a machine with the axes X, Y and Z, driven cycle by cycle by a test.
#[derive(Debug)]
pub struct TrialCore {
    /// Its ports.
    pub bus: CoreBus,
    sequence: u64,
    next_ns: u64,
    /// Commanded positions of the axes, mm.
    pub position: [f64; AXES],
    /// Velocity towards which X accelerates, mm/s.
    pub velocity_x: f64,
    /// The velocity of the last setpoint, mm/s, and its acceleration, mm/s2.
    velocity: [f64; AXES],
    acceleration: [f64; AXES],
    /// Whether setpoints contain the acceleration of their motion. Otherwise it is 0, which a core may also
    /// send.
    pub sends_acceleration: bool,
    /// Power request to the drives.
    pub power: PowerRequest,
    /// The number of the newest reset of the drives' faults.
    pub fault_reset: u32,
    /// The datum of the positions.
    pub datum: u64,
    /// The request for an index pulse: its number and its axis.
    pub index: (u32, u32),
    /// The newest feedback with its time of arrival.
    pub newest: Option<(Instant, Feedback)>,
    /// The newest inputs of the machine.
    pub inputs: Option<MachineInputs>,
}

impl TrialCore {
    /// Opens a core at rest, without power.
    ///
    /// # Panics
    /// If the bus cannot be used.
    #[must_use]
    pub fn open(machine_name: &str, prefix: &str) -> Self {
        let mut config = BusConfig::new(machine_name, "XYZ", PERIOD_NS);
        config.prefix = Some(prefix.to_owned());
        Self {
            bus: CoreBus::open(&config).expect("a bus"),
            sequence: 0,
            next_ns: monotonic_ns(),
            position: [0.0; AXES],
            velocity_x: 0.0,
            velocity: [0.0; AXES],
            acceleration: [0.0; AXES],
            sends_acceleration: false,
            power: PowerRequest::Off,
            fault_reset: 0,
            datum: 0,
            index: (0, 0),
            newest: None,
            inputs: None,
        }
    }

    /// Sends the next setpoint, sleeps until the next cycle, and receives messages.
    pub fn cycle(&mut self) {
        let change = ACCELERATION * PERIOD_S;
        let by = (self.velocity_x - self.velocity[0]).clamp(-change, change);
        self.advance(0, self.velocity[0] + by);
        self.send();
    }

    /// Advances an axis by one period towards a velocity, at a constant acceleration.
    fn advance(&mut self, axis: usize, velocity: f64) {
        self.position[axis] += 0.5 * (self.velocity[axis] + velocity) * PERIOD_S;
        self.acceleration[axis] = (velocity - self.velocity[axis]) / PERIOD_S;
        self.velocity[axis] = velocity;
    }

    fn send(&mut self) {
        let setpoint = Setpoint {
            sequence: self.sequence,
            due_time_ns: self.next_ns + LEAD * PERIOD_NS,
            period_ns: PERIOD_NS,
            position: self.position,
            velocity: self.velocity,
            acceleration: if self.sends_acceleration {
                self.acceleration
            } else {
                [0.0; AXES]
            },
            axes_mask: 0b111,
            state: 1,
            override_ratio: 1.0,
            power_request: self.power.number(),
            fault_reset: self.fault_reset,
            datum: self.datum,
            index_request: self.index.0,
            index_axis: self.index.1,
            ..Setpoint::default()
        };
        self.sequence += 1;
        let _reached = self.bus.publish_setpoint(&setpoint);
        self.next_ns = (self.next_ns + PERIOD_NS).max(monotonic_ns().saturating_sub(LEAD * PERIOD_NS / 2));
        std::thread::sleep(Duration::from_nanos(self.next_ns.saturating_sub(monotonic_ns())));
        self.bus.admit_readers();
        while let Ok(Some(feedback)) = self.bus.unchecked_feedback() {
            self.newest = Some((Instant::now(), feedback));
        }
        while let Ok(Some(inputs)) = self.bus.unchecked_inputs() {
            self.inputs = Some(inputs);
        }
    }

    /// Runs cycles for a time, at `velocity_x`.
    pub fn rest(&mut self, seconds: f64) {
        for _ in 0..(seconds * 1e9) as u64 / PERIOD_NS {
            self.cycle();
        }
    }

    /// Makes X jump persistently, at rest and in motion. Some jumps are small enough that an axis could cover
    /// them in the ten periods for which a bridge waits for setpoints. `moved_mm` returns the distance that
    /// the motor of X has turned.
    ///
    /// # Panics
    /// If the motor follows a jump by more than `resolution_mm`.
    pub fn jumps(&mut self, resolution_mm: f64, mut moved_mm: impl FnMut() -> f64) {
        for (velocity, jump) in [0.0, 20.0]
            .into_iter()
            .flat_map(|velocity| [0.6, 1.0, 2.0].map(|jump| (velocity, jump)))
        {
            self.bring_up();
            self.velocity_x = velocity;
            self.rest(0.3);
            let from = moved_mm();
            self.position[0] += jump;
            self.rest(0.3);
            let moved = moved_mm() - from;
            // The motor lags the core by up to a lead, continues for ten periods, and then brakes.
            let max_mm = velocity * (LEAD + 12) as f64 * PERIOD_S + 0.5 * velocity.min(1.0);
            assert!(
                moved <= max_mm + resolution_mm,
                "{moved} mm at {velocity} mm/s, {jump} mm"
            );
            let (_, feedback) = self.newest.expect("feedback");
            assert_eq!((feedback.bridge_state, feedback.note), (4, 4), "{feedback:?}");
        }
    }

    /// Decelerates X to rest.
    pub fn stop(&mut self) {
        self.velocity_x = 0.0;
        while self.velocity[0] != 0.0 {
            self.cycle();
        }
    }

    /// Moves an axis by a distance at constant velocity, except for its ramps, and waits until it is at rest.
    pub fn travel(&mut self, axis: usize, distance: f64, velocity: f64) {
        let ramp = (velocity / (ACCELERATION * PERIOD_S)).ceil();
        // Both ramps together cover the distance that one of them would cover at full velocity.
        let cruise = (distance.abs() / (velocity * PERIOD_S) - ramp).round().max(1.0);
        let speed = distance / ((cruise + ramp) * PERIOD_S);
        let periods = cruise + 2.0 * ramp;
        for period in 1..=periods as u64 {
            let period = period as f64;
            self.advance(
                axis,
                speed * (period / ramp).min((periods - period) / ramp).min(1.0),
            );
            self.send();
        }
        self.rest(0.5);
    }

    /// Like [`Self::travel`], with velocity ramps of half a cosine that reach the maximum acceleration. The
    /// interpolation of a bridge then stays near the motion at any time within a period and with any missing
    /// setpoints. With a step in acceleration it cannot.
    pub fn travel_smoothly(&mut self, axis: usize, distance: f64, velocity: f64) {
        let ramp = (FRAC_PI_2 * velocity / (ACCELERATION * PERIOD_S)).ceil();
        let cruise = (distance.abs() / (velocity * PERIOD_S) - ramp).round().max(1.0);
        let speed = distance / ((cruise + ramp) * PERIOD_S);
        let (from, periods) = (self.position[axis], cruise + 2.0 * ramp);
        for period in 1..=periods as u64 {
            let period = period as f64;
            // The second half is the reverse of the first.
            let (since, is_first) = if 2.0 * period <= periods {
                (period, true)
            } else {
                (periods - period, false)
            };
            let phase = PI * (since / ramp).min(1.0);
            let moved =
                speed * PERIOD_S * ((since - 0.5 * ramp).max(0.5 * since) - 0.5 * ramp / PI * phase.sin());
            let acceleration = 0.5 * PI * speed / (ramp * PERIOD_S) * phase.sin();
            self.velocity[axis] = 0.5 * speed * (1.0 - phase.cos());
            (self.position[axis], self.acceleration[axis]) = if is_first {
                (from + moved, acceleration)
            } else {
                (from + distance - moved, -acceleration)
            };
            self.send();
        }
        self.rest(0.5);
    }

    /// The newest feedback, if it is fresh.
    #[must_use]
    pub fn fresh(&self) -> Option<Feedback> {
        self.newest
            .filter(|(at, _)| at.elapsed() < FRESH)
            .map(|(_, feedback)| feedback)
    }

    /// Runs cycles until fresh feedback meets a condition.
    ///
    /// # Panics
    /// If it does not meet it in time.
    pub fn until(&mut self, what: &str, mut condition: impl FnMut(&Feedback) -> bool) -> Feedback {
        let begin = Instant::now();
        loop {
            self.cycle();
            if let Some(feedback) = self.fresh().filter(|feedback| condition(feedback)) {
                return feedback;
            }
            assert!(
                begin.elapsed() < LATEST,
                "{what}: not within {LATEST:?}; {:?}",
                self.newest
            );
        }
    }

    /// Runs cycles until the inputs of the machine meet a condition.
    ///
    /// # Panics
    /// If they do not meet it in time.
    pub fn until_inputs(
        &mut self,
        what: &str,
        mut condition: impl FnMut(&MachineInputs) -> bool,
    ) -> MachineInputs {
        let begin = Instant::now();
        loop {
            self.cycle();
            if let Some(inputs) = self.inputs.filter(|inputs| condition(inputs)) {
                return inputs;
            }
            assert!(
                begin.elapsed() < LATEST,
                "{what}: not within {LATEST:?}; {:?}",
                self.inputs
            );
        }
    }

    /// Requests the next index pulse of an axis and waits until the request is taken over.
    ///
    /// # Panics
    /// If it is not taken over in time, or a pulse of an earlier request is reported for it.
    pub fn request_index(&mut self, axis: u32) -> Feedback {
        self.index = (self.index.0 + 1, axis);
        let number = self.index.0;
        let taken = self.until("the request is taken over", |feedback| {
            feedback.index_request == number
        });
        assert!(taken.index_position.is_nan(), "no pulse yet: {taken:?}");
        taken
    }

    /// Waits for the position latched for the newest request.
    ///
    /// # Panics
    /// If none comes in time.
    pub fn latched_index(&mut self) -> f64 {
        let number = self.index.0;
        let latched = self.until("the pulse", |feedback| {
            feedback.index_request == number && !feedback.index_position.is_nan()
        });
        latched.index_position
    }

    /// Sets the commanded positions to those of the axes, and switches the drives on.
    ///
    /// # Panics
    /// If the drives are not operational in time.
    pub fn bring_up(&mut self) -> Feedback {
        self.bring_up_beside(0.0)
    }

    /// Like [`TrialCore::bring_up`], with setpoints of X at this distance from its position, mm.
    ///
    /// # Panics
    /// As [`TrialCore::bring_up`].
    pub fn bring_up_beside(&mut self, distance: f64) -> Feedback {
        (self.power, self.velocity_x, self.velocity) = (PowerRequest::Off, 0.0, [0.0; AXES]);
        self.acceleration = [0.0; AXES];
        let here = self.until("feedback with the drives off", |feedback| {
            states(feedback) == [Some(DriveState::SwitchOnDisabled); 3]
        });
        self.position = here.position;
        self.position[0] += distance;
        self.rest(0.2);
        self.power = PowerRequest::On;
        self.until("operation", |feedback| {
            states(feedback) == [Some(DriveState::OperationEnabled); 3] && feedback.bridge_state == 1
        })
    }
}

/// The state of each of the three drives.
#[must_use]
pub fn states(feedback: &Feedback) -> [Option<DriveState>; 3] {
    core::array::from_fn(|axis| DriveState::decode(feedback.status_word[axis] as u16))
}
