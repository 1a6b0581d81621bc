//! Converts the words of arcs and involutes into curves.
//!
//! RS274/NGC, 3.5.3: centre format (I J K) and radius format (R). Tolerances and messages are LinuxCNC's, so
//! that a program accepted there is accepted here. Involutes: Fanuc's words (G2.2, G3.2) and a linear third
//! axis.

use evolvent_path::{Arc, Axes, Blend, Curve, Involute, InvoluteError, Jet, MAX_ARC_TURNS, Plane, Sense};

use crate::diagnostics::diagnostic::Fault;
use crate::execution::execute::Executor;
use crate::state::machine_state::State;
use crate::syntax::statement::Statement;
use crate::{Code, MoveKind, Settings};

/// Permitted deviation of an arc in a rotated plane, mm.
const ROTATED_TOLERANCE_MM: f64 = 1e-4;

/// The letters of a plane.
struct Letters {
    first: u8,
    second: u8,
    /// Centre words along first, second and normal axis.
    centre: [u8; 3],
    /// Indices of the in-plane axes.
    axes: [usize; 2],
}

impl Letters {
    fn of(plane: Plane) -> Self {
        let (first, second, normal) = plane.axes();
        Self {
            first: b"XYZ"[first],
            second: b"XYZ"[second],
            centre: [b"IJK"[first], b"IJK"[second], b"IJK"[normal]],
            axes: [first, second],
        }
    }

    fn has_end(&self, line: &Statement) -> bool {
        line.has(self.first) || line.has(self.second) || line.has_polar()
    }

    fn names(&self) -> (char, char) {
        (char::from(self.first), char::from(self.second))
    }

    fn centre_names(&self) -> (char, char) {
        (char::from(self.centre[0]), char::from(self.centre[1]))
    }
}

