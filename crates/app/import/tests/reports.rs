//! Every line of a configuration is carried over or reported.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

use evolvent_import::{Import, ImportError, import};

/// A router whose Y is driven by two motors, with the values that a test changes.
const INI: &str = "[EMC]\nMACHINE = router\n[KINS]\nKINEMATICS = trivkins coordinates=XYY\nJOINTS = 3\n\
                   [TRAJ]\nCOORDINATES = X Y\nLINEAR_UNITS = mm\n[EMCIO]\nTOOL_TABLE = tools.tbl\n[AXIS_X]\n\
                   MIN_LIMIT = 0\nMAX_LIMIT = 100\nMAX_VELOCITY = 20\nMAX_ACCELERATION = 200\n[AXIS_Y]\n\
                   MIN_LIMIT = 0\nMAX_LIMIT = 100\nMAX_VELOCITY = 20\nMAX_ACCELERATION = 200\n[JOINT_0]\n\
                   HOME_OFFSET = -5\nHOME_SEARCH_VEL = -10\nHOME_LATCH_VEL = -1\nHOME_SEQUENCE = 0\n\
                   BACKLASH = 0.02\nCOMP_FILE = x.comp\n[JOINT_1]\nHOME_OFFSET = 5\nHOME_SEARCH_VEL = -10\n\
                   HOME_LATCH_VEL = -1\nHOME_SEQUENCE = -1\n[JOINT_2]\nHOME_OFFSET = 5.2\n\
                   HOME_SEARCH_VEL = -10\nHOME_LATCH_VEL = -1\nHOME_SEQUENCE = -1\n";

