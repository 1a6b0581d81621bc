//! A map of 100 x 100 cuts by harmonic balance, and the time that integration takes for the same results.
//!
//! `cargo bench -p evolvent-chatter`. Integration computes a sample of the cells (every 9th speed and depth),
//! with steps of a relative accuracy of 1e-7; one thread is compared with one in processor time. For each
//! cell it follows a small and a large disturbance until the amplitude has died out or is within 1e-4 of its
//! limit, judged from windows of 20 periods. It never finds an unstable cycle.

#![expect(
    clippy::print_stdout,
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark prints and may fail"
)]

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use evolvent_chatter::{
    Accuracy, CuttingTool, Integrator, MapCell, Mapper, Model, PrincipalAxis, StabilityVerdict, State,
};
use evolvent_cutting::{ForceLaw, LawDefinition, ToolAngles};

const COUNT: usize = 100;
/// Columns that one thread computes together.
const STRIP: usize = 25;
/// Simulated time after which a disturbance that has neither settled nor died out is abandoned, s.
const LONGEST_S: f64 = 3.0;

fn main() {
    let angles = ToolAngles {
        rake_deg: 10.0,
        lead_deg: 60.0,
    };
    let law = LawDefinition::built_in("40X-R1")
        .expect("built in")
        .law(angles)
        .unwrap();
    for ratio in [0.02, 0.008] {
        map(&law, ratio);
    }
}

/// Processor time of this thread, independent of the load of the host.
fn processor_time() -> Duration {
    let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec.unsigned_abs(), u32::try_from(now.tv_nsec).unwrap_or(0))
}

fn cut(ratio: f64, column: usize, row: usize) -> CuttingTool {
    let axis = |stiffness, ratio| PrincipalAxis::with_ratio(6.0, stiffness, ratio);
    CuttingTool {
        axes: [
            axis(30_020_020.401_035_063, 0.03),
            axis(14_994_509.394_629_354, ratio),
        ],
        beta_deg: 35.0,
        speed_m_min: 20.0 + 100.0 * (column as f64 + 0.5) / COUNT as f64,
        depth_mm: 0.25 + 5.75 * (row as f64 + 0.5) / COUNT as f64,
        feed_mm_rev: 0.49,
        radial_ratio: 0.4,
        floor_m_min: 2.0,
    }
}

fn map(law: &ForceLaw, ratio: f64) {
    let threads = 2_u32;
    let next = AtomicUsize::new(0);
    let work = || {
        let start = processor_time();
        let mut mapper = Mapper::new(5);
        let mut cells: Vec<MapCell> = Vec::new();
        loop {
            let strip = next.fetch_add(1, Ordering::Relaxed);
            if strip * STRIP >= COUNT {
                return (cells, processor_time() - start);
            }
            let columns = strip * STRIP..(strip + 1) * STRIP;
            let speeds: Vec<f64> = columns.map(|column| cut(ratio, column, 0).speed_m_min).collect();
            let depths: Vec<f64> = (0..COUNT).map(|row| cut(ratio, 0, row).depth_mm).collect();
            cells.extend(mapper.tile(cut(ratio, 0, 0), law, &speeds, &depths));
        }
    };
    let start = Instant::now();
    let (cells, busy) = std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
        let (mut cells, mut busy) = work();
        for other in others {
            let (more, time) = other.join().expect("thread");
            cells.extend(more);
            busy += time;
        }
        (cells, busy)
    });
    let whole = start.elapsed().as_secs_f64();
    let count = |verdict| cells.iter().filter(|cell| cell.verdict == Some(verdict)).count();
    println!(
        "damping {ratio}: map of {} cuts in {whole:.2} s on {threads} threads ({:.2} s of processor time)",
        cells.len(),
        busy.as_secs_f64()
    );
    println!(
        "  {} stable, {} bistable, {} vibrate, {} out of the model",
        count(StabilityVerdict::Stable),
        count(StabilityVerdict::Bistable),
        count(StabilityVerdict::SelfExcited),
        count(StabilityVerdict::OutOfModel)
    );
    compare(law, ratio);
}

