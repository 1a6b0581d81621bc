//! The picture of a plan: the path coloured by feed, the feed over time, and how far each axis uses its limits.
//!
//! A run may have millions of setpoints. What is drawn are buckets of equal time; a bucket keeps the extremes of
//! its setpoints, so that no peak is lost, and when all are full, neighbours are joined.

use evolvent_machine::Machine;
use evolvent_motion::{Setpoint, flags};
use plotters::coord::Shift;
use plotters::prelude::*;

const WIDTH_PX: u32 = 1000;
const HEAD_PX: u32 = 50;
const PATH_PX: u32 = 640;
const FEED_PX: u32 = 240;
const AXIS_PX: u32 = 210;
/// Buckets over time; about two a pixel.
const BUCKETS: usize = 2048;
/// Points of the path.
const POINTS: usize = 16_384;

const VELOCITY: RGBColor = RGBColor(0x3a, 0x7d, 0x2c);
const ACCELERATION: RGBColor = RGBColor(0x00, 0x5a, 0xa0);
const JERK: RGBColor = RGBColor(0xb3, 0x3c, 0x00);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Drawn<T> = Result<T, Box<dyn std::error::Error>>;

/// Extremes over the setpoints of a bucket.
#[derive(Clone, Debug)]
struct Bucket {
    feed: (f64, f64),
    /// Largest magnitudes over the limit: velocity, acceleration, jerk of each axis.
    ratios: Vec<[f64; 3]>,
}

impl Bucket {
    fn join(&mut self, other: &Self) {
        self.feed = (self.feed.0.min(other.feed.0), self.feed.1.max(other.feed.1));
        for (mine, theirs) in self.ratios.iter_mut().zip(&other.ratios) {
            for (mine, theirs) in mine.iter_mut().zip(theirs) {
                *mine = mine.max(*theirs);
            }
        }
    }
}

/// Gathers what is drawn while a plan is computed.
pub(crate) struct PlanFigure {
    machine: Machine,
    period_s: f64,
    buckets: Vec<Bucket>,
    /// Setpoints of a bucket, and of those in the last one.
    width: u64,
    filled: u64,
    /// Points with their feed; none on rapids.
    path: Vec<([f64; 3], Option<f64>)>,
    stride: u64,
    seen: u64,
}

impl PlanFigure {
    pub(crate) fn new(machine: &Machine, period_s: f64) -> Self {
        Self {
            machine: machine.clone(),
            period_s,
            buckets: Vec::with_capacity(BUCKETS),
            width: 1,
            filled: 0,
            path: Vec::with_capacity(POINTS),
            stride: 1,
            seen: 0,
        }
    }

    /// Takes the next setpoint.
    pub(crate) fn see(&mut self, setpoint: &Setpoint) {
        if self.seen.is_multiple_of(self.stride) {
            if self.path.len() == POINTS {
                let mut keep = false;
                self.path.retain(|_| {
                    keep = !keep;
                    keep
                });
                self.stride *= 2;
            }
            let p = &setpoint.position;
            let rapid = setpoint.flags & flags::RAPID != 0;
            self.path
                .push(([p[0], p[1], p[2]], (!rapid).then_some(setpoint.feed_mm_s)));
        }
        self.seen += 1;
        let ratios = self.machine.axes.iter().map(|axis| {
            let i = axis.letter.index();
            [
                setpoint.velocity[i].abs() / axis.max_velocity,
                setpoint.acceleration[i].abs() / axis.max_acceleration,
                setpoint.jerk[i].abs() / axis.max_jerk,
            ]
        });
        let feed = setpoint.feed_mm_s;
        let bucket = Bucket {
            feed: (feed, feed),
            ratios: ratios.collect(),
        };
        if self.filled > 0 && self.filled < self.width {
            if let Some(last) = self.buckets.last_mut() {
                last.join(&bucket);
            }
            self.filled += 1;
            return;
        }
        if self.buckets.len() == BUCKETS {
            self.join_neighbours();
        }
        self.buckets.push(bucket);
        self.filled = 1;
    }

    fn join_neighbours(&mut self) {
        for k in 0..BUCKETS / 2 {
            let (left, right) = self.buckets.split_at_mut(2 * k + 1);
            left[2 * k].join(&right[0]);
            self.buckets.swap(k, 2 * k);
        }
        self.buckets.truncate(BUCKETS / 2);
        self.width *= 2;
    }

