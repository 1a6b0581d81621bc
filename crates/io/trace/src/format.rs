//! Words of the MCAP format, <https://mcap.dev/spec>: a file is magic, records, magic; a record is an opcode,
//! a length and its content, all numbers little-endian.

use std::collections::BTreeMap;

/// First and last bytes of a file.
pub(crate) const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', b'0', b'\r', b'\n'];
/// Opcode and length.
pub(crate) const RECORD_HEAD: usize = 9;
/// Head, content and nothing else of a footer.
pub(crate) const FOOTER_LENGTH: usize = RECORD_HEAD + 8 + 8 + 4;
/// The one compression written.
pub(crate) const ZSTD: &str = "zstd";

/// Opcodes.
pub(crate) mod op {
    pub(crate) const HEADER: u8 = 0x01;
    pub(crate) const FOOTER: u8 = 0x02;
    pub(crate) const SCHEMA: u8 = 0x03;
    pub(crate) const CHANNEL: u8 = 0x04;
    pub(crate) const MESSAGE: u8 = 0x05;
    pub(crate) const CHUNK: u8 = 0x06;
    pub(crate) const MESSAGE_INDEX: u8 = 0x07;
    pub(crate) const CHUNK_INDEX: u8 = 0x08;
    pub(crate) const ATTACHMENT: u8 = 0x09;
    pub(crate) const ATTACHMENT_INDEX: u8 = 0x0A;
    pub(crate) const STATISTICS: u8 = 0x0B;
    pub(crate) const METADATA: u8 = 0x0C;
    pub(crate) const METADATA_INDEX: u8 = 0x0D;
    pub(crate) const SUMMARY_OFFSET: u8 = 0x0E;
    pub(crate) const DATA_END: u8 = 0x0F;
}

/// Starts a record in `out`; [`end_record`] with the returned place fills in its length.
pub(crate) fn begin_record(out: &mut Vec<u8>, opcode: u8) -> usize {
    out.push(opcode);
    out.extend_from_slice(&[0; 8]);
    out.len()
}

/// Fills in the length of the record that began at `at`.
pub(crate) fn end_record(out: &mut [u8], at: usize) {
    let length = (out.len() - at) as u64;
    out[at - 8..at].copy_from_slice(&length.to_le_bytes());
}

pub(crate) fn put_u16(out: &mut Vec<u8>, value: u16) {
    out.extend_from_slice(&value.to_le_bytes());
}

pub(crate) fn put_u32(out: &mut Vec<u8>, value: u32) {
    out.extend_from_slice(&value.to_le_bytes());
}

pub(crate) fn put_u64(out: &mut Vec<u8>, value: u64) {
    out.extend_from_slice(&value.to_le_bytes());
}

pub(crate) fn put_string(out: &mut Vec<u8>, text: &str) {
    put_u32(out, text.len() as u32);
    out.extend_from_slice(text.as_bytes());
}

pub(crate) fn put_string_map(out: &mut Vec<u8>, map: &BTreeMap<String, String>) {
    let at = out.len();
    put_u32(out, 0);
    for (key, value) in map {
        put_string(out, key);
        put_string(out, value);
    }
    let length = (out.len() - at - 4) as u32;
    out[at..at + 4].copy_from_slice(&length.to_le_bytes());
}

pub(crate) fn put_u16_map(out: &mut Vec<u8>, map: &BTreeMap<u16, u64>) {
    put_u32(out, map.len() as u32 * 10);
    for (&key, &value) in map {
        put_u16(out, key);
        put_u64(out, value);
    }
}

/// Reads numbers and strings off a slice; `None` where the slice is too short or a string is no UTF-8.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fields<'a>(pub(crate) &'a [u8]);

impl<'a> Fields<'a> {
    pub(crate) fn bytes(&mut self, length: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(length)?;
        self.0 = tail;
        Some(head)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.bytes(N)?.try_into().ok()
    }

    pub(crate) fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[byte]| byte)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub(crate) fn string(&mut self) -> Option<&'a str> {
        let length = self.u32()? as usize;
        std::str::from_utf8(self.bytes(length)?).ok()
    }

    pub(crate) fn string_map(&mut self) -> Option<BTreeMap<String, String>> {
        let length = self.u32()? as usize;
        let mut inner = Fields(self.bytes(length)?);
        let mut map = BTreeMap::new();
        while !inner.0.is_empty() {
            let key = inner.string()?.to_owned();
            map.insert(key, inner.string()?.to_owned());
        }
        Some(map)
    }

    pub(crate) fn u16_map(&mut self) -> Option<BTreeMap<u16, u64>> {
        let length = self.u32()? as usize;
        let mut inner = Fields(self.bytes(length)?);
        let mut map = BTreeMap::new();
        while !inner.0.is_empty() {
            let key = inner.u16()?;
            map.insert(key, inner.u64()?);
        }
        Some(map)
    }

    /// The next record: opcode and content.
    pub(crate) fn record(&mut self) -> Option<(u8, &'a [u8])> {
        let opcode = self.u8()?;
        let length = usize::try_from(self.u64()?).ok()?;
        Some((opcode, self.bytes(length)?))
    }
}

