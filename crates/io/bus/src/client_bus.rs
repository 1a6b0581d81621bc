//! The clients' side of the bus: bridges, screens, loggers, tests.

use crate::config::{ClientConfig, PLACES_FOR_BRIDGES, PLACES_FOR_OPERATORS};
use crate::deadline::Deadline;
use crate::domain::{
    ATTRIBUTE_AXES, ATTRIBUTE_INTERFACE, ATTRIBUTE_PERIOD, Domain, EventService, Ipc, PubSub, Wanted,
    attribute,
};
use crate::error::{BusError, ReceiveError, SendError};
use crate::name::Channel;
use crate::samples::{receive, send_error};
use core::time::Duration;
use evolvent_wire::{
    EventKind, Feedback, Load, MachineInputs, MachineOutputs, Setpoint, SpindleFeedback, Status,
};
use iceoryx2::port::listener::{Listener, ListenerWaitError};
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::{Subscriber, SubscriberCreateError};
use iceoryx2::prelude::*;

/// One client of one machine. It must stay on the thread that opened it.
#[derive(Debug)]
pub struct ClientBus {
    setpoint_service: PubSub<Setpoint>,
    wanted: Wanted,
    config: ClientConfig,
    period_ns: u64,
    axes: String,
    domain: Domain,
}

impl ClientBus {
    /// Finds the machine, waiting for its core if necessary, and checks that client and core match.
    ///
    /// # Errors
    /// No core in time, or one with another version, period or axes.
    pub fn open(config: &ClientConfig) -> Result<Self, BusError> {
        let deadline = Deadline::after(config.wait);
        let prefix = config.prefix.as_deref();
        let domain = Domain::join_core(&config.machine_name, prefix, "client", deadline)?;
        let wanted: Wanted = [
            (ATTRIBUTE_INTERFACE, Some(crate::INTERFACE_VERSION.to_string())),
            (
                ATTRIBUTE_PERIOD,
                config.period_ns.map(|period_ns| period_ns.to_string()),
            ),
            (ATTRIBUTE_AXES, config.axes.clone()),
        ];
        let setpoint_service = domain.open::<Setpoint>(Channel::Setpoint, &wanted, deadline)?;
        let found = |key| attribute(setpoint_service.attributes(), key).unwrap_or_default();
        Ok(Self {
            period_ns: found(ATTRIBUTE_PERIOD).parse().unwrap_or(0),
            axes: found(ATTRIBUTE_AXES),
            setpoint_service,
            wanted,
            config: config.clone(),
            domain,
        })
    }

    /// The core's control period in ns.
    #[must_use]
    pub const fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// The letters of the machine's axes in order.
    #[must_use]
    pub fn axes(&self) -> &str {
        &self.axes
    }

    /// Subscribes to setpoints from the next one on. A bridge uses [`ClientBus::bridge_setpoints`].
    ///
    /// # Errors
    /// All connections are taken, except those reserved for bridges.
    pub fn setpoints(&self) -> Result<SetpointReader, BusError> {
        self.leave_places(&self.setpoint_service, Channel::Setpoint, PLACES_FOR_BRIDGES)?;
        self.bridge_setpoints()
    }

    /// Subscribes to setpoints from the next one on, as a bridge, on a reserved connection.
    ///
    /// # Errors
    /// All connections are taken.
    pub fn bridge_setpoints(&self) -> Result<SetpointReader, BusError> {
        let subscriber = self.subscribe(&self.setpoint_service, Channel::Setpoint)?;
        Ok(SetpointReader {
            subscriber,
            next: None,
            lost: 0,
        })
    }

    /// Reads the core's snapshots. An operator uses [`ClientBus::operator_status`].
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken except those reserved for operators.
    pub fn status(&self) -> Result<StatusReader, BusError> {
        let service = self
            .domain
            .open::<Status>(Channel::Status, &self.wanted, self.deadline())?;
        self.leave_places(&service, Channel::Status, PLACES_FOR_OPERATORS)?;
        self.read_status(&service)
    }

