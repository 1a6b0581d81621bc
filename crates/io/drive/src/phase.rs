//! The phase lock: the cycle follows the drives' clock.
//!
//! Drives on a fieldbus take their setpoints with their own clock. Two crystals differ by some 10 ppm, so
//! without synchronisation a setpoint would be used twice, or never, every few minutes. The bridge measures
//! the delay of the drives' clock relative to the due time of the setpoint. The cycle lengthens or shortens
//! its period by a proportional and an integral part of this delay.
//!
//! With the phase error `e` (ns), the drives' drift `d` and the correction `u` (ns a cycle) the loop is
//! `e' = e + d - u`, `u = Kp e + Ki sum(e)`. With `Kp = 2 zeta w`, `Ki = w^2` both roots of
//! `z^2 - (2 - Kp - Ki) z + (1 - Kp)` are near `1 - w` for `zeta = 1`. Feedback that is `D` cycles old shifts
//! the phase by about `w D` at that frequency; `w D <= 0.1` keeps more than 60 degrees of margin.
//!
//! `Ki` is per cycle, not per error: if an error arrives only every `n`th cycle, as in a loop that computes
//! `n` cycles in a row, it applies to all of them, `Ki sum(n e)`. The proportional part needs no change,
//! because its correction stays in force meanwhile. `n` is limited to `D`, so that `w n <= 0.1` as well: an
//! error does not apply to a longer silence before it.

/// The period is never changed by more than this fraction.
pub const MAX_CORRECTION_RATIO: f64 = 0.001;

/// Tuning of the lock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PhaseSettings {
    /// The nominal period, ns.
    pub period_ns: u64,
    /// Cycles from a correction to the first feedback that shows it: the lead, plus the delay of bridge and
    /// drives.
    pub delay_cycles: u32,
    /// The target phase error, ns.
    pub target_ns: i64,
}

/// Controls the period by the phase error. May be called by the cycle: no allocation, a few operations.
///
/// ```
/// use evolvent_drive::{PhaseLock, PhaseSettings};
///
/// let mut lock = PhaseLock::new(PhaseSettings { period_ns: 1_000_000, delay_cycles: 2, target_ns: 0 });
/// // The drives' clock loses 20 ns a cycle (20 ppm) and starts 5000 ns late.
/// let mut error_ns = 5_000;
/// for _ in 0..5_000 {
///     error_ns += 20 - lock.step(Some(error_ns));
/// }
/// assert!(error_ns.abs() <= 2, "{error_ns} ns");
/// assert!((lock.drift_ratio() - 20e-6).abs() < 1e-6);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseLock {
    limit_ns: f64,
    target_ns: i64,
    proportional: f64,
    integral: f64,
    /// The integral part of the correction, ns per cycle: in the steady state the drift of the clocks.
    drift_ns: f64,
    /// The correction in force, ns per cycle.
    correction_ns: f64,
    /// The remainder of rounding to whole ns.
    remainder_ns: f64,
    /// Cycles since the last error arrived.
    silent_cycles: u32,
    /// Maximum number of cycles that an error applies to.
    max_cycles: u32,
    hold_cycles: u32,
    /// Cycles since errors began to arrive.
    locked_cycles: u32,
    /// Cycles from then until the remainders of the first error and of an unknown drift are negligible.
    settling_cycles: u32,
}

impl PhaseLock {
    /// Creates a lock without a correction.
    #[must_use]
    pub fn new(settings: PhaseSettings) -> Self {
        let bandwidth = (0.1 / f64::from(settings.delay_cycles.max(1))).min(0.01);
        Self {
            limit_ns: settings.period_ns as f64 * MAX_CORRECTION_RATIO,
            target_ns: settings.target_ns,
            proportional: 2.0 * bandwidth,
            integral: bandwidth * bandwidth,
            drift_ns: 0.0,
            correction_ns: 0.0,
            remainder_ns: 0.0,
            silent_cycles: 0,
            max_cycles: settings.delay_cycles.max(1),
            hold_cycles: (4.0 / bandwidth) as u32,
            locked_cycles: 0,
            // Half a period takes 500 cycles at the limit, and `(1 + w t) exp(-w t)` falls to a
            // two-thousandth after `10 / w`.
            settling_cycles: 500 + (10.0 / bandwidth) as u32,
        }
    }

    /// The known drift of the drives' clock, as a ratio: positive if it is slower.
    #[must_use]
    pub fn drift_ratio(&self) -> f64 {
        self.drift_ns * MAX_CORRECTION_RATIO / self.limit_ns.max(1.0)
    }

    /// Excess of the period over the nominal one, as a ratio.
    #[must_use]
    pub fn correction_ratio(&self) -> f64 {
        self.correction_ns * MAX_CORRECTION_RATIO / self.limit_ns.max(1.0)
    }

    /// Whether it has had time to find drift and phase since errors began to arrive, and there is no long silence.
    #[must_use]
    pub const fn is_settled(&self) -> bool {
        self.locked_cycles >= self.settling_cycles && self.silent_cycles <= self.hold_cycles
    }

    /// Runs one cycle with the newest phase error, if one arrived. Returns the excess of this period over the
    /// nominal one, ns.
    ///
    /// Positive errors (the drives run late) lengthen the period. Without a new error the correction returns
    /// to the drift that was found: the clocks differ as before.
    pub fn step(&mut self, phase_error_ns: Option<i64>) -> i64 {
        if let Some(error_ns) = phase_error_ns {
            if self.silent_cycles > self.hold_cycles {
                self.locked_cycles = 0;
            }
            self.locked_cycles = self.locked_cycles.saturating_add(1);
            let cycles = self.silent_cycles.saturating_add(1).min(self.max_cycles);
            self.silent_cycles = 0;
            let error = error_ns.saturating_sub(self.target_ns) as f64;
            let proportional = self.proportional * error;
            let wanted = proportional + self.drift_ns;
            self.correction_ns = wanted.clamp(-self.limit_ns, self.limit_ns);
            // Anti-windup: the integral grows only if that does not push further into the limit.
            let saturated =
                (wanted > self.limit_ns && error > 0.0) || (wanted < -self.limit_ns && error < 0.0);
            if !saturated {
                let grown = self.drift_ns + self.integral * f64::from(cycles) * error;
                self.drift_ns = grown.clamp(-self.limit_ns, self.limit_ns);
            }
        } else {
            self.silent_cycles = self.silent_cycles.saturating_add(1);
            if self.locked_cycles > 0 {
                self.locked_cycles = self.locked_cycles.saturating_add(1);
            }
            if self.silent_cycles > self.hold_cycles {
                self.correction_ns = self.drift_ns;
            }
        }
        // The rounding error of whole ns is carried over, so that the mean is exact.
        let exact = (self.correction_ns + self.remainder_ns).clamp(-self.limit_ns, self.limit_ns);
        let whole = libm::trunc(exact);
        self.remainder_ns = exact - whole;
        whole as i64
    }
}
