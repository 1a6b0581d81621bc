//! The core's side of the bus.

use crate::config::{
    BusConfig, MAX_SETPOINT_BUFFER, PLACES_FOR_BRIDGES, PLACES_FOR_OPERATORS, STATUS_BUFFER,
};
use crate::deadline::Deadline;
use crate::domain::{
    ATTRIBUTE_AXES, ATTRIBUTE_INTERFACE, ATTRIBUTE_PERIOD, Domain, EventService, Ipc, PubSub, Sizes, Wanted,
};
use crate::error::{BusError, ReceiveError, SendError};
use crate::name::Channel;
use crate::samples::{receive, send_error};
use core::fmt::Debug;
use core::time::Duration;
use evolvent_wire::{
    EventKind, Feedback, Load, MachineInputs, MachineOutputs, Payload, Setpoint, SpindleFeedback, Status,
};
use iceoryx2::port::notifier::{Notifier, NotifierCreateError};
use iceoryx2::port::publisher::{Publisher, PublisherCreateError};
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;

/// The ports of one core. It must stay on the thread that opened it: open it on the publisher's thread.
///
/// No method may be called from the real-time cycle: sending allocates once per message, and opens and
/// removes files when a subscriber joins or leaves.
#[derive(Debug)]
pub struct CoreBus {
    // Ports first: they are dropped in this order, before the node.
    setpoint: Publisher<Ipc, Setpoint, ()>,
    status: Publisher<Ipc, Status, ()>,
    notifier: Notifier<Ipc>,
    feedback: Subscriber<Ipc, Feedback, ()>,
    load: Subscriber<Ipc, Load, ()>,
    output: Publisher<Ipc, MachineOutputs, ()>,
    input: Subscriber<Ipc, MachineInputs, ()>,
    spindle: Subscriber<Ipc, SpindleFeedback, ()>,
    setpoint_service: PubSub<Setpoint>,
    _status_service: PubSub<Status>,
    _event_service: EventService,
    _feedback_service: PubSub<Feedback>,
    _load_service: PubSub<Load>,
    _output_service: PubSub<MachineOutputs>,
    _input_service: PubSub<MachineInputs>,
    _spindle_service: PubSub<SpindleFeedback>,
    rejected: u64,
    _domain: Domain,
}

/// A service with the core's port of it.
type Publishing<P> = (PubSub<P>, Publisher<Ipc, P, ()>);
type Subscribing<P> = (PubSub<P>, Subscriber<Ipc, P, ()>);

/// The services of one core while they are opened.
struct Opening<'a> {
    domain: &'a Domain,
    machine_name: &'a str,
    wanted: &'a Wanted,
    deadline: Deadline,
}

impl Opening<'_> {
    fn publisher<P: Payload + ZeroCopySend + Debug + Copy>(
        &self,
        channel: Channel,
        sizes: Sizes,
    ) -> Result<Publishing<P>, BusError> {
        let service = self
            .domain
            .create::<P>(channel, self.wanted, sizes, self.deadline)?;
        let publisher = publisher(
            self.domain,
            &service,
            channel,
            self.machine_name,
            sizes,
            self.deadline,
        )?;
        Ok((service, publisher))
    }

    fn subscriber<P: Payload + ZeroCopySend + Debug>(
        &self,
        channel: Channel,
        sizes: Sizes,
    ) -> Result<Subscribing<P>, BusError> {
        let service = self
            .domain
            .create::<P>(channel, self.wanted, sizes, self.deadline)?;
        let subscriber = subscriber(&service, channel, self.machine_name)?;
        Ok((service, subscriber))
    }
}

