//! The control service: commands in, answers out.

use core::time::Duration;
use iceoryx2::active_request::ActiveRequest;
use iceoryx2::port::client::Client;
use iceoryx2::port::server::Server;
use iceoryx2::prelude::*;
use std::time::Instant;

use crate::config::{BusConfig, ClientConfig, PLACES_FOR_OPERATORS};
use crate::discovery::no_core;
use crate::domain::{
    ATTRIBUTE_AXES, ATTRIBUTE_INTERFACE, ATTRIBUTE_PERIOD, ControlService, Domain, Ipc, Wanted,
};
use crate::error::{BusError, ReceiveError};
use crate::name::Channel;
use evolvent_wire::{ControlAnswer, ControlRequest, Payload};

type ServerPort = Server<Ipc, ControlRequest, (), ControlAnswer, ()>;
type Active = ActiveRequest<Ipc, ControlRequest, (), ControlAnswer, ()>;
type ClientPort = Client<Ipc, ControlRequest, (), ControlAnswer, ()>;

/// How often an answer is looked for.
const POLL: Duration = Duration::from_micros(500);

/// A request that is to be answered, now or later.
///
/// One that is dropped without an answer leaves its client waiting until its time limit.
#[derive(Debug)]
pub struct ControlCall {
    request: ControlRequest,
    active: Active,
}

impl ControlCall {
    /// The request: a copy, so that what a client does to its memory afterwards has no effect.
    #[must_use]
    pub const fn request(&self) -> &ControlRequest {
        &self.request
    }

    /// Sends the answer. A client that has gone meanwhile misses it.
    pub fn answer(self, answer: ControlAnswer) {
        let _gone = self.active.send_copy(answer);
    }
}

/// The core's end of the control service. It cannot leave the thread that opened it.
///
/// A request is copied before it is looked at: what a client does to its memory afterwards has no effect.
#[derive(Debug)]
pub struct ControlServer {
    server: ServerPort,
    _service: ControlService,
    foreign: u64,
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
        let deadline = Instant::now() + config.open_timeout;
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
            if Instant::now() >= deadline {
                return Err(BusError::Service {
                    service: Channel::Control.service_name(&config.machine_name)?,
                    cause: format!("{cause:?}"),
                });
            }
            // The place of a killed core is given free by cleaning.
            domain.node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
            std::thread::sleep(Duration::from_millis(5));
        };
        domain.end_core();
        Ok(Self {
            server,
            _service: service,
            foreign: 0,
            _domain: domain,
        })
    }

    /// Takes the oldest waiting request; `None` where none waits. One of another version is given too, and is to be rejected. Of
    /// one client at most four can be unanswered at a time.
    ///
    /// # Errors
    /// The connection is damaged.
    pub fn receive(&mut self) -> Result<Option<ControlCall>, ReceiveError> {
        use iceoryx2::port::ReceiveError as Cause;
        let request = self.server.receive().map_err(|cause| ReceiveError::Broken {
            channel: Channel::Control.name(),
            cause: match cause {
                Cause::ExceedsMaxBorrows => "ExceedsMaxBorrows",
                Cause::ConnectionFailure(_) => "ConnectionFailure",
            },
        })?;
        let Some(active) = request else { return Ok(None) };
        let request = *active.payload();
        if !request.is_compatible() {
            self.foreign += 1;
        }
        Ok(Some(ControlCall { request, active }))
    }

    /// Has the oldest waiting request answered by `judge`; `false` where none waits. A request of another version
    /// gets to `judge` too, which is to reject it. A client that has gone meanwhile misses its answer.
    ///
    /// # Errors
    /// The connection is damaged.
    pub fn serve(
        &mut self,
        judge: impl FnOnce(&ControlRequest) -> ControlAnswer,
    ) -> Result<bool, ReceiveError> {
        let Some(call) = self.receive()? else {
            return Ok(false);
        };
        let answer = judge(call.request());
        call.answer(answer);
        Ok(true)
    }

    /// Requests so far whose version or size was not of this build.
    #[must_use]
    pub const fn foreign_requests(&self) -> u64 {
        self.foreign
    }
}

/// Why a command got no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    /// It did not leave.
    #[error("the command was not sent ({cause}): is the core still there?")]
    NotSent {
        /// iceoryx2's name for the cause.
        cause: String,
    },
    /// Nobody answered.
    #[error(
        "no answer within {waited_ms} ms: the core has gone or hangs; whether the command took effect is unknown"
    )]
    NoAnswer {
        /// How long was waited, in ms.
        waited_ms: u64,
    },
    /// The connection is damaged.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
}

/// A client's end of the control service. It cannot leave the thread that opened it.
#[derive(Debug)]
pub struct ControlClient {
    client: ClientPort,
    _service: ControlService,
    number: u64,
    serial: u64,
    _domain: Domain,
}

impl ControlClient {
    /// Finds the machine, waiting for its core where that is not up yet.
    ///
    /// # Errors
    /// No core in time, one that does not fit, or no place but those that are kept for operators who must get in.
    pub fn open(config: &ClientConfig) -> Result<Self, BusError> {
        Self::join(config, PLACES_FOR_OPERATORS)
    }

    /// The same for who comes with one command that must get through, as an emergency stop, and goes again: takes one
    /// of the places that are kept for that.
    ///
    /// # Errors
    /// No core in time, one that does not fit, or no place.
    pub fn open_in_need(config: &ClientConfig) -> Result<Self, BusError> {
        Self::join(config, 0)
    }

    fn join(config: &ClientConfig, kept: usize) -> Result<Self, BusError> {
        let begin = Instant::now();
        let prefix = config.prefix.as_deref();
        let domain = Domain::join_core(&config.machine_name, prefix, "operator", begin + config.wait)?;
        let wanted: Wanted = [
            (ATTRIBUTE_INTERFACE, Some(crate::INTERFACE_VERSION.to_string())),
            (
                ATTRIBUTE_PERIOD,
                config.period_ns.map(|period_ns| period_ns.to_string()),
            ),
            (ATTRIBUTE_AXES, config.axes.clone()),
        ];
        let service = domain.open_control(&wanted, begin + config.wait)?;
        // A core makes the service first and its own end of it then: a command in between would be lost.
        while service.dynamic_config().number_of_servers() == 0 {
            if begin.elapsed() >= config.wait {
                return Err(no_core(&config.machine_name, prefix, begin));
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
        // Unique among clients on this computer for as long as processes keep different numbers and starts.
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
    /// It did not leave, or nobody answered in time.
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

    /// Sends a request with the numbers that stand in it, whatever they are. For tests and for clients that number by
    /// themselves.
    ///
    /// # Errors
    /// It did not leave, or nobody answered in time.
    pub fn send_as_it_is(
        &mut self,
        request: &ControlRequest,
        timeout: Duration,
    ) -> Result<ControlAnswer, CommandError> {
        let begin = Instant::now();
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
            if begin.elapsed() >= timeout {
                return Err(CommandError::NoAnswer {
                    waited_ms: begin.elapsed().as_millis() as u64,
                });
            }
            std::thread::sleep(POLL);
        }
    }
}
