//! Places for connections: a limited number in all, and fewer for one client.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// The part of all places that one client can hold, so that it never locks out the others.
const PART_OF_ONE: (usize, usize) = (3, 4);

/// Places for connections. A connection holds a [`Place`] until it ends.
#[derive(Clone, Debug)]
pub(crate) struct Places {
    free: Arc<Semaphore>,
    held: Arc<Mutex<HashMap<IpAddr, usize>>>,
    of_one: usize,
}

/// A place, free again when dropped.
#[derive(Debug)]
pub(crate) struct Place {
    _permit: OwnedSemaphorePermit,
    held: Arc<Mutex<HashMap<IpAddr, usize>>>,
    client: IpAddr,
}

impl Places {
    pub(crate) fn new(count: usize) -> Self {
        Self {
            free: Arc::new(Semaphore::new(count)),
            held: Arc::default(),
            of_one: count * PART_OF_ONE.0 / PART_OF_ONE.1,
        }
    }

    /// Waits for a free place.
    pub(crate) async fn free(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.free).acquire_owned().await.ok()
    }

    /// The place of a client; none if it holds as many as one may.
    pub(crate) fn take(&self, permit: OwnedSemaphorePermit, address: IpAddr) -> Option<Place> {
        let client = client_of(address);
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let count = held.entry(client).or_default();
        if *count >= self.of_one {
            return None;
        }
        *count += 1;
        Some(Place {
            _permit: permit,
            held: Arc::clone(&self.held),
            client,
        })
    }
}

impl Drop for Place {
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

/// What counts as one client: an IPv4 address, or an IPv6 network of 64 bits, in which a host chooses its addresses itself.
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

    use super::{Place, Places};

    fn address(text: &str) -> IpAddr {
        text.parse().unwrap_or_else(|_| panic!("{text}"))
    }

    fn take(places: &Places, text: &str) -> Option<Place> {
        let permit = Arc::clone(&places.free).try_acquire_owned().ok()?;
        places.take(permit, address(text))
    }

    /// One client takes all it gets, under many addresses of its network: others have places, and it has new ones for those
    /// that it gives back.
    #[test]
    fn one_client_leaves_places_for_others() {
        let places = Places::new(8);
        for (one, same, other) in [
            ("192.0.2.7", "192.0.2.7", "192.0.2.8"),
            ("::ffff:192.0.2.7", "192.0.2.7", "::1"),
            ("2001:db8:0:1::a", "2001:db8:0:1:ffff::b", "2001:db8:0:2::a"),
        ] {
            let mut held = Vec::new();
            for k in 0..6 {
                let place = take(&places, if k % 2 == 0 { one } else { same });
                held.push(place.unwrap_or_else(|| panic!("place {k} of {one}")));
            }
            assert!(take(&places, one).is_none(), "{one}");
            assert!(take(&places, same).is_none(), "{same}");
            assert!(take(&places, other).is_some(), "{other}");
            held.pop();
            assert!(take(&places, same).is_some(), "{same}");
            drop(held);
            assert!(places.held.lock().is_ok_and(|held| held.is_empty()));
        }
    }
}
