//! Input of the smoother: programmed moves.

use evolvent_machine::Limits;
use evolvent_path::Curve;

/// Minimum tolerance, mm, below which the path is kept; and the maximum, to which larger ones are reduced.
const MIN_TOLERANCE_MM: f64 = 1e-6;
const MAX_TOLERANCE_MM: f64 = 100.0;

/// One programmed move. It starts at the end of the previous one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProgramMove {
    /// The programmed curve.
    pub curve: Curve,
    /// Speed along the curve in the feed metric (mm/s; deg/s if only rotary axes move); infinite for rapids.
    pub feed_mm_s: f64,
    /// Whether the move is a rapid (G0).
    pub rapid: bool,
    /// Permitted deviation of the path from the curve.
    pub tolerance: Tolerance,
    /// Program line.
    pub line: u32,
    /// Index of the block in the order of execution.
    pub block: u32,
}

/// Permitted deviation of the driven path from the programmed one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Tolerance {
    /// The path is kept; the joint rule limits the speed at joints (G61).
    Exact,
    /// The path is kept and stops at the end of the block (G61.1).
    Stop,
    /// The path may deviate from the programmed one (G64).
    Within {
        /// Maximum distance of XYZ and of UVW in mm, and of every rotary axis in degrees (G64 P).
        mm: f64,
        /// Maximum distance of a vertex that may be dropped between nearly collinear lines, in mm (G64 Q); 0
        /// for none.
        merge_mm: f64,
    },
}

impl Tolerance {
    /// The distance that is used: at most 100 mm, and 0 if the path is to be kept or the tolerance is below 1
    /// nm.
    #[must_use]
    pub fn mm(&self) -> f64 {
        match *self {
            Self::Within { mm, .. } if mm >= MIN_TOLERANCE_MM => mm.min(MAX_TOLERANCE_MM),
            _ => 0.0,
        }
    }
}

/// Machine settings of the smoother.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmootherSettings {
    /// Time in which the jerk limit compensates a step of acceleration on an exact path, s.
    pub joint_time_s: f64,
    /// Limits of the axes.
    pub limits: Limits,
}
