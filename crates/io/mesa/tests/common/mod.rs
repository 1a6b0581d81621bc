//! Boards at addresses of this computer, and the bridge on a thread.

pub(crate) mod core;

use std::net::IpAddr;
use std::sync::atomic::{AtomicU8, Ordering};

use evolvent_bridge_test::ThreadBridge;
use evolvent_machine::Machine;
use evolvent_mesa::{BoardSettings, RunSettings, run};
use evolvent_mesa_board::{Board, BoardModel, BoardServer, now_ns};

/// A board of its own: every address 127.x.y.z is one of this computer.
pub(crate) fn serve(model: BoardModel) -> (BoardServer, IpAddr) {
    static NEXT: AtomicU8 = AtomicU8::new(1);
    let process = std::process::id();
    let last = NEXT.fetch_add(1, Ordering::Relaxed);
    let address = IpAddr::from([127, 32 + (process >> 8) as u8 % 128, process as u8, last]);
    let server =
        BoardServer::start(Board::new(model, now_ns()), address).expect("an address of this computer");
    (server, address)
}

pub(crate) fn machine(name: &str) -> Machine {
    let text = evolvent_file_tests::shipped(&format!("machines/{name}.toml"));
    Machine::parse(&text, name).expect("a machine")
}

/// The shipped router's board at another address.
pub(crate) fn router(address: IpAddr) -> BoardSettings {
    let text = evolvent_file_tests::shipped("boards/7i96s-router.toml");
    let mut board = BoardSettings::parse(&text, "7i96s-router.toml").expect("a board file");
    board.address = address;
    board
}

/// The shipped router with a 7I76E at another address.
pub(crate) fn field_router(address: IpAddr) -> BoardSettings {
    let text = evolvent_file_tests::shipped("boards/7i76e-router.toml");
    let mut board = BoardSettings::parse(&text, "7i76e-router.toml").expect("a board file");
    board.address = address;
    board
}

/// The bridge on a thread of this process.
pub(crate) fn mesa_bridge(machine: Machine, board: BoardSettings) -> ThreadBridge {
    ThreadBridge::new(move |machine_name, prefix, stop| {
        let settings = RunSettings {
            machine: machine.clone(),
            machine_name: Some(machine_name.to_owned()),
            board: board.clone(),
            prefix: Some(prefix.to_owned()),
            duration: None,
        };
        let report = run(&settings, stop, |text| println!("{text}")).expect("a bridge that runs");
        println!("{report:?}");
    })
}
