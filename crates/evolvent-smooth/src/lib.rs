//! Smoothing: programmed blocks in, the path that is driven out, within the tolerance.

#![expect(
    clippy::neg_cmp_op_on_partial_ord,
    reason = "checks are written so that NaN fails them: not (x <= limit) refuses NaN, x > limit lets it pass"
)]

#[cfg(test)]
extern crate self as evolvent_smooth;

mod band;
mod basis;
mod block;
mod chain;
mod finder;
mod joint;
mod newton;
mod output;
mod smoother;
mod spacing;
mod together;
mod tube;
mod weights;
mod zone;

pub use block::{Block, Settings, Tolerance};
pub use output::{Mark, Output, Stretch};
pub use smoother::Smoother;
