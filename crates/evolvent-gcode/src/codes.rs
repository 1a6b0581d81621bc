//! G and M numbers to what they mean, and the modal groups they belong to.
//!
//! RS274/NGC, table 4 (NISTIR 6556), with LinuxCNC's additions.

use evolvent_path::{Plane, Sense};

/// Motion modes, group 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Motion {
    /// G0.
    Rapid,
    /// G1.
    Linear,
    /// G2, G3.
    Arc(Sense),
    /// G2.2, G3.2.
    Involute(Sense),
    /// G80.
    None,
}

impl Motion {
    /// As written, for messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Rapid => "G0",
            Self::Linear => "G1",
            Self::Arc(Sense::Clockwise) => "G2",
            Self::Arc(_) => "G3",
            Self::Involute(Sense::Clockwise) => "G2.2",
            Self::Involute(_) => "G3.2",
            Self::None => "G80",
        }
    }

    /// Whether I, J, K or R belong to the motion.
    pub(crate) fn is_round(self) -> bool {
        matches!(self, Self::Arc(_) | Self::Involute(_))
    }
}

/// Codes of group 0: they act once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Once {
    /// G4.
    Dwell,
    /// G53.
    MachineCoordinates,
    /// G92.
    SetOffset,
    /// G92.1.
    ClearOffset,
    /// G92.2.
    SuspendOffset,
    /// G92.3.
    RestoreOffset,
}

/// Feed modes, group 5.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FeedMode {
    /// G93.
    InverseTime,
    /// G94.
    PerMinute,
    /// G95.
    PerRevolution,
}

/// Tool length offset, group 8.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LengthOffset {
    /// G43: of the tool H, or of the tool in the spindle.
    Table,
    /// G43.1: the axis words.
    Given,
    /// G43.2: of the tool H, or the axis words, on top of what is in force.
    Added,
    /// G49.
    Off,
}

/// Path control, group 13; the tolerance of G64 is a word of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PathControl {
    /// G61.
    ExactPath,
    /// G61.1.
    ExactStop,
    /// G64.
    Blend,
}

/// A G code that can be executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum GCode {
    Once(Once),
    Motion(Motion),
    Plane(Plane),
    /// G90 (`false`), G91 (`true`).
    Incremental(bool),
    /// G91.1 (`false`), G90.1 (`true`).
    ArcCentreAbsolute(bool),
    FeedMode(FeedMode),
    /// G20 (`true`), G21 (`false`).
    Inches(bool),
    /// G40: never on, so nothing to cancel.
    CutterCompensationOff,
    /// G43, G43.1, G43.2, G49.
    LengthOffset(LengthOffset),
    /// G54 to G59.3, from 0.
    WorkOffset(usize),
    Path(PathControl),
    /// G97: the only spindle mode there is.
    SpindleRpm,
}

/// Modal groups. A line may hold one code of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Group {
    Once,
    Motion,
    Plane,
    Distance,
    ArcDistance,
    FeedMode,
    Units,
    CutterCompensation,
    LengthOffset,
    WorkOffset,
    PathControl,
    SpindleMode,
    Stop,
    ToolChange,
    Spindle,
    Coolant,
}

/// How many groups there are.
pub(crate) const GROUPS: usize = Group::Coolant as usize + 1;

impl Group {
    /// For messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Once => "codes that act once",
            Self::Motion => "motion codes",
            Self::Plane => "plane codes",
            Self::Distance => "distance modes",
            Self::ArcDistance => "arc distance modes",
            Self::FeedMode => "feed modes",
            Self::Units => "units",
            Self::CutterCompensation => "cutter compensation codes",
            Self::LengthOffset => "tool length codes",
            Self::WorkOffset => "work offsets",
            Self::PathControl => "path control modes",
            Self::SpindleMode => "spindle modes",
            Self::Stop => "stops",
            Self::ToolChange => "tool changes",
            Self::Spindle => "spindle codes",
            Self::Coolant => "coolant codes",
        }
    }
}

