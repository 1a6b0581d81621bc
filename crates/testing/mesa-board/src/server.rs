//! The board on a UDP socket.

use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::board::Board;

/// The port of LBP16.
pub const PORT: u16 = 27181;
/// Maximum wait for a packet: the watchdog and delayed replies are handled in between.
const PATIENCE: Duration = Duration::from_millis(1);

/// A board that other threads can access while it is served.
pub type SharedBoard = Arc<Mutex<Board>>;

/// Time since the first call in this process, ns.
#[must_use]
pub fn now_ns() -> u64 {
    static BEGIN: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    BEGIN.get_or_init(Instant::now).elapsed().as_nanos() as u64 + 1
}

/// Serves a board until `stop` is set.
///
/// # Errors
/// The socket fails.
pub fn serve(board: &Mutex<Board>, socket: &UdpSocket, stop: &AtomicBool) -> std::io::Result<()> {
    raise_priority();
    socket.set_read_timeout(Some(PATIENCE))?;
    let mut packet = [0; 2048];
    let mut peer: Option<SocketAddr> = None;
    while !stop.load(Ordering::Relaxed) {
        let received = socket.recv_from(&mut packet);
        let mut board = board.lock().unwrap_or_else(PoisonError::into_inner);
        if let Ok((length, from)) = received {
            peer = Some(from);
            board.receive(now_ns(), &packet[..length], |reply| {
                // A reply that cannot be sent is lost, as on any wire.
                let _lost = socket.send_to(reply, from);
            });
        }
        board.due(now_ns(), |reply| {
            if let Some(peer) = peer {
                let _lost = socket.send_to(reply, peer);
            }
        });
    }
    Ok(())
}

/// Sets `SCHED_FIFO` for the calling thread, if the system permits it: a real board replies within
/// microseconds, independent of this computer's load.
fn raise_priority() {
    let parameters = libc::sched_param { sched_priority: 20 };
    // SAFETY: the parameters live through the call; 0 is the calling thread.
    let _allowed = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) };
}

/// Serves a board on a thread until it is dropped.
#[derive(Debug)]
pub struct BoardServer {
    /// The board.
    pub board: SharedBoard,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl BoardServer {
    /// Starts the server at an address of this computer.
    ///
    /// # Errors
    /// The address is not of this computer, or is taken.
    pub fn start(board: Board, address: IpAddr) -> std::io::Result<Self> {
        Self::with_socket(board, UdpSocket::bind((address, PORT))?)
    }

    /// Starts the server on a socket that was opened elsewhere, for example in another network namespace.
    ///
    /// # Errors
    /// No thread can be started.
    pub fn with_socket(board: Board, socket: UdpSocket) -> std::io::Result<Self> {
        let board = Arc::new(Mutex::new(board));
        let stop = Arc::new(AtomicBool::new(false));
        let thread = std::thread::Builder::new().name("mesa-board".to_owned()).spawn({
            let (board, stop) = (Arc::clone(&board), Arc::clone(&stop));
            move || {
                // A failed socket acts like a disconnected board.
                let _gone = serve(&board, &socket, &stop);
            }
        })?;
        Ok(Self {
            board,
            stop,
            thread: Some(thread),
        })
    }

    /// The board, locked.
    pub fn lock(&self) -> std::sync::MutexGuard<'_, Board> {
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for BoardServer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ended = thread.join();
        }
    }
}
