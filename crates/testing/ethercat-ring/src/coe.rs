//! CANopen over EtherCAT: the SDO server and the SDO information service.

use crate::object::{Access, Dictionary, Mapping, ObjectCode};

/// Codes of aborted transfers (ETG.1000.6, table 41).
pub mod abort {
    /// Toggle bit not changed.
    pub const TOGGLE: u32 = 0x0503_0000;
    /// Unknown command specifier.
    pub const COMMAND: u32 = 0x0504_0001;
    /// Unsupported access.
    pub const ACCESS: u32 = 0x0601_0000;
    /// Written though read only.
    pub const READ_ONLY: u32 = 0x0601_0002;
    /// Entries are changed while sub-index 0 is not zero.
    pub const COUNT_NOT_ZERO: u32 = 0x0601_0003;
    /// No such object.
    pub const NO_OBJECT: u32 = 0x0602_0000;
    /// The object cannot be mapped into a PDO.
    pub const NOT_MAPPABLE: u32 = 0x0604_0041;
    /// The mapped objects are too long.
    pub const MAPPED_LENGTH: u32 = 0x0604_0042;
    /// Length of the parameter does not match.
    pub const LENGTH: u32 = 0x0607_0010;
    /// No such sub-index.
    pub const NO_SUB_INDEX: u32 = 0x0609_0011;
    /// Value out of range.
    pub const RANGE: u32 = 0x0609_0030;
    /// A general error.
    pub const GENERAL: u32 = 0x0800_0000;
    /// Not in the present state.
    pub const STATE: u32 = 0x0800_0022;
}

const SDO_REQUEST: u16 = 2;
const SDO_RESPONSE: u16 = 3;
const SDO_INFORMATION: u16 = 8;
/// Length of CoE header and SDO header.
const SDO_HEADER: usize = 10;
/// Maximum process data of a device, bits.
const MAX_PDO_BITS: i64 = 512 * 8;

/// Reply of the server to a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Reply {
    Nothing,
    /// CoE messages.
    Messages(Vec<Vec<u8>>),
}

#[derive(Clone, Debug)]
enum Transfer {
    None,
    Download {
        index: u16,
        sub_index: u8,
        complete: bool,
        size: usize,
        data: Vec<u8>,
        toggle: bool,
    },
    Upload {
        index: u16,
        sub_index: u8,
        data: Vec<u8>,
        sent: usize,
        toggle: bool,
    },
}

/// The server.
#[derive(Clone, Debug)]
pub(crate) struct Server {
    transfer: Transfer,
    /// Maximum data of a mailbox after its header, bytes.
    capacity: usize,
}

impl Server {
    /// Creates a server for mailboxes of this size, bytes.
    pub(crate) fn new(mailbox_bytes: usize) -> Self {
        Self {
            transfer: Transfer::None,
            capacity: mailbox_bytes.saturating_sub(6),
        }
    }

    /// Handles the data of a CoE message. `configurable`: the device is in PRE-OP.
    pub(crate) fn handle(&mut self, message: &[u8], objects: &mut Dictionary, configurable: bool) -> Reply {
        let Some((&[h0, h1], body)) = message.split_first_chunk::<2>() else {
            return Reply::Nothing;
        };
        match u16::from_le_bytes([h0, h1]) >> 12 {
            SDO_REQUEST => Reply::Messages(vec![self.request(body, objects, configurable)]),
            SDO_INFORMATION => Reply::Messages(self.information(body, objects)),
            _ => Reply::Nothing,
        }
    }

    fn request(&mut self, body: &[u8], objects: &mut Dictionary, configurable: bool) -> Vec<u8> {
        let Some(&[command, i0, i1, sub_index, ref data @ ..]) = body.first_chunk::<8>() else {
            return abort_message(0, 0, abort::COMMAND);
        };
        let index = u16::from_le_bytes([i0, i1]);
        let rest = &body[8..];
        let result = match command >> 5 {
            0 => self.download_segment(command, &body[1..], objects, configurable),
            1 => self.download(command, index, sub_index, *data, rest, objects, configurable),
            2 => self.upload(command, index, sub_index, objects),
            3 => self.upload_segment(command),
            4 => {
                self.transfer = Transfer::None;
                Err(abort::GENERAL)
            }
            _ => Err(abort::COMMAND),
        };
        result.unwrap_or_else(|code| {
            let (index, sub_index) = match self.transfer {
                Transfer::Download { index, sub_index, .. } | Transfer::Upload { index, sub_index, .. } => {
                    (index, sub_index)
                }
                Transfer::None => (index, sub_index),
            };
            self.transfer = Transfer::None;
            abort_message(index, sub_index, code)
        })
    }

