//! Bodies that a thread makes while a client takes them. A client that stops taking ends its body: it holds neither the thread nor
//! memory for longer than [`PAUSE`].

use std::time::{Duration, Instant};

use axum::body::{Body, Bytes};
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

/// How long a client may pause.
const PAUSE: Duration = Duration::from_secs(20);
/// How often a full channel is looked at.
const LOOK: Duration = Duration::from_millis(4);
/// Bytes of a text that are handed over at once.
const PIECE: usize = 64 << 10;
/// Pieces that wait for a client.
const WAITING: usize = 4;

/// A channel for the pieces of a body.
pub(crate) fn channel() -> (mpsc::Sender<Bytes>, mpsc::Receiver<Bytes>) {
    mpsc::channel(WAITING)
}

/// Hands a piece over; false where nobody takes it any more.
pub(crate) fn hand_over(pieces: &mpsc::Sender<Bytes>, piece: Bytes) -> bool {
    hand_over_within(pieces, piece, PAUSE)
}

fn hand_over_within(pieces: &mpsc::Sender<Bytes>, mut piece: Bytes, pause: Duration) -> bool {
    let end = Instant::now() + pause;
    loop {
        match pieces.try_send(piece) {
            Ok(()) => return true,
            Err(TrySendError::Closed(_)) => return false,
            Err(TrySendError::Full(_)) if Instant::now() >= end => return false,
            Err(TrySendError::Full(back)) => piece = back,
        }
        std::thread::sleep(LOOK);
    }
}

/// Hands a whole text over, piece by piece.
pub(crate) fn hand_over_text(pieces: &mpsc::Sender<Bytes>, text: String) {
    let mut rest = Bytes::from(text);
    while !rest.is_empty() {
        let piece = rest.split_to(PIECE.min(rest.len()));
        if !hand_over(pieces, piece) {
            return;
        }
    }
}

/// The response with these pieces as its body.
pub(crate) fn streamed(kind: &'static str, receiver: mpsc::Receiver<Bytes>) -> Response {
    let stream = futures_util::stream::unfold(receiver, |mut receiver| async {
        receiver
            .recv()
            .await
            .map(|bytes| (Ok::<_, std::io::Error>(bytes), receiver))
    });
    ([(CONTENT_TYPE, kind)], Body::from_stream(stream)).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_that_takes_nothing_ends_its_body() {
        let (sender, mut receiver) = channel();
        for _ in 0..WAITING {
            assert!(hand_over_within(
                &sender,
                Bytes::from_static(b"piece"),
                Duration::ZERO
            ));
        }
        let begun = Instant::now();
        let pause = Duration::from_millis(50);
        assert!(!hand_over_within(&sender, Bytes::from_static(b"more"), pause));
        assert!(begun.elapsed() >= pause);
        receiver.try_recv().unwrap();
        assert!(hand_over_within(&sender, Bytes::from_static(b"more"), pause));
        drop(receiver);
        assert!(!hand_over(&sender, Bytes::from_static(b"gone")));
    }

    #[test]
    fn a_text_arrives_whole() {
        let text: String = (0..100_000).map(|i| char::from(b'a' + (i % 26) as u8)).collect();
        let (sender, mut receiver) = channel();
        let sent = text.clone();
        let thread = std::thread::spawn(move || hand_over_text(&sender, sent));
        let mut bytes = Vec::new();
        while let Some(piece) = receiver.blocking_recv() {
            bytes.extend(piece);
        }
        thread.join().unwrap();
        assert_eq!(bytes, text.as_bytes());
    }
}
