//! Limits the number of frames on their way to a page. The kernel buffers megabytes for a stalled link and
//! delivers them afterwards: old figures that look live. A page replies to what it receives (`alive`, twice
//! per second), so one that has not replied for a while receives few frames.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// A page that has not replied for this time receives few frames. It normally replies every 0.5 s.
const REPLY: Duration = Duration::from_millis(1200);
/// Interval of those frames. Without any, the page would have nothing to reply to.
const FEW: Duration = Duration::from_millis(500);

/// The pace of one connection, shared by its reader and writer.
pub(crate) struct Pace {
    begun: Instant,
    /// ms since `begun`; 0 before the first reply: a client that never replies gets all frames.
    heard_ms: AtomicU64,
    sent_ms: AtomicU64,
}

impl Pace {
    pub(crate) fn new() -> Self {
        Self {
            begun: Instant::now(),
            heard_ms: AtomicU64::new(0),
            sent_ms: AtomicU64::new(0),
        }
    }

    /// Notes that the page has sent something.
    pub(crate) fn hear(&self) {
        self.hear_at(self.begun.elapsed());
    }

    /// Whether a frame is sent now; otherwise it is dropped.
    pub(crate) fn may_send(&self) -> bool {
        self.may_send_at(self.begun.elapsed())
    }

    fn hear_at(&self, at: Duration) {
        self.heard_ms.store(ms(at).max(1), Ordering::Relaxed);
    }

    fn may_send_at(&self, at: Duration) -> bool {
        let (now, last_reply) = (ms(at), self.heard_ms.load(Ordering::Relaxed));
        let is_slow = last_reply > 0 && now.saturating_sub(last_reply) > ms(REPLY);
        if is_slow && now.saturating_sub(self.sent_ms.load(Ordering::Relaxed)) < ms(FEW) {
            return false;
        }
        self.sent_ms.store(now, Ordering::Relaxed);
        true
    }
}

fn ms(time: Duration) -> u64 {
    time.as_millis() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames sent from one time to another, at 60 Hz.
    fn sent(pace: &Pace, from_ms: u64, to_ms: u64) -> usize {
        let frames = (from_ms..to_ms).step_by(16);
        frames
            .filter(|&at| pace.may_send_at(Duration::from_millis(at)))
            .count()
    }

    #[test]
    fn a_silent_page_gets_few_frames_until_it_replies() {
        let pace = Pace::new();
        // Before its first reply, and from a client that sends none.
        assert_eq!(sent(&pace, 0, 8000), 500);
        pace.hear_at(Duration::from_millis(8000));
        assert_eq!(sent(&pace, 8000, 9200), 75);
        // A minute without a reply: two a second, not 3750.
        let few = sent(&pace, 9216, 69_216);
        assert!((110..=120).contains(&few), "{few}");
        pace.hear_at(Duration::from_millis(69_216));
        assert_eq!(sent(&pace, 69_216, 70_400), 74);
    }
}
