//! Cutting force over speed, depth of cut and feed.
//!
//! [`ForceLaw::force`] returns the tangential force of a [`Cut`] with its partial derivatives, or the reason
//! why there is none. There are three kinds of law: a power law, a table of measured forces, and a rational
//! law with a falling section (the reconstruction "40X-R1" of steel 40X). A law is data: a [`LawDefinition`]
//! is read from a TOML file ([`LawDefinition::parse`]) or is built in ([`LawDefinition::built_in`]), and
//! becomes a law for the angles of a [`ToolAngles`].
//!
//! ```
//! use evolvent_cutting::{Cut, LawDefinition, ToolAngles};
//! let steel = LawDefinition::built_in("40X-R1").ok_or("no such law")?;
//! let law = steel.law(ToolAngles { rake_deg: 10.0, lead_deg: 60.0 })?;
//! let force = law.force(Cut { speed_m_min: 60.0, depth_mm: 4.0, feed_mm_rev: 0.49 })?;
//! assert!((force.tangential_n - 3430.036).abs() < 1e-3 && force.per_speed < 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! For many speeds and depths at one feed, use [`ForceLaw::section`]. Evaluation neither allocates nor reads
//! a clock, and gives the same bits on every host (`libm`): the real-time cycle may call it. Reading files
//! and creating laws is for start-up.
//!
//! No law extrapolates silently: [`ForceLaw::covers`] says whether a cut is within the range of the data.

mod error;
mod file;
mod fixed_power;
mod force;
mod law;
mod power;
mod rational;
mod table;

pub use error::{ForceError, LawError};
pub use file::{LawDefinition, law_schema};
pub use force::{Cut, Force, SectionForce, ToolAngles};
pub use law::{Covered, ForceLaw, Section};
pub use power::PowerLaw;
pub use rational::{RationalCoefficients, RationalLaw};
pub use table::ForceTable;