    /// Reads the core's snapshots for the duration of a command, on a reserved connection.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn operator_status(&self) -> Result<StatusReader, BusError> {
        let service = self
            .domain
            .open::<Status>(Channel::Status, &self.wanted, self.deadline())?;
        self.read_status(&service)
    }

    /// Reads every snapshot, for a log: a text or an alarm can be shorter than the interval at which a screen
    /// looks.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken except those reserved for operators.
    pub fn every_status(&self) -> Result<EveryStatusReader, BusError> {
        let service = self
            .domain
            .open::<Status>(Channel::Status, &self.wanted, self.deadline())?;
        self.leave_places(&service, Channel::Status, PLACES_FOR_OPERATORS)?;
        Ok(EveryStatusReader {
            subscriber: self.subscribe(&service, Channel::Status)?,
        })
    }

    fn read_status(&self, service: &PubSub<Status>) -> Result<StatusReader, BusError> {
        Ok(StatusReader {
            subscriber: self.subscribe_with(service, Channel::Status, Some(1))?,
            latest: None,
        })
    }

    /// Listens to events from now on.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn events(&self) -> Result<EventReader, BusError> {
        let service = self.domain.open_event(&self.wanted, self.deadline())?;
        let listener = service
            .listener_builder()
            .create()
            .map_err(|_| BusError::NoPlace {
                service: self.service_name(Channel::Event),
                port: "listener",
            })?;
        Ok(EventReader {
            listener,
            _service: service,
        })
    }

    /// Opens the channel for a bridge's feedback.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn feedback_sender(&self) -> Result<FeedbackSender, BusError> {
        let service = self
            .domain
            .open::<Feedback>(Channel::Feedback, &self.wanted, self.deadline())?;
        let publisher = service
            .publisher_builder()
            .create()
            .map_err(|_| BusError::NoPlace {
                service: self.service_name(Channel::Feedback),
                port: "bridge",
            })?;
        Ok(FeedbackSender { publisher })
    }

    /// Reads the bridges' feedback from the next message on, in addition to the core.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn feedback(&self) -> Result<FeedbackReader, BusError> {
        let service = self
            .domain
            .open::<Feedback>(Channel::Feedback, &self.wanted, self.deadline())?;
        Ok(FeedbackReader {
            subscriber: self.subscribe(&service, Channel::Feedback)?,
        })
    }

    /// Opens the channel for a sensor's values.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn load_sender(&self) -> Result<LoadSender, BusError> {
        let service = self
            .domain
            .open::<Load>(Channel::Load, &self.wanted, self.deadline())?;
        let publisher = service
            .publisher_builder()
            .create()
            .map_err(|_| BusError::NoPlace {
                service: self.service_name(Channel::Load),
                port: "sensor",
            })?;
        Ok(LoadSender { publisher })
    }

    /// Subscribes to the values of sensors, starting with the next; the core's own monitoring does not see
    /// this reader.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn loads(&self) -> Result<LoadReader, BusError> {
        let service = self
            .domain
            .open::<Load>(Channel::Load, &self.wanted, self.deadline())?;
        Ok(LoadReader {
            subscriber: self.subscribe(&service, Channel::Load)?,
        })
    }

    /// Subscribes to the machine's outputs, starting with those in force.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn outputs(&self) -> Result<OutputReader, BusError> {
        let service = self
            .domain
            .open::<MachineOutputs>(Channel::Output, &self.wanted, self.deadline())?;
        Ok(OutputReader {
            subscriber: self.subscribe(&service, Channel::Output)?,
        })
    }

    /// Opens the channel for the machine's inputs.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn input_sender(&self) -> Result<InputSender, BusError> {
        let service = self
            .domain
            .open::<MachineInputs>(Channel::Input, &self.wanted, self.deadline())?;
        let publisher = service
            .publisher_builder()
            .create()
            .map_err(|_| BusError::NoPlace {
                service: self.service_name(Channel::Input),
                port: "bridge",
            })?;
        Ok(InputSender { publisher })
    }

    /// Reads the inputs from the next message on, in addition to the core.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn inputs(&self) -> Result<InputReader, BusError> {
        let service = self
            .domain
            .open::<MachineInputs>(Channel::Input, &self.wanted, self.deadline())?;
        Ok(InputReader {
            subscriber: self.subscribe(&service, Channel::Input)?,
        })
    }

    /// Reads the feedback of spindles from the next message on, in addition to the core.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn spindles(&self) -> Result<SpindleReader, BusError> {
        let service = self
            .domain
            .open::<SpindleFeedback>(Channel::Spindle, &self.wanted, self.deadline())?;
        Ok(SpindleReader {
            subscriber: self.subscribe(&service, Channel::Spindle)?,
        })
    }

    /// Opens the channel for the feedback of spindles.
    ///
    /// # Errors
    /// The service does not exist, or all connections are taken.
    pub fn spindle_sender(&self) -> Result<SpindleSender, BusError> {
        let service = self
            .domain
            .open::<SpindleFeedback>(Channel::Spindle, &self.wanted, self.deadline())?;
        let publisher = service
            .publisher_builder()
            .create()
            .map_err(|_| BusError::NoPlace {
                service: self.service_name(Channel::Spindle),
                port: "bridge",
            })?;
        Ok(SpindleSender { publisher })
    }

    fn deadline(&self) -> Deadline {
        Deadline::after(self.config.wait)
    }

    fn service_name(&self, channel: Channel) -> String {
        channel
            .service_name(&self.config.machine_name)
            .unwrap_or_default()
    }

    /// Rejects a reader if no more connections are free than are reserved. iceoryx2 has no such distinction:
    /// foreign clients have to implement it themselves.
    fn leave_places<P: core::fmt::Debug + ZeroCopySend>(
        &self,
        service: &PubSub<P>,
        channel: Channel,
        kept: usize,
    ) -> Result<(), BusError> {
        let taken = service.dynamic_config().number_of_subscribers();
        if taken.saturating_add(kept) < service.static_config().max_subscribers() {
            return Ok(());
        }
        Err(BusError::NoPlace {
            service: self.service_name(channel),
            port: "subscriber",
        })
    }

    fn subscribe<P: core::fmt::Debug + ZeroCopySend>(
        &self,
        service: &PubSub<P>,
        channel: Channel,
    ) -> Result<Subscriber<Ipc, P, ()>, BusError> {
        self.subscribe_with(service, channel, None)
    }

    /// With this buffer instead of the channel's largest.
    fn subscribe_with<P: core::fmt::Debug + ZeroCopySend>(
        &self,
        service: &PubSub<P>,
        channel: Channel,
        buffer: Option<usize>,
    ) -> Result<Subscriber<Ipc, P, ()>, BusError> {
        let builder = service.subscriber_builder();
        let builder = match buffer {
            Some(messages) => builder.buffer_size(messages),
            None => builder,
        };
        builder.create().map_err(|cause| match cause {
            SubscriberCreateError::ExceedsMaxSupportedSubscribers => BusError::NoPlace {
                service: self.service_name(channel),
                port: "subscriber",
            },
            cause => BusError::Service {
                service: self.service_name(channel),
                cause: format!("{cause:?}"),
            },
        })
    }
}

