//! Writes Apache Parquet: columns without nulls, plain values, pages compressed with zstd.

use std::io::{self, Write};
use std::sync::Arc;

use parquet::basic::{Compression, ConvertedType, Encoding, Repetition, Type as Physical, ZstdLevel};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::errors::{ParquetError, Result};
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::types::{Type, TypePtr};

use crate::columns::{Column, Table, Values};

const ZSTD_LEVEL: i32 = 1;
/// A column of a row group is one page, because each page needs a new compressor.
const PAGE_ROWS: usize = 1 << 16;

/// Writes one file.
pub(crate) struct ParquetWriter<W: Write + Send> {
    file: SerializedFileWriter<W>,
}

impl<W: Write + Send> ParquetWriter<W> {
    pub(crate) fn new(out: W, table: &Table, created_by: &str) -> io::Result<Self> {
        let file = schema_of(table)
            .and_then(|schema| SerializedFileWriter::new(out, schema, properties(created_by)?.into()))
            .map_err(io_error)?;
        Ok(Self { file })
    }

    /// Writes the rows of a table as a group.
    pub(crate) fn write(&mut self, table: &Table) -> io::Result<()> {
        if table.rows() == 0 {
            return Ok(());
        }
        self.write_group(table).map_err(io_error)
    }

    fn write_group(&mut self, table: &Table) -> Result<()> {
        let mut group = self.file.next_row_group()?;
        for column in &table.columns {
            // There is one column per column of the schema, which is that of the table.
            let Some(mut out) = group.next_column()? else {
                break;
            };
            match &column.values {
                Values::Double(values) => out.typed::<DoubleType>().write_batch(values, None, None)?,
                Values::Whole(values) => out.typed::<Int64Type>().write_batch(values, None, None)?,
                Values::Text(values) => {
                    let texts: Vec<ByteArray> = values.iter().map(|text| text.as_str().into()).collect();
                    out.typed::<ByteArrayType>().write_batch(&texts, None, None)?
                }
            };
            out.close()?;
        }
        group.close()?;
        Ok(())
    }

    /// Writes the footer; returns the writer.
    pub(crate) fn finish(mut self, notes: &[(String, String)]) -> io::Result<W> {
        for (key, value) in notes {
            self.file
                .append_key_value_metadata(KeyValue::new(key.clone(), value.clone()));
        }
        self.file.into_inner().map_err(io_error)
    }
}

fn properties(created_by: &str) -> Result<WriterProperties> {
    Ok(WriterProperties::builder()
        .set_created_by(created_by.to_owned())
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(ZSTD_LEVEL)?))
        // Measured numbers seldom repeat: a dictionary would be tried and abandoned.
        .set_dictionary_enabled(false)
        .set_encoding(Encoding::PLAIN)
        .set_statistics_enabled(EnabledStatistics::None)
        .set_offset_index_disabled(true)
        .set_data_page_row_count_limit(PAGE_ROWS)
        .build())
}

fn schema_of(table: &Table) -> Result<TypePtr> {
    let fields = table.columns.iter().map(field_of).collect::<Result<_>>()?;
    let root = Type::group_type_builder("trace").with_fields(fields).build()?;
    Ok(Arc::new(root))
}

fn field_of(column: &Column) -> Result<TypePtr> {
    let (physical, converted) = match column.values {
        Values::Double(_) => (Physical::DOUBLE, ConvertedType::NONE),
        Values::Whole(_) => (Physical::INT64, ConvertedType::NONE),
        Values::Text(_) => (Physical::BYTE_ARRAY, ConvertedType::UTF8),
    };
    let field = Type::primitive_type_builder(&column.name, physical)
        .with_repetition(Repetition::REQUIRED)
        .with_converted_type(converted)
        .build()?;
    Ok(Arc::new(field))
}

/// The error of the system, such as a full disk, if the crate passed it on.
fn io_error(error: ParquetError) -> io::Error {
    match error {
        ParquetError::External(source) => match source.downcast::<io::Error>() {
            Ok(error) => *error,
            Err(source) => io::Error::other(source),
        },
        error => io::Error::other(error),
    }
}
