//! Message types and services over iceoryx2.