    #[expect(clippy::too_many_arguments, reason = "the fields of the request")]
    fn download(
        &mut self,
        command: u8,
        index: u16,
        sub_index: u8,
        data: [u8; 4],
        rest: &[u8],
        objects: &mut Dictionary,
        configurable: bool,
    ) -> Result<Vec<u8>, u32> {
        self.transfer = Transfer::None;
        let complete = command & 0x10 != 0;
        if command & 2 != 0 {
            // Expedited; without a stated size, the size of the object applies.
            let count = if command & 1 != 0 {
                4 - usize::from(command >> 2 & 3)
            } else {
                objects
                    .entry(index, sub_index)
                    .map_or(4, |entry| entry.value.len().min(4))
            };
            write(objects, index, sub_index, complete, &data[..count], configurable)?;
            return Ok(response(0x60, index, sub_index, &[0; 4]));
        }
        if command & 1 == 0 {
            return Err(abort::COMMAND);
        }
        let size = u32::from_le_bytes(data) as usize;
        check_target(objects, index, sub_index, complete)?;
        if size > 0x1_0000 {
            return Err(abort::LENGTH);
        }
        if rest.len() >= size {
            write(objects, index, sub_index, complete, &rest[..size], configurable)?;
        } else {
            let data = rest.to_vec();
            self.transfer = Transfer::Download {
                index,
                sub_index,
                complete,
                size,
                data,
                toggle: false,
            };
        }
        Ok(response(0x60, index, sub_index, &[0; 4]))
    }

    fn download_segment(
        &mut self,
        command: u8,
        body: &[u8],
        objects: &mut Dictionary,
        configurable: bool,
    ) -> Result<Vec<u8>, u32> {
        let Transfer::Download {
            index,
            sub_index,
            complete,
            size,
            data,
            toggle,
        } = &mut self.transfer
        else {
            return Err(abort::COMMAND);
        };
        if (command & 0x10 != 0) != *toggle {
            return Err(abort::TOGGLE);
        }
        // The data field has at least seven bytes; the command has the number of unused ones.
        let unused = if body.len() == 7 {
            usize::from(command >> 1 & 7)
        } else {
            0
        };
        data.extend_from_slice(&body[..body.len() - unused]);
        let reply = response_header(0x20 | command & 0x10);
        *toggle = !*toggle;
        if command & 1 != 0 {
            if data.len() != *size {
                return Err(abort::LENGTH);
            }
            write(objects, *index, *sub_index, *complete, data, configurable)?;
            self.transfer = Transfer::None;
        } else if data.len() > *size {
            return Err(abort::LENGTH);
        }
        Ok(reply)
    }

    fn upload(
        &mut self,
        command: u8,
        index: u16,
        sub_index: u8,
        objects: &Dictionary,
    ) -> Result<Vec<u8>, u32> {
        self.transfer = Transfer::None;
        let complete = command & 0x10 != 0;
        let data = read(objects, index, sub_index, complete)?;
        let mark = if complete { 0x10 } else { 0 };
        if (1..=4).contains(&data.len()) {
            let mut field = [0; 4];
            field[..data.len()].copy_from_slice(&data);
            return Ok(response(
                0x43 | mark | (4 - data.len() as u8) << 2,
                index,
                sub_index,
                &field,
            ));
        }
        let mut reply = response(0x41 | mark, index, sub_index, &(data.len() as u32).to_le_bytes());
        let fits = self.capacity.saturating_sub(SDO_HEADER).min(data.len());
        reply.extend_from_slice(&data[..fits]);
        if fits < data.len() {
            self.transfer = Transfer::Upload {
                index,
                sub_index,
                data,
                sent: fits,
                toggle: false,
            };
        }
        Ok(reply)
    }

