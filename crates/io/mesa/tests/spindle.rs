//! The enable of a spindle's drive.

use std::time::{Duration, Instant};

use evolvent_mesa::BoardSettings;
use evolvent_mesa_board::BoardModel;

use crate::common::core::with_bridge_to;

/// The pin of the enable.
const ENABLE: usize = 16;

fn add_spindle(board: &mut BoardSettings) {
    let text = evolvent_file_tests::shipped("boards/7i96s-router.toml");
    let begin = text.find("[spindle]").expect("a spindle");
    let spindle = "[[spindle]]\npwm = 0\nfull_rpm = 3000\nforward = { pin = 15 }\nenable = { pin = 16 }\n\
                   encoder = 0\ncounts_per_rev = 4096\n";
    let text = format!("{}{spindle}", &text[..begin]);
    board.spindles = BoardSettings::parse(&text, "b.toml").expect("a board").spindles;
}

#[test]
fn a_spindle_turned_by_hand_does_not_enable_its_drive() {
    with_bridge_to(BoardModel::B7i96s, add_spindle, |core, server, messages| {
        let begin = Instant::now();
        while !messages.contain(": set up") {
            assert!(begin.elapsed() < Duration::from_secs(20), "no session");
            core.cycle();
        }
        // 4 counts in a period.
        let mut enabled = 0;
        for _ in 0..1000 {
            server.lock().turn_shaft(0, 4.0);
            core.cycle();
            enabled += u32::from(server.lock().level(ENABLE));
        }
        assert_eq!(enabled, 0, "of 1000 times that were looked at");
    });
}
