//! Turns at work that takes long: pages that only watch never hold up those that operate.

use std::sync::Arc;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use crate::gate::Role;

/// A number of turns at the same time for pages that operate, and as many for pages that watch.
#[derive(Debug)]
pub(crate) struct Turns {
    operate: Arc<Semaphore>,
    watch: Arc<Semaphore>,
}

impl Turns {
    pub(crate) fn new(count: usize) -> Self {
        Self {
            operate: Arc::new(Semaphore::new(count)),
            watch: Arc::new(Semaphore::new(count)),
        }
    }

    /// Waits for a turn; it ends when what is returned is dropped.
    pub(crate) async fn take(&self, role: Role) -> Option<OwnedSemaphorePermit> {
        let turns = match role {
            Role::Operate => &self.operate,
            Role::Watch => &self.watch,
        };
        // The semaphores are never closed.
        Arc::clone(turns).acquire_owned().await.ok()
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
}
