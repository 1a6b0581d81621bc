//! Every mistake in a program is reported with its position.

use evolvent_gcode::{Code, Diagnostic, Interpreter, Settings};

/// X Y Z and A exist, so that B can be rejected and rotary motion can be tested.
fn settings() -> Settings {
    Settings {
        axes: [true, true, true, true, false, false, false, false, false],
        ..Settings::default()
    }
}

fn errors(program: &[u8]) -> Vec<Diagnostic> {
    Interpreter::new(program, settings())
        .filter_map(Result::err)
        .collect()
}

/// Lines, the code expected on the last one, and the column in it.
const TABLE: &[(&str, Code, u32)] = {
    use Code::*;
    &[
        // Characters.
        ("G1 X1 ?", UnexpectedCharacter, 7),
        ("!", UnexpectedCharacter, 1),
        ("G1 X=5", UnexpectedCharacter, 5),
        ("G0 X1,5", UnexpectedCharacter, 6),
        ("G0 X1_", UnexpectedCharacter, 6),
        ("G0 X\"1\"", UnexpectedCharacter, 5),
        ("G0 \u{0}X1", UnexpectedCharacter, 4),
        ("\u{7f}", UnexpectedCharacter, 1),
        ("\u{1b}[2J", UnexpectedCharacter, 1),
        ("G0\u{b}X1", UnexpectedCharacter, 3),
        ("G0 X\u{2212}1", NotAscii, 5),
        ("G0 X1\u{a0}Y1", NotAscii, 6),
        ("\u{fc}", NotAscii, 1),
        ("(\u{e4}\u{f6}) \u{fc}", NotAscii, 6),
        ("G0 X1 %", StrayPercent, 7),
        ("G0 X1\n%", StrayPercent, 1),
        ("G0 X1\rY1", StrayReturn, 6),
        ("G0 X1 )", StrayParenthesis, 7),
        ("G0 X1 (a", UnclosedComment, 7),
        ("(", UnclosedComment, 1),
        ("(MSG, a", UnclosedComment, 1),
        ("(a (b) c)", NestedComment, 4),
        // Numbers.
        ("G0 X", NumberMissing, 4),
        ("G0 X Y1", NumberMissing, 4),
        ("G", NumberMissing, 1),
        ("M (a)", NumberMissing, 1),
        ("X;1", NumberMissing, 1),
        ("G1 F", NumberMissing, 4),
        ("G0 X.", BadNumber, 5),
        ("G0 X-", BadNumber, 5),
        ("G0 X-.Y1", BadNumber, 5),
        ("G0 X1.2.3", BadNumber, 5),
        ("G0 X1..", BadNumber, 5),
        ("G0 X1-2", LetterMissing, 6),
        ("12 G0", LetterMissing, 1),
        ("G0 X1 -2", LetterMissing, 7),
        (".", BadNumber, 1),
        ("+", BadNumber, 1),
        ("G0 X1000000000.1", NumberTooLarge, 5),
        ("G0 X-99999999999999999999999999999999", NumberTooLarge, 5),
        ("G9999999999", NumberTooLarge, 2),
        // 1e308 in the forms in which users write it.
        ("G0 X1e308", UnusedWord, 6),
        ("G0 X1E-3", UnusedWord, 6),
        ("G0 XNAN", NumberMissing, 4),
        ("G0 XINF", NumberMissing, 4),
        ("G0 X0x10", RepeatedWord, 6),
        // Parameters and formulas.
        ("G0 X#0", Parameter, 5),
        ("#5602=5", Parameter, 1),
        ("#1.5=5", NotInteger, 1),
        ("#5420=5", ReadOnlyParameter, 1),
        ("#5400=5", ReadOnlyParameter, 1),
        ("#<_x>=5", ReadOnlyParameter, 1),
        ("G0 X#<a>", UndefinedParameter, 5),
        ("#<a=5", BadName, 2),
        ("#<>=5", BadName, 3),
        ("#1", LetterMissing, 1),
        ("#1=", Expression, 4),
        ("#1=X", Expression, 4),
        ("#1=1 #2=[1/0]", Arithmetic, 11),
        ("[1]", LetterMissing, 1),
        ("G0 X[1", Expression, 5),
        ("G0 X[1+]", Expression, 8),
        ("G0 X[1]]", Expression, 8),
        ("G0 X[1 foo 2]", Expression, 8),
        ("G0 X foo[30]", Expression, 6),
        ("G0 XATAN[1]", Expression, 5),
        ("G0 X sqrt[-1]", Arithmetic, 6),
        ("G0 X[1E3]", Expression, 7),
        ("G0 X[100000*100000]", NumberTooLarge, 4),
        // O-words.
        ("O", OWord, 1),
        ("O-1 sub", OWord, 1),
        ("O1.5 sub", OWord, 1),
        ("O<a", BadName, 2),
        ("O1 foo", OWord, 4),
        ("O1 sub x", OWord, 4),
        ("O1 sub 3", OWord, 8),
        ("O1 call [1", Expression, 9),
        ("O1 call", SubroutineMissing, 1),
        ("o<../a> call", SubroutineMissing, 1),
        ("M98 P7", SubroutineMissing, 1),
        ("M98", WordMissing, 1),
        ("O1 endif", OWordOrder, 1),
        ("O1 else", OWordOrder, 1),
        ("O1 elseif [1]", OWordOrder, 1),
        ("O1 endwhile", OWordOrder, 1),
        ("O1 endrepeat", OWordOrder, 1),
        ("O1 endsub", OWordOrder, 1),
        ("O1 return", OWordOrder, 1),
        ("O1 break", OWordOrder, 1),
        ("O1 continue", OWordOrder, 1),
        ("O1 sub", OWordOpen, 1),
        ("O1 if [1]", OWordOpen, 1),
        ("O1 if [0]", OWordOpen, 1),
        ("O1 while [0]", OWordOpen, 1),
        ("O1 do", OWordOpen, 1),
        ("O1 repeat [2]", OWordOpen, 1),
        // Polar coordinates and spindles.
        ("G0 @1", PolarCoordinates, 4),
        ("G0 @1 ^30 X2", PolarCoordinates, 4),
        ("G91 G0 @1 ^30", PolarCoordinates, 8),
        ("G92 @1", PolarCoordinates, 5),
        ("G18 G0 X1 Z3\nG1 F100 @10 ^30", WrongPlane, 9),
        ("G19 G0 Y1\nG0 ^30", WrongPlane, 4),
        ("G18 G91 G81 Z-1 R1 F100 @10", WrongPlane, 9),
        ("M3 $1 S100", SpindleSelection, 4),
        ("(ABORT, no)", ActiveComment, 2),
        // N and /.
        ("G0 N5 X1", MisplacedLineNumber, 4),
        ("N1 N2 G0", MisplacedLineNumber, 4),
        ("N-1 G0", Negative, 1),
        ("N", NumberMissing, 1),
        ("G0 X1/2", MisplacedBlockDelete, 6),
        ("N5 / G0 X1", MisplacedBlockDelete, 4),
        // Codes.
        ("G6", UnknownG, 1),
        ("G77", UnknownG, 1),
        ("G0.5 X1", UnknownG, 1),
        ("G1.01", UnknownG, 1),
        ("G-1", UnknownG, 1),
        ("G100", UnknownG, 1),
        ("G1000000", UnknownG, 1),
        ("G59.4", UnknownG, 1),
        ("G2.3 X1", UnknownG, 1),
        ("X1 G123", UnknownG, 4),
        ("G71 X1", WrongPlane, 1),
        ("G18 F1 G70", WordMissing, 8),
        ("G75 X1", UnsupportedG, 1),
        ("M10", UnknownM, 1),
        ("M-1", Negative, 1),
        ("M3.5", NotInteger, 1),
        ("M200", UnknownM, 1),
        ("M101", UnsupportedM, 1),
        ("G0 G1 X1 F1", ModalGroup, 4),
        ("G0 G0 X1", ModalGroup, 4),
        ("G17 G18", ModalGroup, 5),
        ("G20 G21", ModalGroup, 5),
        ("G90 X1 G91", ModalGroup, 8),
        ("G90.1 G91.1", ModalGroup, 7),
        ("G93 G94", ModalGroup, 5),
        ("G54 G55", ModalGroup, 5),
        ("G61 G64", ModalGroup, 5),
        ("G4 P1 G53", ModalGroup, 7),
        ("G92.1 G92.2", ModalGroup, 7),
        ("G80 G80", ModalGroup, 5),
        ("M0 M2", ModalGroup, 4),
        ("M3 M5", ModalGroup, 4),
        ("M7 M8", ModalGroup, 4),
        ("M6 M6", ModalGroup, 4),
        // Words.
        ("G0 X1 X2", RepeatedWord, 7),
        ("G0 x1 Y1 X1", RepeatedWord, 10),
        ("F1 F2", RepeatedWord, 4),
        ("S1 S1", RepeatedWord, 4),
        ("G0 X1 P1", UnusedWord, 7),
        ("G0 X1 I1", UnusedWord, 7),
        ("G1 F1 X1 R1", UnusedWord, 10),
        ("G61 P1", UnusedWord, 5),
        ("G0 X1 Q1", UnusedWord, 7),
        ("D1", UnusedWord, 1),
        ("H1", UnusedWord, 1),
        ("L1", UnusedWord, 1),
        ("G4 P1 Q1", UnusedWord, 7),
        ("G4 P1 K1", UnusedWord, 7),
        ("G0 B1", NoSuchAxis, 4),
        ("G92 U0", NoSuchAxis, 5),
        ("X1", AxisWithoutMotion, 1),
        ("G80 X1", AxisWithoutMotion, 5),
        ("G4 P1 Y2", AxisWithoutMotion, 7),
        ("G53 X1", AxisWithoutMotion, 5),
        ("G90 Z1 X1", AxisWithoutMotion, 5),
        ("G92 X1 G1 F1", TwoUsers, 8),
        ("G0 G92 X1", TwoUsers, 1),
        ("F1\nG4 P1 G2 X1 I.5", TwoUsers, 4),
        ("G4 P1 G64", TwoUsers, 4),
        ("T1.5", NotInteger, 1),
        ("T-1", Negative, 1),
        ("F-1", Negative, 1),
        ("S-1", Negative, 1),
        ("G4 P-1", Negative, 4),
        ("G64 P-1", Negative, 5),
        ("G64 P1 Q-1", Negative, 8),
        // State.
        ("G1 X1", FeedMissing, 1),
        ("G2 X1 I.5", FeedMissing, 1),
        ("G1 F0 X1", FeedZero, 1),
        ("F100\nG93 G1 X1", InverseTimeFeedMissing, 5),
        ("G93 G1 X1 F2\nX2", InverseTimeFeedMissing, 1),
        ("G93 G1 X1 F0", FeedZero, 5),
        ("F100\nG95 G1 X1", FeedMissing, 5),
        ("G93 F1 G1 X1\nG94 X2", FeedMissing, 5),
        ("G95 F1 G1 X1", SpindleSpeedMissing, 8),
        ("G96 S100 D0 M3", SpindleSpeedMissing, 10),
        ("S100\nS0\nG95 F1 G1 X1", SpindleSpeedMissing, 8),
        ("G53 G2 X1 I.5 F1", MachineCoordinatesMotion, 1),
        ("G53", MachineCoordinatesMotion, 1),
        ("G0 X1 G53 G91", MachineCoordinatesIncremental, 7),
        ("G4", DwellTimeMissing, 1),
        ("G92", OffsetAxesMissing, 1),
        ("M6", ToolMissing, 1),
        ("M72", NothingSaved, 1),
        ("M61", WordMissing, 1),
        ("M19 R400", OutOfRange, 5),
        ("M19 R400", OutOfRange, 5),
        ("M62", WordMissing, 1),
        ("M66 P1 E1", WordMissing, 1),
        ("M66 P1 L3", WordMissing, 1),
        ("M66 P1 L5 Q1", OutOfRange, 8),
        ("G96 D5", WordMissing, 1),
        ("G10 P1 X0", WordMissing, 1),
        ("G10 L2 X0", WordMissing, 1),
        ("G10 L2 P10 X0", OutOfRange, 8),
        ("G10 L3 P1", OutOfRange, 5),
        ("G10 L2 P1 R1 I1", UnusedWord, 14),
        ("G10 L2 P1 X1 Q1", UnusedWord, 14),
        ("G10 L20 P1 X1 R1", UnusedWord, 15),
        ("G52", OffsetAxesMissing, 1),
        ("G33 Z1 K1", SpindleSpeedMissing, 1),
        ("M3 S1\nG33 Z1", WordMissing, 1),
        ("M3 S1\nG33 Z1 K-1", OutOfRange, 8),
        ("M3 S1\nG33 Z1 K1 F5", UnusedWord, 11),
        ("M3 S1\nG33 Z1 K1 Q360", OutOfRange, 11),
        ("M3 S1\nG76 P1 Z-5 I-1 J0.2 K0.5 D0", OutOfRange, 26),
        ("M3 S1\nG76 P1 Z-5 I-1 J0.2 K0.5 L1", WordMissing, 26),
        ("M3 S1\nG76 P1 Z-5 I-1 J0.2 K0.5 L4", OutOfRange, 26),
        ("M3 S1\nG76 P1 Z-5 I-1 J0.2 K0.5 L1 E0", OutOfRange, 29),
        ("M3 S1\nG76 P1 Z-5 I-1 J0.2 K0.5 L1 E2.6", OutOfRange, 29),
        ("F1\nG38.2", WordMissing, 1),
        ("F1\nG38.2 X0", OutOfRange, 1),
        ("G38.2 X5", FeedMissing, 1),
        // Cycles.
        ("G81 X1 R1 Z-1", FeedMissing, 1),
        ("F1\nG81 X1 Z-1", WordMissing, 1),
        ("F1\nG81 X1 R1", WordMissing, 1),
        ("F1\nG81 X1 R-2 Z-1", OutOfRange, 1),
        ("F1\nG81 X1 R1 Z-1 L0", OutOfRange, 15),
        ("F1\nG81 X1 R1 Z-1 A5", UnusedWord, 15),
        ("F1\nG81 X1 R1 Z-1\nG81 R7", WordMissing, 1),
        ("F1\nG81 X1 R1 Z-1\nG82 P1", WordMissing, 1),
        ("M3 S1\nG33 K1", WordMissing, 1),
        ("M3 S1\nG33.1 K1", WordMissing, 1),
        ("F1\nG82 X1 R1 Z-1", WordMissing, 1),
        ("F1\nG83 X1 R1 Z-1", WordMissing, 1),
        ("F1\nG83 X1 R1 Z-1 Q0", OutOfRange, 15),
        ("F1\nG84 X1 R1 Z-1", SpindleSpeedMissing, 1),
        ("F1 M4\nG84 X1 R1 Z-1", SpindleSpeedMissing, 1),
        ("G93\nG81 X1 R1 Z-1 F1", WrongMode, 1),
        ("F1 G17.1\nG81 X1 R1 Z-1", UnusedWord, 5),
        // Splines.
        ("F1\nG5 X1 P1", WordMissing, 1),
        ("F1\nG5 X1 P1 Q1 I1", WordMissing, 1),
        ("F1\nG5 X1 P1 Q1 Z1", UnusedWord, 13),
        ("F1\nG5.1 X1", WordMissing, 1),
        ("F1\nG5.1 X1 I0 J0", WordMissing, 1),
        ("F1 G18\nG5 X1 P1 Q1", WrongPlane, 1),
        ("F1\nG5.3", SplineOpen, 1),
        ("F1\nG5.2 P1 L3\nX1 P1\nG5.3", SplineOpen, 1),
        ("F1\nG5.2 P1 L3\nG1 X1", SplineOpen, 1),
        ("F1\nG5.2 P1 L3\nX1", WordMissing, 1),
        ("F1\nG5.2 P0 L3", OutOfRange, 6),
        ("F1\nG5.2 P1 L99", OutOfRange, 9),
        ("F1\nG5.2 @5 ^30 P1 L3", PolarCoordinates, 6),
        ("F1\nG5.2 P1 L3\nP1 ^30", PolarCoordinates, 4),
        // Holes.
        ("F1\nG13.2 X0 Y0 Z-1 R1 D10 Q1", HoleRefused, 1),
        ("F1\nG13.2 X0 Y0 Z-1 R1 Q1 E2", WordMissing, 1),
        ("F1\nG13.2 X0 Y0 Z-1 R1 D10 Q1 E12", HoleRefused, 1),
        ("F1\nG13.2 X0 Y0 Z1 R1 D10 Q1 E2", HoleRefused, 1),
        // Arcs.
        ("F1\nG2", ArcCentreMissing, 1),
        ("F1\nG3 X1", ArcCentreMissing, 1),
        ("F1\nG2 X1 I.5 R1", ArcMixedFormat, 11),
        ("F1\nG2 X2 I1 K0", ArcOffsetAcrossPlane, 10),
        ("F1 G18\nG2 X2 I1 J0", ArcOffsetAcrossPlane, 10),
        ("F1 G19\nG2 Y2 J1 I0", ArcOffsetAcrossPlane, 10),
        ("F1\nG2 R1", ArcEndMissing, 1),
        ("F1\nG2 Z1 R1", ArcEndMissing, 1),
        ("F1\nG2 X0 R1", ArcNoChord, 1),
        ("F1\nG2 X1 R0", ArcRadiusTooSmall, 7),
        ("F1\nG2 X2 R.99", ArcRadiusTooSmall, 7),
        ("F1\nG2 X20 I10.05", ArcRadiusMismatch, 1),
        ("F1\nG2 X999 I1", ArcRadiusMismatch, 1),
        ("F1\nG2 I0", ArcZeroRadius, 1),
        ("F1\nG2 X1 I1", ArcZeroRadius, 1),
        ("F1\nG2 X1 I.5 P0", ArcTurns, 11),
        ("F1\nG2 X1 I.5 P1.5", ArcTurns, 11),
        ("F1\nG2 X1 I.5 P-1", ArcTurns, 11),
        ("F1\nG2 X1 I.5 P999999999", ArcTurns, 11),
        ("F1\nG90.1 G2 X1 I.5", ArcCentreIncomplete, 7),
        // Involutes.
        ("F1\nG3.2 I1 J1 R1", InvoluteEndMissing, 1),
        ("F1\nG3.2 X1 Y1 R1", InvoluteCentreMissing, 1),
        ("F1\nG3.2 X1 Y1 I0 J0 R1", InvoluteCentreMissing, 1),
        ("F1\nG3.2 X1 Y1 I1 J0", InvoluteRadiusMissing, 1),
        ("F1\nG3.2 X1 Y1 I1 J0 R0", InvoluteRadiusMissing, 18),
        ("F1\nG3.2 X1 Y1 I1 J0 R-1", InvoluteRadiusMissing, 18),
        ("F1\nG3.2 X1 Y1 I1 K0 R1", InvoluteOffsetAcrossPlane, 15),
        ("F1\nG3.2 X5 Y0 I1 R2", InvoluteInside, 1),
        ("F1\nG3.2 X4 Y0 I5 R2", InvoluteInside, 1),
        ("F1\nG3.2 X10 Y0 I5 R2", InvoluteEqualRadii, 1),
        ("F1\nG3.2 X20 Y0 I5 R2", InvoluteMissed, 1),
        ("F1\nG3.2 X5000 Y0 I5 R2", InvoluteTurns, 1),
        ("F1\nG2.2 X1 Y1 I1 R1 P1", UnusedWord, 18),
        // Positions.
        ("G20\nG0 X900000000", PositionTooLarge, 4),
        ("G91 G0 X900000000\nX900000000", PositionTooLarge, 1),
    ]
};

