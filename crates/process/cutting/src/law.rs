//! A force law of any kind.

use crate::error::ForceError;
use crate::fixed_power::FixedPower;
use crate::force::{Cut, Force, SectionForce};
use crate::power::PowerLaw;
use crate::rational::{RationalLaw, RationalSection};
use crate::table::{ForceTable, Weights};

/// Range of the data of a law: minimum and maximum speed (m/min), depth (mm) and feed (mm/rev).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covered {
    /// m/min.
    pub speed_m_min: [f64; 2],
    /// mm.
    pub depth_mm: [f64; 2],
    /// mm/rev.
    pub feed_mm_rev: [f64; 2],
}

impl Default for Covered {
    /// Every positive number.
    fn default() -> Self {
        let all = [0.0, f64::INFINITY];
        Self {
            speed_m_min: all,
            depth_mm: all,
            feed_mm_rev: all,
        }
    }
}

/// A force law for a material and a tool.
///
/// ```
/// use evolvent_cutting::{Cut, LawDefinition, ToolAngles};
/// let steel = LawDefinition::built_in("40X-R1").ok_or("no such law")?;
/// let law = steel.law(ToolAngles { rake_deg: 10.0, lead_deg: 60.0 })?;
/// // One feed, many speeds: the force falls where chatter begins.
/// let section = law.section(0.49)?;
/// assert!(section.force(60.0, 4.0)?.tangential_n > section.force(90.0, 4.0)?.tangential_n);
/// // A cut that cannot be is an error, never a number.
/// assert!(law.force(Cut { speed_m_min: 0.0, depth_mm: 4.0, feed_mm_rev: 0.49 }).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ForceLaw {
    kind: Kind,
    radial_ratio: f64,
    covered: Covered,
}

#[derive(Clone, Debug, PartialEq)]
enum Kind {
    Power(PowerLaw, [FixedPower; 2]),
    Rational(RationalLaw, FixedPower),
    Table(ForceTable),
}

/// A law at a fixed feed, for many speeds and depths.
#[derive(Clone, Copy, Debug)]
pub struct Section<'a> {
    kind: SectionKind<'a>,
}

#[derive(Clone, Copy, Debug)]
enum SectionKind<'a> {
    Power(&'a PowerLaw, &'a [FixedPower; 2], f64),
    Rational(RationalSection<'a>),
    Table(&'a ForceTable, Weights),
}

impl From<PowerLaw> for ForceLaw {
    fn from(law: PowerLaw) -> Self {
        Self::of(Kind::Power(law, law.powers()))
    }
}

impl From<RationalLaw> for ForceLaw {
    fn from(law: RationalLaw) -> Self {
        Self::of(Kind::Rational(law, law.depth_power()))
    }
}

impl From<ForceTable> for ForceLaw {
    fn from(table: ForceTable) -> Self {
        Self::of(Kind::Table(table))
    }
}

impl ForceLaw {
    /// Radial force over tangential force (Py / Pz) if nothing else is known. Assumed, not measured.
    pub const ASSUMED_RADIAL_RATIO: f64 = 0.4;

    fn of(kind: Kind) -> Self {
        Self {
            kind,
            radial_ratio: Self::ASSUMED_RADIAL_RATIO,
            covered: Covered::default(),
        }
    }

    /// The same law with another ratio of radial to tangential force, and with the range of its data.
    #[must_use]
    pub fn with(self, radial_ratio: f64, covered: Covered) -> Self {
        Self {
            radial_ratio,
            covered,
            ..self
        }
    }

    /// Radial force over tangential force, Py / Pz.
    #[must_use]
    pub fn radial_ratio(&self) -> f64 {
        self.radial_ratio
    }

    /// The range of the data.
    #[must_use]
    pub fn covered(&self) -> &Covered {
        &self.covered
    }

    /// Whether the cut is within the range of the data; otherwise its force is extrapolated. The cycle may
    /// call it.
    #[must_use]
    pub fn covers(&self, cut: Cut) -> bool {
        let within = |range: [f64; 2], value: f64| (range[0]..=range[1]).contains(&value);
        within(self.covered.speed_m_min, cut.speed_m_min)
            && within(self.covered.depth_mm, cut.depth_mm)
            && within(self.covered.feed_mm_rev, cut.feed_mm_rev)
    }

    /// The power law, if it is one: its inverses are closed forms.
    #[must_use]
    pub fn power(&self) -> Option<&PowerLaw> {
        match &self.kind {
            Kind::Power(law, _) => Some(law),
            _ => None,
        }
    }

    /// The force of a cut with all derivatives. The cycle may call it.
    ///
    /// # Errors
    /// Speed, depth or feed that is not positive; a pole; a cut outside a table; a law that gives a negative
    /// force.
    pub fn force(&self, cut: Cut) -> Result<Force, ForceError> {
        let section = self.section(cut.feed_mm_rev)?;
        let force = section.force(cut.speed_m_min, cut.depth_mm)?;
        let (feed, speed, depth) = (cut.feed_mm_rev, cut.speed_m_min, cut.depth_mm);
        let per_feed = match (&self.kind, &section.kind) {
            (Kind::Rational(law, _), SectionKind::Rational(section)) => {
                law.per_feed(section, feed, speed, depth)
            }
            (Kind::Table(table), SectionKind::Table(_, weights)) => {
                table.per_feed(weights, feed, speed, depth)?
            }
            (Kind::Power(law, _), _) => force.tangential_n * law.feed_exponent / feed,
            _ => f64::NAN,
        };
        Ok(Force {
            tangential_n: force.tangential_n,
            per_speed: force.per_speed,
            per_depth: force.per_depth,
            per_feed,
        })
    }

    /// The law at a feed in mm/rev. The cycle may call it.
    ///
    /// # Errors
    /// A feed that is not positive or outside a table; a pole at this feed.
    pub fn section(&self, feed_mm_rev: f64) -> Result<Section<'_>, ForceError> {
        if !(feed_mm_rev > 0.0 && feed_mm_rev.is_finite()) {
            return Err(ForceError::Feed { feed_mm_rev });
        }
        let kind = match &self.kind {
            Kind::Power(law, powers) => SectionKind::Power(law, powers, law.at_feed(feed_mm_rev)),
            Kind::Rational(law, power) => SectionKind::Rational(law.at_feed(feed_mm_rev, power)?),
            Kind::Table(table) => SectionKind::Table(table, table.at_feed(feed_mm_rev)?),
        };
        Ok(Section { kind })
    }
}

