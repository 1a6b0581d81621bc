//! Response bodies that a thread produces while a client receives them. If the client is too slow, its body
//! ends with an error, so it occupies thread and memory for at most [`PATIENCE`] plus the time that its bytes
//! take at [`MIN_RATE`].

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes};
use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

/// Total time that a body may wait for its client.
const PATIENCE: Duration = Duration::from_secs(20);
/// Minimum rate of a client, bytes per second: each byte adds its time at this rate to the patience. A slow
/// wireless network reaches it.
const MIN_RATE: f64 = (1 << 20) as f64;
/// Poll interval of a full channel.
const POLL_INTERVAL: Duration = Duration::from_millis(4);
/// Size of the pieces of a text, bytes.
const PIECE: usize = 64 << 10;
/// Maximum number of pieces waiting for a client.
const WAITING: usize = 4;

/// A body produced by a thread. If it is dropped before [`finish`](Self::finish), it ends with an error, so a
/// client never mistakes a part for the whole.
#[derive(Debug)]
pub(crate) struct BodyWriter {
    pieces: mpsc::Sender<Bytes>,
    is_whole: Arc<AtomicBool>,
    patience: Duration,
}

/// The client's end of a [`BodyWriter`].
#[derive(Debug)]
pub(crate) struct BodyPieces {
    pieces: mpsc::Receiver<Bytes>,
    is_whole: Arc<AtomicBool>,
}

/// The two ends of a body.
pub(crate) fn body() -> (BodyWriter, BodyPieces) {
    let (sender, receiver) = mpsc::channel(WAITING);
    let is_whole = Arc::new(AtomicBool::new(false));
    let writer = BodyWriter {
        pieces: sender,
        is_whole: Arc::clone(&is_whole),
        patience: PATIENCE,
    };
    let pieces = BodyPieces {
        pieces: receiver,
        is_whole,
    };
    (writer, pieces)
}

impl BodyWriter {
    /// Passes a piece on; returns `false` if the client no longer receives.
    pub(crate) fn hand_over(&mut self, mut piece: Bytes) -> bool {
        let gained = Duration::from_secs_f64(piece.len() as f64 / MIN_RATE);
        let begun = Instant::now();
        loop {
            match self.pieces.try_send(piece) {
                Ok(()) => break,
                Err(TrySendError::Closed(_)) => return false,
                Err(TrySendError::Full(_)) if begun.elapsed() >= self.patience => return false,
                Err(TrySendError::Full(back)) => piece = back,
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        // Patience is limited: a client that was fast for long must not pause for long.
        self.patience = (self.patience.saturating_sub(begun.elapsed()) + gained).min(PATIENCE);
        true
    }

    /// Passes a whole text on, piece by piece.
    pub(crate) fn hand_over_text(mut self, text: String) {
        let mut rest = Bytes::from(text);
        while !rest.is_empty() {
            let piece = rest.split_to(PIECE.min(rest.len()));
            if !self.hand_over(piece) {
                return;
            }
        }
        self.finish();
    }

    /// Whether the client no longer receives.
    pub(crate) fn is_closed(&self) -> bool {
        self.pieces.is_closed()
    }

    /// Waits until the client no longer receives.
    pub(crate) async fn closed(&self) {
        self.pieces.closed().await;
    }

    /// Ends the body successfully.
    pub(crate) fn finish(self) {
        self.is_whole.store(true, Ordering::Release);
    }
}

impl BodyPieces {
    /// The next piece; an error at the end of an incomplete body.
    async fn next(&mut self) -> Option<io::Result<Bytes>> {
        if let Some(piece) = self.pieces.recv().await {
            return Some(Ok(piece));
        }
        // The stream ends after one error.
        let is_whole = self.is_whole.swap(true, Ordering::Acquire);
        (!is_whole).then(|| {
            Err(io::Error::new(
                io::ErrorKind::ConnectionAborted,
                "the body was cut short",
            ))
        })
    }
}

/// The response with these pieces as its body.
pub(crate) fn streamed(kind: &'static str, pieces: BodyPieces) -> Response {
    let stream = futures_util::stream::unfold(pieces, |mut pieces| async {
        let piece = pieces.next().await?;
        Some((piece, pieces))
    });
    ([(CONTENT_TYPE, kind)], Body::from_stream(stream)).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block_on<T>(future: impl Future<Output = T>) -> T {
        tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .unwrap()
            .block_on(future)
    }

    #[test]
    fn a_client_that_takes_nothing_ends_its_body() {
        let (mut writer, mut pieces) = body();
        writer.patience = Duration::from_millis(50);
        for _ in 0..WAITING {
            assert!(writer.hand_over(Bytes::from_static(b"piece")));
        }
        let begun = Instant::now();
        assert!(!writer.hand_over(Bytes::from_static(b"more")));
        assert!(begun.elapsed() >= Duration::from_millis(50));
        pieces.pieces.try_recv().unwrap();
        assert!(writer.hand_over(Bytes::from_static(b"more")));
        drop(pieces);
        assert!(!writer.hand_over(Bytes::from_static(b"gone")));
    }

    #[test]
    fn a_slow_client_exceeds_the_total_patience() {
        let (mut writer, mut pieces) = body();
        writer.patience = Duration::from_millis(200);
        let reader = std::thread::spawn(move || {
            // Each pause is well below the patience.
            for _ in 0..200 {
                std::thread::sleep(Duration::from_millis(40));
                if pieces.pieces.blocking_recv().is_none() {
                    break;
                }
            }
        });
        let mut count = 0;
        while writer.hand_over(Bytes::from_static(b"piece")) {
            count += 1;
            assert!(count < 100, "a body waits for ever");
        }
        assert!(count >= WAITING, "{count}");
        drop(writer);
        reader.join().unwrap();
    }

    #[test]
    fn a_body_that_is_cut_short_ends_with_an_error() {
        for is_whole in [true, false] {
            let (mut writer, mut pieces) = body();
            assert!(writer.hand_over(Bytes::from_static(b"piece")));
            if is_whole {
                writer.finish();
            } else {
                drop(writer);
            }
            let (first, second, third) =
                block_on(async { (pieces.next().await, pieces.next().await, pieces.next().await) });
            assert_eq!(first.unwrap().unwrap(), "piece");
            assert_eq!(second.is_none(), is_whole, "{second:?}");
            assert!(third.is_none());
        }
    }

    #[test]
    fn a_text_arrives_whole() {
        let text: String = (0..100_000).map(|i| char::from(b'a' + (i % 26) as u8)).collect();
        let (writer, mut pieces) = body();
        let sent = text.clone();
        let thread = std::thread::spawn(move || writer.hand_over_text(sent));
        let mut bytes = Vec::new();
        block_on(async {
            while let Some(piece) = pieces.next().await {
                bytes.extend(piece.unwrap());
            }
        });
        thread.join().unwrap();
        assert_eq!(bytes, text.as_bytes());
    }
}
