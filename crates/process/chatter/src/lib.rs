//! Chatter: predicts whether a cut vibrates, at which amplitude, and at which speeds it is stable.
//!
//! Two mechanisms are treated separately, because they need different data.
//!
//! **Self-oscillation** of a tool on two springs, in a force that falls with the speed and couples two
//! directions. A [`CuttingTool`] and a force law make a [`Model`]. An [`Assessor`] combines all methods into
//! an [`Assessment`] with the limit cycles and a [`StabilityVerdict`]. [`Scanner::scan`] finds the steady cut, the
//! growth of small vibrations, and cycles, stable or not, by harmonic balance along branches. [`verify`]
//! integrates a cycle in time and gives its Floquet multipliers. A [`TransientFollower`] follows disturbances in time.
//! [`least_squares`] is the published method, for comparison. A [`Mapper`] computes maps over speed and
//! depth.
//!
//! **Regenerative chatter**: the tool cuts the waves of the previous revolution or tooth. [`Turning`] and
//! [`Milling`] give stability [`Lobes`] in the frequency domain from measured [`Mode`]s. [`MillingDelay`]
//! gives the limits and multipliers of the delay equation, and the kind of each limit with its frequency:
//! period doubling or Hopf ([`Chatter`]).
//!
//! The first mechanism has no delay, so it predicts no lobes; the second is linear, so it predicts no
//! amplitude.
//!
//! A [`Case`] is read from a case file and contains the data of either or both.
//!
//! ```
//! use evolvent_chatter::{Assessor, CuttingTool, Model, PrincipalAxis, StabilityVerdict};
//! use evolvent_cutting::{LawDefinition, ToolAngles};
//!
//! let steel = LawDefinition::built_in("40X-R1").ok_or("no such law")?;
//! let law = steel.law(ToolAngles { rake_deg: 10.0, lead_deg: 60.0 })?;
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
//! assert_eq!(cut.verdict, StabilityVerdict::SelfExcited);
//! let vibration = cut.largest_stable().ok_or("no cycle")?;
//! assert!((vibration.verified.frequency_hz - 255.4).abs() < 0.1);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Units are SI, except cutting speeds in m/min, and depths and feeds of a cut in mm, as in force laws. The
//! crate uses no files, clocks or threads. Nothing is for the real-time cycle.

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
    AssessedCycle, Assessment, Assessor, Disturbance, DropReason, DroppedCycle, FoundBy, StabilityVerdict,
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
pub use transient::{Fate, TransientFollower};