    /// The picture as the text of an SVG file.
    pub(crate) fn svg(&self, title: &str) -> Result<String, String> {
        let mut svg = String::new();
        self.draw(title, &mut svg)
            .map_err(|error| format!("the plan could not be drawn: {error}"))?;
        Ok(svg)
    }

    fn draw(&self, title: &str, svg: &mut String) -> Drawn<()> {
        let axes = self.machine.axes.len() as u32;
        let height = HEAD_PX + PATH_PX + FEED_PX + axes * AXIS_PX;
        let root = SVGBackend::with_string(svg, (WIDTH_PX, height)).into_drawing_area();
        root.fill(&WHITE)?;
        root.draw(&Text::new(title.to_owned(), (20, 14), ("sans-serif", 24)))?;
        let (_, body) = root.split_vertically(HEAD_PX);
        let (path, body) = body.split_vertically(PATH_PX);
        let (feed, body) = body.split_vertically(FEED_PX);
        self.draw_path(&path)?;
        self.draw_feed(&feed)?;
        for (k, part) in body.split_evenly((axes.max(1) as usize, 1)).iter().enumerate() {
            self.draw_axis(part, k)?;
        }
        root.present()?;
        Ok(())
    }

    /// The plane in which the program mostly lies.
    fn plane(&self) -> (usize, usize) {
        let span = |i: usize| {
            let (low, high) = extent(self.path.iter().map(|point| point.0[i]));
            high - low
        };
        match (span(0), span(1), span(2)) {
            (x, y, z) if z > x && y >= x => (1, 2),
            (_, y, z) if z > y => (2, 0),
            _ => (0, 1),
        }
    }

