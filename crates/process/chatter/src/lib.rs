//! Chatter: will a cut vibrate, how strongly, and at which speed not?
//!
//! Two mechanisms, kept apart because they need different data.
//!
//! **Self-oscillation** of a tool on two springs in a force that falls with the speed and couples two
//! directions. A [`CuttingTool`] and a force law make a [`Model`]. An [`Assessor`] tells everything about its
//! cut: an [`Assessment`] with its cycles and a [`Verdict`]. For that [`Scanner::scan`] finds the steady cut,
//! the growth of small vibrations, and cycles, stable or not, by harmonic balance along branches; [`verify`]
//! integrates a cycle in time and gives its Floquet multipliers; a [`Follower`] follows disturbances in time.
//! [`least_squares`] is the method of the source, for comparison. A [`Mapper`] computes maps of speed and
//! depth.
//!
//! **Regenerative chatter**, in which the tool cuts the waves of the revolution or the tooth before.
//! [`Turning`] and [`Milling`] from measured [`Mode`]s give stability [`Lobes`] in the frequency domain;
//! [`MillingDelay`] gives the limits and multipliers of the delay equation, and whether a limit is one of
//! period doubling or of a vibration of its own, with its frequency ([`Chatter`]).
//!
//! The first knows no delay, so it predicts no lobes; the second is linear, so it predicts no amplitude.
//!
//! A [`Case`] is a question as a file asks it.
//!
//! ```
//! use evolvent_chatter::{Assessor, CuttingTool, Model, PrincipalAxis, Verdict};
//! use evolvent_cutting::{LawDefinition, Tool};
//!
//! let steel = LawDefinition::built_in("40X-R1").ok_or("no such law")?;
//! let law = steel.law(Tool { rake_deg: 10.0, lead_deg: 60.0 })?;
//! let tool = CuttingTool {
//!     axes: [PrincipalAxis::with_ratio(6.0, 3.0e7, 0.03), PrincipalAxis::with_ratio(6.0, 1.5e7, 0.02)],
//!     beta_deg: 35.0,
//!     speed_m_min: 60.0,
//!     depth_mm: 4.0,
//!     feed_mm_rev: 0.49,
//!     radial_ratio: 0.4,
//!     floor_m_min: 2.0,
//! };
//! let cut = Assessor::new(5).assess(&Model::new(tool, &law)?)?;
//! assert_eq!(cut.verdict, Verdict::SelfExcited);
//! let vibration = cut.largest_stable().ok_or("no cycle")?;
//! assert!((vibration.verified.frequency_hz - 255.4).abs() < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! SI units inside, but cutting speeds in m/min, depths and feeds of a cut in mm, as force laws have them.
//! Everything here is pure: no files, clocks or threads; nothing is for the real-time cycle.

mod adams;
mod assess;
mod balance;
mod case;
mod case_file;
mod cycle;
mod delay;
mod elimination;
mod error;
mod floquet;
mod integrate;
mod least_squares;
mod lobe;
mod map;
mod model;
mod pair;
mod scan;
mod speeds;
mod transient;

pub use assess::{
    AssessedCycle, Assessment, Assessor, Disturbance, DropReason, DroppedCycle, FoundBy, Verdict,
};
pub use case::{Case, LawSource, LobeRange, MapRange, OscillationCase, SweepRange};
pub use case_file::case_schema;
pub use cycle::Cycle;
pub use delay::{Chatter, ChatterKind, MillingDelay, lobe_diagram};
pub use error::ChatterError;
pub use floquet::{Verified, verify};
pub use integrate::{Accuracy, Integrator};
pub use least_squares::{Fit, Measure, least_squares};
pub use lobe::{Limit, Lobes, Milling, MillingCut, Mode, Turning, TurningMode};
pub use map::{MapCell, Mapper};
pub use model::{CuttingTool, Equilibrium, Laws, Model, PrincipalAxis, SmallMode, State};
pub use scan::{Branch, MAX_FREE_PART, Prediction, ScanEnd, ScanPoint, Scanner};
pub use speeds::nearest_stable;
pub use transient::{Fate, Follower};