#[test]
fn every_error_of_the_table_has_its_column() {
    assert!(TABLE.len() > 150);
    let mut mismatches = String::new();
    for (program, code, column) in TABLE {
        let found = errors(program.as_bytes());
        let line = program.split('\n').count() as u32;
        let positions: Vec<_> = found
            .iter()
            .map(|error| (error.code, error.line, error.column))
            .collect();
        if positions != [(*code, line, *column)] {
            mismatches +=
                &format!("{program:?}: expected {code:?} at {line}:{column}, found {positions:?}\n");
        }
    }
    assert!(mismatches.is_empty(), "{mismatches}");
}

#[test]
fn every_rendered_error_shows_code_message_and_position() {
    for (program, code, column) in TABLE {
        for error in errors(program.as_bytes()) {
            let shown = error.render("a.ngc");
            assert!(
                shown.contains(code.as_str()) && shown.contains(&error.message),
                "{shown}"
            );
            assert!(shown.contains(&format!("a.ngc:{}:", error.line)), "{shown}");
            assert!(shown.contains(&format!("{column}\n")), "{shown}");
            assert!(error.source.get(error.span.clone()).is_some());
            assert!(error.help.is_some_and(|help| !help.is_empty()), "{program}");
        }
    }
}

/// `docs/errors.md` is written by `EVOLVENT_WRITE_CODES=1 cargo test -p evolvent-gcode --test all bad_input`.
#[test]
fn every_code_is_listed_in_the_docs_with_its_meaning() {
    let mut text = String::from(
        "# Errors of programs\n\n\
         The codes that `evolvent check` and a run report, in text and in JSON. A code never changes its \
         meaning; new ones may be added.\n\n| code | meaning |\n|---|---|\n",
    );
    for code in Code::ALL {
        // Links of the library's documentation have no meaning here.
        let meaning = code.meaning().replace(
            "[`ProgramLimits::max_line_bytes`](crate::ProgramLimits::max_line_bytes)",
            "64 KiB",
        );
        text += &format!("| {code} | {} |\n", meaning.trim().replace('|', "\\|"));
    }
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../docs/errors.md");
    if std::env::var_os("EVOLVENT_WRITE_CODES").is_some() {
        std::fs::write(&path, &text).unwrap();
    }
    let shipped = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        shipped == text,
        "docs/errors.md is out of date: run EVOLVENT_WRITE_CODES=1 cargo test -p evolvent-gcode --test all \
         bad_input"
    );
}

