//! Export of a trace as a table.

use std::io::{self, BufWriter, Write};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use evolvent_config::OutputFile;
use evolvent_trace::{ReadError, TraceFile};

use crate::columns::{Table, Values};
use crate::parquet::ParquetWriter;
use crate::selection::{ExportChannel, Selection};

/// Number of rows written at once: few for text, so that they stay in the cache.
const CSV_ROWS: usize = 512;
const PARQUET_ROWS: usize = 1 << 16;
const BUFFER_BYTES: usize = 1 << 18;
const CREATED_BY: &str = concat!("evolvent version ", env!("CARGO_PKG_VERSION"));

/// Format of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// Comma-separated text with a header; numbers in the shortest form that reads back to the same bits.
    Csv,
    /// Apache Parquet.
    Parquet,
}

/// Why an export failed.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// The trace.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The trace has no description of the run, so its axes have no names.
    #[error("the trace has no description of the run, so its columns have no names")]
    NoRun,
    /// The table cannot be written.
    #[error("{} cannot be written: {source}; free some space or choose another path", .path.display())]
    Write {
        /// Where to.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
}

/// Size of the export.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Exported {
    /// Rows without the header.
    pub rows: u64,
    /// Bytes of the table.
    pub bytes: u64,
}

enum Writer<W: Write + Send> {
    Csv(W),
    Parquet(ParquetWriter<W>),
}

/// Writes the selected part of a trace; the file receives its name when it is complete.
///
/// # Errors
/// [`ExportError`]; no file is left behind.
pub fn export(
    trace: &mut TraceFile,
    channel: ExportChannel,
    selection: &Selection,
    format: ExportFormat,
    output: &Path,
) -> Result<Exported, ExportError> {
    let write_error = |source| ExportError::Write {
        path: output.to_owned(),
        source,
    };
    let file = OutputFile::create(output).map_err(write_error)?;
    let buffered = BufWriter::with_capacity(BUFFER_BYTES, file);
    let (rows, buffered) = export_to(trace, channel, selection, format, (buffered, output))?;
    let file = buffered
        .into_inner()
        .map_err(|error| write_error(error.into_error()))?;
    let bytes = file.finish().map_err(write_error)?;
    Ok(Exported { rows, bytes })
}

fn export_to<W: Write + Send>(
    trace: &mut TraceFile,
    channel: ExportChannel,
    selection: &Selection,
    format: ExportFormat,
    (out, name): (W, &Path),
) -> Result<(u64, W), ExportError> {
    let run = trace.info().run.clone().ok_or(ExportError::NoRun)?;
    let write_error = |source| ExportError::Write {
        path: name.to_owned(),
        source,
    };
    let start_ns = run.start_time_ns;
    let (first_ns, last_ns) = selection.span_ns(start_ns);
    let mut table = match channel {
        ExportChannel::Cycles => Table::of_cycles(&run.axes, start_ns),
        ExportChannel::Events => Table::of_events(start_ns),
        ExportChannel::Blocks => Table::of_blocks(start_ns),
    };
    let (mut writer, max) = match format {
        ExportFormat::Csv => {
            let mut out = out;
            let names: Vec<&str> = table.columns.iter().map(|column| column.name.as_str()).collect();
            writeln!(out, "{}", names.join(",")).map_err(write_error)?;
            (Writer::Csv(out), CSV_ROWS)
        }
        ExportFormat::Parquet => {
            let writer = ParquetWriter::new(out, &table, CREATED_BY).map_err(write_error)?;
            (Writer::Parquet(writer), PARQUET_ROWS)
        }
    };
    let mut rows = 0;
    let mut flush = |table: &mut Table, min: usize| -> Result<(), ExportError> {
        if table.rows() < min.max(1) {
            return Ok(());
        }
        rows += table.rows() as u64;
        match &mut writer {
            Writer::Csv(out) => write_csv(out, table),
            Writer::Parquet(writer) => writer.write(table),
        }
        .map_err(write_error)?;
        table.clear();
        Ok(())
    };
    let within = |time_ns: u64| (first_ns..=last_ns).contains(&time_ns);
    match channel {
        ExportChannel::Cycles => {
            trace.each_cycle(first_ns, last_ns, |record| -> Result<_, ExportError> {
                if selection.has_line(record.line) {
                    table.push_cycle(record);
                    flush(&mut table, max)?;
                }
                Ok(ControlFlow::Continue(()))
            })?;
        }
        ExportChannel::Events => {
            for record in trace.events() {
                let record = record?;
                if within(record.time_ns) {
                    table.push_event(&record);
                    flush(&mut table, max)?;
                }
            }
        }
        ExportChannel::Blocks => {
            for record in trace.blocks() {
                let record = record?;
                if within(record.time_ns) && selection.has_line(record.line) {
                    table.push_block(&record);
                    flush(&mut table, max)?;
                }
            }
        }
    }
    flush(&mut table, 1)?;
    let out = match writer {
        Writer::Csv(out) => out,
        Writer::Parquet(writer) => {
            let notes = [
                ("evolvent.program".to_owned(), run.program_name.clone()),
                ("evolvent.machine".to_owned(), run.machine_name.clone()),
                ("evolvent.period_ns".to_owned(), run.period_ns.to_string()),
                ("evolvent.start_time_ns".to_owned(), start_ns.to_string()),
            ];
            writer.finish(&notes).map_err(write_error)?
        }
    };
    Ok((rows, out))
}

