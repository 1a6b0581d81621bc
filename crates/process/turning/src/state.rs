//! States of self-programmed turning, and the reasons of transitions.

use crate::watch::SensorTrouble;

/// What the tool is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum TurningState {
    /// Before the first start.
    Idle = 0,
    /// Feeding towards stock that has not been felt yet.
    Approach = 1,
    /// In contact, with a depth that still grows along the lead angle.
    Engage = 2,
    /// The axial feed is stopped, and the tool moves out to a smaller depth.
    BackOff = 3,
    /// Cutting at a fixed height, at a feed that follows the load.
    Cut = 4,
    /// The position is too thin for this height: going out and back, to enter deeper.
    ReEnter = 5,
    /// Returning to the first position that is not at size.
    Return = 6,
    /// All stock is at size; the tool is back at the start.
    Done = 7,
    /// Held by the operator.
    Held = 8,
    /// The tool has been drawn out after a fault, or has stopped after one.
    Fault = 9,
    /// Climbing the cone at the end of a pass, at a feed that follows the load.
    Climb = 10,
}

impl TurningState {
    /// Its name in traces and reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Approach => "approach",
            Self::Engage => "engage",
            Self::BackOff => "back off",
            Self::Cut => "cut",
            Self::ReEnter => "re-enter",
            Self::Return => "return",
            Self::Done => "done",
            Self::Held => "held",
            Self::Fault => "fault",
            Self::Climb => "climb",
        }
    }
}

/// Why a state was left, with the numbers of the decision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reason {
    /// The start was requested.
    Started,
    /// The tool is at the start of the pass.
    InPlace,
    /// The load has risen above the threshold of contact.
    Contact {
        /// Load.
        load: f64,
    },
    /// The depth has stopped growing.
    Settled {
        /// Depth, mm.
        depth_mm: f64,
    },
    /// The depth is more than the smallest feed can take, or more than should be taken at once.
    TooDeep {
        /// Depth, mm.
        depth_mm: f64,
        /// The limit, mm.
        limit_mm: f64,
    },
    /// The position of the contact with the face gave the height of the stock.
    FaceFelt {
        /// Height of the stock, mm.
        height_mm: f64,
    },
    /// The tool has moved out to the intended height.
    AtDepth {
        /// Height of the tip, mm.
        out_mm: f64,
    },
    /// The depth is too small for the largest feed, and there is more stock below.
    TooThin {
        /// Depth, mm.
        depth_mm: f64,
    },
    /// No load for more than a revolution: a gap in the stock.
    Air,
    /// The end of the cut.
    EndOfPass,
    /// The pass has met the cone.
    ConeReached,
    /// There is no stock above the final size.
    AtSize,
    /// The operator's hold, or its end.
    Hold,
    /// The readings of the sensor are implausible.
    Sensor(SensorTrouble),
    /// The load exceeded the overload limit for too long.
    Overload {
        /// Load.
        load: f64,
        /// Limit.
        limit: f64,
    },
    /// The load vanished inside known stock.
    BrokenInsert {
        /// Load before.
        before: f64,
        /// Expected depth, mm.
        depth_mm: f64,
    },
    /// The stock is higher than the cutting edge reaches.
    StockTooThick {
        /// Height felt, mm.
        height_mm: f64,
        /// Maximum depth of the edge, mm.
        reach_mm: f64,
    },
    /// The load vanished within a pass and did not return by the end of the job.
    LoadStaysAway {
        /// Position at which it was felt last, mm along the cut.
        along_mm: f64,
    },
    /// A whole pass at the final size without any load.
    NoStock,
    /// Too many passes.
    TooManyPasses,
}

impl Reason {
    /// A sentence for the operator: what happened, and what to do if anything can be done.
    #[must_use]
    pub fn text(&self) -> String {
        match *self {
            Self::Started => "started".into(),
            Self::InPlace => "in place for the pass".into(),
            Self::Contact { load } => format!("the load rose to {load:.0}: contact"),
            Self::Settled { depth_mm } => format!("the depth has settled at {depth_mm:.2} mm"),
            Self::TooDeep { depth_mm, limit_mm } => {
                format!(
                    "a depth of {depth_mm:.2} mm is more than the {limit_mm:.2} mm that are taken at \
                         once"
                )
            }
            Self::FaceFelt { height_mm } => format!("the face was felt: {height_mm:.2} mm of stock"),
            Self::AtDepth { out_mm } => format!("backed off to {out_mm:.2} mm above the final size"),
            Self::TooThin { depth_mm } => format!("only {depth_mm:.2} mm deep at the largest feed"),
            Self::Air => "no load for more than a revolution: a gap".into(),
            Self::EndOfPass => "end of the pass".into(),
            Self::ConeReached => "the pass has met the cone".into(),
            Self::AtSize => "everything is at size".into(),
            Self::Hold => "feed hold".into(),
            Self::Sensor(trouble) => {
                let what = match trouble {
                    SensorTrouble::Silent => "gives no new readings in time",
                    SensorTrouble::NotANumber => "gives readings that are no numbers",
                    SensorTrouble::Saturated => "stands at the end of its range",
                    SensorTrouble::Frozen => "repeats the same reading",
                    SensorTrouble::Negative => "reads far below zero",
                };
                format!(
                    "the load sensor {what}: the feed was stopped; look at the sensor, its cable and \
                         its bridge, then start again"
                )
            }
            Self::Overload { load, limit } => format!(
                "the load was {load:.0}, above the limit of {limit:.0}: the tool was drawn out; look at the \
                 insert and the stock, then start again"
            ),
            Self::BrokenInsert { before, depth_mm } => format!(
                "the load of {before:.0} went away where {depth_mm:.2} mm should be cut: the insert may be \
                 broken, or the sensor reads nothing; look at both, then start again"
            ),
            Self::StockTooThick { height_mm, reach_mm } => format!(
                "the stock stands {height_mm:.1} mm above the final size, and the edge reaches \
                 {reach_mm:.1} mm: rough it down first, or take a longer edge"
            ),
            Self::LoadStaysAway { along_mm } => format!(
                "the load went away {along_mm:.1} mm along the cut and never came back, so it is not known \
                 whether anything was cut behind: look at the insert, the sensor and the part, then start \
                 again"
            ),
            Self::NoStock => {
                "a whole pass at the final size met no stock: see whether there is any, and whether the \
                 load sensor shows anything"
                    .into()
            }
            Self::TooManyPasses => "more passes were needed than make sense: see whether the sensor and the \
                 force law fit the material"
                .into(),
        }
    }
}

/// One change of state. The cycle copies it out without allocation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transition {
    /// Cycle in which it happened, from 0.
    pub cycle: u64,
    /// State that was left.
    pub from: TurningState,
    /// State that was entered.
    pub to: TurningState,
    /// Why.
    pub reason: Reason,
    /// Position along the cut, mm.
    pub along_mm: f64,
    /// Height of the tip above the final size, mm.
    pub out_mm: f64,
    /// Present load.
    pub load: f64,
    /// Present feed, mm/rev.
    pub feed_mm_rev: f64,
    /// Depth that the feed is based on, mm.
    pub depth_mm: f64,
    /// Number of the pass, from 1.
    pub pass: u32,
}
