//! Part programs that mill a hole along involutes.
//!
//! With a clockwise spindle (M3), climb milling of a hole runs counter-clockwise (G3, G3.2) and conventional
//! milling clockwise (G2, G2.2). All coordinates are those of the tool centre; cutter compensation is not
//! used.

mod comparison;

use std::fmt::{self, Write as _};
use std::path::Path;

use evolvent_config::{ProgramNumber, plain};
use evolvent_gcode::ArcTolerance;
use evolvent_path::{
    Axes, Curve, Hole, HoleBlock, HoleError, HolePass, HoleStart, Milling, Plane, Role, Sense, depths_mm,
};
use serde_json::{Value, json};

pub use comparison::BoreComparison;

use crate::error::AnalysisError;
use comparison::{Comparison, pass_json};

/// Clearance above the material at which the rapid downward move ends, mm.
const CLEARANCE_MM: f64 = 1.0;
/// Rounding of a computed distance from the hole's centre, mm.
const ROUNDING_MM: f64 = 1e-9;

/// A hole and how to mill it.
#[derive(Clone, Debug)]
pub struct BoreRequest {
    /// Diameter of the hole, mm.
    pub hole_mm: f64,
    /// Diameter of the tool, mm.
    pub tool_mm: f64,
    /// Climb or conventional milling, with M3.
    pub milling: Milling,
    /// X and Y of the hole's centre, mm.
    pub centre_mm: [f64; 2],
    /// Z of the hole's top, mm.
    pub top_mm: f64,
    /// Depth below the top, mm; 0 makes one pass at the top, as a trial.
    pub depth_mm: f64,
    /// Maximum depth per pass, mm; `None` mills the whole depth at once.
    pub step_mm: Option<f64>,
    /// Height of rapid moves above the top, mm.
    pub safe_mm: f64,
    /// Roughing; `None` if the hole is already roughed.
    pub roughing: Option<BoreRoughing>,
    /// Finishing of the wall; `None` omits it.
    pub finishing: Option<BoreFinishing>,
    /// Feed of the tool centre, mm/min.
    pub feed_mm_min: f64,
    /// Feed of finishing, mm/min; `None` uses the same feed.
    pub finish_feed_mm_min: Option<f64>,
    /// Plunge feed, mm/min.
    pub plunge_feed_mm_min: f64,
    /// Spindle speed, rev/min.
    pub spindle_rpm: f64,
    /// Tool number for T and M6; `None` omits the tool change.
    pub tool_number: Option<u32>,
    /// Blending tolerance (G64 P), mm; `None` selects the exact path (G61).
    pub tolerance_mm: Option<f64>,
}

/// Roughing outwards along an involute, followed by a full circle.
#[derive(Clone, Copy, Debug)]
pub struct BoreRoughing {
    /// Maximum radial pitch of the involute, mm per turn.
    pub pitch_mm: f64,
    /// Turns of the whole involute, at least as many as the pitch requires; `None` derives them from the
    /// pitch.
    pub turns: Option<u32>,
    /// Allowance left on the wall, mm.
    pub allowance_mm: f64,
    /// Where the involute starts.
    pub start: HoleStart,
}

/// Finishing of a wall: involute approach, full circle, mirrored departure.
#[derive(Clone, Copy, Debug)]
pub struct BoreFinishing {
    /// Turns of the whole involute, usually 1 or 2.
    pub turns: u32,
    /// Where the approach starts; `None` starts about half way out, in the area that roughing has cleared.
    pub start: Option<HoleStart>,
}

