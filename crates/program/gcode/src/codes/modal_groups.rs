//! Meaning and modal group of every G and M code.
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
    /// G5.
    CubicSpline,
    /// G5.1.
    QuadraticSpline,
    /// G5.2: adds a control point.
    Nurbs,
    /// G5.3: executes the NURBS.
    NurbsEnd,
    /// G12.2, G13.2.
    Hole(Sense),
    /// G33.
    Thread,
    /// G32 of Fanuc's dialect.
    FanucThread,
    /// G92 of Fanuc's dialect.
    FanucThreadCycle,
    /// G33.1.
    RigidTap,
    /// G38.2 to G38.5.
    Probe {
        /// Until contact is made; otherwise until it is lost.
        toward: bool,
        /// The program stops with an error if the probe does not trip.
        must: bool,
    },
    /// G73, G74, G81 to G89.
    Cycle(Cycle),
    /// G76.
    ThreadCycle,
    /// G82, G75 of a lathe.
    Turning(Turning),
    /// G70 to G72.2.
    Rough(Rough),
    /// G80.
    None,
}

/// Roughing and finishing cycles along a profile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Rough {
    /// Passes along X (G72) instead of Z.
    pub(crate) facing: bool,
    /// 0 everything, 1 without pockets, 2 only pockets.
    pub(crate) variant: u8,
    /// G70.
    pub(crate) finishing: bool,
}

/// Turning cycles of a lathe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Turning {
    /// G82.
    Longitudinal,
    /// G75.
    Facing,
}

/// Drilling cycles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Cycle {
    /// G73.
    ChipBreak,
    /// G74.
    TapLeft,
    /// G81.
    Drill,
    /// G82.
    DrillDwell,
    /// G83.
    Peck,
    /// G84.
    Tap,
    /// G85.
    BoreFeed,
    /// G86.
    BoreStop,
    /// G87.
    BackBore,
    /// G88.
    BoreManual,
    /// G89.
    BoreDwell,
}

impl Cycle {
    /// Whether it needs a rotating spindle, and stops or reverses it.
    pub(crate) fn uses_spindle(self) -> bool {
        matches!(
            self,
            Self::Tap | Self::TapLeft | Self::BoreStop | Self::BackBore | Self::BoreManual
        )
    }
}

impl Motion {
    /// Whether it uses a spindle, which `$` can name.
    pub(crate) fn uses_spindle(self) -> bool {
        match self {
            Self::Thread
            | Self::FanucThread
            | Self::FanucThreadCycle
            | Self::RigidTap
            | Self::ThreadCycle
            | Self::Turning(_) => true,
            Self::Cycle(cycle) => cycle.uses_spindle(),
            _ => false,
        }
    }

    /// Its name for messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Rapid => "G0",
            Self::Linear => "G1",
            Self::Arc(Sense::Clockwise) => "G2",
            Self::Arc(_) => "G3",
            Self::Involute(Sense::Clockwise) => "G2.2",
            Self::Involute(_) => "G3.2",
            Self::CubicSpline => "G5",
            Self::QuadraticSpline => "G5.1",
            Self::Nurbs => "G5.2",
            Self::NurbsEnd => "G5.3",
            Self::Hole(Sense::Clockwise) => "G12.2",
            Self::Hole(_) => "G13.2",
            Self::Thread => "G33",
            Self::FanucThread => "G32",
            Self::FanucThreadCycle => "G92",
            Self::RigidTap => "G33.1",
            Self::Probe {
                toward: true,
                must: true,
            } => "G38.2",
            Self::Probe {
                toward: true,
                must: false,
            } => "G38.3",
            Self::Probe {
                toward: false,
                must: true,
            } => "G38.4",
            Self::Probe {
                toward: false,
                must: false,
            } => "G38.5",
            Self::Cycle(cycle) => match cycle {
                Cycle::ChipBreak => "G73",
                Cycle::TapLeft => "G74",
                Cycle::Drill => "G81",
                Cycle::DrillDwell => "G82",
                Cycle::Peck => "G83",
                Cycle::Tap => "G84",
                Cycle::BoreFeed => "G85",
                Cycle::BoreStop => "G86",
                Cycle::BackBore => "G87",
                Cycle::BoreManual => "G88",
                Cycle::BoreDwell => "G89",
            },
            Self::ThreadCycle => "G76",
            Self::Turning(Turning::Longitudinal) => "G82",
            Self::Turning(Turning::Facing) => "G75",
            Self::Rough(rough) => match (rough.finishing, rough.facing, rough.variant) {
                (true, ..) => "G70",
                (_, false, 0) => "G71",
                (_, false, 1) => "G71.1",
                (_, false, _) => "G71.2",
                (_, true, 0) => "G72",
                (_, true, 1) => "G72.1",
                (_, true, _) => "G72.2",
            },
            Self::None => "G80",
        }
    }

    /// Its number in LinuxCNC's `#<_motion_mode>`: the code times ten.
    pub(crate) fn tenths(self) -> f64 {
        let number = self.name()[1..].parse::<f64>().unwrap_or(0.0);
        (number * 10.0).round()
    }

    /// Whether I, J, K or R without a code selects the motion.
    pub(crate) fn is_round(self) -> bool {
        matches!(self, Self::Arc(_) | Self::Involute(_))
    }
}