impl GCode {
    /// The code of a number in tenths: 22 for G2.2.
    pub(crate) fn from_tenths(tenths: u32) -> Option<Self> {
        Some(match tenths {
            0 => Self::Motion(Motion::Rapid),
            10 => Self::Motion(Motion::Linear),
            20 => Self::Motion(Motion::Arc(Sense::Clockwise)),
            22 => Self::Motion(Motion::Involute(Sense::Clockwise)),
            30 => Self::Motion(Motion::Arc(Sense::CounterClockwise)),
            32 => Self::Motion(Motion::Involute(Sense::CounterClockwise)),
            40 => Self::Once(Once::Dwell),
            170 => Self::Plane(Plane::Xy),
            180 => Self::Plane(Plane::Zx),
            190 => Self::Plane(Plane::Yz),
            200 => Self::Inches(true),
            210 => Self::Inches(false),
            400 => Self::CutterCompensationOff,
            430 => Self::LengthOffset(LengthOffset::Table),
            431 => Self::LengthOffset(LengthOffset::Given),
            432 => Self::LengthOffset(LengthOffset::Added),
            490 => Self::LengthOffset(LengthOffset::Off),
            530 => Self::Once(Once::MachineCoordinates),
            540 | 550 | 560 | 570 | 580 | 590 => Self::WorkOffset((tenths / 10 - 54) as usize),
            591..=593 => Self::WorkOffset((tenths - 591 + 6) as usize),
            610 => Self::Path(PathControl::ExactPath),
            611 => Self::Path(PathControl::ExactStop),
            640 => Self::Path(PathControl::Blend),
            800 => Self::Motion(Motion::None),
            900 => Self::Incremental(false),
            901 => Self::ArcCentreAbsolute(true),
            910 => Self::Incremental(true),
            911 => Self::ArcCentreAbsolute(false),
            920 => Self::Once(Once::SetOffset),
            921 => Self::Once(Once::ClearOffset),
            922 => Self::Once(Once::SuspendOffset),
            923 => Self::Once(Once::RestoreOffset),
            930 => Self::FeedMode(FeedMode::InverseTime),
            940 => Self::FeedMode(FeedMode::PerMinute),
            950 => Self::FeedMode(FeedMode::PerRevolution),
            970 => Self::SpindleRpm,
            _ => return None,
        })
    }

    pub(crate) fn group(self) -> Group {
        match self {
            Self::Once(_) => Group::Once,
            Self::Motion(_) => Group::Motion,
            Self::Plane(_) => Group::Plane,
            Self::Incremental(_) => Group::Distance,
            Self::ArcCentreAbsolute(_) => Group::ArcDistance,
            Self::FeedMode(_) => Group::FeedMode,
            Self::Inches(_) => Group::Units,
            Self::CutterCompensationOff => Group::CutterCompensation,
            Self::LengthOffset(_) => Group::LengthOffset,
            Self::WorkOffset(_) => Group::WorkOffset,
            Self::Path(_) => Group::PathControl,
            Self::SpindleRpm => Group::SpindleMode,
        }
    }
}

/// Whether LinuxCNC's dialect has this G code, in tenths, though it cannot be executed here yet.
pub(crate) fn is_g_of_the_dialect(tenths: u32) -> bool {
    matches!(
        tenths,
        50..=53
            | 70
            | 80
            | 100
            | 171
            | 181
            | 191
            | 280
            | 281
            | 300
            | 301
            | 330
            | 331
            | 382..=385
            | 410
            | 411
            | 420
            | 421
            | 520
            | 700
            | 701
            | 702
            | 710..=712
            | 720..=722
            | 730
            | 740
            | 750
            | 760
            | 810
            | 820
            | 830
            | 840
            | 850
            | 860
            | 870
            | 880
            | 890
            | 960
            | 980
            | 990
    )
}

/// An M code that can be executed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MCode {
    /// M0.
    Stop,
    /// M1.
    OptionalStop,
    /// M2, M30.
    End,
    /// M60.
    PalletStop,
    /// M3.
    SpindleClockwise,
    /// M4.
    SpindleCounterClockwise,
    /// M5.
    SpindleStop,
    /// M6.
    ToolChange,
    /// M7.
    Mist,
    /// M8.
    Flood,
    /// M9.
    CoolantOff,
}

impl MCode {
    pub(crate) fn from_number(number: u32) -> Option<Self> {
        Some(match number {
            0 => Self::Stop,
            1 => Self::OptionalStop,
            2 | 30 => Self::End,
            3 => Self::SpindleClockwise,
            4 => Self::SpindleCounterClockwise,
            5 => Self::SpindleStop,
            6 => Self::ToolChange,
            7 => Self::Mist,
            8 => Self::Flood,
            9 => Self::CoolantOff,
            60 => Self::PalletStop,
            _ => return None,
        })
    }

    pub(crate) fn group(self) -> Group {
        match self {
            Self::Stop | Self::OptionalStop | Self::End | Self::PalletStop => Group::Stop,
            Self::SpindleClockwise | Self::SpindleCounterClockwise | Self::SpindleStop => Group::Spindle,
            Self::ToolChange => Group::ToolChange,
            Self::Mist | Self::Flood | Self::CoolantOff => Group::Coolant,
        }
    }
}

/// Whether LinuxCNC's dialect has this M code, though it cannot be executed here yet.
pub(crate) fn is_m_of_the_dialect(number: u32) -> bool {
    matches!(number, 19 | 48..=53 | 61..=68 | 70..=73 | 98 | 99 | 100..=199)
}