impl Section<'_> {
    /// Force at a speed in m/min and a depth in mm, with its derivatives. The cycle may call it.
    ///
    /// # Errors
    /// Speed or depth that is not positive or outside a table; a law that gives a negative force.
    pub fn force(&self, speed_m_min: f64, depth_mm: f64) -> Result<SectionForce, ForceError> {
        positive(speed_m_min, depth_mm)?;
        let force = match &self.kind {
            SectionKind::Power(law, powers, at_feed) => law.force(*at_feed, powers, speed_m_min, depth_mm),
            SectionKind::Rational(section) => section.force(speed_m_min, depth_mm),
            SectionKind::Table(table, weights) => table.force(weights, speed_m_min, depth_mm)?,
        };
        not_negative(force.tangential_n, speed_m_min, depth_mm)?;
        Ok(force)
    }

    /// The force of [`Section::force`] without its derivatives, N, at less cost. The cycle may call it.
    ///
    /// # Errors
    /// As [`Section::force`].
    pub fn tangential_n(&self, speed_m_min: f64, depth_mm: f64) -> Result<f64, ForceError> {
        positive(speed_m_min, depth_mm)?;
        let force = match &self.kind {
            SectionKind::Power(_, powers, at_feed) => {
                PowerLaw::tangential_n(*at_feed, powers, speed_m_min, depth_mm)
            }
            SectionKind::Rational(section) => section.tangential_n(speed_m_min, depth_mm),
            SectionKind::Table(table, weights) => table.force(weights, speed_m_min, depth_mm)?.tangential_n,
        };
        not_negative(force, speed_m_min, depth_mm)
    }
}

fn positive(speed_m_min: f64, depth_mm: f64) -> Result<(), ForceError> {
    if !(speed_m_min > 0.0 && speed_m_min.is_finite()) {
        return Err(ForceError::Speed { speed_m_min });
    }
    if !(depth_mm > 0.0 && depth_mm.is_finite()) {
        return Err(ForceError::Depth { depth_mm });
    }
    Ok(())
}

fn not_negative(tangential_n: f64, speed_m_min: f64, depth_mm: f64) -> Result<f64, ForceError> {
    if tangential_n >= 0.0 && tangential_n.is_finite() {
        return Ok(tangential_n);
    }
    Err(ForceError::Negative {
        tangential_n,
        speed_m_min,
        depth_mm,
    })
}