/// Why no program could be made.
#[derive(Debug, thiserror::Error)]
pub enum BoreError {
    /// The hole cannot be milled as requested.
    #[error("{0}")]
    Hole(#[from] HoleError),
    /// Turns of roughing whose pitch is above the maximum.
    #[error(
        "rough-turns {turns} gives a pitch of {pitch_mm} mm per turn, above the maximum of {max_mm} mm: \
         give at least {min_turns} turns, or a larger --pitch"
    )]
    FewTurns {
        /// The turns given.
        turns: u32,
        /// Their pitch, mm per turn.
        pitch_mm: f64,
        /// The maximum given, mm per turn.
        max_mm: f64,
        /// Minimum number of turns that keep the maximum.
        min_turns: f64,
    },
    /// The tool's centre would move on a circle below the minimum radius of an arc.
    #[error(
        "the tool's centre would move on a circle of {radius_mm:.6} mm in {pass}, and a program's arcs have \
         at least {min_mm} mm: use a smaller tool{}",
        if *.pass == "roughing" { ", or a smaller --allowance" } else { "" }
    )]
    Circle {
        /// The pass.
        pass: &'static str,
        /// Radius of its last circle, mm.
        radius_mm: f64,
        /// The minimum radius of an arc, mm.
        min_mm: f64,
    },
    /// An allowance wider than the tool: finishing would cut a groove along the wall and leave a ring inside
    /// it.
    #[error(
        "allowance {allowance_mm} is wider than the tool of {tool_mm} mm: finishing would leave a ring of \
         {:.3} mm; give at most {tool_mm}, or use a larger tool",
        .allowance_mm - .tool_mm
    )]
    Ring {
        /// The allowance of roughing, mm.
        allowance_mm: f64,
        /// Diameter of the tool, mm.
        tool_mm: f64,
    },
    /// The tool would move down into material at the start of finishing.
    #[error(
        "{option}: finishing would start {distance_mm:.3} mm from the hole's centre and move down into \
         material: roughing with an allowance of {allowance_mm} mm has cleared space for the tool {}; start \
         there{}",
        range(*.cleared_mm),
        if *.distance_mm > .cleared_mm[1] {
            ", or give a smaller --allowance"
        } else {
            ", or rough first and finish with --finish-only where a drilled hole has the space"
        }
    )]
    FinishStart {
        /// The option that gives the start: `start`, `start-radius` or `start-length`.
        option: &'static str,
        /// Distance of the start from the hole's centre, mm.
        distance_mm: f64,
        /// Distances at which roughing has cleared enough space for the tool, mm.
        cleared_mm: [f64; 2],
        /// The allowance of roughing, mm.
        allowance_mm: f64,
    },
    /// A number that is not positive and finite.
    #[error("{name} {} is impossible: give a positive, finite number", plain(*.value))]
    Number {
        /// Name of the number: `feed`, `finish-feed`, `plunge-feed`, `spindle`, `safe`, `tolerance` or `top`.
        name: &'static str,
        /// The value given.
        value: f64,
    },
}

/// One pass at one depth.
struct Level {
    pass: HolePass,
    z: f64,
    /// Z at which the rapid downward move ends.
    clear_z: f64,
    feed: f64,
    title: &'static str,
}

/// The passes of a hole at all its depths.
pub struct BoreProgram {
    request: BoreRequest,
    levels: Vec<Level>,
}

impl BoreRequest {
    fn check_numbers(&self) -> Result<(), BoreError> {
        let positive = [
            ("feed", Some(self.feed_mm_min)),
            ("finish-feed", self.finish_feed_mm_min),
            ("plunge-feed", Some(self.plunge_feed_mm_min)),
            ("spindle", Some(self.spindle_rpm)),
            ("safe", Some(self.safe_mm)),
            ("tolerance", self.tolerance_mm),
        ];
        for (name, value) in positive {
            if let Some(value) = value
                && !(value > 0.0 && value.is_finite())
            {
                return Err(BoreError::Number { name, value });
            }
        }
        if !self.top_mm.is_finite() {
            return Err(BoreError::Number {
                name: "top",
                value: self.top_mm,
            });
        }
        Ok(())
    }

    /// Z of each pass, from above.
    fn depths_mm(&self) -> Result<Vec<f64>, BoreError> {
        let (top, depth) = (self.top_mm, self.depth_mm);
        if depth == 0.0 && self.step_mm.is_none() {
            return Ok(vec![top]);
        }
        Ok(depths_mm(top, top - depth, self.step_mm.unwrap_or(depth))?)
    }

    /// Z of rapid moves.
    fn safe_z(&self) -> f64 {
        self.top_mm + self.safe_mm
    }

    /// Z at which a rapid downward move to material at `z` ends.
    fn clear_z(&self, z: f64) -> f64 {
        (z + CLEARANCE_MM).min(self.safe_z())
    }

