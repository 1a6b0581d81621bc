//! A place on iceoryx2: node, attributes, and opening that survives the remains of killed runs.

use crate::config::PLACES_FOR_OPERATORS;
use crate::descriptors;
use crate::error::BusError;
use crate::folder::{BusFolder, SHARED_MEMORY, other_users, user_name};
use crate::name::Channel;
use crate::node_counter;
use crate::stale_resources::{self, OpeningLock};
use core::fmt::Debug;
use core::time::Duration;
use evolvent_wire::{EventKind, Payload};
use iceoryx2::node::{NodeCreationFailure, NodeView};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use iceoryx2::service::attribute::{AttributeKey, AttributeValue};
use iceoryx2::service::builder::event::{EventCreateError, EventOpenError, EventOpenOrCreateError};
use iceoryx2::service::builder::publish_subscribe::{
    PublishSubscribeCreateError as CreateError, PublishSubscribeOpenError as OpenError,
    PublishSubscribeOpenOrCreateError as OpenOrCreateError,
};
use iceoryx2::service::builder::request_response::{
    RequestResponseCreateError, RequestResponseOpenError, RequestResponseOpenOrCreateError,
};
use iceoryx2::service::port_factory::{event, publish_subscribe, request_response};
use std::time::Instant;

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

/// How long to wait between two tries.
const RETRY: Duration = Duration::from_millis(5);

/// Processes at one service; clients that have no port count too.
const MAX_NODES: usize = 128;

