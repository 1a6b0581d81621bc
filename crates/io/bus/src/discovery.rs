//! Which machines have a core, and which other users have one.

use crate::deadline::Deadline;
use crate::domain::{Ipc, configuration, pattern};
use crate::error::BusError;
use crate::folder::{BusFolder, login_name, other_users, user_name};
use crate::name::Channel;
use crate::stale_resources;
use iceoryx2::prelude::*;

/// Whether a service is described in a folder. It may belong to a dead core.
pub(crate) fn has_service(folder: &BusFolder, name: &str, channel: Channel) -> bool {
    let (Ok(config), Ok(name)) = (configuration(folder), ServiceName::new(name)) else {
        return false;
    };
    stale_resources::service_file(&config, &name, pattern(channel)).exists()
}

/// No core in time. A core of another user is not accessible, but its existence is visible.
pub(crate) fn no_core(machine_name: &str, prefix: Option<&str>, deadline: Deadline) -> BusError {
    BusError::NoCore {
        machine_name: machine_name.to_owned(),
        waited_ms: deadline.waited_ms(),
        elsewhere: cores_of_other_users(prefix),
    }
}

/// The other users with cores on this computer and what that means, appended to a sentence; empty if there
/// are none.
#[must_use]
pub fn cores_of_other_users(prefix: Option<&str>) -> String {
    let users = other_users(prefix);
    let others: Vec<String> = users.iter().copied().map(user_name).collect();
    let who = match others.as_slice() {
        [] => return String::new(),
        [one] => format!("{one} has a core"),
        several => format!("{} have cores", several.join(" and ")),
    };
    let name = match users.as_slice() {
        [one] => login_name(*one).unwrap_or_else(|| format!("'#{one}'")),
        _ => "USER".to_owned(),
    };
    format!(
        "; {who} on this computer: a bus belongs to one user, so run this as that user (`sudo -u {name} \
         evolvent ...`)"
    )
}

/// Names of the machines with a control service, in order. A killed one is listed until it is removed.
///
/// # Errors
/// The prefix is invalid, or iceoryx2 does not start.
pub fn list_machines(prefix: Option<&str>) -> Result<Vec<String>, BusError> {
    let mut names = Vec::new();
    for folder in BusFolder::existing(prefix)? {
        let config = configuration(&folder)?;
        stale_resources::clear_unborn_segments(&config);
        let listed = Ipc::list(&config, |details| {
            let name = details.static_details.name().as_str();
            let machine = name
                .strip_prefix("evolvent/")
                .and_then(|rest| rest.strip_suffix("/control"));
            names.extend(machine.map(str::to_owned));
            CallbackProgression::Continue
        });
        listed.map_err(|cause| BusError::Domain {
            cause: format!("{}: {cause:?}", folder.path.display()),
        })?;
    }
    names.sort();
    names.dedup();
    Ok(names)
}
