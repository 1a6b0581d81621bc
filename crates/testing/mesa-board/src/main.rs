//! `mesa-board`: the simulated board at an address of this computer, started by hand.

use std::io::Write;
use std::net::{IpAddr, UdpSocket};
use std::process::ExitCode;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

use clap::{Parser, ValueEnum};
use evolvent_mesa_board::{Board, BoardModel, Fault, PORT, Spindle, SpindleCommand, Switch, now_ns, serve};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// A TEST SIMULATOR: a Mesa Ethernet board with HostMot2 at an address of this computer, UDP port 27181.
///
/// Every address 127.x.y.z is one of this computer, so nothing needs to be set up.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    /// The address.
    #[arg(long, value_name = "ADDRESS", default_value = "127.27.1.1")]
    address: IpAddr,
    /// The board.
    #[arg(long, value_enum, default_value = "7i96s")]
    model: Model,
    /// A spindle of this speed, rpm, at full output: encoder 0 with 4096 counts on its shaft, its speed on
    /// PWM generator 0, or of a 7i76e on smart serial; of a 7i96s with contacts for the directions at pins 15
    /// and 16, and one at pin 3 that is closed while its drive is in order; else by the sign.
    #[arg(long, value_name = "RPM")]
    spindle: Option<f64>,
    /// A fault, and its time in seconds after the watchdog was first fed: loss-in, loss-out, half, delay,
    /// reorder, bite, reset, cookie, short, index-missing, field-off, spindle-stall, encoder-off or
    /// lost-counts. May be given several times.
    #[arg(long = "fault", value_name = "KIND@SECONDS[+DURATION]")]
    faults: Vec<Fault>,
    /// A switch: a pin (of a 7i76e a field input) is low while the motor of a step generator is at or beyond
    /// this number of steps from its start; negative ones are passed downward. May be given several times.
    #[arg(long = "switch", value_name = "INPUT:STEPGEN:STEPS")]
    switches: Vec<Switch>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Model {
    /// 5 step generators, 1 encoder.
    #[value(name = "7i92")]
    B7i92,
    /// 11 inputs with filters, 4 isolated and 2 other outputs, 5 step generators, 1 encoder, 1 PWM.
    #[value(name = "7i96s")]
    B7i96s,
    /// 5 step generators, 1 encoder, field I/O of a 7I76 by smart serial.
    #[value(name = "7i76e")]
    B7i76e,
    /// 6 encoders, 6 PWM.
    #[value(name = "7i97")]
    B7i97,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // If standard error is closed, the message cannot be shown.
            let _written = writeln!(std::io::stderr(), "error: {error}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &Arguments) -> std::io::Result<()> {
    let model = match arguments.model {
        Model::B7i92 => BoardModel::B7i92,
        Model::B7i96s => BoardModel::B7i96s,
        Model::B7i76e => BoardModel::B7i76e,
        Model::B7i97 => BoardModel::B7i97,
    };
    let mut board = Board::new(model, now_ns());
    if let Some(full_rpm) = arguments.spindle {
        if model == BoardModel::B7i96s {
            // Current through an isolated input makes it low.
            board.set_level(3, false);
        }
        let command = match model {
            BoardModel::B7i76e => SpindleCommand::Field,
            BoardModel::B7i96s => SpindleCommand::Contacts {
                unit: 0,
                forward: 15,
                reverse: 16,
            },
            BoardModel::B7i92 | BoardModel::B7i97 => SpindleCommand::SignedPwm { unit: 0 },
        };
        board.set_spindle(Spindle {
            full_rpm,
            ..Spindle::usual(0, command)
        });
    }
    for switch in &arguments.switches {
        board.add_switch(*switch);
    }
    for fault in &arguments.faults {
        board.add_fault(*fault);
    }
    let address = arguments.address;
    let socket = UdpSocket::bind((address, PORT)).map_err(|error| {
        std::io::Error::new(
            error.kind(),
            format!("{address}:{PORT} cannot be opened: {error}"),
        )
    })?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    writeln!(
        std::io::stderr(),
        "test simulator: {} at {address}:{PORT}",
        model.card_name()
    )?;
    let board = Mutex::new(board);
    serve(&board, &socket, &stop)?;
    let traffic = board
        .into_inner()
        .unwrap_or_else(PoisonError::into_inner)
        .traffic();
    writeln!(std::io::stderr(), "{traffic:?}")
}
