//! What goes in: programmed moves.

use evolvent_machine::Limits;
use evolvent_path::Curve;

/// A tolerance below this, mm, is as good as none, and one above that is no tolerance.
const LEAST: f64 = 1e-6;
const MOST: f64 = 100.0;

/// One programmed move. It starts where the one before ended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Where to.
    pub curve: Curve,
    /// Speed along the curve in the feed metric (mm/s, deg/s where only rotary axes move); infinite for rapids.
    pub feed: f64,
    /// Whether it is a rapid (G0).
    pub rapid: bool,
    /// How the path may differ from the curve.
    pub tolerance: Tolerance,
    /// Line of the program.
    pub line: u32,
    /// Number of the block, for whoever follows the run.
    pub block: u32,
}

/// How the driven path may differ from the programmed one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tolerance {
    /// The path is kept; joints are passed as fast as the joint rule lets (G61).
    Exact,
    /// The path is kept, and comes to rest at the end of the block (G61.1).
    Stop,
    /// The path may leave the programmed one (G64).
    Within {
        /// Greatest distance of XYZ and of UVW in mm, and of every rotary axis in degrees (G64 P).
        mm: f64,
        /// Greatest distance of a vertex that may be left out between collinear lines, in mm (G64 Q); 0 for none.
        merge_mm: f64,
    },
}

impl Tolerance {
    /// The distance that is made use of: at most 100 mm, and 0 where the path is to be kept or less than a nanometre is
    /// allowed.
    #[must_use]
    pub fn mm(&self) -> f64 {
        match *self {
            Self::Within { mm, .. } if mm >= LEAST => mm.min(MOST),
            _ => 0.0,
        }
    }
}

/// What the smoother has to know of the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Time in which the jerk limit undoes a step of acceleration where the path is kept exactly, s.
    pub joint_time_s: f64,
    /// Limits of the axes.
    pub limits: Limits,
}
