//! Serial numbers of clients: each command takes effect once.

/// Maximum number of clients that are remembered.
const MAX_CLIENTS: usize = 256;

/// The last serial number of each client.
///
/// ```
/// use evolvent_control::Serials;
///
/// let mut serials = Serials::default();
/// assert!(serials.admit(7, 1) && serials.admit(7, 5));
/// assert!(!serials.admit(7, 5), "the same command again");
/// assert!(serials.admit(8, 1), "another client");
/// ```
#[derive(Clone, Debug, Default)]
pub struct Serials {
    /// Client and serial number, in order of the last command.
    last: Vec<(u64, u64)>,
}

impl Serials {
    /// Records a command. Returns `false` if its serial number is not above the last of its client, or if the
    /// client has no number.
    ///
    /// Beyond 256 clients, the client that has been silent longest is forgotten.
    pub fn admit(&mut self, client: u64, serial: u64) -> bool {
        if client == 0 || serial == 0 {
            return false;
        }
        match self.last.iter().position(|&(known, _)| known == client) {
            Some(index) if serial <= self.last[index].1 => return false,
            Some(index) => {
                self.last.remove(index);
            }
            None if self.last.len() >= MAX_CLIENTS => {
                self.last.remove(0);
            }
            None => {}
        }
        self.last.push((client, serial));
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_counts_once_and_only_if_it_is_newer() {
        let mut serials = Serials::default();
        assert!(serials.admit(7, 1));
        assert!(!serials.admit(7, 1), "the same again");
        assert!(serials.admit(7, 5), "numbers may be left out");
        assert!(!serials.admit(7, 4), "older");
        assert!(serials.admit(8, 4), "another client counts by itself");
        assert!(!serials.admit(0, 9) && !serials.admit(9, 0), "no number");
    }

    #[test]
    fn client_memory_is_bounded_and_keeps_busy_clients() {
        let mut serials = Serials::default();
        assert!(serials.admit(1, 10));
        for client in 2..10_000 {
            assert!(serials.admit(client, 1));
            if client % 100 == 0 {
                assert!(serials.admit(1, 10 + client));
            }
        }
        assert!(serials.last.len() <= MAX_CLIENTS);
        assert!(!serials.admit(1, 10), "it has spoken often");
    }
}
