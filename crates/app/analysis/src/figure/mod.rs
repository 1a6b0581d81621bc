//! The picture of a plan: the path coloured by feed and by active limit; feed, and velocity, acceleration and
//! jerk of every axis over time with their limits.
//!
//! A run can have millions of setpoints. Over time they are reduced to buckets that keep the extremes
//! ([`Strips`]), along the path to points that keep its shape ([`Trail`]): the file stays small, and every
//! peak is shown.

mod palette;
pub(crate) mod scale;
mod strips;
pub(crate) mod svg;
mod trail;

use evolvent_machine::{Axis, Machine};
use evolvent_motion::{Setpoint, flags};

use crate::limiting::{Limiting, Order};
use palette::{FEED_TONES, cause_colour, feed_colour};
use scale::{Scale, grouped, nice_ticks};
use strips::{Bucket, Range, Strips};
use svg::{Anchor, Pen, Svg};
use trail::{Trail, TrailPoint};

const WIDTH: f64 = 1200.0;
/// Plot area of the diagrams over time.
const LEFT: f64 = 168.0;
const RIGHT: f64 = 1132.0;
/// Plot areas of the two views of the path.
const VIEWS: [(f64, f64); 2] = [(74.0, 586.0), (668.0, 1180.0)];
const VIEW_HEIGHTS: (f64, f64) = (130.0, 500.0);
const FEED_HEIGHT: f64 = 120.0;
const BAND_HEIGHT: f64 = 30.0;
const STRIP_HEIGHT: f64 = 54.0;
/// Scale of a strip relative to the limits.
const BEYOND: f64 = 1.15;
/// Maximum number of points of the path.
const POINTS: usize = 12_000;
/// Permitted excess of a published setpoint: rounding, and the noise of third differences.
const TOLERATED: [f64; 3] = [1.001, 1.001, 1.02];
/// Maximum number of causes in the legend.
const NAMED: usize = 14;

const STYLE: &str = "text{font:12px sans-serif;fill:#222}.title{font-size:19px;font-weight:bold}.head{font-size:14px;font-weight:bold}.axis{font-size:20px;font-weight:bold}.small{font-size:11px;fill:#555}.bad{font-size:11px;fill:#c00;font-weight:bold}.frame{fill:none;stroke:#999}.grid{stroke:#e4e4e4}.limit{stroke:#c00;stroke-dasharray:5 3}.zero{stroke:#bbb}.mark{fill:#fff;stroke:#222;stroke-width:1.5}";
/// Colours of velocity, acceleration and jerk.
const ORDERS: [&str; 3] = ["#3a7d2c", "#1f5fa8", "#8a5a9e"];

/// Collects the data of the picture while a plan is computed.
pub struct PlanFigure {
    machine: Machine,
    period_s: f64,
    strips: Strips,
    trail: Trail,
    fastest: f64,
}

impl PlanFigure {
    /// A picture for a machine, with the control period in s.
    #[must_use]
    pub fn new(machine: &Machine, period_s: f64) -> Self {
        Self {
            machine: machine.clone(),
            period_s,
            strips: Strips::new(machine, period_s),
            trail: Trail::new(POINTS, 1e-5),
            fastest: 0.0,
        }
    }

    /// Takes the next setpoint, its feed word (`None` on rapids) and its active limit.
    pub fn see(&mut self, setpoint: &Setpoint, word: Option<f64>, cause: Limiting) {
        self.strips.see(setpoint, word, cause);
        let rapid = setpoint.flags & flags::RAPID != 0;
        let feed = (!rapid).then_some(setpoint.feed_mm_s);
        self.fastest = self.fastest.max(feed.unwrap_or(0.0));
        let p = &setpoint.position;
        self.trail.see(TrailPoint {
            position: [p[0], p[1], p[2]],
            feed,
            cause: cause.index() as u8,
        });
    }

