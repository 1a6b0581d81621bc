//! The last plan, as the start for the next.

use crate::barrier::Iterate;
use crate::grid::{Grid, Place};
use crate::piece::Piece;
use crate::window::{Span, Window};

/// By which share speed and acceleration given may differ from those of the last plan at that place.
const SAME: f64 = 1e-5;

/// Pieces of a head that there is room for without allocating.
const MAX_HEAD: usize = 512;

/// A span on which `b = u''` is linear: what the solver's intervals are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Segment {
    pub(crate) span: Span,
    /// `u'^2` at the start.
    pub(crate) a: f64,
    /// `u''` at the start.
    pub(crate) b: f64,
    /// `u'''/u'`.
    pub(crate) c: f64,
}

impl Segment {
    /// `(u'^2, u'')` at offset `x`.
    pub(crate) fn at(&self, x: f64) -> (f64, f64) {
        (self.a + x * (2.0 * self.b + x * self.c), self.b + x * self.c)
    }

    /// What is left of it from offset `x` on.
    fn from(&self, x: f64) -> Self {
        let (a, b) = self.at(x);
        let span = Span {
            x: self.span.x + x,
            length: self.span.length - x,
            ..self.span
        };
        Self {
            span,
            a,
            b,
            c: self.c,
        }
    }
}

/// Where in the last plan a new one begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Found {
    /// Within what was written before the segments: the index of the piece and the time in it.
    Head(usize, f64),
    /// Within the first stub, at this offset.
    FirstStub(f64),
    /// Among the segments, at this offset of the one with this index.
    Segment(usize, f64),
    /// Within the last stub, at this offset.
    LastStub(f64),
}

/// The plan that was handed out last.
#[derive(Clone, Debug, Default)]
pub(crate) struct WarmStart {
    pub(crate) valid: bool,
    pub(crate) segments: Vec<Segment>,
    /// Pieces in closed form before the segments: a way down to a lower feed, or what was left of a first stub.
    pub(crate) head: Vec<Piece>,
    /// The stub before the segments, if any.
    pub(crate) first: Option<Span>,
    /// The stub behind them.
    pub(crate) last: Option<Span>,
    /// `u'^2` at the beginning of the last stub.
    pub(crate) last_a: f64,
    pub(crate) until: u64,
    /// The feed factor it was made for.
    pub(crate) factor: f64,
}

impl WarmStart {
    pub(crate) fn with_capacity(stations: usize) -> Self {
        Self {
            segments: Vec::with_capacity(stations),
            head: Vec::with_capacity(MAX_HEAD),
            ..Self::default()
        }
    }

    /// Keeps nothing but the memory.
    pub(crate) fn forget(&mut self) {
        self.segments.clear();
        self.head.clear();
        (self.valid, self.first, self.last) = (false, None, None);
        (self.last_a, self.until, self.factor) = (0.0, 0, 0.0);
    }

