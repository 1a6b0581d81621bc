//! The control service: commands in, answers out.

use core::time::Duration;
use iceoryx2::active_request::ActiveRequest;
use iceoryx2::port::client::Client;
use iceoryx2::port::server::Server;
use iceoryx2::prelude::*;

use crate::config::{BusConfig, ClientConfig, PLACES_FOR_OPERATORS};
use crate::deadline::Deadline;
use crate::discovery::no_core;
use crate::domain::{
    ATTRIBUTE_AXES, ATTRIBUTE_INTERFACE, ATTRIBUTE_PERIOD, ControlService, Domain, Ipc, Wanted,
};
use crate::error::{BusError, ReceiveError};
use crate::name::Channel;
use evolvent_wire::{ControlAnswer, ControlRequest};

type ServerPort = Server<Ipc, ControlRequest, (), ControlAnswer, ()>;
type Active = ActiveRequest<Ipc, ControlRequest, (), ControlAnswer, ()>;
type ClientPort = Client<Ipc, ControlRequest, (), ControlAnswer, ()>;

/// Poll interval of an answer.
const POLL: Duration = Duration::from_micros(500);

/// A request that has to be answered, now or later.
///
/// If it is dropped without an answer, its client waits until its timeout.
#[derive(Debug)]
pub struct ControlCall {
    request: ControlRequest,
    active: Active,
}

impl ControlCall {
    /// The request: a copy, so later changes by the client have no effect.
    #[must_use]
    pub const fn request(&self) -> &ControlRequest {
        &self.request
    }

    /// Sends the answer. A client that has ended meanwhile misses it.
    pub fn answer(self, answer: ControlAnswer) {
        let _gone = self.active.send_copy(answer);
    }
}

/// The core's end of the control service. It must stay on the thread that opened it.
///
/// A request is copied before it is examined: later changes by the client to its memory have no effect.
#[derive(Debug)]
pub struct ControlServer {
    server: ServerPort,
    _service: ControlService,
    _domain: Domain,
}

impl ControlServer {
    /// Opens the service of a machine whose other channels are open: see [`crate::CoreBus`].
    ///
    /// # Errors
    /// As [`crate::CoreBus::open`].
    pub fn open(config: &BusConfig) -> Result<Self, BusError> {
        let mut domain = Domain::join(&config.machine_name, config.prefix.as_deref(), "control")?;
        let wanted: Wanted = [
            (ATTRIBUTE_INTERFACE, Some(crate::INTERFACE_VERSION.to_string())),
            (ATTRIBUTE_PERIOD, Some(config.period_ns.to_string())),
            (ATTRIBUTE_AXES, Some(config.axes.clone())),
        ];
        let deadline = Deadline::after(config.open_timeout);
        domain.begin_core(deadline)?;
        let service = domain.create_control(&wanted, deadline)?;
        let server = loop {
            let cause = match service
                .server_builder()
                .backpressure_strategy(BackpressureStrategy::DiscardData)
                .create()
            {
                Ok(server) => break server,
                Err(cause) => cause,
            };
            if deadline.has_passed() {
                return Err(BusError::Service {
                    service: Channel::Control.service_name(&config.machine_name)?,
                    cause: format!("{cause:?}"),
                });
            }
            // Cleaning frees the connection of a killed core.
            domain.node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
            std::thread::sleep(Duration::from_millis(5));
        };
        domain.end_core();
        Ok(Self {
            server,
            _service: service,
            _domain: domain,
        })
    }

    /// Takes the oldest waiting request; `None` if there is none. A request of another version is returned
    /// too, and has to be rejected. Each client may have at most four unanswered requests: what it sends
    /// beyond waits until one of them has been answered, while requests of other clients are taken.
    ///
    /// # Errors
    /// The connection is damaged.
    pub fn receive(&mut self) -> Result<Option<ControlCall>, ReceiveError> {
        use iceoryx2::port::ReceiveError as Cause;
        let request = match self.server.receive() {
            Ok(request) => request,
            // All waiting requests are of clients with four unanswered ones.
            Err(Cause::ExceedsMaxBorrows) => None,
            Err(Cause::ConnectionFailure(_)) => {
                return Err(ReceiveError::Broken {
                    channel: Channel::Control.name(),
                    cause: "ConnectionFailure",
                });
            }
        };
        let Some(active) = request else { return Ok(None) };
        let request = *active.payload();
        Ok(Some(ControlCall { request, active }))
    }
}

