//! The C header and the Python module, written from the same tables as the Rust structs.

use crate::domain::{ATTRIBUTE_AXES, ATTRIBUTE_INTERFACE, ATTRIBUTE_PERIOD};
use crate::{
    ACTIVITIES, ANALOG_SIGNALS, BRIDGE_NOTES, BRIDGE_STATES, COMMANDS, ControlAnswer, ControlRequest,
    DIGITAL_SIGNALS, EventKind, Feedback, INTERFACE_VERSION, JOB_RESULTS, LOAD_KINDS, Load, MACHINE_STATES,
    MODES, MachineInputs, MachineOutputs, PLACES_FOR_BRIDGES, PLACES_FOR_OPERATORS, POWER_REQUESTS,
    PROBE_STATES, SETPOINT_FLAGS, SPINDLE_DIRECTIONS, SPINDLE_FLAGS, SPINDLE_WAYS, SPINDLES, STATES,
    SWITCHES, Setpoint, SpindleFeedback, Status, VERDICTS,
};
use evolvent_wire::{AXES, FieldLayout, Payload, Scalar, StructLayout};
use std::fmt::Write;

const PAYLOADS: [StructLayout; 9] = [
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

const COMMAND: &str = "cargo run -p evolvent-bus --example generate-bindings";

/// A group of named numbers: the group's name, its meaning, the entries.
type Constants = (&'static str, &'static str, Vec<(&'static str, u32)>);

fn constants() -> [Constants; 18] {
    [
        (
            "STATE",
            "Values of `state` in Setpoint and Status.",
            STATES.to_vec(),
        ),
        (
            "FLAG",
            "Bits of `flags` in Setpoint and Status.",
            SETPOINT_FLAGS.to_vec(),
        ),
        (
            "POWER",
            "Values of `power_request` in Setpoint.",
            POWER_REQUESTS.to_vec(),
        ),
        (
            "BRIDGE",
            "Values of `bridge_state` in Feedback.",
            BRIDGE_STATES.to_vec(),
        ),
        ("NOTE", "Values of `note` in Feedback.", BRIDGE_NOTES.to_vec()),
        ("LOAD", "Values of `kind` in Load.", LOAD_KINDS.to_vec()),
        (
            "DIRECTION",
            "Values of `spindle_direction` in MachineOutputs.",
            SPINDLE_DIRECTIONS.to_vec(),
        ),
        (
            "WAY",
            "Values of `spindle_way` in MachineOutputs.",
            SPINDLE_WAYS.to_vec(),
        ),
        (
            "PROBE",
            "Values of `probe` in MachineInputs.",
            PROBE_STATES.to_vec(),
        ),
        (
            "SPINDLE",
            "Bits of `flags` in SpindleFeedback.",
            SPINDLE_FLAGS.to_vec(),
        ),
        (
            "EVENT",
            "Numbers on the event channel.",
            EventKind::ALL
                .iter()
                .map(|kind| (kind.name(), kind.number()))
                .collect(),
        ),
        (
            "COMMAND",
            "Values of `command` in ControlRequest.",
            COMMANDS.to_vec(),
        ),
        (
            "VERDICT",
            "Values of `verdict` in ControlAnswer.",
            VERDICTS.to_vec(),
        ),
        (
            "MACHINE",
            "Values of `machine_state` in Status.",
            MACHINE_STATES.to_vec(),
        ),
        (
            "MODE",
            "Values of `mode` in Status and of the command MODE.",
            MODES.to_vec(),
        ),
        ("ACTIVITY", "Values of `activity` in Status.", ACTIVITIES.to_vec()),
        (
            "RESULT",
            "Values of `job_result` in Status.",
            JOB_RESULTS.to_vec(),
        ),
        ("SWITCH", "Bits of `switches` in Status.", SWITCHES.to_vec()),
    ]
}

/// The C header, with static assertions that check it at compile time (C11 or C++11).
#[must_use]
pub fn c_header() -> String {
    let mut out = format!(
        "/* Layout of Evolvent's messages on iceoryx2, interface version {INTERFACE_VERSION}.\n \
         * Generated: do not edit, run `{COMMAND}`.\n *\n \
         * Services are named evolvent/NAME/setpoint, /status, /feedback, /load, /output, /input, /spindle\n \
         * (publish-subscribe), /event,\n \
         * and /control (request-response of ControlRequest and ControlAnswer).\n \
         * Axes are in the order X Y Z A B C U V W. */\n\
         #ifndef EVOLVENT_BUS_H\n#define EVOLVENT_BUS_H\n\n\
         #include <stddef.h>\n#include <stdint.h>\n\n\
         #ifdef __cplusplus\n#define EVOLVENT_STATIC_ASSERT static_assert\nextern \"C\" {{\n\
         #else\n#define EVOLVENT_STATIC_ASSERT _Static_assert\n#endif\n\n\
         #define EVOLVENT_INTERFACE_VERSION {INTERFACE_VERSION}u\n\
         #define EVOLVENT_AXES {AXES}\n\
         #define EVOLVENT_DIGITAL_SIGNALS {DIGITAL_SIGNALS}\n\
         #define EVOLVENT_ANALOG_SIGNALS {ANALOG_SIGNALS}\n\
         #define EVOLVENT_SPINDLES {SPINDLES}\n\
         #define EVOLVENT_ATTRIBUTE_INTERFACE \"{ATTRIBUTE_INTERFACE}\"\n\
         #define EVOLVENT_ATTRIBUTE_PERIOD \"{ATTRIBUTE_PERIOD}\"\n\
         #define EVOLVENT_ATTRIBUTE_AXES \"{ATTRIBUTE_AXES}\"\n"
    );
    for (group, doc, entries) in constants() {
        push(&mut out, format_args!("\n/* {doc} */\n"));
        for (name, number) in entries {
            push(
                &mut out,
                format_args!("#define EVOLVENT_{group}_{name} {number}u\n"),
            );
        }
    }
    for layout in &PAYLOADS {
        c_struct(&mut out, layout);
    }
    out.push_str("\n#ifdef __cplusplus\n}\n#endif\n\n#endif\n");
    out
}

fn c_struct(out: &mut String, layout: &StructLayout) {
    let name = layout.name;
    let upper = name.to_uppercase();
    push(out, format_args!("\n/*"));
    for line in layout.doc {
        push(out, format_args!("{line}\n *"));
    }
    out.push_str("/\n");
    push(
        out,
        format_args!("#define EVOLVENT_{upper}_TYPE_NAME \"{}\"\n", layout.type_name),
    );
    push(
        out,
        format_args!("typedef struct evolvent_{} {{\n", name.to_lowercase()),
    );
    for field in layout.fields {
        let array = field.count.map(|count| format!("[{count}]")).unwrap_or_default();
        push(out, format_args!("    /*{} */\n", field.doc));
        push(
            out,
            format_args!("    {} {}{array};\n", field.scalar.c_name(), field.name),
        );
    }
    let c_name = format!("evolvent_{}_t", name.to_lowercase());
    push(out, format_args!("}} {c_name};\n\n"));
    push(
        out,
        format_args!(
            "EVOLVENT_STATIC_ASSERT(sizeof({c_name}) == {}, \"size of {name}\");\n",
            layout.size_bytes
        ),
    );
    for FieldLayout {
        name: field,
        offset_bytes,
        ..
    } in layout.fields
    {
        push(
            out,
            format_args!(
                "EVOLVENT_STATIC_ASSERT(offsetof({c_name}, {field}) == {offset_bytes}, \"offset of \
                 {name}.{field}\");\n"
            ),
        );
    }
}

/// The Python module: ctypes structures for the `iceoryx2` wheel, and helpers to open channels.
#[must_use]
pub fn python_module() -> String {
    let mut out = format!(
        "\"\"\"Layout of Evolvent's messages on iceoryx2, interface version {INTERFACE_VERSION}, and \
         helpers to read them.\n\nGenerated: do not edit, run `{COMMAND}`.\n\n\
         Needs `pip install iceoryx2==0.10.0` for the helpers; the structures alone need nothing.\n\
         Axes are in the order X Y Z A B C U V W.\n\"\"\"\n\nfrom __future__ import annotations\n\n\
         import ctypes\nimport glob\nimport os\nimport stat\nimport time\n\
         from typing import Any, Optional\n\nINTERFACE_VERSION = {INTERFACE_VERSION}\nAXES = {AXES}\n\
         DIGITAL_SIGNALS = {DIGITAL_SIGNALS}\nANALOG_SIGNALS = {ANALOG_SIGNALS}\nSPINDLES = {SPINDLES}\n\
         PLACES_FOR_BRIDGES = {PLACES_FOR_BRIDGES}\nPLACES_FOR_OPERATORS = {PLACES_FOR_OPERATORS}\n\
         ATTRIBUTE_INTERFACE = \"{ATTRIBUTE_INTERFACE}\"\nATTRIBUTE_PERIOD = \"{ATTRIBUTE_PERIOD}\"\n\
         ATTRIBUTE_AXES = \"{ATTRIBUTE_AXES}\"\n"
    );
    for (group, doc, entries) in constants() {
        push(&mut out, format_args!("\n# {doc}\n"));
        for (name, number) in entries {
            push(&mut out, format_args!("{group}_{name} = {number}\n"));
        }
    }
    for layout in &PAYLOADS {
        python_class(&mut out, layout);
    }
    out.push_str(PYTHON_HELPERS);
    out
}

fn python_class(out: &mut String, layout: &StructLayout) {
    let name = layout.name;
    push(out, format_args!("\n\nclass {name}(ctypes.Structure):\n"));
    let doc: Vec<&str> = layout.doc.iter().map(|line| line.trim()).collect();
    push(
        out,
        format_args!(
            "    \"\"\"{}\n    \"\"\"\n\n",
            doc.join("\n    ").replace("\n    \n", "\n\n")
        ),
    );
    for field in layout.fields {
        let element = field.scalar.ctypes_name();
        let kind = match (field.count, field.scalar) {
            (Some(_), _) => format!("ctypes.Array[ctypes.{element}]"),
            (None, Scalar::F32 | Scalar::F64) => "float".to_owned(),
            (None, _) => "int".to_owned(),
        };
        push(out, format_args!("    {}: {kind}\n", field.name));
    }
    out.push_str("\n    _fields_ = [\n");
    for field in layout.fields {
        let array = field.count.map(|count| format!(" * {count}")).unwrap_or_default();
        push(out, format_args!("        #{}\n", field.doc));
        push(
            out,
            format_args!(
                "        (\"{}\", ctypes.{}{array}),\n",
                field.name,
                field.scalar.ctypes_name()
            ),
        );
    }
    out.push_str("    ]\n\n");
    out.push_str("    def __init__(self, **values: Any) -> None:\n");
    push(
        out,
        format_args!(
            "        super().__init__(interface_version={INTERFACE_VERSION}, struct_size={}, **values)\n\n",
            layout.size_bytes
        ),
    );
    out.push_str("    @staticmethod\n    def type_name() -> str:\n");
    out.push_str("        \"\"\"Name by which iceoryx2 tells payloads apart.\"\"\"\n");
    push(out, format_args!("        return \"{}\"\n", layout.type_name));
}

const PYTHON_HELPERS: &str = r#"

def bus_folders() -> list[str]:
    """Folders in which a core of this user may have opened its bus, the usual one first. Not all need be there."""
    if os.environ.get("EVOLVENT_RUNTIME_DIR"):
        return [os.environ["EVOLVENT_RUNTIME_DIR"]]

    def is_ours(path: Optional[str]) -> bool:
        return bool(path) and os.path.isdir(str(path)) and os.lstat(str(path)).st_uid == os.geteuid()

    folders = ["/run/evolvent"] if is_ours("/run/evolvent") else []
    for session in (os.environ.get("XDG_RUNTIME_DIR"), f"/run/user/{os.geteuid()}"):
        if session and is_ours(session):
            folders.append(f"{session.rstrip('/')}/evolvent")
            break
    return folders + [f"/dev/shm/evolvent-{os.geteuid()}"]


def full_prefix(folder: str, prefix: Optional[str] = None) -> str:
    """What names of segments begin with: the prefix, and a number of this very folder (FNV-1a of path, device, inode).

    Raises PermissionError where the folder is not this user's alone.
    """
    facts = os.lstat(folder)
    if not stat.S_ISDIR(facts.st_mode) or facts.st_uid != os.geteuid() or facts.st_mode & 0o022:
        raise PermissionError(f"the bus's folder {folder} must be a folder of this user to which nobody else may write")
    number = 0x811C9DC5
    for byte in f"{folder}:{facts.st_dev}:{facts.st_ino}".encode():
        number = (number ^ byte) * 0x01000193 & 0xFFFFFFFF
    return f"{'evolvent-' if prefix is None else prefix}{number:08x}-"


def find_core(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> tuple[str, str]:
    """Folder and full prefix of the bus that a machine's core has opened, waiting for it.

    Fails with TimeoutError where there is no core.
    """
    # A single name may be a prefix too, as `open_node` took it up to version 0.1.
    searches = [(f"evolvent/{machine_name}/setpoint".encode(), prefix)]
    if prefix is None:
        searches.append((b"/setpoint", machine_name))
    deadline = time.monotonic() + timeout_s
    while True:
        for folder in filter(os.path.isdir, bus_folders()):
            for wanted, of_prefix in searches:
                full = full_prefix(folder, of_prefix)
                for service in glob.glob(f"{glob.escape(folder)}/services/{full}*.service"):
                    try:
                        with open(service, "rb") as file:
                            if wanted in file.read():
                                return folder, full
                    except OSError:
                        pass  # It is just being made or removed.
        if time.monotonic() >= deadline:
            raise TimeoutError(f"no core of machine {machine_name} of this user within {timeout_s} s")
        time.sleep(0.005)


def open_node(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Any:
    """An iceoryx2 node where a machine's core has its bus, waiting for it. `open_node(PREFIX)` takes the only core of a prefix."""
    import iceoryx2 as iox2

    folder, full = find_core(machine_name, prefix, timeout_s)
    # Waiting for a core that is not up yet is no error worth a line.
    iox2.set_log_level_from_env_or(iox2.LogLevel.Fatal)
    config = iox2.config.global_config()
    config.global_cfg.root_path = iox2.Path.new(folder + "/")
    config.global_cfg.prefix = iox2.FileName.new(full)
    # Signals are the caller's affair.
    return iox2.NodeBuilder.new().config(config).signal_handling_mode(
        iox2.SignalHandlingMode.Disabled
    ).create(iox2.ServiceType.Ipc)


def open_service(node: Any, machine_name: str, channel: str, payload: type, timeout_s: float = 10.0) -> Any:
    """The publish-subscribe service `evolvent/MACHINE_NAME/CHANNEL`, waiting for its core to come up.

    Fails with TimeoutError where there is no core, with RuntimeError where it speaks another version.
    """
    import iceoryx2 as iox2

    name = iox2.ServiceName.new(f"evolvent/{machine_name}/{channel}")
    wanted = iox2.AttributeVerifier.new().require(
        iox2.AttributeKey.new(ATTRIBUTE_INTERFACE), iox2.AttributeValue.new(str(INTERFACE_VERSION))
    )
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            return node.service_builder(name).publish_subscribe(payload).open_with_attributes(wanted)
        except iox2.PublishSubscribeOpenError as error:
            reason = str(error)
        if "Incompatible" in reason or "DoesNotSupport" in reason:
            raise RuntimeError(f"{name}: the core does not fit this module ({reason})")
        if time.monotonic() >= deadline:
            raise TimeoutError(f"{name}: no core within {timeout_s} s ({reason})")
        time.sleep(0.005)


class Reader:
    """Messages of one channel, in order."""

    def __init__(
        self,
        machine_name: str,
        channel: str,
        payload: type,
        prefix: Optional[str] = None,
        timeout_s: float = 10.0,
        places_left: int = 0,
        buffer: Optional[int] = None,
    ) -> None:
        """`places_left` are left to others: `RuntimeError` where no more than these are free. `buffer` messages wait, else as many as the channel permits."""
        self._payload: Any = payload
        self._node = open_node(machine_name, prefix, timeout_s)
        self._service = open_service(self._node, machine_name, channel, payload, timeout_s)
        taken = self._service.dynamic_config.number_of_subscribers
        if taken + places_left >= self._service.static_config.max_subscribers:
            raise RuntimeError(f"{channel} of {machine_name} has no place for another reader: close one")
        builder = self._service.subscriber_builder()
        self._subscriber = (builder if buffer is None else builder.buffer_size(buffer)).create()

    @property
    def attributes(self) -> dict[str, str]:
        """The service's attributes as a dict of texts."""
        return {a.key.to_string(): a.value.to_string() for a in self._service.attributes.values}

    def receive(self) -> Any:
        """A copy of the oldest message not read yet, or None. Does not wait."""
        sample = self._subscriber.receive()
        if sample is None:
            return None
        try:
            message = self._payload.from_buffer_copy(sample.payload().contents)
        finally:
            sample.delete()
        if message.interface_version != INTERFACE_VERSION or message.struct_size != ctypes.sizeof(self._payload):
            raise RuntimeError(f"a message of interface version {message.interface_version}: update the older side")
        return message


def open_setpoints(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Reader:
    """A reader of every setpoint from now on; more than the buffer behind, it loses the oldest."""
    return Reader(machine_name, "setpoint", Setpoint, prefix, timeout_s, places_left=PLACES_FOR_BRIDGES)


def open_setpoints_of_bridge(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Reader:
    """The same for a drive bridge, for which readers leave a place."""
    return Reader(machine_name, "setpoint", Setpoint, prefix, timeout_s)


def open_status(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Reader:
    """A reader of the latest status."""
    return Reader(machine_name, "status", Status, prefix, timeout_s, places_left=PLACES_FOR_OPERATORS, buffer=1)


def open_outputs(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Reader:
    """A reader of the machine's outputs: those in force, then every change."""
    return Reader(machine_name, "output", MachineOutputs, prefix, timeout_s)


class Sender:
    """Sends messages of one channel."""

    def __init__(
        self, machine_name: str, channel: str, payload: type, prefix: Optional[str] = None, timeout_s: float = 10.0
    ) -> None:
        self._payload: Any = payload
        self._node = open_node(machine_name, prefix, timeout_s)
        self._service = open_service(self._node, machine_name, channel, payload, timeout_s)
        self._publisher = self._service.publisher_builder().create()

    def send(self, message: Any) -> None:
        """Sends a copy of a message. Never waits."""
        sample = self._publisher.loan_uninit()
        sample.write_payload(message).send()


def open_inputs(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Sender:
    """A sender of MachineInputs. Send at least four times in the machine file's `signals.input_timeout_ms`."""
    return Sender(machine_name, "input", MachineInputs, prefix, timeout_s)


def open_spindle(machine_name: str, prefix: Optional[str] = None, timeout_s: float = 10.0) -> Sender:
    """A sender of SpindleFeedback."""
    return Sender(machine_name, "spindle", SpindleFeedback, prefix, timeout_s)
"#;

fn push(out: &mut String, text: std::fmt::Arguments<'_>) {
    // Writing to a String does not fail.
    let _ = out.write_fmt(text);
}
