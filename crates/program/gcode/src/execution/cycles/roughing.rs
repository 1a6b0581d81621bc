//! G70 to G72.2: finishing and roughing along a profile that a subroutine describes.
//!
//! LinuxCNC's cycles, with its sequence of moves. The subroutine is executed without motion; its straight
//! moves and arcs are the profile. Passes start on the line from the start (X, Z) to the profile, run along Z
//! (G71) or X (G72) to the profile, retract at 45 degrees and return. Then the profile is followed; G71 and
//! G72 also cut its pockets, G71.1 skips them, G71.2 cuts only them.

use evolvent_path::{Arc, Axes, Curve, Plane, Sense};

use crate::codes::modal_groups::{Motion, Rough};
use crate::diagnostics::diagnostic::Fault;
use crate::execution::cycles::profile::{
    Corner, EQUAL_MM, Piece, Point, ProfileFault, check_monotonic, corner, distance, offset,
    split_at_extremes,
};
use crate::execution::execute::{Executor, Request};
use crate::state::machine_state::State;
use crate::{Action, CanonicalCommand, Code, MoveKind, PathMode};

/// Maximum number of passes of a cycle, and of pieces of a profile.
const MAX_MOVES: usize = 100_000;

/// The words of a line with G70 to G72.2, and its start; mm, program coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RoughCall {
    pub(crate) rough: Rough,
    /// Number of the subroutine.
    pub(crate) number: u32,
    /// X and Z at the start of the cycle.
    start: Point,
    /// D: remaining distance to the profile; of G70 that of the first pass.
    allowance: f64,
    /// E of G70: distance of the last pass.
    final_allowance: f64,
    /// I: depth of a pass.
    depth: f64,
    /// R: retract distance.
    retract: f64,
    /// P of G70: number of passes.
    passes: u32,
}

/// The mapping of Z and X to `u` and `w`.
#[derive(Clone, Copy, Debug)]
struct ProfileFrame {
    /// Passes along X (G72).
    facing: bool,
    signs: Point,
}

impl ProfileFrame {
    fn to_uw(self, zx: Point) -> Point {
        let [u, w] = if self.facing { [zx[1], zx[0]] } else { zx };
        [self.signs[0] * u, self.signs[1] * w]
    }

    fn to_zx(self, uw: Point) -> Point {
        let [u, w] = [self.signs[0] * uw[0], self.signs[1] * uw[1]];
        if self.facing { [w, u] } else { [u, w] }
    }

    /// A mirror image has the opposite sense of rotation.
    fn turn(&self, turn: f64) -> f64 {
        let mirror = self.signs[0] * self.signs[1] * if self.facing { -1.0 } else { 1.0 };
        mirror * turn
    }

    fn piece(&self, piece: &Piece) -> Piece {
        match *piece {
            Piece::Line { a, b } => Piece::Line {
                a: self.to_uw(a),
                b: self.to_uw(b),
            },
            Piece::Arc { a, b, centre, turn } => Piece::Arc {
                a: self.to_uw(a),
                b: self.to_uw(b),
                centre: self.to_uw(centre),
                turn: self.turn(turn),
            },
        }
    }
}

/// A move of the cycle in `[u, w]`.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stroke {
    Rapid(Point),
    Cut(Piece),
}

