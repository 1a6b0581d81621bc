//! Advice on each error, used where the code that detects it has none.

use crate::Code;

/// General advice on each error; a test checks that no code is missing.
const HINTS: &[(Code, &str)] = &[
    (Code::LineTooLong, "is this a part program? If so, split the line"),
    (Code::ReadFailed, "check whether the file can be read"),
    (
        Code::StrayPercent,
        "% must be alone on the first line and on the last",
    ),
    (Code::StrayReturn, "end lines with LF or CR LF"),
    (
        Code::UnexpectedCharacter,
        "outside comments only letters with numbers, # parameters and [ ] expressions are permitted",
    ),
    (Code::NotAscii, "outside comments a program must be plain ASCII"),
    (
        Code::NumberMissing,
        "write a number, a parameter (#5) or an expression ([1 + 2]) after the letter",
    ),
    (
        Code::BadNumber,
        "write one optional sign, digits and at most one decimal point, such as -12.5",
    ),
    (Code::NumberTooLarge, "is a decimal point missing?"),
    (
        Code::UnclosedComment,
        "write ) at its end; a comment does not continue on the next line",
    ),
    (
        Code::NestedComment,
        "close the first comment with ), or write [ ] inside",
    ),
    (
        Code::StrayParenthesis,
        "write ( before the comment, or remove the )",
    ),
    (
        Code::MisplacedLineNumber,
        "write N first on the line, or remove it: line numbers have no effect",
    ),
    (
        Code::MisplacedBlockDelete,
        "write / first on the line; to divide, use brackets: X[1/2]",
    ),
    (
        Code::LetterMissing,
        "write a letter before the value, as in X5 or X[1 + 2]",
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
        "@ is the distance from the program zero and ^ the angle; they cannot be combined with X and Y",
    ),
    (
        Code::SpindleSelection,
        "write the number of a [[spindle]] of the machine file",
    ),
    (
        Code::ActiveComment,
        "the program aborts itself here: read its text",
    ),
    (
        Code::ReadOnlyParameter,
        "it shows the state of the machine; store your value in another parameter",
    ),
    (
        Code::UndefinedParameter,
        "set it first: #<name> = 1; names that start with _ are global",
    ),
    (
        Code::Arithmetic,
        "check the values of the parameters here: (DEBUG, #<name>) shows them",
    ),
    (
        Code::NestingTooDeep,
        "store a part of the expression in a parameter, or end the recursion of a subroutine",
    ),
    (Code::BadName, "a name has 1 to 100 ASCII characters"),
    (
        Code::SubroutineMissing,
        "define it by O<name> sub ... O<name> endsub, or in name.ngc in a subroutine folder",
    ),
    (
        Code::SubroutineFile,
        "check whether the file can be read, and whether it is a program",
    ),
    (
        Code::OWordOrder,
        "O-words nest: the last one opened must be closed first, with the same number or name",
    ),
    (
        Code::OWordOpen,
        "each O-word that opens a block needs one with the same name or number that closes it",
    ),
    (
        Code::BodyTooLong,
        "lines inside a loop are stored to be repeated: make its body a subroutine, or shorter",
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
    (Code::UnsupportedG, "another kind of machine supports this code"),
    (
        Code::UnknownM,
        "look for a mistyped number; a function that the builder of a machine added gets a number from 100 to \
         199 in user_codes of the machine file",
    ),
    (
        Code::UnsupportedM,
        "[program] user_codes in the machine file names those of M100 to M199 that exist",
    ),
    (Code::RepeatedWord, "only G and M may be repeated: use two lines"),
    (
        Code::ModalGroup,
        "one code per group and line: write them on two lines, or remove one",
    ),
    (
        Code::UnusedWord,
        "remove the word, or add the code that it belongs to",
    ),
    (
        Code::NoSuchAxis,
        "remove the word, or choose a machine file with this axis",
    ),
    (Code::AxisWithoutMotion, "write G0, G1, G2 or G3 on this line"),
    (Code::TwoUsers, "write the codes on two lines"),
    (
        Code::NotInteger,
        "write an integer; ROUND[...] rounds an expression",
    ),
    (Code::Negative, "write a number of at least 0"),
    (
        Code::FeedMissing,
        "write F on this line or before; a change of feed mode clears F",
    ),
    (Code::FeedZero, "write an F above 0"),
    (
        Code::InverseTimeFeedMissing,
        "in G93 every feed move needs its own F: 1 / minutes",
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
    (Code::DwellTimeMissing, "write G4 P1.5 to dwell for 1.5 seconds"),
    (
        Code::OffsetAxesMissing,
        "G92 X0 makes the present position X0; G92.1 clears the offset",
    ),
    (
        Code::ToolMissing,
        "write T and the tool number before M6 or on its line",
    ),
    (
        Code::UnknownTool,
        "add the tool to the table, or name another one",
    ),
    (
        Code::WordMissing,
        "the words that a code needs must be on its line",
    ),
    (
        Code::OutOfRange,
        "check the permitted values in the message, and the units (G20, G21)",
    ),
    (Code::CompensationActive, "write G40 first"),
    (Code::WrongPlane, "select the plane with G17, G18 or G19"),
    (Code::WrongMode, "write G94 or G95 first"),
    (
        Code::SplineOpen,
        "a NURBS is one G5.2 line per control point, and G5.3 at its end",
    ),
    (Code::NothingSaved, "write M70 before"),
    (
        Code::ToolChange,
        "check the tool table and the subroutine that changes tools",
    ),
    (
        Code::ArcCentreMissing,
        "write the centre (I, J, K from the start) or the radius R",
    ),
    (Code::ArcMixedFormat, "give either R or I, J, K, not both"),
    (
        Code::ArcOffsetAcrossPlane,
        "centre words are in the plane: I J in G17, I K in G18, J K in G19",
    ),
    (Code::ArcNoChord, "for a full circle give I and J instead of R"),
    (
        Code::ArcRadiusTooSmall,
        "R must be at least half the distance from start to end; check the start point",
    ),
    (
        Code::ArcRadiusMismatch,
        "the end must be on the circle: check I, J, K and G90.1 or G91.1",
    ),
    (
        Code::ArcZeroRadius,
        "I, J and K are the distance from the start to the centre",
    ),
    (Code::ArcTurns, "P is the number of turns, an integer from 1"),
    (
        Code::ArcEndMissing,
        "give the end of the arc: two words of its plane",
    ),
    (
        Code::ArcCentreIncomplete,
        "give both centre words, or G91.1 for a centre relative to the start",
    ),
    (Code::ArcRefused, "check start, end and centre of the arc"),
    (
        Code::InvoluteEndMissing,
        "give the end of the involute: two words of its plane",
    ),
    (
        Code::InvoluteCentreMissing,
        "I and J are the distance from the start to the centre of the base circle, also in G90.1",
    ),
    (Code::InvoluteRadiusMissing, "R is the radius of the base circle"),
    (
        Code::InvoluteRefused,
        "check start, end, centre and base radius of the involute",
    ),
    (
        Code::InvoluteOffsetAcrossPlane,
        "centre words are in the plane: I J in G17, I K in G18, J K in G19",
    ),
    (
        Code::InvoluteInside,
        "no involute exists inside its base circle: reduce R, or check I and J",
    ),
    (
        Code::InvoluteEqualRadii,
        "a curve with equal radii at both ends is an arc: use G2 or G3",
    ),
    (
        Code::InvoluteTurns,
        "check the unit of R: a small base circle gives many turns",
    ),
    (
        Code::InvoluteMissed,
        "compute the end with more decimals, or check the sense of rotation (G2.2, G3.2)",
    ),
    (
        Code::PositionTooLarge,
        "check offsets and increments: no machine travels that far",
    ),
    (Code::LineRefused, "check start and end of the move"),
    (
        Code::HoleRefused,
        "D is the diameter of the hole, E or the tool table that of the tool, Q the pitch, K the allowance",
    ),
    (
        Code::CompensationEntry,
        "make the first move after G41 or G42 longer than the tool radius",
    ),
    (Code::CompensationGouge, "use a smaller tool, or open the corner"),
    (
        Code::ProfileRefused,
        "a profile is a subroutine of G0, G1, G2 and G3 in X and Z that never reverses",
    ),
    (
        Code::BeyondTravel,
        "check work offsets, tool length and the position of the part on the machine",
    ),
    (
        Code::MoveRefused,
        "change the words of this line that the message names",
    ),
    (
        Code::MissingAbility,
        "remove it, or run the program on a machine that supports it",
    ),
];

impl Code {
    /// General advice on this error.
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