    /// The picture as the text of an SVG file.
    #[must_use]
    pub fn svg(&self, title: &str) -> String {
        let mut svg = Svg::new(WIDTH);
        svg.text((20.0, 32.0), Anchor::Start, "title", title);
        let subtitle = format!(
            "{:.3} s at {:.2} Hz; limits of the axes dashed red",
            self.strips.end_s(),
            1.0 / self.period_s
        );
        svg.text((20.0, 52.0), Anchor::Start, "small", &subtitle);
        let below = self.draw_views(&mut svg, 88.0);
        let below = self.draw_feed(&mut svg, below + 34.0);
        let below = self.draw_band(&mut svg, below + 34.0);
        let mut y = below + 30.0;
        for (k, axis) in self.machine.axes.iter().enumerate() {
            y = self.draw_axis(&mut svg, y, k, axis) + 16.0;
        }
        self.draw_times(&mut svg, y - 16.0);
        svg.finish(y + 34.0, STYLE)
    }

    /// The main plane of the program: indices of the horizontal and the vertical axis.
    fn plane(points: &[TrailPoint]) -> (usize, usize) {
        let span = |i: usize| {
            let range = extent(points.iter().map(|point| point.position[i]));
            range.1 - range.0
        };
        match (span(0), span(1), span(2)) {
            (x, y, z) if z > x && y >= x => (1, 2),
            (x, y, z) if z > y && x > z => (0, 2),
            (_, y, z) if z > y => (2, 0),
            _ => (0, 1),
        }
    }

    fn draw_views(&self, svg: &mut Svg, top: f64) -> f64 {
        let points = self.trail.points();
        let (i, j) = Self::plane(&points);
        let (x0, x1) = extent(points.iter().map(|point| point.position[i]));
        let (y0, y1) = extent(points.iter().map(|point| point.position[j]));
        let width = VIEWS[0].1 - VIEWS[0].0;
        // Equal scales; a long, flat part gets a flat view.
        let (dx, dy) = (x1 - x0, y1 - y0);
        let per_px = (1.06 * dx / width).max(1.06 * dy / VIEW_HEIGHTS.1).max(1e-6);
        let height = (1.06 * dy / per_px).clamp(VIEW_HEIGHTS.0, VIEW_HEIGHTS.1);
        let (cx, cy) = (0.5 * (x0 + x1), 0.5 * (y0 + y1));
        let names = ["X", "Y", "Z"];
        svg.text(
            (VIEWS[0].0, top - 10.0),
            Anchor::Start,
            "head",
            "Path, coloured by feed",
        );
        svg.text(
            (VIEWS[1].0, top - 10.0),
            Anchor::Start,
            "head",
            "Path, coloured by what limits the motion",
        );
        for (view, &(left, right)) in VIEWS.iter().enumerate() {
            let across = Scale::new(cx - 0.5 * width * per_px, cx + 0.5 * width * per_px, left, right);
            let half = 0.5 * height * per_px;
            let up = Scale::new(cy - half, cy + half, top + height, top);
            for tick in nice_ticks(across.low(), across.high(), 6) {
                let x = across.at(tick);
                svg.line((x, top), (x, top + height), "grid");
                svg.text((x, top + height + 15.0), Anchor::Middle, "small", &grouped(tick));
            }
            for tick in nice_ticks(up.low(), up.high(), (height / 60.0) as usize + 1) {
                let y = up.at(tick);
                svg.line((left, y), (right, y), "grid");
                svg.text((left - 5.0, y + 4.0), Anchor::End, "small", &grouped(tick));
            }
            svg.frame((left, top), (width, height));
            svg.text(
                (right, top + height + 29.0),
                Anchor::End,
                "small",
                &format!("{}, mm", names[i]),
            );
            svg.text(
                (left - 5.0, top - 10.0),
                Anchor::End,
                "small",
                &format!("{}, mm", names[j]),
            );
            let project = |point: &TrailPoint| (across.at(point.position[i]), up.at(point.position[j]));
            if view == 0 {
                self.draw_by_feed(svg, &points, project);
            } else {
                self.draw_by_cause(svg, &points, project);
            }
            if let (Some(first), Some(last)) = (points.first(), points.last()) {
                svg.circle(project(first), 3.5, "mark");
                svg.circle(project(last), 2.0, "mark");
            }
            if 0.5 * self.trail.tolerance() > per_px {
                let text = format!("drawn within {:.2} mm", self.trail.tolerance());
                svg.text((left, top + height + 29.0), Anchor::Start, "small", &text);
            }
        }
        let below = top + height + 44.0;
        self.draw_feed_legend(svg, below);
        self.draw_cause_legend(svg, below)
    }

