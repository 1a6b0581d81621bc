//! What would help: the program planned again with one thing changed.

use std::sync::Arc;

use evolvent_machine::MAX_RATE_HZ;
use evolvent_path::AxisLetter;
use evolvent_runtime::{Controls, Job};
use serde::Serialize;

use super::surroundings::{Corner, Surroundings};
use super::watch::Seen;
use crate::limiting::{Limiting, Order};
use crate::unobserved::Unobserved;

/// Plans are made again for so many changes at most.
const MOST: usize = 3;
/// A cause below this share of the line's time is not worth a plan.
const WORTH: f64 = 0.05;

/// One change and what came of it.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Remedy {
    /// What was changed.
    pub(crate) change: String,
    /// Time on the line with it.
    pub(crate) time_s: f64,
    /// Time of the whole program with it.
    pub(crate) program_s: f64,
}

/// What can be changed.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Change {
    Axis(AxisLetter, Order),
    Tolerance,
    Rate,
}

/// Plans the program again for what limits the line most.
pub(crate) fn remedies(job: &Job, line: u32, program: &Surroundings, seen: &Seen) -> Vec<Remedy> {
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

fn candidates(job: &Job, program: &Surroundings, seen: &Seen) -> Vec<Change> {
    let mut changes = Vec::new();
    let mut add = |change: Change| {
        if !changes.contains(&change) && changes.len() < MOST {
            changes.push(change);
        }
    };
    for (cause, share) in &seen.causes {
        match cause {
            Limiting::Axis(axis, order) if *share >= WORTH => add(Change::Axis(*axis, *order)),
            Limiting::ChordError if *share >= WORTH && 2.0 * job.setup.rate_hz() <= MAX_RATE_HZ => {
                add(Change::Rate);
            }
            _ => {}
        }
    }
    // The tolerance of the machine file can be changed here, one of the program cannot.
    let default = |corner: Corner| matches!(corner, Corner::WithinDefault(_));
    let blended = program.moves.iter().any(|block| default(block.corner_after))
        || program
            .before
            .as_ref()
            .is_some_and(|before| default(before.block.corner_after));
    if blended && !seen.places.is_empty() {
        changes.truncate(MOST - 1);
        changes.push(Change::Tolerance);
    }
    changes
}

/// A description, and the job with the change.
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

/// Seconds on the line and in all; none if the plan fails.
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
