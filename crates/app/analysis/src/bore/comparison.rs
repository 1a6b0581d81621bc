//! The geometry of the blocks, and a comparison of the involute with other paths.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use evolvent_path::{
    Archimedean, Curve, HoleBlock, HolePass, Role, half_circle_radii_mm, half_circles_length_mm,
    helix_length_mm,
};
use evolvent_runtime::{Controls, Job, Setup};
use serde_json::{Value, json};

use crate::error::AnalysisError;
use crate::load_setup::load_setup;
use crate::scratch::Folder;
use crate::unobserved::Unobserved;

/// Maximum deviation of the polyline from the Archimedean spiral, mm.
const POLYLINE_MM: f64 = 0.001;
/// Maximum number of turns of a helix that is planned.
const MAX_HELIX_TURNS: f64 = 2000.0;
/// Blending tolerance of every path of the comparison, mm, if the request has none.
const BLEND_MM: f64 = 0.01;

/// The six numbers of a block (12), (13), and the values derived from them.
pub(crate) fn block_json(block: &HoleBlock) -> Value {
    let figures = &block.figures;
    let involute = matches!(block.curve, Curve::Involute(_));
    let kind = if involute { "involute" } else { "circle" };
    let end = block.curve.end();
    let end_roll = involute.then(|| figures.end_radius_mm / block.radius_mm);
    json!({
        "role": match block.role {
            Role::Rough => "rough",
            Role::RoughCircle => "rough_circle",
            Role::Approach => "approach",
            Role::FinishCircle => "finish_circle",
            Role::Departure => "departure",
        },
        "kind": kind,
        "length_mm": figures.length_mm,
        "start_mm": figures.start_mm,
        "end_machine_mm": [end[0], end[1]],
        "psi_rad": figures.turn_rad,
        "phi0_rad": involute.then_some(figures.start_roll_rad),
        "phi_end_rad": end_roll,
        "r_n_mm": figures.start_radius_mm,
        "r_k_mm": figures.end_radius_mm,
        "base_radius_mm": involute.then_some(block.radius_mm),
        "centre_mm": block.centre_mm,
    })
}

/// A pass at one depth.
pub(crate) fn pass_json(title: &str, z_mm: f64, feed_mm_min: f64, pass: &HolePass) -> Value {
    json!({
        "pass": title,
        "z_mm": z_mm,
        "feed_mm_min": feed_mm_min,
        "radius_mm": pass.radius_mm,
        "turns": pass.turns,
        "visible_turns": pass.visible_turns(),
        "pitch_mm": pass.pitch_mm,
        "base_radius_mm": pass.base_radius_mm,
        "length_mm": pass.length_mm(),
        "time_at_feed_s": 60.0 * pass.length_mm() / feed_mm_min,
        "blocks": pass.blocks.iter().map(block_json).collect::<Vec<_>>(),
    })
}

/// The first pass of a hole compared with other paths that clear it.
#[derive(Debug, Default)]
pub struct BoreComparison {
    feed_mm_min: f64,
    list: Vec<Alternative>,
}

/// A path that clears the hole at one depth.
#[derive(Debug)]
struct Alternative {
    name: &'static str,
    length_mm: Option<f64>,
    /// A limitation or drawback of the path.
    remark: String,
    /// Duration under the machine's limits, s.
    time_s: Option<f64>,
    program: Option<String>,
}

/// Input of the comparison.
pub(crate) struct Comparison<'a> {
    pub(crate) pass: &'a HolePass,
    pub(crate) centre_mm: [f64; 2],
    pub(crate) top_mm: f64,
    pub(crate) hole_mm: f64,
    pub(crate) tool_mm: f64,
    pub(crate) depth_mm: f64,
    pub(crate) feed_mm_min: f64,
    pub(crate) tolerance_mm: Option<f64>,
}

