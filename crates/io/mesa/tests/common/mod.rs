//! Boards at addresses of this computer, and the bridge on a thread.

pub(crate) mod core;

use std::net::IpAddr;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use evolvent_bridge_test::{BridgeUnderTest, StartError};
use evolvent_bus::remove_private_domain;
use evolvent_machine::Machine;
use evolvent_mesa::{BoardSettings, BridgeReport, RunSettings, run};
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

/// The messages of a bridge.
pub(crate) type Told = Mutex<Vec<String>>;

pub(crate) fn was_told(told: &Told, what: &str) -> bool {
    let told = told.lock().expect("no panic");
    told.iter().any(|text| text.contains(what))
}

/// Runs the bridge while a test uses a core of the same prefix. Leaves nothing behind, also if the test fails.
pub(crate) fn with_running<C>(
    settings: RunSettings,
    mut core: C,
    test: impl FnOnce(&mut C, &Told),
) -> BridgeReport {
    let prefix = settings.prefix.clone().expect("a prefix of its own");
    let (stop, told) = (Arc::new(AtomicBool::new(false)), Arc::new(Told::default()));
    let bridge = std::thread::spawn({
        let (stop, told) = (Arc::clone(&stop), Arc::clone(&told));
        move || {
            run(&settings, &stop, |text| {
                told.lock().expect("no panic").push(text.to_owned());
            })
        }
    });
    let result = catch_unwind(AssertUnwindSafe(|| test(&mut core, &told)));
    stop.store(true, Ordering::Relaxed);
    let report = bridge.join().expect("no panic");
    drop(core);
    let _swept = remove_private_domain(&prefix);
    println!("{told:#?} {report:?}");
    if let Err(panic) = result {
        resume_unwind(panic);
    }
    report.expect("a bridge that fits")
}

/// The bridge on a thread of this process.
pub(crate) struct MesaBridge {
    pub(crate) machine: Machine,
    pub(crate) board: BoardSettings,
    running: Option<(Arc<AtomicBool>, JoinHandle<BridgeReport>)>,
    pub(crate) report: BridgeReport,
}

impl MesaBridge {
    pub(crate) fn new(machine: Machine, board: BoardSettings) -> Self {
        Self {
            machine,
            board,
            running: None,
            report: BridgeReport::default(),
        }
    }
}

impl BridgeUnderTest for MesaBridge {
    fn start(&mut self, machine_name: &str, prefix: &str) -> Result<(), StartError> {
        self.end();
        let settings = RunSettings {
            machine: self.machine.clone(),
            machine_name: Some(machine_name.to_owned()),
            board: self.board.clone(),
            prefix: Some(prefix.to_owned()),
            duration: None,
        };
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            run(&settings, &flag, |text| println!("{text}")).expect("a bridge that runs")
        });
        self.running = Some((stop, thread));
        Ok(())
    }

    fn end(&mut self) {
        if let Some((stop, thread)) = self.running.take() {
            stop.store(true, Ordering::Relaxed);
            self.report = thread.join().expect("no panic");
            println!("{:?}", self.report);
        }
    }

    fn kill(&mut self) {
        self.end();
    }

    fn can_be_killed(&self) -> bool {
        false
    }

    fn is_running(&mut self) -> bool {
        self.running
            .as_ref()
            .is_some_and(|(_, thread)| !thread.is_finished())
    }
}
