//! Filtered inputs (InM) and outputs of modules (SSR, OutM), by Mesa's register map.

/// Bit with which SSR puts out its frequency.
const RELAY_ENABLE: u32 = 1 << 12;
/// Maximum number of scans that are simulated one by one; more than the longest filter has.
const MAX_SCANS: u64 = 2048;

/// An InM: each input counts up while it is high and down while it is low, and changes at the ends.
#[derive(Clone, Debug)]
pub(crate) struct InputFilter {
    width: u32,
    control: u32,
    slow: u32,
    counts: [u32; 32],
    raw: u32,
    filtered: u32,
    /// Remaining clocks, less than a scan.
    rest: u64,
}

impl InputFilter {
    pub(crate) const fn new(width: u32) -> Self {
        Self {
            width,
            control: width - 1,
            slow: 0,
            counts: [0; 32],
            raw: 0,
            filtered: 0,
            rest: 0,
        }
    }

    pub(crate) const fn reset(&mut self) {
        *self = Self::new(self.width);
    }

    /// Number of inputs that it scans.
    pub(crate) const fn width(&self) -> u32 {
        self.width
    }

    /// Registers by number: control, slow inputs, filtered data, raw data, counters.
    pub(crate) const fn read(&self, register: usize) -> u32 {
        match register {
            0 => self.control,
            1 => self.slow,
            2 => self.filtered,
            3 => self.raw,
            _ => 0,
        }
    }

    pub(crate) const fn write(&mut self, register: usize, value: u32) {
        match register {
            0 => self.control = value & !0x1F | (self.width - 1),
            1 => self.slow = value & (((1_u64 << self.width) - 1) as u32),
            _ => {}
        }
    }

    /// Advances by `clocks` with these levels at the pins.
    pub(crate) fn advance(&mut self, clocks: u64, levels: u32) {
        let scan = 4 * (u64::from(self.control >> 6 & 0x3FF) + 1) * u64::from(self.width);
        self.rest += clocks;
        let scans = self.rest / scan;
        self.rest %= scan;
        self.raw = if self.control >> 5 & 1 == 1 {
            !levels
        } else {
            levels
        };
        for _ in 0..scans.min(MAX_SCANS) {
            for input in 0..self.width {
                let count = &mut self.counts[input as usize];
                let max_count = if self.slow >> input & 1 == 1 {
                    self.control >> 22
                } else {
                    self.control >> 16 & 0x3F
                };
                if self.raw >> input & 1 == 1 {
                    *count = (*count + 1).min(max_count);
                    if *count >= max_count {
                        self.filtered |= 1 << input;
                    }
                } else {
                    *count = count.saturating_sub(1);
                    if *count == 0 {
                        self.filtered &= !(1 << input);
                    }
                }
            }
        }
    }
}

/// Outputs of SSR and OutM.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FieldOutputs {
    /// Data and frequency of SSR.
    pub(crate) relays: u32,
    pub(crate) relay_rate: u32,
    /// Data of OutM.
    pub(crate) simple: u32,
}

impl FieldOutputs {
    /// Whether SSR drives its gates.
    pub(crate) const fn relays_run(self) -> bool {
        self.relay_rate & RELAY_ENABLE != 0
    }
}