/// Setpoints in order, with a count of those that were overwritten before they were read.
#[derive(Debug)]
pub struct SetpointReader {
    subscriber: Subscriber<Ipc, Setpoint, ()>,
    next: Option<u64>,
    lost: u64,
}

impl SetpointReader {
    /// The oldest setpoint not read yet; none if there is none. Does not wait.
    ///
    /// # Errors
    /// The connection is damaged, or the core uses another version.
    pub fn receive(&mut self) -> Result<Option<Setpoint>, ReceiveError> {
        let setpoint = receive(&self.subscriber, Channel::Setpoint)?;
        if let Some(setpoint) = &setpoint {
            // A lower number is a new run, not a loss.
            let expected = self.next.unwrap_or(setpoint.sequence);
            self.lost += setpoint.sequence.saturating_sub(expected);
            self.next = setpoint.sequence.checked_add(1);
        }
        Ok(setpoint)
    }

    /// Setpoints lost since the first, seen as gaps in the sequence.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }
}

/// The feedback of all bridges, in the order of arrival.
#[derive(Debug)]
pub struct FeedbackReader {
    subscriber: Subscriber<Ipc, Feedback, ()>,
}

impl FeedbackReader {
    /// The oldest feedback not read yet; none if there is none. Does not wait. Its values are the bridge's
    /// and may not be numbers.
    ///
    /// # Errors
    /// The connection is damaged, or a bridge uses another version.
    pub fn receive(&mut self) -> Result<Option<Feedback>, ReceiveError> {
        receive(&self.subscriber, Channel::Feedback)
    }
}

