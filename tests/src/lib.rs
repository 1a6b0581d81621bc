//! Tests across crates and with foreign clients; see the `tests` folder beside this file.
