//! Frames in, frames out: working counters, positions, clocks, and faults. Time is simulated.

use evolvent_ethercat_ring::{DriveSettings, FaultKind, HOP_NS, Ring, SubDevice, TerminalKind, address};

const MS: u64 = 1_000_000;

fn ring() -> Ring {
    Ring::new(
        vec![
            SubDevice::terminal(TerminalKind::Coupler, 1),
            SubDevice::drive(DriveSettings::default(), 2, 40.0),
            SubDevice::drive(DriveSettings::default(), 3, -60.0),
            SubDevice::terminal(TerminalKind::DigitalInput, 4),
        ],
        0,
    )
}

/// Command, address (position or station, and offset), data.
type Order<'a> = (u8, u16, u16, &'a [u8]);
/// Position or station, data, working counter.
type Reply = (u16, Vec<u8>, u16);

fn frame(orders: &[Order<'_>]) -> Vec<u8> {
    let mut body = Vec::new();
    for (i, (command, position, offset, data)) in orders.iter().enumerate() {
        let more = if i + 1 < orders.len() { 0x8000 } else { 0 };
        body.extend([*command, i as u8]);
        body.extend(position.to_le_bytes());
        body.extend(offset.to_le_bytes());
        body.extend((data.len() as u16 | more).to_le_bytes());
        body.extend([0, 0]);
        body.extend(*data);
        body.extend([0, 0]);
    }
    let mut frame = vec![0xFF; 6];
    frame.extend([0x10, 0x11, 0x12, 0x13, 0x14, 0x15, 0x88, 0xA4]);
    frame.extend((body.len() as u16 | 0x1000).to_le_bytes());
    frame.extend(body);
    frame
}

fn replies(frame: &[u8]) -> Vec<Reply> {
    let mut rest = &frame[16..];
    let mut replies = Vec::new();
    while rest.len() >= 12 {
        let length = usize::from(u16::from_le_bytes([rest[6], rest[7]]) & 0x7FF);
        let counter = u16::from_le_bytes([rest[10 + length], rest[11 + length]]);
        replies.push((
            u16::from_le_bytes([rest[2], rest[3]]),
            rest[10..10 + length].to_vec(),
            counter,
        ));
        rest = &rest[12 + length..];
    }
    replies
}

fn send(ring: &mut Ring, now_ns: u64, orders: &[Order<'_>]) -> Vec<Reply> {
    let returned = ring.exchange(now_ns, frame(orders));
    assert_eq!(returned.len(), 1, "one frame");
    assert_eq!(returned[0].frame[6], 0x12, "the local bit of the source");
    replies(&returned[0].frame)
}

/// The counters of ETG.1000.4, section 5.4: a read counts 1, a write 1, a write together with a read 2.
#[test]
fn every_command_counts_as_the_standard_says() {
    let mut ring = ring();
    for position in 0..4_u16 {
        let station = (0x1001 + position).to_le_bytes();
        send(
            &mut ring,
            1,
            &[(
                2,
                0_u16.wrapping_sub(position),
                address::STATION_ADDRESS,
                &station,
            )],
        );
    }
    let scratch = 0x1F00;
    let table: [(u8, u16, u16); 14] = [
        (1, 0xFFFF, 1),  // APRD
        (2, 0xFFFF, 1),  // APWR
        (3, 0xFFFF, 3),  // APRW
        (4, 0x1002, 1),  // FPRD
        (5, 0x1002, 1),  // FPWR
        (6, 0x1002, 3),  // FPRW
        (7, 0, 4),       // BRD
        (8, 0, 4),       // BWR
        (9, 0, 12),      // BRW
        (13, 0xFFFF, 4), // ARMW: one reads, three write
        (14, 0x1002, 4), // FRMW
        (0, 0, 0),       // NOP
        (1, 5, 0),       // nobody there
        (4, 0x2000, 0),
    ];
    let orders: Vec<Order<'_>> = table
        .iter()
        .map(|&(command, position, _)| (command, position, scratch, [7_u8, 7].as_slice()))
        .collect();
    for ((command, position, expected), (after, _, counter)) in
        table.into_iter().zip(send(&mut ring, 2, &orders))
    {
        assert_eq!(counter, expected, "command {command}");
        let counts = matches!(command, 1..=3 | 7..=9 | 13);
        assert_eq!(
            after,
            if counts {
                position.wrapping_add(4)
            } else {
                position
            },
            "command {command}"
        );
    }
}

#[test]
fn broadcast_and_multiple_write_follow_the_standard() {
    let mut ring = ring();
    send(
        &mut ring,
        1,
        &[(2, 0, 0x1F00, &[0x01]), (2, 0xFFFF, 0x1F00, &[0x80])],
    );
    assert_eq!(send(&mut ring, 2, &[(7, 0, 0x1F00, &[0])])[0].1, [0x81]);
    send(&mut ring, 3, &[(13, 0, 0x1F00, &[0])]);
    assert_eq!(send(&mut ring, 4, &[(1, 0xFFFF, 0x1F00, &[0])])[0].1, [0x01]);
}

/// Inputs of one device in the logical space: LRD and LWR count 1, LRW 1 for a read and 2 for a write.
#[test]
fn logical_datagrams_count_reads_and_writes() {
    let mut ring = ring();
    let fmmu = |logical: u8, physical: u16, kind: u8| {
        let [p0, p1] = physical.to_le_bytes();
        [logical, 0, 0, 0, 2, 0, 0, 7, p0, p1, 0, kind, 1, 0, 0, 0]
    };
    send(
        &mut ring,
        1,
        &[
            (2, 0, address::FMMU, &fmmu(0x10, 0x1F00, 2)),
            (2, 0xFFFF, address::FMMU, &fmmu(0x12, 0x1F10, 1)),
        ],
    );
    send(&mut ring, 2, &[(2, 0xFFFF, 0x1F10, &[0xAA, 0xBB])]);
    let data = [1, 2, 3, 4];
    for (command, expected, counter) in [
        (10, [1, 2, 0xAA, 0xBB], 1),
        (11, data, 1),
        (12, [1, 2, 0xAA, 0xBB], 3),
    ] {
        let answer = send(&mut ring, 3, &[(command, 0x10, 0, &data)]).remove(0);
        assert_eq!(
            (answer.1.as_slice(), answer.2),
            (expected.as_slice(), counter),
            "command {command}"
        );
    }
    assert_eq!(send(&mut ring, 4, &[(1, 0, 0x1F00, &[0, 0])])[0].1, [1, 2]);
    ring.begin_fault(5 * MS, FaultKind::WorkingCounter, 1, Some(MS));
    assert_eq!(send(&mut ring, 5 * MS, &[(12, 0x10, 0, &data)])[0].2, 2);
    assert_eq!(send(&mut ring, 7 * MS, &[(12, 0x10, 0, &data)])[0].2, 3);
}

/// The procedure of a MainDevice: latch, offsets and delays from the receive times, then the reference's time
/// every ms.
#[test]
fn clocks_that_drift_follow_the_reference() {
    let mut ring = ring();
    let clocks = 3_u16;
    for position in 0..clocks {
        send(
            &mut ring,
            1,
            &[(
                2,
                0_u16.wrapping_sub(position),
                address::STATION_ADDRESS,
                &(0x1001 + position).to_le_bytes(),
            )],
        );
    }
    assert_eq!(
        send(&mut ring, MS, &[(8, 0, address::DC_RECEIVE_TIMES, &[0; 4])])[0].2,
        clocks,
        "only devices with a clock count"
    );
    let word = |ring: &mut Ring, station: u16, offset: u16| {
        let answer = send(ring, MS, &[(4, station, offset, &[0; 4])]).remove(0);
        u32::from_le_bytes(answer.1.try_into().expect("four bytes"))
    };
    let round_trip =
        |ring: &mut Ring, station: u16| word(ring, station, 0x904).wrapping_sub(word(ring, station, 0x900));
    let (first, second) = (round_trip(&mut ring, 0x1001), round_trip(&mut ring, 0x1002));
    assert!(first.abs_diff(6 * HOP_NS as u32) <= 1, "{first}");
    assert!(first.abs_diff(second + 2 * HOP_NS as u32) <= 1, "{second}");
    let reference = word(&mut ring, 0x1001, 0x918);
    for station in [0x1002, 0x1003] {
        let local = word(&mut ring, station, 0x918);
        let delay = HOP_NS as u32 * u32::from(station - 0x1001);
        // Both devices received the latching frame, the second one later by the delay.
        let offset = i64::from(reference) + i64::from(delay) - i64::from(local);
        send(
            &mut ring,
            MS,
            &[
                (5, station, address::DC_OFFSET, &offset.to_le_bytes()),
                (5, station, address::DC_DELAY, &delay.to_le_bytes()),
            ],
        );
    }
    for millisecond in 2..3000 {
        send(
            &mut ring,
            millisecond * MS,
            &[(14, 0x1001, address::DC_SYSTEM_TIME, &[0; 8])],
        );
    }
    let times: Vec<u64> = ring
        .devices()
        .iter()
        .filter_map(|device| device.system_time_ns(3000 * MS))
        .collect();
    for time in &times[1..] {
        assert!(time.abs_diff(times[0]) < 50, "{times:?}");
    }
}

#[test]
fn a_cable_that_is_cut_and_a_device_that_comes_back() {
    let mut ring = ring();
    let count = |ring: &mut Ring, at: u64| {
        ring.exchange(at, frame(&[(7, 0, 0x0000, &[0])]))
            .first()
            .map(|returned| replies(&returned.frame)[0].2)
    };
    assert_eq!(count(&mut ring, 1), Some(4));
    send(
        &mut ring,
        2,
        &[(2, 0xFFFE, address::STATION_ADDRESS, &[0x03, 0x10])],
    );
    ring.begin_fault(3 * MS, FaultKind::Break, 2, Some(5 * MS));
    assert_eq!(count(&mut ring, 4 * MS), Some(2));
    // The link of port 1 of the last device is gone.
    assert_eq!(
        send(&mut ring, 4 * MS, &[(1, 0xFFFF, address::DL_STATUS, &[0; 2])])[0].1[0] >> 5 & 1,
        0
    );
    assert_eq!(count(&mut ring, 9 * MS), Some(4));
    assert_eq!(
        send(&mut ring, 9 * MS, &[(4, 0x1003, 0, &[0])])[0].2,
        1,
        "it has kept its address"
    );
    ring.begin_fault(10 * MS, FaultKind::Gone, 2, Some(5 * MS));
    assert_eq!(count(&mut ring, 11 * MS), Some(2));
    assert_eq!(count(&mut ring, 16 * MS), Some(4));
    assert_eq!(
        send(&mut ring, 16 * MS, &[(4, 0x1003, 0, &[0])])[0].2,
        0,
        "it has started again"
    );
    ring.begin_fault(20 * MS, FaultKind::Break, 0, None);
    assert_eq!(count(&mut ring, 21 * MS), None);
}

/// An incremental encoder loses its count with its supply.
#[test]
fn drive_without_supply_restarts_at_0_unless_absolute() {
    for absolute in [false, true] {
        let settings = DriveSettings {
            start_turns: 3.5,
            start_increments: 12_345,
            absolute,
            ..DriveSettings::default()
        };
        let mut ring = Ring::new(vec![SubDevice::drive(settings, 1, 0.0)], 0);
        let read = |ring: &Ring| {
            let drive = ring.devices()[0].as_drive().expect("a drive");
            (drive.position(), drive.motor_turns())
        };
        let (before, turns) = read(&ring);
        assert_eq!(before, 12_345);
        ring.begin_fault(2 * MS, FaultKind::Gone, 0, Some(5 * MS));
        for now_ms in 1..20 {
            ring.advance(now_ms * MS);
        }
        let (after, turned) = read(&ring);
        assert!((turned - turns).abs() < 1e-6, "the motor stands");
        assert_eq!(after, if absolute { before } else { 0 });
    }
}

#[test]
fn frames_are_lost_late_and_overtaken() {
    let mut ring = ring();
    let order = |number: u8| frame(&[(7, 0, 0x0000, [number].as_slice())]);
    ring.begin_fault(MS, FaultKind::Loss, 0, Some(MS));
    assert!(ring.exchange(MS, order(0)).is_empty());
    ring.begin_fault(3 * MS, FaultKind::Delay, 0, Some(MS));
    assert_eq!(ring.exchange(3 * MS, order(0))[0].due_ns, 8 * MS);
    ring.begin_fault(5 * MS, FaultKind::Reorder, 0, Some(MS));
    let (mut first, mut second) = (order(0), order(0));
    (first[17], second[17]) = (1, 2);
    assert!(ring.exchange(5 * MS, first).is_empty());
    let indices: Vec<u8> = ring
        .exchange(5 * MS, second)
        .iter()
        .map(|returned| returned.frame[17])
        .collect();
    assert_eq!(indices, [2, 1]);
}

/// Random frames, independent of the code, and frames with a valid beginning and a random rest.
#[test]
fn no_frame_whatever_is_in_it_stops_the_ring() {
    let mut ring = ring();
    let mut generator = evolvent_random::Random::from_state(0x9E37_79B9_7F4A_7C15);
    let mut random = move || generator.bits();
    for i in 0..20_000_u64 {
        let length = (random() % 120) as usize;
        let mut bytes: Vec<u8> = (0..length).map(|_| random() as u8).collect();
        if i % 4 != 0 {
            let command = (random() % 16) as u8;
            let position = [0, 0xFFFF, 0xFFFE, 0x1001][(random() % 4) as usize];
            let offset = (random() % 0x3100) as u16;
            bytes = frame(&[(command, position, offset, &bytes)]);
        }
        if i % 16 == 3 {
            bytes.truncate((random() % 40) as usize);
        }
        let _returned = ring.exchange(i * 10_000, bytes);
    }
    assert!(ring.frames() > 10_000);
}
