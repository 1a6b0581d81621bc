//! The chatter case of the service, computed once: limits over spindle speed, on which a page marks the
//! present speed.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use axum::extract::State;
use axum::http::StatusCode;
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use evolvent_analysis::{ChatterAnswer, ChatterRequest, read_chatter_case};
use tokio::sync::oneshot;

use crate::programs::background;
use crate::server::Server;

/// The case file and its result.
#[derive(Debug, Default)]
pub(crate) struct ChatterCase {
    file: Option<PathBuf>,
    /// JSON, or the error.
    answer: OnceLock<Result<String, String>>,
}

impl ChatterCase {
    pub(crate) fn new(file: Option<PathBuf>) -> Self {
        Self {
            file,
            answer: OnceLock::new(),
        }
    }

    /// Whether a case was given.
    pub(crate) const fn is_given(&self) -> bool {
        self.file.is_some()
    }

    fn compute(&self) -> Result<String, String> {
        let file = self.file.as_deref().ok_or("no case file was given")?;
        let request = ChatterRequest {
            sweep: true,
            ..ChatterRequest::default()
        };
        let answer = read_chatter_case(file).and_then(|case| ChatterAnswer::new(file, case, &request));
        answer
            .map(|answer| answer.json().to_string())
            .map_err(|error| error.to_string())
    }
}

/// The output of `evolvent chatter CASE.toml --json`, without maps.
pub(crate) async fn chatter(State(server): State<Arc<Server>>) -> Response {
    if !server.chatter.is_given() {
        return StatusCode::NOT_FOUND.into_response();
    }
    if server.chatter.answer.get().is_none() {
        let (sender, receiver) = oneshot::channel::<()>();
        let of_thread = Arc::clone(&server);
        let started = background("screen-chatter", move || {
            // Further requests wait for the first.
            of_thread
                .chatter
                .answer
                .get_or_init(|| of_thread.chatter.compute());
            drop(sender);
        });
        if started.is_err() {
            return StatusCode::SERVICE_UNAVAILABLE.into_response();
        }
        // The thread has ended, with or without a result.
        let _ended = receiver.await;
    }
    match server.chatter.answer.get() {
        Some(Ok(text)) => ([(CONTENT_TYPE, "application/json")], text.clone()).into_response(),
        Some(Err(text)) => (StatusCode::UNPROCESSABLE_ENTITY, text.clone()).into_response(),
        None => StatusCode::SERVICE_UNAVAILABLE.into_response(),
    }
}
