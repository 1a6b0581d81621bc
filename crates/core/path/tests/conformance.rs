//! Properties of every curve, checked over a gallery of ordinary and degenerate curves.
//!
//! Error budgets scale with magnitude: `scale` is the largest number that enters a curve (coordinates,
//! centre, radius), because no result can be more accurate than the rounding of that number.

use evolvent_path::{Axes, Curve};
use evolvent_random::Random;
use nalgebra::Vector3;

use crate::gallery::{Case, gallery, speed};

const EPS: f64 = f64::EPSILON;

#[test]
fn end_points_are_exact_and_reached_without_a_jump() {
    for Case { name, curve, scale } in gallery() {
        let domain = curve.domain();
        assert_eq!(curve.position(0.0), curve.start(), "{name}");
        assert_eq!(curve.jet(0.0).position, curve.start(), "{name}");
        assert_eq!(curve.position(domain), curve.end(), "{name}");
        assert_eq!(curve.jet(domain).position, curve.end(), "{name}");
        let budget = 64.0 * EPS * scale;
        for (inside, end) in [(domain * EPS, curve.start()), (domain.next_down(), curve.end())] {
            let jump = (curve.position(inside) - end).amax();
            assert!(jump <= budget, "{name}: {jump:e} > {budget:e}");
        }
        assert!(
            (curve.arc_length(domain) - curve.length()).abs() <= 4.0 * EPS * curve.length(),
            "{name}"
        );
        assert_eq!(curve.parameter(curve.length()), domain, "{name}");
    }
}

#[test]
fn jets_are_finite_and_clamped_for_every_parameter() {
    for Case { name, curve, .. } in gallery() {
        for u in [
            -1.0,
            0.0,
            f64::MIN_POSITIVE,
            f64::NAN,
            f64::INFINITY,
            f64::NEG_INFINITY,
            1e308,
        ] {
            assert!(curve.jet(u).is_finite(), "{name} at {u}");
        }
        assert_eq!(curve.position(-1.0), curve.start(), "{name}");
        assert_eq!(curve.position(f64::NAN), curve.start(), "{name}");
        assert_eq!(curve.position(f64::INFINITY), curve.end(), "{name}");
    }
}

/// Central difference of order eight.
fn difference(f: impl Fn(f64) -> Axes, u: f64, h: f64) -> Axes {
    [
        (1.0, 4.0 / 5.0),
        (2.0, -1.0 / 5.0),
        (3.0, 4.0 / 105.0),
        (4.0, -1.0 / 280.0),
    ]
    .into_iter()
    .fold(Axes::zeros(), |sum, (k, weight)| {
        sum + (f(u + k * h) - f(u - k * h)) * (weight / h)
    })
}

#[test]
fn jets_are_the_derivatives_of_position() {
    let seed = 0x5EED_0001;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    for Case { name, curve, scale } in gallery() {
        let domain = curve.domain();
        for _ in 0..40 {
            let u = domain * (0.02 + 0.96 * random.unit());
            let jet = curve.jet(u);
            let ratio = |a: &Axes, b: &Axes| if b.norm() > 0.0 { a.norm() / b.norm() } else { 0.0 };
            let bend = ratio(&jet.second, &jet.first).max(ratio(&jet.third, &jet.second));
            let h = (domain / 400.0).min(0.04 / bend.max(1e-300));
            // At the end of the section near the base circle only three derivatives are continuous: no
            // difference across it.
            if matches!(curve, Curve::Involute(_))
                && is_regular(&curve, u - 4.0 * h) != is_regular(&curve, u + 4.0 * h)
            {
                continue;
            }
            let pairs: [(Axes, Axes, f64); 3] = [
                (difference(|u| curve.position(u), u, h), jet.first, scale),
                (
                    difference(|u| curve.jet(u).first, u, h),
                    jet.second,
                    jet.first.norm(),
                ),
                (
                    difference(|u| curve.jet(u).second, u, h),
                    jet.third,
                    jet.second.norm(),
                ),
            ];
            for (order, (measured, given, magnitude)) in pairs.into_iter().enumerate() {
                let error = (measured - given).amax();
                let budget = 2e-8 * given.norm() + 100.0 * EPS * magnitude / h;
                assert!(
                    error <= budget,
                    "{name}, order {}, u {u}: {error:e} > {budget:e}",
                    order + 1
                );
            }
        }
    }
}

