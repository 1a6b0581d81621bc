//! The quality of the distributed clocks: differences between the devices and the reference clock, phase of
//! the frames relative to SYNC0, and rate of this computer's clock. Only the constructor allocates; nothing
//! waits.

use evolvent_trace::Histogram;

use crate::network::MAX_DEVICES;

/// Time between two readings of 092Ch, ns: one device at a time.
const READING_NS: u64 = 20_000_000;
/// Cycles before the mean phase is known: the loop that follows the reference has a time constant of 16.
const SETTLING_CYCLES: u32 = 256;
/// Blocks for the drift, ns: the frame with the minimum delay in each block counts.
const BLOCK_NS: u64 = 1_000_000_000;
/// Time from OP of all devices to the first report of the figures, ns.
const FIRST_REPORT_NS: u64 = 10_000_000_000;

/// Measurements of a network's clocks while all devices were in OP.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClockFigures {
    /// Number of readings of the system time difference (092Ch).
    pub readings: u64,
    /// The largest difference read, ns: positive if the device's clock is ahead of the reference clock.
    pub max_difference_ns: i32,
    /// The device with this difference, from 0.
    pub max_difference_device: Option<usize>,
    /// The largest of the last readings of all devices, ns.
    pub last_difference_ns: i32,
    /// Mean distance of frames, as they pass the reference clock, from the middle between two SYNC0, ns:
    /// positive if they are late.
    pub shift_ns: i64,
    /// Distance from that mean which half of the frames do not exceed, ns, too large by at most a sixteenth.
    pub jitter_p50_ns: u64,
    /// The same for 99.9 % of them.
    pub jitter_p999_ns: u64,
    /// The maximum.
    pub jitter_max_ns: u64,
    /// How much faster this computer's clock is than the reference clock, millionths; none before two seconds
    /// in OP.
    pub drift_ppm: Option<f64>,
}

/// The difference in register 092Ch (ETG.1000.4): a magnitude, and bit 31 if the device's copy of the system
/// time is late.
const fn difference_ns(register: u32) -> i32 {
    let magnitude = (register & 0x7FFF_FFFF) as i32;
    if register >> 31 == 1 {
        -magnitude
    } else {
        magnitude
    }
}

/// Observes the clocks over all sessions of a bridge.
#[derive(Debug)]
pub(crate) struct ClockMonitor {
    /// Devices with a clock that follows the reference.
    followers: [bool; MAX_DEVICES],
    /// The next device to read.
    next_device: usize,
    next_reading_ns: u64,
    last_differences_ns: [i32; MAX_DEVICES],
    figures: ClockFigures,
    /// Phase of the frames.
    settled_cycles: u32,
    mean_ns: f64,
    sum_ns: i64,
    cycles: i64,
    jitter: Histogram,
    drift: Drift,
    report_at_ns: Option<u64>,
    is_used: bool,
}

impl ClockMonitor {
    pub(crate) fn new() -> Self {
        Self {
            followers: [false; MAX_DEVICES],
            next_device: 0,
            next_reading_ns: 0,
            last_differences_ns: [0; MAX_DEVICES],
            figures: ClockFigures::default(),
            settled_cycles: 0,
            mean_ns: 0.0,
            sum_ns: 0,
            cycles: 0,
            jitter: Histogram::default(),
            drift: Drift::default(),
            report_at_ns: None,
            is_used: false,
        }
    }

    /// Begins when all devices are in OP; those at `clocks` have a clock, and the first of them is the
    /// reference.
    pub(crate) fn begin(&mut self, clocks: impl Iterator<Item = usize>, now_ns: u64) {
        self.followers = [false; MAX_DEVICES];
        for device in clocks.skip(1) {
            if let Some(follower) = self.followers.get_mut(device) {
                *follower = true;
            }
        }
        self.last_differences_ns = [0; MAX_DEVICES];
        self.next_reading_ns = now_ns + READING_NS;
        self.settled_cycles = 0;
        self.drift = Drift::default();
        self.report_at_ns = Some(now_ns + FIRST_REPORT_NS);
        self.is_used = true;
    }

    /// The device whose difference is due.
    pub(crate) fn due(&mut self, now_ns: u64) -> Option<usize> {
        if !self.is_used || now_ns < self.next_reading_ns {
            return None;
        }
        let from = self.next_device;
        let mut devices = (0..MAX_DEVICES).map(|step| (from + step) % MAX_DEVICES);
        devices.find(|device| self.followers[*device])
    }

    /// Takes the difference of a device; `None` if it did not reply in time.
    pub(crate) fn take_difference(&mut self, device: usize, register: Option<u32>, now_ns: u64) {
        self.next_device = (device + 1) % MAX_DEVICES;
        self.next_reading_ns = now_ns + READING_NS;
        let Some(register) = register else { return };
        let difference_ns = difference_ns(register);
        self.figures.readings += 1;
        self.last_differences_ns[device] = difference_ns;
        let is_larger = difference_ns.unsigned_abs() > self.figures.max_difference_ns.unsigned_abs();
        if is_larger || self.figures.max_difference_device.is_none() {
            self.figures.max_difference_ns = difference_ns;
            self.figures.max_difference_device = Some(device);
        }
    }

    /// Takes a frame that was sent at `sent_ns` and passed the reference clock at its time `reference_ns`,
    /// `phase_ns` after the middle between two SYNC0.
    pub(crate) fn take_frame(&mut self, sent_ns: u64, reference_ns: u64, phase_ns: i64) {
        if !self.is_used {
            return;
        }
        self.settled_cycles = self.settled_cycles.saturating_add(1);
        let deviation_ns = phase_ns as f64 - self.mean_ns;
        // The plain mean of the first cycles, then a slow one: the shift follows the drift of the clocks.
        self.mean_ns += deviation_ns / f64::from(self.settled_cycles.min(SETTLING_CYCLES));
        if self.settled_cycles > SETTLING_CYCLES {
            self.sum_ns += phase_ns;
            self.cycles += 1;
            self.jitter.record(deviation_ns.abs() as i64);
        }
        self.drift.take(sent_ns, reference_ns);
    }