/// Non-modal codes, group 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NonModal {
    /// G4.
    Dwell,
    /// G10.
    SetData,
    /// G28, G30, with the first parameter of the stored position.
    Home(usize),
    /// G28.1, G30.1.
    SetHome(usize),
    /// G52.
    LocalOffset,
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

impl NonModal {
    /// Whether axis words on the line belong to it.
    pub(crate) fn uses_axes(self) -> bool {
        matches!(
            self,
            Self::SetData | Self::Home(_) | Self::LocalOffset | Self::SetOffset
        )
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Dwell => "G4",
            Self::SetData => "G10",
            Self::Home(crate::parameters::values::HOME_G28) => "G28",
            Self::Home(_) => "G30",
            Self::SetHome(crate::parameters::values::HOME_G28) => "G28.1",
            Self::SetHome(_) => "G30.1",
            Self::LocalOffset => "G52",
            Self::MachineCoordinates => "G53",
            Self::SetOffset => "G92",
            Self::ClearOffset => "G92.1",
            Self::SuspendOffset => "G92.2",
            Self::RestoreOffset => "G92.3",
        }
    }
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
    /// G43: offset of tool H, or of the tool in the spindle.
    Table,
    /// G43.1: offset given by the axis words.
    Dynamic,
    /// G43.2: offset of tool H, or of the axis words, added to the present one.
    Additional,
    /// G49.
    Off,
}

/// Path control, group 13. The tolerance of G64 is a separate word.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PathControl {
    /// G61.
    ExactPath,
    /// G61.1.
    ExactStop,
    /// G64.
    Blend,
}

/// Cutter compensation, group 7.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Compensation {
    /// G40.
    Off,
    /// G41, G42: the side of the path on which the tool is, and whether D is the number of a tool (G41) or a
    /// diameter (G41.1).
    On { left: bool, dynamic: bool },
}

/// Planes, group 2. Curves exist only in the first three.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PlaneCode {
    /// G17, G18, G19.
    Main(Plane),
    /// G17.1, G18.1, G19.1: UV, WU, VW.
    Secondary(Plane),
}

/// An executable G code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum GCode {
    NonModal(NonModal),
    Motion(Motion),
    Plane(PlaneCode),
    /// G90 (`false`), G91 (`true`).
    Incremental(bool),
    /// G91.1 (`false`), G90.1 (`true`).
    ArcCentreAbsolute(bool),
    FeedMode(FeedMode),
    /// G20 (`true`), G21 (`false`).
    Inches(bool),
    Compensation(Compensation),
    /// G43, G43.1, G43.2, G49.
    LengthOffset(LengthOffset),
    /// G54 to G59.3, from 0.
    WorkOffset(usize),
    Path(PathControl),
    /// G96 (`true`), G97 (`false`).
    ConstantSurfaceSpeed(bool),
    /// G98: retract to the initial height (`true`), G99: to R.
    RetractToInitial(bool),
    /// G7 (`true`), G8 (`false`).
    Diameter(bool),
}