impl Executor<'_> {
    /// Executes a line with G70 to G72.2: the move to the start, and the call of the profile.
    pub(crate) fn roughing(&mut self, rough: Rough) -> Result<Request, Fault> {
        let line = self.line;
        let name = Motion::Rough(rough).name();
        let fault = |code, message: String| Err(Fault::new(code, line.motion_span(), message));
        let units = match name {
            "G70" => Some(("inches", "G20")),
            "G71" => Some(("millimetres", "G21")),
            _ => None,
        };
        if let Some((unit, instead)) = units.filter(|_| !line.has(b'Q') && !line.has_axes()) {
            let message = format!("{name} is a turning cycle in this dialect, not the selection of {unit}");
            return Err(Fault::new(Code::WordMissing, line.motion_span(), message).help(format!(
                "write {instead} for {unit}; the cycle needs G18 and Q, the number of the subroutine with \
                 the profile"
            )));
        }
        if self.state.plane() != Some(Plane::Zx) || self.state.rotation[0] != 0.0 {
            return Err(self.wrong_plane(&format!("{name} outside of G18, or in rotated coordinates,")));
        }
        self.allow_only_axes(b"XZ", name)?;
        self.check_uncompensated(name)?;
        self.check_feed(name)?;
        let Some(number) = line.integer(b'Q')? else {
            return fault(
                Code::WordMissing,
                format!("{name} needs Q, the number of the subroutine with the profile"),
            );
        };
        let unit = self.state.unit_mm();
        let positive = |letter: u8, default: f64, min: f64| match line.word(letter) {
            None => Ok(default),
            Some(value) if value * unit > min => Ok(value * unit),
            Some(value) => {
                let message = format!("{}{value}: too small for {name}", char::from(letter));
                Err(Fault::new(Code::OutOfRange, line.span(letter), message))
            }
        };
        let start = self.target()?;
        let program = self.state.machine_to_program(start);
        let call = RoughCall {
            rough,
            number,
            start: [program[2], program[0]],
            allowance: positive(b'D', 0.0, -1e-12)?,
            final_allowance: positive(b'E', 0.0, -1e-12)?,
            depth: positive(b'I', unit, EQUAL_MM)?,
            retract: positive(b'R', 0.5 * unit, 0.0)?,
            passes: line.integer(b'P')?.unwrap_or(1),
        };
        if call.passes == 0 || call.passes as usize > MAX_MOVES {
            let message = format!("P{}: {name} has 1 to {MAX_MOVES} passes", call.passes);
            return Err(Fault::new(Code::OutOfRange, line.span(b'P'), message));
        }
        self.emit_line_in_mode(start, MoveKind::Rapid, PathMode::ExactPath)?;
        Ok(Request::Profile(call))
    }

    /// The moves of a cycle whose profile has been read. `profile` is in `[z, x]`, program coordinates.
    pub(crate) fn rough(
        &mut self,
        call: &RoughCall,
        profile: Result<&[Piece], ProfileFault>,
    ) -> Result<(), Fault> {
        let rejected = |fault: ProfileFault| {
            let name = Motion::Rough(call.rough).name();
            let (what, help) = match fault {
                ProfileFault::Empty => (
                    "has no moves",
                    "the subroutine must contain G0, G1, G2 and G3 in X and Z",
                ),
                ProfileFault::TooLong => (
                    "has more than 100 000 moves",
                    "write its curves with G2 and G3, or with fewer points",
                ),
                ProfileFault::NotMonotonic => (
                    "reverses",
                    "for G70 and G71 Z must be monotonic along the profile, for G72 X",
                ),
                ProfileFault::Allowance => ("vanishes at the distance D", "reduce D"),
                ProfileFault::Corner => (
                    "has a fillet (A) or chamfer (C) that does not fit",
                    "they must be between two straight lines that are long enough",
                ),
            };
            let message = format!("{name}: the profile of O{} {what}", call.number);
            Fault::new(Code::ProfileRefused, self.line.motion_span(), message).help(help)
        };
        let (frame, pieces) = profile
            .and_then(|profile| orient_profile(call, profile))
            .map_err(rejected)?;
        let mut strokes = Vec::new();
        let begin = pieces.first().map_or([0.0; 2], Piece::start);
        if call.rough.finishing {
            let moves = call.passes as usize * pieces.len();
            if moves > MAX_MOVES {
                let message = format!(
                    "P{} makes more than {MAX_MOVES} moves of this profile",
                    call.passes
                );
                return Err(Fault::new(Code::OutOfRange, self.line.span(b'P'), message));
            }
            for pass in (0..call.passes).rev() {
                let fraction = f64::from(pass) / f64::from(call.passes);
                let allowance = fraction * (call.allowance - call.final_allowance) + call.final_allowance;
                let offset_profile = offset(&pieces, allowance.max(0.0)).map_err(rejected)?;
                strokes.push(Stroke::Rapid(pass_start(call, &frame, begin)));
                strokes.extend(offset_profile.first().map(|first| Stroke::Rapid(first.start())));
                strokes.extend(offset_profile.into_iter().map(Stroke::Cut));
            }
        } else {
            let offset_profile = offset(&pieces, call.allowance).map_err(rejected)?;
            strokes = roughing_strokes(call, &frame, begin, offset_profile).ok_or_else(|| {
                let message = format!("more than {MAX_MOVES} passes");
                Fault::new(Code::OutOfRange, self.line.span(b'I'), message)
                    .help("check the unit of the depth I of a pass")
            })?;
        }
        for stroke in strokes {
            self.stroke(&frame, stroke)?;
        }
        Ok(())
    }

    fn stroke(&mut self, frame: &ProfileFrame, stroke: Stroke) -> Result<(), Fault> {
        let path_mode = match self.state.modes.path_mode {
            PathMode::Blend { .. } => PathMode::ExactPath,
            other => other,
        };
        let mut at = self.state.machine_to_program(self.state.position);
        let mut to = |this: &mut Self, point: Point, kind: MoveKind| {
            let [z, x] = frame.to_zx(point);
            (at[0], at[2]) = (x, z);
            this.move_to(at, kind, path_mode)
        };
        match stroke {
            Stroke::Rapid(point) => to(self, point, MoveKind::Rapid),
            Stroke::Cut(Piece::Line { b, .. }) => to(self, b, MoveKind::Feed),
            Stroke::Cut(Piece::Arc { b, centre, turn, .. }) => {
                let [z, x] = frame.to_zx(b);
                let [centre_z, centre_x] = frame.to_zx(centre);
                (at[0], at[2]) = (x, z);
                let end = self.state.program_to_machine(at);
                let mut middle = at;
                (middle[0], middle[2]) = (centre_x, centre_z);
                let middle = self.state.program_to_machine(middle);
                let sense = if frame.turn(turn) > 0.0 {
                    Sense::CounterClockwise
                } else {
                    Sense::Clockwise
                };
                let from = self.state.position;
                if distance([from[0], from[2]], [end[0], end[2]]) < EQUAL_MM {
                    return Ok(());
                }
                let arc =
                    Arc::new(Plane::Zx, from, end, [middle[2], middle[0]], sense, 0).map_err(|error| {
                        Fault::new(Code::ArcRefused, self.line.motion_span(), error.to_string())
                    })?;
                let curve = Curve::Arc(arc);
                let feed = self.speed(curve.length(), false);
                self.emit_curve(curve, MoveKind::Feed, feed, path_mode)
            }
        }
    }
}