    fn rough(&self, hole: &Hole, depths: &[f64], roughing: &BoreRoughing) -> Result<Vec<Level>, BoreError> {
        let mut levels = Vec::new();
        let mut above = self.top_mm;
        for &z in depths {
            let pass = hole.rough(
                roughing.pitch_mm,
                roughing.turns,
                roughing.allowance_mm,
                roughing.start,
                &resting(z),
            )?;
            // As in the planning of the pass: rounding must not add a turn.
            let min_turns = (pass.radius_mm / roughing.pitch_mm - 1e-9).ceil().max(1.0);
            if f64::from(pass.turns) < min_turns {
                return Err(BoreError::FewTurns {
                    turns: pass.turns,
                    pitch_mm: pass.pitch_mm,
                    max_mm: roughing.pitch_mm,
                    min_turns,
                });
            }
            levels.push(Level {
                pass,
                z,
                clear_z: self.clear_z(above),
                feed: self.feed_mm_min,
                title: "roughing",
            });
            above = z;
        }
        Ok(levels)
    }

    /// `cleared_mm`: distances at which roughing has cleared enough space for the tool.
    fn finish(
        &self,
        hole: &Hole,
        depths: &[f64],
        finishing: &BoreFinishing,
        cleared_mm: Option<[f64; 2]>,
    ) -> Result<Vec<Level>, BoreError> {
        let start = finishing_start(hole, self, finishing, cleared_mm)?;
        // Roughing has opened the hole down to the bottom. Of a hole roughed elsewhere only the top is known.
        let is_open = cleared_mm.is_some();
        let mut levels = Vec::new();
        for &z in depths {
            levels.push(Level {
                pass: hole.finish(finishing.turns, 0.0, start, &resting(z))?,
                z,
                clear_z: self.clear_z(if is_open { z } else { self.top_mm }),
                feed: self.finish_feed_mm_min.unwrap_or(self.feed_mm_min),
                title: "finishing",
            });
        }
        Ok(levels)
    }
}

impl BoreProgram {
    /// Computes the passes.
    ///
    /// # Errors
    /// An impossible request, with the numbers that make it so.
    pub fn new(request: BoreRequest) -> Result<Self, BoreError> {
        request.check_numbers()?;
        let hole = Hole {
            plane: Plane::Xy,
            centre_mm: request.centre_mm,
            diameter_mm: request.hole_mm,
            tool_diameter_mm: request.tool_mm,
            milling: request.milling,
        };
        let depths = request.depths_mm()?;
        let mut levels = match &request.roughing {
            Some(roughing) => request.rough(&hole, &depths, roughing)?,
            None => Vec::new(),
        };
        if let Some(finishing) = &request.finishing {
            let cleared_mm = levels.last().map(|level| level.pass.cleared_mm(request.tool_mm));
            levels.extend(request.finish(&hole, &depths, finishing, cleared_mm)?);
        }
        // The rounding of the coordinates must not make the radius smaller than what was compared.
        let min_mm = ArcTolerance::default().radius_mm;
        if let Some(small) = levels
            .iter()
            .find(|level| level.pass.radius_mm < min_mm + ROUNDING_MM)
        {
            return Err(BoreError::Circle {
                pass: small.title,
                radius_mm: small.pass.radius_mm,
                min_mm,
            });
        }
        Ok(Self { request, levels })
    }

    /// The blocks of all passes in order.
    pub fn blocks(&self) -> impl Iterator<Item = &HoleBlock> {
        self.levels.iter().flat_map(|level| &level.pass.blocks)
    }

    /// Compares the first pass with half circles, an Archimedean spiral and a helix. With a machine file, the
    /// duration of each path is planned under the machine's limits.
    ///
    /// # Errors
    /// An invalid machine file, or a path that the machine cannot follow.
    pub fn compare(&self, machine: Option<&Path>) -> Result<BoreComparison, AnalysisError> {
        let Some(first) = self.levels.first() else {
            return Ok(BoreComparison::default());
        };
        let request = &self.request;
        let comparison = Comparison {
            pass: &first.pass,
            centre_mm: request.centre_mm,
            top_mm: request.top_mm,
            hole_mm: request.hole_mm,
            tool_mm: request.tool_mm,
            depth_mm: request.depth_mm,
            feed_mm_min: first.feed,
            tolerance_mm: request.tolerance_mm,
        };
        comparison.alternatives(machine)
    }