    /// Becomes a copy, without allocating where there is room.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        let mut segments = std::mem::take(&mut self.segments);
        segments.clear();
        segments.extend_from_slice(&other.segments);
        let mut head = std::mem::take(&mut self.head);
        head.clear();
        head.extend_from_slice(&other.head);
        *self = Self {
            segments,
            head,
            ..*other
        };
    }

    /// Becomes the same plan driven `rate` times as fast, `0 < rate <= 1`: by distance `u'^2`, `u''` and `u'''/u'` scale alike.
    pub(crate) fn slow_down(&mut self, rate: f64) {
        let square = rate * rate;
        for segment in &mut self.segments {
            segment.a *= square;
            segment.b *= square;
            segment.c *= square;
        }
        for piece in &mut self.head {
            piece.law = piece.law.slowed_down(rate);
            piece.duration /= rate;
        }
        self.last_a *= square;
        self.factor *= rate;
    }

    /// Takes over a plan; `head` is what was written before its window.
    pub(crate) fn keep(&mut self, head: &[Piece], window: &Window, x: &Iterate, until: u64, factor: f64) {
        let n = window.n();
        self.head.clear();
        self.head.extend_from_slice(head);
        self.segments.clear();
        for k in 0..n {
            self.segments.push(Segment {
                span: window.spans[window.span_index(k)],
                a: x.a[k],
                b: x.b[k],
                c: x.c[k],
            });
        }
        self.first = window.from_rest.then(|| window.spans[0]);
        self.last = window.spans.last().copied();
        self.last_a = x.a[n];
        self.until = until;
        self.factor = factor;
        self.valid = true;
    }

    /// Finds the place in the plan, if the state given is the plan's there.
    pub(crate) fn find(&self, grid: &Grid, from: Place, v: f64, a: f64) -> Option<Found> {
        if !self.valid {
            return None;
        }
        let within = |span: &Span| {
            let x = from.x - span.x;
            let slack = 1e-9 * span.length;
            (span.interval == from.interval && x >= -slack && x <= span.length + slack)
                .then_some(x.clamp(0.0, span.length))
        };
        let same = |one: f64, other: f64, size: f64| (one - other).abs() <= SAME * size;
        for (k, piece) in self.head.iter().enumerate() {
            let (_, begin) = grid.stretch_of(piece.interval)?;
            let x = from.x - (piece.from - begin);
            if piece.interval == from.interval && (-1e-9 * piece.length..piece.length).contains(&x) {
                let t = piece.law.time_to(x, piece.duration);
                let (start, now, end) = (
                    piece.law.at(0.0).0,
                    piece.law.at(t).0,
                    piece.law.at(piece.duration).0,
                );
                let push = start.a.abs().max(end.a.abs());
                let fits = same(v, now.v, start.v.max(end.v)) && same(a, now.a, push);
                return fits.then_some(Found::Head(k, t));
            }
        }
        if let Some(first) = &self.first
            && let Some(x) = within(first)
            && x < first.length
        {
            // u = j t^3/6 with v^2 = 3/2 D b at its end.
            let (end_v, end_b) = (self.segments.first()?.a.sqrt(), self.segments.first()?.b);
            let share = libm::cbrt(x / first.length);
            let fits = same(v, end_v * share * share, end_v) && same(a, end_b * share, end_b);
            return fits.then_some(Found::FirstStub(x));
        }
        // The later of two segments that meet at the place, so that the first one is never empty.
        for (k, segment) in self.segments.iter().enumerate() {
            if let Some(x) = within(&segment.span)
                && x < segment.span.length
            {
                let (square, b) = segment.at(x);
                let speed = square.max(0.0).sqrt();
                let push = segment
                    .b
                    .abs()
                    .max((segment.b + segment.c * segment.span.length).abs());
                let fits = same(v, speed, speed) && same(a, b, push);
                return fits.then_some(Found::Segment(k, x));
            }
        }
        let last = self.last.as_ref()?;
        let x = within(last)?;
        let start_v = self.last_a.sqrt();
        let start_b = self.last_a / (1.5 * last.length);
        let share = libm::cbrt(1.0 - x / last.length);
        let fits = same(v, start_v * share * share, start_v) && same(-a, start_b * share, start_b);
        fits.then_some(Found::LastStub(x))
    }

    /// What is left of the segments from index `k`, offset `x` on.
    pub(crate) fn rest(&self, k: usize, x: f64, out: &mut Vec<Segment>) {
        out.extend_from_slice(&self.segments[k..]);
        if let Some(first) = out.first_mut() {
            *first = first.from(x);
        }
    }

    /// The last stub gone through without coming to rest, in three parts: from its state to zero acceleration at
    /// `u'^2 = level`, where `level` is at most a third of what it is at the stub's beginning.
    ///
    /// With lengths in stubs and `b` in that of the beginning, `a` begins with 3/2 and slope -2; the values of `b`
    /// between the parts share out what is needed to lose `3/2 - level`. Three times the stub's jerk suffices.
    pub(crate) fn release(span: Span, square: f64, level: f64, out: &mut Vec<Segment>) {
        let beta = square / (1.5 * span.length);
        let third = span.length / 3.0;
        let sum = 1.5 * (level / (beta * span.length) - 1.5) + 0.5;
        let b = [-beta, 0.6 * sum * beta, 0.4 * sum * beta, 0.0];
        let mut a = square;
        for k in 0..3 {
            let part = Span {
                x: span.x + third * k as f64,
                length: if k == 2 { span.length - 2.0 * third } else { third },
                ..span
            };
            let c = (b[k + 1] - b[k]) / part.length;
            out.push(Segment {
                span: part,
                a,
                b: b[k],
                c,
            });
            a += (b[k] + b[k + 1]) * part.length;
        }
    }
}
