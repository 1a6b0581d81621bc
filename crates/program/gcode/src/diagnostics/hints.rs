//! What to do about each error, where the place that found it knows nothing better.

use crate::Code;

impl Code {
    /// What helps in general.
    pub(crate) const fn hint(self) -> &'static str {
        match self {
            Self::LineTooLong => "is this a part program? If so, split the line",
            Self::ReadFailed => "see whether the file and its disk can be read",
            Self::StrayPercent => "% stands alone, on the first line and on the last",
            Self::StrayReturn => "end lines with LF or CR LF",
            Self::UnexpectedCharacter => {
                "outside comments there are letters with numbers, # parameters and [ ] formulas"
            }
            Self::NotAscii => "outside comments a program is plain ASCII",
            Self::NumberMissing => "write a number, a parameter (#5) or a formula ([1 + 2]) after the letter",
            Self::BadNumber => "write one optional sign, digits and at most one decimal point, such as -12.5",
            Self::NumberTooLarge => "is a decimal point missing?",
            Self::UnclosedComment => "write ) at its end; a comment does not go on in the next line",
            Self::NestedComment => "close the first comment with ), or write [ ] inside",
            Self::StrayParenthesis => "write ( before the comment, or leave the ) out",
            Self::MisplacedLineNumber => {
                "write N first on the line, or leave it out: line numbers do nothing"
            }
            Self::MisplacedBlockDelete => "write / first on the line; to divide, use brackets: X[1/2]",
            Self::LetterMissing => "write the letter whose value it is, as in X5 or X[1 + 2]",
            Self::Parameter => "#1 to #30 are arguments, #31 to #5000 are free; #<name> needs no number",
            Self::Expression => {
                "operators are + - * / ** MOD, EQ NE GT GE LT LE, AND OR XOR; ATAN is written ATAN[y]/[x]"
            }
            Self::OWord => "write O and a number or a <name>, then sub, call, if, while, do, repeat ...",
            Self::PolarCoordinates => {
                "@ is a distance from the program's zero and ^ an angle; X and Y do not go with them"
            }
            Self::SpindleSelection => "leave $ out: there is one spindle",
            Self::ActiveComment => "the program itself ends here: see what it says",
            Self::ReadOnlyParameter => {
                "it shows the state of the machine; keep your value in another parameter"
            }
            Self::UndefinedParameter => {
                "set it before: #<name> = 1; names with _ in front are known everywhere"
            }
            Self::Arithmetic => {
                "look at the values that the parameters have here: (DEBUG, #<name>) shows them"
            }
            Self::NestingTooDeep => {
                "keep a part of the formula in a parameter, or end a subroutine that calls itself"
            }
            Self::BadName => "a name has 1 to 100 characters of plain ASCII",
            Self::SubroutineMissing => {
                "define it by O<name> sub ... O<name> endsub, or in name.ngc in a folder of subroutines"
            }
            Self::SubroutineFile => "see whether the file can be read, and whether it is a program",
            Self::OWordOrder => {
                "what is opened last is closed first, by an O-word of the same number or name"
            }
            Self::OWordOpen => {
                "each O-word that opens something has one of the same name or number that closes it"
            }
            Self::BodyTooLong => {
                "lines inside a loop are kept to be run again: make its body a subroutine, or shorter"
            }
            Self::TooManySteps => "does the condition of the loop ever change?",
            Self::Interrupted => "start it again",
            Self::RestartRefused => {
                "choose a line between two operations, such as a rapid move to the next one"
            }
            Self::UnknownG => "look for a mistyped number; decimals count: G59.3 is not G593",
            Self::UnsupportedG => "another kind of machine has this code",
            Self::UnknownM => "look for a mistyped number; M100 to M199 are the machine's own",
            Self::UnsupportedM => {
                "[program] user_codes in the machine file names those of M100 to M199 that exist"
            }
            Self::RepeatedWord => "only G and M may be repeated: write two lines",
            Self::ModalGroup => "one of a kind per line: write them on two lines, or leave one out",
            Self::UnusedWord => "leave the word out, or write the code that it belongs to",
            Self::NoSuchAxis => "leave the word out, or choose the machine file that has this axis",
            Self::AxisWithoutMotion => "write G0, G1, G2 or G3 on this line",
            Self::TwoUsers => "write the codes on two lines",
            Self::NotInteger => "write a whole number; ROUND[...] makes one of a formula",
            Self::Negative => "write a number that is not below 0",
            Self::FeedMissing => "write F on this line or before; a change of feed mode forgets F",
            Self::FeedZero => "write an F above 0",
            Self::InverseTimeFeedMissing => "in G93 every feed move has its own F: 1 / minutes",
            Self::SpindleSpeedMissing => "write S and M3 or M4 first",
            Self::MachineCoordinatesMotion => "write G53 G0 X.. or G53 G1 X.. on one line",
            Self::MachineCoordinatesIncremental => "machine coordinates are absolute: write G90 first",
            Self::DwellTimeMissing => "write G4 P1.5 to wait for one and a half seconds",
            Self::OffsetAxesMissing => "G92 X0 makes the present position X0; G92.1 clears the offset",
            Self::ToolMissing => "write T and the tool's number before M6 or on its line",
            Self::UnknownTool => "add the tool to the table, or name another one",
            Self::WordMissing => "the words that a code needs stand on its line",
            Self::OutOfRange => {
                "see what values the message allows, and whether the units are right (G20, G21)"
            }
            Self::CompensationActive => "write G40 first",
            Self::WrongPlane => "G17, G18, G19 choose the plane",
            Self::WrongMode => "write G94 or G95 first",
            Self::SplineOpen => "a NURBS is a G5.2 line for each control point, and G5.3 at its end",
            Self::NothingSaved => "write M70 before",
            Self::ToolChange => "look at the tool table and at the subroutine that changes tools",
            Self::ArcCentreMissing => "write the centre (I, J, K from the start) or the radius R",
            Self::ArcMixedFormat => "give either R or I, J, K",
            Self::ArcOffsetAcrossPlane => "centre words lie in the plane: I J in G17, I K in G18, J K in G19",
            Self::ArcNoChord => "for a full circle write I and J instead of R",
            Self::ArcRadiusTooSmall => {
                "R is at least half the distance from start to end; is the start where it should be?"
            }
            Self::ArcRadiusMismatch => {
                "the end must lie on the circle: look at I, J, K and at G90.1 or G91.1"
            }
            Self::ArcZeroRadius => "I, J and K lead from the start to the centre",
            Self::ArcTurns => "P is the number of turns, a whole number from 1",
            Self::ArcEndMissing => "write the end of the arc: two words of its plane",
            Self::ArcCentreIncomplete => {
                "give both centre words, or G91.1 for a centre relative to the start"
            }
            Self::ArcRefused => "look at start, end and centre of the arc",
            Self::InvoluteEndMissing => "write the end of the involute: two words of its plane",
            Self::InvoluteCentreMissing => {
                "I and J lead from the start to the base circle's centre, also in G90.1"
            }
            Self::InvoluteRadiusMissing => "R is the radius of the base circle",
            Self::InvoluteRefused => "look at start, end, centre and base radius of the involute",
            Self::InvoluteOffsetAcrossPlane => {
                "centre words lie in the plane: I J in G17, I K in G18, J K in G19"
            }
            Self::InvoluteInside => {
                "no involute lies inside its base circle: make R smaller, or look at I and J"
            }
            Self::InvoluteEqualRadii => "a curve with equal distances at both ends is an arc: G2 or G3",
            Self::InvoluteTurns => "look at the unit of R: a small base circle makes many turns",
            Self::InvoluteMissed => {
                "compute the end with more decimals, or look at the sense of rotation (G2.2, G3.2)"
            }
            Self::PositionTooLarge => "no machine travels that far: look at offsets and increments",
            Self::LineRefused => "look at start and end of the move",
            Self::HoleRefused => {
                "D is the hole's diameter, E or the tool table the tool's, Q the pitch, K the allowance"
            }
            Self::CompensationEntry => "let the first move after G41 or G42 be longer than the tool's radius",
            Self::CompensationGouge => "use a smaller tool, or open the corner",
            Self::ProfileRefused => {
                "a profile is a subroutine of G0, G1, G2 and G3 in X and Z that never turns back"
            }
            Self::BeyondTravel => "look at work offsets, tool length and the part's place on the machine",
            Self::MoveRefused => "see what the machine says about this move",
            Self::MissingAbility => "leave it out, or run the program where it can be done",
        }
    }
}
