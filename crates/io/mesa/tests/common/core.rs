//! A core that moves the router's X axis over the bus, and the bridge of a simulated board.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::time::Duration;

use evolvent_bridge_trial::{Messages, TrialCore, with_bridge as with_bridge_and_core};
use evolvent_disturbance::unless_disturbed;
use evolvent_mesa::{BoardSettings, BridgeReport, RunSettings, run_measured};
use evolvent_mesa_board::{BoardModel, BoardServer};

use super::{machine, router, serve};

/// Steps per mm of X in the router's board file.
pub(crate) const STEPS: f64 = 320.0;

/// Runs the bridge, with its messages, during a test.
pub(crate) fn with_bridge(
    edit: impl Fn(&mut BoardSettings),
    test: impl Fn(&mut TrialCore, &BoardServer, &Messages),
) -> BridgeReport {
    with_bridge_to(BoardModel::B7i96s, edit, test)
}

pub(crate) fn with_bridge_to(
    model: BoardModel,
    edit: impl Fn(&mut BoardSettings),
    test: impl Fn(&mut TrialCore, &BoardServer, &Messages),
) -> BridgeReport {
    with_suspended_bridge_to(model, edit, &AtomicU64::new(0), test)
}

/// Like [`with_bridge`]; each time that `suspend_ms` is set, the bridge's cycle sleeps once for this time.
pub(crate) fn with_suspended_bridge_to(
    model: BoardModel,
    edit: impl Fn(&mut BoardSettings),
    suspend_ms: &AtomicU64,
    test: impl Fn(&mut TrialCore, &BoardServer, &Messages),
) -> BridgeReport {
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    unless_disturbed(|| {
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let prefix = format!("mesaft{}-{number}_", std::process::id());
        let (server, address) = serve(model);
        let mut board = router(address);
        board.watchdog_s = 0.1;
        board.max_lost_packets = 20;
        edit(&mut board);
        let settings = RunSettings {
            machine: machine("router-3axis"),
            machine_name: Some("mesa-faults".to_owned()),
            board,
            prefix: Some(prefix.clone()),
            duration: None,
        };
        with_bridge_and_core(
            &prefix,
            |stop, messages| {
                let mut sleep =
                    |_| std::thread::sleep(Duration::from_millis(suspend_ms.swap(0, Ordering::Relaxed)));
                run_measured(&settings, stop, |text| messages.push(text), Some(&mut sleep))
            },
            TrialCore::open("mesa-faults", &prefix),
            |core, messages| test(core, &server, messages),
        )
    })
}
