//! The path for a picture, with as few points as possible.

/// Maximum number of points.
const MAX_POINTS: usize = 50_000;
/// Initial maximum distance of an omitted point from the line of its neighbours, mm.
const FIRST_TOLERANCE_MM: f64 = 2e-4;
/// Initial maximum number of points that a line may omit.
const FIRST_SKIPS: usize = 24;

/// A point of the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spot {
    pub(crate) position: [f64; 3],
    pub(crate) feed_mm_s: f64,
    pub(crate) error: f64,
    pub(crate) sequence: u64,
    /// Not a cut: a rapid, a jog, homing.
    pub(crate) is_rapid: bool,
}

/// Gathers a path. If it needs too many points, the tolerance doubles.
#[derive(Debug)]
pub(crate) struct Trail {
    kept: Vec<Spot>,
    skipped: Vec<Spot>,
    tolerance_mm: f64,
    skips: usize,
    /// An omitted point must also have about the speed of its neighbours.
    feed_step_mm_s: f64,
}

impl Trail {
    pub(crate) fn new(feed_step_mm_s: f64) -> Self {
        Self {
            kept: Vec::new(),
            skipped: Vec::new(),
            tolerance_mm: FIRST_TOLERANCE_MM,
            skips: FIRST_SKIPS,
            feed_step_mm_s,
        }
    }

    pub(crate) fn push(&mut self, spot: Spot) {
        if !spot.position.iter().all(|value| value.is_finite()) {
            return;
        }
        let Some(anchor) = self.kept.last().copied() else {
            self.kept.push(spot);
            return;
        };
        // Cycles at rest add nothing.
        if self.skipped.last().unwrap_or(&anchor).position == spot.position {
            return;
        }
        let fits = self.skipped.len() < self.skips
            && spot.is_rapid == anchor.is_rapid
            && (spot.feed_mm_s - anchor.feed_mm_s).abs() < self.feed_step_mm_s
            && self.skipped.iter().all(|skipped| {
                off_line(&skipped.position, &anchor.position, &spot.position) <= self.tolerance_mm
            });
        if !fits && let Some(corner) = self.skipped.pop() {
            self.skipped.clear();
            self.kept.push(corner);
            if self.kept.len() >= MAX_POINTS {
                self.thin_out();
            }
        }
        self.skipped.push(spot);
    }

    fn thin_out(&mut self) {
        self.tolerance_mm *= 2.0;
        self.skips *= 2;
        self.feed_step_mm_s *= 1.5;
        let all = std::mem::take(&mut self.kept);
        all.into_iter().for_each(|spot| self.push(spot));
        // If the tolerance alone does not reduce the points enough, more points are skipped.
        if self.kept.len() > MAX_POINTS * 3 / 4 {
            let mut at = 0;
            self.kept.retain(|_| {
                at += 1;
                at % 2 == 1
            });
        }
    }

    pub(crate) fn finish(mut self) -> Vec<Spot> {
        self.kept.extend(self.skipped.pop());
        self.kept
    }
}

/// Distance of a point from a line segment.
fn off_line(point: &[f64; 3], from: &[f64; 3], to: &[f64; 3]) -> f64 {
    let sub = |a: &[f64; 3], b: &[f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let dot = |a: &[f64; 3], b: &[f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (chord, off) = (sub(to, from), sub(point, from));
    let square = dot(&chord, &chord);
    let fraction = if square > 0.0 {
        (dot(&off, &chord) / square).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let rest = [
        off[0] - fraction * chord[0],
        off[1] - fraction * chord[1],
        off[2] - fraction * chord[2],
    ];
    dot(&rest, &rest).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_path_keeps_its_tolerance_with_few_points() {
        let mut trail = Trail::new(1e9);
        let spots: Vec<Spot> = (0..200_000_u64)
            .map(|n| {
                let angle = n as f64 * 1e-3;
                Spot {
                    position: [20.0 * angle.cos(), 20.0 * angle.sin(), angle * 0.1],
                    feed_mm_s: 20.0,
                    error: 0.0,
                    sequence: n,
                    is_rapid: false,
                }
            })
            .collect();
        spots.iter().for_each(|&spot| trail.push(spot));
        let tolerance = 4.0 * trail.tolerance_mm;
        let kept = trail.finish();
        assert!(kept.len() < MAX_POINTS, "{} points", kept.len());
        let mut at = 0;
        for spot in &spots {
            while kept[at + 1].sequence < spot.sequence {
                at += 1;
            }
            let off = off_line(&spot.position, &kept[at].position, &kept[at + 1].position);
            assert!(off <= tolerance, "{off} at {}", spot.sequence);
        }
        assert_eq!((kept[0].sequence, kept[kept.len() - 1].sequence), (0, 199_999));
    }
}
