//! Hostile configurations give an error or a valid machine, never a panic.

use evolvent_import::import;
use proptest::prelude::*;

const GOOD: &str = "[EMC]\nMACHINE = Router\n[KINS]\nKINEMATICS = trivkins coordinates=XYYZA\nJOINTS = 5\n\
[TRAJ]\nCOORDINATES = X Y Y Z A\nLINEAR_UNITS = inch\nANGULAR_UNITS = degree\nMAX_LINEAR_VELOCITY = 5\n\
[EMCMOT]\nSERVO_PERIOD = 1000000\n[RS274NGC]\nRS274NGC_STARTUP_CODE = G20 G64 P0.001\n\
PARAMETER_FILE = a.var\n[AXIS_X]\nMIN_LIMIT = -1\nMAX_LIMIT = 40\nMAX_VELOCITY = 4\nMAX_ACCELERATION = 30\n\
[JOINT_0]\nHOME_SEARCH_VEL = -1.5\nHOME_LATCH_VEL = 0.1\nHOME_OFFSET = -0.5\nHOME_SEQUENCE = -1\n\
FERROR = 0.05\nMIN_FERROR = 0.01\nBACKLASH = 0.001\n";

fn words() -> impl Strategy<Value = String> {
    prop_oneof![
        "[ -~]{0,12}",
        any::<f64>().prop_map(|value| value.to_string()),
        Just("1e999".to_owned()),
        Just("XYZABCUVW".to_owned()),
        Just("-0".to_owned()),
        Just("\u{0}\u{feff}\"\\".to_owned()),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn changed_lines_give_a_reason_or_a_valid_machine(changes in prop::collection::vec((0_usize..40, words(), any::<bool>()), 1..6)) {
        let mut lines: Vec<String> = GOOD.lines().map(str::to_owned).collect();
        for (at, word, is_value) in changes {
            let at = at % lines.len();
            let key = lines[at].split('=').next().unwrap_or_default().to_owned();
            lines[at] = if is_value { format!("{key}= {word}") } else { word };
        }
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("m.ini");
        std::fs::write(&file, lines.join("\n")).expect("a file");
        match import(&file, "m") {
            Ok(import) => {
                evolvent_machine::Machine::parse(import.machine(), "m.toml").expect("a valid machine");
            }
            Err(error) => prop_assert!(error.to_string().contains("m.ini"), "{error}"),
        }
    }

    #[test]
    fn any_bytes_are_read(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("m.ini");
        std::fs::write(&file, bytes).expect("a file");
        let _any = import(&file, "m");
    }
}