    fn draw_path(&self, area: &Area<'_>) -> Drawn<()> {
        let (i, j) = self.plane();
        let ((x0, x1), (y0, y1)) = (
            extent(self.path.iter().map(|point| point.0[i])),
            extent(self.path.iter().map(|point| point.0[j])),
        );
        // Equal scales: the plot is 860 by 540 pixels within its margins.
        let (px, py) = (860.0, 540.0);
        let scale = ((x1 - x0).max(1e-6) / px).max((y1 - y0).max(1e-6) / py) * 1.06;
        let (cx, cy) = (0.5 * (x0 + x1), 0.5 * (y0 + y1));
        let (wx, wy) = (0.5 * scale * px, 0.5 * scale * py);
        let fastest = self.path.iter().filter_map(|point| point.1).fold(1e-9, f64::max);
        let names = ["X", "Y", "Z"];
        let caption = format!(
            "Path, coloured by feed: blue at rest, red at {:.0} mm/min; rapids grey",
            60.0 * fastest
        );
        let mut chart = ChartBuilder::on(area)
            .caption(caption, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(44)
            .y_label_area_size(84)
            .build_cartesian_2d(cx - wx..cx + wx, cy - wy..cy + wy)?;
        chart
            .configure_mesh()
            .x_desc(format!("{}, mm", names[i]))
            .y_desc(format!("{}, mm", names[j]))
            .light_line_style(TRANSPARENT)
            .label_style(("sans-serif", 14))
            .draw()?;
        // Stretches of like colour in one element each keep the file small.
        let shade = |feed: Option<f64>| feed.map(|feed| (16.0 * feed / fastest).min(15.0) as u32);
        let mut from = 0;
        while from + 1 < self.path.len() {
            let tone = shade(self.path[from].1);
            let mut to = from + 1;
            while to + 1 < self.path.len() && shade(self.path[to].1) == tone {
                to += 1;
            }
            let line = self.path[from..=to].iter().map(|point| (point.0[i], point.0[j]));
            let style = match tone {
                None => RGBColor(0x90, 0x90, 0x90).stroke_width(1),
                Some(tone) => HSLColor(0.66 * (1.0 - f64::from(tone) / 15.0), 0.9, 0.42).stroke_width(2),
            };
            chart.draw_series(LineSeries::new(line, style))?;
            from = to;
        }
        Ok(())
    }

    fn time(&self, bucket: usize) -> f64 {
        (bucket as f64 + 0.5) * self.width as f64 * self.period_s
    }

    fn draw_feed(&self, area: &Area<'_>) -> Drawn<()> {
        let fastest = 60.0
            * self
                .buckets
                .iter()
                .map(|bucket| bucket.feed.1)
                .fold(1e-9, f64::max);
        let end = self.time(self.buckets.len());
        let mut chart = ChartBuilder::on(area)
            .caption("Feed along the path", ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(38)
            .y_label_area_size(84)
            .build_cartesian_2d(0.0..end, 0.0..1.08 * fastest)?;
        chart
            .configure_mesh()
            .x_desc("time, s")
            .y_desc("feed, mm/min")
            .light_line_style(TRANSPARENT)
            .label_style(("sans-serif", 14))
            .draw()?;
        let line = self.buckets.iter().enumerate().flat_map(|(k, bucket)| {
            let t = self.time(k);
            [(t, 60.0 * bucket.feed.0), (t, 60.0 * bucket.feed.1)]
        });
        chart.draw_series(LineSeries::new(line, VELOCITY.stroke_width(1)))?;
        Ok(())
    }

    fn draw_axis(&self, area: &Area<'_>, axis: usize) -> Drawn<()> {
        let Some(of) = self.machine.axes.get(axis) else {
            return Ok(());
        };
        let unit = if of.letter.is_rotary() { "deg" } else { "mm" };
        let caption = format!(
            "{}: share of {:.0} {unit}/s, {:.0} {unit}/s2, {:.0} {unit}/s3",
            of.letter.letter(),
            of.max_velocity,
            of.max_acceleration,
            of.max_jerk
        );
        let end = self.time(self.buckets.len());
        let mut chart = ChartBuilder::on(area)
            .caption(caption, ("sans-serif", 18))
            .margin(10)
            .x_label_area_size(38)
            .y_label_area_size(84)
            .build_cartesian_2d(0.0..end, 0.0..125.0)?;
        chart
            .configure_mesh()
            .x_desc("time, s")
            .y_desc("% of limit")
            .y_labels(6)
            .light_line_style(TRANSPARENT)
            .label_style(("sans-serif", 14))
            .draw()?;
        for (k, name, color) in [
            (2, "jerk", JERK),
            (1, "acceleration", ACCELERATION),
            (0, "velocity", VELOCITY),
        ] {
            let line = self
                .buckets
                .iter()
                .enumerate()
                .map(|(at, bucket)| (self.time(at), 100.0 * bucket.ratios[axis][k].min(1.2)));
            chart.draw_series(LineSeries::new(line, color.stroke_width(1)))?;
            // Beside the caption: nowhere else is free of lines for sure.
            let place = ([730, 810, 930][k], 14);
            area.draw(&Text::new(
                name,
                place,
                ("sans-serif", 16).into_font().color(&color),
            ))?;
        }
        chart.draw_series(LineSeries::new(
            [(0.0, 100.0), (end, 100.0)],
            BLACK.stroke_width(1),
        ))?;
        Ok(())
    }
}

fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use evolvent_motion::State;
    use evolvent_path::Axes;

    use super::*;

    fn figure() -> PlanFigure {
        let text = include_str!("../../../config/machines/mill-3axis.toml");
        let machine = Machine::parse(text, "mill-3axis.toml").unwrap();
        PlanFigure::new(&machine, 0.001)
    }

    fn setpoint(sequence: u64, feed_mm_s: f64) -> Setpoint {
        Setpoint {
            sequence,
            position: Axes::repeat(sequence as f64 * 1e-3),
            velocity: Axes::repeat(feed_mm_s),
            acceleration: Axes::zeros(),
            jerk: Axes::zeros(),
            path_mm: 0.0,
            feed_mm_s,
            feed_override: 1.0,
            line: 1,
            block: 0,
            state: State::Running,
            flags: 0,
            actions: 0,
        }
    }

    #[test]
    fn no_peak_is_lost_however_long_the_run() {
        for peak in [0, 1, 77_777, 99_999] {
            let mut figure = figure();
            for k in 0..100_000 {
                figure.see(&setpoint(k, if k == peak { 50.0 } else { 1.0 }));
            }
            assert!(figure.buckets.len() <= BUCKETS && figure.path.len() <= POINTS);
            let most = figure
                .buckets
                .iter()
                .map(|bucket| bucket.feed.1)
                .fold(0.0, f64::max);
            assert_eq!(most, 50.0, "peak at {peak}");
            // 100 000 setpoints at 1 ms: the buckets cover 100 s.
            let covered = figure.buckets.len() as f64 * figure.width as f64 * 0.001;
            assert!((100.0..100.1).contains(&covered), "{covered}");
            let at = figure
                .buckets
                .iter()
                .position(|bucket| bucket.feed.1 > 40.0)
                .unwrap();
            assert!((figure.time(at) - peak as f64 * 0.001).abs() <= figure.width as f64 * 0.001);
        }
    }

    #[test]
    fn a_plan_without_setpoints_is_drawn_all_the_same() {
        let svg = figure().svg("empty").unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    }
}
