//! Stability lobes compared with simulations of the delay equation in fixed steps.

use evolvent_chatter::{ChatterKind, MillingDelay};

use crate::common::near;
use crate::published_cuts::{insperger, mill_of, stiffness_n_m};

/// The mill of Insperger and Stepan in fixed steps: its deflection at 16 positions per tooth, for the last 40
/// teeth of 160, and its oscillations in that time.
fn stepped(immersion: f64, rpm: f64, depth_m: f64) -> (Vec<[f64; 16]>, f64) {
    const STEPS: usize = 1600;
    let omega = std::f64::consts::TAU * 922.0;
    let (ratio, mass) = (0.011, 0.03993);
    let entry = f64::acos(2.0 * immersion - 1.0);
    let tooth_s = 60.0 / rpm / 2.0;
    let h = tooth_s / STEPS as f64;
    // From entry on; teeth are half a turn apart.
    let factor = |part: f64| {
        let angle = entry + std::f64::consts::PI * part;
        if angle > std::f64::consts::PI {
            return 0.0;
        }
        (6e8 * f64::cos(angle) + 2e8 * f64::sin(angle)) * f64::sin(angle)
    };
    let mut past = vec![0.0_f64; STEPS + 1];
    let (mut q, mut v) = (1e-6, 0.0);
    let (mut samples, mut crossings) = (Vec::new(), 0);
    for tooth in 0..160 {
        let mut now = Vec::with_capacity(STEPS + 1);
        let mut sample = [0.0; 16];
        for k in 0..STEPS {
            now.push(q);
            if k % (STEPS / 16) == 0 {
                sample[k / (STEPS / 16)] = q;
            }
            let rate = |part: f64, q: f64, v: f64| {
                let old = past[k] + part * (past[k + 1] - past[k]);
                let cut = depth_m * factor((k as f64 + part) / STEPS as f64) * (q - old);
                (v, -omega * omega * q - 2.0 * ratio * omega * v - cut / mass)
            };
            let a = rate(0.0, q, v);
            let b = rate(0.5, q + 0.5 * h * a.0, v + 0.5 * h * a.1);
            let c = rate(0.5, q + 0.5 * h * b.0, v + 0.5 * h * b.1);
            let d = rate(1.0, q + h * c.0, v + h * c.1);
            let next = q + h / 6.0 * (a.0 + 2.0 * (b.0 + c.0) + d.0);
            v += h / 6.0 * (a.1 + 2.0 * (b.1 + c.1) + d.1);
            if tooth >= 120 && q < 0.0 && next >= 0.0 {
                crossings += 1;
            }
            q = next;
        }
        now.push(q);
        past = now;
        if tooth >= 120 {
            samples.push(sample);
        }
    }
    (samples, f64::from(crossings) / (40.0 * tooth_s))
}