/// The values of all sensors, in the order of arrival.
#[derive(Debug)]
pub struct LoadReader {
    subscriber: Subscriber<Ipc, Load, ()>,
}

impl LoadReader {
    /// The oldest value not read yet; none if there is none. Does not wait. The reader must check whether it
    /// is valid.
    ///
    /// # Errors
    /// The connection is damaged, or a sensor uses another version.
    pub fn receive(&mut self) -> Result<Option<Load>, ReceiveError> {
        receive(&self.subscriber, Channel::Load)
    }
}

/// The latest snapshot.
#[derive(Debug)]
pub struct StatusReader {
    subscriber: Subscriber<Ipc, Status, ()>,
    latest: Option<Status>,
}

impl StatusReader {
    /// The latest snapshot; none before the core has sent the first since this reader joined. `sequence` and
    /// `time_ns` show whether it is stale: after the core's death the last one stays.
    ///
    /// # Errors
    /// The connection is damaged, or the core uses another version.
    pub fn latest(&mut self) -> Result<Option<Status>, ReceiveError> {
        while let Some(status) = receive(&self.subscriber, Channel::Status)? {
            self.latest = Some(status);
        }
        Ok(self.latest)
    }
}

/// Every snapshot, in order.
#[derive(Debug)]
pub struct EveryStatusReader {
    subscriber: Subscriber<Ipc, Status, ()>,
}

impl EveryStatusReader {
    /// The oldest snapshot not read yet, the first of them the one that was current when this reader joined. A
    /// reader that lags by more than [`STATUS_BUFFER`](crate::STATUS_BUFFER) loses the oldest, which leaves a
    /// gap in `sequence`.
    ///
    /// # Errors
    /// The connection is damaged, or the core uses another version.
    pub fn receive(&mut self) -> Result<Option<Status>, ReceiveError> {
        receive(&self.subscriber, Channel::Status)
    }
}

/// Wakes with the core's events.
#[derive(Debug)]
pub struct EventReader {
    listener: Listener<Ipc>,
    _service: EventService,
}

impl EventReader {
    /// Sleeps until an event, the timeout, or a signal; returns the events, each kind once, in the order of
    /// their numbers. A timeout of zero only polls.
    ///
    /// # Errors
    /// The connection is damaged.
    pub fn wait(&mut self, timeout: Duration) -> Result<Vec<EventKind>, ReceiveError> {
        let mut kinds = Vec::new();
        let note =
            |activation: EventActivation| kinds.extend(EventKind::from_number(activation.id.as_value()));
        // For a socket, a timeout of zero microseconds means none: it would wait forever.
        let waited = if timeout < Duration::from_micros(1) {
            self.listener.try_wait(note)
        } else {
            self.listener.timed_wait(note, timeout)
        };
        match waited {
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => {}
            Err(_) => {
                return Err(ReceiveError::Broken {
                    channel: "event",
                    cause: "ListenerWaitError",
                });
            }
        }
        kinds.sort_by_key(|kind| kind.number());
        kinds.dedup();
        Ok(kinds)
    }
}

