//! The diagrams of the control rate: figures 3, 4 and 5 of Kombarov and Sorokin, as one SVG.
//!
//! Text remains text in the SVG, so drawing needs no font. All axes are logarithmic: the limits are power
//! laws and become straight lines. Lines are labelled at their ends instead of in a legend.

use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::chord::{acceleration_feed_mm_s, acceleration_rate_hz, jerk_feed_mm_s, rate_for};
use crate::rate::{GRAVITY_MM_S2, RateError, RateInput, RationalRate, rational_rate};

/// The reason why there is no figure.
#[derive(Debug, thiserror::Error)]
pub enum FigureError {
    /// The numbers give no rational rate.
    #[error(transparent)]
    Rate(#[from] RateError),
    /// Drawing failed.
    #[error("the figures could not be drawn: {0}; this is a fault of the program, please report the numbers")]
    Draw(String),
}

const WIDTH_PX: u32 = 1000;
const HEAD_PX: u32 = 76;
const FIGURE_PX: u32 = 500;
const STEPS: u32 = 400;
/// Radii of figure 4, mm.
const RADII_MM: [f64; 5] = [0.25, 0.5, 1.0, 2.0, 5.0];
/// Accelerations of figure 4, g.
const ACCELERATIONS_G: [f64; 4] = [0.01, 0.1, 1.0, 10.0];
/// Jerks of figure 4, m/s3.
const JERKS_M_S3: [f64; 4] = [5.0, 50.0, 500.0, 5000.0];
/// Grids of figure 5, increments per mm; the grid of the input is added.
const GRIDS: [f64; 3] = [1e3, 1e4, 1e5];

// Dark enough to print; slopes and labels distinguish the lines without colour.
const JERK_COLOUR: RGBColor = RGBColor(0xb3, 0x3c, 0x00);
const ACCELERATION_COLOUR: RGBColor = RGBColor(0x00, 0x5a, 0xa0);
const FEED_COLOUR: RGBColor = RGBColor(0x3a, 0x7d, 0x2c);
const MACHINE_COLOUR: RGBColor = RGBColor(0xa0, 0x00, 0x60);

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Log = LogCoord<f64>;
type Chart<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<Log, Log>>;
/// Name, colour and feed over radius of one limit.
type Limit<'a> = (&'a str, RGBColor, &'a dyn Fn(f64) -> f64);
type Drawn<T> = Result<T, Box<dyn std::error::Error>>;

/// Draws three figures, one below the other: figure 3 (feed that acceleration, jerk and maximum feed permit,
/// over the radius), figure 4 (control rate over feed, by radius, with the lines at which acceleration and
/// jerk limit it) and figure 5 (control rate over acceleration, by grid). The point that requires the
/// rational rate is marked in each.
///
/// `title` is the heading, for example the machine's name. Returns the text of an SVG file. Not real-time
/// safe.
///
/// # Errors
/// Those of [`rational_rate`]; drawing itself has no cause to fail.
pub fn figures_svg(input: &RateInput, title: &str) -> Result<String, FigureError> {
    figures_svg_of_axes(input, &[], title)
}

/// As [`figures_svg`], with one figure 3 for each axis with its own limits, as in the paper (3a, 3b, ..): no
/// motion has the acceleration limit of one axis and the jerk limit of another. Without axes there is one
/// figure 3, for `input`.
///
/// # Errors
/// As [`figures_svg`], also for the limits of an axis.
pub fn figures_svg_of_axes(
    input: &RateInput,
    axes: &[(char, RateInput)],
    title: &str,
) -> Result<String, FigureError> {
    let rate = rational_rate(input)?;
    let mut feeds = Vec::new();
    for (letter, input) in axes {
        let name = format!("Figure 3. Feed that the limits of {letter} permit, over the radius of the path");
        feeds.push((name, *input, rational_rate(input)?));
    }
    if feeds.is_empty() {
        let name = "Figure 3. Feed that the limits permit, over the radius of the path";
        feeds.push((name.to_owned(), *input, rate));
    }
    let mut svg = String::new();
    draw(input, &rate, &feeds, title, &mut svg).map_err(|error| FigureError::Draw(error.to_string()))?;
    Ok(svg)
}

fn draw(
    input: &RateInput,
    rate: &RationalRate,
    feeds: &[(String, RateInput, RationalRate)],
    title: &str,
    svg: &mut String,
) -> Drawn<()> {
    let count = feeds.len() + 2;
    let height = HEAD_PX + u32::try_from(count)? * FIGURE_PX;
    let root = SVGBackend::with_string(svg, (WIDTH_PX, height)).into_drawing_area();
    root.fill(&WHITE)?;
    let (head, body) = root.split_vertically(HEAD_PX);
    let heading = format!(
        "Rational control rate {} Hz, needed at R {} mm and F {} mm/min, for {} increments/mm, chord error \
         {}",
        figure(rate.rate_hz),
        figure(rate.radius_mm),
        figure(rate.feed_mm_min),
        figure(input.increments_per_mm),
        figure(input.permitted_error_increments)
    );
    head.draw(&Text::new(
        title.to_owned(),
        (20, 12),
        ("sans-serif", 26).into_font(),
    ))?;
    head.draw(&Text::new(heading, (20, 44), ("sans-serif", 19).into_font()))?;
    let parts = body.split_evenly((count, 1));
    if let [of_feeds @ .., rates, grids] = parts.as_slice() {
        for (area, (name, input, rate)) in of_feeds.iter().zip(feeds) {
            feed_over_radius(area, &root, name, input, rate)?;
        }
        rate_over_feed(rates, &root, input, rate)?;
        rate_over_acceleration(grids, &root, input, rate)?;
    }
    root.present()?;
    Ok(())
}

/// Figure 3.
fn feed_over_radius(
    area: &Area<'_>,
    root: &Area<'_>,
    name: &str,
    input: &RateInput,
    rate: &RationalRate,
) -> Drawn<()> {
    let min = input.min_radius_mm;
    let crossings = [
        input.jerk_to_acceleration_radius_mm(),
        input.jerk_to_feed_radius_mm(),
        input.acceleration_to_feed_radius_mm(),
        rate.radius_mm,
    ];
    // Beyond the last crossing within the travel of any machine.
    let last = crossings
        .into_iter()
        .filter(|r| r.is_finite() && *r < 1e5)
        .fold(10.0 * min, f64::max);
    let radii = decade_below(min)..decade_above(2.0 * last);
    let at_ends =
        [input.feed_on_mm_s(radii.start).0, input.feed_on_mm_s(radii.end).0].map(|feed| feed * 60.0);
    let feeds = decade_below(at_ends[0])..decade_above(at_ends[1] * 1.5);
    let mut chart = log_log(
        area,
        name,
        &("radius R, mm", radii.clone()),
        &("feed F, mm/min", feeds.clone()),
    )?;
    let limits: [Limit<'_>; 3] = [
        ("by jerk", JERK_COLOUR, &|r| {
            jerk_feed_mm_s(r, input.jerk_mm_s3) * 60.0
        }),
        ("by acceleration", ACCELERATION_COLOUR, &|r| {
            acceleration_feed_mm_s(r, input.acceleration_mm_s2) * 60.0
        }),
        ("by maximum feed", FEED_COLOUR, &|_| input.max_feed_mm_s * 60.0),
    ];
    for (name, color, limit) in limits {
        let points = curve(&radii, |r| Some((r, limit(r))), &feeds);
        if points.is_empty() {
            continue;
        }
        chart
            .draw_series(LineSeries::new(points, color.stroke_width(2)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], color.stroke_width(2)));
    }
    let permitted = curve(&radii, |r| Some((r, input.feed_on_mm_s(r).0 * 60.0)), &feeds);
    chart
        .draw_series(LineSeries::new(permitted, BLACK.mix(0.25).stroke_width(9)))?
        .label("permitted: the lowest")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 24, y)], BLACK.mix(0.25).stroke_width(9)));
    mark(
        &mut chart,
        root,
        (rate.radius_mm, rate.feed_mm_min),
        &radii,
        &feeds,
        "needs the highest rate",
    )?;
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .background_style(WHITE)
        .border_style(BLACK.mix(0.4))
        .label_font(("sans-serif", 17))
        .draw()?;
    Ok(())
}

