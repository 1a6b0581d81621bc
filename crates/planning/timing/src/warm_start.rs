//! The last plan, as the warm start of the next.

use crate::barrier::Iterate;
use crate::grid::{Grid, PathPosition};
use crate::piece::TimeLawPiece;
use crate::window::{Span, Window};

/// Permitted relative difference between a given state and that of the last plan at the position.
const STATE_TOLERANCE: f64 = 1e-5;

/// Number of head pieces for which memory is reserved.
const MAX_HEAD: usize = 512;

/// A span on which `b = u''` is linear, with its state: one interval of the solver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SolvedSpan {
    pub(crate) span: Span,
    /// `u'^2` at the start.
    pub(crate) a: f64,
    /// `u''` at the start.
    pub(crate) b: f64,
    /// `u'''/u'`.
    pub(crate) c: f64,
}

impl SolvedSpan {
    /// `(u'^2, u'')` at offset `x`.
    pub(crate) fn at(&self, x: f64) -> (f64, f64) {
        (self.a + x * (2.0 * self.b + x * self.c), self.b + x * self.c)
    }

    /// The remainder from offset `x`.
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

/// Where in the last plan a new one starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum ResumePoint {
    /// In the pieces before the segments: index of the piece, and the time in it.
    Head(usize, f64),
    /// In the first stub, at this offset.
    FirstStub(f64),
    /// In the segment with this index, at this offset.
    SolvedSpan(usize, f64),
    /// In the last stub, at this offset.
    LastStub(f64),
}

/// The last plan.
#[derive(Clone, Debug, Default)]
pub(crate) struct WarmStart {
    pub(crate) valid: bool,
    pub(crate) solved_spans: Vec<SolvedSpan>,
    /// Pieces in closed form before the segments: a deceleration to a reduced feed, or the remainder of a
    /// first stub.
    pub(crate) head: Vec<TimeLawPiece>,
    /// The stub before the segments, if any.
    pub(crate) first: Option<Span>,
    /// The stub after them.
    pub(crate) last: Option<Span>,
    /// `u'^2` at the start of the last stub.
    pub(crate) last_a: f64,
    pub(crate) until: u64,
    /// The feed factor of the plan.
    pub(crate) factor: f64,
}

impl WarmStart {
    pub(crate) fn with_capacity(stations: usize) -> Self {
        Self {
            solved_spans: Vec::with_capacity(stations),
            head: Vec::with_capacity(MAX_HEAD),
            ..Self::default()
        }
    }

    /// Drops the plan, keeping the memory.
    pub(crate) fn forget(&mut self) {
        self.solved_spans.clear();
        self.head.clear();
        (self.valid, self.first, self.last) = (false, None, None);
        (self.last_a, self.until, self.factor) = (0.0, 0, 0.0);
    }