/// Why a command received no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// It was not sent.
    #[error("the command was not sent ({cause}): check that the core still runs")]
    NotSent {
        /// iceoryx2's name for the cause.
        cause: String,
    },
    /// Nobody answered.
    #[error(
        "no answer within {waited_ms} ms: the core has ended or hangs; whether the command took effect is \
         unknown"
    )]
    NoAnswer {
        /// The time waited, in ms.
        waited_ms: u64,
    },
    /// The connection is damaged.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
}

/// A client's end of the control service. It must stay on the thread that opened it.
#[derive(Debug)]
pub struct ControlClient {
    client: ClientPort,
    _service: ControlService,
    number: u64,
    serial: u64,
    _domain: Domain,
}

impl ControlClient {
    /// Finds the machine, waiting for its core if necessary.
    ///
    /// # Errors
    /// No core in time, one that does not match, or no connection except those reserved for operators.
    pub fn open(config: &ClientConfig) -> Result<Self, BusError> {
        Self::join(config, PLACES_FOR_OPERATORS)
    }

    /// The same for a client that sends one command that must get through, such as an emergency stop: uses
    /// one of the reserved connections.
    ///
    /// # Errors
    /// No core in time, one that does not match, or no connection.
    pub fn open_in_need(config: &ClientConfig) -> Result<Self, BusError> {
        Self::join(config, 0)
    }

    fn join(config: &ClientConfig, kept: usize) -> Result<Self, BusError> {
        let deadline = Deadline::after(config.wait);
        let prefix = config.prefix.as_deref();
        let domain = Domain::join_core(&config.machine_name, prefix, "operator", deadline)?;
        let wanted: Wanted = [
            (ATTRIBUTE_INTERFACE, Some(crate::INTERFACE_VERSION.to_string())),
            (
                ATTRIBUTE_PERIOD,
                config.period_ns.map(|period_ns| period_ns.to_string()),
            ),
            (ATTRIBUTE_AXES, config.axes.clone()),
        ];
        let service = domain.open_control(&wanted, deadline)?;
        // A core creates the service before its own end of it: a command in between would be lost.
        while service.dynamic_config().number_of_servers() == 0 {
            if deadline.has_passed() {
                return Err(no_core(&config.machine_name, prefix, deadline));
            }
            std::thread::sleep(POLL);
        }
        let taken = service.dynamic_config().number_of_clients();
        if taken.saturating_add(kept) >= service.static_config().max_clients() {
            return Err(BusError::NoPlace {
                service: Channel::Control.service_name(&config.machine_name)?,
                port: "client",
            });
        }
        let client = service
            .client_builder()
            .backpressure_strategy(BackpressureStrategy::DiscardData)
            .create()
            .map_err(|cause| BusError::Service {
                service: Channel::Control
                    .service_name(&config.machine_name)
                    .unwrap_or_default(),
                cause: format!("{cause:?}"),
            })?;
        // Unique among the clients on this computer, because processes have different numbers and start
        // times.
        let id = u64::from(std::process::id());
        let time = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .map_or(1, |since| since.as_nanos() as u64);
        Ok(Self {
            client,
            _service: service,
            number: (time ^ (id << 44)).max(1),
            serial: 0,
            _domain: domain,
        })
    }

    /// This client's number.
    #[must_use]
    pub const fn number(&self) -> u64 {
        self.number
    }

    /// Sends a command with the next serial number and waits for its answer.
    ///
    /// # Errors
    /// It was not sent, or there was no answer in time.
    pub fn command(
        &mut self,
        request: &ControlRequest,
        timeout: Duration,
    ) -> Result<ControlAnswer, CommandError> {
        self.serial += 1;
        let request = ControlRequest {
            client: self.number,
            serial: self.serial,
            ..*request
        };
        self.send_as_it_is(&request, timeout)
    }

    /// Sends a request with the given numbers. For tests and for clients with their own numbering.
    ///
    /// # Errors
    /// It was not sent, or there was no answer in time.
    pub fn send_as_it_is(
        &mut self,
        request: &ControlRequest,
        timeout: Duration,
    ) -> Result<ControlAnswer, CommandError> {
        let deadline = Deadline::after(timeout);
        let pending = self
            .client
            .send_copy(*request)
            .map_err(|cause| CommandError::NotSent {
                cause: format!("{cause:?}"),
            })?;
        loop {
            let answer = pending.receive().map_err(|_| ReceiveError::Broken {
                channel: Channel::Control.name(),
                cause: "ConnectionFailure",
            })?;
            if let Some(answer) = answer {
                return Ok(*answer.payload());
            }
            if deadline.has_passed() {
                return Err(CommandError::NoAnswer {
                    waited_ms: deadline.waited_ms(),
                });
            }
            std::thread::sleep(POLL);
        }
    }
}