/// Modal groups. A line may contain one code of each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Group {
    NonModal,
    /// G92.1, G92.2, G92.3: LinuxCNC permits them next to a code of group 0, and executes them after it.
    OffsetSwitch,
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
    Retract,
    Diameter,
    Stop,
    ToolChange,
    Spindle,
    Coolant,
    Override,
    InputOutput,
    Modes,
    User,
}

/// The number of groups.
pub(crate) const GROUPS: usize = Group::User as usize + 1;

impl Group {
    /// Its name for messages.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::NonModal => "non-modal codes",
            Self::OffsetSwitch => "codes for the offset of G92",
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
            Self::Retract => "retract modes",
            Self::Diameter => "diameter modes",
            Self::Stop => "stops and calls",
            Self::ToolChange => "tool changes",
            Self::Spindle => "spindle codes",
            Self::Coolant => "coolant codes",
            Self::Override => "override codes",
            Self::InputOutput => "input and output codes",
            Self::Modes => "codes that save or restore modes",
            Self::User => "user-defined codes",
        }
    }
}

impl GCode {
    /// The code with this number in tenths: 22 for G2.2.
    pub(crate) fn from_tenths(tenths: u32) -> Option<Self> {
        use crate::parameters::values::{HOME_G28, HOME_G30};
        let cycle = |cycle| Self::Motion(Motion::Cycle(cycle));
        Some(match tenths {
            0 => Self::Motion(Motion::Rapid),
            10 => Self::Motion(Motion::Linear),
            20 => Self::Motion(Motion::Arc(Sense::Clockwise)),
            22 => Self::Motion(Motion::Involute(Sense::Clockwise)),
            30 => Self::Motion(Motion::Arc(Sense::CounterClockwise)),
            32 => Self::Motion(Motion::Involute(Sense::CounterClockwise)),
            40 => Self::NonModal(NonModal::Dwell),
            50 => Self::Motion(Motion::CubicSpline),
            51 => Self::Motion(Motion::QuadraticSpline),
            52 => Self::Motion(Motion::Nurbs),
            53 => Self::Motion(Motion::NurbsEnd),
            70 => Self::Diameter(true),
            80 => Self::Diameter(false),
            100 => Self::NonModal(NonModal::SetData),
            122 => Self::Motion(Motion::Hole(Sense::Clockwise)),
            132 => Self::Motion(Motion::Hole(Sense::CounterClockwise)),
            170 => Self::Plane(PlaneCode::Main(Plane::Xy)),
            171 => Self::Plane(PlaneCode::Secondary(Plane::Xy)),
            180 => Self::Plane(PlaneCode::Main(Plane::Zx)),
            181 => Self::Plane(PlaneCode::Secondary(Plane::Zx)),
            190 => Self::Plane(PlaneCode::Main(Plane::Yz)),
            191 => Self::Plane(PlaneCode::Secondary(Plane::Yz)),
            200 => Self::Inches(true),
            210 => Self::Inches(false),
            280 => Self::NonModal(NonModal::Home(HOME_G28)),
            281 => Self::NonModal(NonModal::SetHome(HOME_G28)),
            300 => Self::NonModal(NonModal::Home(HOME_G30)),
            301 => Self::NonModal(NonModal::SetHome(HOME_G30)),
            330 => Self::Motion(Motion::Thread),
            331 => Self::Motion(Motion::RigidTap),
            382..=385 => Self::Motion(Motion::Probe {
                toward: tenths <= 383,
                must: tenths.is_multiple_of(2),
            }),
            400 => Self::Compensation(Compensation::Off),
            410 | 411 | 420 | 421 => Self::Compensation(Compensation::On {
                left: tenths < 420,
                dynamic: tenths % 10 == 1,
            }),
            430 => Self::LengthOffset(LengthOffset::Table),
            431 => Self::LengthOffset(LengthOffset::Dynamic),
            432 => Self::LengthOffset(LengthOffset::Additional),
            490 => Self::LengthOffset(LengthOffset::Off),
            520 => Self::NonModal(NonModal::LocalOffset),
            530 => Self::NonModal(NonModal::MachineCoordinates),
            540 | 550 | 560 | 570 | 580 | 590 => Self::WorkOffset((tenths / 10 - 54) as usize),
            591..=593 => Self::WorkOffset((tenths - 591 + 6) as usize),
            610 => Self::Path(PathControl::ExactPath),
            611 => Self::Path(PathControl::ExactStop),
            640 => Self::Path(PathControl::Blend),
            700 | 710..=712 | 720..=722 => Self::Motion(Motion::Rough(Rough {
                facing: tenths >= 720,
                variant: (tenths % 10) as u8,
                finishing: tenths == 700,
            })),
            730 => cycle(Cycle::ChipBreak),
            740 => cycle(Cycle::TapLeft),
            760 => Self::Motion(Motion::ThreadCycle),
            800 => Self::Motion(Motion::None),
            810 => cycle(Cycle::Drill),
            820 => cycle(Cycle::DrillDwell),
            830 => cycle(Cycle::Peck),
            840 => cycle(Cycle::Tap),
            850 => cycle(Cycle::BoreFeed),
            860 => cycle(Cycle::BoreStop),
            870 => cycle(Cycle::BackBore),
            880 => cycle(Cycle::BoreManual),
            890 => cycle(Cycle::BoreDwell),
            900 => Self::Incremental(false),
            901 => Self::ArcCentreAbsolute(true),
            910 => Self::Incremental(true),
            911 => Self::ArcCentreAbsolute(false),
            920 => Self::NonModal(NonModal::SetOffset),
            921 => Self::NonModal(NonModal::ClearOffset),
            922 => Self::NonModal(NonModal::SuspendOffset),
            923 => Self::NonModal(NonModal::RestoreOffset),
            930 => Self::FeedMode(FeedMode::InverseTime),
            940 => Self::FeedMode(FeedMode::PerMinute),
            950 => Self::FeedMode(FeedMode::PerRevolution),
            960 => Self::ConstantSurfaceSpeed(true),
            970 => Self::ConstantSurfaceSpeed(false),
            980 => Self::RetractToInitial(true),
            990 => Self::RetractToInitial(false),
            _ => return None,
        })
    }