fn compare(law: &ForceLaw, ratio: f64) {
    let (mut quick, mut slow) = (0.0, 0.0);
    let (mut unfinished, mut sampled, mut differ, mut worst, mut shared) = (0, 0, 0, 0.0_f64, 0);
    let mut mapper = Mapper::new(5);
    for column in (4..COUNT).step_by(9) {
        for row in (4..COUNT).step_by(9) {
            let tool = cut(ratio, column, row);
            let start = processor_time();
            let cell = mapper.cell(tool, law);
            let between = processor_time();
            let answer = integrated(&Model::new(tool, law).unwrap());
            quick += (between - start).as_secs_f64();
            slow += (processor_time() - between).as_secs_f64();
            sampled += 1;
            let Some((verdict, amplitude)) = answer else {
                unfinished += 1;
                continue;
            };
            if cell.verdict != Some(verdict) {
                differ += 1;
            } else if amplitude > 0.0 {
                worst = worst.max((amplitude / cell.amplitude_m - 1.0).abs());
                shared += 1;
            }
        }
    }
    println!(
        "  {sampled} of them, one thread: balance {:.3} ms, integration {:.2} ms a cut: {:.0} times",
        1e3 * quick / f64::from(sampled),
        1e3 * slow / f64::from(sampled),
        slow / quick
    );
    println!(
        "  {differ} verdicts differ, {unfinished} not settled after {LONGEST_S} s; amplitudes of {shared} \
         agree to {worst:.1e}"
    );
}

/// Verdict and amplitude (of V2, the largest settled one) from a small and a large disturbance.
fn integrated(model: &Model<'_>) -> Option<(StabilityVerdict, f64)> {
    let Ok(rest) = model.equilibrium() else {
        return Some((StabilityVerdict::OutOfModel, 0.0));
    };
    let tool = model.tool();
    let largest = 0.9 * (tool.speed_m_min - tool.floor_m_min) / 60.0;
    let small = follow(model, rest.deflection_m, 0.01 * largest);
    let large = follow(model, rest.deflection_m, largest);
    match (small, large) {
        (Outcome::Unfinished, _) | (Outcome::Died, Outcome::Unfinished) => None,
        (Outcome::Lost, _) | (Outcome::Died, Outcome::Lost) => Some((StabilityVerdict::OutOfModel, 0.0)),
        (Outcome::Settled(amplitude), _) => Some((StabilityVerdict::SelfExcited, amplitude)),
        (Outcome::Died, Outcome::Settled(amplitude)) => Some((StabilityVerdict::Bistable, amplitude)),
        (Outcome::Died, Outcome::Died) => Some((StabilityVerdict::Stable, 0.0)),
    }
}

enum Outcome {
    Died,
    Settled(f64),
    Lost,
    /// Neither within the simulated time.
    Unfinished,
}

fn follow(model: &Model<'_>, rest: [f64; 2], kick: f64) -> Outcome {
    let mut state = State::new(rest[0], rest[1], 0.0, kick);
    let period = 1.0 / model.tool().axes[1].frequency_hz();
    let mut integrator = Integrator::<4>::new(Accuracy {
        relative: 1e-7,
        absolute: 1e-11,
        longest_step_s: 0.1 * period,
    });
    let first = kick * period / std::f64::consts::TAU;
    let (mut before, mut change) = (f64::NAN, f64::NAN);
    let mut time = 0.0;
    while time < LONGEST_S {
        // 20 periods; extremes of the last two.
        let mut rate = |state: &State| model.derivative(state);
        let event = |state: &State| model.cut_at(state).1;
        let Ok(next) = integrator.run(state, 18.0 * period, &mut rate, &event) else {
            return Outcome::Lost;
        };
        state = next;
        let (mut values, mut slowest) = (Vec::with_capacity(80), f64::INFINITY);
        for _ in 0..80 {
            let Ok(next) = integrator.run(state, period / 40.0, &mut rate, &event) else {
                return Outcome::Lost;
            };
            state = next;
            values.push(state[1]);
            slowest = slowest.min(model.cut_at(&state).0);
        }
        time += 20.0 * period;
        let amplitude = half_peak_to_peak(&values);
        if slowest <= model.tool().floor_m_min {
            return Outcome::Lost;
        }
        if amplitude < 1e-3 * first {
            return Outcome::Died;
        }
        // The remaining change if changes continue to fall at the same rate.
        let (next, last) = (amplitude - before, change);
        let ratio = (next / last).abs();
        if ratio < 1.0 && (next * ratio / (1.0 - ratio)).abs() < 1e-4 * amplitude {
            return Outcome::Settled(amplitude);
        }
        (before, change) = (amplitude, next);
    }
    Outcome::Unfinished
}

/// Half of the distance between the extremes, each that of the parabola through three samples.
fn half_peak_to_peak(values: &[f64]) -> f64 {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for three in values.windows(3) {
        let (a, b, c) = (three[0], three[1], three[2]);
        let (slope, bend) = (0.5 * (c - a), a - 2.0 * b + c);
        let peak = if bend == 0.0 || slope.abs() > bend.abs() {
            b
        } else {
            b - 0.5 * slope * slope / bend
        };
        (low, high) = (low.min(peak), high.max(peak));
    }
    0.5 * (high - low)
}
