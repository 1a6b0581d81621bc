//! Results of an attempt to open a service: iceoryx2's errors by their remedy.

use iceoryx2::service::builder::event::EventOpenError;
use iceoryx2::service::builder::publish_subscribe::PublishSubscribeOpenError as OpenError;
use iceoryx2::service::builder::request_response::RequestResponseOpenError;

/// Result of an attempt to open.
pub(crate) enum OpenFailure {
    /// May disappear: another process is creating, removing or cleaning up.
    Passing(String),
    /// Incomplete, and no process completes it.
    Hung(String),
    Missing,
    Attributes,
    Settings(String),
    Permission,
}

pub(crate) fn open_failure(error: OpenError) -> OpenFailure {
    match error {
        OpenError::DoesNotExist => OpenFailure::Missing,
        OpenError::IncompatibleAttributes => OpenFailure::Attributes,
        OpenError::InsufficientPermissions => OpenFailure::Permission,
        OpenError::IncompatibleTypes
        | OpenError::IncompatibleMessagingPattern
        | OpenError::IncompatibleOverflowBehavior
        | OpenError::VersionMismatch
        | OpenError::DoesNotSupportRequestedMinBufferSize
        | OpenError::DoesNotSupportRequestedMinHistorySize
        | OpenError::DoesNotSupportRequestedMinSubscriberBorrowedSamples
        | OpenError::DoesNotSupportRequestedAmountOfPublishers
        | OpenError::DoesNotSupportRequestedAmountOfSubscribers
        | OpenError::DoesNotSupportRequestedAmountOfNodes => OpenFailure::Settings(format!("{error:?}")),
        OpenError::HangsInCreation | OpenError::ServiceInCorruptedState => {
            OpenFailure::Hung(format!("{error:?}"))
        }
        other => OpenFailure::Passing(format!("{other:?}")),
    }
}

pub(crate) fn control_failure(error: &RequestResponseOpenError) -> OpenFailure {
    use RequestResponseOpenError as Error;
    match error {
        Error::DoesNotExist => OpenFailure::Missing,
        Error::IncompatibleAttributes => OpenFailure::Attributes,
        Error::InsufficientPermissions => OpenFailure::Permission,
        Error::HangsInCreation | Error::ServiceInCorruptedState => OpenFailure::Hung(format!("{error:?}")),
        Error::Interrupt
        | Error::InternalFailure
        | Error::IsMarkedForDestruction
        | Error::ExceedsMaxNumberOfNodes
        | Error::UnableToCreateServiceTag => OpenFailure::Passing(format!("{error:?}")),
        other => OpenFailure::Settings(format!("{other:?}")),
    }
}

pub(crate) fn event_failure(error: EventOpenError) -> OpenFailure {
    match error {
        EventOpenError::DoesNotExist => OpenFailure::Missing,
        EventOpenError::IncompatibleAttributes => OpenFailure::Attributes,
        EventOpenError::InsufficientPermissions => OpenFailure::Permission,
        EventOpenError::HangsInCreation | EventOpenError::ServiceInCorruptedState => {
            OpenFailure::Hung(format!("{error:?}"))
        }
        EventOpenError::Interrupt
        | EventOpenError::InternalFailure
        | EventOpenError::IsMarkedForDestruction
        | EventOpenError::ExceedsMaxNumberOfNodes
        | EventOpenError::UnableToCreateServiceTag => OpenFailure::Passing(format!("{error:?}")),
        other => OpenFailure::Settings(format!("{other:?}")),
    }
}
