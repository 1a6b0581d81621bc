//! Conversion of a page's command to a request on the bus.

use std::path::PathBuf;

use evolvent_bus::{AXES, ControlRequest};
use evolvent_control::CommandCode;

use crate::messages::CommandMessage;
use crate::programs::is_good_name;

/// Commands that stop; every page may send them.
pub(crate) const STOPPING: [CommandCode; 5] = [
    CommandCode::Estop,
    CommandCode::Off,
    CommandCode::Hold,
    CommandCode::Stop,
    CommandCode::JogStop,
];

/// The command with a number.
pub(crate) fn code_of(number: u32) -> Option<CommandCode> {
    CommandCode::ALL
        .iter()
        .copied()
        .find(|&code| code as u32 == number)
}

/// The request, or the error of the message.
pub(crate) fn request_of(
    message: &CommandMessage,
    file_of: impl Fn(&str) -> PathBuf,
) -> Result<ControlRequest, String> {
    let code = code_of(message.command).ok_or_else(|| format!("{} is not a command", message.command))?;
    let mut request = ControlRequest {
        command: code as u32,
        axes_mask: message.axes_mask,
        index: message.index,
        amount: message.amount,
        ..ControlRequest::default()
    };
    for (axis, &value) in &message.values {
        let slot = axis
            .parse()
            .ok()
            .and_then(|axis: usize| request.values.get_mut(axis));
        *slot.ok_or_else(|| format!("{axis} is not an axis; axes are 0 to {}", AXES - 1))? = value;
    }
    // A page names uploaded programs, not files of the computer.
    let mut text = message.text.clone();
    if code == CommandCode::Load {
        if !is_good_name(&text) {
            return Err(format!("{text:?} is not the name of an uploaded program"));
        }
        text = file_of(&text).display().to_string();
    }
    if request.set_text(&text) {
        Ok(request)
    } else {
        Err(format!("{} bytes are too long for a command", text.len()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(command: u32, text: &str) -> CommandMessage {
        let json = serde_json::json!({"id": 1, "command": command, "text": text});
        serde_json::from_value(json).unwrap()
    }

    #[test]
    fn load_takes_names_only() {
        let folder = |name: &str| PathBuf::from("/programs").join(name);
        let request = request_of(&message(6, "part.ngc"), folder).unwrap();
        assert_eq!(request.text(), Some("/programs/part.ngc"));
        for name in ["../part.ngc", "/etc/passwd", "", ".hidden", "a/b", "a\0b"] {
            request_of(&message(6, name), folder).unwrap_err();
        }
    }

    #[test]
    fn what_is_no_command_is_refused() {
        let folder = |name: &str| PathBuf::from("/programs").join(name);
        request_of(&message(0, ""), folder).unwrap_err();
        request_of(&message(4711, ""), folder).unwrap_err();
        request_of(&message(19, &"x".repeat(2000)), folder).unwrap_err();
        let mut far = message(20, "");
        far.values.insert("9".to_owned(), 1.0);
        request_of(&far, folder).unwrap_err();
    }
}