fn write_csv(out: &mut impl Write, table: &Table) -> io::Result<()> {
    let mut buffer = zmij::Buffer::new();
    let mut line = Vec::with_capacity(1024);
    for row in 0..table.rows() {
        line.clear();
        for (at, column) in table.columns.iter().enumerate() {
            if at > 0 {
                line.push(b',');
            }
            match &column.values {
                Values::Double(values) => put_double(&mut line, values[row], &mut buffer),
                Values::Whole(values) => put_whole(&mut line, values[row]),
                Values::Text(values) => put_text(&mut line, &values[row]),
            }
        }
        line.push(b'\n');
        out.write_all(&line)?;
    }
    Ok(())
}

/// A value that is not a number is an empty field.
fn put_double(line: &mut Vec<u8>, value: f64, buffer: &mut zmij::Buffer) {
    if value == 0.0 {
        line.extend_from_slice(if value.is_sign_negative() { b"-0" } else { b"0" });
    } else if value.is_finite() {
        line.extend_from_slice(buffer.format_finite(value).as_bytes());
    } else if value.is_infinite() {
        line.extend_from_slice(if value > 0.0 { b"inf" } else { b"-inf" });
    }
}

fn put_whole(line: &mut Vec<u8>, value: i64) {
    let mut digits = [0_u8; 20];
    let mut at = digits.len();
    let mut rest = value.unsigned_abs();
    loop {
        at -= 1;
        digits[at] = b'0' + (rest % 10) as u8;
        rest /= 10;
        if rest == 0 {
            break;
        }
    }
    if value < 0 {
        line.push(b'-');
    }
    line.extend_from_slice(&digits[at..]);
}

fn put_text(line: &mut Vec<u8>, text: &str) {
    if text.contains(['"', ',', '\n', '\r']) {
        line.push(b'"');
        line.extend_from_slice(text.replace('"', "\"\"").as_bytes());
        line.push(b'"');
    } else {
        line.extend_from_slice(text.as_bytes());
    }
}

#[cfg(test)]
mod tests {
    use evolvent_path::AxisLetter;
    use evolvent_trace::{CycleRecord, Recorder, RunInfo};

    use super::*;

    /// A full disk.
    struct Full;

    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(io::ErrorKind::StorageFull.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_full_disk_is_told_with_the_name_of_the_table() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let info = RunInfo {
            axes: vec![AxisLetter::X],
            period_ns: 1_000_000,
            ..RunInfo::default()
        };
        let mut recorder = Recorder::create(&path, &info).unwrap();
        recorder.cycle(&CycleRecord::default()).unwrap();
        recorder.finish(&std::collections::BTreeMap::new()).unwrap();
        let mut trace = TraceFile::open(&path).unwrap();
        for format in [ExportFormat::Csv, ExportFormat::Parquet] {
            let all = Selection::default();
            let out = (Full, Path::new("table.csv"));
            let Err(error) = export_to(&mut trace, ExportChannel::Cycles, &all, format, out) else {
                panic!("written to a full disk");
            };
            let text = error.to_string();
            assert!(text.starts_with("table.csv cannot be written: "), "{text}");
        }
    }
}
