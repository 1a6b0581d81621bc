//! Blocks in, path out.

use crate::joint::{JointKind, judge};
use crate::{Block, Mark, Output, Settings, Stretch, Tolerance};

/// Turns programmed blocks into the path that is driven.
#[derive(Debug)]
pub struct Smoother {
    settings: Settings,
    held: Option<Block>,
    /// Parameter at the end of what was pushed.
    end: f64,
    deviation: f64,
}

impl Smoother {
    /// At rest at the start of the first block.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        Self {
            settings,
            held: None,
            end: 0.0,
            deviation: 0.0,
        }
    }

    /// Appends a block; whatever of the path is settled by it comes out.
    pub fn push(&mut self, block: &Block, out: &mut Vec<Output>) {
        let mut joint = false;
        if let Some(held) = self.held.replace(*block) {
            let (left, right) = (&held.curve, &block.curve);
            let kind = judge(
                &left.jet(left.domain()),
                &right.jet(0.0),
                &self.settings.limits,
                self.settings.joint_time_s,
            );
            match kind {
                _ if held.tolerance == Tolerance::Stop => out.push(Output::Cap { speed: 0.0 }),
                JointKind::Smooth => {}
                JointKind::Step { speed } => {
                    out.push(Output::Cap { speed });
                    joint = speed > 0.0;
                }
            }
        }
        let length = block.curve.domain();
        self.end += length;
        out.push(Output::Stretch(Stretch {
            curve: block.curve,
            from: 0.0,
            length,
            feed: block.feed,
            rapid: block.rapid,
            blend: false,
            joint,
        }));
        out.push(Output::Mark(Mark {
            end: self.end,
            line: block.line,
            block: block.block,
            rapid: block.rapid,
        }));
    }

    /// The path comes to rest at the end of what was pushed: all of it comes out.
    pub fn rest(&mut self, out: &mut Vec<Output>) {
        if self.held.take().is_some() {
            out.push(Output::Cap { speed: 0.0 });
        }
    }

    /// Largest distance of the path that came out from the programmed one, mm (or degrees of a rotary axis).
    #[must_use]
    pub fn deviation_mm(&self) -> f64 {
        self.deviation
    }
}