/// The profile with passes along increasing `u` below the start.
fn orient_profile(call: &RoughCall, profile: &[Piece]) -> Result<(ProfileFrame, Vec<Piece>), ProfileFault> {
    let (Some(first), Some(last)) = (profile.first(), profile.last()) else {
        return Err(ProfileFault::Empty);
    };
    if profile.len() > MAX_MOVES {
        return Err(ProfileFault::TooLong);
    }
    let mut frame = ProfileFrame {
        facing: call.rough.facing,
        signs: [1.0, 1.0],
    };
    let start = frame.to_uw(call.start);
    let (begin, end) = (frame.to_uw(first.start()), frame.to_uw(last.end()));
    // The direction of the profile; without one, away from the start.
    let direction = if (end[0] - begin[0]).abs() > EQUAL_MM {
        end[0] - begin[0]
    } else {
        begin[0] - start[0]
    };
    frame.signs[0] = if direction < 0.0 { -1.0 } else { 1.0 };
    let above = if (start[1] - begin[1]).abs() > EQUAL_MM {
        start[1] - begin[1]
    } else {
        end[1] - begin[1]
    };
    frame.signs[1] = if above < 0.0 { -1.0 } else { 1.0 };
    let pieces: Vec<Piece> = profile.iter().map(|piece| frame.piece(piece)).collect();
    check_monotonic(&pieces)?;
    Ok((frame, pieces))
}

