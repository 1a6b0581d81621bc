//! The stable numbers of everything that can be wrong with a program.

/// Declares the enum, the stable text of each code and a list of all of them.
macro_rules! codes {
    ($($(#[doc = $doc:literal])+ $name:ident = $text:literal,)+) => {
        /// What is wrong, by a number that never changes its meaning. Numbers of one hundred belong together:
        /// 00 the file, 01 characters, 02 parameters, formulas, O-words, 03 words, 04 state,
        /// 05 arcs, 06 involutes, 07 positions, 08 what the machine refuses.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[non_exhaustive]
        pub enum Code {
            $($(#[doc = $doc])+ $name,)+
        }

        impl Code {
            /// Every code.
            pub const ALL: &'static [Self] = &[$(Self::$name,)+];

            /// What it means, in one sentence.
            #[must_use]
            pub const fn meaning(self) -> &'static str {
                match self {
                    $(Self::$name => concat!($($doc),+),)+
                }
            }

            /// The code as people and editors see it, such as `G0103`.
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
    /// A line is longer than [`Settings::max_line_bytes`](crate::Settings::max_line_bytes).
    LineTooLong = "G0001",
    /// The text could not be read.
    ReadFailed = "G0002",
    /// A `%` that is neither the first nor the last line.
    StrayPercent = "G0003",
    /// A carriage return inside a line.
    StrayReturn = "G0004",

    /// A character that means nothing in RS274/NGC.
    UnexpectedCharacter = "G0101",
    /// A byte outside a comment that is not ASCII.
    NotAscii = "G0102",
    /// A letter without a number.
    NumberMissing = "G0103",
    /// A number that is none.
    BadNumber = "G0104",
    /// A number too large for any machine.
    NumberTooLarge = "G0105",
    /// `(` without `)`.
    UnclosedComment = "G0106",
    /// `(` inside a comment.
    NestedComment = "G0107",
    /// `)` without `(`.
    StrayParenthesis = "G0108",
    /// N somewhere else than at the beginning.
    MisplacedLineNumber = "G0109",
    /// `/` somewhere else than at the beginning.
    MisplacedBlockDelete = "G0110",
    /// A number without a letter before it.
    LetterMissing = "G0111",

    /// No such parameter.
    Parameter = "G0201",
    /// A formula that is none.
    Expression = "G0202",
    /// An O-word that is none.
    OWord = "G0203",
    /// `@` and `^` where they have no meaning.
    PolarCoordinates = "G0204",
    /// `$` with a spindle that does not exist.
    SpindleSelection = "G0205",
    /// A comment that ends the program: `(ABORT, text)`.
    ActiveComment = "G0206",
    /// A parameter that a program cannot write.
    ReadOnlyParameter = "G0207",
    /// A named parameter that has not been set.
    UndefinedParameter = "G0208",
    /// A formula without a value: division by 0, root of a negative number.
    Arithmetic = "G0209",
    /// Brackets or subroutines nested too deep.
    NestingTooDeep = "G0210",
    /// The name of a parameter or subroutine that is none.
    BadName = "G0211",
    /// No subroutine of this name.
    SubroutineMissing = "G0212",
    /// A file of a subroutine that cannot be read or is too large.
    SubroutineFile = "G0213",
    /// An O-word that does not go with those before it.
    OWordOrder = "G0214",
    /// The end of a loop, condition or subroutine is missing.
    OWordOpen = "G0215",
    /// The body of a loop or subroutine is too long to be kept, or a line gives too many commands.
    BodyTooLong = "G0216",
    /// Too many lines without anything to do for the machine, or lines with errors that loops repeat without end.
    TooManySteps = "G0217",
    /// The interpreter was told to stop.
    Interrupted = "G0218",
    /// A program cannot begin at this line.
    RestartRefused = "G0219",

    /// No such G code.
    UnknownG = "G0301",
    /// A G code that this kind of machine does not have.
    UnsupportedG = "G0302",
    /// No such M code.
    UnknownM = "G0303",
    /// An M code of RS274/NGC that is not available yet.
    UnsupportedM = "G0304",
    /// The same word twice on a line.
    RepeatedWord = "G0305",
    /// Two codes of one modal group on a line.
    ModalGroup = "G0306",
    /// A word that nothing on the line uses.
    UnusedWord = "G0307",
    /// A word for an axis that the machine does not have.
    NoSuchAxis = "G0308",
    /// Axis words, but no motion that uses them.
    AxisWithoutMotion = "G0309",
    /// Two codes on a line that both want the axis words (or the same P).
    TwoUsers = "G0310",
    /// A value that must be a whole number.
    NotInteger = "G0311",
    /// A value that must not be negative.
    Negative = "G0312",

    /// A feed move, but F has never been given.
    FeedMissing = "G0401",
    /// A feed move at F0.
    FeedZero = "G0402",
    /// G93 needs F on every line.
    InverseTimeFeedMissing = "G0403",
    /// G95 needs a spindle speed.
    SpindleSpeedMissing = "G0404",
    /// G53 without G0 or G1.
    MachineCoordinatesMotion = "G0405",
    /// G53 together with G91.
    MachineCoordinatesIncremental = "G0406",
    /// G4 without P.
    DwellTimeMissing = "G0407",
    /// G92 without an axis word.
    OffsetAxesMissing = "G0408",
    /// M6, but T has never been given.
    ToolMissing = "G0409",

    /// A tool that the tool table does not have.
    UnknownTool = "G0410",
    /// A word that a code needs is missing.
    WordMissing = "G0411",
    /// A value outside of what makes sense.
    OutOfRange = "G0412",
    /// Something that does not go while cutter compensation is on.
    CompensationActive = "G0413",
    /// Not in the plane in force.
    WrongPlane = "G0414",
    /// Not in the feed mode in force.
    WrongMode = "G0415",
    /// G5.2 and G5.3 do not fit.
    SplineOpen = "G0416",
    /// M72 without modes that were saved.
    NothingSaved = "G0417",
    /// What cannot be in a tool change, or the tool table contradicts it.
    ToolChange = "G0418",

    /// An arc without I, J, K or R.
    ArcCentreMissing = "G0501",
    /// An arc with R and with I, J or K.
    ArcMixedFormat = "G0502",
    /// I, J or K across the plane of the arc.
    ArcOffsetAcrossPlane = "G0503",
    /// R arc that ends where it starts.
    ArcNoChord = "G0504",
    /// R too small to reach the end.
    ArcRadiusTooSmall = "G0505",
    /// The end is not on the circle.
    ArcRadiusMismatch = "G0506",
    /// Radius nought.
    ArcZeroRadius = "G0507",
    /// P is not a whole number of turns.
    ArcTurns = "G0508",
    /// Arc in radius format without an end in its plane.
    ArcEndMissing = "G0509",
    /// G90.1 with only one centre word.
    ArcCentreIncomplete = "G0510",
    /// The geometry refuses the arc for another reason.
    ArcRefused = "G0511",

    /// Involute without an end.
    InvoluteEndMissing = "G0601",
    /// Involute without the base circle's centre.
    InvoluteCentreMissing = "G0602",
    /// Involute without a base radius above nought.
    InvoluteRadiusMissing = "G0603",
    /// The geometry refuses the involute for another reason.
    InvoluteRefused = "G0604",
    /// I, J or K across the plane of the involute.
    InvoluteOffsetAcrossPlane = "G0605",
    /// Start or end inside the base circle.
    InvoluteInside = "G0606",
    /// Start and end equally far from the base circle's centre.
    InvoluteEqualRadii = "G0607",
    /// Too many turns.
    InvoluteTurns = "G0608",
    /// The end is not on the involute.
    InvoluteMissed = "G0609",

    /// A position that no machine can reach.
    PositionTooLarge = "G0701",
    /// The geometry refuses the line.
    LineRefused = "G0702",

    /// The geometry refuses the hole of G12.2 or G13.2.
    HoleRefused = "G0703",
    /// Cutter compensation: the first move is too short.
    CompensationEntry = "G0704",
    /// Cutter compensation: the tool does not fit.
    CompensationGouge = "G0705",

    /// G70 to G72.2: the profile cannot be turned.
    ProfileRefused = "G0706",

    /// A move leaves the travel of an axis.
    BeyondTravel = "G0801",
    /// The machine cannot do a move for another reason.
    MoveRefused = "G0802",
    /// Something that this machine cannot do.
    MissingAbility = "G0803",
}

impl std::fmt::Display for Code {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(self.as_str())
    }
}
