//! The path reduced to few points within a tolerance.
//!
//! A setpoint is kept where the path leaves a strip around its direction at the last kept point, where it
//! reverses, or where its colour changes. All omitted points are within two tolerances of the drawn path.
//! When there are too many points, the tolerance is doubled and the points are reduced again.

/// A point, and the colours of the section that begins at it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct TrailPoint {
    pub(crate) position: [f64; 3],
    /// Path speed, mm/s; `None` on rapids.
    pub(crate) feed: Option<f64>,
    /// Index of a `Limiting`.
    pub(crate) cause: u8,
}

impl TrailPoint {
    fn colour(&self) -> (Option<u8>, u8) {
        // Feeds of one colour differ by less than a twelfth: 12 colours cover at least a factor of 2.
        let step = |feed: f64| (8.0 * feed.max(1e-3).log2() + 80.0).clamp(0.0, 255.0) as u8;
        (self.feed.map(step), self.cause)
    }
}

/// Reduces the path.
#[derive(Debug)]
pub(crate) struct Trail {
    points: Vec<TrailPoint>,
    max_points: usize,
    tolerance: f64,
    direction: Option<[f64; 3]>,
    reach: f64,
    latest: Option<TrailPoint>,
}

impl Trail {
    /// A trail of at most `max_points` points, and not fewer than 8; `tolerance`, above zero, is the initial one.
    pub(crate) fn new(max_points: usize, tolerance: f64) -> Self {
        Self {
            points: Vec::with_capacity(max_points.max(8)),
            max_points: max_points.max(8),
            tolerance,
            direction: None,
            reach: 0.0,
            latest: None,
        }
    }

    /// The points kept, and the last one seen.
    pub(crate) fn points(&self) -> Vec<TrailPoint> {
        let mut points = self.points.clone();
        points.extend(self.latest);
        points
    }

    /// Maximum deviation of the drawn path, mm.
    pub(crate) fn tolerance(&self) -> f64 {
        2.0 * self.tolerance
    }

    pub(crate) fn see(&mut self, point: TrailPoint) {
        if !point.position.iter().all(|x| x.is_finite()) {
            return;
        }
        self.add(point);
        while self.points.len() > self.max_points {
            self.tolerance *= 2.0;
            let old = std::mem::take(&mut self.points);
            let latest = self.latest.take();
            self.points.reserve(self.max_points);
            for point in old.into_iter().chain(latest) {
                self.add(point);
            }
        }
    }

    fn add(&mut self, point: TrailPoint) {
        let Some(anchor) = self.points.last().copied() else {
            self.keep(point);
            return;
        };
        let chord = minus(point.position, anchor.position);
        let far = dot(chord, chord).sqrt();
        if point.colour() != anchor.colour() && far >= self.tolerance {
            self.keep(point);
            return;
        }
        match self.direction {
            None if far >= 4.0 * self.tolerance => {
                self.direction = Some(chord.map(|x| x / far));
                self.reach = far;
            }
            None => {}
            Some(direction) => {
                let along = dot(chord, direction);
                let beside = (far * far - along * along).max(0.0).sqrt();
                if beside > self.tolerance || along < self.reach - self.tolerance {
                    if let Some(latest) = self.latest.take() {
                        self.keep(TrailPoint {
                            cause: anchor.cause,
                            feed: anchor.feed,
                            ..latest
                        });
                        self.add(point);
                    }
                    return;
                }
                self.reach = self.reach.max(along);
            }
        }
        self.latest = Some(point);
    }

    fn keep(&mut self, point: TrailPoint) {
        self.points.push(point);
        self.latest = None;
        self.direction = None;
        self.reach = 0.0;
    }
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, y: f64) -> TrailPoint {
        TrailPoint {
            position: [x, y, 0.0],
            feed: Some(10.0),
            cause: 0,
        }
    }

    /// Distance from a section.
    fn off(p: [f64; 3], a: [f64; 3], b: [f64; 3]) -> f64 {
        let (chord, to) = (minus(b, a), minus(p, a));
        let fraction = (dot(chord, to) / dot(chord, chord).max(1e-300)).clamp(0.0, 1.0);
        let rest = minus(to, chord.map(|x| x * fraction));
        dot(rest, rest).sqrt()
    }

    #[test]
    fn a_long_path_stays_within_the_stated_tolerance() {
        // A spiral of 60 turns, a zigzag with reversals, and back: 100 000 points on 500.
        let path: Vec<[f64; 3]> = (0..100_000)
            .map(|k| {
                let t = f64::from(k) * 1e-5;
                let angle = 60.0 * std::f64::consts::TAU * t;
                if k % 1000 < 900 {
                    [40.0 * t * angle.cos(), 40.0 * t * angle.sin(), t]
                } else {
                    [40.0 * (angle * 7.0).sin(), 0.0, t]
                }
            })
            .collect();
        let mut trail = Trail::new(500, 1e-6);
        for &position in &path {
            trail.see(TrailPoint {
                position,
                ..point(0.0, 0.0)
            });
        }
        let drawn = trail.points();
        assert!(drawn.len() <= 501, "{}", drawn.len());
        for p in &path {
            let nearest = drawn
                .windows(2)
                .map(|pair| off(*p, pair[0].position, pair[1].position))
                .fold(f64::INFINITY, f64::min);
            assert!(nearest <= trail.tolerance(), "{nearest} at {p:?}");
        }
    }

    #[test]
    fn a_square_keeps_corners_and_its_sides_few_points() {
        let mut trail = Trail::new(100, 1e-6);
        for side in 0..4 {
            for k in 0..10_000 {
                let t = f64::from(k) * 1e-3;
                let (x, y) = [(t, 0.0), (10.0, t), (10.0 - t, 10.0), (0.0, 10.0 - t)][side];
                trail.see(point(x, y));
            }
        }
        assert!(trail.points().len() <= 12 && trail.tolerance() < 1e-5);
        for corner in [(10.0, 0.0), (10.0, 10.0), (0.0, 10.0)] {
            let found = trail
                .points()
                .iter()
                .any(|p| (p.position[0] - corner.0).abs() < 2e-3 && (p.position[1] - corner.1).abs() < 2e-3);
            assert!(found, "{corner:?}");
        }
    }

    #[test]
    fn a_stretch_of_another_colour_on_a_line_is_kept() {
        let mut trail = Trail::new(100, 1e-6);
        for k in 0..1000 {
            let cause = u8::from((400..420).contains(&k));
            trail.see(TrailPoint {
                cause,
                ..point(f64::from(k), 0.0)
            });
        }
        let points = trail.points();
        let from = points.iter().position(|p| p.cause == 1).unwrap();
        assert_eq!(points[from].position[0], 400.0);
        assert_eq!(points[from + 1].position[0], 420.0);
    }
}
