//! What to do about each error, where the place that found it knows nothing better.

use crate::Code;

/// What helps in general; a test looks that no code is missing.
const HINTS: &[(Code, &str)] = &[
    (Code::LineTooLong, "is this a part program? If so, split the line"),
    (Code::ReadFailed, "see whether the file and its disk can be read"),
    (
        Code::StrayPercent,
        "% stands alone, on the first line and on the last",
    ),
    (Code::StrayReturn, "end lines with LF or CR LF"),
    (
        Code::UnexpectedCharacter,
        "outside comments there are letters with numbers, # parameters and [ ] formulas",
    ),
    (Code::NotAscii, "outside comments a program is plain ASCII"),
    (
        Code::NumberMissing,
        "write a number, a parameter (#5) or a formula ([1 + 2]) after the letter",
    ),
    (
        Code::BadNumber,
        "write one optional sign, digits and at most one decimal point, such as -12.5",
    ),
    (Code::NumberTooLarge, "is a decimal point missing?"),
    (
        Code::UnclosedComment,
        "write ) at its end; a comment does not go on in the next line",
    ),
    (
        Code::NestedComment,
        "close the first comment with ), or write [ ] inside",
    ),
    (
        Code::StrayParenthesis,
        "write ( before the comment, or leave the ) out",
    ),
    (
        Code::MisplacedLineNumber,
        "write N first on the line, or leave it out: line numbers do nothing",
    ),
    (
        Code::MisplacedBlockDelete,
        "write / first on the line; to divide, use brackets: X[1/2]",
    ),
    (
        Code::LetterMissing,
        "write the letter whose value it is, as in X5 or X[1 + 2]",
    ),
    (
        Code::Parameter,
        "#1 to #30 are arguments, #31 to #5000 are free; #<name> needs no number",
    ),
    (
        Code::Expression,
        "operators are + - * / ** MOD, EQ NE GT GE LT LE, AND OR XOR; ATAN is written ATAN[y]/[x]",
    ),
    (
        Code::OWord,
        "write O and a number or a <name>, then sub, call, if, while, do, repeat ...",
    ),
    (
        Code::PolarCoordinates,
        "@ is a distance from the program's zero and ^ an angle; X and Y do not go with them",
    ),
    (Code::SpindleSelection, "leave $ out: there is one spindle"),
    (
        Code::ActiveComment,
        "the program itself ends here: see what it says",
    ),
    (
        Code::ReadOnlyParameter,
        "it shows the state of the machine; keep your value in another parameter",
    ),
    (
        Code::UndefinedParameter,
        "set it before: #<name> = 1; names with _ in front are known everywhere",
    ),
    (
        Code::Arithmetic,
        "look at the values that the parameters have here: (DEBUG, #<name>) shows them",
    ),
    (
        Code::NestingTooDeep,
        "keep a part of the formula in a parameter, or end a subroutine that calls itself",
    ),
    (Code::BadName, "a name has 1 to 100 characters of plain ASCII"),
    (
        Code::SubroutineMissing,
        "define it by O<name> sub ... O<name> endsub, or in name.ngc in a folder of subroutines",
    ),
    (
        Code::SubroutineFile,
        "see whether the file can be read, and whether it is a program",
    ),
    (
        Code::OWordOrder,
        "what is opened last is closed first, by an O-word of the same number or name",
    ),
    (
        Code::OWordOpen,
        "each O-word that opens something has one of the same name or number that closes it",
    ),
    (
        Code::BodyTooLong,
        "lines inside a loop are kept to be run again: make its body a subroutine, or shorter",
    ),
    (Code::TooManySteps, "does the condition of the loop ever change?"),
    (Code::Interrupted, "start it again"),
    (
        Code::RestartRefused,
        "choose a line between two operations, such as a rapid move to the next one",
    ),
    (
        Code::UnknownG,
        "look for a mistyped number; decimals count: G59.3 is not G593",
    ),
    (Code::UnsupportedG, "another kind of machine has this code"),
    (
        Code::UnknownM,
        "look for a mistyped number; M100 to M199 are the machine's own",
    ),
    (
        Code::UnsupportedM,
        "[program] user_codes in the machine file names those of M100 to M199 that exist",
    ),
    (
        Code::RepeatedWord,
        "only G and M may be repeated: write two lines",
    ),
    (
        Code::ModalGroup,
        "one of a kind per line: write them on two lines, or leave one out",
    ),
    (
        Code::UnusedWord,
        "leave the word out, or write the code that it belongs to",
    ),
    (
        Code::NoSuchAxis,
        "leave the word out, or choose the machine file that has this axis",
    ),
    (Code::AxisWithoutMotion, "write G0, G1, G2 or G3 on this line"),
    (Code::TwoUsers, "write the codes on two lines"),
    (
        Code::NotInteger,
        "write a whole number; ROUND[...] makes one of a formula",
    ),
    (Code::Negative, "write a number that is not below 0"),
    (
        Code::FeedMissing,
        "write F on this line or before; a change of feed mode forgets F",
    ),
    (Code::FeedZero, "write an F above 0"),
    (
        Code::InverseTimeFeedMissing,
        "in G93 every feed move has its own F: 1 / minutes",
    ),
    (Code::SpindleSpeedMissing, "write S and M3 or M4 first"),
    (
        Code::MachineCoordinatesMotion,
        "write G53 G0 X.. or G53 G1 X.. on one line",
    ),
    (
        Code::MachineCoordinatesIncremental,
        "machine coordinates are absolute: write G90 first",
    ),
    (
        Code::DwellTimeMissing,
        "write G4 P1.5 to wait for one and a half seconds",
    ),
    (
        Code::OffsetAxesMissing,
        "G92 X0 makes the present position X0; G92.1 clears the offset",
    ),
    (
        Code::ToolMissing,
        "write T and the tool's number before M6 or on its line",
    ),
    (
        Code::UnknownTool,
        "add the tool to the table, or name another one",
    ),
    (Code::WordMissing, "the words that a code needs stand on its line"),
    (
        Code::OutOfRange,
        "see what values the message allows, and whether the units are right (G20, G21)",
    ),
    (Code::CompensationActive, "write G40 first"),
    (Code::WrongPlane, "G17, G18, G19 choose the plane"),
    (Code::WrongMode, "write G94 or G95 first"),
    (
        Code::SplineOpen,
        "a NURBS is a G5.2 line for each control point, and G5.3 at its end",
    ),
    (Code::NothingSaved, "write M70 before"),
    (
        Code::ToolChange,
        "look at the tool table and at the subroutine that changes tools",
    ),
    (
        Code::ArcCentreMissing,
        "write the centre (I, J, K from the start) or the radius R",
    ),
    (Code::ArcMixedFormat, "give either R or I, J, K"),
    (
        Code::ArcOffsetAcrossPlane,
        "centre words lie in the plane: I J in G17, I K in G18, J K in G19",
    ),
    (Code::ArcNoChord, "for a full circle write I and J instead of R"),
    (
        Code::ArcRadiusTooSmall,
        "R is at least half the distance from start to end; is the start where it should be?",
    ),
    (
        Code::ArcRadiusMismatch,
        "the end must lie on the circle: look at I, J, K and at G90.1 or G91.1",
    ),
    (
        Code::ArcZeroRadius,
        "I, J and K lead from the start to the centre",
    ),
    (Code::ArcTurns, "P is the number of turns, a whole number from 1"),
    (
        Code::ArcEndMissing,
        "write the end of the arc: two words of its plane",
    ),
    (
        Code::ArcCentreIncomplete,
        "give both centre words, or G91.1 for a centre relative to the start",
    ),
    (Code::ArcRefused, "look at start, end and centre of the arc"),
    (
        Code::InvoluteEndMissing,
        "write the end of the involute: two words of its plane",
    ),
    (
        Code::InvoluteCentreMissing,
        "I and J lead from the start to the base circle's centre, also in G90.1",
    ),
    (Code::InvoluteRadiusMissing, "R is the radius of the base circle"),
    (
        Code::InvoluteRefused,
        "look at start, end, centre and base radius of the involute",
    ),
    (
        Code::InvoluteOffsetAcrossPlane,
        "centre words lie in the plane: I J in G17, I K in G18, J K in G19",
    ),
    (
        Code::InvoluteInside,
        "no involute lies inside its base circle: make R smaller, or look at I and J",
    ),
    (
        Code::InvoluteEqualRadii,
        "a curve with equal distances at both ends is an arc: G2 or G3",
    ),
    (
        Code::InvoluteTurns,
        "look at the unit of R: a small base circle makes many turns",
    ),
    (
        Code::InvoluteMissed,
        "compute the end with more decimals, or look at the sense of rotation (G2.2, G3.2)",
    ),
    (
        Code::PositionTooLarge,
        "no machine travels that far: look at offsets and increments",
    ),
    (Code::LineRefused, "look at start and end of the move"),
    (
        Code::HoleRefused,
        "D is the hole's diameter, E or the tool table the tool's, Q the pitch, K the allowance",
    ),
    (
        Code::CompensationEntry,
        "let the first move after G41 or G42 be longer than the tool's radius",
    ),
    (Code::CompensationGouge, "use a smaller tool, or open the corner"),
    (
        Code::ProfileRefused,
        "a profile is a subroutine of G0, G1, G2 and G3 in X and Z that never turns back",
    ),
    (
        Code::BeyondTravel,
        "look at work offsets, tool length and the part's place on the machine",
    ),
    (Code::MoveRefused, "see what the machine says about this move"),
    (
        Code::MissingAbility,
        "leave it out, or run the program where it can be done",
    ),
];

impl Code {
    /// What helps in general.
    pub(crate) fn hint(self) -> &'static str {
        HINTS
            .iter()
            .find(|(code, _)| *code == self)
            .map_or("see docs/errors.md", |(_, hint)| hint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_has_one_hint() {
        for code in Code::ALL {
            let hints = HINTS.iter().filter(|(of, _)| of == code);
            assert_eq!(hints.count(), 1, "{}", code.as_str());
        }
    }
}
