//! Foreign clients on the simulated board, over real sockets: Debian's `mesaflash` and LinuxCNC's `hm2_eth`.
//!
//! They need the packages `mesaflash` and `linuxcnc-uspace`, `iptables`, and the right to create network
//! namespaces. If the packages are not installed, EVOLVENT_LINUXCNC names the folder of `tools/get-linuxcnc`,
//! which has them unpacked.

#![expect(clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "a test")]

use std::collections::BTreeSet;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};
use std::sync::Mutex;

use evolvent_bridge_trial::{TrialCore, with_bridge};
use evolvent_ethercat_ring::{await_carrier, ip, own_namespace};
use evolvent_machine::Machine;
use evolvent_mesa::{BoardSettings, RunSettings, run};
use evolvent_mesa_board::{Board, BoardModel, BoardServer, PORT, now_ns};

/// Address of the client and of the board, and of the board's interface as its EEPROM has it: `hm2_eth` takes
/// it from there.
const CLIENT: &str = "10.27.0.1/24";
const BOARD: &str = "10.27.0.2";
const MAC: &str = "00:60:1b:20:00:01";

/// Creates a board in its own namespace, connected by a cable to the namespace of the calling thread.
fn board_behind_cable(model: BoardModel) -> Result<BoardServer, String> {
    own_namespace()?;
    for arguments in [
        "link add hm0 type veth peer name hm1",
        "link set hm1 address 00:60:1b:20:00:01",
        "link set lo up",
    ] {
        ip(&arguments.split(' ').collect::<Vec<_>>())?;
    }
    ip(&["addr", "add", CLIENT, "dev", "hm0"])?;
    let (thread_sender, thread_receiver) = std::sync::mpsc::channel();
    let (ready_sender, ready) = std::sync::mpsc::channel();
    // A socket stays in the namespace of the thread that opened it.
    let other = std::thread::spawn(move || {
        own_namespace()?;
        // SAFETY: no memory is concerned.
        let thread = unsafe { libc::gettid() };
        thread_sender.send(thread).map_err(|error| error.to_string())?;
        ready.recv().map_err(|error| error.to_string())?;
        ip(&["addr", "add", &format!("{BOARD}/24"), "dev", "hm1"])?;
        ip(&["link", "set", "hm1", "up"])?;
        std::net::UdpSocket::bind((BOARD, PORT)).map_err(|error| error.to_string())
    });
    if let Ok(thread) = thread_receiver.recv() {
        ip(&["link", "set", "hm1", "netns", &thread.to_string()])?;
        ready_sender.send(()).map_err(|error| error.to_string())?;
    }
    let socket = other.join().map_err(|_| "the board's thread".to_owned())??;
    ip(&["link", "set", "hm0", "up"])?;
    await_carrier(&["hm0"]);
    assert!(MAC.starts_with("00:60:1b"), "Mesa's");
    BoardServer::with_socket(Board::new(model, now_ns()), socket).map_err(|error| error.to_string())
}

fn is_installed(program: &str) -> bool {
    std::env::var_os("PATH").is_some_and(|path| {
        std::env::split_paths(&path)
            .chain(["/usr/sbin".into()])
            .any(|folder| folder.join(program).exists())
    })
}

/// The script that runs commands with the unpacked programs, if this program is one of them.
fn unpacked(program: &str) -> Option<PathBuf> {
    let folder = PathBuf::from(std::env::var_os("EVOLVENT_LINUXCNC")?);
    let has = |part: &str| folder.join("programs/usr").join(part).join(program).exists();
    let script = folder.join("with-programs");
    // Not every user may overlay the programs on the system's.
    let runs = || {
        Command::new(&script)
            .arg("true")
            .status()
            .is_ok_and(|status| status.success())
    };
    ((has("bin") || has("sbin")) && runs()).then_some(script)
}