    fn draw_by_feed(
        &self,
        svg: &mut Svg,
        points: &[TrailPoint],
        project: impl Fn(&TrailPoint) -> (f64, f64),
    ) {
        let tone = |feed: f64| {
            let fraction = feed / self.fastest.max(1e-9);
            ((FEED_TONES as f64 * fraction) as usize).min(FEED_TONES - 1)
        };
        let pens = pens(FEED_TONES + 1, points, project, |point| {
            point.feed.map_or(FEED_TONES, tone)
        });
        // Rapids first, then from fast to slow: slow sections are on top.
        svg.stroke(&pens[FEED_TONES], "#bbb", 1.0, "stroke-dasharray=\"4 3\"");
        for tone in (0..FEED_TONES).rev() {
            svg.stroke(&pens[tone], &feed_colour(tone), 1.8, "");
        }
    }

    fn draw_by_cause(
        &self,
        svg: &mut Svg,
        points: &[TrailPoint],
        project: impl Fn(&TrailPoint) -> (f64, f64),
    ) {
        // Rapids are thinner: they cross the part.
        let pens = pens(2 * Limiting::COUNT, points, project, |point| {
            usize::from(point.cause) + if point.feed.is_none() { Limiting::COUNT } else { 0 }
        });
        let mut causes = self.strips.causes();
        // Frequent causes below, rare ones on top.
        causes.sort_by(|a, b| b.1.total_cmp(&a.1));
        for (cause, _) in causes {
            let colour = cause_colour(cause);
            for (which, width) in [(cause.index() + Limiting::COUNT, 1.0), (cause.index(), 1.8)] {
                if let Some(pen) = pens.get(which) {
                    svg.stroke(pen, &colour, width, "");
                }
            }
        }
    }

    fn draw_feed_legend(&self, svg: &mut Svg, top: f64) {
        let (left, right) = VIEWS[0];
        let width = 0.6 * (right - left) / FEED_TONES as f64;
        for tone in 0..FEED_TONES {
            svg.rect(
                (left + tone as f64 * width, top),
                (width + 0.5, 12.0),
                &feed_colour(tone),
            );
        }
        let end = left + width * FEED_TONES as f64;
        let fastest = 60.0 * self.fastest;
        for (fraction, anchor) in [(0.0, Anchor::Start), (0.5, Anchor::Middle), (1.0, Anchor::End)] {
            let text = grouped((fraction * fastest).round());
            svg.text(
                (left + fraction * (end - left), top + 26.0),
                anchor,
                "small",
                &text,
            );
        }
        svg.text((end + 10.0, top + 11.0), Anchor::Start, "", "mm/min");
        svg.text(
            (left, top + 44.0),
            Anchor::Start,
            "small",
            "rapids dashed grey; large circle: start, small circle: end",
        );
    }

    fn draw_cause_legend(&self, svg: &mut Svg, top: f64) -> f64 {
        let causes = self.strips.causes();
        let (left, right) = VIEWS[1];
        let column = 0.5 * (right - left);
        let shown = causes.len().min(NAMED);
        let rows = shown.div_ceil(2).max(1);
        for (k, (cause, fraction)) in causes.iter().take(shown).enumerate() {
            let (x, y) = (left + column * (k / rows) as f64, top + 18.0 * (k % rows) as f64);
            svg.rect((x, y), (22.0, 12.0), &cause_colour(*cause));
            let text = format!("{}: {} of the time", cause.name(), percent(*fraction));
            svg.text((x + 30.0, y + 10.5), Anchor::Start, "", &text);
        }
        let mut y = top + 18.0 * rows as f64;
        if causes.len() > shown {
            let rest: f64 = causes.iter().skip(shown).map(|(_, fraction)| fraction).sum();
            let text = format!("and {} more: {} of the time", causes.len() - shown, percent(rest));
            svg.text((left, y + 10.5), Anchor::Start, "small", &text);
            y += 18.0;
        }
        y.max(top + 50.0)
    }

    fn times(&self) -> Scale {
        Scale::new(0.0, self.strips.end_s().max(1e-9), LEFT, RIGHT)
    }

