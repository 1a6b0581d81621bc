//! Threads in the form of Fanuc's lathes: G32, and the cycle G92.

use evolvent_path::Axes;

use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::{Code, MoveKind, PathMode};

/// Modal words of such threads.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FanucThread {
    /// F of the last thread, mm per revolution along its longer axis.
    lead_mm: Option<f64>,
    /// Z and R of the last G92 in program coordinates, mm.
    cycle: Option<(f64, f64)>,
}

impl FanucThread {
    /// Called for another motion: a later G92 needs all its words.
    pub(crate) fn end_cycle(&mut self) {
        self.cycle = None;
    }

    /// Called for another motion, whose F is a feed: a later thread needs its own lead.
    pub(crate) fn clear_lead(&mut self) {
        self.lead_mm = None;
    }
}

/// Path per revolution if the longer axis moves by `lead_mm`.
fn lead_along_path(displacement: &Axes, lead_mm: f64) -> f64 {
    let longer = displacement[0].abs().max(displacement[2].abs());
    lead_mm * libm::hypot(displacement[0], displacement[2]) / longer.max(f64::MIN_POSITIVE)
}

impl Executor<'_> {
    /// G32: like G33, but F is the lead of the longer axis, and Q is in thousandths of a degree.
    pub(crate) fn fanuc_thread(&mut self) -> Result<(), Fault> {
        if !self.line.has_axes() {
            return Ok(());
        }
        self.allow_only_axes(b"XZ", "G32")?;
        let lead_mm = self.fanuc_lead("G32")?;
        let degrees = self.fanuc_angle("G32")?;
        let target = self.target()?;
        let pitch_mm = lead_along_path(&(target - self.state.position), lead_mm);
        self.emit_thread(target, pitch_mm, degrees, None)
    }

    /// G92: to X (by R farther out at its start), along the thread to Z, outwards to the initial X, and back.
    /// Following lines with X alone are further passes.
    pub(crate) fn fanuc_thread_cycle(&mut self) -> Result<(), Fault> {
        let line = self.line;
        if !line.has_axes() {
            if line.motion_code().is_none() {
                return Ok(());
            }
            let message = "G92 is a thread cycle on this machine (program.fanuc_threads) and needs X and Z";
            return Err(Fault::new(Code::WordMissing, line.motion_span(), message).help(
                "the highest speed of G96 is its word D; an offset is set by G10 L2 or `ctl touch-off`",
            ));
        }
        self.allow_only_axes(b"XZ", "G92")?;
        let lead_mm = self.fanuc_lead("G92")?;
        let degrees = self.fanuc_angle("G92")?;
        let start = self.state.machine_to_program(self.state.position);
        let target = self.state.machine_to_program(self.target()?);
        let before = self.state.fanuc_thread.cycle;
        let z = match (line.has(b'Z'), before) {
            (true, _) => target[2],
            (false, Some((z, _))) => z,
            (false, None) => {
                let message = "G92 needs Z, the end of the thread";
                return Err(Fault::new(Code::WordMissing, line.motion_span(), message));
            }
        };
        let taper = match (line.word(b'R'), before) {
            (Some(taper), _) => taper * self.state.unit_mm(),
            (None, Some((_, taper))) => taper,
            (None, None) => 0.0,
        };
        let x = target[0];
        if !line.has(b'X') || x == start[0] || z == start[2] {
            let message = "G92 needs X, the depth, away from where it begins, and an end Z away from there";
            return Err(Fault::new(Code::OutOfRange, line.motion_span(), message)
                .help("begin beside the thread and before it: G0 X30 Z5, then G92 X28.5 Z-20 F1.5"));
        }
        let point = |x: f64, z: f64| {
            let mut at = start;
            (at[0], at[2]) = (x, z);
            at
        };
        let (begin, end) = (point(x + taper, start[2]), point(x, z));
        let pitch_mm = lead_along_path(&(end - begin), lead_mm);
        self.move_to(begin, MoveKind::Rapid, PathMode::ExactPath)?;
        self.thread_to(end, pitch_mm, degrees, start[0])?;
        self.move_to(point(start[0], z), MoveKind::Rapid, PathMode::ExactPath)?;
        self.move_to(start, MoveKind::Rapid, PathMode::ExactPath)?;
        self.state.fanuc_thread.cycle = Some((z, taper));
        Ok(())
    }

    /// F, or that of the previous thread.
    fn fanuc_lead(&mut self, name: &str) -> Result<f64, Fault> {
        let before = self.state.fanuc_thread.lead_mm;
        let lead_mm = match before {
            Some(lead_mm) if !self.line.has(b'F') => lead_mm,
            _ => self.pitch(name, b'F')?,
        };
        self.state.fanuc_thread.lead_mm = Some(lead_mm);
        Ok(lead_mm)
    }

    /// Q, in thousandths of a degree, converted to degrees.
    fn fanuc_angle(&self, name: &str) -> Result<f64, Fault> {
        let angle = self.line.word(b'Q').unwrap_or(0.0);
        if (0.0..360_000.0).contains(&angle) {
            return Ok(1e-3 * angle);
        }
        let message = format!(
            "{name}: Q{angle} is the angle at which the thread begins, 0 to 360000 thousandths of a degree"
        );
        Err(Fault::new(Code::OutOfRange, self.line.span(b'Q'), message))
    }
}
