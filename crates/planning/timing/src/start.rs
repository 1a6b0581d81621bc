//! Feasible motions from which the solver starts.

use crate::barrier::Iterate;
use crate::limits::PathLimits;
use crate::stub::Stub;
use crate::warm_start::SolvedSpan;
use crate::window::Window;

/// Length over which the acceleration fades between the stub and the slow motion, in stub lengths.
pub(crate) const FADE: f64 = 20.0;
/// Fraction of the permitted `u'^2` at which the first slow motion is tried.
const CRAWL_FRACTION: f64 = 0.3;

/// The fading factor of the acceleration at distance `x` from a stub, over `length` but at most 45 % of
/// `total`.
fn fade(x: f64, length: f64, available: f64) -> f64 {
    let reach = length.min(0.45 * available);
    if x < reach {
        let left = 1.0 - x / reach;
        left * left
    } else {
        0.0
    }
}

/// Sets the stations on `segments`, which the window may divide further. Returns the index of the first
/// station after them, which has the state of their end.
pub(crate) fn fill(window: &Window, solved_spans: &[SolvedSpan], x: &mut Iterate) -> usize {
    let (mut k, n) = (0, window.n());
    for solved_span in solved_spans {
        let mut at = 0.0;
        while at < solved_span.span.length * (1.0 - 1e-9) && k < n {
            (x.a[k], x.b[k]) = solved_span.at(at);
            x.c[k] = solved_span.c;
            at += window.d[k];
            k += 1;
        }
        (x.a[k], x.b[k]) = solved_span.at(solved_span.span.length);
    }
    k
}

/// Sets the stations from `first` to a slow motion at `u'^2 = level` that decelerates over this many lengths
/// of the last stub. The state at `first` is `level` with zero acceleration, unless `first` is the last
/// station but one.
pub(crate) fn crawl_to_end(window: &Window, first: usize, level: f64, lengths: f64, x: &mut Iterate) {
    let n = window.n();
    let available: f64 = window.d[first..].iter().sum();
    let stub = window.end.length;
    // From the end: the shape of b at the stations, and twice its integral.
    let (mut twice, mut at) = (0.0, 0.0);
    x.b[n] = 1.0;
    for k in (first..n).rev() {
        at += window.d[k];
        x.b[k] = if k == first {
            0.0
        } else {
            fade(at, lengths * stub, available)
        };
        twice += (x.b[k] + x.b[k + 1]) * window.d[k];
    }
    let beta = level / (1.5 * stub + twice);
    x.a[n] = 1.5 * stub * beta;
    for k in first..=n {
        x.b[k] *= -beta;
    }
    for k in (first..n).rev() {
        x.c[k] = (x.b[k + 1] - x.b[k]) / window.d[k];
        x.a[k] = x.a[k + 1] - (x.b[k] + x.b[k + 1]) * window.d[k];
    }
}

/// Sets all stations to a slow motion from rest to rest at `u'^2 = level`.
pub(crate) fn feasible_start(window: &Window, level: f64, x: &mut Iterate) {
    let n = window.n();
    let total: f64 = window.d.iter().sum();
    let (mut from_start, mut from_end) = (window.start.length, window.end.length);
    let (mut up, mut down) = (1.5 * from_start, 1.5 * from_end);
    let (start, end) = (from_start, from_end);
    let mut at = 0.0;
    let shapes = |at: f64, k: usize| {
        let s = if k == 0 {
            1.0
        } else if k == n {
            0.0
        } else {
            fade(at, FADE * start, total)
        };
        let e = if k == n {
            1.0
        } else if k == 0 {
            0.0
        } else {
            fade(total - at, FADE * end, total)
        };
        (s, e)
    };
    for k in 0..n {
        let (s0, e0) = shapes(at, k);
        at += window.d[k];
        let (s1, e1) = shapes(at, k + 1);
        up += (s0 + s1) * window.d[k];
        down += (e0 + e1) * window.d[k];
    }
    (from_start, from_end) = (level / up, level / down);
    at = 0.0;
    for k in 0..=n {
        let (s, e) = shapes(at, k);
        x.b[k] = from_start * s - from_end * e;
        if k < n {
            at += window.d[k];
        }
    }
    x.a[0] = 1.5 * start * x.b[0];
    for k in 0..n {
        x.c[k] = (x.b[k + 1] - x.b[k]) / window.d[k];
        x.a[k + 1] = x.a[k] + (x.b[k] + x.b[k + 1]) * window.d[k];
    }
    // The last state must be on the stub's line exactly, but rounding grows along the path.
    x.a[n] = -1.5 * end * x.b[n];
}