    /// The geometry of every block (phi0, psi, radii of curvature, length) and the comparison as a JSON
    /// object.
    #[must_use]
    pub fn json(&self, comparison: Option<&BoreComparison>) -> Value {
        let request = &self.request;
        let passes: Vec<_> = self
            .levels
            .iter()
            .map(|level| pass_json(level.title, level.z, level.feed, &level.pass))
            .collect();
        json!({
            "hole_mm": request.hole_mm,
            "tool_mm": request.tool_mm,
            "centre_mm": request.centre_mm,
            "milling": if request.milling == Milling::Conventional { "conventional" } else { "climb" },
            "length_mm": self.levels.iter().map(|level| level.pass.length_mm()).sum::<f64>(),
            "passes": passes,
            "comparison": comparison.map(BoreComparison::json),
        })
    }

    /// The part program.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut text);
        text
    }

    fn write(&self, out: &mut String) -> fmt::Result {
        self.header(out)?;
        let request = &self.request;
        // G8: a machine file may have programs start with diameters.
        writeln!(out, "G8 G17 G21 G40 G49 G90 G94")?;
        match request.tolerance_mm {
            Some(tolerance) => writeln!(out, "G64 P{}", word(tolerance))?,
            None => writeln!(out, "G61")?,
        }
        if let Some(number) = request.tool_number {
            writeln!(out, "T{number} M6")?;
        }
        writeln!(out, "S{} M3", word(request.spindle_rpm))?;
        writeln!(out, "G0 Z{}", coordinate(self.request.safe_z()))?;
        for level in &self.levels {
            self.level(level, out)?;
        }
        writeln!(out, "\nM5\nM30")
    }

    fn header(&self, out: &mut String) -> fmt::Result {
        let request = &self.request;
        let sense = if request.milling == Milling::Conventional {
            "conventional, clockwise"
        } else {
            "climb, counter-clockwise"
        };
        writeln!(
            out,
            "(hole of {} mm, tool of {} mm, {sense} with M3)",
            request.hole_mm, request.tool_mm
        )?;
        let [x, y] = request.centre_mm;
        writeln!(
            out,
            "(centre X{} Y{}, top Z{}, path of the tool centre, mm)",
            word(x),
            word(y),
            word(request.top_mm)
        )?;
        let mut last = "";
        let mut total = 0.0;
        for level in &self.levels {
            let pass = &level.pass;
            total += pass.length_mm();
            if level.title == last {
                continue;
            }
            last = level.title;
            writeln!(
                out,
                "({}: R {} mm, n {} turns, H {:.6} mm per turn, r {:.9} mm, {:.3} turns visible, {:.6} mm \
                 long at each depth)",
                level.title,
                pass.radius_mm,
                pass.turns,
                pass.pitch_mm,
                pass.base_radius_mm,
                pass.visible_turns(),
                pass.length_mm()
            )?;
        }
        let depths = self.levels.iter().filter(|level| level.title == last).count();
        writeln!(out, "(depths: {depths}, cutting path in all {total:.3} mm)")?;
        writeln!(
            out,
            "(G2.2 and G3.2: involute, I J to the centre of its base circle, R its radius)"
        )
    }

    fn level(&self, level: &Level, out: &mut String) -> fmt::Result {
        let Some(first) = level.pass.blocks.first() else {
            return Ok(());
        };
        let start = first.curve.start();
        writeln!(out, "\n({} at Z{})", level.title, coordinate(level.z))?;
        writeln!(out, "G0 X{} Y{}", coordinate(start[0]), coordinate(start[1]))?;
        writeln!(out, "G0 Z{}", coordinate(level.clear_z))?;
        writeln!(
            out,
            "G1 Z{} F{}",
            coordinate(level.z),
            word(self.request.plunge_feed_mm_min)
        )?;
        for block in &level.pass.blocks {
            writeln!(out, "({}, {:.6} mm)", title(block.role), block.figures.length_mm)?;
            writeln!(out, "{}", line(block, level.feed))?;
        }
        writeln!(out, "G0 Z{}", coordinate(self.request.safe_z()))
    }
}

