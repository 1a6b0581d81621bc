//! Cutter compensation on random contours: no point of the tool's path is nearer to the contour than the
//! radius, no move is reversed or becomes a full turn, and every contour that the tool fits is accepted.
//!
//! Generator and checks do not know the algorithm: they sample the path.

use evolvent_random::{Random, cases, cases_are_given};
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::fmt::Write as _;

use evolvent_gcode::{Action, Code, Diagnostic, Interpreter, Move, Settings};
use evolvent_path::{Axes, Curve};

/// Loss of distance at a corner below 0.05 rad that is passed straight, as a fraction of the radius.
const STRAIGHT_LOSS: f64 = 0.00125;

type Point = [f64; 2];

fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// A programmed line (sweep 0) or arc.
#[derive(Clone, Copy, Debug)]
struct Piece {
    start: Point,
    end: Point,
    centre: Point,
    /// Above 0 counter-clockwise, rad.
    sweep: f64,
}

impl Piece {
    fn line(start: Point, angle: f64, length: f64) -> Self {
        let end = [start[0] + length * angle.cos(), start[1] + length * angle.sin()];
        Self {
            start,
            end,
            centre: [0.0; 2],
            sweep: 0.0,
        }
    }

    /// An arc with the given direction at its start.
    fn arc(start: Point, angle: f64, radius: f64, sweep: f64) -> Self {
        let sign = sweep.signum();
        let centre = [
            start[0] - sign * radius * angle.sin(),
            start[1] + sign * radius * angle.cos(),
        ];
        let last = angle + sweep;
        let end = [
            centre[0] + sign * radius * last.sin(),
            centre[1] - sign * radius * last.cos(),
        ];
        Self {
            start,
            end,
            centre,
            sweep,
        }
    }

    fn radius(&self) -> f64 {
        distance(self.start, self.centre)
    }

    fn direction(&self, fraction: f64) -> f64 {
        if self.sweep == 0.0 {
            return (self.end[1] - self.start[1]).atan2(self.end[0] - self.start[0]);
        }
        let first = (self.start[1] - self.centre[1]).atan2(self.start[0] - self.centre[0]);
        first + self.sweep.signum() * FRAC_PI_2 + fraction * self.sweep
    }

    fn at(&self, fraction: f64) -> Point {
        if self.sweep == 0.0 {
            return [0, 1].map(|axis| self.start[axis] + fraction * (self.end[axis] - self.start[axis]));
        }
        let angle = self.direction(fraction) - self.sweep.signum() * FRAC_PI_2;
        let radius = self.radius();
        [
            self.centre[0] + radius * angle.cos(),
            self.centre[1] + radius * angle.sin(),
        ]
    }

    /// Distance of a point from the piece.
    fn distance(&self, point: Point) -> f64 {
        let ends = distance(point, self.start).min(distance(point, self.end));
        if self.sweep == 0.0 {
            let chord = [self.end[0] - self.start[0], self.end[1] - self.start[1]];
            let from = [point[0] - self.start[0], point[1] - self.start[1]];
            let square = chord[0] * chord[0] + chord[1] * chord[1];
            let foot = (from[0] * chord[0] + from[1] * chord[1]) / square;
            let offset = (chord[0] * from[1] - chord[1] * from[0]).abs() / square.sqrt();
            return if (0.0..=1.0).contains(&foot) { offset } else { ends };
        }
        let angle = |of: Point| (of[1] - self.centre[1]).atan2(of[0] - self.centre[0]);
        let turned = (self.sweep.signum() * (angle(point) - angle(self.start))).rem_euclid(TAU);
        if turned <= self.sweep.abs() {
            (distance(point, self.centre) - self.radius()).abs()
        } else {
            ends
        }
    }

