//! Messages of the mailbox.

/// Bytes of the header.
pub(crate) const HEADER: usize = 6;
/// Type of errors.
const ERROR: u8 = 0;
/// Type of CANopen over EtherCAT.
pub(crate) const COE: u8 = 3;

/// Errors of the mailbox itself (ETG.1000.4, table 30).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum MailboxError {
    Protocol = 2,
    Size = 8,
}

/// A received message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Message<'a> {
    pub(crate) kind: u8,
    pub(crate) counter: u8,
    pub(crate) data: &'a [u8],
}

impl<'a> Message<'a> {
    /// Decodes a mailbox.
    ///
    /// # Errors
    /// The stated length exceeds the mailbox.
    pub(crate) fn decode(mailbox: &'a [u8]) -> Result<Self, MailboxError> {
        let Some((&[l0, l1, _, _, _, kind], rest)) = mailbox.split_first_chunk::<HEADER>() else {
            return Err(MailboxError::Size);
        };
        let data = rest
            .get(..usize::from(u16::from_le_bytes([l0, l1])))
            .ok_or(MailboxError::Size)?;
        Ok(Self {
            kind: kind & 0x0F,
            counter: kind >> 4 & 7,
            data,
        })
    }
}

/// Encodes a message for a mailbox of `bytes` bytes.
pub(crate) fn encode(kind: u8, counter: u8, data: &[u8], bytes: usize) -> Vec<u8> {
    let mut message = vec![0_u8; HEADER];
    message[..2].copy_from_slice(&(data.len() as u16).to_le_bytes());
    message[5] = kind | counter << 4;
    message.extend_from_slice(data);
    message.resize(bytes, 0);
    message
}

/// Encodes an error reply to a message.
pub(crate) fn encode_error(error: MailboxError, counter: u8, bytes: usize) -> Vec<u8> {
    encode(ERROR, counter, &[1, 0, error as u8, 0], bytes)
}