impl Comparison<'_> {
    /// Compares the involute with three other paths from the same start to the same circle, each with a full
    /// circle at the end. With a machine, the duration of each path is planned under its limits.
    ///
    /// # Errors
    /// An invalid machine file, or a path that the machine cannot follow.
    pub(crate) fn alternatives(&self, machine: Option<&Path>) -> Result<BoreComparison, AnalysisError> {
        let pass = self.pass;
        let (radius, turns) = (pass.radius_mm, pass.turns);
        let round = std::f64::consts::TAU * radius;
        let start = pass
            .blocks
            .first()
            .map_or([0.0; 2], |block| block.figures.start_mm);
        let from_mm = f64::hypot(start[0], start[1]);
        let involute: Vec<_> = pass.blocks.iter().map(|block| self.line(block)).collect();
        let spiral = Archimedean {
            pitch_mm: pass.pitch_mm,
            from_mm,
            to_mm: radius,
        };
        let angle = pass.pitch_mm.atan2(round).to_degrees();
        let centred = from_mm < 1e-9;
        let largest = radius / f64::from(turns) * 0.5;
        let mut list = vec![
            Alternative {
                name: "involute",
                length_mm: Some(pass.length_mm()),
                remark: "joins the circle with its tangent and curvature".to_owned(),
                time_s: None,
                program: self
                    .first_point(pass)
                    .map(|at| self.text(at, &involute.join("\n"))),
            },
            Alternative {
                name: "half circles",
                length_mm: centred.then(|| half_circles_length_mm(radius, turns) + round),
                remark: if centred {
                    format!(
                        "curvature steps {} times, by at most 1/{largest:.3} mm",
                        2 * turns
                    )
                } else {
                    "start in the centre only".to_owned()
                },
                time_s: None,
                program: centred.then(|| self.half_circles(radius, turns)),
            },
            Alternative {
                name: "Archimedean spiral",
                length_mm: Some(spiral.length_mm() + round),
                remark: format!("meets the circle at an angle of {angle:.3} degrees"),
                time_s: None,
                program: Some(self.archimedean(&spiral, radius)),
            },
            self.helix(radius),
        ];
        if let Some(file) = machine {
            let setup = load_setup(file, None)?;
            for path in &mut list {
                if let Some(program) = &path.program {
                    path.time_s = Some(planned_s(&setup, path.name, program)?);
                }
            }
        }
        Ok(BoreComparison {
            feed_mm_min: self.feed_mm_min,
            list,
        })
    }

    /// A helix clears a hole in one pass if the tool covers the centre; its turns lead down, not outwards.
    fn helix(&self, radius: f64) -> Alternative {
        let covers = self.tool_mm >= 0.5 * self.hole_mm;
        let fits = covers && self.depth_mm > 0.0;
        let pitch = self.pass.pitch_mm;
        let turns = (self.depth_mm / pitch - 1e-9).ceil().max(1.0);
        let round = std::f64::consts::TAU * radius;
        let is_short = turns <= MAX_HELIX_TURNS;
        let program = (fits && is_short).then(|| {
            let [x, y] = self.translated([radius, 0.0]);
            let mut text = String::new();
            for turn in 1..=turns as u64 {
                let z = self.top_mm - self.depth_mm * turn as f64 / turns;
                // Writing to a string cannot fail.
                let _ = writeln!(text, "G3 X{x} Y{y} I{} J0 Z{z:.6}", -radius);
            }
            let _ = write!(text, "G3 X{x} Y{y} I{} J0", -radius);
            let from = format!("X{x} Y{y} Z{:.6}", self.top_mm);
            self.program(&from, &text)
        });
        Alternative {
            name: "helix",
            length_mm: fits.then(|| helix_length_mm(radius, self.depth_mm, pitch) + round),
            remark: if !covers {
                format!(
                    "needs a tool of at least {:.3} mm: this one leaves a core",
                    0.5 * self.hole_mm
                )
            } else if fits && !is_short {
                format!("{turns} turns of the pitch: too many to be planned")
            } else if fits {
                format!("{turns} turns of the pitch down the whole depth")
            } else {
                "needs a depth".to_owned()
            },
            time_s: None,
            program,
        }
    }

    /// A point around the hole's centre, in machine coordinates.
    fn translated(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x + self.centre_mm[0], y + self.centre_mm[1]]
    }

    fn first_point(&self, pass: &HolePass) -> Option<[f64; 2]> {
        let start = pass.blocks.first()?.curve.start();
        Some([start[0], start[1]])
    }

    fn line(&self, block: &HoleBlock) -> String {
        super::line(block, self.feed_mm_min)
    }

    fn half_circles(&self, radius: f64, turns: u32) -> String {
        let mut text = String::new();
        let mut x = 0.0;
        for (k, half) in half_circle_radii_mm(radius, turns).into_iter().enumerate() {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            // Writing to a string cannot fail.
            let to = x + sign * 2.0 * half;
            let [to_x, to_y] = self.translated([to, 0.0]);
            let _ = writeln!(text, "G3 X{to_x:.9} Y{to_y:.9} I{:.9} J0", sign * half);
            x = to;
        }
        let sign = if x > 0.0 { -1.0 } else { 1.0 };
        let [to_x, to_y] = self.translated([x, 0.0]);
        let _ = write!(text, "G3 X{to_x:.9} Y{to_y:.9} I{:.9} J0", sign * radius);
        self.text(self.translated([0.0, 0.0]), &text)
    }

    fn archimedean(&self, spiral: &Archimedean, radius: f64) -> String {
        let mut text = String::new();
        let angles = spiral.polyline_rad(POLYLINE_MM);
        for angle in angles.iter().skip(1) {
            let [x, y] = self.translated(spiral.at(*angle));
            // Writing to a string cannot fail.
            let _ = writeln!(text, "G1 X{x:.6} Y{y:.6}");
        }
        let end = angles.last().map_or([radius, 0.0], |angle| spiral.at(*angle));
        let [x, y] = self.translated(end);
        let _ = write!(text, "G3 X{x:.6} Y{y:.6} I{:.6} J{:.6}", -end[0], -end[1]);
        let from = angles.first().map_or([0.0; 2], |angle| spiral.at(*angle));
        self.text(self.translated(from), &text)
    }

    /// The machine is already at the start, so only the path itself is timed. All paths are at the position
    /// of the hole.
    fn text(&self, [x, y]: [f64; 2], path: &str) -> String {
        self.program(&format!("X{x} Y{y}"), path)
    }

    /// Like [`Self::text`], with the words of the start.
    fn program(&self, from: &str, path: &str) -> String {
        let tolerance = self.tolerance_mm.unwrap_or(BLEND_MM);
        let feed_mm_min = self.feed_mm_min;
        format!("G8 G17 G21 G40 G49 G90 G94 G64 P{tolerance}\nG0 {from}\nG4 P0\nF{feed_mm_min}\n{path}\nM2\n")
    }
}

