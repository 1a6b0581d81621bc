//! The same bytes in every language: Rust, C by its compiler, Python by ctypes.

use evolvent_bus::{
    ControlAnswer, ControlRequest, Feedback, Load, MachineInputs, MachineOutputs, Payload, SETPOINT_FLAGS,
    STATES, Setpoint, SpindleFeedback, Status, StructLayout,
};
use std::fs::{read_to_string, write};
use std::path::{Path, PathBuf};
use std::process::Command;

const LAYOUTS: [StructLayout; 9] = [
    Setpoint::LAYOUT,
    Status::LAYOUT,
    Feedback::LAYOUT,
    Load::LAYOUT,
    MachineOutputs::LAYOUT,
    MachineInputs::LAYOUT,
    SpindleFeedback::LAYOUT,
    ControlRequest::LAYOUT,
    ControlAnswer::LAYOUT,
];

fn tools() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../tools")
}

#[test]
fn shipped_header_and_module_match_generated_ones() {
    for (file, text) in [
        ("include/evolvent_bus.h", evolvent_bus::c_header()),
        ("python/evolvent_bus.py", evolvent_bus::python_module()),
    ] {
        let shipped = read_to_string(tools().join(file)).expect("a file");
        assert!(
            shipped == text,
            "{file} is old: run `cargo run -p evolvent-bus --example generate-bindings`"
        );
    }
}

/// Layout is a contract: a change of a number here requires a new interface version.
#[test]
fn sizes_of_version_1_stay_as_they_are() {
    assert_eq!(evolvent_bus::INTERFACE_VERSION, 1);
    let sizes = LAYOUTS.map(|layout| (layout.type_name, layout.size_bytes));
    assert_eq!(
        sizes,
        [
            ("evolvent.Setpoint.v1", 400),
            ("evolvent.Status.v1", 1840),
            ("evolvent.Feedback.v1", 424),
            ("evolvent.Load.v1", 88),
            ("evolvent.MachineOutputs.v1", 448),
            ("evolvent.MachineInputs.v1", 352),
            ("evolvent.SpindleFeedback.v1", 112),
            ("evolvent.ControlRequest.v1", 1208),
            ("evolvent.ControlAnswer.v1", 632),
        ]
    );
}

/// Sums up sizes by C's alignment rules, independent of the Rust compiler.
#[test]
fn fields_lie_where_natural_alignment_puts_them() {
    for layout in LAYOUTS {
        let mut end: usize = 0;
        for field in layout.fields {
            let size = field.scalar.size_bytes();
            end = end.next_multiple_of(size);
            assert_eq!(field.offset_bytes, end, "{}.{}", layout.name, field.name);
            end += size * field.count.unwrap_or(1);
        }
        assert_eq!(layout.size_bytes, end.next_multiple_of(8), "{}", layout.name);
        let head: Vec<&str> = layout.fields[..2].iter().map(|field| field.name).collect();
        assert_eq!(head, ["interface_version", "struct_size"]);
        // The reserve of these is used up: their next field raises the interface version.
        let last = match layout.type_name {
            "evolvent.Feedback.v1" => "index_position",
            "evolvent.Status.v1" => "phase_error_max_ns",
            _ => "reserved",
        };
        assert_eq!(layout.fields.last().map(|field| field.name), Some(last));
    }
}

#[test]
fn default_payload_is_compatible_and_zero_after_head() {
    let setpoint = Setpoint::default();
    assert!(setpoint.is_compatible());
    assert!(
        !Setpoint {
            interface_version: 2,
            ..setpoint
        }
        .is_compatible()
    );
    assert!(
        !Setpoint {
            struct_size: 8,
            ..setpoint
        }
        .is_compatible()
    );
    assert_eq!(
        (setpoint.sequence, setpoint.position, setpoint.reserved),
        (0, [0.0; 9], [0; 2])
    );
}

#[test]
fn numbers_of_states_and_flags_do_not_repeat() {
    for (i, (name, number)) in STATES.into_iter().enumerate() {
        assert_eq!(number as usize, i, "{name}");
    }
    for (i, (name, bit)) in SETPOINT_FLAGS.into_iter().enumerate() {
        assert_eq!(bit, 1 << i, "{name}");
    }
}