    fn upload_segment(&mut self, command: u8) -> Result<Vec<u8>, u32> {
        let Transfer::Upload {
            data, sent, toggle, ..
        } = &mut self.transfer
        else {
            return Err(abort::COMMAND);
        };
        if (command & 0x10 != 0) != *toggle {
            return Err(abort::TOGGLE);
        }
        let count = (data.len() - *sent).min(self.capacity.saturating_sub(3));
        let is_last = *sent + count == data.len();
        let unused = 7_usize.saturating_sub(count);
        let mut reply = response_header((command & 0x10) | (unused as u8) << 1 | u8::from(is_last));
        reply.extend_from_slice(&data[*sent..*sent + count]);
        reply.resize(reply.len() + unused, 0);
        *sent += count;
        *toggle = !*toggle;
        if is_last {
            self.transfer = Transfer::None;
        }
        Ok(reply)
    }

    fn information(&self, body: &[u8], objects: &Dictionary) -> Vec<Vec<u8>> {
        let (opcode, request) = (
            body.first().copied().unwrap_or(0) & 0x7F,
            body.get(4..).unwrap_or(&[]),
        );
        let word = |offset: usize| {
            request
                .get(offset..offset + 2)
                .map_or(0, |bytes| u16::from_le_bytes([bytes[0], bytes[1]]))
        };
        match opcode {
            1 => self.object_list(word(0), objects),
            3 => vec![describe_object(word(0), objects)],
            5 => vec![describe_entry(
                word(0),
                request.get(2).copied().unwrap_or(0),
                request.get(3).copied().unwrap_or(0),
                objects,
            )],
            _ => vec![information_error(abort::COMMAND)],
        }
    }

    /// Returns an object list, in several fragments if necessary.
    fn object_list(&self, kind: u16, objects: &Dictionary) -> Vec<Vec<u8>> {
        let listed = |kind: u16| -> Vec<u16> {
            let is_mapped = |index: u16, mapping| {
                objects
                    .object(index)
                    .is_some_and(|object| object.entries.iter().any(|entry| entry.mapping == mapping))
            };
            objects
                .indices()
                .filter(|&index| match kind {
                    1 => true,
                    2 => is_mapped(index, Mapping::Output),
                    3 => is_mapped(index, Mapping::Input),
                    _ => false,
                })
                .collect()
        };
        let words: Vec<u16> = if kind == 0 {
            (1..=5).map(|kind| listed(kind).len() as u16).collect()
        } else {
            listed(kind)
        };
        let data: Vec<u8> = core::iter::once(kind)
            .chain(words)
            .flat_map(u16::to_le_bytes)
            .collect();
        let chunks: Vec<&[u8]> = data
            .chunks((self.capacity.saturating_sub(6) & !1).max(2))
            .collect();
        let last = chunks.len() - 1;
        chunks
            .into_iter()
            .enumerate()
            .map(|(i, chunk)| {
                let incomplete = if i < last { 0x80 } else { 0 };
                let mut message = information_header(2 | incomplete, (last - i) as u16);
                message.extend_from_slice(chunk);
                message
            })
            .collect()
    }
}

fn coe_header(service: u16) -> Vec<u8> {
    (service << 12).to_le_bytes().to_vec()
}

fn response_header(command: u8) -> Vec<u8> {
    let mut message = coe_header(SDO_RESPONSE);
    message.push(command);
    message
}

fn response(command: u8, index: u16, sub_index: u8, data: &[u8; 4]) -> Vec<u8> {
    let mut message = response_header(command);
    message.extend_from_slice(&index.to_le_bytes());
    message.push(sub_index);
    message.extend_from_slice(data);
    message
}

/// An abort message, which has the type of a request.
pub(crate) fn abort_message(index: u16, sub_index: u8, code: u32) -> Vec<u8> {
    let mut message = coe_header(SDO_REQUEST);
    message.push(0x80);
    message.extend_from_slice(&index.to_le_bytes());
    message.push(sub_index);
    message.extend_from_slice(&code.to_le_bytes());
    message
}