/// Figure 4.
fn rate_over_feed(area: &Area<'_>, root: &Area<'_>, input: &RateInput, rate: &RationalRate) -> Drawn<()> {
    let (k, permitted) = (input.increments_per_mm, input.permitted_error_increments);
    let feeds = 100.0..100_000.0;
    let highest = acceleration_rate_hz(10.0 * GRAVITY_MM_S2, k, permitted);
    let top = decade_above(highest);
    let rates = top / 1000.0..top;
    let mut chart = log_log(
        area,
        &format!("Figure 4. Control rate over feed, at {} increments/mm", figure(k)),
        &("feed F, mm/min", feeds.clone()),
        &("control rate f, Hz", rates.clone()),
    )?;
    let mut first = true;
    for radius_mm in RADII_MM {
        let line = curve(
            &feeds,
            |feed| Some((feed, rate_for(feed / 60.0, radius_mm, k, permitted))),
            &rates,
        );
        let end = line.last().copied();
        chart.draw_series(LineSeries::new(line, BLACK.stroke_width(1)))?;
        if let Some(end) = end {
            // A line leaves through the top or the right side.
            let through_top = end.1 > 0.98 * rates.end;
            let anchor = if through_top {
                (HPos::Center, VPos::Bottom)
            } else {
                (HPos::Left, VPos::Center)
            };
            let text = format!("R {}{}", figure(radius_mm), if through_top { "" } else { " mm" });
            let text = if first || !through_top {
                text
            } else {
                figure(radius_mm)
            };
            // Clear of the frame and of the wider first label.
            let shift = if through_top { (0, -3) } else { (5, 0) };
            label(&chart, root, end, shift, &text, &BLACK, anchor)?;
            first = false;
        }
    }
    // Where a limit applies: every radius from the smallest one up gives a point of the line.
    let radii = RADII_MM[0]..1e7;
    for n in ACCELERATIONS_G {
        let point = |r: f64| {
            let feed = acceleration_feed_mm_s(r, n * GRAVITY_MM_S2);
            (feed * 60.0 <= feeds.end).then(|| (feed * 60.0, rate_for(feed, r, k, permitted)))
        };
        let line = curve(&radii, point, &rates);
        let end = line.last().copied();
        chart.draw_series(LineSeries::new(line, ACCELERATION_COLOUR.stroke_width(2)))?;
        if let Some(end) = end {
            let text = format!("A {} g", figure(n));
            let anchor = (HPos::Left, VPos::Center);
            label(
                &chart,
                root,
                (feeds.end, end.1),
                (5, 0),
                &text,
                &ACCELERATION_COLOUR,
                anchor,
            )?;
        }
    }
    for jerk in JERKS_M_S3 {
        let point = |r: f64| {
            let feed = jerk_feed_mm_s(r, jerk * 1000.0);
            (feed * 60.0 <= feeds.end).then(|| (feed * 60.0, rate_for(feed, r, k, permitted)))
        };
        let line = curve(&radii, point, &rates);
        let start = line.first().copied();
        chart.draw_series(LineSeries::new(line, JERK_COLOUR.stroke_width(2)))?;
        if let Some(start) = start {
            let text = format!("J {} m/s³", figure(jerk));
            label(
                &chart,
                root,
                start,
                (-6, -3),
                &text,
                &JERK_COLOUR,
                (HPos::Right, VPos::Center),
            )?;
        }
    }
    mark(
        &mut chart,
        root,
        (rate.feed_mm_min, rate.rate_hz),
        &feeds,
        &rates,
        "these limits",
    )?;
    Ok(())
}

