//! G and M codes of other dialects that this one does not have, and their equivalent here.

/// Advice for functions that a machine builder connects to an M code.
const USER_CODE: &str = "give it a number from 100 to 199 in user_codes of the machine file, and write that";
const OTHER_OFFSETS: &str = "write G54 to G59, G59.1, G59.2 or G59.3";
const CIRCULAR_POCKET: &str = "write the circles: G3 I.. with the radius, or G13.2, which mills a hole";
const PLAIN_MOVES: &str = "write the moves of the axes, from a postprocessor that computes them, in place of the lines up to its end";
const MIRRORED: &str = "write the coordinates with the other sign, as in X[-#1]";

/// Message and advice for a G code, by its number times ten.
#[cold]
pub(crate) fn g_code(tenths: u32) -> Option<(&'static str, &'static str)> {
    Some(match tenths {
        71 | 1070 => (
            "cylindrical interpolation (G7.1, G107) is not available",
            PLAIN_MOVES,
        ),
        90 => (
            "G9, an exact stop for one line, is not a code of this dialect",
            "write G61.1 before the line and G64 after it",
        ),
        110 => (
            "G11, the end of data input, is not a code of this dialect",
            "delete it: G10 applies to its own line only",
        ),
        120 => (
            "G12, a circular pocket, is not a code of this dialect",
            CIRCULAR_POCKET,
        ),
        130 => (
            "G13, a circular pocket, is not a code of this dialect",
            CIRCULAR_POCKET,
        ),
        121 | 131 | 1120 | 1130 => (
            "polar coordinate interpolation (G12.1, G112) is not available",
            PLAIN_MOVES,
        ),
        150 | 160 => (
            "polar coordinates (G15, G16) are words in this dialect, not codes",
            "write @ for the distance from the program zero and ^ for the angle, as in G0 @10 ^45",
        ),
        220 | 230 => (
            "stored travel limits (G22, G23) are not codes of this dialect",
            "delete the code: the travel of the axes is in the machine file",
        ),
        250 | 260 => (
            "the watch of the spindle speed (G25, G26) is not a code of this dialect",
            "delete the code and its words",
        ),
        270 => (
            "G27, the check of the reference position, is not a code of this dialect",
            "delete the line; the core knows whether an axis is homed",
        ),
        290 => (
            "G29, the return from the reference position, is not a code of this dialect",
            "write the moves back: G0 X.. Y.., then G0 Z..",
        ),
        310 => (
            "G31 is not a code of this dialect: probing is G38",
            "write G38.2 (error without contact) or G38.3",
        ),
        320 => (
            "G32 is not a code of this dialect: threading is G33",
            "write G33 with K, the pitch, or the cycle G76; fanuc_threads = true in [program] of the \
             machine file reads G32 and G92 as Fanuc's lathes do",
        ),
        340 => (
            "G34, a thread with a variable lead, is not a code of this dialect",
            "write short G33 moves one after another, each with its own K",
        ),
        370 => (
            "G37, the automatic measurement of a tool, is not a code of this dialect",
            "write G38.2 Z.. F.. toward the sensor, and G10 L10 P.. Z.. with its height",
        ),
        434 | 435 | 2340 => (
            "tool centre point control (G43.4, G43.5, G234) is not available",
            "write G43 H.. with a program whose postprocessor has computed the rotary axes",
        ),
        440 => (
            "G44, a length that is subtracted, is not a code of this dialect",
            "write G43, with the length as a negative number in the tool table",
        ),
        450 | 460 | 480 => (
            "moves that an offset lengthens or shortens (G45 to G48) are not codes of this dialect",
            "write G41 or G42 with D for the radius of the tool, and G43 H.. for its length",
        ),
        470 => (
            "G47, which engraves text, or lengthens a move, in other dialects, is not a code of this one",
            "write the moves of the characters, or G41 and G42 with D for the radius of the tool",
        ),
        500 | 510 => (
            "scaling (G50, G51) is not a code of this dialect",
            "multiply in the program, as in X[2 * 10]",
        ),
        501 | 511 | 1000 | 1010 => (
            "mirror images (G50.1, G51.1, G100, G101) are not codes of this dialect",
            MIRRORED,
        ),
        531 | 536 | 682 | 684 => (
            "tilted planes (G68.2) are not available",
            "write the program for the axes of the machine",
        ),
        541 => (
            "G54.1 is not a code of this dialect: there are nine work offsets",
            "write G54 to G59, G59.1, G59.2 or G59.3; G10 L2 P1 to P9 and parameters hold more",
        ),
        600 => (
            "G60, positioning from one side, is not a code of this dialect",
            "write two moves, the second one always from the same side",
        ),
        620 | 630 => (
            "the feed in corners and the mode for tapping (G62, G63) are not codes of this dialect",
            "delete the code: G64 P.. sets the tolerance at corners, and G84 taps",
        ),
        650 | 660 | 661 | 670 => (
            "macro calls (G65, G66, G67) are not codes of this dialect: subroutines are called by O-words",
            "write O1000 call [1] [2], whose values are #1 and #2 in O1000 sub ... O1000 endsub; or M98 \
             P1000",
        ),
        680 | 681 => (
            "G68 is not a code of this dialect: coordinates are rotated with a work offset",
            "write G10 L2 P0 R30 to rotate XY by 30 degrees about the work zero, G10 L2 P0 R0 to end it",
        ),
        690 | 691 => (
            "G69 is not a code of this dialect: coordinates are rotated with a work offset",
            "write G10 L2 P0 R0 to end the rotation of the work offset in force",
        ),
        770 | 780 | 790 => (
            "the turning cycles of one pass (G77 to G79) are not codes of this dialect",
            "write each pass as G0 X.., G1 Z.. F.., G0 X.. and G0 Z..; G71 roughs, and G76 cuts threads",
        ),
        1030 => (
            "G103, the limit of the look-ahead, is not a code of this dialect",
            "delete the line: look-ahead ends by itself where the program reads a probe or an input",
        ),
        1500 => (
            "a pocket by its outline (G150) is not a code of this dialect",
            "write the passes of the pocket, or G13.2, which mills a hole",
        ),
        1540 => (
            "G154 is not a code of this dialect: there are nine work offsets",
            OTHER_OFFSETS,
        ),
        1870 => (
            "G187, the smoothness, is G64 in this dialect",
            "delete G187; G64 P0.01 sets the tolerance at corners",
        ),
        2530 | 2540 | 2550 => (
            "work offsets that follow rotary axes (G253, G254, G255) are not available",
            "write the program for the axes of the machine",
        ),
        _ => return None,
    })
}

