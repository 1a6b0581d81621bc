//! The enabling signal of a jog.

/// A continuous jog continues only while its client renews it.
///
/// ```
/// use evolvent_control::JogEnable;
///
/// let mut enable = JogEnable::held(7, 0);
/// assert!(enable.renew(7, 50_000_000));
/// assert_eq!(enable.until_ns(), 50_000_000 + JogEnable::PATIENCE_NS);
/// assert!(!enable.renew(8, 60_000_000), "another client");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JogEnable {
    client: u64,
    until_ns: u64,
}

impl JogEnable {
    /// Time for which a jog continues without being renewed, ns.
    pub const PATIENCE_NS: u64 = 90_000_000;

    /// Started or renewed by `client` at `now_ns`.
    #[must_use]
    pub const fn held(client: u64, now_ns: u64) -> Self {
        Self {
            client,
            until_ns: now_ns.saturating_add(Self::PATIENCE_NS),
        }
    }

    /// Renews the jog. For another client, returns `false` and has no effect.
    pub fn renew(&mut self, client: u64, now_ns: u64) -> bool {
        let mine = client == self.client;
        if mine {
            *self = Self::held(client, now_ns);
        }
        mine
    }

    /// Time until which the jog may continue, ns of the caller's clock.
    #[must_use]
    pub const fn until_ns(self) -> u64 {
        self.until_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_client_that_jogs_keeps_the_jog_going() {
        let mut held = JogEnable::held(7, 1_000);
        assert_eq!(held.until_ns(), 1_000 + JogEnable::PATIENCE_NS);
        assert!(!held.renew(8, 50_000_000));
        assert_eq!(held.until_ns(), 1_000 + JogEnable::PATIENCE_NS);
        assert!(held.renew(7, 50_000_000));
        assert_eq!(held.until_ns(), 50_000_000 + JogEnable::PATIENCE_NS);
    }
}
