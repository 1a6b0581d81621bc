//! Sending and receiving on iceoryx2's ports: checks of version and size, names of errors.

use crate::domain::Ipc;
use crate::error::{ReceiveError, SendError};
use crate::name::Channel;
use core::fmt::Debug;
use evolvent_wire::Payload;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::ZeroCopySend;

/// Takes one message of this version from a subscriber.
pub(crate) fn receive<P: Payload + ZeroCopySend + Debug>(
    subscriber: &Subscriber<Ipc, P, ()>,
    channel: Channel,
) -> Result<Option<P>, ReceiveError> {
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

/// iceoryx2's name of a cause, without allocation: it may be called every cycle.
pub(crate) fn send_error(channel: Channel, cause: iceoryx2::port::SendError) -> SendError {
    use iceoryx2::port::SendError as Cause;
    let cause = match cause {
        Cause::ConnectionBrokenSinceSenderNoLongerExists => "SenderNoLongerExists",
        Cause::ConnectionCorrupted => "ConnectionCorrupted",
        Cause::LoanError(_) => "LoanError",
        Cause::ConnectionError(_) => "ConnectionError",
        Cause::UnableToDeliver => "UnableToDeliver",
        Cause::InternalError => "InternalError",
    };
    SendError::NotSent {
        channel: channel.name(),
        cause,
    }
}
