//! The programmed path: the curves of a program's moves as polylines with the programmed feed. It needs no
//! plan, so it is drawn until the planned path arrives.

use std::iter::Peekable;
use std::path::Path;

use evolvent_gcode::{Action, MoveKind};
use evolvent_path::{Axes, Curve};
use evolvent_runtime::{Commands, ProgramError, Setup};

/// Maximum distance between a curve and its polyline, mm. It is invisible at the resolution of a screen that
/// shows 1 m.
const CHORD_MM: f64 = 0.02;
/// Maximum number of chords of a curve: the curvature of an involute has no bound at its base circle.
const MAX_CHORDS: f64 = 512.0;
/// Number of commands without a later line after which a program counts as endless, as in `evolvent check`.
const MAX_ROUND: u32 = 1_000_000;

/// The end of a chord.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ProgrammedVertex {
    /// x y z in machine coordinates, mm.
    pub(crate) position: [f32; 3],
    /// Feed on the chord that ends here, mm/s; negative on rapids.
    pub(crate) feed_mm_s: f32,
    pub(crate) line: u32,
}

/// Interprets a program and draws its moves.
pub(crate) struct ProgrammedPath {
    commands: Peekable<Commands>,
    max_feed_mm_s: f64,
    /// Maximum velocity of every axis; infinite for axes that the machine does not have.
    max_velocity: [f64; 9],
    end: Option<Axes>,
    /// Moves interpreted so far, which is the number of the next block.
    moves: u32,
    vertices: u32,
    farthest_line: u32,
    /// Number of commands since a later line was reached.
    round: u32,
    is_over: bool,
}

impl ProgrammedPath {
    /// Opens a program.
    ///
    /// # Errors
    /// The program cannot be opened.
    pub(crate) fn open(program: &Path, setup: &Setup) -> Result<Self, ProgramError> {
        let mut max_velocity = [f64::INFINITY; 9];
        for axis in &setup.machine.axes {
            max_velocity[axis.letter.index()] = axis.max_velocity;
        }
        Ok(Self {
            commands: Commands::open(program, setup)?.peekable(),
            max_feed_mm_s: setup.machine.max_feed_mm_s.unwrap_or(f64::INFINITY),
            max_velocity,
            end: None,
            moves: 0,
            vertices: 0,
            farthest_line: 0,
            round: 0,
            is_over: false,
        })
    }

    /// Interprets one command and passes its vertices on. False at the end of the program, at its first
    /// error, and once it counts as endless.
    pub(crate) fn advance(&mut self, put: &mut impl FnMut(ProgrammedVertex)) -> bool {
        let command = match self.commands.next() {
            Some(Ok(command)) if !self.is_over => command,
            // A run ends at the first error.
            _ => {
                self.is_over = true;
                return false;
            }
        };
        self.round += 1;
        if command.line > self.farthest_line {
            (self.farthest_line, self.round) = (command.line, 0);
        }
        match &command.action {
            Action::Move(motion) => {
                self.moves += u32::from(!command.continues);
                let is_rapid = motion.kind == MoveKind::Rapid;
                self.draw(&motion.curve, motion.feed_mm_s, is_rapid, command.line, put);
            }
            // Their feed depends on the spindle.
            Action::Thread { curve, .. } | Action::RigidTap { curve, .. } => {
                self.draw(curve, f64::INFINITY, false, command.line, put);
            }
            Action::Probe { curve, feed_mm_s, .. } => {
                self.draw(curve, *feed_mm_s, false, command.line, put);
            }
            _ => {}
        }
        self.is_over = self.round > MAX_ROUND;
        !self.is_over
    }

    /// Number of vertices up to the end of a block. The block number must not decrease.
    pub(crate) fn vertices_through(&mut self, block: u32) -> u32 {
        while (self.moves <= block || self.part_follows()) && self.advance(&mut |_| {}) {}
        self.vertices
    }

    /// Whether the next command is a further part of the present move.
    fn part_follows(&mut self) -> bool {
        matches!(self.commands.peek(), Some(Ok(command)) if command.continues)
    }

    fn draw(
        &mut self,
        curve: &Curve,
        feed_mm_s: f64,
        is_rapid: bool,
        line: u32,
        put: &mut impl FnMut(ProgrammedVertex),
    ) {
        let mut from = curve.start();
        let mut put = |position: &Axes, feed: f64| {
            self.vertices += 1;
            put(ProgrammedVertex {
                position: [0, 1, 2].map(|axis| position[axis] as f32),
                feed_mm_s: if is_rapid { -feed } else { feed } as f32,
                line,
            });
        };
        let word = feed_mm_s.min(self.max_feed_mm_s);
        let chords = chords(curve);
        if self.end != Some(from) {
            put(&from, reached(word, &self.max_velocity, &from, &curve.end()));
        }
        for k in 1..=chords {
            let to = if k == chords {
                curve.end()
            } else {
                curve.position(curve.domain() * f64::from(k) / f64::from(chords))
            };
            put(&to, reached(word, &self.max_velocity, &from, &to));
            from = to;
        }
        self.end = Some(from);
    }
}

