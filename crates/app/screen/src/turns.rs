//! Turns for long work: pages that only watch never delay those that operate.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::gate::Role;

/// A number of simultaneous turns for pages that operate, and the same number for pages that watch.
#[derive(Debug)]
pub(crate) struct Turns {
    operate: Queue,
    watch: Queue,
}

#[derive(Debug)]
struct Queue {
    turns: Arc<Semaphore>,
    waiting: AtomicUsize,
}

impl Queue {
    fn new(count: usize) -> Self {
        Self {
            turns: Arc::new(Semaphore::new(count)),
            waiting: AtomicUsize::new(0),
        }
    }
}

/// A request that waits for its turn, until it gets it or gives up.
struct Waiting<'a>(&'a AtomicUsize);

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Turns {
    pub(crate) fn new(count: usize) -> Self {
        Self {
            operate: Queue::new(count),
            watch: Queue::new(count),
        }
    }

    /// Waits for a turn, which ends when the returned value is dropped.
    pub(crate) async fn take(&self, role: Role) -> Option<OwnedSemaphorePermit> {
        self.take_behind(role, usize::MAX).await
    }

    /// Like [`Self::take`], unless `max_waiting` requests of this role are already waiting.
    pub(crate) async fn take_behind(&self, role: Role, max_waiting: usize) -> Option<OwnedSemaphorePermit> {
        let Queue { turns, waiting } = match role {
            Role::Operate => &self.operate,
            Role::Watch => &self.watch,
        };
        let turns = Arc::clone(turns);
        if let Ok(free) = Arc::clone(&turns).try_acquire_owned() {
            return Some(free);
        }
        let before = waiting.fetch_add(1, Ordering::Relaxed);
        let _waiting = Waiting(waiting);
        if before >= max_waiting {
            return None;
        }
        // The semaphores are never closed.
        turns.acquire_owned().await.ok()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn pages_that_watch_hold_up_no_page_that_operates() {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .unwrap();
        runtime.block_on(async {
            let turns = Turns::new(1);
            let watched = turns.take(Role::Watch).await;
            assert!(watched.is_some());
            let more = tokio::time::timeout(Duration::from_millis(20), turns.take(Role::Watch)).await;
            assert!(more.is_err(), "one at a time");
            let operates = tokio::time::timeout(Duration::from_secs(10), turns.take(Role::Operate)).await;
            assert!(operates.is_ok_and(|turn| turn.is_some()));
            drop(watched);
            assert!(turns.take(Role::Watch).await.is_some());
        });
    }

    #[test]
    fn a_queue_that_is_full_takes_no_more() {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_time()
            .build()
            .unwrap();
        runtime.block_on(async {
            let turns = Arc::new(Turns::new(1));
            let first = turns.take_behind(Role::Watch, 2).await;
            assert!(first.is_some());
            let waits: Vec<_> = (0..2)
                .map(|_| {
                    let turns = Arc::clone(&turns);
                    tokio::spawn(async move { turns.take_behind(Role::Watch, 2).await.is_some() })
                })
                .collect();
            tokio::task::yield_now().await;
            assert!(turns.take_behind(Role::Watch, 2).await.is_none(), "two wait");
            assert!(
                turns.take_behind(Role::Operate, 2).await.is_some(),
                "of the other role none"
            );
            // A request that gives up leaves the queue.
            waits[0].abort();
            tokio::task::yield_now().await;
            let third =
                tokio::time::timeout(Duration::from_millis(20), turns.take_behind(Role::Watch, 2)).await;
            assert!(third.is_err(), "it waits");
            drop(first);
            assert!(waits.into_iter().next_back().unwrap().await.unwrap());
        });
    }
}