/// `timeout` over one of these programs, installed or unpacked.
fn timeout(options: &[&str], program: &str) -> Command {
    let mut command = match unpacked(program) {
        Some(script) if !is_installed(program) || !is_installed("iptables") => {
            let mut command = Command::new(script);
            command.arg("timeout");
            command
        }
        _ => Command::new("timeout"),
    };
    command.args(options).arg(program);
    command
}

/// Runs a test with a board in a namespace, on its own thread. Returns `None` and prints a message if that is
/// not possible.
fn on_cable<R: Send + 'static>(
    model: BoardModel,
    programs: &'static [&'static str],
    test: impl FnOnce(&BoardServer) -> R + Send + 'static,
) -> Option<R> {
    for program in programs {
        if !is_installed(program) && unpacked(program).is_none() {
            println!("not measured: {program} is not installed");
            return None;
        }
    }
    let thread = std::thread::spawn(move || match board_behind_cable(model) {
        Ok(server) => Some(test(&server)),
        Err(why) => {
            println!("not measured: {why}");
            None
        }
    });
    thread
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

fn text(output: &Output) -> String {
    let both = [output.stdout.as_slice(), output.stderr.as_slice()].concat();
    String::from_utf8_lossy(&both).into_owned()
}

#[test]
fn mesaflash_reads_modules_and_pins() {
    for (model, device, modules) in [
        (BoardModel::B7i96s, "7i96s", "StepGen"),
        (BoardModel::B7i92, "7i92", "StepGen"),
        (BoardModel::B7i97, "7i97", "PWM"),
    ] {
        on_cable(model, &["mesaflash"], move |_| {
            let output = timeout(&["20"], "mesaflash")
                .args(["--device", device, "--addr", BOARD, "--readhmid"])
                .output()
                .expect("mesaflash to start");
            let output_text = text(&output);
            assert!(output.status.success(), "{output_text}");
            for wanted in [
                "Clock Low frequency: 100.0000 MHz",
                "WatchDog",
                "IOPort",
                "QCount",
                modules,
            ] {
                assert!(output_text.contains(wanted), "{wanted}: {output_text}");
            }
            let pins = output_text.matches("IOPort ").count();
            assert!(pins >= 34, "{pins} pins: {output_text}");
        });
    }
}

/// A HAL file that connects to the board in a 5 ms thread, then runs `lines`.
fn prepared(board: &str, watchdog_ns: u64, lines: &str) -> String {
    format!(
        "loadrt hostmot2\n\
         loadrt hm2_eth board_ip={BOARD}\n\
         loadrt threads name1=t period1=5000000\n\
         addf hm2_{board}.0.read t\n\
         addf hm2_{board}.0.write t\n\
         setp hm2_{board}.0.watchdog.timeout_ns {watchdog_ns}\n\
         setp hm2_{board}.0.packet-error-limit 1000\n\
         {lines}"
    )
}

/// Runs `hm2_eth` with a HAL file. It runs as another user, as LinuxCNC does if root starts it.
fn hal(file: &str) -> Output {
    // One LinuxCNC per host: its real-time process and shared memory have fixed names.
    static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
    let _only = ONE_AT_A_TIME.lock();
    let folder = std::env::temp_dir().join(format!("evolvent-hal-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o777)).expect("its rights");
    let path = folder.join("test.hal");
    std::fs::write(&path, file).expect("a file");
    let output = timeout(&["-k", "2", "40"], "halrun")
        .arg("-f")
        .arg(&path)
        .current_dir(&folder)
        .env("RTAPI_UID", "65534")
        .env("HOME", &folder)
        .env("RTAPI_FIFO_PATH", folder.join("fifo"))
        .stdin(Stdio::null())
        .output()
        .expect("halrun to start");
    let _left = std::fs::remove_dir_all(&folder);
    output
}

/// The output of `getp` after a mark.
fn printed<'a>(output_text: &'a str, mark: &str) -> &'a str {
    let rest = output_text.split(mark).nth(1).unwrap_or_default();
    rest.lines().nth(1).unwrap_or_default().trim()
}

/// The output of `getp` after a mark, as a number.
fn after(output_text: &str, mark: &str) -> f64 {
    let text = printed(output_text, mark);
    text.parse()
        .unwrap_or_else(|_| panic!("no number after {mark}: {output_text}"))
}

/// Runs `hm2_eth`, and repeats the run if the host disturbed it: on a busy host it may time out waiting for a
/// packet.
fn hal_in_time(file: &str) -> String {
    let mut output_text = String::new();
    for _ in 0..5 {
        let output = hal(file);
        output_text = text(&output);
        if output.status.success() && !output_text.contains("Resource temporarily unavailable") {
            return output_text;
        }
        println!("again: {output_text}");
    }
    panic!("hm2_eth did not run: {output_text}");
}

/// Registers read and written from one feeding of the watchdog to the next, as in most cycles.
fn per_cycle(log: &[(u16, bool)]) -> (usize, usize) {
    let cycles = log.split(|access| *access == (0x0E00, true));
    let mut counts: Vec<(usize, usize)> = cycles
        .map(|cycle| {
            let writes = cycle.iter().filter(|(_, is_write)| *is_write).count();
            (cycle.len() - writes, writes + 1)
        })
        .collect();
    counts.sort_unstable();
    counts.get(counts.len() / 2).copied().unwrap_or_default()
}

#[test]
fn hm2_eth_drives_steps_pins_and_watchdog() {
    const HAL: &str = "\
setp hm2_7i96s.0.stepgen.00.control-type 1
setp hm2_7i96s.0.stepgen.00.position-scale 100
setp hm2_7i96s.0.stepgen.00.maxaccel 0
setp hm2_7i96s.0.stepgen.00.steplen 2000
setp hm2_7i96s.0.stepgen.00.stepspace 3000
setp hm2_7i96s.0.stepgen.00.dirsetup 4000
setp hm2_7i96s.0.stepgen.00.dirhold 5000
setp hm2_7i96s.0.stepgen.00.velocity-cmd 50
setp hm2_7i96s.0.stepgen.00.enable 1
setp hm2_7i96s.0.ssr.00.out-00 1
start
loadusr -w sleep 1
setp hm2_7i96s.0.stepgen.00.velocity-cmd -20
loadusr -w sleep 0.5
setp hm2_7i96s.0.stepgen.00.enable 0
loadusr -w sleep 0.2
loadusr -w echo counts
getp hm2_7i96s.0.stepgen.00.counts
loadusr -w echo wired
getp hm2_7i96s.0.stepgen.00.position-fb
";
    const PROGRAMS: [&str; 2] = ["halrun", "iptables"];
    on_cable(BoardModel::B7i96s, &PROGRAMS, |server| {
        // On a busy host the client may time out waiting for a packet.
        let mut output_text = String::new();
        for _ in 0..5 {
            server.lock().keep_log();
            let begin = server.lock().motor_steps(0);
            let output = hal(&prepared("7i96s", 200_000_000, HAL));
            output_text = text(&output);
            if output_text.contains("Resource temporarily unavailable") || !output.status.success() {
                println!("again: {output_text}");
                continue;
            }
            let board = server.lock();
            let counts = after(&output_text, "counts");
            let moved = board.motor_steps(0) - begin;
            assert!((moved - counts).abs() <= 1.0, "motor {moved}, hm2_eth {counts}");
            assert!(counts > 1000.0, "about 4000 steps: {counts}");
            assert!(
                (after(&output_text, "wired") * 100.0 - counts).abs() <= 1.0,
                "{output_text}"
            );
            assert_eq!(
                board.step_times_ns(0)[..2],
                [2010, 3010],
                "the map says N + 1 clocks"
            );
            assert_eq!(board.step_times_ns(0)[2..], [4000, 5000]);
            assert_eq!(board.motor_stalls(0), 0);
            let traffic = board.traffic();
            assert!(traffic.feeds > 100, "{traffic:?}");
            assert_eq!(traffic.refused, 0, "{traffic:?}");
            println!("{traffic:?}");
            drop(board);
            let log = server.lock().take_log();
            let (reads, writes) = per_cycle(&log);
            println!("hm2_eth: {reads} registers read and {writes} written in a cycle");
            assert!(reads >= 8, "three ports and five accumulators, at least: {reads}");
            std::thread::sleep(std::time::Duration::from_millis(400));
            assert!(
                server.lock().has_bitten(),
                "nobody feeds the watchdog any more, and it was set to 0.2 s"
            );
            assert!(!server.lock().is_driven(11));
            return;
        }
        panic!("hm2_eth did not run: {output_text}");
    });
}

/// Filtered inputs and isolated outputs, whose registers must match `hm2_eth`'s.
#[test]
fn hm2_eth_closes_isolated_outputs_and_reads_inputs() {
    const HAL: &str = "\
setp hm2_7i96s.0.ssr.00.out-03 1
setp hm2_7i96s.0.outm.00.out-04 1
start
loadusr -w sleep 0.5
loadusr -w echo closed
getp hm2_7i96s.0.inm.00.input-03
loadusr -w echo other
getp hm2_7i96s.0.inm.00.input-04
loadusr -w echo simple
getp hm2_7i96s.0.inm.00.input-05
loadusr -w echo unused
getp hm2_7i96s.0.inm.00.input-06
loadusr -w echo raw
getp hm2_7i96s.0.inm.00.raw-input-03
setp hm2_7i96s.0.ssr.00.out-03 0
loadusr -w sleep 0.3
loadusr -w echo again
getp hm2_7i96s.0.inm.00.input-03
";
    on_cable(BoardModel::B7i96s, &["halrun", "iptables"], |server| {
        // SSR 3 lets current flow through input 3, whose pin is low then; that of input 4 is low too. OutM
        // does the same to input 5. `hm2_eth` sets the global inversion of the filter, so such inputs are
        // true for it.
        server.lock().wire(14, 3);
        server.lock().wire(15, 5);
        server.lock().set_level(4, false);
        server.lock().keep_log();
        let output_text = hal_in_time(&prepared("7i96s", 500_000_000, HAL));
        let log = server.lock().take_log();
        println!("{output_text}");
        for (mark, wanted) in [
            ("closed", "TRUE"),
            ("other", "TRUE"),
            ("simple", "TRUE"),
            ("unused", "FALSE"),
            ("raw", "TRUE"),
            ("again", "FALSE"),
        ] {
            assert_eq!(printed(&output_text, mark), wanted, "{mark}: {output_text}");
        }
        for (address, is_write) in [
            (0x7D00, true),
            (0x7E00, true),
            (0x8500, true),
            (0x8600, true),
            (0x8700, false),
        ] {
            assert!(
                log.contains(&(address, is_write)),
                "{address:04X}h, written {is_write}"
            );
        }
        assert_eq!(server.lock().traffic().refused, 0);
    });
}

/// A 7I76 on smart serial, described by its own memory.
#[test]
fn hm2_eth_finds_the_field_io_of_a_7i76() {
    const HAL: &str = "\
setp hm2_7i76e.0.7i76.0.0.output-05 1
setp hm2_7i76e.0.7i76.0.0.spinout-maxlim 24000
setp hm2_7i76e.0.7i76.0.0.spinout-scalemax 24000
setp hm2_7i76e.0.7i76.0.0.spinout 6000
setp hm2_7i76e.0.7i76.0.0.spinena 1
start
loadusr -w sleep 0.5
loadusr -w echo wired
getp hm2_7i76e.0.7i76.0.0.input-07
loadusr -w echo other
getp hm2_7i76e.0.7i76.0.0.input-08
loadusr -w sleep 1
";
    on_cable(BoardModel::B7i76e, &["halrun", "iptables"], |server| {
        server.lock().wire_field(5, 7);
        let is_quarter = std::thread::scope(|scope| {
            let spindle = scope.spawn(|| {
                let begin = std::time::Instant::now();
                while begin.elapsed() < std::time::Duration::from_secs(200) {
                    let (duty, reverse, enabled) = server.lock().field_spindle();
                    if (duty - 0.25).abs() < 3e-4 && !reverse && enabled {
                        return true;
                    }
                    std::thread::sleep(std::time::Duration::from_millis(5));
                }
                false
            });
            let output_text = hal_in_time(&prepared("7i76e", 500_000_000, HAL));
            println!("{output_text}");
            assert_eq!(printed(&output_text, "wired"), "TRUE", "{output_text}");
            assert_eq!(printed(&output_text, "other"), "FALSE", "{output_text}");
            spindle.join().expect("no panic")
        });
        assert!(is_quarter, "the spindle's output was a quarter");
        assert_eq!(server.lock().traffic().refused, 0);
    });
}

/// `hm2_eth` arms the index of an encoder and reads the latched count: the count restarts at the edge, once.
#[test]
fn hm2_eth_latches_the_index_of_an_encoder() {
    for (rising, edge) in [(false, 1301), (true, 1300)] {
        let hal = format!(
            "setp hm2_7i97.0.encoder.00.scale 1\n\
             setp hm2_7i97.0.encoder.00.index-invert {}\n\
             start\n\
             loadusr -w sleep 0.5\n\
             setp hm2_7i97.0.encoder.00.index-enable 1\n\
             loadusr -w sleep 4\n\
             loadusr -w echo armed\n\
             getp hm2_7i97.0.encoder.00.index-enable\n\
             loadusr -w echo counted\n\
             getp hm2_7i97.0.encoder.00.count\n",
            u8::from(rising)
        );
        on_cable(BoardModel::B7i97, &["halrun", "iptables"], move |server| {
            server.lock().set_index(0, 1300);
            let stop = std::sync::atomic::AtomicBool::new(false);
            let output_text = std::thread::scope(|scope| {
                // One and a half turns after the driver has armed it.
                scope.spawn(|| {
                    let mut left = 0;
                    while !stop.load(std::sync::atomic::Ordering::Relaxed) {
                        let mut board = server.lock();
                        if board.index_is_armed(0) && left == 0 {
                            left = 200;
                        }
                        if left > 0 {
                            board.turn_shaft(0, 30.0);
                            left -= 1;
                        }
                        drop(board);
                        std::thread::sleep(std::time::Duration::from_millis(5));
                    }
                });
                let output_text = hal_in_time(&prepared("7i97", 500_000_000, &hal));
                stop.store(true, std::sync::atomic::Ordering::Relaxed);
                output_text
            });
            println!("{output_text}");
            assert_eq!(printed(&output_text, "armed"), "FALSE", "{output_text}");
            // The pulse is at 1300 counts of each turn of 4000, and the first one counts.
            let shaft = server.lock().shaft(0);
            let pulse = shaft - after(&output_text, "counted");
            println!("rising {rising}: pulse at {pulse}");
            assert_eq!((pulse as i64).rem_euclid(4000), edge, "{output_text}");
            assert_eq!(server.lock().traffic().refused, 0);
        });
    }
}

/// Registers read, and registers written.
type Registers = [BTreeSet<u16>; 2];

fn registers(log: &[(u16, bool)]) -> Registers {
    let of = |written: bool| {
        let accesses = log.iter().filter(|(_, is_write)| *is_write == written);
        accesses.map(|(address, _)| *address).collect()
    };
    [of(false), of(true)]
}

fn addresses_text(registers: &BTreeSet<u16>) -> String {
    let texts: Vec<_> = registers.iter().map(|address| format!("{address:04X}")).collect();
    texts.join(" ")
}

/// Our bridge and `hm2_eth` on the same board: both move step generator 0 and set an isolated output. Every
/// register that our bridge reads or writes is also read or written by `hm2_eth`, and each cycle of our
/// bridge is one packet with a reply and one without.
#[test]
fn bridge_uses_hm2_eth_registers_in_two_packets() {
    const HAL: &str = "\
setp hm2_7i96s.0.stepgen.00.control-type 1
setp hm2_7i96s.0.stepgen.00.position-scale 320
setp hm2_7i96s.0.stepgen.00.maxaccel 0
setp hm2_7i96s.0.stepgen.00.velocity-cmd 10
setp hm2_7i96s.0.stepgen.00.enable 1
setp hm2_7i96s.0.pwmgen.00.enable 1
setp hm2_7i96s.0.pwmgen.00.value 0.5
setp hm2_7i96s.0.ssr.00.out-00 1
start
loadusr -w sleep 1
";
    on_cable(BoardModel::B7i96s, &["halrun", "iptables"], |server| {
        server.lock().keep_log();
        let output_text = hal_in_time(&prepared("7i96s", 200_000_000, HAL));
        let log = server.lock().take_log();
        let of_hm2 = registers(&log);
        let (reads, writes) = per_cycle(&log);
        println!("hm2_eth: {reads} registers read and {writes} written in a cycle; {output_text}");

        let prefix = format!("mesafr{}_", std::process::id());
        let shipped = |file: &str| evolvent_file_tests::shipped(file);
        let machine = Machine::parse(&shipped("machines/router-3axis.toml"), "router").expect("a machine");
        let mut board = BoardSettings::parse(&shipped("boards/7i96s-router.toml"), "board").expect("a board");
        (board.address, board.max_lost_packets, board.watchdog_s) =
            (BOARD.parse().expect("an address"), 40, 0.5);
        let settings = RunSettings {
            machine,
            machine_name: Some("mesa-foreign".to_owned()),
            board,
            prefix: Some(prefix.clone()),
            duration: None,
        };
        let _before = server.lock().take_log();
        let (mut cycle_log, mut counts) = (Vec::new(), [0; 2]);
        with_bridge(
            &prefix,
            |stop, messages| run(&settings, stop, |text| messages.push(text)),
            TrialCore::open("mesa-foreign", &prefix),
            |core, _messages| {
                core.bring_up();
                core.velocity_x = 20.0;
                let begin = server.lock().traffic();
                core.rest(1.0);
                let end = server.lock().traffic();
                counts = [end.packets - begin.packets, end.feeds - begin.feeds];
                cycle_log = server.lock().take_log();
                core.stop();
            },
        );
        let ours = registers(&cycle_log);
        let (reads, writes) = per_cycle(&cycle_log);
        println!(
            "our bridge: {reads} registers read and {writes} written in a cycle; {counts:?} packets and feeds"
        );
        for (direction, (theirs, ours)) in ["read", "written"].iter().zip(of_hm2.iter().zip(&ours)) {
            println!("{direction} by both: {}", addresses_text(&(theirs & ours)));
            println!(
                "{direction} by hm2_eth alone: {}",
                addresses_text(&(theirs - ours))
            );
            println!(
                "{direction} by our bridge alone: {}",
                addresses_text(&(ours - theirs))
            );
        }
        for (direction, (theirs, ours)) in ["read", "written"].iter().zip(of_hm2.iter().zip(&ours)) {
            let alone = ours - theirs;
            assert!(
                alone.is_empty(),
                "{direction} by our bridge alone: {}",
                addresses_text(&alone)
            );
        }
        // The rates, the ports and the watchdog are in every cycle of both.
        for address in [0x2000, 0x1000, 0x0E00] {
            assert!(
                of_hm2[1].contains(&address) && ours[1].contains(&address),
                "{address:04X}h"
            );
        }
        // A cycle may be in progress at the beginning and at the end.
        let [packets, feeds] = counts;
        assert!(feeds > 300, "{feeds} cycles");
        assert!(
            packets.abs_diff(2 * feeds) <= 2,
            "{packets} packets in {feeds} cycles"
        );
    });
}