/// Number of chords that keep a curve within [`CHORD_MM`]: the distance of a chord of length c from an arc of
/// curvature k is k c² / 8.
fn chords(curve: &Curve) -> u32 {
    let curvature = curve.curvature_bound(0.0, curve.domain());
    let count = curve.length() * (curvature / (8.0 * CHORD_MM)).sqrt();
    (count.ceil().min(MAX_CHORDS) as u32).max(1)
}

/// The feed that the axes reach on a chord, at most the feed word.
fn reached(word: f64, max_velocity: &[f64; 9], from: &Axes, to: &Axes) -> f64 {
    let [x, y, z] = [0, 1, 2].map(|axis| to[axis] - from[axis]);
    let length = (x * x + y * y + z * z).sqrt();
    let by_axes = (0..3)
        .map(|axis| max_velocity[axis] * length / (to[axis] - from[axis]).abs())
        .fold(f64::INFINITY, f64::min);
    let feed = word.min(by_axes);
    // A chord of rotary axes alone is a point here.
    if feed.is_finite() { feed } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use evolvent_machine::Machine;

    use super::*;

    fn path(text: &str) -> (tempfile::TempDir, ProgrammedPath) {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("part.ngc");
        std::fs::write(&program, text).unwrap();
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let machine = Machine::load(&file).unwrap();
        let setup = Setup::new(machine, file, String::new(), None).unwrap();
        let path = ProgrammedPath::open(&program, &setup).unwrap();
        (folder, path)
    }

    fn vertices(text: &str) -> Vec<ProgrammedVertex> {
        let (_folder, mut path) = path(text);
        let mut vertices = Vec::new();
        while path.advance(&mut |vertex| vertices.push(vertex)) {}
        vertices
    }

    #[test]
    fn the_parts_of_a_move_are_one_block() {
        let text =
            "G21 G90 G18 G54\nG0 X20\nG95 G96 S60 D1500 M3\nG1 X30 F0.5\nG1 X120 F0.5\nG94 G1 X130 F77\nM2\n";
        let all = vertices(text).len() as u32;
        let (_folder, mut path) = path(text);
        let counts: Vec<u32> = (0..4).map(|block| path.vertices_through(block)).collect();
        assert!(counts[2] > counts[1] + 50, "{counts:?}");
        assert_eq!((counts[3], counts[3] - counts[2]), (all, 1), "{counts:?}");
    }

    #[test]
    fn lines_have_their_ends_their_feed_and_their_line() {
        let found = vertices("G21 G90 G94\nG1 X30 F600\nG0 X40\nG1 Y10 F60000\nM2\n");
        let found: Vec<_> = found
            .iter()
            .map(|vertex| (vertex.position, vertex.feed_mm_s, vertex.line))
            .collect();
        // The X and Y axes of the mill reach 30000 mm/min.
        assert_eq!(
            found,
            [
                ([0.0, 0.0, 0.0], 10.0, 2),
                ([30.0, 0.0, 0.0], 10.0, 2),
                ([40.0, 0.0, 0.0], -500.0, 3),
                ([40.0, 10.0, 0.0], 500.0, 4),
            ]
        );
    }

    /// The sagitta of a chord over the angle a of a circle with radius r is r (1 - cos(a / 2)).
    #[test]
    fn an_arc_uses_the_fewest_chords_within_tolerance() {
        let found = vertices("G21 G90 G17\nG1 X50 F600\nG3 X50 Y0 I-50 J0\nM2\n");
        let chords = found.len() as f64 - 2.0;
        let sagitta = |chords: f64| 50.0 * (1.0 - (std::f64::consts::PI / chords).cos());
        assert!(sagitta(chords) <= CHORD_MM, "{chords}");
        assert!(sagitta(chords - 2.0) > CHORD_MM, "{chords}");
        for vertex in &found[1..] {
            let [x, y, _] = vertex.position.map(f64::from);
            assert!((x.hypot(y) - 50.0).abs() < 1e-4, "{vertex:?}");
        }
    }

    #[test]
    fn blocks_end_where_their_moves_end() {
        let (_folder, mut path) = path("G21 G90\nG1 X1 F600\nG4 P0.1\nX2\nX3\nM2\n");
        let ends: Vec<_> = [0, 0, 1, 2, 9].map(|block| path.vertices_through(block)).into();
        assert_eq!(ends, [2, 2, 3, 4, 4]);
    }

    #[test]
    fn an_error_and_an_endless_loop_end_it() {
        assert_eq!(vertices("G21 G90\nG1 X1 F600\nG1 Q\nG1 X2\nM2\n").len(), 2);
        let found = vertices("G21 G90 F600\no1 while [1]\nG1 X1\nG1 X0\no1 endwhile\nM2\n");
        let max = MAX_ROUND as usize + 10;
        assert!((max / 2..max).contains(&found.len()), "{}", found.len());
    }
}