/// A temporary folder of a test, removed with it.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        // Two tests may use a folder of the same name at the same time.
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let name = format!("evolvent-import-{test}-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, text).expect("a file");
        path
    }

    fn import(&self, ini: &str) -> Result<Import, ImportError> {
        import(&self.write("router.ini", ini), "router")
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        // It may already be removed.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// Key and reason of each line of a section that was not carried over.
fn dropped(import: &Import, section: &str) -> Vec<(String, String)> {
    let all = import.report().dropped.iter();
    all.filter(|line| line.section == section)
        .map(|line| (line.key.clone(), line.reason.clone()))
        .collect()
}

#[test]
fn backlash_is_used_if_the_screw_table_is_unreadable() {
    let folder = Folder::new("backlash");
    let missing = folder.import(INI).expect("a machine");
    assert!(
        missing.machine().contains("backlash_mm = 0.02"),
        "{}",
        missing.machine()
    );
    let keys: Vec<_> = dropped(&missing, "JOINT_0")
        .into_iter()
        .map(|(key, _)| key)
        .collect();
    assert_eq!(keys, ["COMP_FILE"]);
    // The same if the file is not a table.
    folder.write("x.comp", "no numbers\n");
    let odd = folder.import(INI).expect("a machine");
    assert!(odd.machine().contains("backlash_mm = 0.02"), "{}", odd.machine());
    // Next to a table, backlash has no effect, and the report says so.
    folder.write("x.comp", "0 0.001 -0.001\n50 50.002 49.998\n100 100.001 99.999\n");
    let good = folder.import(INI).expect("a machine");
    assert!(good.machine().contains("screw_table"), "{}", good.machine());
    assert!(!good.machine().contains("backlash"), "{}", good.machine());
    assert!(
        matches!(
            &dropped(&good, "JOINT_0")[..],
            [(key, reason)] if key == "BACKLASH" && reason.contains("together with COMP_FILE")
        ),
        "{:?}",
        good.report()
    );
}

#[test]
fn odd_tool_table_lines_are_named_and_the_rest_kept() {
    let folder = Folder::new("tools");
    folder.write(
        "tools.tbl",
        "T1 P1 D6 Z10 ; six\nTOOLS of May\nT2 P2 D8 Z12\nD5\nT1 P9\nT3 Q77\nT4 P4 D3\n",
    );
    let import = folder.import(INI).expect("a machine");
    assert!(
        import.machine().contains("tool_table = \"router.tbl\""),
        "{}",
        import.machine()
    );
    let lines: Vec<_> = import
        .report()
        .dropped
        .iter()
        .filter(|line| line.file.ends_with("tools.tbl"))
        .map(|line| (line.line, line.value.as_str()))
        .collect();
    assert_eq!(
        lines,
        [(2, "TOOLS of May"), (4, "D5"), (5, "T1 P9"), (6, "T3 Q77")]
    );
    let files = import.write(&folder.0.join("router.toml"), true).expect("files");
    let table = files
        .iter()
        .find(|file| file.ends_with("router.tbl"))
        .expect("a table");
    let table = std::fs::read_to_string(table).expect("a table");
    for tool in ["T1 P1", "six", "T2 P2", "T4 P4"] {
        assert!(table.contains(tool), "{tool} is missing in {table}");
    }
    // Many invalid lines are counted, and a file without any tool is dropped completely.
    folder.write("tools.tbl", &format!("T1 P1\n{}", "odd\n".repeat(500)));
    let import = folder.import(INI).expect("a machine");
    let named = import.report().dropped.iter().filter(|line| line.value == "odd");
    assert_eq!(named.count(), 20);
    let told = dropped(&import, "EMCIO");
    assert!(
        told.iter().any(|(_, reason)| reason.contains("480 more lines")),
        "{told:?}"
    );
    folder.write("tools.tbl", "nothing of a table\n");
    let import = folder.import(INI).expect("a machine");
    assert!(!import.machine().contains("tool_table"), "{}", import.machine());
}

#[test]
fn a_second_gantry_motor_is_directed_to_its_table() {
    let folder = Folder::new("gantry");
    let import = folder.import(INI).expect("a machine");
    let told = dropped(&import, "JOINT_2");
    assert_eq!(told.len(), 4, "{told:?}");
    for (key, reason) in told {
        assert!(reason.contains("the second motor of Y"), "{key}: {reason}");
        assert!(reason.contains("[axis.gantry]"), "{key}: {reason}");
        assert_eq!(
            key == "HOME_OFFSET",
            reason.contains("squaring_offset"),
            "{key}: {reason}"
        );
    }
    assert_eq!(dropped(&import, "JOINT_1"), []);
}

#[test]
fn a_home_offset_that_no_machine_has_is_named() {
    let folder = Folder::new("offset");
    // A switch beyond the travel is common and is kept.
    let import = folder.import(INI).expect("a machine");
    assert!(
        import.machine().contains("switch_mm = -5"),
        "{}",
        import.machine()
    );
    for value in ["2e9", "-1e300"] {
        let ini = INI.replace("HOME_OFFSET = -5", &format!("HOME_OFFSET = {value}"));
        let error = folder.import(&ini).expect_err("no machine").to_string();
        assert!(error.contains("[JOINT_0] HOME_OFFSET of X"), "{error}");
    }
}

#[test]
fn force_does_not_replace_configuration_files() {
    let folder = Folder::new("own-folder");
    let table = "T1 P1 D0.25 Z1.5 ; inches\n";
    let parameters = "5221\t1.5\n";
    folder.write("router.tbl", table);
    folder.write("router.var", parameters);
    let ini = INI
        .replace("LINEAR_UNITS = mm", "LINEAR_UNITS = inch")
        .replace("tools.tbl", "router.tbl")
        + "[RS274NGC]\nPARAMETER_FILE = router.var\n";
    let import = folder.import(&ini).expect("a machine");
    let read = |name: &str| std::fs::read_to_string(folder.0.join(name)).expect("a file");
    for force in [false, true] {
        let error = import.write(&folder.0.join("router.toml"), force);
        let text = error.expect_err("its own files").to_string();
        assert!(
            text.contains("LinuxCNC's tool table itself; name another file") && !text.contains("--force"),
            "{text}"
        );
        assert_eq!(
            (read("router.tbl").as_str(), read("router.var").as_str()),
            (table, parameters)
        );
        assert!(!folder.0.join("router.toml").exists());
    }
    // Under another name in the same folder, repeatedly.
    let import = evolvent_import::import(&folder.0.join("router.ini"), "evolvent").expect("a machine");
    for _ in 0..2 {
        import
            .write(&folder.0.join("evolvent.toml"), true)
            .expect("files");
        assert_eq!(read("router.tbl"), table);
        assert!(read("evolvent.tbl").contains("D6.35"), "{}", read("evolvent.tbl"));
    }
}

#[test]
fn the_machine_file_has_its_own_extension() {
    let folder = Folder::new("extension");
    folder.write("tools.tbl", "T1 P1 D6\n");
    let import = folder.import(INI).expect("a machine");
    let error = import.write(&folder.0.join("router.tbl"), true);
    let text = error.expect_err("the name of a table").to_string();
    assert!(text.contains("a machine file has the extension .toml"), "{text}");
    assert!(!folder.0.join("router.tbl").exists());
}

#[test]
fn a_latch_at_a_switch_opening_edge_is_named() {
    let folder = Folder::new("latch");
    folder.write("x.comp", "0 0 0\n100 0 0\n");
    let named = |ini: &str| -> Vec<String> {
        let import = folder.import(ini).expect("a machine");
        let lines = dropped(&import, "JOINT_0").into_iter();
        lines
            .filter(|(key, _)| key == "HOME_LATCH_VEL")
            .map(|(_, reason)| reason)
            .collect()
    };
    assert!(named(INI).is_empty());
    let opposite = INI.replacen("HOME_LATCH_VEL = -1", "HOME_LATCH_VEL = 1", 1);
    let reasons = named(&opposite);
    assert!(
        matches!(&reasons[..], [reason] if reason.contains("its sign is not carried over") && reason.contains("correct switch_mm by")),
        "{reasons:?}"
    );
    // With an index pulse the sign belongs to the method.
    let by_index = opposite.replacen("HOME_SEQUENCE = 0", "HOME_SEQUENCE = 0\nHOME_USE_INDEX = YES", 1);
    assert!(named(&by_index).is_empty());
}

/// The start-up code of a machine with these units: the machine-file keys for the start of programs, and the
/// reason if its line is reported.
fn start_of(units: &str, code: Option<&str>) -> (Vec<String>, Vec<String>) {
    let folder = Folder::new("start");
    folder.write("x.comp", "0 0 0\n100 0 0\n");
    let code = code.map_or_else(String::new, |code| format!("RS274NGC_STARTUP_CODE = {code}\n"));
    let ini = INI
        .replace("LINEAR_UNITS = mm", &format!("LINEAR_UNITS = {units}"))
        .replace("[EMCIO]", &format!("[RS274NGC]\n{code}[EMCIO]"));
    let import = folder.import(&ini).expect("a machine");
    let keys =
        (import.machine().lines()).filter(|line| line.contains("_unit = ") || line.starts_with("start_"));
    let keys = keys.map(str::to_owned).collect();
    let reasons = dropped(&import, "RS274NGC")
        .into_iter()
        .map(|(_, reason)| reason)
        .collect();
    (keys, reasons)
}

#[test]
fn programs_start_in_the_unit_and_plane_of_linuxcnc() {
    let start = "start_unit = \"inch\"";
    let parameters = "parameter_unit = \"inch\"";
    for (units, code, expected) in [
        ("mm", None, &[][..]),
        ("inch", None, &[start, parameters][..]),
        ("in", Some("G64 P0.001"), &[start, parameters]),
        ("inch ; of the machine", None, &[start, parameters]),
        ("0.03937007874", None, &[start, parameters]),
        ("inch", Some("G21 G64 P0.01"), &[parameters]),
        ("mm", Some("G90 G20"), &[start]),
        ("mm", Some("G21 (not G20)"), &[]),
        (
            "mm",
            Some("G7 G18"),
            &["start_plane = \"zx\"", "start_x = \"diameter\""],
        ),
        ("mm", Some("G19 G8"), &["start_plane = \"yz\""]),
        ("mm", Some("G17 (G18 G7)"), &[]),
    ] {
        let (keys, reasons) = start_of(units, code);
        assert_eq!(keys, expected, "{units} {code:?}");
        assert!(reasons.is_empty(), "{units} {code:?}: {reasons:?}");
    }
}

#[test]
fn start_up_words_are_carried_over_or_named() {
    for (code, lost) in [
        ("G17 G20 G40 G49 G80 G90 G91.1 G94 G97 G8 G99 G64 P0.001", None),
        ("G7 G18 G21 G61", None),
        ("G19 G61.1", None),
        ("G17.1 G90.1", Some("G17.1 G90.1 ")),
        ("G64 P0.01 Q0.02", Some("Q0.02 ")),
        ("g20 g91 m3 s500 f10", Some("G91 M3 S500 F10 ")),
        ("G64", None),
        ("G54 G92.1", Some("G54 G92.1 ")),
    ] {
        let (_, reasons) = start_of("inch", Some(code));
        match lost {
            None => assert!(reasons.is_empty(), "{code}: {reasons:?}"),
            Some(lost) => assert!(
                matches!(&reasons[..], [reason] if reason.starts_with(lost)),
                "{code}: {reasons:?}"
            ),
        }
    }
    let (_, reasons) = start_of("mm", Some("G64 P[#<_x>] o<begin> call"));
    assert!(
        matches!(&reasons[..], [reason] if reason.contains("expressions")),
        "{reasons:?}"
    );
}

/// A machine file has no stop after every move, so the choice is reported.
#[test]
fn a_start_in_exact_stop_becomes_exact_path() {
    let folder = Folder::new("start");
    folder.write("x.comp", "0 0 0\n100 0 0\n");
    for (code, is_chosen) in [("G61.1", true), ("G61", false)] {
        let ini = INI.replace(
            "[EMCIO]",
            &format!("[RS274NGC]\nRS274NGC_STARTUP_CODE = {code}\n[EMCIO]"),
        );
        let import = folder.import(&ini).expect("a machine");
        assert!(import.machine().contains("mode = \"exact\""), "{code}");
        let mut chosen = import.report().chosen.iter();
        assert_eq!(chosen.any(|value| value.key == "path.mode"), is_chosen, "{code}");
    }
}

/// A value is reported as chosen if it is in the machine file.
#[test]
fn an_absolute_encoder_has_no_speeds_to_choose() {
    let folder = Folder::new("absolute");
    folder.write("x.comp", "0 0 0\n100 0 0\n");
    let chosen = |joint: &str| -> Vec<String> {
        let ini = INI.replacen("HOME_SEARCH_VEL = -10\nHOME_LATCH_VEL = -1\n", joint, 1);
        let import = folder.import(&ini).expect("a machine");
        let chosen = import.report().chosen.iter();
        chosen
            .map(|value| value.key.clone())
            .filter(|key| key.ends_with(" of X") && !key.starts_with("max_jerk"))
            .collect()
    };
    let none: [&str; 0] = [];
    assert_eq!(chosen("HOME_ABSOLUTE_ENCODER = 2\n"), none);
    assert_eq!(chosen("HOME_ABSOLUTE_ENCODER = 1\nHOME_SEARCH_VEL = 900\n"), none);
    assert_eq!(chosen("HOME_SEARCH_VEL = 900\n"), ["search of X", "latch of X"]);
}

/// The lines of a section that were not carried over, by number.
fn lines(import: &Import, section: &str) -> Vec<(u32, String)> {
    let all = import.report().dropped.iter();
    all.filter(|line| line.section == section)
        .map(|line| (line.line, line.reason.clone()))
        .collect()
}

#[test]
fn a_key_that_is_given_twice_is_named() {
    let folder = Folder::new("twice");
    folder.write("x.comp", "0 0 0\n100 0 0\n");
    let ini = INI.replacen(
        "[AXIS_X]\nMIN_LIMIT = 0\nMAX_LIMIT = 100\n",
        "[AXIS_X]\nMIN_LIMIT = 0\nMAX_LIMIT = 90\nMAX_LIMIT = 100\n",
        1,
    );
    let import = folder.import(&ini).expect("a machine");
    assert!(
        import.machine().contains("travel_max_mm = 90"),
        "{}",
        import.machine()
    );
    let named = lines(&import, "AXIS_X");
    assert!(
        matches!(&named[..], [(14, reason)] if reason.contains("the first one applies")),
        "{named:?}"
    );
}

#[test]
fn a_home_offset_without_a_search_is_named() {
    let folder = Folder::new("no-search");
    folder.write("x.comp", "0 0 0\n100 0 0\n");
    let named = |homing: &str| -> Vec<String> {
        let ini = INI.replacen(
            "HOME_OFFSET = -5\nHOME_SEARCH_VEL = -10\nHOME_LATCH_VEL = -1\n",
            homing,
            1,
        );
        let import = folder.import(&ini).expect("a machine");
        let keys = dropped(&import, "JOINT_0").into_iter().map(|(key, _)| key);
        keys.filter(|key| !["HOME_SEQUENCE", "BACKLASH", "COMP_FILE"].contains(&key.as_str()))
            .collect()
    };
    let none: [&str; 0] = [];
    assert_eq!(named("HOME_OFFSET = 5\n"), ["HOME_OFFSET"]);
    assert_eq!(named("HOME_OFFSET = 5\nHOME = 5\n"), none);
    assert_eq!(named("HOME_OFFSET = 0\nHOME_LATCH_VEL = 1\n"), ["HOME_LATCH_VEL"]);
    assert_eq!(
        named("HOME_OFFSET = 5\nHOME_ABSOLUTE_ENCODER = 1\n"),
        ["HOME_OFFSET"]
    );
}

#[test]
fn limits_of_a_wrapped_axis_are_named() {
    let folder = Folder::new("wrapped");
    let named = |limits: &str| {
        let ini = format!(
            "[KINS]\nKINEMATICS = trivkins coordinates=AX\nJOINTS = 2\n[TRAJ]\nLINEAR_UNITS = mm\n[AXIS_A]\n\
             WRAPPED_ROTARY = 1\n{limits}MAX_VELOCITY = 20\nMAX_ACCELERATION = 200\n[JOINT_0]\n\
             HOME_SEQUENCE = 0\n"
        );
        lines(&folder.import(&ini).expect("a machine"), "AXIS_A").len()
    };
    assert_eq!(named("MIN_LIMIT = 0\nMAX_LIMIT = 360\n"), 2);
    assert_eq!(named("MIN_LIMIT = -1e99\nMAX_LIMIT = 1e9\n"), 0);
}

#[test]
fn a_lathe_by_its_axes_alone_is_listed_as_chosen() {
    let folder = Folder::new("kind");
    for (display, letters, kind, is_chosen) in [
        ("", "XZ", "lathe", true),
        ("[DISPLAY]\nLATHE = 1\n", "XZ", "lathe", false),
        ("[DISPLAY]\nLATHE = 1\n", "XYZ", "lathe", false),
        ("", "XYZ", "mill", false),
    ] {
        let ini = format!(
            "{display}[KINS]\nKINEMATICS = trivkins coordinates={letters}\n[TRAJ]\nLINEAR_UNITS = mm\n"
        );
        let import = folder.import(&ini).expect("a machine");
        let line = format!("kind = \"{kind}\"");
        assert!(
            import.machine().contains(&line),
            "{display}{letters}: {}",
            import.machine()
        );
        let chosen = import.report().chosen.iter().any(|value| value.key == "kind");
        assert_eq!(chosen, is_chosen, "{display}{letters}");
    }
}