impl Executor<'_> {
    /// G2, G3.
    pub(crate) fn arc(&mut self, sense: Sense) -> Result<(), Fault> {
        let plane = match self.state.plane() {
            Some(plane) => plane,
            None => return Err(self.wrong_plane("an arc")),
        };
        let name = if sense == Sense::Clockwise { "G2" } else { "G3" };
        self.check_feed(name)?;
        if self.state.cutter.programmed.is_some() && !self.state.cutter.is_on() {
            let message = format!("{name} before the move that completes G40");
            let fault = Fault::new(Code::CompensationActive, self.line.motion_span(), message);
            return Err(fault.help("the tool returns to the programmed path on a straight move: G0 or G1"));
        }
        let target = self.target()?;
        if self.state.rotation[0] != 0.0 && plane != Plane::Xy {
            return self.rotated_plane_arc(plane, sense, target);
        }
        let curve = arc(self.state, plane, sense, target, self.line, self.settings)?;
        if self.state.cutter.is_on() {
            return self.compensated_arc(curve);
        }
        let feed = self.speed(curve.length(), false);
        let path_mode = self.state.modes.path_mode;
        self.emit_curve(curve, MoveKind::Feed, feed, path_mode)
    }

    /// An arc in G18 or G19 while XY is rotated. Its plane contains no axis, so it becomes a chain of
    /// quintics, each within [`ROTATED_TOLERANCE_MM`] of it.
    fn rotated_plane_arc(&mut self, plane: Plane, sense: Sense, target: Axes) -> Result<(), Fault> {
        if self.state.cutter.is_on() {
            return Err(self.wrong_plane("cutter compensation in rotated coordinates"));
        }
        // In coordinates without the rotation the arc is in its plane.
        let state = &*self.state;
        let mut unrotated = *state;
        unrotated.rotation = [0.0, 1.0, 0.0];
        unrotated.work = state.rotate_back(state.work + state.tool_offset);
        unrotated.tool_offset = Axes::zeros();
        unrotated.position = state.rotate_back(state.position);
        unrotated.cutter.programmed = None;
        let target = state.rotate_back(target);
        let curve = arc(&unrotated, plane, sense, target, self.line, self.settings)?;
        let radius = match &curve {
            Curve::Arc(arc) => arc.radius_mm(),
            _ => 0.0,
        };
        // A quintic that matches both ends of an angle with two derivatives deviates by radius * angle^6 /
        // (6! 2^6).
        let angle = libm::pow(46_080.0 * ROTATED_TOLERANCE_MM / radius.max(1e-3), 1.0 / 6.0).min(0.5);
        let length = curve.length();
        let count = (length / (angle * radius.max(1e-3))).ceil().clamp(1.0, 1e6);
        let step_length = length / count;
        let state = *self.state;
        let rotated = |u: f64| {
            let jet = curve.at(u);
            Jet {
                position: state.rotate(jet.position),
                first: state.rotate(jet.first),
                second: state.rotate(jet.second),
                third: state.rotate(jet.third),
            }
        };
        let mut start = rotated(0.0);
        start.position = state.position;
        let mut pieces = Vec::new();
        for index in 1..=count as u64 {
            let end = rotated((step_length * index as f64).min(length));
            let blend = Blend::hermite(&start, &end, step_length)
                .map_err(|error| Fault::new(Code::ArcRefused, self.line.motion_span(), error.to_string()))?;
            pieces.push(Curve::Blend(blend));
            start = end;
        }
        self.emit_pieces(&pieces)
    }

    /// G2.2, G3.2.
    pub(crate) fn involute(&mut self, sense: Sense) -> Result<(), Fault> {
        let plane = self.unrotated_plane("an involute")?;
        let name = if sense == Sense::Clockwise { "G2.2" } else { "G3.2" };
        self.check_feed(name)?;
        if self.state.cutter.is_on() {
            let message = format!("{name} while cutter compensation is on");
            let fault = Fault::new(Code::CompensationActive, self.line.motion_span(), message);
            return Err(fault.help("write G40 first, and program the path of the tool centre"));
        }
        let target = self.target()?;
        let curve = involute(self.state, plane, sense, target, self.line, self.settings)?;
        let feed = self.speed(curve.length(), false);
        let path_mode = self.state.modes.path_mode;
        self.emit_curve(curve, MoveKind::Feed, feed, path_mode)
    }

    fn unrotated_plane(&self, what: &str) -> Result<Plane, Fault> {
        match self.state.plane() {
            Some(plane) if plane == Plane::Xy || self.state.rotation[0] == 0.0 => Ok(plane),
            Some(_) => Err(self.wrong_plane(&format!("{what} in rotated coordinates"))),
            None => Err(self.wrong_plane(what)),
        }
    }
}

/// The arc of a line. `target` is the end in machine coordinates.
fn arc(
    state: &State,
    plane: Plane,
    sense: Sense,
    mut target: Axes,
    line: &Statement,
    settings: &Settings,
) -> Result<Curve, Fault> {
    let letters = Letters::of(plane);
    let (first, second) = letters.names();
    let (i, j) = letters.centre_names();
    let span = line.motion_span();
    let has_centre = letters.centre.iter().any(|letter| line.has(*letter));
    if !has_centre && !line.has(b'R') {
        let message = format!("an arc without {i}, {j} or R");
        return Err(Fault::new(Code::ArcCentreMissing, span, message).help(format!(
            "write {i} and {j}, from the start to the centre, or the radius R"
        )));
    }
    if has_centre && line.has(b'R') {
        let message = format!("an arc with R and with {i} or {j}");
        return Err(Fault::new(Code::ArcMixedFormat, line.span(b'R'), message).help("give one of them only"));
    }
    let turns = turns(line)?;
    let start_position = state.programmed();
    let start = [start_position[letters.axes[0]], start_position[letters.axes[1]]];
    let end = [target[letters.axes[0]], target[letters.axes[1]]];
    let centre = if line.has(b'R') {
        if !letters.has_end(line) {
            let message = format!("an arc with R needs its end: {first} or {second}");
            return Err(Fault::new(Code::ArcEndMissing, span, message));
        }
        centre_by_radius(state, sense, start, end, line, settings, &letters)?
    } else {
        centre_by_offset(state, start, end, line, settings, &letters)?
    };
    if !line.has(b'R') && same_point(start, end) {
        // A full circle: rounding of the end must not shrink it to a point.
        target[letters.axes[0]] = start[0];
        target[letters.axes[1]] = start[1];
    }
    Arc::new(plane, start_position, target, centre, sense, turns)
        .map(Curve::Arc)
        .map_err(|error| Fault::new(Code::ArcRefused, span, error.to_string()))
}

