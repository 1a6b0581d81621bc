//! The description of a board, and the errors if there is no valid one.

use std::net::IpAddr;

use evolvent_mesa::{DescriptionError, Link, LinkError, tag};
use evolvent_mesa_board::{BoardModel, FaultKind};

use crate::common::serve;

#[test]
fn boards_are_described_as_they_are() {
    for (model, name, pins, steps, encoders, pwms) in [
        (BoardModel::B7i92, "7I92", 34, 5, 1, 0),
        (BoardModel::B7i96s, "7I96S", 51, 5, 1, 1),
        (BoardModel::B7i76e, "7I76E-16", 51, 5, 1, 0),
        (BoardModel::B7i97, "7I97", 51, 0, 6, 6),
    ] {
        let (_server, address) = serve(model);
        let board = Link::open(address)
            .and_then(|link| link.explore())
            .expect("a board");
        let count = |tag| board.module(tag).map_or(0, |module| module.instances);
        assert_eq!((board.name.as_str(), board.pins.len()), (name, pins));
        assert_eq!(
            [count(tag::STEP_GENERATOR), count(tag::ENCODER), count(tag::PWM)],
            [steps, encoders, pwms]
        );
        let module = board.module(tag::ENCODER).expect("encoders");
        assert_eq!(
            module.address(1, 2),
            0x3108,
            "control register of encoder 2, by the register map"
        );
        assert!(board.text().contains("watchdog"), "{}", board.text());
    }
}

#[test]
fn another_cookie_is_told() {
    let (server, address) = serve(BoardModel::B7i92);
    server.lock().fault_now(FaultKind::Cookie, None);
    let error = Link::open(address)
        .and_then(|link| link.explore())
        .expect_err("no HostMot2");
    assert_eq!(
        error,
        LinkError::Description(DescriptionError::Cookie { found: 0x1234_5678 })
    );
    assert!(error.to_string().contains("mesaflash"), "{error}");
}

#[test]
fn a_board_that_is_not_there_is_told() {
    let address = IpAddr::from([127, 0, 77, 77]);
    let error = Link::open(address)
        .and_then(|link| link.explore())
        .expect_err("nobody");
    assert_eq!(error, LinkError::Silent { address });
}

#[test]
fn lost_packets_are_asked_for_again() {
    let (server, address) = serve(BoardModel::B7i96s);
    server.lock().fault_now(FaultKind::Half, None);
    let board = Link::open(address)
        .and_then(|link| link.explore())
        .expect("a board");
    assert_eq!(board.name, "7I96S");
}
