//! Stable numbers of all errors in a program.

/// Declares the enum, the stable text of each code, and the list of all codes.
macro_rules! codes {
    ($($(#[doc = $doc:literal])+ $name:ident = $text:literal,)+) => {
        /// An error, identified by a number whose meaning never changes. The hundreds are groups: 00 file, 01
        /// characters, 02 parameters, expressions and O-words, 03 words, 04 state, 05 arcs, 06 involutes, 07
        /// positions, 08 limits of the machine.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[non_exhaustive]
        pub enum Code {
            $($(#[doc = $doc])+ $name,)+
        }

        impl Code {
            /// Every code.
            pub const ALL: &'static [Self] = &[$(Self::$name,)+];

            /// Its meaning in one sentence.
            #[must_use]
            pub const fn meaning(self) -> &'static str {
                match self {
                    $(Self::$name => concat!($($doc),+),)+
                }
            }

            /// The code as shown to users and editors, such as `G0103`.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self {
                    $(Self::$name => $text,)+
                }
            }
        }
    };
}

codes! {
    /// A line is longer than [`ProgramLimits::max_line_bytes`](crate::ProgramLimits::max_line_bytes).
    LineTooLong = "G0001",
    /// The text could not be read.
    ReadFailed = "G0002",
    /// A `%` on a line that is neither the first nor the last.
    StrayPercent = "G0003",
    /// A carriage return inside a line.
    StrayReturn = "G0004",

    /// A character without meaning in RS274/NGC.
    UnexpectedCharacter = "G0101",
    /// A byte outside a comment that is not ASCII.
    NotAscii = "G0102",
    /// A letter without a number.
    NumberMissing = "G0103",
    /// A malformed number.
    BadNumber = "G0104",
    /// A number out of range for any machine.
    NumberTooLarge = "G0105",
    /// `(` without `)`.
    UnclosedComment = "G0106",
    /// `(` inside a comment.
    NestedComment = "G0107",
    /// `)` without `(`.
    StrayParenthesis = "G0108",
    /// N that is not the first word of the line.
    MisplacedLineNumber = "G0109",
    /// `/` that is not at the start of the line.
    MisplacedBlockDelete = "G0110",
    /// A number without a letter before it.
    LetterMissing = "G0111",

    /// The parameter does not exist.
    Parameter = "G0201",
    /// A malformed expression.
    Expression = "G0202",
    /// A malformed O-word.
    OWord = "G0203",
    /// `@` or `^` where they have no meaning.
    PolarCoordinates = "G0204",
    /// `$` with a spindle that does not exist, or `$-1` with a code of a single spindle.
    SpindleSelection = "G0205",
    /// A comment that aborts the program: `(ABORT, text)`.
    ActiveComment = "G0206",
    /// A read-only parameter.
    ReadOnlyParameter = "G0207",
    /// A named parameter that has not been set.
    UndefinedParameter = "G0208",
    /// An expression without a value: division by 0, root of a negative number.
    Arithmetic = "G0209",
    /// Brackets or subroutine calls nested too deeply.
    NestingTooDeep = "G0210",
    /// A malformed name of a parameter or subroutine.
    BadName = "G0211",
    /// The subroutine does not exist.
    SubroutineMissing = "G0212",
    /// The file of a subroutine cannot be read or is too large.
    SubroutineFile = "G0213",
    /// An O-word that does not match the preceding ones.
    OWordOrder = "G0214",
    /// The end of a loop, condition or subroutine is missing.
    OWordOpen = "G0215",
    /// The body of a loop or subroutine is too long to be stored, or a line gives too many commands.
    BodyTooLong = "G0216",
    /// Too many lines without a command for the machine, or lines with errors that loops repeat without end.
    TooManySteps = "G0217",
    /// The interpreter was interrupted.
    Interrupted = "G0218",
    /// The program cannot start at this line.
    RestartRefused = "G0219",

    /// The G code does not exist.
    UnknownG = "G0301",
    /// A G code that this kind of machine does not have.
    UnsupportedG = "G0302",
    /// The M code does not exist.
    UnknownM = "G0303",
    /// An M code of RS274/NGC that is not available yet.
    UnsupportedM = "G0304",
    /// The same word twice on one line.
    RepeatedWord = "G0305",
    /// Two codes of one modal group on one line.
    ModalGroup = "G0306",
    /// A word that no code on the line uses.
    UnusedWord = "G0307",
    /// A word for an axis that the machine does not have.
    NoSuchAxis = "G0308",
    /// Axis words without a motion that uses them.
    AxisWithoutMotion = "G0309",
    /// Two codes on one line that both use the axis words (or the same P).
    TwoUsers = "G0310",
    /// A value that must be an integer.
    NotInteger = "G0311",
    /// A value that must not be negative.
    Negative = "G0312",

    /// A feed move without a feed.
    FeedMissing = "G0401",
    /// A feed move at F0.
    FeedZero = "G0402",
    /// G93 requires F on every line.
    InverseTimeFeedMissing = "G0403",
    /// G95 requires a spindle speed.
    SpindleSpeedMissing = "G0404",
    /// G53 without G0 or G1.
    MachineCoordinatesMotion = "G0405",
    /// G53 together with G91.
    MachineCoordinatesIncremental = "G0406",
    /// G4 without P.
    DwellTimeMissing = "G0407",
    /// G92 without an axis word.
    OffsetAxesMissing = "G0408",
    /// M6 without a preceding T.
    ToolMissing = "G0409",

    /// The tool is not in the tool table.
    UnknownTool = "G0410",
    /// A word that a code requires is missing.
    WordMissing = "G0411",
    /// A value out of range.
    OutOfRange = "G0412",
    /// Not permitted while cutter compensation is on.
    CompensationActive = "G0413",
    /// Not available in the active plane.
    WrongPlane = "G0414",
    /// Not available in the active feed mode.
    WrongMode = "G0415",
    /// G5.2 and G5.3 do not match.
    SplineOpen = "G0416",
    /// M72 without saved modes.
    NothingSaved = "G0417",
    /// Not permitted in a tool change, or contradicted by the tool table.
    ToolChange = "G0418",

    /// An arc without I, J, K or R.
    ArcCentreMissing = "G0501",
    /// An arc with R and with I, J or K.
    ArcMixedFormat = "G0502",
    /// I, J or K perpendicular to the plane of the arc.
    ArcOffsetAcrossPlane = "G0503",
    /// An R arc that ends at its start.
    ArcNoChord = "G0504",
    /// R too small to reach the end.
    ArcRadiusTooSmall = "G0505",
    /// The end is not on the circle.
    ArcRadiusMismatch = "G0506",
    /// The radius is zero.
    ArcZeroRadius = "G0507",
    /// P is not a whole number of turns.
    ArcTurns = "G0508",
    /// An arc in radius format without an end point in its plane.
    ArcEndMissing = "G0509",
    /// G90.1 with only one centre word.
    ArcCentreIncomplete = "G0510",
    /// The geometry rejects the arc for another reason.
    ArcRefused = "G0511",

    /// An involute without an end point.
    InvoluteEndMissing = "G0601",
    /// An involute without the centre of its base circle.
    InvoluteCentreMissing = "G0602",
    /// An involute without a base radius above zero.
    InvoluteRadiusMissing = "G0603",
    /// The geometry rejects the involute for another reason.
    InvoluteRefused = "G0604",
    /// I, J or K perpendicular to the plane of the involute.
    InvoluteOffsetAcrossPlane = "G0605",
    /// Start or end inside the base circle.
    InvoluteInside = "G0606",
    /// Start and end at equal distances from the centre of the base circle.
    InvoluteEqualRadii = "G0607",
    /// Too many turns.
    InvoluteTurns = "G0608",
    /// The end is not on the involute.
    InvoluteMissed = "G0609",

    /// A position out of reach of any machine.
    PositionTooLarge = "G0701",
    /// The geometry rejects the line.
    LineRefused = "G0702",

    /// The geometry rejects the hole of G12.2 or G13.2.
    HoleRefused = "G0703",
    /// Cutter compensation: the first move is too short.
    CompensationEntry = "G0704",
    /// Cutter compensation: the tool does not fit the contour.
    CompensationGouge = "G0705",

    /// G70 to G72.2: the profile cannot be turned.
    ProfileRefused = "G0706",

    /// A move exceeds the travel of an axis.
    BeyondTravel = "G0801",
    /// The machine cannot do a move for another reason.
    MoveRefused = "G0802",
    /// A function that this machine does not have.
    MissingAbility = "G0803",
}

impl std::fmt::Display for Code {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(self.as_str())
    }
}