    fn word(&self, decimals: usize) -> String {
        let [x, y] = self.end;
        if self.sweep == 0.0 {
            return format!("G1 X{x:.decimals$} Y{y:.decimals$}");
        }
        let code = if self.sweep > 0.0 { 3 } else { 2 };
        let [i, j] = [self.centre[0] - self.start[0], self.centre[1] - self.start[1]];
        format!("G{code} X{x:.decimals$} Y{y:.decimals$} I{i:.decimals$} J{j:.decimals$}")
    }
}

/// A contour and the tool that follows it.
struct Case {
    pieces: Vec<Piece>,
    radius: f64,
    left: bool,
    program: String,
    /// Error of the written contour: a few roundings, in mm.
    rounding_mm: f64,
}

/// The first line of the contour in the program; each piece has one line.
const FIRST_LINE: usize = 5;

impl Case {
    /// The program: a straight move leads to the contour in the direction of its first piece.
    fn new(pieces: Vec<Piece>, radius: f64, left: bool, decimals: usize) -> Self {
        let angle = pieces[0].direction(0.0);
        let entry = Piece::line(pieces[0].start, angle + PI, 3.0 * radius);
        let last = pieces[pieces.len() - 1];
        let exit = Piece::line(last.end, last.direction(1.0), 3.0 * radius);
        let side = if left { "G41.1" } else { "G42.1" };
        let mut program = format!(
            "G21 G17 G90 F600\nG0 X{:.6} Y{:.6}\n{side} D{:.6}\nG1 X{:.6} Y{:.6}\n",
            entry.end[0],
            entry.end[1],
            2.0 * radius,
            entry.start[0],
            entry.start[1]
        );
        for piece in &pieces {
            let _ = writeln!(program, "{}", piece.word(decimals));
        }
        let _ = write!(program, "G40 {}\nM2\n", exit.word(decimals));
        Self {
            pieces,
            radius,
            left,
            program,
            rounding_mm: 3.0 * 10_f64.powi(-(decimals as i32)),
        }
    }

    fn side(&self) -> f64 {
        if self.left { 1.0 } else { -1.0 }
    }

    /// The moves of the tool for each piece.
    fn run(&self) -> Result<Vec<Vec<Move>>, Diagnostic> {
        let mut moves = vec![Vec::new(); self.pieces.len()];
        for item in Interpreter::new(self.program.as_bytes(), Settings::default()) {
            let command = item?;
            let piece_index = (command.line as usize).wrapping_sub(FIRST_LINE);
            if let (Action::Move(step), Some(list)) = (command.action, moves.get_mut(piece_index)) {
                list.push(step);
            }
        }
        Ok(moves)
    }

    /// The tool's centre where it touches a piece.
    fn touching(&self, piece: &Piece, fraction: f64) -> Point {
        let angle = piece.direction(fraction) + self.side() * FRAC_PI_2;
        let [x, y] = piece.at(fraction);
        [x + self.radius * angle.cos(), y + self.radius * angle.sin()]
    }

    /// Additional clearance up to which a position still counts as too narrow: rounding moves corners by many
    /// times its size where walls are nearly parallel.
    fn rounding_margin(&self) -> f64 {
        if self.rounding_mm < 1e-5 {
            0.0
        } else {
            50.0 * self.rounding_mm
        }
    }

    fn clearance(&self, point: Point) -> f64 {
        self.pieces
            .iter()
            .map(|piece| piece.distance(point))
            .fold(f64::INFINITY, f64::min)
    }

