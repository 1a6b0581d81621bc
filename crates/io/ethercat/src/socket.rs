//! A raw socket for EtherCAT's frames on one network interface.

use std::ffi::CString;
use std::fs::File;
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::fs::MetadataExt as _;

use thiserror::Error;

/// EtherCAT's Ethernet type.
const ETHER_TYPE: u16 = 0x88A4;
/// The packet sockets of this network namespace, one per line.
const PACKET_SOCKETS: &str = "/proc/thread-self/net/packet";

/// Why an interface cannot be opened for EtherCAT.
#[derive(Debug, Error)]
pub enum InterfaceError {
    /// There is no interface of this name, or the process lacks the privilege.
    #[error(
        "the network interface {interface} cannot be opened: {source}; raw sockets need CAP_NET_RAW, and \
         the interface must be up"
    )]
    Closed {
        /// Its name.
        interface: String,
        /// The error of the system.
        source: io::Error,
    },
    /// Another MainDevice has a socket on the interface. Two on one ring take each other's devices out of
    /// operation.
    #[error(
        "the network interface {interface} is in use by another EtherCAT MainDevice{by}, so nothing was sent: \
         end it first, because two MainDevices on one ring take each other's devices out of operation"
    )]
    InUse {
        /// Its name.
        interface: String,
        /// Its process in parentheses, if it can be found, preceded by a space.
        by: String,
    },
}

/// A packet socket; opening one needs CAP_NET_RAW. Sending and receiving do not allocate.
#[derive(Debug)]
pub(crate) struct PacketSocket {
    descriptor: OwnedFd,
}

fn checked(result: i64) -> io::Result<i64> {
    if result < 0 {
        Err(io::Error::last_os_error())
    } else {
        Ok(result)
    }
}

impl PacketSocket {
    /// Opens the interface of this name if no other MainDevice uses it.
    pub(crate) fn open(interface: &str) -> Result<Self, InterfaceError> {
        let (socket, index) = Self::open_any(interface).map_err(|source| InterfaceError::Closed {
            interface: interface.to_owned(),
            source,
        })?;
        // Looked for after opening: of two that open at the same time, at least one finds the other.
        match socket.find_other(index) {
            Some(inode) => Err(InterfaceError::InUse {
                interface: interface.to_owned(),
                by: owner(inode).map_or_else(String::new, |process| format!(" ({process})")),
            }),
            None => Ok(socket),
        }
    }

    /// Opens the interface of this name. Also returns its number.
    fn open_any(interface: &str) -> io::Result<(Self, u32)> {
        let name = CString::new(interface).map_err(io::Error::other)?;
        // SAFETY: the name is a string that ends with a zero byte.
        let index = unsafe { libc::if_nametoindex(name.as_ptr()) };
        if index == 0 {
            return Err(io::Error::last_os_error());
        }
        let protocol = ETHER_TYPE.to_be();
        let kind = libc::SOCK_RAW | libc::SOCK_CLOEXEC | libc::SOCK_NONBLOCK;
        // SAFETY: no memory is passed.
        let raw = unsafe { libc::socket(libc::AF_PACKET, kind, i32::from(protocol)) };
        let raw = i32::try_from(checked(i64::from(raw))?).map_err(io::Error::other)?;
        // SAFETY: the descriptor was just created and has no other owner.
        let descriptor = unsafe { OwnedFd::from_raw_fd(raw) };
        let address = libc::sockaddr_ll {
            sll_family: libc::AF_PACKET as u16,
            sll_protocol: protocol,
            sll_ifindex: i32::try_from(index).map_err(io::Error::other)?,
            sll_hatype: 0,
            sll_pkttype: 0,
            sll_halen: 0,
            sll_addr: [0; 8],
        };
        let size = size_of::<libc::sockaddr_ll>() as u32;
        // SAFETY: the address is one of a packet socket and is valid during the call.
        let bound = unsafe { libc::bind(descriptor.as_raw_fd(), (&raw const address).cast(), size) };
        checked(i64::from(bound))?;
        Ok((Self { descriptor }, index))
    }

    /// The inode of another EtherCAT socket on the interface of this number, if the system lists any. A
    /// capture of the wire is none: it receives every protocol.
    fn find_other(&self, index: u32) -> Option<u64> {
        let own = File::from(self.descriptor.try_clone().ok()?)
            .metadata()
            .ok()?
            .ino();
        let listed = std::fs::read_to_string(PACKET_SOCKETS).ok()?;
        listed.lines().skip(1).find_map(|line| {
            // sk RefCnt Type Proto Iface R Rmem User Inode
            let columns: Vec<&str> = line.split_whitespace().collect();
            let &[_, _, _, protocol, on, _, _, _, inode] = columns.as_slice() else {
                return None;
            };
            let is_ethercat = u16::from_str_radix(protocol, 16) == Ok(ETHER_TYPE);
            let inode = inode.parse().ok().filter(|inode| *inode != own)?;
            (is_ethercat && on.parse() == Ok(index)).then_some(inode)
        })
    }

    /// Waits until a frame is available, at most `patience_ns`.
    pub(crate) fn wait(&self, patience_ns: u64) {
        let mut poll = libc::pollfd {
            fd: self.descriptor.as_raw_fd(),
            events: libc::POLLIN,
            revents: 0,
        };
        let patience = libc::timespec {
            tv_sec: (patience_ns / 1_000_000_000) as i64,
            tv_nsec: (patience_ns % 1_000_000_000) as i64,
        };
        // SAFETY: one entry, a time, and no mask of signals.
        let _ready = unsafe { libc::ppoll(&raw mut poll, 1, &raw const patience, core::ptr::null()) };
    }

    /// Reads the next frame into a buffer; `None` if there is none.
    pub(crate) fn receive<'a>(&self, buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        // SAFETY: the buffer has the stated length.
        let length = unsafe {
            libc::recv(
                self.descriptor.as_raw_fd(),
                buffer.as_mut_ptr().cast(),
                buffer.len(),
                0,
            )
        };
        buffer.get(..usize::try_from(length).ok()?)
    }

    /// Sends a frame.
    pub(crate) fn send(&self, frame: &[u8]) -> io::Result<usize> {
        // SAFETY: the buffer has the stated length.
        let sent = unsafe { libc::send(self.descriptor.as_raw_fd(), frame.as_ptr().cast(), frame.len(), 0) };
        checked(sent as i64).map(|sent| sent as usize)
    }
}

/// The process that has the socket of this inode, as far as this user may see it.
fn owner(inode: u64) -> Option<String> {
    let wanted = format!("socket:[{inode}]");
    let has_it = |process: &std::path::Path| {
        let descriptors = std::fs::read_dir(process.join("fd")).into_iter().flatten();
        descriptors
            .flatten()
            .any(|entry| std::fs::read_link(entry.path()).is_ok_and(|to| to.as_os_str() == wanted.as_str()))
    };
    std::fs::read_dir("/proc").ok()?.flatten().find_map(|entry| {
        let number: u32 = entry.file_name().to_str()?.parse().ok()?;
        let process = entry.path();
        let name = has_it(&process).then(|| std::fs::read_to_string(process.join("comm")).ok())??;
        Some(format!("process {number}, {}", name.trim_end()))
    })
}
