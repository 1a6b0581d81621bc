//! A bench for tests: a network namespace with a virtual cable and the ring at one end.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use crate::namespace::{await_carrier, ip, own_namespace};
use crate::ring::Ring;
use crate::run::{monotonic_ns, run};
use crate::socket::PacketSocket;
use crate::subdevice::SubDevice;

/// The end of the cable for the MainDevice.
pub const MAIN_INTERFACE: &str = "ec0";
/// The ring's end.
const RING_INTERFACE: &str = "ec1";

/// The ring on the bench.
pub type SharedRing = Arc<Mutex<Ring>>;

/// Runs a test on its own thread, in a network namespace that ends with it. Processes that the test starts
/// see the same interfaces. Returns `None` and prints a message if this user may not create namespaces or
/// interfaces.
///
/// # Panics
/// If the test panics, or the virtual cable gets no carrier.
pub fn on_bench<R: Send + 'static>(
    devices: Vec<SubDevice>,
    test: impl FnOnce(&SharedRing) -> R + Send + 'static,
) -> Option<R> {
    let thread = std::thread::spawn(move || {
        if let Err(why) = make_cable() {
            let _written = std::io::Write::write_all(
                &mut std::io::stdout(),
                format!("not measured: {why}\n").as_bytes(),
            );
            return None;
        }
        let socket = PacketSocket::open(RING_INTERFACE).ok()?;
        let ring = Arc::new(Mutex::new(Ring::new(devices, monotonic_ns())));
        let stop = Arc::new(AtomicBool::new(false));
        let server = std::thread::spawn({
            let (ring, stop) = (Arc::clone(&ring), Arc::clone(&stop));
            move || run(&ring, &socket, &stop)
        });
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| test(&ring)));
        stop.store(true, Ordering::Relaxed);
        let _ended = server.join();
        match result {
            Ok(result) => Some(result),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    });
    thread
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// Creates a namespace for this thread, with a pair of virtual interfaces that are up.
fn make_cable() -> Result<(), String> {
    own_namespace()?;
    ip(&[
        "link",
        "add",
        "name",
        MAIN_INTERFACE,
        "type",
        "veth",
        "peer",
        "name",
        RING_INTERFACE,
    ])?;
    for interface in [MAIN_INTERFACE, RING_INTERFACE] {
        // No other protocol may send frames here.
        let path = format!("/proc/sys/net/ipv6/conf/{interface}/disable_ipv6");
        let _ignored = std::fs::write(path, "1");
        ip(&["link", "set", interface, "up"])?;
    }
    await_carrier(&[MAIN_INTERFACE, RING_INTERFACE]);
    Ok(())
}