impl CoreBus {
    /// Opens every channel of a machine as its only core.
    ///
    /// First removes the resources of killed runs; takes 15 to 50 ms, so open before the machine is armed.
    ///
    /// # Errors
    /// [`BusError::AlreadyRunning`] with the process if a core of this name is alive; otherwise an error of
    /// the settings, of services that clients of an earlier run hold, or of shared memory.
    pub fn open(config: &BusConfig) -> Result<Self, BusError> {
        check(config)?;
        let machine_name = config.machine_name.as_str();
        let mut domain = Domain::join(machine_name, config.prefix.as_deref(), "core")?;
        let wanted: Wanted = [
            (ATTRIBUTE_INTERFACE, Some(crate::INTERFACE_VERSION.to_string())),
            (ATTRIBUTE_PERIOD, Some(config.period_ns.to_string())),
            (ATTRIBUTE_AXES, Some(config.axes.clone())),
        ];
        let deadline = Deadline::after(config.open_timeout);
        domain.begin_core(deadline)?;
        let opening = Opening {
            domain: &domain,
            machine_name,
            wanted: &wanted,
            deadline,
        };

        // The setpoint publisher comes first: only one is permitted, so it decides which of two cores that
        // start together survives.
        let sizes = Sizes {
            publishers: 1,
            subscribers: config.max_setpoint_subscribers + PLACES_FOR_BRIDGES,
            buffer: config.setpoint_buffer,
            history: 0,
        };
        let (setpoint_service, setpoint) = opening.publisher::<Setpoint>(Channel::Setpoint, sizes)?;

        let sizes = Sizes {
            publishers: 1,
            subscribers: 32 + PLACES_FOR_OPERATORS,
            buffer: STATUS_BUFFER,
            history: 1,
        };
        let (status_service, status) = opening.publisher::<Status>(Channel::Status, sizes)?;

        let from_bridges = Sizes {
            publishers: PLACES_FOR_BRIDGES,
            subscribers: 8,
            buffer: 256,
            history: 0,
        };
        let from_sensors = Sizes {
            publishers: 8,
            ..from_bridges
        };
        let (feedback_service, feedback) = opening.subscriber::<Feedback>(Channel::Feedback, from_bridges)?;
        let (load_service, load) = opening.subscriber::<Load>(Channel::Load, from_sensors)?;
        let (input_service, input) = opening.subscriber::<MachineInputs>(Channel::Input, from_bridges)?;
        let (spindle_service, spindle) =
            opening.subscriber::<SpindleFeedback>(Channel::Spindle, from_bridges)?;

        // History 1: a bridge that joins late receives the current outputs with the next `admit_readers`.
        let sizes = Sizes {
            publishers: 1,
            subscribers: 8 + PLACES_FOR_BRIDGES,
            buffer: 256,
            history: 1,
        };
        let (output_service, output) = opening.publisher::<MachineOutputs>(Channel::Output, sizes)?;

        let event_service = domain.create_event(&wanted, deadline)?;
        let notifier = notifier(&domain, &event_service, machine_name, deadline)?;

        domain.end_core();
        Ok(Self {
            setpoint,
            status,
            notifier,
            feedback,
            load,
            output,
            input,
            spindle,
            setpoint_service,
            _status_service: status_service,
            _event_service: event_service,
            _feedback_service: feedback_service,
            _load_service: load_service,
            _output_service: output_service,
            _input_service: input_service,
            _spindle_service: spindle_service,
            rejected: 0,
            _domain: domain,
        })
    }

    /// Sends a setpoint to every subscriber; never waits for one. Returns the number reached.
    ///
    /// # Errors
    /// The setpoint was not sent, or not to all.
    pub fn publish_setpoint(&mut self, setpoint: &Setpoint) -> Result<usize, SendError> {
        self.setpoint
            .send_copy(*setpoint)
            .map_err(|cause| send_error(Channel::Setpoint, cause))
    }

    /// Replaces the snapshot of status readers. A reader that joins later receives it with the next call, or
    /// with [`CoreBus::admit_readers`].
    ///
    /// # Errors
    /// The status was not sent, or not to all.
    pub fn publish_status(&mut self, status: &Status) -> Result<usize, SendError> {
        self.status
            .send_copy(*status)
            .map_err(|cause| send_error(Channel::Status, cause))
    }