/// Where finishing starts, so that the tool moves down in what roughing has cut.
fn finishing_start(
    hole: &Hole,
    request: &BoreRequest,
    finishing: &BoreFinishing,
    cleared_mm: Option<[f64; 2]>,
) -> Result<HoleStart, BoreError> {
    // Half way out: clear of the wall, with more than a quarter turn for the cutting force to build up.
    let half_way = HoleStart::CurvatureRadius(0.5 * hole.path_radius_mm(0.0)?);
    let start = finishing.start.unwrap_or(half_way);
    let (Some(roughing), Some(cleared_mm)) = (&request.roughing, cleared_mm) else {
        return Ok(start);
    };
    if roughing.allowance_mm > request.tool_mm {
        return Err(BoreError::Ring {
            allowance_mm: roughing.allowance_mm,
            tool_mm: request.tool_mm,
        });
    }
    let distance_mm = |start: HoleStart| -> Result<f64, BoreError> {
        let pass = hole.finish(finishing.turns, 0.0, start, &Axes::zeros())?;
        let start = pass.blocks.first().map(|block| block.figures.start_mm);
        Ok(start.map_or(0.0, |[x, y]| x.hypot(y)))
    };
    let found_mm = distance_mm(start)?;
    let is_cleared = found_mm >= cleared_mm[0] - ROUNDING_MM && found_mm <= cleared_mm[1] + ROUNDING_MM;
    // The tool has been at the start of roughing, whatever is left around it.
    if is_cleared || start == roughing.start {
        return Ok(start);
    }
    let option = match finishing.start {
        None if cleared_mm[0] == 0.0 => return Ok(HoleStart::Point([0.5 * cleared_mm[1], 0.0])),
        None => return Ok(roughing.start),
        Some(HoleStart::CurvatureRadius(_)) => "start-radius",
        Some(HoleStart::Length(_)) => "start-length",
        Some(_) => "start",
    };
    Err(BoreError::FinishStart {
        option,
        distance_mm: found_mm,
        cleared_mm,
        allowance_mm: roughing.allowance_mm,
    })
}

/// A range of permitted distances, rounded inwards to micrometres.
fn range([low, high]: [f64; 2]) -> String {
    let (low, high) = ((1e3 * low).ceil() * 1e-3, (1e3 * high).floor() * 1e-3);
    if low < high {
        format!("from {low:.3} to {high:.3} mm from the centre")
    } else {
        "only at its own start".to_owned()
    }
}

fn resting(z: f64) -> Axes {
    let mut axes = Axes::zeros();
    axes[2] = z;
    axes
}

fn title(role: Role) -> &'static str {
    match role {
        Role::Rough => "out along the involute",
        Role::RoughCircle => "once round",
        Role::Approach => "approach",
        Role::FinishCircle => "once round on the wall",
        Role::Departure => "departure",
    }
}

/// One block as a program line.
fn line(block: &HoleBlock, feed: f64) -> String {
    let (start, end) = (block.curve.start(), block.curve.end());
    let involute = matches!(block.curve, Curve::Involute(_));
    let code = match (block.curve.sense(), involute) {
        (Sense::Clockwise, true) => "G2.2",
        (_, true) => "G3.2",
        (Sense::Clockwise, false) => "G2",
        (_, false) => "G3",
    };
    let [i, j] = [0, 1].map(|axis| coordinate(block.centre_mm[axis] - start[axis]));
    let radius = if involute {
        // Exact: rounding would change the length of many turns by nanometres.
        format!(" R{}", word(block.radius_mm))
    } else {
        String::new()
    };
    format!(
        "{code} X{} Y{} I{i} J{j}{radius} F{}",
        coordinate(end[0]),
        coordinate(end[1]),
        word(feed)
    )
}

/// A given number, or one that determines the path: it has the same bits when read back.
fn word(value: f64) -> ProgramNumber {
    ProgramNumber::exact(value)
}

/// A computed coordinate.
fn coordinate(value: f64) -> ProgramNumber {
    ProgramNumber::without_noise(value)
}
