//! Random programs of tool changes, compared with LinuxCNC.

use std::ffi::OsStr;
use std::fmt::Write as _;

use evolvent_random::{Random, cases, seed, seed_of_time};

use crate::rs274;

/// Tools of the random programs: number and row of a table in mm. Stand-alone `rs274` names tools by their
/// row, which is the number here.
const TOOLS: [(u32, &str); 5] = [
    (1, "P11 Z12.5 D6"),
    (2, "P7 Z-40.25 X1.5 D8 I-35 J35 Q2"),
    (3, "P3 Z3 Y-2 D0.5"),
    (4, "P1 Z100 D20 I95 J155 Q6"),
    (5, "P12 Z0.75 X-3 Y4 D3"),
];

/// A random program with T, M6, tool lengths, and the words of M61 and M66. Figures are compared as ratios:
/// the parameters of a tool are in inches in stand-alone `rs274`, and in mm here. T0, M61 with a tool, and
/// the value of M66 are left out: `rs274` ignores them or does not have them.
fn random_program(random: &mut Random) -> String {
    let mut text = "G21 G90\nT2 M6\n".to_owned();
    let tool = |random: &mut Random| random.one_of(&TOOLS).0;
    for step in 1..=6 + random.below(30) {
        let line = match random.below(20) {
            0..=2 => format!("T{} M6", tool(random)),
            3 => format!("T{}", tool(random)),
            4 => "M6".to_owned(),
            5 => format!("T{}\nT{} M6", tool(random), tool(random)),
            6..=9 => "G43".to_owned(),
            10 => format!("G43 H{}", tool(random)),
            11 => "G49".to_owned(),
            12 => format!("G10 L1 P{} Z{} R{}", tool(random), 1 + step, random.below(9)),
            13 => format!("T{} M6 G43 H{}", tool(random), tool(random)),
            14 => format!("G43.1 Z{}", step),
            15 => format!(
                "M66 {}",
                random.one_of(&["P0 L0", "P1 L3 Q1", "P0 L1 Q0.5", "P3 L4 Q2", "E0 L0"])
            ),
            // Each of these may be an error, which ends the program.
            16 if random.below(4) == 0 => {
                let invalid = [
                    "M66 L0",
                    "M66 P0 E0 L0",
                    "M66 E0 L1 Q1",
                    "M66 P0 L3",
                    "M66 P0 L3 Q0",
                    "M66 P-1 L0",
                    "M66 P0 L-1",
                    "M66 P0",
                    "M66 P0 Q1",
                    "M61",
                    "M61 Q-1",
                    "M61 Q99",
                    "T99",
                    "T99 M6",
                    "T-1",
                    "G43 H99",
                    "G10 L1 Z1",
                    "G43 I1",
                    "T2 M61 Q3 M6",
                ];
                (*random.one_of(&invalid)).to_owned()
            }
            // After a tool change stand-alone `rs274` does not know the position of the axes.
            _ => format!("G0 X{} Y{} Z{step}", random.below(9), random.below(9)),
        };
        let _written = writeln!(text, "{line}");
        if random.below(3) == 0 {
            text += "(PRINT,#5400 #<_current_tool> #<_selected_tool> #5411 #5412 #5413)\n";
        }
        if random.below(4) == 0 {
            text +=
                "G4 P[ABS[#5410 / #5403 / 7]]\nG4 P[10 + #5401 / #5403 / 7]\nG4 P[10 + #5402 / #5403 / 7]\n";
        }
    }
    text + "M2\n"
}

#[test]
fn random_tool_changes_match_linuxcnc() {
    let Some(folder) = rs274::linuxcnc() else { return };
    let mut random = Random::from_state(seed(seed_of_time()));
    let folder_of_programs = tempfile::tempdir().expect("a folder");
    let rows: String = TOOLS.map(|(number, row)| format!("T{number} {row}\n")).concat();
    let table = folder_of_programs.path().join("tools.tbl");
    std::fs::write(&table, rows).expect("a file");
    let mut programs = Vec::new();
    for number in 0..cases(150) {
        let file = folder_of_programs.path().join(format!("{number}.ngc"));
        std::fs::write(&file, random_program(&mut random)).expect("a file");
        programs.push(file);
    }
    rs274::assert_equal(&folder, &[OsStr::new("--tools"), table.as_os_str()], &programs);
}