    fn draw_grid(&self, svg: &mut Svg, top: f64, height: f64) {
        let times = self.times();
        for tick in nice_ticks(0.0, times.high(), 10) {
            svg.line((times.at(tick), top), (times.at(tick), top + height), "grid");
        }
    }

    fn draw_times(&self, svg: &mut Svg, top: f64) {
        let times = self.times();
        for tick in nice_ticks(0.0, times.high(), 10) {
            svg.text(
                (times.at(tick), top + 15.0),
                Anchor::Middle,
                "small",
                &grouped(tick),
            );
        }
        svg.text((RIGHT + 8.0, top + 15.0), Anchor::Start, "small", "time, s");
    }

    fn draw_feed(&self, svg: &mut Svg, top: f64) -> f64 {
        svg.text((LEFT, top - 8.0), Anchor::Start, "head", "Feed along the path");
        svg.text(
            (LEFT + 176.0, top - 8.0),
            Anchor::Start,
            "small",
            "mm/min (deg/min where only rotary axes move); rapids grey; black line: feed word times override",
        );
        let buckets = self.strips.buckets();
        let max = |range: &dyn Fn(&Bucket) -> Range| {
            buckets
                .iter()
                .map(|bucket| range(bucket).magnitude())
                .fold(0.0, f64::max)
        };
        let (cutting, rapid) = (max(&|bucket| bucket.feed), max(&|bucket| bucket.rapid));
        let word = max(&|bucket| bucket.word);
        // Neither rapids nor a feed word far above the achieved feed may flatten the diagram.
        let reached = if cutting > 0.0 { cutting } else { rapid };
        let high = 60.0
            * reached
                .max(if word <= 2.0 * reached { word } else { 0.0 })
                .max(1e-6)
            * 1.12;
        let up = Scale::new(0.0, high, top + FEED_HEIGHT, top);
        self.draw_grid(svg, top, FEED_HEIGHT);
        for tick in nice_ticks(0.0, high, 4) {
            let y = up.at(tick);
            svg.line((LEFT, y), (RIGHT, y), "grid");
            svg.text((LEFT - 5.0, y + 4.0), Anchor::End, "small", &grouped(tick));
        }
        let height = |feed: f64| up.at((60.0 * feed).min(high));
        svg.fill(&self.area(|bucket| bucket.rapid, height), "#c4c4c4");
        svg.fill(&self.area(|bucket| bucket.feed, height), "#2f7d6b");
        let mut pen = Pen::default();
        let times = self.times();
        let mut down = false;
        for (k, bucket) in buckets.iter().enumerate() {
            let word = bucket.word.high * 60.0;
            if !bucket.word.is_some() || word > high {
                down = false;
                continue;
            }
            let (x0, x1) = (
                times.at(self.strips.start_s(k)),
                times.at(self.strips.start_s(k + 1)),
            );
            if down {
                pen.line_to(x0, up.at(word));
            } else {
                pen.move_to(x0, up.at(word));
            }
            pen.line_to(x1, up.at(word));
            down = true;
        }
        svg.stroke(&pen, "#000", 0.9, "");
        let beyond = [("rapids", rapid), ("feed words", word)]
            .iter()
            .filter(|(_, speed)| 60.0 * speed > high)
            .map(|(what, speed)| format!("{what} up to {}", grouped((60.0 * speed).round())))
            .collect::<Vec<_>>();
        if !beyond.is_empty() {
            let text = format!("beyond the picture: {}", beyond.join(", "));
            // Below the frame: the heading with its units is above it.
            let below = top + FEED_HEIGHT + 14.0;
            svg.text((RIGHT, below), Anchor::End, "small", &text);
        }
        svg.frame((LEFT, top), (RIGHT - LEFT, FEED_HEIGHT));
        top + FEED_HEIGHT
    }

