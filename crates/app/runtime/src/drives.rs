//! Settings for monitoring the drives, from the machine file.

use evolvent_drive::{FeedbackBounds, PhaseSettings, WatchMode, WatchSettings};
use evolvent_machine::{FeedbackMode, Machine};
use evolvent_path::AxisMask;

use crate::pacing::{cycles_per_wake, wake_interval_ns};

/// Settings for monitoring the drives at a period.
///
/// A sample may always be as old as three wake-ups of the loop.
#[must_use]
pub fn watch_settings(machine: &Machine, period_ns: u64) -> WatchSettings {
    let ns = |seconds: f64| (seconds * 1e9) as u64;
    let mut settings = WatchSettings::new(period_ns, AxisMask::NONE);
    settings.mode = match machine.drives.feedback {
        FeedbackMode::Ignore => WatchMode::Ignore,
        FeedbackMode::IfPresent => WatchMode::IfPresent,
        FeedbackMode::Required => WatchMode::Required,
    };
    settings.stale_ns = ns(machine.drives.feedback_timeout_s)
        .max(3 * wake_interval_ns(period_ns, machine.lead_cycles(period_ns)));
    settings.enable_timeout_ns = ns(machine.drives.enable_timeout_s);
    settings.bounds = feedback_bounds(machine);
    settings.bounds.ahead_ns = settings.stale_ns;
    for axis in &machine.axes {
        let index = axis.letter.index();
        settings.axes |= AxisMask::one(index);
        settings.following_floor[index] = axis.following_error;
        settings.following_time_s[index] = axis.following_time_s;
        settings.memory_s = settings.memory_s.max(2.0 * axis.following_time_s);
    }
    settings
}

/// The range of plausible feedback of a machine.
#[must_use]
pub(crate) fn feedback_bounds(machine: &Machine) -> FeedbackBounds {
    let mut bounds = FeedbackBounds::new(AxisMask::NONE);
    for axis in &machine.axes {
        let index = axis.letter.index();
        bounds.axes |= AxisMask::one(index);
        let reach = machine.corrections.reach(machine)[index];
        let travel = [axis.travel_min - reach, axis.travel_max + reach];
        bounds.set_axis(index, travel, axis.max_velocity);
    }
    bounds
}

/// Settings for following the drives' clock; `None` if the machine file disables it.
#[must_use]
pub fn phase_settings(machine: &Machine, period_ns: u64) -> Option<PhaseSettings> {
    let lead_cycles = machine.lead_cycles(period_ns);
    machine.drives.follow_clock.then_some(PhaseSettings {
        period_ns,
        delay_cycles: lead_cycles + 1 + cycles_per_wake(period_ns, lead_cycles) as u32,
        target_ns: 0,
    })
}
