//! A plot area with scales, grid and labels.

use crate::figure::scale::{Scale, grouped, nice_ticks};
use crate::figure::svg::{Anchor, Pen, Svg};

pub(crate) const WIDTH: f64 = 1200.0;
pub(crate) const STYLE: &str = "text{font:12px sans-serif;fill:#222}.title{font-size:19px;font-weight:bold}\
    .head{font-size:14px;font-weight:bold}.small{font-size:11px;fill:#555}.frame{fill:none;stroke:#999}\
    .grid{stroke:#e4e4e4}.zero{stroke:#888}.mark{fill:#fff;stroke:#222;stroke-width:1.5}\
    .here{stroke:#222;stroke-dasharray:4 3}";
/// Colours of stable, unstable and the law.
pub(crate) const STABLE: &str = "#1f5fa8";
pub(crate) const UNSTABLE: &str = "#c8501e";

/// A plot area on the page.
pub(crate) struct Chart {
    pub(crate) x: Scale,
    pub(crate) y: Scale,
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

impl Chart {
    /// A plot area at `at` (left, top) with a size and value ranges.
    pub(crate) fn new(at: (f64, f64), size: (f64, f64), x: [f64; 2], y: [f64; 2]) -> Self {
        let (left, top) = at;
        let (right, bottom) = (left + size.0, top + size.1);
        Self {
            x: Scale::new(x[0], x[1], left, right),
            y: Scale::new(y[0], y[1], bottom, top),
            left,
            right,
            top,
            bottom,
        }
    }

    /// Draws grid, frame, numbers and labels.
    pub(crate) fn frame(&self, svg: &mut Svg, head: &str, x: &str, y: &str) {
        self.grid(svg);
        self.border(svg, head, x, y);
    }

    fn grid(&self, svg: &mut Svg) {
        for tick in nice_ticks(self.x.low(), self.x.high(), 8) {
            svg.line(
                (self.x.at(tick), self.top),
                (self.x.at(tick), self.bottom),
                "grid",
            );
        }
        for tick in nice_ticks(self.y.low(), self.y.high(), 6) {
            let class = if tick == 0.0 { "zero" } else { "grid" };
            svg.line((self.left, self.y.at(tick)), (self.right, self.y.at(tick)), class);
        }
    }

    /// Draws frame, numbers and labels over the plot.
    pub(crate) fn border(&self, svg: &mut Svg, head: &str, x: &str, y: &str) {
        for tick in nice_ticks(self.x.low(), self.x.high(), 8) {
            svg.text(
                (self.x.at(tick), self.bottom + 15.0),
                Anchor::Middle,
                "small",
                &grouped(tick),
            );
        }
        for tick in nice_ticks(self.y.low(), self.y.high(), 6) {
            svg.text(
                (self.left - 5.0, self.y.at(tick) + 4.0),
                Anchor::End,
                "small",
                &grouped(tick),
            );
        }
        svg.frame(
            (self.left, self.top),
            (self.right - self.left, self.bottom - self.top),
        );
        svg.text((self.left, self.top - 24.0), Anchor::Start, "head", head);
        svg.text((self.left, self.top - 8.0), Anchor::Start, "small", y);
        svg.text((self.right, self.bottom + 29.0), Anchor::End, "small", x);
    }

    pub(crate) fn project(&self, x: f64, y: f64) -> (f64, f64) {
        (self.x.at(x), self.y.at(y))
    }

    /// Draws a line through points, interrupted at `None` and clipped at the top and bottom of the frame.
    pub(crate) fn line(
        &self,
        svg: &mut Svg,
        points: &[Option<(f64, f64)>],
        colour: &str,
        width: f64,
        more: &str,
    ) {
        let mut pen = Pen::default();
        let mut down = false;
        for point in points {
            let Some((x, y)) = point.filter(|(x, y)| x.is_finite() && y.is_finite()) else {
                down = false;
                continue;
            };
            let (x, y) = self.project(x, y);
            let y = y.clamp(self.top - 1.0, self.bottom + 1.0);
            if down {
                pen.line_to(x, y);
            } else {
                pen.move_to(x, y);
            }
            down = true;
        }
        svg.stroke(&pen, colour, width, more);
    }

    /// Draws a vertical line through the whole area.
    pub(crate) fn upright(&self, svg: &mut Svg, x: f64) {
        svg.line((self.x.at(x), self.top), (self.x.at(x), self.bottom), "here");
    }

    /// Draws a band over a range of x.
    pub(crate) fn band(&self, svg: &mut Svg, from: f64, to: f64, colour: &str) {
        let (a, b) = (self.x.at(from).max(self.left), self.x.at(to).min(self.right));
        if b > a {
            svg.rect((a, self.top), (b - a, self.bottom - self.top), colour);
        }
    }
}

/// A range that contains all values with a margin and does not extend below `least`.
pub(crate) fn range_of(values: impl Iterator<Item = f64>, least: f64) -> [f64; 2] {
    let finite = values.filter(|value| value.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if low > high {
        return [least.max(0.0), least.max(0.0) + 1.0];
    }
    let room = (0.06 * (high - low)).max(1e-9 * high.abs()).max(1e-12);
    [(low - room).max(least), high + room]
}

/// Draws the lines at the foot of a picture; returns the total height.
pub(crate) fn foot(svg: &mut Svg, top: f64, lines: &[String]) -> f64 {
    svg.text((60.0, top), Anchor::Start, "head", "Assumed");
    let mut y = top;
    for line in lines {
        y += 17.0;
        svg.text((60.0, y), Anchor::Start, "", line);
    }
    y + 20.0
}
