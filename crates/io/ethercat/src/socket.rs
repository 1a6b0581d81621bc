//! A raw socket for EtherCAT's frames on one network interface.

use std::ffi::CString;
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

/// EtherCAT's Ethernet type.
const ETHER_TYPE: u16 = 0x88A4;

/// A packet socket; opening one needs CAP_NET_RAW. Neither call allocates.
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
    /// Opens the interface of this name.
    pub(crate) fn open(interface: &str) -> io::Result<Self> {
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
        Ok(Self { descriptor })
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