    /// Connects to readers that have joined since the last message: late status readers receive the latest
    /// snapshot now, and joining does not delay the next setpoint. Call it a few times per second.
    pub fn admit_readers(&mut self) {
        // A failure appears again, as an error, with the next message.
        let _ = self.setpoint.update_connections();
        let _ = self.status.update_connections();
        let _ = self.output.update_connections();
    }

    /// Wakes every listener. Publish the status that explains it first.
    ///
    /// # Errors
    /// A listener could not be woken.
    pub fn notify(&mut self, kind: EventKind) -> Result<usize, SendError> {
        self.notifier
            .notify_with_custom_event_id(EventId::new(kind.number() as usize))
            .map_err(|_| SendError::NotSent {
                channel: "event",
                cause: "NotifierNotifyError",
            })
    }

    /// The oldest feedback not taken yet. Feedback that is not finite is dropped and counted.
    ///
    /// # Errors
    /// The connection is damaged, or a bridge uses another version.
    pub fn feedback(&mut self) -> Result<Option<Feedback>, ReceiveError> {
        while let Some(feedback) = receive(&self.feedback, Channel::Feedback)? {
            if feedback.is_finite() {
                return Ok(Some(feedback));
            }
            self.rejected += 1;
        }
        Ok(None)
    }

    /// The oldest feedback not taken yet, with any values, for monitoring that reports invalid ones.
    ///
    /// # Errors
    /// The connection is damaged, or a bridge uses another version.
    pub fn unchecked_feedback(&mut self) -> Result<Option<Feedback>, ReceiveError> {
        receive(&self.feedback, Channel::Feedback)
    }

    /// The oldest cutting load not taken yet. A load that is not finite or out of range is dropped and
    /// counted.
    ///
    /// # Errors
    /// The connection is damaged, or a sensor uses another version.
    pub fn load(&mut self) -> Result<Option<Load>, ReceiveError> {
        while let Some(load) = receive(&self.load, Channel::Load)? {
            if load.is_valid() {
                return Ok(Some(load));
            }
            self.rejected += 1;
        }
        Ok(None)
    }

    /// Sends the outputs to every bridge; never waits for one. Returns the number reached.
    ///
    /// # Errors
    /// The outputs were not sent, or not to all.
    pub fn publish_outputs(&mut self, outputs: &MachineOutputs) -> Result<usize, SendError> {
        self.output
            .send_copy(*outputs)
            .map_err(|cause| send_error(Channel::Output, cause))
    }

    /// The oldest inputs not taken yet, with any values: the monitoring that knows the machine's inputs
    /// reports invalid ones.
    ///
    /// # Errors
    /// The connection is damaged, or a bridge uses another version.
    pub fn unchecked_inputs(&mut self) -> Result<Option<MachineInputs>, ReceiveError> {
        receive(&self.input, Channel::Input)
    }

    /// The oldest feedback of a spindle not taken yet, with any values.
    ///
    /// # Errors
    /// The connection is damaged, or a bridge uses another version.
    pub fn unchecked_spindle(&mut self) -> Result<Option<SpindleFeedback>, ReceiveError> {
        receive(&self.spindle, Channel::Spindle)
    }

    /// Number of messages that were dropped because of invalid values.
    #[must_use]
    pub const fn rejected_inputs(&self) -> u64 {
        self.rejected
    }

    /// Subscribers of the setpoint channel.
    #[must_use]
    pub fn setpoint_subscribers(&self) -> usize {
        self.setpoint_service.dynamic_config().number_of_subscribers()
    }