fn information_header(opcode: u8, fragments_left: u16) -> Vec<u8> {
    let mut message = coe_header(SDO_INFORMATION);
    message.extend_from_slice(&[opcode, 0]);
    message.extend_from_slice(&fragments_left.to_le_bytes());
    message
}

fn information_error(code: u32) -> Vec<u8> {
    let mut message = information_header(7, 0);
    message.extend_from_slice(&code.to_le_bytes());
    message
}

fn describe_object(index: u16, objects: &Dictionary) -> Vec<u8> {
    let Some(object) = objects.object(index) else {
        return information_error(abort::NO_OBJECT);
    };
    let mut message = information_header(4, 0);
    message.extend_from_slice(&index.to_le_bytes());
    let data_type = object.entries.last().map_or(0, |entry| entry.data_type);
    message.extend_from_slice(&data_type.to_le_bytes());
    let highest = if object.code == ObjectCode::Variable {
        0
    } else {
        object.entries.len().saturating_sub(1)
    };
    message.extend_from_slice(&[highest as u8, object.code as u8]);
    message.extend_from_slice(object.name.as_bytes());
    message
}

fn describe_entry(index: u16, sub_index: u8, value_info: u8, objects: &Dictionary) -> Vec<u8> {
    let Some(entry) = objects.entry(index, sub_index) else {
        return information_error(abort::NO_SUB_INDEX);
    };
    let mut message = information_header(6, 0);
    message.extend_from_slice(&index.to_le_bytes());
    message.extend_from_slice(&[sub_index, value_info & 7]);
    message.extend_from_slice(&entry.data_type.to_le_bytes());
    let bits = if entry.bits == 0 {
        entry.value.len() as u16 * 8
    } else {
        u16::from(entry.bits)
    };
    message.extend_from_slice(&bits.to_le_bytes());
    message.extend_from_slice(&entry.access_bits().to_le_bytes());
    message.extend_from_slice(entry.name.as_bytes());
    message
}

fn check_target(objects: &Dictionary, index: u16, sub_index: u8, complete: bool) -> Result<(), u32> {
    let object = objects.object(index).ok_or(abort::NO_OBJECT)?;
    if usize::from(sub_index) >= object.entries.len() {
        return Err(abort::NO_SUB_INDEX);
    }
    if complete && (sub_index > 1 || object.code == ObjectCode::Variable) {
        return Err(abort::ACCESS);
    }
    Ok(())
}

/// With complete access, sub-index 0 takes 16 bits and the others follow without gaps.
fn read(objects: &Dictionary, index: u16, sub_index: u8, complete: bool) -> Result<Vec<u8>, u32> {
    check_target(objects, index, sub_index, complete)?;
    let object = objects.object(index).ok_or(abort::NO_OBJECT)?;
    if !complete {
        return Ok(object.entries[usize::from(sub_index)].value.clone());
    }
    let count = objects.integer(index, 0).max(0) as usize;
    let mut data = if sub_index == 0 {
        vec![count as u8, 0]
    } else {
        Vec::new()
    };
    for entry in object.entries.iter().skip(1).take(count) {
        data.extend_from_slice(&entry.value);
    }
    Ok(data)
}

fn write(
    objects: &mut Dictionary,
    index: u16,
    sub_index: u8,
    complete: bool,
    data: &[u8],
    configurable: bool,
) -> Result<(), u32> {
    check_target(objects, index, sub_index, complete)?;
    if !complete {
        return write_entry(objects, index, sub_index, data, configurable);
    }
    // All or nothing: a PDO list must be emptied, filled and closed.
    let before = objects.clone();
    let result = write_complete(objects, index, sub_index, data, configurable);
    if result.is_err() {
        *objects = before;
    }
    result
}

fn write_complete(
    objects: &mut Dictionary,
    index: u16,
    sub_index: u8,
    data: &[u8],
    configurable: bool,
) -> Result<(), u32> {
    let (count, mut rest) = if sub_index == 0 {
        let (&[count, _], rest) = data.split_first_chunk::<2>().ok_or(abort::LENGTH)?;
        (Some(count), rest)
    } else {
        (None, data)
    };
    if count.is_some() && is_pdo_list(index) {
        write_entry(objects, index, 0, &[0], configurable)?;
    }
    let mut sub_index = 1;
    while !rest.is_empty() {
        let size = objects
            .entry(index, sub_index)
            .ok_or(abort::NO_SUB_INDEX)?
            .value
            .len();
        let value = rest.get(..size).ok_or(abort::LENGTH)?;
        write_entry(objects, index, sub_index, value, configurable)?;
        rest = &rest[size..];
        sub_index += 1;
    }
    match count {
        Some(count) if is_pdo_list(index) => write_entry(objects, index, 0, &[count], configurable),
        _ => Ok(()),
    }
}