    pub(crate) fn group(self) -> Group {
        match self {
            Self::NonModal(NonModal::ClearOffset | NonModal::SuspendOffset | NonModal::RestoreOffset) => {
                Group::OffsetSwitch
            }
            Self::NonModal(_) => Group::NonModal,
            Self::Motion(_) => Group::Motion,
            Self::Plane(_) => Group::Plane,
            Self::Incremental(_) => Group::Distance,
            Self::ArcCentreAbsolute(_) => Group::ArcDistance,
            Self::FeedMode(_) => Group::FeedMode,
            Self::Inches(_) => Group::Units,
            Self::Compensation(_) => Group::CutterCompensation,
            Self::LengthOffset(_) => Group::LengthOffset,
            Self::WorkOffset(_) => Group::WorkOffset,
            Self::Path(_) => Group::PathControl,
            Self::ConstantSurfaceSpeed(_) => Group::SpindleMode,
            Self::RetractToInitial(_) => Group::Retract,
            Self::Diameter(_) => Group::Diameter,
        }
    }
}

/// The code with this number in tenths, where a lathe differs.
pub(crate) fn lathe_code(tenths: u32) -> Option<GCode> {
    match tenths {
        750 => Some(GCode::Motion(Motion::Turning(Turning::Facing))),
        820 => Some(GCode::Motion(Motion::Turning(Turning::Longitudinal))),
        _ => None,
    }
}

