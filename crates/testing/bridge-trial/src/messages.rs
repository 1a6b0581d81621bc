//! What a bridge says while it runs.

use std::sync::Mutex;

/// The messages of a bridge, in order.
#[derive(Debug, Default)]
pub struct Messages(Mutex<Vec<String>>);

impl Messages {
    /// Adds one.
    ///
    /// # Panics
    /// If a thread panicked while it added one.
    pub fn push(&self, text: &str) {
        self.0.lock().expect("no panic").push(text.to_owned());
    }

    /// How many contain a text.
    ///
    /// # Panics
    /// As [`Messages::push`].
    #[must_use]
    pub fn count(&self, part: &str) -> usize {
        let messages = self.0.lock().expect("no panic");
        messages.iter().filter(|text| text.contains(part)).count()
    }

    /// Whether one contains a text.
    ///
    /// # Panics
    /// As [`Messages::push`].
    #[must_use]
    pub fn contain(&self, part: &str) -> bool {
        self.count(part) > 0
    }
}
