//! Writes Apache Parquet, version 1 of the format: plain columns without nulls, pages compressed with zstd.
//!
//! Of the format (<https://parquet.apache.org/docs/file-format/>) this is the part that every reader has. Its headers are
//! Thrift structures in the compact protocol: a field's head is the step of its number and its type, whole numbers
//! are zigzag varints.

use std::io::{self, Write};

use crate::columns::{Table, Values};

const MAGIC: &[u8; 4] = b"PAR1";
const ZSTD_LEVEL: i32 = 1;
/// Codes of the format.
const TYPE_INT64: i64 = 2;
const TYPE_DOUBLE: i64 = 5;
const TYPE_BYTES: i64 = 6;
const CODEC_ZSTD: i64 = 6;
const ENCODING_PLAIN: i64 = 0;
const ENCODING_RLE: i64 = 3;

/// Thrift's compact protocol.
#[derive(Debug, Default)]
struct Thrift {
    bytes: Vec<u8>,
    last: Vec<u8>,
}

const KIND_I32: u8 = 5;
const KIND_I64: u8 = 6;
const KIND_BINARY: u8 = 8;
const KIND_LIST: u8 = 9;
const KIND_STRUCT: u8 = 12;

impl Thrift {
    fn new() -> Self {
        Self {
            bytes: Vec::new(),
            last: vec![0],
        }
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    fn zigzag(&mut self, value: i64) {
        self.varint(((value << 1) ^ (value >> 63)) as u64);
    }

    /// Heads of fields go upwards by less than 16 in every structure here.
    fn head(&mut self, field: u8, kind: u8) {
        if let Some(last) = self.last.last_mut() {
            self.bytes.push((field - *last) << 4 | kind);
            *last = field;
        }
    }

    fn int(&mut self, field: u8, value: i64) {
        self.head(field, KIND_I32);
        self.zigzag(value);
    }

    fn long(&mut self, field: u8, value: i64) {
        self.head(field, KIND_I64);
        self.zigzag(value);
    }

    fn raw_text(&mut self, text: &str) {
        self.varint(text.len() as u64);
        self.bytes.extend_from_slice(text.as_bytes());
    }

    fn text(&mut self, field: u8, text: &str) {
        self.head(field, KIND_BINARY);
        self.raw_text(text);
    }

    fn list(&mut self, field: u8, kind: u8, length: usize) {
        self.head(field, KIND_LIST);
        if length < 15 {
            self.bytes.push((length as u8) << 4 | kind);
        } else {
            self.bytes.push(0xF0 | kind);
            self.varint(length as u64);
        }
    }

    /// A structure as a field, or as an element of a list.
    fn structure(&mut self, field: Option<u8>, fill: impl FnOnce(&mut Self)) {
        if let Some(field) = field {
            self.head(field, KIND_STRUCT);
        }
        self.last.push(0);
        fill(self);
        self.bytes.push(0);
        self.last.pop();
    }
}

/// A column in a row group, as the footer names it.
#[derive(Debug)]
struct Chunk {
    offset: u64,
    values: usize,
    raw_bytes: u64,
    bytes: u64,
}

/// Writes one file.
pub(crate) struct ParquetWriter<W> {
    out: W,
    position: u64,
    names: Vec<(String, i64)>,
    groups: Vec<(usize, Vec<Chunk>)>,
    compressor: zstd::bulk::Compressor<'static>,
    raw: Vec<u8>,
}

fn kind_of(values: &Values) -> i64 {
    match values {
        Values::Double(_) => TYPE_DOUBLE,
        Values::Whole(_) => TYPE_INT64,
        Values::Text(_) => TYPE_BYTES,
    }
}

impl<W: Write> ParquetWriter<W> {
    pub(crate) fn new(mut out: W, table: &Table) -> io::Result<Self> {
        out.write_all(MAGIC)?;
        Ok(Self {
            out,
            position: MAGIC.len() as u64,
            names: table
                .columns
                .iter()
                .map(|column| (column.name.clone(), kind_of(&column.values)))
                .collect(),
            groups: Vec::new(),
            compressor: zstd::bulk::Compressor::new(ZSTD_LEVEL)?,
            raw: Vec::new(),
        })
    }

