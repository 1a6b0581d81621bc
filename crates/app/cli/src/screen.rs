//! Progress during a run, and the summary at its end.

use std::io::{self, BufRead, IsTerminal, Write};
use std::path::Path;

use evolvent_runtime::{Controls, Notice, RunObserver, Summary};
use indicatif::{ProgressBar, ProgressStyle};

/// Progress on standard error, on a terminal only; messages of the program in any case.
pub(crate) struct Screen {
    bar: Option<ProgressBar>,
    lines: u64,
    /// Whether someone can confirm program stops.
    asks: bool,
    /// The last program stop that was reported, as the number of stops passed by then.
    prompted: Option<u32>,
}

impl Screen {
    /// For a program whose lines are counted first. `asks`: an operator at the terminal confirms program
    /// stops.
    pub(crate) fn new(program: &Path, quiet: bool, asks: bool) -> Self {
        let terminal = !quiet && io::stderr().is_terminal();
        let lines = if terminal { count_lines(program) } else { 0 };
        let bar = terminal.then(|| {
            let bar = ProgressBar::new(lines.max(1));
            let style = ProgressStyle::with_template("{bar:32} line {pos}/{len}  {msg}");
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar
        });
        Self {
            bar,
            lines,
            asks,
            prompted: None,
        }
    }

    /// Removes the progress bar.
    pub(crate) fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }

    fn say(&self, text: &str) {
        match &self.bar {
            // The bar is hidden if the terminal cannot move its cursor (TERM is dumb or not set), and then
            // prints nothing.
            Some(bar) if !bar.is_hidden() => bar.println(text),
            // If standard error is closed, nobody is left to inform.
            _ => drop(writeln!(io::stderr(), "{text}")),
        }
    }
}

impl RunObserver for Screen {
    fn progress(&mut self, controls: &Controls) {
        let progress = controls.progress();
        if let Some(bar) = &self.bar {
            bar.set_position(u64::from(progress.line).min(self.lines));
            bar.set_message(format!(
                "{:.1} mm  {:.0} mm/min  {} setpoints",
                progress.path_mm,
                60.0 * progress.feed_mm_s,
                progress.cycles
            ));
        }
        if self.asks && progress.at_program_stop && self.prompted != Some(progress.resumes) {
            self.prompted = Some(progress.resumes);
            self.say(&format!(
                "program stop at line {}: press Enter to continue",
                progress.line
            ));
        }
    }

    fn notice(&mut self, notice: &Notice) {
        if notice.is_message {
            self.say(&format!("line {}: {}", notice.line, notice.text));
        }
    }

    fn note(&mut self, text: &str) {
        self.say(&format!("note: {text}"));
    }
}

fn count_lines(program: &Path) -> u64 {
    let Ok(file) = evolvent_config::open_regular(program) else {
        return 0;
    };
    let mut reader = io::BufReader::with_capacity(1 << 20, file);
    let mut lines = 0;
    loop {
        let Ok(chunk) = reader.fill_buf() else {
            return lines;
        };
        if chunk.is_empty() {
            return lines;
        }
        lines += chunk.iter().filter(|byte| **byte == b'\n').count() as u64;
        let length = chunk.len();
        reader.consume(length);
    }
}

/// The summary as text.
pub(crate) fn write_summary(out: &mut dyn Write, summary: &Summary) -> io::Result<()> {
    writeln!(
        out,
        "{} on {}: {}",
        summary.program, summary.machine, summary.outcome
    )?;
    writeln!(
        out,
        "  {:.3} s at {:.2} Hz ({} ns), {} setpoints, {} moves, {:.3} mm of path",
        summary.duration_s,
        summary.rate_hz,
        summary.period_ns,
        summary.cycles,
        summary.moves,
        summary.path_length_mm
    )?;
    writeln!(out)?;
    writeln!(
        out,
        "  axis      end position     velocity, of limit      acceleration, of limit          jerk, of limit"
    )?;
    for (axis, position) in summary.per_axis.iter().zip(&summary.end_position) {
        let (length, rotary) = if "ABC".contains(axis.axis) {
            ("deg", true)
        } else {
            ("mm ", false)
        };
        let mark = if rotary { "deg" } else { "mm" };
        writeln!(
            out,
            "  {}     {:>12.6} {length} {:>10.2} {mark}/s {:>5.1} % {:>13.1} {mark}/s2 {:>5.1} % {:>13.0} \
             {mark}/s3 {:>5.1} %",
            axis.axis,
            position,
            axis.max_velocity_mm_s,
            100.0 * axis.velocity_ratio,
            axis.max_acceleration_mm_s2,
            100.0 * axis.acceleration_ratio,
            axis.max_jerk_mm_s3,
            100.0 * axis.jerk_ratio,
        )?;
    }
    writeln!(out)?;
    writeln!(
        out,
        "  chord error {:.3} um of {:.3} um permitted; distance to the programmed path {:.3} um",
        1000.0 * summary.max_chord_error_mm,
        1000.0 * summary.permitted_chord_error_mm,
        1000.0 * summary.max_path_error_mm
    )?;
    if summary
        .per_axis
        .iter()
        .any(|axis| axis.max_jerk_at_joints_mm_s3 > 0.0)
    {
        writeln!(
            out,
            "  at steps of curvature in exact-path mode jerk is bounded by the joint time only \
             (path.joint_time_ms)"
        )?;
    }
    if let Some(turning) = &summary.turning {
        let peak = turning.peak_true_load.unwrap_or(turning.peak_load);
        writeln!(
            out,
            "  load-adaptive turning cycles: {} of {} at size, {} passes, backed off {} times, {:.1} s; \
             maximum load {peak:.0} ({:.3} of the set load)",
            turning.done,
            turning.cycles,
            turning.passes,
            turning.back_offs,
            turning.time_s,
            peak / turning.set_load
        )?;
    }
    writeln!(
        out,
        "  late setpoints {}, lost records {}, lost setpoints {}, starved cycles {}",
        summary.late_cycles, summary.dropped_records, summary.dropped_setpoints, summary.starved_cycles
    )?;
    if let (Some(wake), Some(work)) = (&summary.wake_lateness, &summary.work) {
        let us = |ns: i64| ns as f64 / 1000.0;
        writeln!(
            out,
            "  wake-up lateness p50 {:.1}, p99.9 {:.1}, max {:.1} us; own work p50 {:.1}, p99.9 {:.1}, max \
             {:.1} us",
            us(wake.p50_ns),
            us(wake.p999_ns),
            us(wake.max_ns),
            us(work.p50_ns),
            us(work.p999_ns),
            us(work.max_ns)
        )?;
    }
    if let Some(trace) = &summary.trace {
        writeln!(out, "  trace {trace}")?;
    }
    Ok(())
}