#[test]
fn messages_name_the_invalid_word() {
    for (program, word) in [
        ("G0 X1 P1", "P"),
        ("G77", "G77"),
        ("G59.4", "G59.4"),
        ("M12", "M12"),
        ("G71 X1", "G71"),
        ("G0 B1", "B"),
        ("G17 G18", "G17 and G18"),
        ("M03 M5", "M3 and M5"),
        ("G0 X#<no>", "#<no>"),
        ("F1\nG2 X20 I10.05", "r1=10.0500 r2=9.9500"),
    ] {
        let found = errors(program.as_bytes());
        assert!(found[0].message.contains(word), "{}", found[0].message);
    }
}

#[test]
fn invalid_utf8_is_permitted_in_comments_only() {
    assert_eq!(errors(b"G0 X1 \xff")[0].code, Code::NotAscii);
    assert_eq!(errors(b"G0 X1 (\xff\xfe\x00) ; \x80\x01"), []);
}

#[test]
fn utf16_is_named() {
    for text in [b"\xff\xfeG\x000\x00", b"\xfe\xff\x00G\x000"] {
        let help = errors(text)[0].help.clone().expect("help");
        assert!(help.contains("UTF-16"), "{help}");
    }
}

#[test]
fn one_pass_finds_the_errors_of_many_lines() {
    let program = "G21 F60\nG1 X1\nG20 G91 X?\nG55 G0 X5 P1\nG1 X2\nG6\nM2\nthis is not reached";
    let mut commands = Vec::new();
    let mut lines = Vec::new();
    for item in Interpreter::new(program.as_bytes(), settings()) {
        match item {
            Ok(command) => commands.push(command),
            Err(error) => lines.push(error.line),
        }
    }
    assert_eq!(lines, [3, 4, 6]);
    let ends: Vec<_> = commands
        .iter()
        .filter_map(|command| match &command.action {
            evolvent_gcode::Action::Move(step) => Some(step.curve.end()[0]),
            _ => None,
        })
        .collect();
    // X2 is absolute and in mm: the rejected line has set neither inches nor increments.
    assert_eq!(ends, [1.0, 2.0]);
}