/// The `u'^2` of the first slow motion that is tried.
pub(crate) fn crawl_level(window: &Window, first: usize, limits: &PathLimits) -> f64 {
    (first..window.n())
        .map(|k| window.steady(k, limits))
        .fold(f64::INFINITY, f64::min)
        * CRAWL_FRACTION
}

/// The initial guess of a motion: `u'^2` at the stations, and the length over which the speed may change
/// significantly there.
#[derive(Clone, Debug, Default)]
pub(crate) struct InitialGuess {
    pub(crate) a: Vec<f64>,
    pub(crate) length: Vec<f64>,
}

impl InitialGuess {
    pub(crate) fn with_capacity(stations: usize) -> Self {
        Self {
            a: Vec::with_capacity(stations + 1),
            length: Vec::with_capacity(stations + 1),
        }
    }
}

/// Fraction of the permitted constant `u'^2` that the initial guess has.
const STEADY_FRACTION: f64 = 0.6;
/// Growth of `u'^2` along the path: fractions of acceleration and of the root of jerk.
const GUIDE_GROWTH: (f64, f64) = (0.6, 0.7);

/// A continuous speed of about half of what the path permits: at each station the minimum of the permitted
/// constant speed and of what is reachable from the neighbours.
pub(crate) fn initial_guess(window: &Window, limits: &PathLimits, x: &Iterate, out: &mut InitialGuess) {
    let n = window.n();
    let axes = limits.axes();
    out.a.clear();
    out.length.clear();
    let mut growths = std::mem::take(&mut out.length);
    // Along the tangent: acceleration and the root of jerk, for the intervals before and after a station.
    let tangential = |k: usize, point: usize| {
        let first = &window.cells[window.span_index(k)].points[point].first;
        (
            axes.acceleration_along(first).min(1e30),
            axes.jerk_along(first).min(1e30),
        )
    };
    let stub = |end: Stub| 0.75 * end.length * end.max_b;
    for k in 0..=n {
        let before = k
            .checked_sub(1)
            .map_or(f64::INFINITY, |k| window.steady(k, limits));
        let behind = if k < n {
            window.steady(k, limits)
        } else {
            f64::INFINITY
        };
        out.a
            .push(STEADY_FRACTION * before.min(behind).min(window.cap[k]));
    }
    out.a[n] = out.a[n].min(stub(window.end));
    out.a[0] = if window.from_rest {
        out.a[0].min(stub(window.start))
    } else {
        x.a[0]
    };
    let grown = |a: f64, k: usize| {
        let (acceleration, jerk) = tangential(k, 1);
        a + window.d[k] * (GUIDE_GROWTH.0 * acceleration).min(GUIDE_GROWTH.1 * a.sqrt().sqrt() * jerk.sqrt())
    };
    for k in 0..n {
        out.a[k + 1] = out.a[k + 1].min(grown(out.a[k], k));
    }
    for k in (0..n).rev() {
        out.a[k] = out.a[k].min(grown(out.a[k + 1], k));
    }
    for k in 0..=n {
        let (acceleration, jerk) = tangential(k.min(n - 1), if k < n { 0 } else { 2 });
        let a = out.a[k];
        growths.push((a / acceleration).max(a.sqrt() * a.sqrt().sqrt() / jerk.sqrt()));
    }
    out.length = growths;
}