/// What is asked of the attributes: each key with its value, or none where any will do.
pub(crate) type Wanted = [(&'static str, Option<String>); 3];

/// Sizes of a service, said by the core only.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sizes {
    pub(crate) publishers: usize,
    pub(crate) subscribers: usize,
    pub(crate) buffer: usize,
    pub(crate) history: usize,
}

/// How an attempt to open ended.
enum Failure {
    /// May go away: another process is just creating, removing or cleaning up.
    Passing(String),
    /// Half made, and nobody goes on making it.
    Hung(String),
    Missing,
    Attributes,
    Settings(String),
    Permission,
}

/// A node on iceoryx2.
#[derive(Debug)]
pub(crate) struct Domain {
    pub(crate) node: Node<Ipc>,
    machine_name: String,
    /// Held by a core while it opens.
    lock: Option<OpeningLock>,
}

/// A process that is stopped and continued while it makes a node may be told of an internal error, where the next try succeeds.
const NODE_ATTEMPTS: u32 = 5;

impl Domain {
    /// Joins as a core, and clears what dead processes have left.
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
        deadline: Instant,
    ) -> Result<Self, BusError> {
        descriptors::check(descriptors::OF_A_CLIENT)?;
        let begin = Instant::now();
        let name = Channel::Setpoint.service_name(machine_name)?;
        loop {
            for folder in BusFolder::existing(prefix)? {
                if has_service(&folder, &name, Channel::Setpoint) {
                    return Self::join_in(machine_name, &folder, role);
                }
            }
            if Instant::now() >= deadline {
                return Err(no_core(machine_name, prefix, begin));
            }
            std::thread::sleep(RETRY);
        }
    }

    fn join_in(machine_name: &str, folder: &BusFolder, role: &str) -> Result<Self, BusError> {
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

    /// Keeps other cores from opening at the same time, and removes what a killed one has left half made.
    pub(crate) fn begin_core(&mut self, deadline: Instant) -> Result<(), BusError> {
        let lock = OpeningLock::acquire(self.node.config(), deadline)?;
        for channel in [
            Channel::Setpoint,
            Channel::Status,
            Channel::Feedback,
            Channel::Load,
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

    /// Opens a service as the core does, creating it where it is missing.
    pub(crate) fn create<P: Payload + ZeroCopySend + Debug>(
        &self,
        channel: Channel,
        wanted: &Wanted,
        sizes: Sizes,
        deadline: Instant,
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
                        Failure::Permission
                    }
                    OpenOrCreateError::PublishSubscribeCreateError(
                        error @ (CreateError::HangsInCreation | CreateError::ServiceInCorruptedState),
                    ) => Failure::Hung(format!("{error:?}")),
                    other => Failure::Passing(format!("{other:?}")),
                })
        })
    }

    /// Opens a service that the core has created.
    pub(crate) fn open<P: Payload + ZeroCopySend + Debug>(
        &self,
        channel: Channel,
        wanted: &Wanted,
        deadline: Instant,
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
    pub(crate) fn create_event(&self, wanted: &Wanted, deadline: Instant) -> Result<EventService, BusError> {
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
                        Failure::Permission
                    }
                    EventOpenOrCreateError::EventCreateError(
                        error @ EventCreateError::ServiceInCorruptedState,
                    ) => Failure::Hung(format!("{error:?}")),
                    other => Failure::Passing(format!("{other:?}")),
                })
        })
    }

    /// Opens the event service that the core has created.
    pub(crate) fn open_event(&self, wanted: &Wanted, deadline: Instant) -> Result<EventService, BusError> {
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

    /// Opens the control service as the core does. Commands of a client that does not wait for its answers overwrite
    /// each other, and nobody else's.
    pub(crate) fn create_control(
        &self,
        wanted: &Wanted,
        deadline: Instant,
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
                    ) => Failure::Permission,
                    RequestResponseOpenOrCreateError::RequestResponseCreateError(
                        error @ (RequestResponseCreateError::HangsInCreation
                        | RequestResponseCreateError::ServiceInCorruptedState),
                    ) => Failure::Hung(format!("{error:?}")),
                    other => Failure::Passing(format!("{other:?}")),
                })
        })
    }

    /// Opens the control service that the core has created.
    pub(crate) fn open_control(
        &self,
        wanted: &Wanted,
        deadline: Instant,
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

    /// Tries until it works, fails for good, or time is up. Between two tries the dead are cleared away.
    fn retry<T>(
        &self,
        service: &str,
        channel: Channel,
        wanted: &Wanted,
        deadline: Instant,
        attempt: impl Fn() -> Result<T, Failure>,
    ) -> Result<T, BusError> {
        let begin = Instant::now();
        let is_core = self.lock.is_some();
        loop {
            let failure = match attempt() {
                Ok(done) => return Ok(done),
                Err(failure) => failure,
            };
            let (machine_name, service) = (self.machine_name.clone(), service.to_owned());
            if is_core
                && matches!(failure, Failure::Attributes | Failure::Settings(_))
                && let Some(pid) = self.living_core()
            {
                return Err(BusError::AlreadyRunning { machine_name, pid });
            }
            match failure {
                Failure::Permission => return Err(BusError::Permission { service }),
                Failure::Settings(cause) => return Err(BusError::HeldByClients { service, cause }),
                Failure::Attributes => {
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
                Failure::Missing if Instant::now() >= deadline => {
                    return Err(no_core(&machine_name, None, begin));
                }
                Failure::Passing(cause) | Failure::Hung(cause) if Instant::now() >= deadline => {
                    return Err(BusError::Service { service, cause });
                }
                Failure::Hung(_) if is_core => self.remove_service(channel),
                Failure::Passing(_) | Failure::Hung(_) => {
                    self.node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
                }
                Failure::Missing => {}
            }
            std::thread::sleep(RETRY);
        }
    }

    /// Removes a service that cannot be opened because its maker died before it was complete.
    fn remove_service(&self, channel: Channel) {
        let (Ok((_, name)), Some(lock)) = (self.name(channel), &self.lock) else {
            return;
        };
        stale_resources::clear_half_made_service(lock, self.node.config(), &name, pattern(channel));
        // SAFETY: nobody uses the service: it cannot be opened, and only cores make one, of which only the holder
        // of the lock, this one, is opening. Where it fails, the next attempt to open fails too, and reports it.
        let _ = unsafe { self.node.force_remove_service(&name, pattern(channel)) };
    }

    /// The other core of this machine's name, if one lives: its process where that can be found out.
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
        // A publisher whose node is dead is none: it is about to be cleared away.
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

    /// Every attribute that is not as wanted, with both values.
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

fn pattern(channel: Channel) -> MessagingPattern {
    match channel {
        Channel::Event => MessagingPattern::Event,
        Channel::Control => MessagingPattern::RequestResponse,
        Channel::Setpoint | Channel::Status | Channel::Feedback | Channel::Load => {
            MessagingPattern::PublishSubscribe
        }
    }
}

/// iceoryx2's configuration in a folder. The user's own configuration file of iceoryx2 counts for the rest.
fn configuration(folder: &BusFolder) -> Result<Config, BusError> {
    // iceoryx2 reports on standard error what our errors say already.
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
    // A core that stops must not stumble over what another machine's killed core has left.
    config.global.node.cleanup_dead_nodes_on_destruction = false;
    Ok(config)
}

/// Whether a service is described in a folder. It may be a dead core's.
fn has_service(folder: &BusFolder, name: &str, channel: Channel) -> bool {
    let (Ok(config), Ok(name)) = (configuration(folder), ServiceName::new(name)) else {
        return false;
    };
    stale_resources::service_file(&config, &name, pattern(channel)).exists()
}

/// Nobody was there in time. A core of another user cannot be seen, but that there is one can.
pub(crate) fn no_core(machine_name: &str, prefix: Option<&str>, begin: Instant) -> BusError {
    BusError::NoCore {
        machine_name: machine_name.to_owned(),
        waited_ms: begin.elapsed().as_millis() as u64,
        elsewhere: cores_of_other_users(prefix),
    }
}

/// Which other users have cores on this computer and what that means, to go behind a sentence; empty where none has.
#[must_use]
pub fn cores_of_other_users(prefix: Option<&str>) -> String {
    let others: Vec<String> = other_users(prefix).into_iter().map(user_name).collect();
    let who = match others.as_slice() {
        [] => return String::new(),
        [one] => format!("{one} has a core"),
        several => format!("{} have cores", several.join(" and ")),
    };
    format!("; {who} on this computer: a bus belongs to one user, so run this as that user (`sudo -u USER`)")
}

/// Names of the machines whose control service is there, in order. One that was killed is among them until somebody
/// clears it away.
///
/// # Errors
/// The prefix is none, or iceoryx2 does not start.
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

/// How often a domain is cleaned at the most: others may be cleaning it too, or just be ending.
const CLEANINGS: u32 = 5;

/// Clears a domain of one's own away: what killed processes have left, and iceoryx2's node counter, a file of
/// 16 bytes that it keeps per prefix for ever. Does nothing while a node of that prefix lives.
///
/// For tests and tools that make up a prefix. The machine's usual domain needs it never.
///
/// # Errors
/// The prefix is none, or iceoryx2 does not start.
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
                // Nothing lives there; see `clear_unborn_nodes`.
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

/// The value of an attribute.
pub(crate) fn attribute(attributes: &AttributeSet, key: &str) -> Option<String> {
    attributes
        .iter()
        .find(|attribute| attribute.key().as_bytes() == key.as_bytes())
        .and_then(|attribute| String::from_utf8(attribute.value().as_bytes().to_vec()).ok())
}

/// Takes one message of this version from a subscriber.
pub(crate) fn receive<P: Payload + ZeroCopySend + Debug>(
    subscriber: &Subscriber<Ipc, P, ()>,
    channel: Channel,
) -> Result<Option<P>, crate::ReceiveError> {
    use crate::error::ReceiveError;
    use iceoryx2::port::ReceiveError as Cause;
    let channel = channel.name();
    let sample = subscriber.receive().map_err(|cause| ReceiveError::Broken {
        channel,
        cause: match cause {
            Cause::ExceedsMaxBorrows => "ExceedsMaxBorrows",
            Cause::ConnectionFailure(_) => "ConnectionFailure",
        },
    })?;
    let Some(sample) = sample else { return Ok(None) };
    let message = *sample.payload();
    if message.is_compatible() {
        return Ok(Some(message));
    }
    Err(ReceiveError::Version {
        channel,
        version: message.interface_version(),
        size: message.struct_size(),
        known_version: crate::INTERFACE_VERSION,
        known_size: P::LAYOUT.size_bytes as u32,
    })
}

/// iceoryx2's name of a cause, without allocation: it may be asked for every cycle.
pub(crate) fn send_error(channel: Channel, cause: iceoryx2::port::SendError) -> crate::SendError {
    use iceoryx2::port::SendError as Cause;
    let cause = match cause {
        Cause::ConnectionBrokenSinceSenderNoLongerExists => "SenderNoLongerExists",
        Cause::ConnectionCorrupted => "ConnectionCorrupted",
        Cause::LoanError(_) => "LoanError",
        Cause::ConnectionError(_) => "ConnectionError",
        Cause::UnableToDeliver => "UnableToDeliver",
        Cause::InternalError => "InternalError",
    };
    crate::SendError::NotSent {
        channel: channel.name(),
        cause,
    }
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

fn open_failure(error: OpenError) -> Failure {
    match error {
        OpenError::DoesNotExist => Failure::Missing,
        OpenError::IncompatibleAttributes => Failure::Attributes,
        OpenError::InsufficientPermissions => Failure::Permission,
        OpenError::IncompatibleTypes
        | OpenError::IncompatibleMessagingPattern
        | OpenError::IncompatibleOverflowBehavior
        | OpenError::VersionMismatch
        | OpenError::DoesNotSupportRequestedMinBufferSize
        | OpenError::DoesNotSupportRequestedMinHistorySize
        | OpenError::DoesNotSupportRequestedMinSubscriberBorrowedSamples
        | OpenError::DoesNotSupportRequestedAmountOfPublishers
        | OpenError::DoesNotSupportRequestedAmountOfSubscribers
        | OpenError::DoesNotSupportRequestedAmountOfNodes => Failure::Settings(format!("{error:?}")),
        OpenError::HangsInCreation | OpenError::ServiceInCorruptedState => {
            Failure::Hung(format!("{error:?}"))
        }
        other => Failure::Passing(format!("{other:?}")),
    }
}

fn control_failure(error: &RequestResponseOpenError) -> Failure {
    use RequestResponseOpenError as Error;
    match error {
        Error::DoesNotExist => Failure::Missing,
        Error::IncompatibleAttributes => Failure::Attributes,
        Error::InsufficientPermissions => Failure::Permission,
        Error::HangsInCreation | Error::ServiceInCorruptedState => Failure::Hung(format!("{error:?}")),
        Error::Interrupt
        | Error::InternalFailure
        | Error::IsMarkedForDestruction
        | Error::ExceedsMaxNumberOfNodes
        | Error::UnableToCreateServiceTag => Failure::Passing(format!("{error:?}")),
        other => Failure::Settings(format!("{other:?}")),
    }
}

fn event_failure(error: EventOpenError) -> Failure {
    match error {
        EventOpenError::DoesNotExist => Failure::Missing,
        EventOpenError::IncompatibleAttributes => Failure::Attributes,
        EventOpenError::InsufficientPermissions => Failure::Permission,
        EventOpenError::HangsInCreation | EventOpenError::ServiceInCorruptedState => {
            Failure::Hung(format!("{error:?}"))
        }
        EventOpenError::Interrupt
        | EventOpenError::InternalFailure
        | EventOpenError::IsMarkedForDestruction
        | EventOpenError::ExceedsMaxNumberOfNodes
        | EventOpenError::UnableToCreateServiceTag => Failure::Passing(format!("{error:?}")),
        other => Failure::Settings(format!("{other:?}")),
    }
}