    /// Copies a plan, without allocating if the capacity suffices.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        let mut solved_spans = std::mem::take(&mut self.solved_spans);
        solved_spans.clear();
        solved_spans.extend_from_slice(&other.solved_spans);
        let mut head = std::mem::take(&mut self.head);
        head.clear();
        head.extend_from_slice(&other.head);
        *self = Self {
            solved_spans,
            head,
            ..*other
        };
    }

    /// Scales the plan in time, to `rate` times the speed, `0 < rate <= 1`: `u'^2`, `u''` and `u'''/u'` by
    /// distance scale alike.
    pub(crate) fn slow_down(&mut self, rate: f64) {
        let square = rate * rate;
        for solved_span in &mut self.solved_spans {
            solved_span.a *= square;
            solved_span.b *= square;
            solved_span.c *= square;
        }
        for piece in &mut self.head {
            piece.law = piece.law.slowed_down(rate);
            piece.duration_s /= rate;
        }
        self.last_a *= square;
        self.factor *= rate;
    }

    /// Stores a plan; `head` contains the pieces before its window.
    pub(crate) fn keep(
        &mut self,
        head: &[TimeLawPiece],
        window: &Window,
        x: &Iterate,
        until: u64,
        factor: f64,
    ) {
        let n = window.n();
        self.head.clear();
        self.head.extend_from_slice(head);
        self.solved_spans.clear();
        for k in 0..n {
            self.solved_spans.push(SolvedSpan {
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

    /// Finds the position in the plan if the given state is that of the plan there.
    pub(crate) fn find(&self, grid: &Grid, from: PathPosition, v: f64, a: f64) -> Option<ResumePoint> {
        if !self.valid {
            return None;
        }
        let within = |span: &Span| {
            let x = from.x - span.x;
            let slack = 1e-9 * span.length;
            (span.interval == from.interval && x >= -slack && x <= span.length + slack)
                .then_some(x.clamp(0.0, span.length))
        };
        let is_close = |one: f64, other: f64, size: f64| (one - other).abs() <= STATE_TOLERANCE * size;
        for (k, piece) in self.head.iter().enumerate() {
            let (_, begin) = grid.segment_of(piece.interval)?;
            let x = from.x - (piece.from - begin);
            if piece.interval == from.interval && (-1e-9 * piece.length..piece.length).contains(&x) {
                let t = piece.law.time_to(x, piece.duration_s);
                let (start, now, end) = (
                    piece.law.at(0.0).0,
                    piece.law.at(t).0,
                    piece.law.at(piece.duration_s).0,
                );
                let push = start.a.abs().max(end.a.abs());
                let fits = is_close(v, now.v, start.v.max(end.v)) && is_close(a, now.a, push);
                return fits.then_some(ResumePoint::Head(k, t));
            }
        }
        if let Some(first) = &self.first
            && let Some(x) = within(first)
            && x < first.length
        {
            // u = j t^3/6 with v^2 = 3/2 D b at its end.
            let (end_v, end_b) = (self.solved_spans.first()?.a.sqrt(), self.solved_spans.first()?.b);
            let fraction = libm::cbrt(x / first.length);
            let fits =
                is_close(v, end_v * fraction * fraction, end_v) && is_close(a, end_b * fraction, end_b);
            return fits.then_some(ResumePoint::FirstStub(x));
        }
        // At the boundary of two segments the later one, so that the first segment is never empty.
        for (k, solved_span) in self.solved_spans.iter().enumerate() {
            if let Some(x) = within(&solved_span.span)
                && x < solved_span.span.length
            {
                let (square, b) = solved_span.at(x);
                let speed = square.max(0.0).sqrt();
                let push = solved_span
                    .b
                    .abs()
                    .max((solved_span.b + solved_span.c * solved_span.span.length).abs());
                let fits = is_close(v, speed, speed) && is_close(a, b, push);
                return fits.then_some(ResumePoint::SolvedSpan(k, x));
            }
        }
        let last = self.last.as_ref()?;
        let x = within(last)?;
        let start_v = self.last_a.sqrt();
        let start_b = self.last_a / (1.5 * last.length);
        let fraction = libm::cbrt(1.0 - x / last.length);
        let fits =
            is_close(v, start_v * fraction * fraction, start_v) && is_close(-a, start_b * fraction, start_b);
        fits.then_some(ResumePoint::LastStub(x))
    }

    /// The remainder of the segments from index `k`, offset `x`.
    pub(crate) fn remainder(&self, k: usize, x: f64, out: &mut Vec<SolvedSpan>) {
        out.extend_from_slice(&self.solved_spans[k..]);
        if let Some(first) = out.first_mut() {
            *first = first.from(x);
        }
    }

    /// The last stub passed without a stop, in three parts: from its state to zero acceleration at
    /// `u'^2 = level`, where `level` is at most a third of the value at the start of the stub.
    ///
    /// With lengths in stub lengths and `b` relative to its start value, `a` starts with 3/2 and slope -2;
    /// the values of `b` between the parts distribute the decrease `3/2 - level`. Three times the stub's jerk
    /// suffices.
    pub(crate) fn release(span: Span, square: f64, level: f64, out: &mut Vec<SolvedSpan>) {
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
            out.push(SolvedSpan {
                span: part,
                a,
                b: b[k],
                c,
            });
            a += (b[k] + b[k + 1]) * part.length;
        }
    }
}