/// Full turns after the first, from P.
fn turns(line: &Statement) -> Result<u32, Fault> {
    let Some(p) = line.word(b'P') else { return Ok(0) };
    let rounded = p.round();
    if (p - rounded).abs() > 1e-4 || rounded < 1.0 || rounded > f64::from(MAX_ARC_TURNS) {
        let message = format!("P{p}: P on an arc is the number of turns, an integer from 1");
        return Err(Fault::new(Code::ArcTurns, line.span(b'P'), message));
    }
    Ok(rounded as u32 - 1)
}

/// Whether an arc ends at its start, up to the rounding of increments and offsets.
fn same_point(start: [f64; 2], end: [f64; 2]) -> bool {
    let is_near = |a: f64, b: f64| (a - b).abs() <= 1e-10 + 8.0 * f64::EPSILON * a.abs().max(b.abs());
    is_near(start[0], end[0]) && is_near(start[1], end[1])
}

fn centre_by_offset(
    state: &State,
    start: [f64; 2],
    end: [f64; 2],
    line: &Statement,
    settings: &Settings,
    letters: &Letters,
) -> Result<[f64; 2], Fault> {
    let normal_word = letters.centre[2];
    if line.has(normal_word) {
        let message = format!("{} is not in the plane of this arc", char::from(normal_word));
        let (i, j) = letters.centre_names();
        return Err(
            Fault::new(Code::ArcOffsetAcrossPlane, line.span(normal_word), message).help(format!(
                "in this plane the centre of an arc is given by {i} and {j}; G17, G18, G19 select the plane"
            )),
        );
    }
    let unit = state.unit_mm();
    let mut words = Axes::zeros();
    for index in 0..2 {
        let word = line.word(letters.centre[index]);
        if word.is_none() && state.modes.arc_centre_absolute {
            let name = char::from(letters.centre[index]);
            let message = format!("{name} is missing: G90.1 makes the centre absolute");
            return Err(Fault::new(Code::ArcCentreIncomplete, line.motion_span(), message)
                .help("give both centre words, or G91.1 for a centre relative to the start"));
        }
        words[letters.axes[index]] = word.unwrap_or(0.0) * unit;
    }
    let absolute = state.modes.arc_centre_absolute;
    let rotated = if absolute {
        state.program_to_machine(words)
    } else {
        state.rotate(words)
    };
    let centre = [0, 1].map(|index| {
        let base = if absolute { 0.0 } else { start[index] };
        base + rotated[letters.axes[index]]
    });
    check_radii(state, start, end, centre, line, settings, letters)?;
    Ok(centre)
}