/// Message and advice for an M code. Below 100 many numbers belong to the builder of the machine.
#[cold]
pub(crate) fn m_code(number: u32) -> Option<(&'static str, &'static str)> {
    Some(match number {
        10 | 11 | 69 => (
            "a clamp (M10, M11, M69) is a command of the machine in other dialects",
            USER_CODE,
        ),
        13 => (
            "M13, spindle and coolant, is not a code of this dialect",
            "write M3 M8",
        ),
        14 => (
            "M14, spindle and coolant, is not a code of this dialect",
            "write M4 M8",
        ),
        17 => (
            "M17, the end of a subroutine, is not a code of this dialect",
            "write O100 endsub, or M99 in a file that M98 calls",
        ),
        31..=33 => (
            "the chip conveyor (M31 to M33) is a command of the machine in other dialects",
            USER_CODE,
        ),
        40..=45 => (
            "a gear (M40 to M45) is a command of the machine in other dialects",
            USER_CODE,
        ),
        83 | 84 => (
            "the air blast (M83, M84) is a command of the machine in other dialects",
            "write M7, if it is connected as mist, and M9; or give it a number from 100 to 199 in user_codes of \
             the machine file, and write that",
        ),
        88 | 89 => (
            "coolant through the spindle (M88, M89) is a command of the machine in other dialects",
            "write M7 or M8, if it is connected to one, and M9; or give it a number from 100 to 199 in \
             user_codes of the machine file, and write that",
        ),
        _ => return None,
    })
}
