//! A raw socket for EtherCAT's frames on one network interface.

use core::time::Duration;
use std::ffi::CString;
use std::io;
use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};

use crate::datagram::ETHER_TYPE;

/// A packet socket; needs CAP_NET_RAW.
#[derive(Debug)]
pub struct PacketSocket {
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
    ///
    /// # Errors
    /// There is no interface of this name, or the process lacks the privilege.
    pub fn open(interface: &str) -> io::Result<Self> {
        let name = CString::new(interface).map_err(io::Error::other)?;
        // SAFETY: the name is a string that ends with a zero byte.
        let index = unsafe { libc::if_nametoindex(name.as_ptr()) };
        if index == 0 {
            return Err(io::Error::last_os_error());
        }
        let protocol = ETHER_TYPE.to_be();
        // SAFETY: no memory is passed.
        let raw = unsafe {
            libc::socket(
                libc::AF_PACKET,
                libc::SOCK_RAW | libc::SOCK_CLOEXEC,
                i32::from(protocol),
            )
        };
        let raw = i32::try_from(checked(i64::from(raw))?).map_err(io::Error::other)?;
        // SAFETY: the descriptor was just made and nobody else has it.
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
        // SAFETY: the address is one of a packet socket and lives through the call.
        let bound = unsafe { libc::bind(descriptor.as_raw_fd(), (&raw const address).cast(), size) };
        checked(i64::from(bound))?;
        Ok(Self { descriptor })
    }

    /// Waits for a frame. Returns whether there is one.
    ///
    /// # Errors
    /// The interface is gone.
    pub fn wait(&self, patience: Duration) -> io::Result<bool> {
        let mut poll = libc::pollfd {
            fd: self.descriptor.as_raw_fd(),
            events: libc::POLLIN,
            revents: 0,
        };
        let patience = libc::timespec {
            tv_sec: patience.as_secs() as i64,
            tv_nsec: i64::from(patience.subsec_nanos()),
        };
        // SAFETY: one entry, a time, and no mask of signals.
        let ready = unsafe { libc::ppoll(&raw mut poll, 1, &raw const patience, core::ptr::null()) };
        match checked(i64::from(ready)) {
            Ok(ready) => Ok(ready > 0),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Returns the next frame, or `None` after the time limit.
    ///
    /// # Errors
    /// The interface is gone.
    pub fn receive(&self, patience: Duration) -> io::Result<Option<Vec<u8>>> {
        if !self.wait(patience)? {
            return Ok(None);
        }
        let mut frame = vec![0_u8; 1600];
        // SAFETY: the buffer has the stated length.
        let length = unsafe {
            libc::recv(
                self.descriptor.as_raw_fd(),
                frame.as_mut_ptr().cast(),
                frame.len(),
                libc::MSG_DONTWAIT,
            )
        };
        match checked(length as i64) {
            Ok(length) => {
                frame.truncate(length as usize);
                Ok(Some(frame))
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Sends a frame.
    ///
    /// # Errors
    /// The interface is gone, or its buffer is full.
    pub fn send(&self, frame: &[u8]) -> io::Result<()> {
        // SAFETY: the buffer has the stated length.
        let sent = unsafe { libc::send(self.descriptor.as_raw_fd(), frame.as_ptr().cast(), frame.len(), 0) };
        checked(sent as i64).map(|_| ())
    }
}
