//! `evolvent ctl`: an operator at the command line.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use evolvent_bus::{
    ClientBus, ClientConfig, ControlClient, Status, StatusReader, bus_folders, cores_of_other_users,
    list_machines,
};
use evolvent_control::CommandCode;

use crate::ctl_answer::tell;
use crate::ctl_args::{Action, CtlArgs};
use crate::ctl_request::request;
use crate::ctl_session::{MAX_POLLS, POLL, STOP_ANSWER, Session};
use crate::ctl_status::{status_to_json, write_status};
use crate::{CommandError, Ending};

/// Maximum time to open the bus, in addition to `--patience`. iceoryx2 waits forever for some kinds of
/// damage.
const OPENING: Duration = Duration::from_secs(15);

pub(crate) fn run(args: &CtlArgs, out: &mut dyn Write, err: &mut dyn Write) -> Result<Ending, CommandError> {
    if !(0.0..=3600.0).contains(&args.patience) {
        return Err(CommandError::Usage("--patience must be 0 to 3600 s".to_owned()));
    }
    let failed = |error: &dyn std::fmt::Display| CommandError::Failed(error.to_string());
    let patience = Duration::from_secs_f64(args.patience);
    let opened = give_up_after(patience + OPENING);
    let name = match &args.machine_name {
        Some(name) => name.clone(),
        None => only_machine(args)?,
    };
    let config = ClientConfig {
        prefix: args.bus_prefix.clone(),
        wait: patience,
        ..ClientConfig::new(&name)
    };
    if let Some(code) = stopping_command(&args.action) {
        // Sends only the command itself, without a status and without one of the connections reserved for
        // screens.
        let mut client = ControlClient::open_in_need(&config).map_err(|error| failed(&error))?;
        opened.store(true, Ordering::Release);
        let answer = client
            .command(&request(code), STOP_ANSWER)
            .map_err(|error| failed(&error))?;
        return tell(&answer, None, args.json, out);
    }
    let bus = ClientBus::open(&config).map_err(|error| failed(&error))?;
    let mut reader = bus.operator_status().map_err(|error| failed(&error))?;
    opened.store(true, Ordering::Release);
    let status = fresh_status(&mut reader)?;
    if matches!(args.action, Action::Status) {
        let written = if args.json {
            writeln!(out, "{}", status_to_json(&status, bus.axes()))
        } else {
            write_status(out, &status, bus.axes(), &name)
        };
        written.map_err(|error| failed(&error))?;
        return Ok(Ending::Clean);
    }
    if let Action::Io { machine } = &args.action {
        return crate::ctl_io::run(&bus, machine.as_deref(), args.json, out);
    }
    let client = ControlClient::open(&config).map_err(|error| failed(&error))?;
    let mut session = Session {
        client,
        reader,
        json: args.json,
        interrupted: Arc::new(AtomicBool::new(false)),
    };
    session.act(&args.action, &status, out, err)
}

/// Actions that stop. They need no status.
fn stopping_command(action: &Action) -> Option<CommandCode> {
    match action {
        Action::Estop => Some(CommandCode::Estop),
        Action::Hold => Some(CommandCode::Hold),
        Action::Stop => Some(CommandCode::Stop),
        Action::JogStop => Some(CommandCode::JogStop),
        Action::Off => Some(CommandCode::Off),
        _ => None,
    }
}

/// Ends the process after a while, unless the returned flag was set: the sender of an emergency stop must
/// learn that it was not delivered.
fn give_up_after(limit: Duration) -> Arc<AtomicBool> {
    let done = Arc::new(AtomicBool::new(false));
    let of_thread = Arc::clone(&done);
    // Without the thread there is no time limit; everything else works as before.
    let _spawned = std::thread::Builder::new().name("limit".into()).spawn(move || {
        std::thread::sleep(limit);
        if !of_thread.load(Ordering::Acquire) {
            let folders = bus_folders(None).unwrap_or_default();
            let folders: Vec<String> = folders
                .iter()
                .map(|(path, _)| path.display().to_string())
                .collect();
            // If standard error is closed, the exit code still reports it.
            let _unread = writeln!(
                std::io::stderr(),
                "error: the bus does not open within {:.0} s, so the command was not sent: use the hardware \
                 stop. This computer is too busy, another process hangs while it opens the bus, or files of \
                 the bus are damaged. Try again; if no client can connect any more, end every core of this \
                 user and remove {}",
                limit.as_secs_f64(),
                folders.join(" and ")
            );
            std::process::exit(1);
        }
    });
    done
}

/// The served machine, if there is only one.
fn only_machine(args: &CtlArgs) -> Result<String, CommandError> {
    let mut machines =
        list_machines(args.bus_prefix.as_deref()).map_err(|error| CommandError::Failed(error.to_string()))?;
    match machines.len() {
        1 => Ok(machines.remove(0)),
        0 => Err(CommandError::Failed(format!(
            "no machine is served on this computer by this user; start `evolvent serve`{}",
            cores_of_other_users(args.bus_prefix.as_deref())
        ))),
        _ => Err(CommandError::Usage(format!(
            "several machines are served: {}; choose one with --machine-name",
            machines.join(", ")
        ))),
    }
}

/// A status that is not older than its publisher.
fn fresh_status(reader: &mut StatusReader) -> Result<Status, CommandError> {
    let mut first: Option<u64> = None;
    for _ in 0..MAX_POLLS {
        let latest = reader
            .latest()
            .map_err(|error| CommandError::Failed(error.to_string()))?;
        if let Some(status) = latest {
            // A status that does not change may belong to a dead core.
            if first.is_some_and(|first| status.sequence > first) {
                return Ok(status);
            }
            first.get_or_insert(status.sequence);
        }
        std::thread::sleep(POLL);
    }
    Err(CommandError::Failed(
        "the core has ended: its status does not change; start it again".to_owned(),
    ))
}