/// LinuxCNC's two conditions on an arc in centre format, with its messages.
fn check_radii(
    state: &State,
    start: [f64; 2],
    end: [f64; 2],
    centre: [f64; 2],
    line: &Statement,
    settings: &Settings,
    letters: &Letters,
) -> Result<(), Fault> {
    let radius = |point: [f64; 2]| libm::hypot(point[0] - centre[0], point[1] - centre[1]);
    let (r1, r2) = (radius(start), radius(end));
    let is_zero = |radius: f64| radius < settings.arc.radius_mm;
    let tolerance = if state.modes.inches {
        settings.arc.inch_mm
    } else {
        settings.arc.metric_mm
    };
    let radii_differ = |r1: f64, r2: f64| {
        let (difference, relative) = ((r1 - r2).abs(), (r1 - r2).abs() / r1.max(r2));
        difference > 100.0 * tolerance || difference > tolerance && relative > settings.arc.relative
    };
    let zero_radius = is_zero(r1) || is_zero(r2);
    if !zero_radius && !radii_differ(r1, r2) {
        return Ok(());
    }
    let (difference, relative) = ((r1 - r2).abs(), (r1 - r2).abs() / r1.max(r2));
    let (first, second) = letters.names();
    let point_text = |point: [f64; 2]| {
        let mut machine = state.position;
        (machine[letters.axes[0]], machine[letters.axes[1]]) = (point[0], point[1]);
        let program = state.machine_to_program(machine);
        let value = |index: usize| program[letters.axes[index]] / state.unit_mm();
        format!("({first}{:.4},{second}{:.4})", value(0), value(1))
    };
    let unit = state.unit_mm();
    let figures = format!(
        "start={} center={} end={} r1={:.4} r2={:.4}",
        point_text(start),
        point_text(centre),
        point_text(end),
        r1 / unit,
        r2 / unit
    );
    let (i, j) = letters.centre_names();
    if zero_radius {
        return Err(Fault::new(
            Code::ArcZeroRadius,
            line.motion_span(),
            format!("Zero-radius arc: {figures}"),
        )
        .help(if state.modes.arc_centre_absolute {
            format!("{i} and {j} are the coordinates of the centre (G90.1)")
        } else {
            format!("{i} and {j} are the distance from the start to the centre")
        }));
    }
    let message = format!(
        "Radius to end of arc differs from radius to start: {figures} abs_err={:.4} rel_err={:.4}%",
        difference / unit,
        100.0 * relative
    );
    let [meaning, other, code] = if state.modes.arc_centre_absolute {
        ["absolute (G90.1)", "distances from the start", "G91.1"]
    } else {
        ["from the start (G91.1)", "absolute", "G90.1"]
    };
    let [r1, r2] = radii_in_other_mode(state, start, end, line, letters);
    // G90.1 needs both words.
    let has_both = letters.centre[..2].iter().all(|letter| line.has(*letter));
    let fits = has_both && !is_zero(r1) && !is_zero(r2) && !radii_differ(r1, r2);
    let help = if fits {
        format!("the circle fits if {i} and {j} are {other}: write {code} on a line before")
    } else {
        format!("the end must be on the circle; {i} and {j} are {meaning} now")
    };
    Err(Fault::new(Code::ArcRadiusMismatch, line.motion_span(), message).help(help))
}

/// The distances, mm, of start and end from the centre that G90.1 in place of G91.1, or the reverse, would
/// give.
fn radii_in_other_mode(
    state: &State,
    start: [f64; 2],
    end: [f64; 2],
    line: &Statement,
    letters: &Letters,
) -> [f64; 2] {
    let program = |point: [f64; 2]| {
        let mut machine = state.position;
        (machine[letters.axes[0]], machine[letters.axes[1]]) = (point[0], point[1]);
        state.machine_to_program(machine)
    };
    let start = program(start);
    [start, program(end)].map(|point| {
        let from_centre = [0, 1].map(|index| {
            let axis = letters.axes[index];
            let word = line.word(letters.centre[index]).unwrap_or(0.0) * state.unit_mm();
            let base = if state.modes.arc_centre_absolute {
                start[axis]
            } else {
                0.0
            };
            point[axis] - base - word
        });
        libm::hypot(from_centre[0], from_centre[1])
    })
}