/// Sends a bridge's feedback.
#[derive(Debug)]
pub struct FeedbackSender {
    publisher: Publisher<Ipc, Feedback, ()>,
}

impl FeedbackSender {
    /// Sends one feedback message; never waits.
    ///
    /// # Errors
    /// The message was not sent.
    pub fn send(&mut self, feedback: &Feedback) -> Result<usize, SendError> {
        self.publisher
            .send_copy(*feedback)
            .map_err(|cause| send_error(Channel::Feedback, cause))
    }
}

/// Sends a sensor's values.
#[derive(Debug)]
pub struct LoadSender {
    publisher: Publisher<Ipc, Load, ()>,
}

impl LoadSender {
    /// Sends one value; never waits.
    ///
    /// # Errors
    /// The value was not sent.
    pub fn send(&mut self, load: &Load) -> Result<usize, SendError> {
        self.publisher
            .send_copy(*load)
            .map_err(|cause| send_error(Channel::Load, cause))
    }
}

/// The machine's outputs, in the order of their changes.
#[derive(Debug)]
pub struct OutputReader {
    subscriber: Subscriber<Ipc, MachineOutputs, ()>,
}

impl OutputReader {
    /// The oldest outputs not read yet; none if there are none. Does not wait.
    ///
    /// # Errors
    /// The connection is damaged, or the core uses another version.
    pub fn receive(&mut self) -> Result<Option<MachineOutputs>, ReceiveError> {
        receive(&self.subscriber, Channel::Output)
    }
}

/// The inputs of all bridges, in the order of arrival.
#[derive(Debug)]
pub struct InputReader {
    subscriber: Subscriber<Ipc, MachineInputs, ()>,
}

impl InputReader {
    /// The oldest message not read yet; none if there is none. Does not wait. Its values are the bridge's and
    /// may not be numbers.
    ///
    /// # Errors
    /// The connection is damaged, or a bridge uses another version.
    pub fn receive(&mut self) -> Result<Option<MachineInputs>, ReceiveError> {
        receive(&self.subscriber, Channel::Input)
    }
}

/// The feedback of all spindles, in the order of arrival.
#[derive(Debug)]
pub struct SpindleReader {
    subscriber: Subscriber<Ipc, SpindleFeedback, ()>,
}

impl SpindleReader {
    /// The oldest message not read yet; none if there is none. Does not wait. Its values are the bridge's and
    /// may not be numbers.
    ///
    /// # Errors
    /// The connection is damaged, or a bridge uses another version.
    pub fn receive(&mut self) -> Result<Option<SpindleFeedback>, ReceiveError> {
        receive(&self.subscriber, Channel::Spindle)
    }
}

/// Sends the machine's inputs.
#[derive(Debug)]
pub struct InputSender {
    publisher: Publisher<Ipc, MachineInputs, ()>,
}

impl InputSender {
    /// Sends one message; never waits.
    ///
    /// # Errors
    /// The message was not sent.
    pub fn send(&mut self, inputs: &MachineInputs) -> Result<usize, SendError> {
        self.publisher
            .send_copy(*inputs)
            .map_err(|cause| send_error(Channel::Input, cause))
    }
}

/// Sends the feedback of spindles.
#[derive(Debug)]
pub struct SpindleSender {
    publisher: Publisher<Ipc, SpindleFeedback, ()>,
}

impl SpindleSender {
    /// Sends one message; never waits.
    ///
    /// # Errors
    /// The message was not sent.
    pub fn send(&mut self, feedback: &SpindleFeedback) -> Result<usize, SendError> {
        self.publisher
            .send_copy(*feedback)
            .map_err(|cause| send_error(Channel::Spindle, cause))
    }
}
