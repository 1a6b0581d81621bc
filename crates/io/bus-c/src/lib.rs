//! The bus for C: a few functions for a bridge to drives and signals. The header is
//! `tools/include/evolvent_bridge.h`, examples are `tools/examples/bridge.c` and `signals.c`.
//!
//! No package registry has iceoryx2's own C binding at the version of the bus, so a bridge in C would have to
//! be built with a checkout of it. This library is built with the workspace (`cargo build -p evolvent-bus-c`)
//! and always uses the same version.
//!
//! A handle belongs to the thread that opened it. No function panics across the C interface: an error is a
//! return value and a sentence.
//!
//! A client that prints setpoints; `tools/examples/bridge.c` is a whole bridge, which the tests compile, link
//! and run:
//!
//! ```c
//! char error[256];
//! evolvent_bridge_t *bus = evolvent_bridge_open("mill-3axis", NULL, 1000, error, sizeof error);
//! evolvent_setpoint_t s;
//! while (bus && evolvent_bridge_receive(bus, &s) == 1) printf("%f mm\n", s.position[0]);
//! ```

use core::ffi::{CStr, c_char, c_int};
use core::time::Duration;
use std::ffi::CString;

use evolvent_bus::{
    ClientBus, ClientConfig, Feedback, FeedbackSender, InputSender, MachineInputs, MachineOutputs,
    OutputReader, ReceiveError, Setpoint, SetpointReader,
};

/// One bridge on one bus.
#[derive(Debug)]
pub struct EvolventBridge {
    setpoints: SetpointReader,
    feedback: FeedbackSender,
    /// Opened at first use: a bridge without signals takes no connection for them.
    outputs: Option<OutputReader>,
    inputs: Option<InputSender>,
    period_ns: u64,
    axes: CString,
    error: CString,
    client: ClientBus,
}

impl EvolventBridge {
    fn fail(&mut self, error: &dyn core::fmt::Display) -> c_int {
        self.error = CString::new(error.to_string()).unwrap_or_default();
        BROKEN
    }
}

/// A message was received.
const SOME: c_int = 1;
/// No message, or success.
const NONE: c_int = 0;
/// The bus is broken; open it again.
const BROKEN: c_int = -1;
/// A setpoint of another interface version arrived; it was dropped.
const VERSION: c_int = -2;

fn text(pointer: *const c_char) -> Option<String> {
    if pointer.is_null() {
        return None;
    }
    // SAFETY: not null; the caller gives a text that ends with zero, as the header says.
    let text = unsafe { CStr::from_ptr(pointer) };
    text.to_str().ok().map(str::to_owned)
}

/// Copies a sentence into the caller's buffer, truncated to fit and terminated by zero.
fn tell(sentence: &str, room: *mut c_char, size: usize) {
    if room.is_null() || size == 0 {
        return;
    }
    let count = sentence.len().min(size - 1);
    // SAFETY: the caller's buffer has `size` bytes, as the header requires, and `count + 1` is not more.
    let room = unsafe { core::slice::from_raw_parts_mut(room.cast::<u8>(), count + 1) };
    room[..count].copy_from_slice(&sentence.as_bytes()[..count]);
    room[count] = 0;
}

/// Opens the bus of a machine as its bridge. See the header.
///
/// # Safety
/// `machine_name` is a zero-terminated text; `prefix` is one or null; `error` has `error_size` bytes or is
/// null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn evolvent_bridge_open(
    machine_name: *const c_char,
    prefix: *const c_char,
    wait_ms: u32,
    error: *mut c_char,
    error_size: usize,
) -> *mut EvolventBridge {
    let Some(name) = text(machine_name) else {
        tell("the machine's name is not valid text", error, error_size);
        return core::ptr::null_mut();
    };
    let mut config = ClientConfig::new(&name);
    config.prefix = text(prefix).filter(|prefix| !prefix.is_empty());
    config.wait = Duration::from_millis(u64::from(wait_ms));
    let opened = ClientBus::open(&config).and_then(|client| {
        Ok(EvolventBridge {
            setpoints: client.bridge_setpoints()?,
            feedback: client.feedback_sender()?,
            period_ns: client.period_ns(),
            axes: CString::new(client.axes()).unwrap_or_default(),
            error: CString::default(),
            outputs: None,
            inputs: None,
            client,
        })
    });
    match opened {
        Ok(bridge) => Box::into_raw(Box::new(bridge)),
        Err(cause) => {
            tell(&cause.to_string(), error, error_size);
            core::ptr::null_mut()
        }
    }
}

/// Takes the oldest setpoint not taken yet. See the header.
///
/// # Safety
/// `bridge` is open; `setpoint` has space for one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn evolvent_bridge_receive(
    bridge: *mut EvolventBridge,
    setpoint: *mut Setpoint,
) -> c_int {
    // SAFETY: the caller gives an open bridge, or null.
    let Some(bridge) = (unsafe { bridge.as_mut() }) else {
        return BROKEN;
    };
    if setpoint.is_null() {
        return BROKEN;
    }
    match bridge.setpoints.receive() {
        Ok(Some(found)) => {
            // SAFETY: not null, and the caller provides space for one setpoint; the layout is that of the
            // header.
            unsafe { setpoint.write_unaligned(found) };
            SOME
        }
        Ok(None) => NONE,
        Err(error) => {
            bridge.error = CString::new(error.to_string()).unwrap_or_default();
            if matches!(error, ReceiveError::Version { .. }) {
                VERSION
            } else {
                BROKEN
            }
        }
    }
}