    /// Checks the moves beside one piece: possibly an arc about the corner before it, then the piece's own
    /// move, parallel to the piece and on its side.
    fn check_moves(&self, piece: &Piece, moves: &[Move]) -> Result<(), String> {
        let tolerance = STRAIGHT_LOSS * self.radius + self.rounding_mm;
        let Some((own_move, corner)) = moves.split_last() else {
            return Ok(());
        };
        if corner.len() > 1 {
            return Err(format!("{} moves", moves.len()));
        }
        for step in corner {
            let Curve::Arc(arc) = step.curve else {
                return Err("a corner that is no arc".to_owned());
            };
            if distance(arc.centre_mm(), piece.start) > self.rounding_mm || arc.sweep_rad().abs() > PI + 1e-6
            {
                return Err(format!("an arc of {} about the corner", arc.sweep_rad()));
            }
        }
        // Only an arc about the corner: a piece that vanishes has no move of its own.
        if let (Curve::Arc(arc), 0.0) = (own_move.curve, piece.sweep)
            && distance(arc.centre_mm(), piece.start) <= self.rounding_mm
        {
            return Err("a line became an arc".to_owned());
        }
        let (start, end) = (plane(own_move.curve.start()), plane(own_move.curve.end()));
        if piece.sweep == 0.0 {
            let angle = piece.direction(0.0);
            let forward = (end[0] - start[0]) * angle.cos() + (end[1] - start[1]) * angle.sin();
            if forward <= 0.0 {
                return Err(format!("a line goes back by {} mm", -forward));
            }
        } else {
            let Curve::Arc(arc) = own_move.curve else {
                return Err("an arc became a line".to_owned());
            };
            // A corner that is passed straight may let it begin slightly earlier.
            let margin = 0.06 * (1.0 + self.radius / arc.radius_mm());
            if arc.sweep_rad() * piece.sweep <= 0.0 || arc.sweep_rad().abs() > piece.sweep.abs() + margin {
                let (swept, programmed) = (arc.sweep_rad(), piece.sweep);
                return Err(format!("an arc of {programmed} rad turns by {swept}"));
            }
        }
        for point in samples(own_move) {
            let deviation = (piece.distance(point) - self.radius).abs();
            if deviation > tolerance {
                return Err(format!(
                    "{deviation} mm off the piece that it runs along, at {point:?}"
                ));
            }
        }
        Ok(())
    }
}

fn plane(point: Axes) -> Point {
    [point[0], point[1]]
}

fn samples(step: &Move) -> impl Iterator<Item = Point> {
    let curve = step.curve;
    let length = curve.length();
    (0..=60).map(move |index| plane(curve.position(f64::from(index) / 60.0 * length)))
}

/// A landscape: the contour always advances in X, so it never intersects itself. Rotated by any angle, and
/// seen from below if the tool is on the right.
fn landscape(random: &mut Random) -> Case {
    let radius = random.between(0.5, 8.0);
    let left = random.unit() < 0.5;
    let decimals: i32 = [6, 6, 4, 3][(4.0 * random.unit()) as usize];
    let size = |random: &mut Random| radius * random.between(-1.5, 3.0).exp();
    let mut at = [0.0, 0.0];
    let mut chain: Vec<Piece> = vec![Piece::line(at, 0.0, 4.0 * radius)];
    at = chain[0].end;
    for _ in 0..3 + (5.0 * random.unit()) as usize {
        let smooth = random.unit() < 0.3;
        let first = if smooth {
            chain[chain.len() - 1].direction(1.0)
        } else {
            random.between(-1.5, 1.5)
        };
        let piece = if random.unit() < 0.6 {
            Piece::line(at, first, size(random))
        } else {
            let arc = Piece::arc(at, first, size(random), random.between(-1.5, 1.5) - first);
            let chord = (arc.end[0] - at[0]).hypot(arc.end[1] - at[1]);
            // With these decimals a shorter arc may end where it begins, which means a full circle.
            if chord > 10_f64.powi(1 - decimals) {
                arc
            } else {
                Piece::line(at, first, size(random))
            }
        };
        at = piece.end;
        chain.push(piece);
    }
    chain.push(Piece::line(at, 0.0, 4.0 * radius));
    let rotation = random.between(-PI, PI);
    let transform = |[x, y]: Point| {
        let y = if left { y } else { -y };
        [
            rotation.cos() * x - rotation.sin() * y,
            rotation.sin() * x + rotation.cos() * y,
        ]
    };
    let pieces = chain.iter().map(|piece| Piece {
        start: transform(piece.start),
        end: transform(piece.end),
        centre: transform(piece.centre),
        sweep: if left { piece.sweep } else { -piece.sweep },
    });
    Case::new(pieces.collect(), radius, left, decimals as usize)
}

