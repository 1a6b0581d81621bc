//! What a configuration has is carried over or named, line by line.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::path::PathBuf;

use evolvent_import::{Import, ImportError, import};

/// A router of which two motors drive Y, with the values that a test changes.
const INI: &str = "[EMC]\nMACHINE = router\n[KINS]\nKINEMATICS = trivkins coordinates=XYY\nJOINTS = 3\n[TRAJ]\nCOORDINATES = X Y\n\
                   LINEAR_UNITS = mm\n[EMCIO]\nTOOL_TABLE = tools.tbl\n\
                   [AXIS_X]\nMIN_LIMIT = 0\nMAX_LIMIT = 100\nMAX_VELOCITY = 20\nMAX_ACCELERATION = 200\n\
                   [AXIS_Y]\nMIN_LIMIT = 0\nMAX_LIMIT = 100\nMAX_VELOCITY = 20\nMAX_ACCELERATION = 200\n\
                   [JOINT_0]\nHOME_OFFSET = -5\nHOME_SEARCH_VEL = -10\nHOME_LATCH_VEL = 1\nHOME_SEQUENCE = 0\n\
                   BACKLASH = 0.02\nCOMP_FILE = x.comp\n\
                   [JOINT_1]\nHOME_OFFSET = 5\nHOME_SEARCH_VEL = -10\nHOME_LATCH_VEL = 1\nHOME_SEQUENCE = -1\n\
                   [JOINT_2]\nHOME_OFFSET = 5.2\nHOME_SEARCH_VEL = -10\nHOME_LATCH_VEL = 1\nHOME_SEQUENCE = -1\n";

/// A folder of a test, removed with it.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("evolvent-import-{test}-{}", std::process::id()));
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
        // It may be gone already.
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
fn backlash_counts_where_the_table_of_the_screw_cannot_be_read() {
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
    // Nor where it is none.
    folder.write("x.comp", "no numbers\n");
    let odd = folder.import(INI).expect("a machine");
    assert!(odd.machine().contains("backlash_mm = 0.02"), "{}", odd.machine());
    // Beside a table it has no effect, and says so.
    folder.write("x.comp", "0 0.001 -0.001\n50 50.002 49.998\n100 100.001 99.999\n");
    let good = folder.import(INI).expect("a machine");
    assert!(good.machine().contains("screw_table"), "{}", good.machine());
    assert!(!good.machine().contains("backlash"), "{}", good.machine());
    assert!(
        matches!(&dropped(&good, "JOINT_0")[..], [(key, reason)] if key == "BACKLASH" && reason.contains("beside COMP_FILE")),
        "{:?}",
        good.report()
    );
}

#[test]
fn an_odd_line_of_a_tool_table_is_named_and_the_others_are_kept() {
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
    // Many odd lines are counted, and a file without any tool is dropped as a whole.
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
fn the_second_motor_of_a_gantry_is_told_where_it_belongs() {
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
    // A switch beyond the travel is usual, and kept.
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
fn no_file_of_the_configuration_is_replaced_even_with_force() {
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
    // Under another name beside them, again and again.
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
