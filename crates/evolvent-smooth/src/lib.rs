//! Smoothing: programmed blocks in, the path that is driven out, within the tolerance.

mod block;
mod joint;
mod output;
mod smoother;

pub use block::{Block, Settings, Tolerance};
pub use output::{Mark, Output, Stretch};
pub use smoother::Smoother;