/// Assignments (1C12h, 1C13h) and mappings (1600h.., 1A00h..): sub-index 0 is writable and is the number of
/// valid entries.
fn is_pdo_list(index: u16) -> bool {
    matches!(index, 0x1C12 | 0x1C13 | 0x1600..=0x17FF | 0x1A00..=0x1BFF)
}

fn write_entry(
    objects: &mut Dictionary,
    index: u16,
    sub_index: u8,
    data: &[u8],
    configurable: bool,
) -> Result<(), u32> {
    let entry = objects.entry(index, sub_index).ok_or(abort::NO_SUB_INDEX)?;
    match entry.access {
        Access::ReadOnly => return Err(abort::READ_ONLY),
        Access::Configuration if !configurable => return Err(abort::STATE),
        Access::Configuration | Access::ReadWrite => {}
    }
    if entry.value.len() != data.len() {
        return Err(abort::LENGTH);
    }
    if is_pdo_list(index) {
        check_pdo_list(objects, index, sub_index, data)?;
    }
    if let Some(entry) = objects.entry_mut(index, sub_index) {
        entry.value.copy_from_slice(data);
    }
    Ok(())
}

fn check_pdo_list(objects: &Dictionary, index: u16, sub_index: u8, data: &[u8]) -> Result<(), u32> {
    if sub_index == 0 {
        let count = data.first().copied().unwrap_or(0);
        let known = objects.object(index).map_or(0, |object| object.entries.len() - 1);
        if usize::from(count) > known {
            return Err(abort::MAPPED_LENGTH);
        }
        let bits: i64 = (1..=count)
            .map(|sub_index| objects.integer(index, sub_index) & 0xFF)
            .sum();
        return if bits > MAX_PDO_BITS {
            Err(abort::MAPPED_LENGTH)
        } else {
            Ok(())
        };
    }
    if objects.integer(index, 0) != 0 {
        return Err(abort::COUNT_NOT_ZERO);
    }
    let is_output = matches!(index, 0x1C12 | 0x1600..=0x17FF);
    if let &[p0, p1] = data {
        let pdo = u16::from_le_bytes([p0, p1]);
        let fits = if is_output {
            (0x1600..0x1800).contains(&pdo)
        } else {
            (0x1A00..0x1C00).contains(&pdo)
        };
        return if fits && objects.object(pdo).is_some() {
            Ok(())
        } else {
            Err(abort::NOT_MAPPABLE)
        };
    }
    let &[bits, sub_index, i0, i1] = data else {
        return Err(abort::LENGTH);
    };
    let mapped = u16::from_le_bytes([i0, i1]);
    if mapped == 0 {
        // A gap.
        return Ok(());
    }
    let entry = objects.entry(mapped, sub_index).ok_or(abort::NO_OBJECT)?;
    let wanted = if is_output {
        Mapping::Output
    } else {
        Mapping::Input
    };
    if entry.mapping != wanted || entry.bits != bits {
        return Err(abort::NOT_MAPPABLE);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::{Entry, data_type};

    fn server() -> (Server, Dictionary) {
        let mut objects = Dictionary::default();
        objects.variable(
            0x2000,
            Entry::integer("Number", data_type::UNSIGNED32, 0x1234_5678).writable(),
        );
        objects.variable(0x2001, Entry::text("Text", &"long ".repeat(60)).writable());
        objects.compound(
            0x2002,
            "List",
            ObjectCode::Array,
            vec![Entry::integer("One", data_type::UNSIGNED16, 1).writable(); 3],
        );
        (Server::new(64), objects)
    }

    fn one(reply: Reply) -> Vec<u8> {
        let Reply::Messages(mut messages) = reply else {
            panic!("no reply")
        };
        assert_eq!(messages.len(), 1);
        messages.remove(0)
    }

    fn reply_to(server: &mut Server, objects: &mut Dictionary, body: &[u8]) -> Vec<u8> {
        let message: Vec<u8> = [0x00, 0x20].into_iter().chain(body.iter().copied()).collect();
        one(server.handle(&message, objects, true))
    }

    #[test]
    fn long_texts_are_segmented_with_toggle_checks() {
        let (mut server, mut objects) = server();
        let reply = reply_to(&mut server, &mut objects, &[0x40, 0x01, 0x20, 0, 0, 0, 0, 0]);
        assert_eq!(reply[2], 0x41);
        assert_eq!(u32::from_le_bytes([reply[6], reply[7], reply[8], reply[9]]), 300);
        let mut text = reply[10..].to_vec();
        let mut toggle = 0;
        loop {
            let reply = reply_to(&mut server, &mut objects, &[0x60 | toggle, 0, 0, 0, 0, 0, 0, 0]);
            assert_eq!(reply[2] & 0xF0, toggle);
            let unused = usize::from(reply[2] >> 1 & 7);
            text.extend_from_slice(&reply[3..reply.len() - unused]);
            toggle ^= 0x10;
            if reply[2] & 1 == 1 {
                break;
            }
        }
        assert_eq!(text, "long ".repeat(60).as_bytes());
        let _first = reply_to(&mut server, &mut objects, &[0x40, 0x01, 0x20, 0, 0, 0, 0, 0]);
        let reply = reply_to(&mut server, &mut objects, &[0x70, 0, 0, 0, 0, 0, 0, 0]);
        assert_eq!(
            (reply[2], &reply[6..10]),
            (0x80, abort::TOGGLE.to_le_bytes().as_slice())
        );

        let (size, new) = (300_u32.to_le_bytes(), [b'x'; 300]);
        let mut begin = vec![0x21, 0x01, 0x20, 0];
        begin.extend_from_slice(&size);
        begin.extend_from_slice(&new[..40]);
        assert_eq!(reply_to(&mut server, &mut objects, &begin)[2], 0x60);
        for (i, chunk) in new[40..].chunks(52).enumerate() {
            let last = u8::from(i == 4);
            let toggle = if i % 2 == 1 { 0x10 } else { 0 };
            let body: Vec<u8> = [toggle | last].into_iter().chain(chunk.iter().copied()).collect();
            assert_eq!(reply_to(&mut server, &mut objects, &body)[2], 0x20 | toggle);
        }
        assert_eq!(
            objects.entry(0x2001, 0).map(|entry| entry.value.as_slice()),
            Some(new.as_slice())
        );
    }

    #[test]
    fn complete_access_reads_the_count_as_a_word() {
        let (mut server, mut objects) = server();
        let reply = reply_to(&mut server, &mut objects, &[0x50, 0x02, 0x20, 0, 0, 0, 0, 0]);
        assert_eq!(reply[2], 0x51);
        assert_eq!(&reply[10..], [3, 0, 1, 0, 1, 0, 1, 0]);
    }

    #[test]
    fn what_is_not_there_is_aborted_with_its_code() {
        let (mut server, mut objects) = server();
        for (body, code) in [
            ([0x40, 0x99, 0x20, 0, 0, 0, 0, 0], abort::NO_OBJECT),
            ([0x40, 0x02, 0x20, 9, 0, 0, 0, 0], abort::NO_SUB_INDEX),
            ([0x2F, 0x00, 0x20, 0, 1, 0, 0, 0], abort::LENGTH),
            ([0x2F, 0x02, 0x20, 0, 1, 0, 0, 0], abort::READ_ONLY),
            ([0xE0, 0x02, 0x20, 0, 1, 0, 0, 0], abort::COMMAND),
            ([0x60, 0x02, 0x20, 0, 1, 0, 0, 0], abort::COMMAND),
        ] {
            let reply = reply_to(&mut server, &mut objects, &body);
            assert_eq!(
                (reply[2], &reply[6..10]),
                (0x80, code.to_le_bytes().as_slice()),
                "{body:?}"
            );
        }
    }
}