    /// Waits until at least `count` subscribers read setpoints, and connects to them, so that the first
    /// setpoint reaches them all. Returns their number, which is smaller after a timeout.
    #[must_use]
    pub fn wait_for_setpoint_subscribers(&self, count: usize, timeout: Duration) -> usize {
        let deadline = Deadline::after(timeout);
        loop {
            let found = self.setpoint_subscribers();
            if found >= count || deadline.has_passed() {
                // A failure appears again, as an error, with the first setpoint.
                let _ = self.setpoint.update_connections();
                return found;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

fn check(config: &BusConfig) -> Result<(), BusError> {
    if !(1_000..=1_000_000_000).contains(&config.period_ns) {
        return Err(BusError::Period {
            period_ns: config.period_ns,
        });
    }
    let letters = config.axes.as_bytes();
    let known = letters.iter().all(|letter| b"XYZABCUVW".contains(letter));
    let single = letters
        .iter()
        .enumerate()
        .all(|(i, letter)| !letters[..i].contains(letter));
    if letters.is_empty() || !known || !single {
        return Err(BusError::Axes {
            axes: config.axes.chars().take(32).collect(),
        });
    }
    if !(1..=MAX_SETPOINT_BUFFER).contains(&config.setpoint_buffer) {
        let (setpoints, max) = (config.setpoint_buffer, MAX_SETPOINT_BUFFER);
        return Err(BusError::SetpointBuffer { setpoints, max });
    }
    if !(1..=64).contains(&config.max_setpoint_subscribers) {
        return Err(BusError::Subscribers {
            subscribers: config.max_setpoint_subscribers,
        });
    }
    Ok(())
}

/// Creates the only publisher of a service. If there is one already, its owner is alive, or it is removed.
fn publisher<P: Debug + ZeroCopySend + Copy>(
    domain: &Domain,
    service: &PubSub<P>,
    channel: Channel,
    machine_name: &str,
    sizes: Sizes,
    deadline: Deadline,
) -> Result<Publisher<Ipc, P, ()>, BusError> {
    let name = channel.service_name(machine_name)?;
    loop {
        match service.publisher_builder().create() {
            Ok(publisher) => return Ok(publisher),
            Err(PublisherCreateError::ExceedsMaxSupportedPublishers) => {
                if let Some(pid) = domain.living_core() {
                    return Err(BusError::AlreadyRunning {
                        machine_name: machine_name.to_owned(),
                        pid,
                    });
                }
                if deadline.has_passed() {
                    return Err(BusError::NoPlace {
                        service: name,
                        port: "publisher",
                    });
                }
                domain.node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
                std::thread::sleep(Duration::from_millis(5));
            }
            Err(cause) => {
                let bytes = size_of::<P>() * sizes.subscribers * (sizes.buffer + 2);
                return Err(BusError::SharedMemory {
                    service: name,
                    needed_mib: bytes.div_ceil(1 << 20),
                    cause: format!("{cause:?}"),
                });
            }
        }
    }
}

fn notifier(
    domain: &Domain,
    service: &EventService,
    machine_name: &str,
    deadline: Deadline,
) -> Result<Notifier<Ipc>, BusError> {
    loop {
        let cause = match service.notifier_builder().create() {
            Ok(notifier) => return Ok(notifier),
            Err(cause) => cause,
        };
        let service = Channel::Event.service_name(machine_name)?;
        if cause != NotifierCreateError::ExceedsMaxSupportedNotifiers {
            return Err(BusError::Service {
                service,
                cause: format!("{cause:?}"),
            });
        }
        if deadline.has_passed() {
            return Err(BusError::NoPlace {
                service,
                port: "notifier",
            });
        }
        domain.node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn subscriber<P: Debug + ZeroCopySend>(
    service: &PubSub<P>,
    channel: Channel,
    machine_name: &str,
) -> Result<Subscriber<Ipc, P, ()>, BusError> {
    service
        .subscriber_builder()
        .create()
        .map_err(|cause| BusError::Service {
            service: channel.service_name(machine_name).unwrap_or_default(),
            cause: format!("{cause:?}"),
        })
}