#[test]
fn tangents_by_arc_length_are_unit_vectors() {
    for Case { name, curve, scale } in gallery() {
        for i in 1..50 {
            let jet = curve.at(curve.length() * f64::from(i) / 50.0);
            let error = (speed(&jet.first) - 1.0).abs();
            // An end point rounded to the grid changes the length by the same relative amount.
            let budget = 64.0 * EPS * (1.0 + scale / curve.length());
            assert!(error <= budget, "{name}: {error:e} > {budget:e}");
            assert!((speed(&jet.first) - 1.0).abs() < 1e-6, "{name}");
        }
    }
}

/// Whether the regular parameter is arc length here.
fn is_regular(curve: &Curve, u: f64) -> bool {
    (speed(&curve.jet(u).first) - 1.0).abs() < 1e-9
}

/// The parameters between which the speed is analytic: the ends and, on involutes, the end of the section
/// near the base circle.
fn analytic_pieces(curve: &Curve) -> Vec<f64> {
    let (mut low, mut high) = (0.0, curve.domain());
    let first = is_regular(curve, low);
    if !matches!(curve, Curve::Involute(_)) || first == is_regular(curve, high) {
        return vec![low, high];
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if is_regular(curve, middle) == first {
            low = middle;
        } else {
            high = middle;
        }
    }
    vec![0.0, low, curve.domain()]
}