    /// Active limits over time: each bucket is a column, divided in proportion to its setpoints.
    fn draw_band(&self, svg: &mut Svg, top: f64) -> f64 {
        svg.text((LEFT, top - 8.0), Anchor::Start, "head", "Limited by");
        svg.text(
            (LEFT + 176.0, top - 8.0),
            Anchor::Start,
            "small",
            "colours as above; where causes alternate quickly, a column shows their shares",
        );
        let times = self.times();
        let buckets = self.strips.buckets();
        for (cause, _) in self.strips.causes() {
            let mut pen = Pen::default();
            let mut from = 0;
            while from < buckets.len() {
                let part = column(&buckets[from], cause);
                let mut to = from + 1;
                while to < buckets.len() && column(&buckets[to], cause) == part {
                    to += 1;
                }
                if part.0 < part.1 {
                    let (x0, x1) = (
                        times.at(self.strips.start_s(from)),
                        times.at(self.strips.start_s(to)),
                    );
                    let (y0, y1) = (top + BAND_HEIGHT * part.0, top + BAND_HEIGHT * part.1);
                    pen.move_to(x0, y0);
                    pen.line_to(x1, y0);
                    pen.line_to(x1, y1);
                    pen.line_to(x0, y1);
                    pen.close();
                }
                from = to;
            }
            svg.fill(&pen, &cause_colour(cause));
        }
        svg.frame((LEFT, top), (RIGHT - LEFT, BAND_HEIGHT));
        top + BAND_HEIGHT
    }

    fn draw_axis(&self, svg: &mut Svg, top: f64, k: usize, axis: &Axis) -> f64 {
        let letter = axis.letter.letter().to_string();
        let middle = top + 1.5 * STRIP_HEIGHT + 8.0;
        svg.text((28.0, middle + 7.0), Anchor::Middle, "axis", &letter);
        let limits = [axis.max_velocity, axis.max_acceleration, axis.max_jerk];
        for (n, order) in Order::ALL.iter().enumerate() {
            let (limit, top) = (limits[n], top + n as f64 * (STRIP_HEIGHT + 8.0));
            let up = Scale::new(-BEYOND * limit, BEYOND * limit, top + STRIP_HEIGHT, top);
            self.draw_grid(svg, top, STRIP_HEIGHT);
            svg.line((LEFT, up.at(0.0)), (RIGHT, up.at(0.0)), "zero");
            let range = |bucket: &Bucket| bucket.axes.get(k).map_or(bucket.feed, |ranges| ranges[n]);
            let pen = self.area(range, |value| up.at(value.clamp(-BEYOND * limit, BEYOND * limit)));
            svg.fill(&pen, ORDERS[n]);
            for (sign, name) in [(1.0, ""), (-1.0, "\u{2212}")] {
                let y = up.at(sign * limit);
                svg.line((LEFT, y), (RIGHT, y), "limit");
                let text = format!("{name}{}", grouped(limit));
                svg.text((LEFT - 5.0, y + 4.0), Anchor::End, "small", &text);
            }
            svg.text(
                (44.0, up.at(0.0) + 1.0),
                Anchor::Start,
                "",
                &capitalised(order.name()),
            );
            svg.text(
                (44.0, up.at(0.0) + 15.0),
                Anchor::Start,
                "small",
                order.unit(axis.letter),
            );
            let max = self
                .strips
                .buckets()
                .iter()
                .map(|bucket| range(bucket).magnitude())
                .fold(0.0, f64::max);
            let class = if max > TOLERATED[n] * limit {
                "bad"
            } else {
                "small"
            };
            let text = format!("{:.1} %", 100.0 * max / limit);
            svg.text((RIGHT + 6.0, up.at(0.0) + 4.0), Anchor::Start, class, &text);
            svg.frame((LEFT, top), (RIGHT - LEFT, STRIP_HEIGHT));
        }
        top + 3.0 * STRIP_HEIGHT + 16.0
    }

    /// The area between the lowest and the highest values over time.
    fn area(&self, range: impl Fn(&Bucket) -> Range, up: impl Fn(f64) -> f64) -> Pen {
        let times = self.times();
        let buckets = self.strips.buckets();
        let mut pen = Pen::default();
        let mut from = 0;
        while from < buckets.len() {
            if !range(&buckets[from]).is_some() {
                from += 1;
                continue;
            }
            let mut to = from;
            while to < buckets.len() && range(&buckets[to]).is_some() {
                to += 1;
            }
            pen.move_to(
                times.at(self.strips.start_s(from)),
                up(range(&buckets[from]).high),
            );
            for k in from..to {
                let y = up(range(&buckets[k]).high);
                pen.line_to(times.at(self.strips.start_s(k)), y);
                pen.line_to(times.at(self.strips.start_s(k + 1)), y);
            }
            for k in (from..to).rev() {
                let y = up(range(&buckets[k]).low);
                pen.line_to(times.at(self.strips.start_s(k + 1)), y);
                pen.line_to(times.at(self.strips.start_s(k)), y);
            }
            pen.close();
            from = to;
        }
        pen
    }
}

