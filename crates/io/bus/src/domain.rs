//! A domain of iceoryx2: node, attributes, and opening despite the resources of killed runs.

use crate::config::PLACES_FOR_OPERATORS;
use crate::deadline::Deadline;
use crate::descriptors;
use crate::discovery::{has_service, no_core};
use crate::error::BusError;
use crate::folder::BusFolder;
use crate::name::Channel;
use crate::node_counter;
use crate::open_failure::{OpenFailure, control_failure, event_failure, open_failure};
use crate::stale_resources::{self, OpeningLock};
use core::fmt::Debug;
use core::time::Duration;
use evolvent_wire::{EventKind, Payload};
use iceoryx2::node::{NodeCreationFailure, NodeView};
use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use iceoryx2::service::builder::event::{EventCreateError, EventOpenOrCreateError};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError as CreateError, PublishSubscribeOpenOrCreateError as OpenOrCreateError,
};
use iceoryx2::service::builder::request_response::{
    RequestResponseCreateError, RequestResponseOpenOrCreateError,
};
use iceoryx2::service::port_factory::{event, publish_subscribe, request_response};

pub(crate) type Ipc = ipc::Service;
pub(crate) type PubSub<P> = publish_subscribe::PortFactory<Ipc, P, ()>;
pub(crate) type EventService = event::PortFactory<Ipc>;
pub(crate) type ControlService =
    request_response::PortFactory<Ipc, crate::ControlRequest, (), crate::ControlAnswer, ()>;

/// Attribute: version of the bus contract.
pub const ATTRIBUTE_INTERFACE: &str = "evolvent.interface";
/// Attribute: the control period in ns.
pub const ATTRIBUTE_PERIOD: &str = "evolvent.period_ns";
/// Attribute: the letters of the axes in order.
pub const ATTRIBUTE_AXES: &str = "evolvent.axes";

/// Wait between two attempts.
const RETRY: Duration = Duration::from_millis(5);

/// Processes per service; clients without a port count too.
const MAX_NODES: usize = 128;

