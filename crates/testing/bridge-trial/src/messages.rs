//! Messages of a running bridge.

use std::sync::Mutex;

/// The messages of a bridge, in order.
#[derive(Debug, Default)]
pub struct Messages(Mutex<Vec<String>>);

impl Messages {
    /// Adds a message.
    ///
    /// # Panics
    /// If a thread panicked while it added a message.
    pub fn push(&self, text: &str) {
        self.0.lock().expect("no panic").push(text.to_owned());
    }

    /// Number of messages that contain `part`.
    ///
    /// # Panics
    /// As [`Messages::push`].
    #[must_use]
    pub fn count(&self, part: &str) -> usize {
        let messages = self.0.lock().expect("no panic");
        messages.iter().filter(|text| text.contains(part)).count()
    }

    /// Whether any message contains `part`.
    ///
    /// # Panics
    /// As [`Messages::push`].
    #[must_use]
    pub fn contain(&self, part: &str) -> bool {
        self.count(part) > 0
    }
}