/// One pen per colour: sections of equal colour share one element to keep the file small.
fn pens(
    count: usize,
    points: &[TrailPoint],
    project: impl Fn(&TrailPoint) -> (f64, f64),
    colour: impl Fn(&TrailPoint) -> usize,
) -> Vec<Pen> {
    let mut pens: Vec<Pen> = std::iter::repeat_with(Pen::default).take(count).collect();
    let mut last = None;
    for pair in points.windows(2) {
        let which = colour(&pair[0]).min(count.saturating_sub(1));
        let (from, to) = (project(&pair[0]), project(&pair[1]));
        if let Some(pen) = pens.get_mut(which) {
            if last != Some(which) {
                pen.move_to(from.0, from.1);
            }
            pen.line_to(to.0, to.1);
        }
        last = Some(which);
    }
    pens
}

/// The extent of a cause in the column of a bucket, as fractions of the height from the top.
fn column(bucket: &Bucket, cause: Limiting) -> (f64, f64) {
    let whole = f64::from(bucket.count().max(1));
    let above: u32 = bucket.causes.iter().take(cause.index()).sum();
    let own = bucket.causes.get(cause.index()).copied().unwrap_or(0);
    (f64::from(above) / whole, f64::from(above + own) / whole)
}

fn percent(fraction: f64) -> String {
    if fraction > 0.0 && fraction < 0.0005 {
        "< 0.1 %".to_owned()
    } else {
        format!("{:.1} %", 100.0 * fraction)
    }
}

fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters
        .next()
        .map(|first| first.to_uppercase().collect::<String>() + letters.as_str())
        .unwrap_or_default()
}

fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limiting::tests::{mill, moving};

    #[test]
    fn a_plan_without_setpoints_is_drawn_all_the_same() {
        let svg = PlanFigure::new(&mill(), 0.001).svg("empty <&>");
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
        assert!(svg.contains("empty &lt;&amp;&gt;") && !svg.contains("NaN") && !svg.contains("inf"));
    }

    /// An hour at 1 kHz in the worst case for the file size: speed, cause and direction change all the time.
    #[test]
    fn one_hour_at_1_khz_needs_less_than_two_megabytes() {
        let mut figure = PlanFigure::new(&mill(), 0.001);
        for k in 0..3_600_000_u32 {
            let t = f64::from(k) * 1e-3;
            let speed = 50.0 + 49.0 * (7.0 * t).sin();
            let mut setpoint = moving(
                [speed, -speed, 0.0],
                [speed * 90.0, 0.0, 0.0],
                [0.0, speed * 3e3, 0.0],
            );
            setpoint.position[0] = 100.0 * (11.0 * t).sin();
            setpoint.position[1] = 100.0 * (0.013 * t + 3.0 * t).cos();
            let cause = Limiting::of_index(k as usize / 37 % Limiting::COUNT);
            figure.see(&setpoint, Some(120.0), cause);
        }
        let svg = figure.svg("an hour");
        assert!(svg.len() < 2_000_000, "{} bytes", svg.len());
    }

    #[test]
    fn what_exceeds_a_limit_is_said_in_red() {
        let drawn = |jerk: f64| {
            let mut figure = PlanFigure::new(&mill(), 0.001);
            let setpoint = moving([1.0, 0.0, 0.0], [0.0; 3], [jerk, 0.0, 0.0]);
            figure.see(&setpoint, None, Limiting::Nothing);
            figure.svg("")
        };
        assert!(!drawn(202_000.0).contains("class=\"bad\""));
        assert!(drawn(210_000.0).contains("class=\"bad\">105.0 %"));
    }
}
