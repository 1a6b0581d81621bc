//! MCAP traces: schemas, recorder, reader, recovery.