/// Sends feedback. See the header.
///
/// # Safety
/// `bridge` is open; `feedback` points to one.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn evolvent_bridge_send(
    bridge: *mut EvolventBridge,
    feedback: *const Feedback,
) -> c_int {
    // SAFETY: the caller gives an open bridge, or null.
    let Some(bridge) = (unsafe { bridge.as_mut() }) else {
        return BROKEN;
    };
    if feedback.is_null() {
        return BROKEN;
    }
    // SAFETY: not null, and the caller gives one feedback; every bit pattern is a value of it.
    let mut message = unsafe { feedback.read_unaligned() };
    // This library sets the header of the message.
    let head = Feedback::default();
    (message.interface_version, message.struct_size) = (head.interface_version, head.struct_size);
    match bridge.feedback.send(&message) {
        Ok(_) => NONE,
        Err(error) => {
            bridge.error = CString::new(error.to_string()).unwrap_or_default();
            BROKEN
        }
    }
}

/// Takes the oldest change of the machine's outputs not taken yet. See the header.
///
/// # Safety
/// `bridge` is open; `outputs` has space for them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn evolvent_bridge_receive_outputs(
    bridge: *mut EvolventBridge,
    outputs: *mut MachineOutputs,
) -> c_int {
    // SAFETY: the caller gives an open bridge, or null.
    let Some(bridge) = (unsafe { bridge.as_mut() }) else {
        return BROKEN;
    };
    if outputs.is_null() {
        return BROKEN;
    }
    if bridge.outputs.is_none() {
        match bridge.client.outputs() {
            Ok(reader) => bridge.outputs = Some(reader),
            Err(error) => return bridge.fail(&error),
        }
    }
    match bridge.outputs.as_mut().map(OutputReader::receive) {
        Some(Ok(Some(found))) => {
            // SAFETY: not null, and the caller provides space for them; the layout is that of the header.
            unsafe { outputs.write_unaligned(found) };
            SOME
        }
        Some(Ok(None)) | None => NONE,
        Some(Err(error)) => {
            let broken = bridge.fail(&error);
            if matches!(error, ReceiveError::Version { .. }) {
                VERSION
            } else {
                broken
            }
        }
    }
}

/// Sends the machine's inputs. See the header.
///
/// # Safety
/// `bridge` is open; `inputs` points to them.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn evolvent_bridge_send_inputs(
    bridge: *mut EvolventBridge,
    inputs: *const MachineInputs,
) -> c_int {
    // SAFETY: the caller gives an open bridge, or null.
    let Some(bridge) = (unsafe { bridge.as_mut() }) else {
        return BROKEN;
    };
    if inputs.is_null() {
        return BROKEN;
    }
    if bridge.inputs.is_none() {
        match bridge.client.input_sender() {
            Ok(sender) => bridge.inputs = Some(sender),
            Err(error) => return bridge.fail(&error),
        }
    }
    // SAFETY: not null, and the caller gives inputs; every bit pattern is a value of them.
    let mut message = unsafe { inputs.read_unaligned() };
    // This library sets the header of the message.
    let head = MachineInputs::default();
    (message.interface_version, message.struct_size) = (head.interface_version, head.struct_size);
    match bridge.inputs.as_mut().map(|sender| sender.send(&message)) {
        Some(Err(error)) => bridge.fail(&error),
        _ => NONE,
    }
}

/// The core's period in ns; 0 for a null bridge.
///
/// # Safety
/// `bridge` is open, or null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn evolvent_bridge_period_ns(bridge: *const EvolventBridge) -> u64 {
    // SAFETY: the caller gives an open bridge, or null.
    unsafe { bridge.as_ref() }.map_or(0, |bridge| bridge.period_ns)
}

/// The letters of the machine's axes in order; valid as long as the bridge.
///
/// # Safety
/// `bridge` is open, or null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn evolvent_bridge_axes(bridge: *const EvolventBridge) -> *const c_char {
    // SAFETY: the caller gives an open bridge, or null.
    unsafe { bridge.as_ref() }.map_or(c"".as_ptr(), |bridge| bridge.axes.as_ptr())
}

/// The last error as a sentence; valid until the next call.
///
/// # Safety
/// `bridge` is open, or null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn evolvent_bridge_error(bridge: *const EvolventBridge) -> *const c_char {
    // SAFETY: the caller gives an open bridge, or null.
    unsafe { bridge.as_ref() }.map_or(c"no bridge".as_ptr(), |bridge| bridge.error.as_ptr())
}

/// Closes a bridge; null counts as closed.
///
/// # Safety
/// `bridge` came from [`evolvent_bridge_open`] and is not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn evolvent_bridge_close(bridge: *mut EvolventBridge) {
    if !bridge.is_null() {
        // SAFETY: it came from a box, and the caller returns it.
        drop(unsafe { Box::from_raw(bridge) });
    }
}