#[test]
fn a_line_with_an_error_emits_nothing() {
    let items: Vec<_> = Interpreter::new(&b"(MSG, go) T1 S5 M3 G1 X1"[..], settings()).collect();
    assert!(matches!(&items[0], Err(error) if error.code == Code::FeedMissing));
    assert!(matches!(&items[1], Ok(command) if command.action == evolvent_gcode::Action::ProgramEnd));
    assert_eq!(items.len(), 2);
}

#[test]
fn reading_continues_after_a_line_that_is_too_long() {
    let mut program = vec![b' '; 100_000];
    program.extend_from_slice(b"\nG6");
    let found = errors(&program);
    assert_eq!(found.len(), 2);
    assert_eq!((found[0].code, found[0].line), (Code::LineTooLong, 1));
    assert_eq!((found[1].code, found[1].line), (Code::UnknownG, 2));
}

/// Returns some lines, then fails like a disconnected USB stick.
struct Broken(&'static [u8]);

impl std::io::Read for Broken {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.0.is_empty() {
            return Err(std::io::Error::other("device gone"));
        }
        std::io::Read::read(&mut self.0, buffer)
    }
}

#[test]
fn a_read_error_is_reported_once() {
    let reader = std::io::BufReader::new(Broken(b"G0 X1\nG0 X"));
    let items: Vec<_> = Interpreter::new(reader, settings()).collect();
    assert_eq!(items.len(), 2);
    assert!(items[0].is_ok());
    let error = items[1].as_ref().unwrap_err();
    assert_eq!((error.code, error.line), (Code::ReadFailed, 2));
    assert!(error.message.contains("device gone"));
}

#[test]
fn truncated_programs_terminate_without_panic() {
    let program = b"%\n(MSG, hi)\nG21 G90 F100\nG1 X1.5 Y-2\nG2 X3 I.75 P2\n/ G4 P1.5\nM30\n%\n";
    for end in 0..program.len() {
        let items: Vec<_> = Interpreter::new(&program[..end], settings()).collect();
        assert!(matches!(items.last(), Some(Ok(_) | Err(_))));
    }
}