/// Start of the line on which passes start: at the start of the cycle, but not beyond the start of the
/// profile.
fn pass_start(call: &RoughCall, frame: &ProfileFrame, profile: Point) -> Point {
    let [u, w] = frame.to_uw(call.start);
    [u.min(profile[0]), w]
}

/// The moves of G71 to G72.2; `profile` is the start of the profile itself. `None` if there are too many
/// passes.
fn roughing_strokes(
    call: &RoughCall,
    frame: &ProfileFrame,
    profile: Point,
    mut pieces: Vec<Piece>,
) -> Option<Vec<Stroke>> {
    let (first, last) = (pieces.first()?.start(), pieces.last()?.end());
    let start = pass_start(call, frame, profile);
    // The profile ends at the surface of the stock.
    if last[1] < start[1] - EQUAL_MM {
        pieces.push(Piece::Line {
            a: last,
            b: [last[0], start[1]],
        });
    }
    let pieces = split_at_extremes(&pieces);
    let mut strokes = Vec::new();
    let total_depth = start[1] - first[1];
    if total_depth / call.depth > MAX_MOVES as f64 {
        return None;
    }
    if call.rough.variant != 2 {
        for pass in 0..MAX_MOVES {
            let level = start[1] - pass as f64 * call.depth;
            if level < first[1] + EQUAL_MM {
                break;
            }
            let fraction = (start[1] - level) / total_depth;
            let begin = [start[0] + fraction * (first[0] - start[0]), level];
            strokes.push(Stroke::Rapid(begin));
            let Some((_, end)) = next_rise(&pieces, 0, level) else {
                continue;
            };
            strokes.push(Stroke::Cut(Piece::Line { a: begin, b: end }));
            strokes.extend(retract_strokes(begin, end, call.retract));
            strokes.push(Stroke::Rapid(begin));
        }
    }
    if total_depth > EQUAL_MM {
        strokes.push(Stroke::Rapid(first));
    } else {
        // Along the surface of the stock.
        strokes.push(Stroke::Cut(Piece::Line { a: start, b: first }));
    }
    follow_profile(call, start, &pieces, &mut strokes)?;
    Some(strokes)
}

/// Retracts from the wall at the end of a pass, and returns above the pass.
fn retract_strokes(begin: Point, end: Point, retract: f64) -> [Stroke; 2] {
    // Not beyond the start of a pass that is shorter than the retract.
    let clearance = retract.min(0.5 * (end[0] - begin[0]).max(0.0));
    let height = end[1] + clearance;
    [
        Stroke::Rapid([end[0] - clearance, height]),
        Stroke::Rapid([begin[0] + clearance, height]),
    ]
}

/// The first point, from a piece on, at which the profile rises to a height.
fn next_rise(pieces: &[Piece], from: usize, level: f64) -> Option<(usize, Point)> {
    pieces[from..].iter().enumerate().find_map(|(offset, piece)| {
        let rises = piece.end()[1] > piece.start()[1] && piece.end()[1] >= level - EQUAL_MM;
        let below = piece.start()[1] < level + EQUAL_MM;
        let point = (rises && below).then(|| piece.at_height(level)).flatten()?;
        Some((from + offset, point))
    })
}

