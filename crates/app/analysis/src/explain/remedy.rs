//! Remedies: the program planned again with one change.

use std::sync::Arc;

use evolvent_machine::MAX_RATE_HZ;
use evolvent_path::AxisLetter;
use evolvent_runtime::{Controls, Job};
use serde::Serialize;

use super::surroundings::{Corner, Surroundings};
use super::watch::LineTiming;
use crate::limiting::{Limiting, Order};
use crate::unobserved::Unobserved;

/// Maximum number of changes that are planned.
const MAX_CHANGES: usize = 3;
/// Causes below this fraction of the line's duration are not planned.
const WORTH: f64 = 0.05;

/// One change and its effect.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Remedy {
    /// The change.
    pub(crate) change: String,
    /// Duration of the line with the change.
    pub(crate) time_s: f64,
    /// Duration of the whole program with the change.
    pub(crate) program_s: f64,
}

/// A possible change.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    Axis(AxisLetter, Order),
    Tolerance,
    Rate,
}

/// Plans the program again for the causes that limit the line most.
pub(crate) fn remedies(job: &Job, line: u32, program: &Surroundings, seen: &LineTiming) -> Vec<Remedy> {
    candidates(job, program, seen)
        .into_iter()
        .filter_map(|change| {
            let (change, job) = changed(job, change)?;
            let (time_s, program_s) = timed(&job, line)?;
            Some(Remedy {
                change,
                time_s,
                program_s,
            })
        })
        .collect()
}

fn candidates(job: &Job, program: &Surroundings, seen: &LineTiming) -> Vec<Change> {
    let mut changes = Vec::new();
    let mut add = |change: Change| {
        if !changes.contains(&change) && changes.len() < MAX_CHANGES {
            changes.push(change);
        }
    };
    for (cause, fraction) in &seen.causes {
        match cause {
            Limiting::Axis(axis, order) if *fraction >= WORTH => add(Change::Axis(*axis, *order)),
            Limiting::ChordError if *fraction >= WORTH && 2.0 * job.setup.rate_hz() <= MAX_RATE_HZ => {
                add(Change::Rate);
            }
            _ => {}
        }
    }
    // The tolerance of the machine file can be changed here, a programmed one cannot.
    let blended = program
        .corners()
        .any(|corner| matches!(corner, Corner::WithinDefault(_)));
    if blended && !seen.places.is_empty() {
        changes.truncate(MAX_CHANGES - 1);
        changes.push(Change::Tolerance);
    }
    changes
}

/// The description of a change, and the changed job.
fn changed(job: &Job, change: Change) -> Option<(String, Job)> {
    let mut job = job.clone();
    let text = match change {
        Change::Axis(letter, order) => {
            let axis = job
                .setup
                .machine
                .axes
                .iter_mut()
                .find(|axis| axis.letter == letter)?;
            match order {
                Order::Velocity => axis.max_velocity *= 2.0,
                Order::Acceleration => axis.max_acceleration *= 2.0,
                Order::Jerk => axis.max_jerk *= 2.0,
            }
            format!("twice the {} of {}", order.name(), letter.letter())
        }
        Change::Tolerance => {
            let path = &mut job.setup.machine.path;
            path.blend_tolerance_mm *= 2.0;
            format!("twice the blend tolerance (G64 P{})", path.blend_tolerance_mm)
        }
        Change::Rate => {
            job.setup.period_ns = (job.setup.period_ns / 2).max(1);
            "twice the control rate".to_owned()
        }
    };
    Some((text, job))
}

/// Seconds on the line and in total; `None` if the plan fails.
fn timed(job: &Job, line: u32) -> Option<(f64, f64)> {
    let controls = Arc::new(Controls::new(job.feed_override));
    let (mut on_line, mut all) = (0_u64, 0_u64);
    let outcome = evolvent_runtime::run(job, &controls, &mut Unobserved, |setpoint| {
        all += 1;
        on_line += u64::from(setpoint.line == line);
    });
    let outcome = outcome.ok()?;
    if outcome.fault.is_some() || outcome.program.is_err() {
        return None;
    }
    let period_s = job.setup.period_ns as f64 * 1e-9;
    Some((on_line as f64 * period_s, all as f64 * period_s))
}
