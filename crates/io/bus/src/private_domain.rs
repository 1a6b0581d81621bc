//! Removal of the domain of a test or a tool.

use crate::domain::{Domain, Ipc, configuration};
use crate::error::BusError;
use crate::folder::{BusFolder, SHARED_MEMORY};
use crate::stale_resources;
use core::time::Duration;
use iceoryx2::prelude::*;

/// Maximum number of cleanings of a domain: other processes may be cleaning it too, or be ending.
const CLEANINGS: u32 = 5;

/// Removes a private domain: the resources of killed processes, and iceoryx2's node counter, a file of 16
/// bytes that it keeps per prefix forever. Does nothing while a node of that prefix is alive.
///
/// For tests and tools with their own prefix. The machine's default domain never needs it.
///
/// # Errors
/// The prefix is invalid, or iceoryx2 does not start.
pub fn remove_private_domain(prefix: &str) -> Result<(), BusError> {
    for folder in BusFolder::existing(Some(prefix))? {
        remove_domain(&folder)?;
    }
    Ok(())
}

fn remove_domain(folder: &BusFolder) -> Result<(), BusError> {
    let config = configuration(folder)?;
    for attempt in 0..CLEANINGS {
        drop(Domain::join_in("cleaner", folder, "cleaner")?);
        let (mut alive, mut dead) = (0, 0);
        let listed = Node::<Ipc>::list(&config, |state| {
            match state {
                NodeState::Alive(_) => alive += 1,
                NodeState::Dead(_) => dead += 1,
                // No process uses it; see `clear_unborn_nodes`.
                NodeState::Inaccessible(_) | NodeState::Undefined(_) => {}
            }
            CallbackProgression::Continue
        });
        if listed.is_ok() && alive + dead == 0 {
            break;
        }
        if attempt + 1 == CLEANINGS {
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let Ok(files) = std::fs::read_dir(SHARED_MEMORY) else {
        return Ok(());
    };
    stale_resources::clear_unborn_nodes(&config, Duration::ZERO);
    for file in files.flatten() {
        let name = file.file_name();
        // PREFIX, a hash of 40 digits, `_node.VERSION.global_mgmt`.
        let rest = name
            .to_str()
            .and_then(|name| name.strip_prefix(folder.prefix.as_str()))
            .unwrap_or_default();
        let hash = rest.bytes().take_while(u8::is_ascii_hexdigit).count();
        if hash == 40 && rest.ends_with(".global_mgmt") {
            // Another cleaner may have been faster.
            let _ = std::fs::remove_file(file.path());
        }
    }
    Ok(())
}
