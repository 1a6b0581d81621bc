//! The simulated board alone: protocol words, counters, watchdog.

#![expect(clippy::panic, reason = "a test")]

use evolvent_mesa_board::{Board, BoardModel, FaultKind};

/// Address, width 32 bits, no increment, one.
fn read(board: &mut Board, now_ns: u64, address: u16) -> Option<u32> {
    let [low, high] = address.to_le_bytes();
    let mut found = None;
    board.receive(now_ns, &[0x01, 0x42, low, high], |reply| {
        found = reply.try_into().ok().map(u32::from_le_bytes);
    });
    found
}

fn write(board: &mut Board, now_ns: u64, address: u16, value: u32) {
    let mut packet = vec![0x01, 0xC2];
    packet.extend(address.to_le_bytes());
    packet.extend(value.to_le_bytes());
    board.receive(now_ns, &packet, |_| panic!("a write has no reply"));
}

#[test]
fn several_commands_share_a_packet() {
    let mut board = Board::new(BoardModel::B7i92, 0);
    // Write 0x1234 to scratch 0 of the timers (space 4), read it, read the name (space 7), and the cookie.
    let packet = [
        0x01, 0xD1, 0x10, 0x00, 0x34, 0x12, 0x01, 0x51, 0x10, 0x00, 0x84, 0x5C, 0x00, 0x00, 0x01, 0x42, 0x00,
        0x01,
    ];
    let mut reply = Vec::new();
    board.receive(1000, &packet, |bytes| reply.extend_from_slice(bytes));
    assert_eq!(reply, b"\x34\x127I92\xFE\xCA\xAA\x55");
}

#[test]
fn steps_reach_the_motor_only_by_the_pins() {
    let mut board = Board::new(BoardModel::B7i96s, 0);
    for (address, value) in [(0x2500, 199), (0x2600, 199), (0x2000, 429_497)] {
        write(&mut board, 10, address, value);
    }
    // 429497 / 2^32 of 100 MHz are 10 000 steps/s.
    let steps = f64::from(read(&mut board, 1_000_000_010, 0x2100).expect("a reply") as i32) / 65536.0;
    assert!((steps - 10_000.0).abs() < 0.1, "{steps}");
    assert!(board.motor_steps(0).abs() < f64::EPSILON, "the pins are inputs");
    write(&mut board, 1_000_000_010, 0x1104, 3);
    write(&mut board, 1_000_000_010, 0x1204, 3);
    board.advance(1_500_000_010);
    assert!(
        (board.motor_steps(0) - 5000.0).abs() <= 1.0,
        "{}",
        board.motor_steps(0)
    );
}

#[test]
fn pulses_do_not_come_faster_than_their_times_allow() {
    let mut board = Board::new(BoardModel::B7i96s, 0);
    for (address, value) in [(0x2500, 499), (0x2600, 499), (0x2000, 0x7FFF_FFFF)] {
        write(&mut board, 10, address, value);
    }
    board.advance(100_000_010);
    let steps = read(&mut board, 100_000_010, 0x2100).expect("a reply") >> 16;
    assert!(steps.abs_diff(10_000) <= 1, "5 us and 5 us are 100 kHz: {steps}");
}

#[test]
fn a_watchdog_that_is_not_fed_takes_the_pins_away() {
    let mut board = Board::new(BoardModel::B7i96s, 0);
    write(&mut board, 10, 0x0C00, 1_000_000);
    write(&mut board, 10, 0x0E00, 0x5A00_0000);
    write(&mut board, 10, 0x1100, 1 << 11);
    assert!(board.is_driven(11));
    board.advance(9_999_000);
    assert_eq!(read(&mut board, 9_999_010, 0x0D00), Some(0));
    board.advance(10_001_000);
    assert_eq!(read(&mut board, 10_001_010, 0x0D00), Some(1), "10 ms are over");
    assert!(!board.is_driven(11));
    write(&mut board, 10_001_020, 0x1100, 1 << 11);
    assert!(!board.is_driven(11), "not before its status is cleared");
}

#[test]
fn a_board_that_has_lost_its_supply_knows_nothing() {
    let mut board = Board::new(BoardModel::B7i92, 0);
    write(&mut board, 10, 0x2100, 0x0005_0000);
    board.fault_now(FaultKind::Reset, None);
    board.advance(1000);
    assert_eq!(read(&mut board, 2000, 0x2100), None, "it starts");
    assert_eq!(read(&mut board, 200_000_000, 0x2100), Some(0));
}

#[test]
fn garbage_is_counted_and_answered_by_nothing() {
    let mut random = evolvent_random::Random::seeded(27);
    let mut board = Board::new(BoardModel::B7i96s, 0);
    for i in 0..2000 {
        let length = random.below(40);
        let packet: Vec<u8> = (0..length).map(|_| random.below(256) as u8).collect();
        board.receive(1000 * i, &packet, |reply| assert!(reply.len() <= 20 * 127 * 8));
    }
}