/// Required attributes: each key with its value, or none if any value is accepted.
pub(crate) type Wanted = [(&'static str, Option<String>); 3];

/// Sizes of a service, set only by the core.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes {
    pub(crate) publishers: usize,
    pub(crate) subscribers: usize,
    pub(crate) buffer: usize,
    pub(crate) history: usize,
}

/// A node on iceoryx2.
#[derive(Debug)]
pub(crate) struct Domain {
    pub(crate) node: Node<Ipc>,
    machine_name: String,
    /// Held by a core while it opens.
    lock: Option<OpeningLock>,
}

/// A process that is stopped and continued while it creates a node may receive an internal error; the next
/// attempt succeeds.
const NODE_ATTEMPTS: u32 = 5;

impl Domain {
    /// Joins as a core, and removes the resources of dead processes.
    pub(crate) fn join(machine_name: &str, prefix: Option<&str>, role: &str) -> Result<Self, BusError> {
        crate::check_machine_name(machine_name)?;
        descriptors::check(descriptors::OF_A_CORE)?;
        Self::join_in(machine_name, &BusFolder::of_core(prefix)?, role)
    }

    /// Joins the folder in which the machine's core has opened its services, waiting for it.
    pub(crate) fn join_core(
        machine_name: &str,
        prefix: Option<&str>,
        role: &str,
        deadline: Deadline,
    ) -> Result<Self, BusError> {
        descriptors::check(descriptors::OF_A_CLIENT)?;
        let name = Channel::Setpoint.service_name(machine_name)?;
        loop {
            for folder in BusFolder::existing(prefix)? {
                if has_service(&folder, &name, Channel::Setpoint) {
                    return Self::join_in(machine_name, &folder, role);
                }
            }
            if deadline.has_passed() {
                return Err(no_core(machine_name, prefix, deadline));
            }
            std::thread::sleep(RETRY);
        }
    }

    pub(crate) fn join_in(machine_name: &str, folder: &BusFolder, role: &str) -> Result<Self, BusError> {
        let config = configuration(folder)?;
        stale_resources::clear_unborn_segments(&config);
        node_counter::secure(&folder.prefix)?;
        let failed = |cause: &dyn Debug| BusError::Domain {
            cause: format!("{cause:?}"),
        };
        let name =
            NodeName::new(&format!("evolvent.{machine_name}.{role}")).map_err(|cause| failed(&cause))?;
        let create = || {
            NodeBuilder::new()
                .name(&name)
                // The daemon handles signals itself.
                .signal_handling_mode(SignalHandlingMode::Disabled)
                .config(&config)
                .create::<Ipc>()
        };
        let mut created = create();
        for _ in 1..NODE_ATTEMPTS {
            if !matches!(created, Err(NodeCreationFailure::InternalError)) {
                break;
            }
            std::thread::sleep(RETRY);
            created = create();
        }
        let node = created.map_err(|cause| failed(&cause))?;
        node_counter::check(&folder.prefix)?;
        node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
        stale_resources::clear_dead_nodes(node.config());
        stale_resources::clear_unborn_nodes(node.config(), stale_resources::LEFT_AFTER);
        Ok(Self {
            node,
            machine_name: machine_name.to_owned(),
            lock: None,
        })
    }

    /// Keeps other cores from opening at the same time, and removes the incomplete resources of a killed one.
    pub(crate) fn begin_core(&mut self, deadline: Deadline) -> Result<(), BusError> {
        let lock = OpeningLock::acquire(self.node.config(), deadline)?;
        for channel in [
            Channel::Setpoint,
            Channel::Status,
            Channel::Feedback,
            Channel::Load,
            Channel::Output,
            Channel::Input,
            Channel::Spindle,
            Channel::Event,
            Channel::Control,
        ] {
            let (_, name) = self.name(channel)?;
            stale_resources::clear_half_made_service(&lock, self.node.config(), &name, pattern(channel));
        }
        self.lock = Some(lock);
        Ok(())
    }

    /// Lets other cores open.
    pub(crate) fn end_core(&mut self) {
        self.lock = None;
    }

    fn name(&self, channel: Channel) -> Result<(String, ServiceName), BusError> {
        let text = channel.service_name(&self.machine_name)?;
        let name = ServiceName::new(&text).map_err(|cause| BusError::Service {
            service: text.clone(),
            cause: format!("{cause:?}"),
        })?;
        Ok((text, name))
    }

    /// Opens a service as the core does, creating it if it does not exist.
    pub(crate) fn create<P: Payload + ZeroCopySend + Debug>(
        &self,
        channel: Channel,
        wanted: &Wanted,
        sizes: Sizes,
        deadline: Deadline,
    ) -> Result<PubSub<P>, BusError> {
        let (text, name) = self.name(channel)?;
        let verifier = verifier(wanted)?;
        self.retry(&text, channel, wanted, deadline, || {
            self.node
                .service_builder(&name)
                .publish_subscribe::<P>()
                .enable_safe_overflow(true)
                .max_publishers(sizes.publishers)
                .max_subscribers(sizes.subscribers)
                .subscriber_max_buffer_size(sizes.buffer)
                .subscriber_max_borrowed_samples(2)
                .history_size(sizes.history)
                .max_nodes(MAX_NODES)
                .open_or_create_with_attributes(&verifier)
                .map_err(|error| match error {
                    OpenOrCreateError::PublishSubscribeOpenError(error) => open_failure(error),
                    OpenOrCreateError::PublishSubscribeCreateError(CreateError::InsufficientPermissions) => {
                        OpenFailure::Permission
                    }
                    OpenOrCreateError::PublishSubscribeCreateError(
                        error @ (CreateError::HangsInCreation | CreateError::ServiceInCorruptedState),
                    ) => OpenFailure::Hung(format!("{error:?}")),
                    other => OpenFailure::Passing(format!("{other:?}")),
                })
        })
    }

    /// Opens a service that the core has created.
    pub(crate) fn open<P: Payload + ZeroCopySend + Debug>(
        &self,
        channel: Channel,
        wanted: &Wanted,
        deadline: Deadline,
    ) -> Result<PubSub<P>, BusError> {
        let (text, name) = self.name(channel)?;
        let verifier = verifier(wanted)?;
        self.retry(&text, channel, wanted, deadline, || {
            self.node
                .service_builder(&name)
                .publish_subscribe::<P>()
                .open_with_attributes(&verifier)
                .map_err(open_failure)
        })
    }

    /// Opens the event service as the core does.
    pub(crate) fn create_event(&self, wanted: &Wanted, deadline: Deadline) -> Result<EventService, BusError> {
        let (text, name) = self.name(Channel::Event)?;
        let verifier = verifier(wanted)?;
        let id = |kind: EventKind| EventId::new(kind.number() as usize);
        self.retry(&text, Channel::Event, wanted, deadline, || {
            self.node
                .service_builder(&name)
                .event()
                .event_id_max_value(EventKind::MAX_NUMBER)
                .max_notifiers(1)
                .max_listeners(32)
                .max_nodes(MAX_NODES)
                .notifier_created_event(id(EventKind::CoreOpened))
                .notifier_dropped_event(id(EventKind::CoreClosed))
                .notifier_dead_event(id(EventKind::CoreDied))
                .open_or_create_with_attributes(&verifier)
                .map_err(|error| match error {
                    EventOpenOrCreateError::EventOpenError(error) => event_failure(error),
                    EventOpenOrCreateError::EventCreateError(EventCreateError::InsufficientPermissions) => {
                        OpenFailure::Permission
                    }
                    EventOpenOrCreateError::EventCreateError(
                        error @ EventCreateError::ServiceInCorruptedState,
                    ) => OpenFailure::Hung(format!("{error:?}")),
                    other => OpenFailure::Passing(format!("{other:?}")),
                })
        })
    }

    /// Opens the event service that the core has created.
    pub(crate) fn open_event(&self, wanted: &Wanted, deadline: Deadline) -> Result<EventService, BusError> {
        let (text, name) = self.name(Channel::Event)?;
        let verifier = verifier(wanted)?;
        self.retry(&text, Channel::Event, wanted, deadline, || {
            self.node
                .service_builder(&name)
                .event()
                .open_with_attributes(&verifier)
                .map_err(event_failure)
        })
    }

    /// Opens the control service as the core does. Commands of a client that does not wait for its answers
    /// overwrite only each other.
    pub(crate) fn create_control(
        &self,
        wanted: &Wanted,
        deadline: Deadline,
    ) -> Result<ControlService, BusError> {
        let (text, name) = self.name(Channel::Control)?;
        let verifier = verifier(wanted)?;
        self.retry(&text, Channel::Control, wanted, deadline, || {
            self.node
                .service_builder(&name)
                .request_response::<crate::ControlRequest, crate::ControlAnswer>()
                .enable_safe_overflow_for_requests(true)
                .enable_safe_overflow_for_responses(true)
                .max_servers(1)
                .max_clients(32 + PLACES_FOR_OPERATORS)
                .max_active_requests_per_client(4)
                .max_response_buffer_size(2)
                .max_nodes(MAX_NODES)
                .open_or_create_with_attributes(&verifier)
                .map_err(|error| match error {
                    RequestResponseOpenOrCreateError::RequestResponseOpenError(error) => {
                        control_failure(&error)
                    }
                    RequestResponseOpenOrCreateError::RequestResponseCreateError(
                        RequestResponseCreateError::InsufficientPermissions,
                    ) => OpenFailure::Permission,
                    RequestResponseOpenOrCreateError::RequestResponseCreateError(
                        error @ (RequestResponseCreateError::HangsInCreation
                        | RequestResponseCreateError::ServiceInCorruptedState),
                    ) => OpenFailure::Hung(format!("{error:?}")),
                    other => OpenFailure::Passing(format!("{other:?}")),
                })
        })
    }

    /// Opens the control service that the core has created.
    pub(crate) fn open_control(
        &self,
        wanted: &Wanted,
        deadline: Deadline,
    ) -> Result<ControlService, BusError> {
        let (text, name) = self.name(Channel::Control)?;
        let verifier = verifier(wanted)?;
        self.retry(&text, Channel::Control, wanted, deadline, || {
            self.node
                .service_builder(&name)
                .request_response::<crate::ControlRequest, crate::ControlAnswer>()
                .open_with_attributes(&verifier)
                .map_err(|error| control_failure(&error))
        })
    }

    /// Tries until it succeeds, fails permanently, or times out. Resources of dead processes are removed
    /// between attempts.
    fn retry<T>(
        &self,
        service: &str,
        channel: Channel,
        wanted: &Wanted,
        deadline: Deadline,
        attempt: impl Fn() -> Result<T, OpenFailure>,
    ) -> Result<T, BusError> {
        let is_core = self.lock.is_some();
        loop {
            let failure = match attempt() {
                Ok(done) => return Ok(done),
                Err(failure) => failure,
            };
            let (machine_name, service) = (self.machine_name.clone(), service.to_owned());
            if is_core
                && matches!(failure, OpenFailure::Attributes | OpenFailure::Settings(_))
                && let Some(pid) = self.living_core()
            {
                return Err(BusError::AlreadyRunning { machine_name, pid });
            }
            match failure {
                OpenFailure::Permission => return Err(BusError::Permission { service }),
                OpenFailure::Settings(cause) => return Err(BusError::HeldByClients { service, cause }),
                OpenFailure::Attributes => {
                    return Err(BusError::Incompatible {
                        differences: self.differences(channel, wanted),
                        service,
                        advice: if is_core {
                            "clients of an earlier run keep it alive, close them and start again"
                        } else {
                            "make the client for this core, or start the core with the client's settings"
                        },
                    });
                }
                OpenFailure::Missing if deadline.has_passed() => {
                    return Err(no_core(&machine_name, None, deadline));
                }
                OpenFailure::Passing(cause) | OpenFailure::Hung(cause) if deadline.has_passed() => {
                    return Err(BusError::Service { service, cause });
                }
                OpenFailure::Hung(_) if is_core => self.remove_service(channel),
                OpenFailure::Passing(_) | OpenFailure::Hung(_) => {
                    self.node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
                }
                OpenFailure::Missing => {}
            }
            std::thread::sleep(RETRY);
        }
    }

    /// Removes a service that cannot be opened because its creator died before it was complete.
    fn remove_service(&self, channel: Channel) {
        let (Ok((_, name)), Some(lock)) = (self.name(channel), &self.lock) else {
            return;
        };
        stale_resources::clear_half_made_service(lock, self.node.config(), &name, pattern(channel));
        // SAFETY: the service is not in use: it cannot be opened, and only cores create one, of which only
        // the holder of the lock, this one, is opening. If it fails, the next attempt to open fails too, and
        // reports it.
        let _ = unsafe { self.node.force_remove_service(&name, pattern(channel)) };
    }

    /// The other live core with this machine's name: its process, if it can be determined.
    pub(crate) fn living_core(&self) -> Option<Option<i32>> {
        let (_, name) = self.name(Channel::Setpoint).ok()?;
        let service = self
            .node
            .service_builder(&name)
            .publish_subscribe::<crate::Setpoint>()
            .open()
            .ok()?;
        let mut owner = None;
        service.dynamic_config().list_publishers(|publisher| {
            owner = Some(publisher.node_id);
            CallbackProgression::Stop
        });
        let owner = owner?;
        let mut found = None;
        // A publisher of a dead node does not count: it is about to be removed.
        let listed = service.nodes(|state| {
            if *state.node_id() != owner {
                return CallbackProgression::Continue;
            }
            found = match state {
                NodeState::Alive(view) => Some(
                    view.details()
                        .as_ref()
                        .map(|details| details.process_id().value()),
                ),
                NodeState::Dead(_) => None,
                NodeState::Inaccessible(_) | NodeState::Undefined(_) => Some(None),
            };
            CallbackProgression::Stop
        });
        listed.ok().and(found)
    }

    /// Every attribute that differs from the required one, with both values.
    fn differences(&self, channel: Channel, wanted: &Wanted) -> String {
        let Ok((_, name)) = self.name(channel) else {
            return String::new();
        };
        let details = Ipc::details(&name, self.node.config(), pattern(channel));
        let Ok(Some(details)) = details else {
            return "its attributes cannot be read".to_owned();
        };
        let there = details.static_details.attributes();
        let mut differences = Vec::new();
        for (key, value) in wanted {
            let found = attribute(there, key);
            match (value, found) {
                (Some(here), Some(there)) if *here == there => {}
                (None, Some(_)) => {}
                (here, there) => differences.push(format!(
                    "{key} is {} there and {} here",
                    there.as_deref().unwrap_or("missing"),
                    here.as_deref().unwrap_or("wanted"),
                )),
            }
        }
        differences.join(", ")
    }
}

pub(crate) fn pattern(channel: Channel) -> MessagingPattern {
    match channel {
        Channel::Event => MessagingPattern::Event,
        Channel::Control => MessagingPattern::RequestResponse,
        Channel::Setpoint
        | Channel::Status
        | Channel::Feedback
        | Channel::Load
        | Channel::Output
        | Channel::Input
        | Channel::Spindle => MessagingPattern::PublishSubscribe,
    }
}

/// iceoryx2's configuration in a folder. The user's own configuration file of iceoryx2 applies to the rest.
pub(crate) fn configuration(folder: &BusFolder) -> Result<Config, BusError> {
    // iceoryx2 reports on standard error what our errors already report.
    set_log_level_from_env_or(LogLevel::Fatal);
    let mut config = Config::global_config().clone();
    let bad = |cause: &dyn Debug| BusError::Folder {
        path: folder.path.display().to_string(),
        reason: format!("or its prefix {} cannot be used ({cause:?})", folder.prefix),
    };
    config.global.prefix = FileName::new(folder.prefix.as_bytes()).map_err(|cause| bad(&cause))?;
    let root = format!("{}/", folder.path.display());
    config
        .global
        .set_root_path(&Path::new(root.as_bytes()).map_err(|cause| bad(&cause))?);
    // A core that stops must not fail because of another machine's killed core.
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    Ok(config)
}

/// The value of an attribute.
pub(crate) fn attribute(attributes: &AttributeSet, key: &str) -> Option<String> {
    attributes
        .iter()
        .find(|attribute| attribute.key().as_bytes() == key.as_bytes())
        .and_then(|attribute| String::from_utf8(attribute.value().as_bytes().to_vec()).ok())
}

fn verifier(wanted: &Wanted) -> Result<AttributeVerifier, BusError> {
    let failed = |cause: &dyn Debug| BusError::Domain {
        cause: format!("{cause:?}"),
    };
    let mut verifier = AttributeVerifier::new();
    for (key, value) in wanted {
        let key = AttributeKey::new(key.as_bytes()).map_err(|cause| failed(&cause))?;
        verifier = match value {
            Some(value) => {
                let value = AttributeValue::new(value.as_bytes()).map_err(|cause| failed(&cause))?;
                verifier.require(&key, &value)
            }
            None => verifier.require_key(&key),
        }
        .map_err(|cause| failed(&cause))?;
    }
    Ok(verifier)
}