    /// The figures once in each session, when they have settled.
    pub(crate) fn first_report(&mut self, now_ns: u64) -> Option<ClockFigures> {
        self.report_at_ns.take_if(|at_ns| *at_ns <= now_ns)?;
        self.figures()
    }

    /// The figures so far; none without distributed clocks.
    pub(crate) fn figures(&self) -> Option<ClockFigures> {
        let last = self.last_differences_ns.iter().max_by_key(|ns| ns.unsigned_abs());
        self.is_used.then(|| ClockFigures {
            last_difference_ns: last.copied().unwrap_or(0),
            shift_ns: self.sum_ns / self.cycles.max(1),
            jitter_p50_ns: self.jitter.percentile_ns(50.0).unsigned_abs(),
            jitter_p999_ns: self.jitter.percentile_ns(99.9).unsigned_abs(),
            jitter_max_ns: self.jitter.max_ns().unsigned_abs(),
            drift_ppm: self.drift.ppm(),
            ..self.figures
        })
    }
}

/// The drift of this computer's clock, from the frames with the minimum delay at the beginning and at the
/// end: the computer can only delay a frame.
#[derive(Debug, Default)]
struct Drift {
    /// Time on this computer of the frame with the minimum delay, and the reference's time minus it.
    first: Option<(u64, i64)>,
    last: Option<(u64, i64)>,
    present: Option<(u64, i64)>,
    block_end_ns: u64,
}

impl Drift {
    fn take(&mut self, sent_ns: u64, reference_ns: u64) {
        let here = (sent_ns, reference_ns.wrapping_sub(sent_ns).cast_signed());
        if sent_ns >= self.block_end_ns {
            if let Some(best) = self.present.take() {
                self.last = self.first.and(Some(best));
                self.first.get_or_insert(best);
            }
            self.block_end_ns = sent_ns + BLOCK_NS;
        }
        if self.present.is_none_or(|(_, lead_ns)| here.1 < lead_ns) {
            self.present = Some(here);
        }
    }

    /// Millionths by which this computer's clock is faster.
    fn ppm(&self) -> Option<f64> {
        let ((first_ns, first_lead_ns), (last_ns, last_lead_ns)) = (self.first?, self.last?);
        let gained_ns = last_lead_ns.wrapping_sub(first_lead_ns) as f64;
        let reference_ns = last_ns.saturating_sub(first_ns) as f64 + gained_ns;
        Some(-gained_ns / reference_ns.max(1.0) * 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bit_31_is_the_sign_of_a_difference() {
        assert_eq!(difference_ns(0), 0);
        assert_eq!(difference_ns(37), 37);
        assert_eq!(difference_ns(0x8000_0025), -37);
        assert_eq!(difference_ns(0xFFFF_FFFF), -i32::MAX);
    }

    #[test]
    fn devices_are_read_in_turn_and_the_reference_is_not() {
        let mut monitor = ClockMonitor::new();
        assert_eq!(monitor.due(u64::MAX), None, "no session");
        monitor.begin([1, 2, 5].into_iter(), 0);
        let mut read = Vec::new();
        for now_ns in (0..=5 * READING_NS).step_by(READING_NS as usize / 10) {
            if let Some(device) = monitor.due(now_ns) {
                read.push(device);
                let register = [0, 0, 0x8000_0100, 0, 0, 80][device];
                monitor.take_difference(device, Some(register), now_ns);
            }
        }
        assert_eq!(read, [2, 5, 2, 5, 2]);
        let figures = monitor.figures().expect("figures");
        assert_eq!(
            (figures.max_difference_ns, figures.max_difference_device),
            (-256, Some(2))
        );
        monitor.take_difference(2, Some(3), 0);
        let figures = monitor.figures().expect("figures");
        assert_eq!(
            (figures.max_difference_ns, figures.last_difference_ns),
            (-256, 80)
        );
    }

    #[test]
    fn each_session_reports_once() {
        let mut monitor = ClockMonitor::new();
        assert!(monitor.figures().is_none() && monitor.first_report(u64::MAX).is_none());
        for begin_ns in [0, 2 * FIRST_REPORT_NS] {
            monitor.begin([0, 1].into_iter(), begin_ns);
            for now_ns in [begin_ns, begin_ns + FIRST_REPORT_NS - 1] {
                assert!(monitor.first_report(now_ns).is_none());
            }
            assert!(monitor.first_report(begin_ns + FIRST_REPORT_NS).is_some());
            assert!(monitor.first_report(u64::MAX).is_none());
        }
    }

    /// A computer whose clock is fast by 37 ppm, with frames that are up to half a millisecond late.
    #[test]
    fn late_frames_do_not_change_the_drift() {
        let mut drift = Drift::default();
        let mut random: u64 = 1;
        for cycle in 0..5_000_u64 {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let sent_ns = 7_000_000 + cycle * 1_000_000;
            let late_ns = ((random >> 40) * 500_000) >> 24;
            let reference_ns = (sent_ns as f64 / (1.0 + 37e-6)) as u64 + late_ns;
            drift.take(sent_ns, reference_ns + 1_000_000_000_000);
            assert!(drift.ppm().is_none() || cycle >= 2_000);
        }
        let ppm = drift.ppm().expect("a drift");
        assert!((ppm - 37.0).abs() < 1.0, "{ppm}");
    }
}