/// A G code of Fanuc's threads, by its number in tenths, if `fanuc_threads` is set.
pub(crate) fn fanuc_code(tenths: u32) -> Option<GCode> {
    match tenths {
        320 => Some(GCode::Motion(Motion::FanucThread)),
        920 => Some(GCode::Motion(Motion::FanucThreadCycle)),
        _ => None,
    }
}

/// An executable M code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MCode {
    /// M0.
    Stop,
    /// M1.
    OptionalStop,
    /// M2 (`false`), M30 (`true`: with pallet change).
    End(bool),
    /// M60.
    PalletStop,
    /// M98.
    Call,
    /// M99.
    Return,
    /// M3.
    SpindleClockwise,
    /// M4.
    SpindleCounterClockwise,
    /// M5.
    SpindleStop,
    /// M19.
    SpindleOrient,
    /// M6.
    ToolChange,
    /// M61.
    ToolNumber,
    /// M7.
    Mist,
    /// M8.
    Flood,
    /// M9.
    CoolantOff,
    /// M48 (`true`), M49 (`false`).
    Overrides(bool),
    /// M50.
    FeedOverride,
    /// M51.
    SpindleOverride,
    /// M52.
    AdaptiveFeed,
    /// M53.
    FeedStop,
    /// M62 to M65.
    Output {
        /// Synchronised with motion instead of immediate.
        synchronised: bool,
        on: bool,
    },
    /// M66.
    Input,
    /// M67 (`true`: synchronised with motion), M68.
    AnalogOutput(bool),
    /// M70.
    SaveModes,
    /// M71.
    InvalidateModes,
    /// M72.
    RestoreModes,
    /// M73.
    SaveAndRestoreModes,
    /// M100 to M199.
    User(u32),
}

impl MCode {
    pub(crate) fn from_number(number: u32) -> Option<Self> {
        Some(match number {
            0 => Self::Stop,
            1 => Self::OptionalStop,
            2 => Self::End(false),
            3 => Self::SpindleClockwise,
            4 => Self::SpindleCounterClockwise,
            5 => Self::SpindleStop,
            6 => Self::ToolChange,
            7 => Self::Mist,
            8 => Self::Flood,
            9 => Self::CoolantOff,
            19 => Self::SpindleOrient,
            30 => Self::End(true),
            48 => Self::Overrides(true),
            49 => Self::Overrides(false),
            50 => Self::FeedOverride,
            51 => Self::SpindleOverride,
            52 => Self::AdaptiveFeed,
            53 => Self::FeedStop,
            60 => Self::PalletStop,
            61 => Self::ToolNumber,
            62..=65 => Self::Output {
                synchronised: number <= 63,
                on: number.is_multiple_of(2),
            },
            66 => Self::Input,
            67 => Self::AnalogOutput(true),
            68 => Self::AnalogOutput(false),
            70 => Self::SaveModes,
            71 => Self::InvalidateModes,
            72 => Self::RestoreModes,
            73 => Self::SaveAndRestoreModes,
            98 => Self::Call,
            99 => Self::Return,
            100..=199 => Self::User(number),
            _ => return None,
        })
    }

    pub(crate) fn group(self) -> Group {
        match self {
            Self::Stop | Self::OptionalStop | Self::End(_) | Self::PalletStop | Self::Call | Self::Return => {
                Group::Stop
            }
            Self::SpindleClockwise
            | Self::SpindleCounterClockwise
            | Self::SpindleStop
            | Self::SpindleOrient => Group::Spindle,
            Self::ToolChange | Self::ToolNumber => Group::ToolChange,
            Self::Mist | Self::Flood | Self::CoolantOff => Group::Coolant,
            Self::Overrides(_)
            | Self::FeedOverride
            | Self::SpindleOverride
            | Self::AdaptiveFeed
            | Self::FeedStop => Group::Override,
            Self::Output { .. } | Self::Input | Self::AnalogOutput(_) => Group::InputOutput,
            Self::SaveModes | Self::InvalidateModes | Self::RestoreModes | Self::SaveAndRestoreModes => {
                Group::Modes
            }
            Self::User(_) => Group::User,
        }
    }
}
