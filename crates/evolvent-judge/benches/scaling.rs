//! How the cost of planning grows.
fn main() {}