fn centre_by_radius(
    state: &State,
    sense: Sense,
    start: [f64; 2],
    end: [f64; 2],
    line: &Statement,
    settings: &Settings,
    letters: &Letters,
) -> Result<[f64; 2], Fault> {
    let r = line.word(b'R').unwrap_or(0.0) * state.unit_mm();
    let chord = [end[0] - start[0], end[1] - start[1]];
    let length = libm::hypot(chord[0], chord[1]);
    let half_chord = 0.5 * length;
    if same_point(start, end) {
        let (i, j) = letters.centre_names();
        let message = "an arc with R that ends where it starts could be any circle";
        return Err(Fault::new(Code::ArcNoChord, line.motion_span(), message)
            .help(format!("for a full circle give {i} and {j} instead of R")));
    }
    if half_chord - r.abs() > settings.arc.radius_mm {
        let unit = state.unit_mm();
        let message = format!(
            "Arc radius too small to reach end point: R {:.4}, half the distance {:.4}",
            r.abs() / unit,
            half_chord / unit
        );
        return Err(Fault::new(Code::ArcRadiusTooSmall, line.span(b'R'), message));
    }
    // Distance of the centre from the chord, by a product that does not cancel near the semicircle. A radius
    // short of the semicircle by rounding is a semicircle.
    let height = ((r.abs() - half_chord).max(0.0) * (r.abs() + half_chord)).sqrt();
    // R > 0: at most half a turn, so the centre is on the side towards which the arc turns.
    let side = sense.sign() * if r < 0.0 { -1.0 } else { 1.0 };
    let scale = side * height / length;
    Ok([
        start[0] + 0.5 * chord[0] - scale * chord[1],
        start[1] + 0.5 * chord[1] + scale * chord[0],
    ])
}

/// The involute of a line of the program.
fn involute(
    state: &State,
    plane: Plane,
    sense: Sense,
    target: Axes,
    line: &Statement,
    settings: &Settings,
) -> Result<Curve, Fault> {
    let letters = Letters::of(plane);
    let (first, second) = letters.names();
    let (i, j) = letters.centre_names();
    let span = line.motion_span();
    if !letters.has_end(line) {
        let message = format!("an involute needs its end: {first} and {second}");
        return Err(Fault::new(Code::InvoluteEndMissing, span, message));
    }
    let normal_word = letters.centre[2];
    if line.has(normal_word) {
        let message = format!("{} is not in the plane of this involute", char::from(normal_word));
        return Err(
            Fault::new(Code::InvoluteOffsetAcrossPlane, line.span(normal_word), message).help(format!(
                "in this plane the centre of the base circle is given by {i} and {j}"
            )),
        );
    }
    let unit = state.unit_mm();
    let mut words = Axes::zeros();
    for index in 0..2 {
        words[letters.axes[index]] = line.word(letters.centre[index]).unwrap_or(0.0) * unit;
    }
    let words = state.rotate(words);
    let offset = [0, 1].map(|index| words[letters.axes[index]]);
    if offset == [0.0; 2] {
        let message = format!("an involute needs {i} and {j}, and not both 0");
        return Err(Fault::new(Code::InvoluteCentreMissing, span, message)
            .help("they are the distance from the start to the centre of the base circle, also in G90.1"));
    }
    let radius = line.word(b'R').unwrap_or(0.0) * unit;
    if radius <= 0.0 {
        return Err(Fault::new(
            Code::InvoluteRadiusMissing,
            line.span(b'R'),
            "an involute needs R above 0",
        )
        .help("R is the radius of the base circle"));
    }
    let centre = [0, 1].map(|index| state.position[letters.axes[index]] + offset[index]);
    Involute::new(
        plane,
        state.position,
        target,
        centre,
        radius,
        sense,
        settings.involute_tolerance_mm,
    )
    .map(Curve::Involute)
    .map_err(|error| {
        let code = match error {
            InvoluteError::StartInside { .. } | InvoluteError::EndInside { .. } => Code::InvoluteInside,
            InvoluteError::EqualRadii { .. } => Code::InvoluteEqualRadii,
            InvoluteError::Turns { .. } => Code::InvoluteTurns,
            InvoluteError::OffInvolute { .. } => Code::InvoluteMissed,
            _ => Code::InvoluteRefused,
        };
        Fault::new(code, span, error.to_string())
    })
}
