//! Slots for connections: a limited number in total, and fewer per client.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Fraction of all slots that one client can hold, so that it never locks out the others.
const CLIENT_FRACTION: (usize, usize) = (3, 4);

/// Slots for connections. Each connection holds a [`Slot`] until it ends.
#[derive(Clone, Debug)]
pub(crate) struct Slots {
    free: Arc<Semaphore>,
    held: Arc<Mutex<HashMap<IpAddr, usize>>>,
    per_client: usize,
}

/// The client of a request.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Client(pub(crate) IpAddr);

/// A slot, free again when dropped.
#[derive(Debug)]
pub(crate) struct Slot {
    _permit: OwnedSemaphorePermit,
    held: Arc<Mutex<HashMap<IpAddr, usize>>>,
    client: IpAddr,
}

impl Slots {
    pub(crate) fn new(count: usize) -> Self {
        Self {
            free: Arc::new(Semaphore::new(count)),
            held: Arc::default(),
            per_client: count * CLIENT_FRACTION.0 / CLIENT_FRACTION.1,
        }
    }

    /// Waits for a free slot.
    pub(crate) async fn free(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.free).acquire_owned().await.ok()
    }

    /// Assigns a slot to a client; `None` if it has its maximum.
    pub(crate) fn take(&self, permit: OwnedSemaphorePermit, address: IpAddr) -> Option<Slot> {
        let client = client_of(address);
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let count = held.entry(client).or_default();
        if *count >= self.per_client {
            return None;
        }
        *count += 1;
        Some(Slot {
            _permit: permit,
            held: Arc::clone(&self.held),
            client,
        })
    }
}

impl Slot {
    pub(crate) fn client(&self) -> Client {
        Client(self.client)
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = held.get_mut(&self.client) {
            *count -= 1;
            if *count == 0 {
                held.remove(&self.client);
            }
        }
    }
}

/// The identity of a client: an IPv4 address, or an IPv6 /64 network, in which a host selects its own
/// addresses.
fn client_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(six) if !six.is_loopback() => IpAddr::V6((six.to_bits() & !u128::from(u64::MAX)).into()),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use std::net::IpAddr;
    use std::sync::Arc;

    use super::{Slot, Slots};

    fn address(text: &str) -> IpAddr {
        text.parse().unwrap_or_else(|_| panic!("{text}"))
    }

    fn take(slots: &Slots, text: &str) -> Option<Slot> {
        let permit = Arc::clone(&slots.free).try_acquire_owned().ok()?;
        slots.take(permit, address(text))
    }

    /// One client takes all slots that it can get, with many addresses of its network: others still get
    /// slots, and it gets new ones for those that it returns.
    #[test]
    fn one_client_leaves_slots_for_others() {
        let slots = Slots::new(8);
        for (one, same, other) in [
            ("192.0.2.7", "192.0.2.7", "192.0.2.8"),
            ("::ffff:192.0.2.7", "192.0.2.7", "::1"),
            ("2001:db8:0:1::a", "2001:db8:0:1:ffff::b", "2001:db8:0:2::a"),
        ] {
            let mut held = Vec::new();
            for k in 0..6 {
                let slot = take(&slots, if k % 2 == 0 { one } else { same });
                held.push(slot.unwrap_or_else(|| panic!("slot {k} of {one}")));
            }
            assert!(take(&slots, one).is_none(), "{one}");
            assert!(take(&slots, same).is_none(), "{same}");
            assert!(take(&slots, other).is_some(), "{other}");
            held.pop();
            assert!(take(&slots, same).is_some(), "{same}");
            drop(held);
            assert!(slots.held.lock().is_ok_and(|held| held.is_empty()));
        }
    }
}
