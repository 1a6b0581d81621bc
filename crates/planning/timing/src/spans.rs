//! How the intervals of a window are divided further where the motion begins and ends at rest.

use crate::cell::Cell;
use crate::grid::{Grid, Place};
use crate::optimizer::WindowProblem;
use crate::stub::most_jerk;
use crate::window::Span;

/// Largest length of a span as a share of its distance from a rest.
const SLOPE: f64 = 0.12;
/// The same at the end of an open window, which is planned again before the motion gets there.
const OPEN_SLOPE: f64 = 0.3;
/// How many times longer than good the stub there may be.
const OPEN_STUB: f64 = 100.0;
/// Near a rest spans need not be shorter than this share of the stub that would be good there.
const FINEST: f64 = 0.02;

/// How often a stub is halved until constant jerk is good on it: at a thousandth of the feed it is next to nothing.
const HALVINGS: u32 = 30;

/// By which factor a span may be longer than its neighbour, and how small a share of itself it is divided into.
const GROWTH: f64 = 1.35;
const SMALLEST: f64 = 0.003;

/// The spans from a place to the end of interval `until - 1`, undivided.
pub(crate) fn plain(grid: &Grid, from: Place, until: u64, spans: &mut Vec<Span>) {
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

/// Divides the spans from index `first` on, which begin at rest (or, `reverse`, end there), so that the first is a
/// stub and the following grow in proportion to their distance from the rest. At most `room` spans in all.
pub(crate) fn grade(
    spans: &mut Vec<Span>,
    job: &WindowProblem<'_>,
    reverse: bool,
    room: usize,
    scratch: &mut Vec<Span>,
) {
    let total: f64 = spans.iter().map(|span| span.length).sum();
    if reverse {
        spans.reverse();
    }
    let Some(first) = spans.first().copied() else {
        return;
    };
    let good = good_length(job, first, reverse).min(total / 20.0);
    let slope = if reverse && job.gentle < 1.0 {
        OPEN_SLOPE
    } else {
        SLOPE
    };
    // A longer stub is faster where it begins. Newton's method at best doubles `u'^2` in a step, so that the next
    // window, which goes through this place at speed, takes half as many.
    let stub = if reverse && job.gentle < 1.0 {
        (OPEN_STUB * good)
            .min(total / 20.0)
            .min(if job.whole { 1.0 } else { 0.5 } * first.length)
    } else {
        good.min(0.5 * first.length)
    };
    scratch.clear();
    let (mut at, mut next) = (0.0, stub);
    let mut spare = room.saturating_sub(spans.len());
    for span in spans.iter() {
        let mut left = *span;
        while left.length > 1.5 * next && spare > 0 {
            spare -= 1;
            // An even share of what is left rather than a crumb at the end.
            let part = if left.length < 2.0 * next {
                0.5 * left.length
            } else {
                next
            };
            let piece = cut(&mut left, part, reverse);
            scratch.push(piece);
            at += part;
            next = (slope * at).max(FINEST * good);
        }
        scratch.push(left);
        at += left.length;
        next = (slope * at).max(FINEST * good);
    }
    if reverse {
        scratch.reverse();
    }
    std::mem::swap(spans, scratch);
}

/// Divides spans that are much longer than a neighbour, so that lengths change gently. At most `room` spans in all.
pub(crate) fn balance(spans: &mut Vec<Span>, room: usize, scratch: &mut Vec<Span>) {
    for reverse in [false, true] {
        if reverse {
            spans.reverse();
        }
        scratch.clear();
        let mut next = f64::INFINITY;
        let mut spare = room.saturating_sub(spans.len());
        for span in spans.iter() {
            let mut left = *span;
            next = f64::max(next, SMALLEST * span.length);
            while left.length > 1.5 * next && spare > 0 {
                spare -= 1;
                let part = if left.length < 2.0 * next {
                    0.5 * left.length
                } else {
                    next
                };
                scratch.push(cut(&mut left, part, reverse));
                next = GROWTH * part;
            }
            scratch.push(left);
            next = GROWTH * left.length;
        }
        if reverse {
            scratch.reverse();
        }
        std::mem::swap(spans, scratch);
    }
}

/// Takes a part off a span: from its start, or `reverse` from its end.
fn cut(left: &mut Span, part: f64, reverse: bool) -> Span {
    let rest = left.length - part;
    let piece = Span {
        x: if reverse { left.x + rest } else { left.x },
        length: part,
        ..*left
    };
    if !reverse {
        left.x += part;
    }
    left.length = rest;
    piece
}

/// Divides the spans of the first `reach` into parts of at most `most`, where the motion is to change at once however
/// smooth the path is there. At most `room` spans in all.
pub(crate) fn subdivide(spans: &mut Vec<Span>, reach: f64, most: f64, room: usize, scratch: &mut Vec<Span>) {
    scratch.clear();
    let mut at = 0.0;
    let mut spare = room.saturating_sub(spans.len());
    for span in spans.iter() {
        let wanted = if at < reach {
            (span.length / most).ceil().clamp(1.0, 1e3)
        } else {
            1.0
        };
        let parts = (wanted as usize).min(spare + 1);
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

/// Over which length from rest constant jerk is as good as anything: well within the first phase of jerk, before
/// the path has turned.
fn good_length(job: &WindowProblem<'_>, first: Span, reverse: bool) -> f64 {
    let (grid, limits) = (job.grid, job.grid.limits());
    let (Some(cell), true) = (grid.cell(first.interval), first.length > 0.0) else {
        return 0.0;
    };
    let Some(stretch) = grid.stretch(cell.stretch) else {
        return 0.0;
    };
    let mut length = first.length;
    let most = |length: f64| {
        let x = if reverse {
            first.x + first.length - length
        } else {
            first.x
        };
        let part = Cell::new(stretch, cell.stretch, cell.from + x, length, limits);
        let far = usize::from(!reverse) * 2;
        let ends = |point: usize, x: f64| most_jerk(&part.points[point], x, limits, job.factor, 1.0, reverse);
        (
            ends(2 - far, 0.0),
            ends(1, 0.5 * length).min(ends(far, 2.0 * length)),
        )
    };
    for _ in 0..HALVINGS {
        let (at_rest, later) = most(length);
        if later >= 0.98 * at_rest {
            break;
        }
        length *= 0.5;
    }
    length
}