/// Figure 5.
fn rate_over_acceleration(
    area: &Area<'_>,
    root: &Area<'_>,
    input: &RateInput,
    rate: &RationalRate,
) -> Drawn<()> {
    let permitted = input.permitted_error_increments;
    let accelerations = 0.001..10.0;
    let mut grids = GRIDS.to_vec();
    // One additional line for the grid of the input.
    if !grids
        .iter()
        .any(|grid| (grid / input.increments_per_mm - 1.0).abs() < 0.01)
    {
        grids.push(input.increments_per_mm);
    }
    let of = |n: f64, k: f64| acceleration_rate_hz(n * GRAVITY_MM_S2, k, permitted);
    let min = grids.iter().copied().fold(f64::INFINITY, f64::min);
    let max = grids.iter().copied().fold(0.0, f64::max);
    let rates = decade_below(of(accelerations.start, min))..decade_above(of(accelerations.end, max));
    let mut chart = log_log(
        area,
        "Figure 5. Control rate that acceleration alone needs, by grid (k increments/mm)",
        &("permitted acceleration n, g", accelerations.clone()),
        &("control rate f, Hz", rates.clone()),
    )?;
    for k in grids {
        let line = curve(&accelerations, |n| Some((n, of(n, k))), &rates);
        let end = line.last().copied();
        chart.draw_series(LineSeries::new(line, ACCELERATION_COLOUR.stroke_width(2)))?;
        if let Some(end) = end {
            let text = format!("k {}", figure(k));
            label(
                &chart,
                root,
                end,
                (5, 0),
                &text,
                &ACCELERATION_COLOUR,
                (HPos::Left, VPos::Center),
            )?;
        }
    }
    let n = input.acceleration_mm_s2 / GRAVITY_MM_S2;
    mark(
        &mut chart,
        root,
        (n, rate.rate_hz),
        &accelerations,
        &rates,
        "these limits",
    )?;
    Ok(())
}

type Span = std::ops::Range<f64>;

