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
/// Timeout of one request during discovery, and the number of attempts.
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
        /// The error of the operating system.
        cause: String,
    },
    /// No board replies.
    #[error(
        "no board replies at {address}: check supply, cable, and that this computer has an address of the \
         same network; boards \
         come with 192.168.1.121 or 10.10.10.10, by jumper"
    )]
    Silent {
        /// The board's address.
        address: IpAddr,
    },
    /// The data read are not a valid description.
    #[error(transparent)]
    Description(#[from] DescriptionError),
    /// The commands exceed a packet.
    #[error(transparent)]
    Full(#[from] PacketFull),
}

/// A socket connected to one board.
#[derive(Debug)]
pub struct Link {
    socket: UdpSocket,
    address: IpAddr,
}

impl Link {
    /// Opens a socket for the board at an address.
    ///
    /// # Errors
    /// There is no route to the address.
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

    /// Sends a packet. A packet that cannot be sent counts as lost.
    pub fn send(&self, packet: &Packet) {
        let _lost = self.socket.send(packet.bytes());
    }

    /// Returns the next received packet, if any.
    pub fn receive<'b>(&self, buffer: &'b mut [u8; MAX_PACKET + 8]) -> Option<&'b [u8]> {
        loop {
            match self.socket.recv(buffer) {
                Ok(length) => return Some(&buffer[..length]),
                // The board's port is closed (ICMP); a packet after this error is read next.
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => {}
                Err(_) => return None,
            }
        }
    }

    /// Waits for a packet, at most for the given time.
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
        // If a signal interrupts the call, the caller repeats it.
        // SAFETY: one descriptor and a time that live through the call; no signal mask.
        let _ready = unsafe { libc::ppoll(&raw mut polled, 1, &raw const time, core::ptr::null()) };
    }

    /// Sends a packet and waits for its reply, with retries. Not for use in the cycle.
    ///
    /// # Errors
    /// No reply of the expected length.
    pub fn request(&self, packet: &Packet, take: impl FnOnce(Reply<'_>)) -> Result<(), LinkError> {
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

    /// Reads the description of a board.
    ///
    /// # Errors
    /// The board does not reply, or has no HostMot2.
    pub fn explore(&self) -> Result<Description, LinkError> {
        let mut packet = Packet::new();
        packet.read(Space::Board, 0, 8)?;
        let mut name = [0; 16];
        self.request(&packet, |mut reply| {
            for pair in name.chunks_mut(2) {
                pair.copy_from_slice(&reply.word().to_le_bytes());
            }
        })?;
        let length = name.iter().position(|byte| *byte == 0).unwrap_or(16);
        let name = String::from_utf8_lossy(&name[..length])
            .trim()
            .escape_default()
            .to_string();
        Description::explore(name, &mut LinkRegisters(self))
    }
}

/// Register access with one packet per read.
struct LinkRegisters<'a>(&'a Link);

impl Registers for LinkRegisters<'_> {
    type Error = LinkError;

    fn read(&mut self, address: u16, values: &mut [u32]) -> Result<(), LinkError> {
        let mut packet = Packet::new();
        packet.read(Space::HostMot2, address, values.len())?;
        self.0
            .request(&packet, |mut reply| values.fill_with(|| reply.value()))
    }
}