/// Duration of a path under the limits of a machine, s, without the approach to its start.
fn planned_s(setup: &Setup, name: &str, text: &str) -> Result<f64, AnalysisError> {
    let failed = |error: &dyn std::fmt::Display| AnalysisError::Failed(format!("{name}: {error}"));
    let folder = Folder::new("evolvent-bore").map_err(|error| failed(&error))?;
    let program = folder.path().join("path.ngc");
    std::fs::write(&program, text).map_err(|error| failed(&error))?;
    let job = Job::new(program, setup.clone());
    // The path begins after the dwell, in line 4.
    let mut cycles = 0_u64;
    let outcome = evolvent_runtime::run(&job, &Arc::new(Controls::new(1.0)), &mut Unobserved, |setpoint| {
        cycles += u64::from(setpoint.line > 3);
    })
    .map_err(|error| failed(&error))?;
    outcome.program.map_err(|error| failed(&error))?;
    if let Some(fault) = outcome.fault {
        return Err(failed(&fault));
    }
    Ok(cycles as f64 * setup.period_ns as f64 * 1e-9)
}

impl BoreComparison {
    /// As a table.
    #[must_use]
    pub fn text(&self) -> String {
        let feed_mm_min = self.feed_mm_min;
        let mut text = String::from("  path                  length mm   at feed s   planned s   \n");
        let cell = |value: Option<f64>, digits: usize| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
        };
        for path in &self.list {
            let at_feed = path.length_mm.map(|length| 60.0 * length / feed_mm_min);
            // Writing to a string cannot fail.
            let _ = writeln!(
                text,
                "  {:<20}{:>11}{:>12}{:>12}   {}",
                path.name,
                cell(path.length_mm, 3),
                cell(at_feed, 3),
                cell(path.time_s, 3),
                path.remark
            );
        }
        text
    }

    /// As a list of objects.
    pub(super) fn json(&self) -> Value {
        let feed_mm_min = self.feed_mm_min;
        self.list
            .iter()
            .map(|path| {
                json!({
                    "path": path.name,
                    "length_mm": path.length_mm,
                    "time_at_feed_s": path.length_mm.map(|length| 60.0 * length / feed_mm_min),
                    "planned_s": path.time_s,
                    "remark": path.remark,
                })
            })
            .collect()
    }
}