/// A simulation without multipliers shows whether every second tooth cuts alike, and the frequency of the
/// vibration.
#[test]
fn flip_and_hopf_limits_are_those_of_a_simulation() {
    let (mut flips, mut hopfs) = (0, 0);
    for (immersion, rpm) in [
        (0.05, 18_600.0),
        (0.05, 19_500.0),
        (0.1, 19_000.0),
        (0.1, 14_000.0),
        (0.5, 9_000.0),
        (0.5, 16_000.0),
        (0.05, 11_300.0),
    ] {
        let delay = MillingDelay::milling(&insperger(immersion), rpm).unwrap();
        let limit = delay.limit(0.05).unwrap().unwrap();
        let at_limit = delay.chatter(limit).unwrap();
        near(at_limit.multiplier.norm(), 1.0, 1e-6, "multiplier at the limit");
        let beyond = delay.chatter(1.02 * limit).unwrap();
        let (samples, frequency) = stepped(immersion, rpm, 1.02 * limit);
        // Fits x(n + 2) = a x(n + 1) + b x(n), whose roots are the largest pair.
        let (mut xx, mut xy, mut yy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0);
        let scale = |n: usize| samples[n].iter().fold(0.0_f64, |max, x| max.max(x.abs()));
        for n in 0..samples.len() - 2 {
            for ((x, y), z) in samples[n].iter().zip(&samples[n + 1]).zip(&samples[n + 2]) {
                let [x, y, z] = [x, y, z].map(|value| value / scale(n));
                (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
                (xz, yz) = (xz + x * z, yz + y * z);
            }
        }
        let what = format!("immersion {immersion}, {rpm} rpm: {at_limit:?}, simulated {frequency} Hz");
        match at_limit.kind {
            ChatterKind::Flip => {
                flips += 1;
                // One tooth to the next: -1.
                near(xy / xx, beyond.multiplier.re, 5e-3, &what);
            }
            ChatterKind::Hopf => {
                hopfs += 1;
                let determinant = xx * yy - xy * xy;
                let (a, b) = (
                    (yz * xx - xz * xy) / determinant,
                    (xz * yy - yz * xy) / determinant,
                );
                near(f64::sqrt(-b), beyond.multiplier.norm(), 5e-3, &what);
                let cosine = a / (2.0 * f64::sqrt(-b));
                let expected = beyond.multiplier.re / beyond.multiplier.norm();
                assert!(
                    (cosine - expected).abs() < 0.02,
                    "{what}: {cosine} for {expected}"
                );
            }
            ChatterKind::Fold => panic!("{what}"),
        }
        // Of the frequencies that the multiplier permits, the dominant one.
        let tooth_hz = rpm / 30.0;
        assert!(
            (at_limit.frequency_hz - frequency).abs() < 0.3 * tooth_hz,
            "{what}"
        );
    }
    assert!(flips >= 2 && hopfs >= 2, "{flips} flip, {hopfs} Hopf");
}

/// The factor by which an impulse on [`mill_of`] grows from tooth to tooth, averaged over the last half of
/// `teeth`: the delay equation in fixed steps of 1/60 wave.
fn growth(frequency_hz: f64, immersion: f64, rpm: f64, depth_m: f64, teeth: usize) -> f64 {
    let omega = std::f64::consts::TAU * frequency_hz;
    let stiffness = stiffness_n_m();
    let entry = f64::acos(2.0 * immersion - 1.0);
    let tooth_s = 30.0 / rpm;
    let steps = (tooth_s * frequency_hz * 60.0).ceil() as usize;
    let h = tooth_s / steps as f64;
    let drive = |part: f64| {
        let angle = entry + std::f64::consts::PI * part;
        if angle > std::f64::consts::PI {
            return 0.0;
        }
        let (c, s) = (f64::cos(angle), f64::sin(angle));
        depth_m * (6e8 * c + 2e8 * s) * s * omega * omega / stiffness
    };
    let mut past: Vec<f64> = (0..=steps).map(|k| f64::cos(omega * k as f64 * h)).collect();
    let (mut q, mut v) = (1.0, 0.0);
    let mut sizes = Vec::new();
    for _ in 0..teeth {
        let mut now = Vec::with_capacity(steps + 1);
        for k in 0..steps {
            now.push(q);
            let between = if k > 0 && k + 2 <= steps {
                (9.0 * (past[k] + past[k + 1]) - past[k - 1] - past[k + 2]) / 16.0
            } else {
                0.5 * (past[k] + past[k + 1])
            };
            let [first, middle, last] = [0.0, 0.5, 1.0].map(|part| drive((k as f64 + part) / steps as f64));
            let rate = |drive: f64, old: f64, q: f64, v: f64| {
                (
                    v,
                    -omega * omega * q - 2.0 * 0.011 * omega * v - drive * (q - old),
                )
            };
            let a = rate(first, past[k], q, v);
            let b = rate(middle, between, q + 0.5 * h * a.0, v + 0.5 * h * a.1);
            let c = rate(middle, between, q + 0.5 * h * b.0, v + 0.5 * h * b.1);
            let d = rate(last, past[k + 1], q + h * c.0, v + h * c.1);
            q += h / 6.0 * (a.0 + 2.0 * (b.0 + c.0) + d.0);
            v += h / 6.0 * (a.1 + 2.0 * (b.1 + c.1) + d.1);
        }
        now.push(q);
        sizes.push(now.iter().fold(0.0_f64, |max, q| max.max(q.abs())));
        past = now;
    }
    let half = teeth / 2;
    (sizes[teeth - 1] / sizes[half - 1]).powf(1.0 / (teeth - half) as f64)
}

/// An impulse dies out below the limit and grows above it, for any number of waves per tooth.
#[test]
fn many_wave_limits_match_simulation() {
    for (frequency_hz, immersion, rpm, waves) in [
        (4000.0, 1.0, 2000.0, 60.0),
        (4000.0, 1.0, 1000.0, 120.0),
        (4000.0, 1.0, 700.0, 171.0),
        (4000.0, 1.0, 500.0, 240.0),
        (3000.0, 0.5, 300.0, 150.0),
        (922.0, 0.5, 100.0, 138.0),
        (4000.0, 0.1, 500.0, 49.0),
    ] {
        let milling = mill_of(frequency_hz, immersion);
        let exit = milling.cut().exit_deg - milling.cut().entry_deg;
        let held = frequency_hz * exit / 6.0 / rpm;
        assert!((held - waves).abs() < 1.0, "{held} waves");
        let limit = MillingDelay::milling(&milling, rpm)
            .unwrap()
            .limit(5e-3)
            .unwrap()
            .unwrap();
        let [below, above] =
            [0.985, 1.015].map(|part| growth(frequency_hz, immersion, rpm, part * limit, 120));
        assert!(
            below < 0.995 && above > 1.005,
            "{waves} waves, {rpm} rpm: limit {} mm, growth {below} below and {above} above",
            1e3 * limit
        );
    }
}
