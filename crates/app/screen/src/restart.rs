//! How a program would begin in the middle, told before anything moves.

use std::path::Path;
use std::sync::Arc;

use axum::extract::{Path as UrlPath, State};
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use evolvent_bus::Status;
use evolvent_runtime::{Commands, Setup};
use tokio::sync::oneshot;

use crate::messages::RestartInfo;
use crate::programs::{background, present_setup};
use crate::server::Server;

/// Bit of `switches` in the status: lines that begin with `/` are left out.
const BLOCK_DELETE: u32 = 4;

/// The modes in force at a line, and the way there from where the machine stands. It is the way that START with this line takes.
pub(crate) async fn restart(
    State(server): State<Arc<Server>>,
    UrlPath((_key, name, line)): UrlPath<(String, String, u32)>,
) -> Response {
    let Some(file) = server.file_of(&name) else {
        return StatusCode::NOT_FOUND.into_response();
    };
    // The lines before may be many, and loops among them long: one page at a time.
    let Ok(turn) = Arc::clone(&server.restarts).try_acquire_owned() else {
        let text = "the way to another line is being worked out; try again when it is there";
        return (StatusCode::TOO_MANY_REQUESTS, text).into_response();
    };
    let (sender, receiver) = oneshot::channel();
    let started = background("screen-restart", move || {
        let setup = present_setup(&server.setup, server.state_folder.as_deref());
        let setup = setup_at(setup, server.hub.present().as_deref());
        // The page may have gone.
        let _gone = sender.send(restart_of(&file, setup, line));
        drop(turn);
    });
    if started.is_err() {
        return StatusCode::SERVICE_UNAVAILABLE.into_response();
    }
    let Ok(info) = receiver.await else {
        return StatusCode::SERVICE_UNAVAILABLE.into_response();
    };
    match serde_json::to_string(&info) {
        Ok(text) => ([(CONTENT_TYPE, "application/json")], text).into_response(),
        Err(error) => (StatusCode::INTERNAL_SERVER_ERROR, error.to_string()).into_response(),
    }
}

/// The set-up of a program that starts now.
fn setup_at(mut setup: Setup, now: Option<&Status>) -> Setup {
    if let Some(status) = now {
        setup.place = Some(status.position_machine.into());
        setup.tool = status.tool;
        setup.block_delete = status.switches & BLOCK_DELETE != 0;
        setup.rapid_override = status.rapid_override_ratio;
    }
    setup
}

fn restart_of(file: &Path, mut setup: Setup, line: u32) -> RestartInfo {
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
    match Commands::open(file, &setup) {
        Ok(commands) => commands.start().map_or(nothing, |start| RestartInfo {
            line: start.restart.line,
            modes: start.restart.modes.clone(),
            position: axes.iter().map(|&axis| start.restart.position[axis]).collect(),
            steps: start.approach.clone(),
            problem: String::new(),
        }),
        Err(error) => RestartInfo {
            problem: error.to_string(),
            ..nothing
        },
    }
}