    /// Writes the rows of a table as a group.
    pub(crate) fn write(&mut self, table: &Table) -> io::Result<()> {
        let rows = table.rows();
        if rows == 0 {
            return Ok(());
        }
        let mut chunks = Vec::with_capacity(table.columns.len());
        for column in &table.columns {
            self.raw.clear();
            match &column.values {
                Values::Double(values) => values
                    .iter()
                    .for_each(|value| self.raw.extend_from_slice(&value.to_le_bytes())),
                Values::Whole(values) => values
                    .iter()
                    .for_each(|value| self.raw.extend_from_slice(&value.to_le_bytes())),
                Values::Text(values) => {
                    for text in values {
                        self.raw.extend_from_slice(&(text.len() as u32).to_le_bytes());
                        self.raw.extend_from_slice(text.as_bytes());
                    }
                }
            }
            let packed = self.compressor.compress(&self.raw)?;
            let mut head = Thrift::new();
            head.structure(None, |head| {
                head.int(1, 0);
                head.int(2, self.raw.len() as i64);
                head.int(3, packed.len() as i64);
                head.structure(Some(5), |page| {
                    page.int(1, rows as i64);
                    page.int(2, ENCODING_PLAIN);
                    page.int(3, ENCODING_RLE);
                    page.int(4, ENCODING_RLE);
                });
            });
            self.out.write_all(&head.bytes)?;
            self.out.write_all(&packed)?;
            let bytes = (head.bytes.len() + packed.len()) as u64;
            chunks.push(Chunk {
                offset: self.position,
                values: rows,
                raw_bytes: (head.bytes.len() + self.raw.len()) as u64,
                bytes,
            });
            self.position += bytes;
        }
        self.groups.push((rows, chunks));
        Ok(())
    }

    /// Writes the footer; gives what it wrote to.
    pub(crate) fn finish(mut self, created_by: &str, notes: &[(String, String)]) -> io::Result<W> {
        let mut footer = Thrift::new();
        let rows: usize = self.groups.iter().map(|group| group.0).sum();
        footer.structure(None, |meta| {
            meta.int(1, 1);
            meta.list(2, KIND_STRUCT, self.names.len() + 1);
            meta.structure(None, |root| {
                root.text(4, "trace");
                root.int(5, self.names.len() as i64);
            });
            for (name, kind) in &self.names {
                meta.structure(None, |element| {
                    element.int(1, *kind);
                    element.int(3, 0);
                    element.text(4, name);
                    if *kind == TYPE_BYTES {
                        element.int(6, 0);
                    }
                });
            }
            meta.long(3, rows as i64);
            meta.list(4, KIND_STRUCT, self.groups.len());
            for (rows, chunks) in &self.groups {
                meta.structure(None, |group| self.put_group(group, *rows, chunks));
            }
            meta.list(5, KIND_STRUCT, notes.len());
            for (key, value) in notes {
                meta.structure(None, |note| {
                    note.text(1, key);
                    note.text(2, value);
                });
            }
            meta.text(6, created_by);
        });
        self.out.write_all(&footer.bytes)?;
        self.out.write_all(&(footer.bytes.len() as u32).to_le_bytes())?;
        self.out.write_all(MAGIC)?;
        Ok(self.out)
    }

    fn put_group(&self, group: &mut Thrift, rows: usize, chunks: &[Chunk]) {
        group.list(1, KIND_STRUCT, chunks.len());
        for (chunk, (name, kind)) in chunks.iter().zip(&self.names) {
            group.structure(None, |column| {
                column.long(2, chunk.offset as i64);
                column.structure(Some(3), |meta| {
                    meta.int(1, *kind);
                    meta.list(2, KIND_I32, 2);
                    meta.zigzag(ENCODING_PLAIN);
                    meta.zigzag(ENCODING_RLE);
                    meta.list(3, KIND_BINARY, 1);
                    meta.raw_text(name);
                    meta.int(4, CODEC_ZSTD);
                    meta.long(5, chunk.values as i64);
                    meta.long(6, chunk.raw_bytes as i64);
                    meta.long(7, chunk.bytes as i64);
                    meta.long(9, chunk.offset as i64);
                });
            });
        }
        let raw: u64 = chunks.iter().map(|chunk| chunk.raw_bytes).sum();
        group.long(2, raw as i64);
        group.long(3, rows as i64);
    }
}