#[test]
fn random_contours_are_never_gouged() {
    let mut random = Random::new();
    let (mut accepted, mut rejected) = (0, 0);
    for _ in 0..cases(3000) {
        let case = landscape(&mut random);
        let text = &case.program;
        match case.run() {
            Ok(moves) => {
                accepted += 1;
                let min_clearance = case.radius * (1.0 - STRAIGHT_LOSS) - case.rounding_mm;
                for (piece, moves) in case.pieces.iter().zip(&moves) {
                    if let Err(fault) = case.check_moves(piece, moves) {
                        panic!("{fault}\n{text}");
                    }
                    for point in moves.iter().flat_map(samples) {
                        let clearance = case.clearance(point);
                        assert!(
                            clearance >= min_clearance,
                            "{clearance} of {} at {point:?}\n{text}",
                            case.radius
                        );
                    }
                }
            }
            Err(error) => {
                rejected += 1;
                assert_eq!(
                    error.code,
                    Code::CompensationGouge,
                    "{}\n{text}",
                    error.render("x")
                );
                // A corner that is passed straight takes up to a fortieth of the radius more than necessary.
                let is_straight = case.pieces.windows(2).any(|pair| {
                    let turn = pair[1].direction(0.0) - pair[0].direction(1.0);
                    {
                        let turn = turn.rem_euclid(TAU);
                        let turn = turn.min(TAU - turn);
                        (0.001..0.051).contains(&turn)
                    }
                });
                if is_straight {
                    continue;
                }
                // Some piece cannot be touched by the tool at all.
                let is_unreachable = case.pieces.iter().any(|piece| {
                    (0..=2000).all(|index| {
                        let centre = case.touching(piece, f64::from(index) / 2000.0);
                        let is_inside = piece.sweep * case.side() > 0.0 && piece.radius() <= case.radius;
                        is_inside || case.clearance(centre) < case.radius + case.rounding_margin()
                    })
                });
                assert!(
                    is_unreachable,
                    "refused, but every piece can be reached: {}\n{text}",
                    error.render("x")
                );
            }
        }
    }
    println!("{accepted} accepted, {rejected} refused");
    assert!(accepted > 200 && rejected > 200 || accepted + rejected < 3000);
}

#[test]
fn no_contour_move_is_reversed_or_a_full_turn() {
    let mut random = Random::new();
    let mut accepted = 0;
    for _ in 0..cases(3000) {
        let radius = random.between(0.5, 8.0);
        let left = random.unit() < 0.5;
        let (mut at, mut angle) = ([0.0, 0.0], random.between(-PI, PI));
        let mut pieces = vec![Piece::line(at, angle, 4.0 * radius)];
        at = pieces[0].end;
        for _ in 0..3 + (4.0 * random.unit()) as usize {
            angle += match (10.0 * random.unit()) as u32 {
                0 => 0.0,
                1 => random.between(-0.1, 0.1),
                2 => FRAC_PI_2,
                3 => -FRAC_PI_2,
                _ => random.between(-3.05, 3.05),
            };
            let size = radius * random.between(-2.0, 2.5).exp();
            let piece = if random.unit() < 0.55 {
                Piece::line(at, angle, size)
            } else {
                let sweep = random.between(0.05, 6.2);
                let sweep = if random.unit() < 0.5 { sweep } else { -sweep };
                angle += sweep;
                Piece::arc(at, angle - sweep, size, sweep)
            };
            at = piece.end;
            pieces.push(piece);
        }
        let case = Case::new(pieces, radius, left, 6);
        let Ok(moves) = case.run() else { continue };
        accepted += 1;
        for (piece, moves) in case.pieces.iter().zip(&moves) {
            if let Err(fault) = case.check_moves(piece, moves) {
                panic!("{fault}\n{piece:?}\n{}", case.program);
            }
        }
    }
    println!("{accepted} accepted");
    assert!(accepted > 300 || cases_are_given());
}
