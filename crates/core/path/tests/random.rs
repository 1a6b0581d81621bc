//! Random input of every magnitude gives a curve or an error, and every curve evaluates without a panic.

use evolvent_path::{Arc, Axes, Blend, Curve, Involute, Jet, Line, Plane, Sense};
use evolvent_random::Random;

/// Numbers of any magnitude.
trait AnyMagnitude {
    fn number(&mut self) -> f64;
    fn axes(&mut self) -> Axes;
}

impl AnyMagnitude for Random {
    /// A number of any magnitude, of both signs, sometimes a special value.
    fn number(&mut self) -> f64 {
        match self.bits() % 40 {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => f64::from_bits(self.bits()),
            3..=9 => 0.0,
            _ => {
                let magnitude = 10f64.powf(self.unit() * 20.0 - 11.0);
                if self.bits().is_multiple_of(2) {
                    magnitude
                } else {
                    -magnitude
                }
            }
        }
    }

    fn axes(&mut self) -> Axes {
        Axes::from_fn(|_, _| {
            if self.bits().is_multiple_of(3) {
                self.number()
            } else {
                0.0
            }
        })
    }
}

fn check(curve: Curve, random: &mut Random, what: &str) {
    let (length, domain) = (curve.length(), curve.domain());
    assert!(
        length > 0.0 && length.is_finite() && domain > 0.0 && domain.is_finite(),
        "{what}"
    );
    assert_eq!(curve.jet(0.0).position, curve.start(), "{what}");
    assert_eq!(curve.jet(domain).position, curve.end(), "{what}");
    for _ in 0..8 {
        let (a, b) = (random.unit() * domain, random.unit() * domain);
        assert!(curve.jet(a).is_finite(), "{what} at {a}: {:?}", curve.jet(a));
        let (low, high) = curve.bounds(a, b);
        let position = curve.position(a);
        let slack = 1e-9 * (position.amax() + length);
        assert!(
            (0..9).all(|i| low[i] <= position[i] + slack && high[i] >= position[i] - slack),
            "{what}"
        );
        let bounds = curve.derivative_bounds(a, b);
        for bound in [bounds.0, bounds.1, bounds.2] {
            assert!(
                bound.iter().all(|value| value.is_finite() && *value >= 0.0),
                "{what}"
            );
        }
        assert!(curve.curvature_bound(a, b) >= 0.0, "{what}");
        let s = curve.arc_length(a);
        assert!(
            (0.0..=length * (1.0 + 1e-12)).contains(&s),
            "{what}: {s} of {length}"
        );
        assert!((0.0..=domain).contains(&curve.parameter(s)), "{what}");
    }
    let back = curve.reversed();
    assert_eq!((back.start(), back.end()), (curve.end(), curve.start()), "{what}");
}

#[test]
fn random_input_gives_a_valid_curve_or_an_error() {
    let seed = 0x5EED_0004;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    let mut built = [0; 5];
    for _ in 0..40_000 {
        let plane = [Plane::Xy, Plane::Zx, Plane::Yz][(random.bits() % 3) as usize];
        let sense =
            [Sense::Clockwise, Sense::CounterClockwise, Sense::Straight][(random.bits() % 3) as usize];
        let (start, end) = (random.axes(), random.axes());
        let centre = [random.number(), random.number()];
        if let Ok(line) = Line::new(start, end) {
            built[0] += 1;
            check(line.into(), &mut random, &format!("line {start:?} {end:?}"));
        }
        let turns = (random.bits() % 5) as u32;
        if let Ok(arc) = Arc::new(plane, start, end, centre, sense, turns) {
            built[1] += 1;
            let what = format!("arc {plane:?} {start:?} {end:?} {centre:?} {sense:?} {turns}");
            check(arc.into(), &mut random, &what);
        }
        let (radius, tolerance) = (random.number(), random.number());
        if let Ok(involute) = Involute::new(plane, start, end, centre, radius, sense, tolerance) {
            built[2] += 1;
            check(involute.into(), &mut random, "random involute");
        }
        // A valid involute of random position and size.
        let (r, from, span) = (
            radius.abs(),
            20.0 * random.unit().powi(6),
            300.0 * random.unit().powi(4),
        );
        let point = |phi: f64| {
            let (first, second, _) = plane.axes();
            let mut axes = start;
            axes[first] = centre[0] + r * (phi.cos() + phi * phi.sin());
            axes[second] = centre[1] + r * (phi.sin() - phi * phi.cos());
            axes
        };
        let ends = (point(from), point(from + span));
        let sound = Involute::new(plane, ends.0, ends.1, centre, r, Sense::CounterClockwise, 1e-3);
        if let Ok(involute) = sound {
            built[3] += 1;
            let what = format!("involute {plane:?} {centre:?} {r} {from} {span} {start:?}");
            check(involute.into(), &mut random, &what);
        }
        let jets = [start, end].map(|position| Jet {
            first: random.axes(),
            second: random.axes(),
            ..Jet::at_rest(position)
        });
        if built[4] < 400
            && let Ok(blend) = Blend::hermite(&jets[0], &jets[1], random.number())
        {
            built[4] += 1;
            check(blend.into(), &mut random, &format!("blend {jets:?}"));
        }
    }
    println!("built {built:?}");
    assert!(
        [0, 1, 3].into_iter().all(|kind| built[kind] > 1000) && built[4] > 20,
        "{built:?}"
    );
}

/// Lines, circles, helices and arcs whose radius grows: a part has the points of the whole, and adjacent
/// parts join.
#[test]
fn a_part_of_a_line_or_an_arc_lies_on_it() {
    let mut random = Random::seeded(47);
    for _ in 0..2000 {
        let random_point =
            |random: &mut Random| Axes::from_fn(|i, _| if i < 3 { random.unit() * 80.0 - 40.0 } else { 0.0 });
        let (start, end) = (random_point(&mut random), random_point(&mut random));
        let centre = [random.unit() * 60.0 - 30.0, random.unit() * 60.0 - 30.0];
        let sense = if random.bits().is_multiple_of(2) {
            Sense::Clockwise
        } else {
            Sense::CounterClockwise
        };
        let turns = (random.bits() % 3) as u32;
        let curve = if random.bits().is_multiple_of(3) {
            Line::new(start, end).map(Curve::from)
        } else {
            Arc::new(Plane::Xy, start, end, centre, sense, turns).map(Curve::from)
        };
        let Ok(curve) = curve else { continue };
        let length = curve.length();
        let (a, b) = (random.unit() * length, random.unit() * length);
        let (from, to) = (a.min(b), a.max(b));
        assert!(curve.part(to, from).is_none() && curve.part(from, from).is_none());
        let part = curve.part(from, to).unwrap();
        assert!((part.length() - (to - from)).abs() < 1e-9 * length, "{curve:?}");
        for k in 0..=7 {
            let s = (to - from) * f64::from(k) / 7.0;
            let off = (part.at(s).position - curve.at(from + s).position).norm();
            assert!(off < 1e-9 * (length + 100.0), "{off} at {s} of {curve:?}");
        }
        let whole = curve.part(0.0, length).unwrap();
        assert_eq!((whole.start(), whole.end()), (curve.start(), curve.end()));
        let rest = curve.part(to, length).unwrap_or(whole);
        assert_eq!(rest.end(), curve.end());
    }
}
