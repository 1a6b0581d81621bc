//! Divides the intervals of a window further where the motion starts and ends at rest.

use crate::cell::Cell;
use crate::grid::{Grid, PathPosition};
use crate::optimizer::WindowProblem;
use crate::stub::max_jerk;
use crate::window::Span;

/// Maximum length of a span as a fraction of its distance from a rest.
const GRADING: f64 = 0.12;
/// The same at the end of an open window, which is replanned before the motion reaches it.
const OPEN_GRADING: f64 = 0.3;
/// Factor on the length of the stub there.
const OPEN_STUB_FACTOR: f64 = 100.0;
/// Minimum length of a span near a rest, as a fraction of the stub length.
const MIN_SPAN_FRACTION: f64 = 0.02;

/// Maximum number of halvings in the search for the stub length; at 0.1 % of the feed the stub is tiny.
const MAX_HALVINGS: u32 = 30;

/// Maximum ratio of the lengths of neighbouring spans, and minimum length of a part of a span, as a fraction.
const MAX_GROWTH: f64 = 1.35;
const MIN_PART_FRACTION: f64 = 0.003;

/// The undivided spans from a position to the end of interval `until - 1`.
pub(crate) fn plain(grid: &Grid, from: PathPosition, until: u64, spans: &mut Vec<Span>) {
    for interval in from.interval..until {
        let length = grid.interval_length(interval).unwrap_or(0.0);
        let x = if interval == from.interval { from.x } else { 0.0 };
        if length - x > 0.0 {
            spans.push(Span {
                interval,
                x,
                length: length - x,
            });
        }
    }
}

/// Divides the spans that start (or, with `reverse`, end) at rest, so that the first is a stub and the
/// following ones grow in proportion to their distance from the rest. At most `capacity` spans in total.
pub(crate) fn grade(
    spans: &mut Vec<Span>,
    problem: &WindowProblem<'_>,
    reverse: bool,
    capacity: usize,
    scratch: &mut Vec<Span>,
) {
    let total: f64 = spans.iter().map(|span| span.length).sum();
    if reverse {
        spans.reverse();
    }
    let Some(first) = spans.first().copied() else {
        return;
    };
    let rest_length = rest_length_at(problem, first, reverse).min(total / 20.0);
    let grading = if reverse && problem.end_jerk_fraction < 1.0 {
        OPEN_GRADING
    } else {
        GRADING
    };
    // A longer stub permits a higher speed at its start. Newton's method at best doubles `u'^2` per step, so
    // the next window, which passes this position at speed, needs half as many steps.
    let stub = if reverse && problem.end_jerk_fraction < 1.0 {
        (OPEN_STUB_FACTOR * rest_length)
            .min(total / 20.0)
            .min(if problem.whole { 1.0 } else { 0.5 } * first.length)
    } else {
        rest_length.min(0.5 * first.length)
    };
    scratch.clear();
    let (mut at, mut next) = (0.0, stub);
    let mut spare = capacity.saturating_sub(spans.len());
    for span in spans.iter() {
        let mut left = *span;
        while left.length > 1.5 * next && spare > 0 {
            spare -= 1;
            // Half of the remainder instead of a tiny span at the end.
            let part = if left.length < 2.0 * next {
                0.5 * left.length
            } else {
                next
            };
            let piece = cut(&mut left, part, reverse);
            scratch.push(piece);
            at += part;
            next = (grading * at).max(MIN_SPAN_FRACTION * rest_length);
        }
        scratch.push(left);
        at += left.length;
        next = (grading * at).max(MIN_SPAN_FRACTION * rest_length);
    }
    if reverse {
        scratch.reverse();
    }
    std::mem::swap(spans, scratch);
}

/// Divides spans that are much longer than a neighbour. At most `capacity` spans in total.
pub(crate) fn balance(spans: &mut Vec<Span>, capacity: usize, scratch: &mut Vec<Span>) {
    for reverse in [false, true] {
        if reverse {
            spans.reverse();
        }
        scratch.clear();
        let mut next = f64::INFINITY;
        let mut spare = capacity.saturating_sub(spans.len());
        for span in spans.iter() {
            let mut left = *span;
            next = f64::max(next, MIN_PART_FRACTION * span.length);
            while left.length > 1.5 * next && spare > 0 {
                spare -= 1;
                let part = if left.length < 2.0 * next {
                    0.5 * left.length
                } else {
                    next
                };
                scratch.push(cut(&mut left, part, reverse));
                next = MAX_GROWTH * part;
            }
            scratch.push(left);
            next = MAX_GROWTH * left.length;
        }
        if reverse {
            scratch.reverse();
        }
        std::mem::swap(spans, scratch);
    }
}

/// Cuts a part off a span: from its start, or with `reverse` from its end.
fn cut(left: &mut Span, part: f64, reverse: bool) -> Span {
    let remainder = left.length - part;
    let piece = Span {
        x: if reverse { left.x + remainder } else { left.x },
        length: part,
        ..*left
    };
    if !reverse {
        left.x += part;
    }
    left.length = remainder;
    piece
}

/// Divides the spans of the first `reach` into parts of at most `max`, for a motion that has to change at
/// once however smooth the path is there. At most `capacity` spans in total.
pub(crate) fn subdivide(
    spans: &mut Vec<Span>,
    reach: f64,
    max: f64,
    capacity: usize,
    scratch: &mut Vec<Span>,
) {
    scratch.clear();
    let mut at = 0.0;
    let mut spare = capacity.saturating_sub(spans.len());
    for span in spans.iter() {
        let needed = if at < reach {
            (span.length / max).ceil().clamp(1.0, 1e3)
        } else {
            1.0
        };
        let parts = (needed as usize).min(spare + 1);
        spare -= parts - 1;
        let width = span.length / parts as f64;
        for k in 0..parts {
            let x = width * k as f64;
            let length = if k + 1 == parts { span.length - x } else { width };
            scratch.push(Span {
                x: span.x + x,
                length,
                ..*span
            });
        }
        at += span.length;
    }
    std::mem::swap(spans, scratch);
}

/// The length from rest over which constant jerk is optimal: well within the first phase of jerk, before the
/// path has curved.
fn rest_length_at(problem: &WindowProblem<'_>, first: Span, reverse: bool) -> f64 {
    let (grid, limits) = (problem.grid, problem.grid.limits());
    let (Some(cell), true) = (grid.cell(first.interval), first.length > 0.0) else {
        return 0.0;
    };
    let Some(segment) = grid.segment(cell.segment) else {
        return 0.0;
    };
    let mut length = first.length;
    let max = |length: f64| {
        let x = if reverse {
            first.x + first.length - length
        } else {
            first.x
        };
        let part = Cell::new(segment, cell.segment, cell.from + x, length, limits);
        let far = usize::from(!reverse) * 2;
        let ends =
            |point: usize, x: f64| max_jerk(&part.points[point], x, limits, problem.factor, 1.0, reverse);
        (
            ends(2 - far, 0.0),
            ends(1, 0.5 * length).min(ends(far, 2.0 * length)),
        )
    };
    for _ in 0..MAX_HALVINGS {
        let (at_rest, later) = max(length);
        if later >= 0.98 * at_rest {
            break;
        }
        length *= 0.5;
    }
    length
}