fn log_log<'a, 'b>(
    area: &Area<'b>,
    caption: &str,
    x: &(&str, Span),
    y: &(&str, Span),
) -> Drawn<Chart<'a, 'b>> {
    let mut chart = ChartBuilder::on(area)
        .caption(caption, ("sans-serif", 20))
        .margin(8)
        .margin_top(4)
        .margin_right(110)
        .x_label_area_size(48)
        .y_label_area_size(84)
        .build_cartesian_2d(rounded_out(&x.1).log_scale(), rounded_out(&y.1).log_scale())?;
    chart
        .configure_mesh()
        .x_desc(x.0)
        .y_desc(y.0)
        .axis_desc_style(("sans-serif", 18))
        .label_style(("sans-serif", 16))
        .bold_line_style(BLACK.mix(0.22))
        .light_line_style(BLACK.mix(0.07))
        .x_label_formatter(&|value| figure(*value))
        .y_label_formatter(&|value| figure(*value))
        .draw()?;
    Ok(chart)
}

/// Points of a curve over a logarithmic parameter, as far as they are within the range of y.
///
/// SVG coordinates are rounded to pixels, which makes a straight line of many points ragged. Points on the
/// line through their neighbours are therefore dropped.
fn curve(over: &Span, point: impl Fn(f64) -> Option<(f64, f64)>, y: &Span) -> Vec<(f64, f64)> {
    let (start, end) = (libm::log(over.start), libm::log(over.end));
    let all: Vec<_> = (0..=STEPS)
        .map(|i| libm::exp(start + (end - start) * f64::from(i) / f64::from(STEPS)))
        .filter_map(point)
        .filter(|(_, value)| (y.start..=y.end).contains(value))
        .collect();
    let slope = |a: (f64, f64), b: (f64, f64)| libm::log(b.1 / a.1) / libm::log(b.0 / a.0);
    let mut kept: Vec<(f64, f64)> = Vec::new();
    for (i, &here) in all.iter().enumerate() {
        let straight = match (kept.last(), all.get(i + 1)) {
            (Some(&before), Some(&after)) => (slope(before, here) - slope(here, after)).abs() < 0.01,
            _ => false,
        };
        if !straight {
            kept.push(here);
        }
    }
    kept
}

fn label(
    chart: &Chart<'_, '_>,
    root: &Area<'_>,
    at: (f64, f64),
    shift: (i32, i32),
    text: &str,
    color: &RGBColor,
    (h, v): (HPos, VPos),
) -> Drawn<()> {
    let (x, y) = chart.backend_coord(&at);
    let style = ("sans-serif", 16).into_font().color(color).pos(Pos::new(h, v));
    root.draw(&Text::new(text.to_owned(), (x + shift.0, y + shift.1), style))?;
    Ok(())
}

/// A ring at the point that requires the rational rate, if it is inside the figure.
fn mark(
    chart: &mut Chart<'_, '_>,
    root: &Area<'_>,
    at: (f64, f64),
    x: &Span,
    y: &Span,
    text: &str,
) -> Drawn<()> {
    if !(x.start..=x.end).contains(&at.0) || !(y.start..=y.end).contains(&at.1) {
        return Ok(());
    }
    chart.draw_series([Circle::new(at, 6, MACHINE_COLOUR.stroke_width(3))])?;
    // The label crosses lines: a pale background keeps it legible.
    let (x, y) = chart.backend_coord(&at);
    let (right, bottom) = (x - 8, y - 12);
    let width = i32::try_from(text.len()).unwrap_or(0) * 7;
    root.draw(&Rectangle::new(
        [(right - width, bottom - 17), (right, bottom)],
        WHITE.mix(0.9).filled(),
    ))?;
    label(
        chart,
        root,
        at,
        (-10, -12),
        text,
        &MACHINE_COLOUR,
        (HPos::Right, VPos::Bottom),
    )
}

/// Slightly extended, so that rounding does not push the first and last tick out of the figure.
fn rounded_out(span: &Span) -> Span {
    span.start * (1.0 - 1e-9)..span.end * (1.0 + 1e-9)
}

fn decade_below(value: f64) -> f64 {
    libm::pow(10.0, (libm::log10(value) + 1e-9).floor())
}

fn decade_above(value: f64) -> f64 {
    libm::pow(10.0, (libm::log10(value) - 1e-9).ceil())
}

/// Formats a number with four significant digits, in groups of three.
fn figure(value: f64) -> String {
    if !value.is_finite() || value == 0.0 {
        return format!("{value}");
    }
    let digits = libm::log10(value.abs()).floor();
    if !(-4.0..7.0).contains(&digits) {
        return format!("{value:.2e}");
    }
    let decimals = (3.0 - digits).max(0.0) as usize;
    let text = format!("{value:.decimals$}");
    let (whole, part) = text.split_once('.').unwrap_or((&text, ""));
    let part = part.trim_end_matches('0');
    let mut grouped = String::new();
    for (i, c) in whole.chars().enumerate() {
        if i > 0 && (whole.len() - i) % 3 == 0 && whole.len() > 4 {
            grouped.push('\u{a0}');
        }
        grouped.push(c);
    }
    if part.is_empty() {
        grouped
    } else {
        format!("{grouped}.{part}")
    }
}