#[test]
fn states_and_flags_are_those_of_the_cycle() {
    use evolvent_motion::{MotionState, flags};
    let states = [
        MotionState::Idle,
        MotionState::Running,
        MotionState::Holding,
        MotionState::Held,
        MotionState::Stopping,
        MotionState::Stopped,
        MotionState::Dwell,
        MotionState::ProgramStop,
        MotionState::Fault,
        MotionState::Done,
    ];
    for (state, (name, number)) in states.into_iter().zip(STATES) {
        let spelled = format!("{state:?}").to_uppercase();
        assert_eq!((state as u32, spelled), (number, name.replace('_', "")));
    }
    let bits = [
        ("LATE", flags::LATE),
        ("HOLD", flags::HOLD),
        ("BLEND", flags::BLEND),
        ("RAPID", flags::RAPID),
        ("JOINT", flags::JOINT),
        ("STARVED", flags::STARVED),
        ("GUARD", flags::GUARD),
        ("LAST", flags::LAST),
    ];
    assert_eq!(SETPOINT_FLAGS, bits);
}

/// The compiler checks sizes and offsets by the header's static assertions; the program prints them once
/// more.
#[test]
fn the_c_compiler_agrees_on_sizes_and_offsets() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut source = "#include <stdio.h>\n#include \"evolvent_bus.h\"\nint main(void) {\n".to_owned();
    for layout in LAYOUTS {
        let c_name = format!("evolvent_{}_t", layout.name.to_lowercase());
        source += &format!("printf(\"{} %zu\\n\", sizeof({c_name}));\n", layout.name);
        for field in layout.fields {
            let (rust, c) = (layout.name, field.name);
            source += &format!("printf(\"{rust}.{c} %zu\\n\", offsetof({c_name}, {c}));\n");
        }
    }
    source += "return 0;\n}\n";
    let (file, program) = (folder.path().join("layout.c"), folder.path().join("layout"));
    write(&file, source).expect("written");
    let compiled = Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Werror", "-pedantic", "-I"])
        .arg(tools().join("include"))
        .arg(&file)
        .arg("-o")
        .arg(&program)
        .output()
        .expect("a C compiler");
    assert!(
        compiled.status.success(),
        "{}",
        String::from_utf8_lossy(&compiled.stderr)
    );
    let printed = Command::new(&program).output().expect("a program");
    assert_eq!(String::from_utf8_lossy(&printed.stdout), expected());
}

/// Needs the environment variable EVOLVENT_PYTHON, the path of any Python 3.
#[test]
fn python_agrees_on_sizes_offsets_and_type_names() {
    let Ok(python) = std::env::var("EVOLVENT_PYTHON") else {
        println!("skipped: EVOLVENT_PYTHON is not set");
        return;
    };
    let script = "import evolvent_bus as bus, ctypes\n\
        for t in (bus.Setpoint, bus.Status, bus.Feedback, bus.Load, bus.MachineOutputs, bus.MachineInputs, \
        bus.SpindleFeedback, bus.ControlRequest, bus.ControlAnswer):\n\x20   print(t.__name__, \
        ctypes.sizeof(t))\n\x20   for field in t._fields_:\n\x20       print(f'{t.__name__}.{field[0]} \
        {getattr(t, field[0]).offset}')\n\
        for t in (bus.Setpoint, bus.Status, bus.Feedback, bus.Load, bus.MachineOutputs, bus.MachineInputs, \
        bus.SpindleFeedback, bus.ControlRequest, bus.ControlAnswer):\n\x20   m = t()\n\x20   assert \
        (m.interface_version, m.struct_size) == (bus.INTERFACE_VERSION, \
        ctypes.sizeof(t))\n\x20   print(t.type_name())\n";
    let printed = Command::new(python)
        .env("PYTHONPATH", tools().join("python"))
        .args(["-B", "-c", script])
        .output()
        .expect("Python");
    assert!(
        printed.status.success(),
        "{}",
        String::from_utf8_lossy(&printed.stderr)
    );
    let names: String = LAYOUTS
        .iter()
        .map(|layout| format!("{}\n", layout.type_name))
        .collect();
    assert_eq!(String::from_utf8_lossy(&printed.stdout), expected() + &names);
}

fn expected() -> String {
    let mut text = String::new();
    for layout in LAYOUTS {
        text += &format!("{} {}\n", layout.name, layout.size_bytes);
        for field in layout.fields {
            text += &format!("{}.{} {}\n", layout.name, field.name, field.offset_bytes);
        }
    }
    text
}
