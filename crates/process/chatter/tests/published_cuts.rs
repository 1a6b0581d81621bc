//! The turning tool and the mill of published stability lobes.

#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use evolvent_chatter::{Milling, MillingCut, Mode, Turning, TurningMode};

/// Y. Altintas' turning tool: two modes at 30 and -45 degrees to the chip's thickness, 1000 N/mm2.
pub(crate) fn altintas() -> Turning {
    let mode = |frequency_hz, damping_ratio, stiffness_n_m, direction_deg| TurningMode {
        mode: Mode {
            frequency_hz,
            damping_ratio,
            stiffness_n_m,
        },
        direction_deg,
    };
    Turning::new(
        &[
            mode(250.0, 0.012, 2.26e8, 30.0),
            mode(150.0, 0.010, 2.13e8, -45.0),
        ],
        0.0,
        1e9,
    )
    .unwrap()
}

/// T. Insperger's and G. Stepan's mill: one mode along the feed, two teeth.
pub(crate) fn insperger(immersion: f64) -> Milling {
    mill_of(922.0, immersion)
}

/// The stiffness of the mode of [`insperger`], for which mass and frequency are published.
pub(crate) fn stiffness_n_m() -> f64 {
    let omega = 922.0 * std::f64::consts::TAU;
    0.03993 * omega * omega
}

/// The mill of [`insperger`] with another natural frequency.
pub(crate) fn mill_of(frequency_hz: f64, immersion: f64) -> Milling {
    let mode = Mode {
        frequency_hz,
        damping_ratio: 0.011,
        stiffness_n_m: stiffness_n_m(),
    };
    let cut = MillingCut {
        teeth: 2,
        entry_deg: 0.0,
        exit_deg: 180.0,
        tangential_n_m2: 6e8,
        radial_n_m2: 2e8,
    };
    Milling::new(cut.with_immersion(immersion, true), &[mode], &[]).unwrap()
}