#[test]
fn arc_length_is_the_integral_of_speed() {
    // Composite five-point Gauss-Legendre rule, independent of the crate's rule.
    let nodes = [
        (0.0, 128.0 / 225.0),
        (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
        (0.906_179_845_938_664, 0.236_926_885_056_189_08),
    ];
    for Case { name, curve, scale } in gallery() {
        let mut sum = 0.0;
        for ends in analytic_pieces(&curve).windows(2) {
            let half = 0.5 * (ends[1] - ends[0]) / 200.0;
            for piece in 0..200 {
                let middle = ends[0] + half * f64::from(2 * piece + 1);
                for (x, weight) in nodes {
                    let both = [middle - x * half, middle + x * half].map(|u| speed(&curve.jet(u).first));
                    sum += weight * half * if x == 0.0 { both[0] } else { both[0] + both[1] };
                }
                let u = middle + half;
                let error = (curve.arc_length(u) - sum).abs();
                let budget = 1e-12 * sum + 32.0 * EPS * scale;
                assert!(error <= budget, "{name} at {u}: {error:e} > {budget:e}");
            }
        }
    }
}

#[test]
fn parameter_inverts_arc_length() {
    for Case { name, curve, .. } in gallery() {
        let length = curve.length();
        for i in 0..=64 {
            // Quadratic spacing, to sample densely near base circles.
            let s = length * (f64::from(i) / 64.0).powi(2);
            let error = (curve.arc_length(curve.parameter(s)) - s).abs();
            assert!(error <= 1e-12 * length, "{name} at {s}: {error:e}");
        }
    }
}

#[test]
fn at_and_jet_describe_the_same_point() {
    for Case { name, curve, scale } in gallery() {
        for i in 1..20 {
            let s = curve.length() * f64::from(i) / 20.0;
            let (by_s, by_u) = (curve.at(s), curve.jet(curve.parameter(s)).by_arc_length());
            assert!(
                (by_s.position - by_u.position).amax() <= 64.0 * EPS * scale,
                "{name}"
            );
            for (a, b) in [
                (by_s.first, by_u.first),
                (by_s.second, by_u.second),
                (by_s.third, by_u.third),
            ] {
                let budget = 1e-9 * b.norm() + 64.0 * EPS * scale / curve.length() * (1.0 + b.norm());
                assert!((a - b).amax() <= budget, "{name} at {s}: {a} {b}");
            }
        }
    }
}

#[test]
fn reversing_twice_gives_the_same_curve() {
    for Case { name, curve, scale } in gallery() {
        let back = curve.reversed();
        let again = back.reversed();
        assert_eq!((back.start(), back.end()), (curve.end(), curve.start()), "{name}");
        assert_eq!(back.sense(), curve.sense().reversed(), "{name}");
        let budget = 64.0 * EPS * scale;
        for i in 0..=40 {
            let u = curve.domain() * f64::from(i) / 40.0;
            let error = (back.position(curve.domain() - u) - curve.position(u)).amax();
            assert!(error <= budget, "{name}: {error:e} > {budget:e}");
            let error = (again.position(u) - curve.position(u)).amax();
            assert!(error <= budget, "{name}, twice: {error:e}");
            let turned = back.jet(curve.domain() - u).first + curve.jet(u).first;
            assert!(turned.amax() <= 1e-9 * (1.0 + scale / curve.length()), "{name}");
        }
    }
}

#[test]
fn bounds_contain_every_point_and_are_tight() {
    let seed = 0x5EED_0002;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    for Case { name, curve, scale } in gallery() {
        for _ in 0..12 {
            let (a, b) = (random.unit() * curve.domain(), random.unit() * curve.domain());
            let (low, high) = curve.bounds(a, b);
            let samples = 4000;
            let (mut min, mut max) = (curve.position(a), curve.position(a));
            let mut step2 = 0.0f64;
            let step = (b - a).abs() / f64::from(samples);
            for i in 0..=samples {
                let jet = curve.jet(a.min(b) + step * f64::from(i));
                min = min.inf(&jet.position);
                max = max.sup(&jet.position);
                step2 = step2.max(jet.second.amax() * step * step / 8.0);
            }
            let rounding = 64.0 * EPS * scale;
            for i in 0..9 {
                assert!(
                    low[i] <= min[i] + rounding && high[i] >= max[i] - rounding,
                    "{name}: axis {i}"
                );
                let slack = 1.01 * step2 + rounding;
                assert!(
                    min[i] - low[i] <= slack && high[i] - max[i] <= slack,
                    "{name}: axis {i} not tight"
                );
            }
        }
    }
}

#[test]
fn derivative_bounds_hold_and_are_tight() {
    let seed = 0x5EED_0003;
    println!("seed {seed:#x}");
    let mut random = Random::from_state(seed);
    for Case { name, curve, .. } in gallery() {
        for round in 0..60 {
            let a = random.unit() * curve.domain();
            let short = round % 2 == 0;
            let b = if short {
                (a + 1e-5 * curve.domain()).min(curve.domain())
            } else {
                random.unit() * curve.domain()
            };
            let (d1, d2, d3) = curve.derivative_bounds(a, b);
            let bend = curve.curvature_bound(a, b);
            let mut seen = [Axes::zeros(); 3];
            let mut bent = 0.0f64;
            for i in 0..=200 {
                let jet = curve.jet(a + (b - a) * f64::from(i) / 200.0);
                for (max, derivative) in seen.iter_mut().zip([jet.first, jet.second, jet.third]) {
                    *max = max.sup(&derivative.abs());
                }
                bent = bent.max(jet.curvature());
            }
            for (order, (bound, max)) in [d1, d2, d3].iter().zip(seen).enumerate() {
                let rounding = 1e-12 * max.amax() + f64::MIN_POSITIVE;
                for i in 0..9 {
                    assert!(
                        bound[i] >= max[i] - rounding,
                        "{name}: order {} axis {i} {bound} {max}",
                        order + 1
                    );
                    let loose = bound[i] - max[i];
                    assert!(
                        !short || loose <= 0.02 * max.amax() + rounding,
                        "{name}: order {} axis {i} loose",
                        order + 1
                    );
                }
            }
            assert!(bend >= bent * (1.0 - 1e-9), "{name}: curvature {bend} < {bent}");
            assert!(
                !short || bend <= bent * 1.02 + 1e-12,
                "{name}: curvature {bend} loose against {bent}"
            );
        }
    }
}

#[test]
fn curvature_agrees_with_finite_differences() {
    for Case { name, curve, .. } in gallery() {
        // Where coordinates are coarse compared with the radius, differences show only rounding.
        if matches!(
            name,
            "1 um at 1e5 mm" | "involute of 100 km" | "blend of rotary axes"
        ) {
            continue;
        }
        let length = curve.length();
        for i in 3..10 {
            let s = length * f64::from(i) / 12.0;
            let h = 1e-4 * length;
            let turn: Vector3<f64> = (curve.tangent(s + h) - curve.tangent(s - h)) / (2.0 * h);
            let k = curve.curvature(s);
            // Second-order difference over an angle of k h.
            let budget = k * ((k * h).powi(2) + 1e-5) + 1e-9;
            assert!((turn.norm() - k).abs() <= budget, "{name}: {} {k}", turn.norm());
            let change = (curve.curvature(s + h) - curve.curvature(s - h)) / (2.0 * h);
            let dk = curve.curvature_derivative(s);
            assert!(
                (change - dk).abs() <= 1e-4 * dk.abs() + 1e-9 * k / h + 1e-9,
                "{name}: {change} {dk}"
            );
        }
    }
}
