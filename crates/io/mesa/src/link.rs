//! The socket to a board.

use core::time::Duration;
use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::os::fd::AsRawFd;

use thiserror::Error;

use crate::description::{Description, DescriptionError, Registers};
use crate::packet::{MAX_PACKET, Packet, PacketFull, Reply, Space};

/// The port of LBP16.
pub const PORT: u16 = 27181;
/// How long a board may take while it is explored, and how often it is asked.
const PATIENCE: Duration = Duration::from_millis(100);
const ATTEMPTS: u32 = 5;

/// Why a board cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum LinkError {
    /// The socket.
    #[error("no socket to {address}: {cause}; check the address and the interface that leads there")]
    Socket {
        /// The board's address.
        address: IpAddr,
        /// What the system said.
        cause: String,
    },
    /// Nobody answers.
    #[error(
        "no board replies at {address}: check supply, cable, and that this computer has an address of the \
         same network; boards \
         come with 192.168.1.121 or 10.10.10.10, by jumper"
    )]
    Silent {
        /// The board's address.
        address: IpAddr,
    },
    /// What it says makes no board.
    #[error(transparent)]
    Description(#[from] DescriptionError),
    /// More than a packet holds.
    #[error(transparent)]
    Full(#[from] PacketFull),
}

/// A socket that speaks with one board.
#[derive(Debug)]
pub struct Link {
    socket: UdpSocket,
    address: IpAddr,
}

impl Link {
    /// A socket for a board at an address.
    ///
    /// # Errors
    /// There is no way to that address.
    pub fn open(address: IpAddr) -> Result<Self, LinkError> {
        let failed = |error: std::io::Error| LinkError::Socket {
            address,
            cause: error.to_string(),
        };
        let any: SocketAddr = match address {
            IpAddr::V4(_) => ([0, 0, 0, 0], 0).into(),
            IpAddr::V6(_) => ([0_u16; 8], 0).into(),
        };
        let socket = UdpSocket::bind(any).map_err(failed)?;
        socket.connect((address, PORT)).map_err(failed)?;
        socket.set_nonblocking(true).map_err(failed)?;
        Ok(Self { socket, address })
    }

    /// The board's address.
    #[must_use]
    pub const fn address(&self) -> IpAddr {
        self.address
    }

    /// Sends a packet. What does not leave is lost, as on any wire.
    pub fn send(&self, packet: &Packet) {
        let _lost = self.socket.send(packet.bytes());
    }

    /// The next packet that has come, if one has.
    pub fn receive<'b>(&self, buffer: &'b mut [u8; MAX_PACKET + 8]) -> Option<&'b [u8]> {
        loop {
            match self.socket.recv(buffer) {
                Ok(length) => return Some(&buffer[..length]),
                // Told where nobody listens; what is there behind it is read next.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
                Err(_) => return None,
            }
        }
    }

    /// Waits until a packet has come, at most so long.
    pub fn wait(&self, longest: Duration) {
        let mut polled = libc::pollfd {
            fd: self.socket.as_raw_fd(),
            events: libc::POLLIN,
            revents: 0,
        };
        let time = libc::timespec {
            tv_sec: longest.as_secs() as libc::time_t,
            tv_nsec: libc::c_long::from(longest.subsec_nanos()),
        };
        // Interrupted by a signal it is asked again by the caller.
        // SAFETY: one descriptor and a time that live through the call; no signal mask.
        let _ready = unsafe { libc::ppoll(&raw mut polled, 1, &raw const time, core::ptr::null()) };
    }

    /// Sends a packet and waits for its reply, a few times. For what is not done in a cycle.
    ///
    /// # Errors
    /// No reply of the right length comes.
    pub fn ask(&self, packet: &Packet, take: impl FnOnce(Reply<'_>)) -> Result<(), LinkError> {
        let mut buffer = [0; MAX_PACKET + 8];
        while self.receive(&mut buffer).is_some() {}
        for _ in 0..ATTEMPTS {
            self.send(packet);
            let until = std::time::Instant::now() + PATIENCE;
            loop {
                let left = until.saturating_duration_since(std::time::Instant::now());
                if left.is_zero() {
                    break;
                }
                self.wait(left);
                if let Some(bytes) = self.receive(&mut buffer)
                    && bytes.len() == packet.reply_bytes()
                {
                    take(Reply::new(bytes));
                    return Ok(());
                }
            }
        }
        Err(LinkError::Silent {
            address: self.address,
        })
    }

    /// Asks a board what it is.
    ///
    /// # Errors
    /// It does not answer, or has no HostMot2.
    pub fn explore(&self) -> Result<Description, LinkError> {
        let mut packet = Packet::new();
        packet.read(Space::Board, 0, 8)?;
        let mut name = [0; 16];
        self.ask(&packet, |mut reply| {
            for pair in name.chunks_mut(2) {
                pair.copy_from_slice(&reply.word().to_le_bytes());
            }
        })?;
        let length = name.iter().position(|byte| *byte == 0).unwrap_or(16);
        let name = String::from_utf8_lossy(&name[..length])
            .trim()
            .escape_default()
            .to_string();
        Description::explore(name, &mut Asking(self))
    }
}

/// Registers that are asked for one packet at a time.
struct Asking<'a>(&'a Link);

impl Registers for Asking<'_> {
    type Error = LinkError;

    fn read(&mut self, address: u16, values: &mut [u32]) -> Result<(), LinkError> {
        let mut packet = Packet::new();
        packet.read(Space::HostMot2, address, values.len())?;
        self.0
            .ask(&packet, |mut reply| values.fill_with(|| reply.value()))
    }
}
