//! The start in the middle of a program, computed before anything moves.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::extract::{Extension, Path as UrlPath, RawQuery, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use evolvent_bus::Status;
use evolvent_gcode::Code;
use evolvent_runtime::{Commands, ProgramError, Setup};
use tokio::sync::oneshot;

use crate::gate::Role;
use crate::kept::present_setup;
use crate::messages::RestartInfo;
use crate::programs::background;
use crate::server::{Server, upload_of};

/// Bit of `switches` in the status: lines that begin with `/` are skipped.
const BLOCK_DELETE: u32 = 4;
/// Maximum time for interpreting the preceding lines: a slow computer takes a second for 50 MB, and a user
/// does not wait for minutes.
const PATIENCE: Duration = Duration::from_secs(10);
/// Maximum wait for an earlier request: a page that requests another line has given the earlier one up.
const TURN: Duration = Duration::from_secs(2);
/// Maximum memory for loops and subroutines before the line, bytes: a quarter of the limit of a run.
const MAX_BODY_BYTES: usize = 64 << 20;

/// The modes in force at a line, and the approach from the present position. It is the approach that START
/// with this line takes.
pub(crate) async fn restart(
    State(server): State<Arc<Server>>,
    Extension(role): Extension<Role>,
    UrlPath((_key, name, line)): UrlPath<(String, String, u32)>,
    RawQuery(query): RawQuery,
) -> Response {
    if role != Role::Operate {
        return (StatusCode::FORBIDDEN, "this page may only watch").into_response();
    }
    let Some((file, _)) = server.file_of(&name, upload_of(query.as_deref())) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    // There may be many lines before it, with long loops, so one page is served at a time.
    let turn = tokio::time::timeout(TURN, Arc::clone(&server.restarts).acquire_owned()).await;
    let Ok(Ok(turn)) = turn else {
        let text = "the approach to another line is being computed; try again afterwards";
        return (StatusCode::TOO_MANY_REQUESTS, text).into_response();
    };
    let (sender, mut receiver) = oneshot::channel();
    let interrupt = Interrupt::default();
    let interrupted = Arc::clone(&interrupt.0);
    let started = background("screen-restart", move || {
        let setup = present_setup(&server.setup, server.state_folder.as_deref());
        let setup = setup_at(setup, server.hub.present().as_deref());
        // The page may have gone.
        let _gone = sender.send(restart_of(&file, setup, line, interrupted));
        drop(turn);
    });
    if started.is_err() {
        return StatusCode::SERVICE_UNAVAILABLE.into_response();
    }
    let in_time = tokio::time::timeout(PATIENCE, &mut receiver).await;
    let info = match in_time {
        Ok(info) => info,
        Err(_) => {
            interrupt.0.store(true, Ordering::Relaxed);
            receiver.await
        }
    };
    let Ok(info) = info else {
        return StatusCode::SERVICE_UNAVAILABLE.into_response();
    };
    match serde_json::to_string(&info) {
        Ok(text) => ([(CONTENT_TYPE, "application/json")], text).into_response(),
        Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
    }
}

/// Interrupts the interpreter when dropped: the request of a page that has gone is dropped while it waits.
#[derive(Debug, Default)]
struct Interrupt(Arc<AtomicBool>);

impl Drop for Interrupt {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// The setup of a program that starts now.
fn setup_at(mut setup: Setup, now: Option<&Status>) -> Setup {
    if let Some(status) = now {
        setup.position = Some(status.position_machine.into());
        setup.tool = status.tool;
        setup.block_delete = status.switches & BLOCK_DELETE != 0;
        setup.rapid_override = status.rapid_override_ratio;
    }
    setup
}

fn restart_of(file: &Path, mut setup: Setup, line: u32, interrupt: Arc<AtomicBool>) -> RestartInfo {
    setup.start_line = Some(line);
    let axes: Vec<usize> = setup
        .machine
        .axes
        .iter()
        .map(|axis| axis.letter.index())
        .collect();
    let nothing = RestartInfo {
        line,
        modes: String::new(),
        position: Vec::new(),
        steps: Vec::new(),
        problem: String::new(),
    };
    match Commands::open_bounded(file, &setup, MAX_BODY_BYTES, interrupt) {
        Ok(commands) => commands.start().map_or(nothing, |start| RestartInfo {
            line: start.restart.line,
            modes: start.restart.summary(),
            position: axes.iter().map(|&axis| start.restart.position[axis]).collect(),
            steps: start.approach.clone(),
            problem: String::new(),
        }),
        Err(error) => RestartInfo {
            problem: problem_of(&error, line),
            ..nothing
        },
    }
}

fn problem_of(error: &ProgramError, line: u32) -> String {
    match error {
        ProgramError::Text { diagnostic, .. } if diagnostic.code == Code::Interrupted => format!(
            "the lines before line {line} were interpreted for {} s, as far as line {}, and it was not \
             reached; choose an earlier line",
            PATIENCE.as_secs(),
            diagnostic.line
        ),
        _ => error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use evolvent_machine::Machine;

    use super::*;

    fn restart_info(text: &str, line: u32, interrupt: bool) -> RestartInfo {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("part.ngc");
        std::fs::write(&program, text).unwrap();
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let machine = Machine::load(&file).unwrap();
        let setup = Setup::new(machine, file, String::new(), None).unwrap();
        let flag = Arc::new(AtomicBool::new(false));
        let of_thread = Arc::clone(&flag);
        let timer = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(50));
            of_thread.store(interrupt, Ordering::Relaxed);
        });
        let info = restart_of(&program, setup, line, flag);
        timer.join().unwrap();
        info
    }

    #[test]
    fn the_way_to_a_line_is_bounded_by_time() {
        // Some hundred million lines, each with a move.
        let long = "G21 G90 G1 F1000\n#1=0\no1 while [#1 LT 100000000]\n#1=[#1+1]\nG1 X[#1/10000000]\n\
                    o1 endwhile\nG0 Z5\nM2\n";
        let begun = std::time::Instant::now();
        let info = restart_info(long, 7, true);
        assert!(begun.elapsed() < Duration::from_secs(5), "{:?}", begun.elapsed());
        assert!(
            info.problem.contains("line 7 were interpreted for 10 s"),
            "{info:?}"
        );
        let short = restart_info(&long.replace("100000000", "3"), 7, false);
        assert_eq!((short.problem.as_str(), short.line), ("", 7));
    }

    #[test]
    fn the_way_to_a_line_is_bounded_by_memory() {
        let body = "G1 X1 (a line of a loop that is stored to be repeated, with a comment to make it long)\n"
            .repeat(900_000);
        let info = restart_info(
            &format!("G21 G90 G1 F1000\no1 repeat [2]\n{body}o1 endrepeat\nG0 Z5\nM2\n"),
            900_004,
            false,
        );
        assert!(
            info.problem.contains("G0216"),
            "{}",
            &info.problem[..300.min(info.problem.len())]
        );
    }
}