/// Moves along the profile, with the pockets that the variant includes. `None` if they need too many passes:
/// they may be deeper than the profile as a whole.
fn follow_profile(call: &RoughCall, start: Point, pieces: &[Piece], strokes: &mut Vec<Stroke>) -> Option<()> {
    let mut index = 0;
    let mut steps = 0;
    let mut remainder: Option<Piece> = None;
    // The height at which the next pass crosses a pocket.
    let mut level: Option<f64> = None;
    while let Some(piece) = remainder.take().or_else(|| pieces.get(index).copied()) {
        steps += 1;
        if steps > MAX_MOVES + pieces.len() {
            return None;
        }
        let (a, b) = (piece.start(), piece.end());
        if b[1] >= a[1] - EQUAL_MM {
            level = None;
            push_cut(
                strokes,
                piece,
                index > 0 && pieces[index - 1].end()[1] < pieces[index - 1].start()[1] - EQUAL_MM,
            );
            index += 1;
            continue;
        }
        // Down into a pocket.
        if call.rough.variant == 1 {
            match next_rise(pieces, index + 1, a[1]) {
                Some((index_of_rise, point)) => {
                    strokes.push(Stroke::Cut(Piece::Line { a, b: point }));
                    let (_, after) = pieces[index_of_rise].split(point);
                    index = index_of_rise;
                    if after.is_degenerate() {
                        index += 1;
                    } else {
                        remainder = Some(after);
                    }
                    continue;
                }
                None => {
                    push_cut(strokes, piece, false);
                    index += 1;
                    continue;
                }
            }
        }
        let next = *level.get_or_insert_with(|| match call.rough.variant {
            2 => a[1],
            // The levels continue those of the passes above.
            _ => start[1] - ((start[1] - a[1]) / call.depth - 1e-9).ceil() * call.depth,
        });
        let Some(point) = (next > b[1] + EQUAL_MM)
            .then(|| piece.at_height(next.min(a[1])))
            .flatten()
        else {
            push_cut(strokes, piece, false);
            index += 1;
            continue;
        };
        let (before, after) = piece.split(point);
        if !before.is_degenerate() {
            push_cut(strokes, before, false);
        }
        if let Some((_, end)) = next_rise(pieces, index + 1, next)
            && end[0] - point[0] > EQUAL_MM
        {
            strokes.push(Stroke::Cut(Piece::Line { a: point, b: end }));
            strokes.extend(retract_strokes(point, end, call.retract));
            strokes.push(Stroke::Cut(Piece::Line {
                a: [point[0], end[1] + call.retract],
                b: point,
            }));
        }
        level = Some(next - call.depth);
        if after.is_degenerate() {
            index += 1;
        } else {
            remainder = Some(after);
        }
    }
    Some(())
}

/// Appends a piece of the profile; the second half of a concave arc is joined with the first.
fn push_cut(strokes: &mut Vec<Stroke>, piece: Piece, after_falling: bool) {
    if let (true, Piece::Arc { b, centre, turn, .. }) = (after_falling, piece)
        && let Some(Stroke::Cut(Piece::Arc {
            b: end,
            centre: last_centre,
            turn: last_turn,
            ..
        })) = strokes.last_mut()
        && *last_centre == centre
        && *last_turn == turn
    {
        *end = b;
        return;
    }
    strokes.push(Stroke::Cut(piece));
}

/// The pieces of a profile from the moves of its subroutine, without the approach. `corners` lists the moves
/// that end in a fillet or chamfer.
pub(crate) fn profile_of(
    commands: &[CanonicalCommand],
    corners: &[(usize, Corner)],
    state: &State,
) -> Result<Vec<Piece>, ProfileFault> {
    let mut pieces: Vec<Piece> = Vec::new();
    let mut pending: Option<Corner> = None;
    let point = |machine: Axes| {
        let program = state.machine_to_program(machine);
        [program[2], program[0]]
    };
    for (index, command) in commands.iter().enumerate() {
        let Action::Move(step) = &command.action else {
            continue;
        };
        let (a, b) = (point(step.curve.start()), point(step.curve.end()));
        let piece = match &step.curve {
            Curve::Line(_) => Piece::Line { a, b },
            Curve::Arc(arc) if arc.plane() == Plane::Zx => {
                let [z, x] = arc.centre_mm();
                let mut centre = step.curve.start();
                (centre[0], centre[2]) = (x, z);
                Piece::Arc {
                    a,
                    b,
                    centre: point(centre),
                    turn: arc.sweep_rad().signum(),
                }
            }
            _ => return Err(ProfileFault::Corner),
        };
        let kind = corners
            .iter()
            .find(|(move_index, _)| *move_index == index)
            .map(|(_, kind)| *kind);
        if piece.is_degenerate() {
            continue;
        }
        match (pending.take(), pieces.pop()) {
            (Some(corner_kind), Some(before)) => pieces.extend(corner(before, piece, corner_kind)?),
            (_, before) => {
                pieces.extend(before);
                pieces.push(piece);
            }
        }
        pending = kind;
    }
    Ok(pieces)
}