/// Head of a chunk record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ChunkHead<'a> {
    pub(crate) start_time: u64,
    pub(crate) end_time: u64,
    pub(crate) uncompressed_size: u64,
    pub(crate) uncompressed_crc: u32,
    pub(crate) compression: &'a str,
    pub(crate) data: &'a [u8],
}

impl<'a> ChunkHead<'a> {
    pub(crate) fn parse(content: &'a [u8]) -> Option<Self> {
        let mut fields = Fields(content);
        let head = Self {
            start_time: fields.u64()?,
            end_time: fields.u64()?,
            uncompressed_size: fields.u64()?,
            uncompressed_crc: fields.u32()?,
            compression: fields.string()?,
            data: {
                let length = usize::try_from(fields.u64()?).ok()?;
                fields.bytes(length)?
            },
        };
        fields.0.is_empty().then_some(head)
    }
}

/// Where a chunk lies and what it spans.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ChunkIndex {
    pub(crate) start_time: u64,
    pub(crate) end_time: u64,
    pub(crate) offset: u64,
    pub(crate) length: u64,
    pub(crate) message_index_offsets: BTreeMap<u16, u64>,
    pub(crate) message_index_length: u64,
    pub(crate) compression: String,
    pub(crate) compressed_size: u64,
    pub(crate) uncompressed_size: u64,
}

impl ChunkIndex {
    pub(crate) fn put(&self, out: &mut Vec<u8>) {
        let at = begin_record(out, op::CHUNK_INDEX);
        put_u64(out, self.start_time);
        put_u64(out, self.end_time);
        put_u64(out, self.offset);
        put_u64(out, self.length);
        put_u16_map(out, &self.message_index_offsets);
        put_u64(out, self.message_index_length);
        put_string(out, &self.compression);
        put_u64(out, self.compressed_size);
        put_u64(out, self.uncompressed_size);
        end_record(out, at);
    }

    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
        let mut fields = Fields(content);
        Some(Self {
            start_time: fields.u64()?,
            end_time: fields.u64()?,
            offset: fields.u64()?,
            length: fields.u64()?,
            message_index_offsets: fields.u16_map()?,
            message_index_length: fields.u64()?,
            compression: fields.string()?.to_owned(),
            compressed_size: fields.u64()?,
            uncompressed_size: fields.u64()?,
        })
    }
}

/// Where an attachment lies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct AttachmentIndex {
    pub(crate) offset: u64,
    pub(crate) length: u64,
    pub(crate) log_time: u64,
    pub(crate) create_time: u64,
    pub(crate) data_size: u64,
    pub(crate) name: String,
    pub(crate) media_type: String,
}

impl AttachmentIndex {
    pub(crate) fn put(&self, out: &mut Vec<u8>) {
        let at = begin_record(out, op::ATTACHMENT_INDEX);
        put_u64(out, self.offset);
        put_u64(out, self.length);
        put_u64(out, self.log_time);
        put_u64(out, self.create_time);
        put_u64(out, self.data_size);
        put_string(out, &self.name);
        put_string(out, &self.media_type);
        end_record(out, at);
    }

    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
        let mut fields = Fields(content);
        Some(Self {
            offset: fields.u64()?,
            length: fields.u64()?,
            log_time: fields.u64()?,
            create_time: fields.u64()?,
            data_size: fields.u64()?,
            name: fields.string()?.to_owned(),
            media_type: fields.string()?.to_owned(),
        })
    }
}

/// Where a metadata record lies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct MetadataIndex {
    pub(crate) offset: u64,
    pub(crate) length: u64,
    pub(crate) name: String,
}

impl MetadataIndex {
    pub(crate) fn put(&self, out: &mut Vec<u8>) {
        let at = begin_record(out, op::METADATA_INDEX);
        put_u64(out, self.offset);
        put_u64(out, self.length);
        put_string(out, &self.name);
        end_record(out, at);
    }

    pub(crate) fn parse(content: &[u8]) -> Option<Self> {
        let mut fields = Fields(content);
        Some(Self {
            offset: fields.u64()?,
            length: fields.u64()?,
            name: fields.string()?.to_owned(),
        })
    }
}
