//! Recording of the wire: pcapng, written by a separate thread, with a size limit.
//!
//! The cycle copies each frame into a queue and never waits; frames that do not fit are counted. The file keeps the most recent frames:
//! when it reaches half of its size, its contents are moved to a second file without a name, and recording starts again in the
//! empty file. At the end both halves are joined. On a full disk the older half gives way. The file always has whole blocks.

use core::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use core::time::Duration;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use evolvent_bridge::{confine_writer, monotonic_ns};
use rtrb::{Consumer, Producer, RingBuffer};

/// Size of the queue, bytes: several seconds of a network with 1 kHz and 200 bytes per cycle.
const QUEUE_BYTES: usize = 4 << 20;
/// Bytes of time, direction and length before each frame in the queue.
const HEADER: usize = 11;
/// Poll interval of the writer.
const POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Smallest file, bytes.
pub const MIN_DUMP_BYTES: u64 = 1 << 20;

/// Settings of a recording of the wire.
#[derive(Clone, Debug)]
pub struct DumpSettings {
    /// The file, which is created or replaced.
    pub path: PathBuf,
    /// Maximum size, bytes; at least [`MIN_DUMP_BYTES`].
    pub max_bytes: u64,
}

/// Direction of a frame, as the pcapng option has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    In = 1,
    Out = 2,
}

/// Counts of a recording.
#[derive(Debug, Default)]
pub(crate) struct DumpCounters {
    /// Frames written, including those that later ones have replaced.
    pub(crate) written: AtomicU64,
    /// Frames that did not fit into the queue.
    pub(crate) lost: AtomicU64,
    /// What has happened to the file and is not told yet: what, and in the lower half the number of the system's error; 0 if nothing.
    trouble: AtomicU64,
}

/// What happens to the file of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DumpTrouble {
    /// There was no space for the older half; recording continues.
    HalfDropped {
        /// The system's error.
        errno: i32,
    },
    /// The recording has ended. The file has what was written until then.
    Ended {
        /// The system's error.
        errno: i32,
    },
}

impl DumpCounters {
    fn report(&self, is_end: bool, error: &io::Error) {
        let errno = error.raw_os_error().unwrap_or(0).cast_unsigned();
        let trouble = (1 + u64::from(is_end)) << 32 | u64::from(errno);
        self.trouble.store(trouble, Ordering::Relaxed);
    }

    /// What has happened since the last time. The cycle may call it.
    pub(crate) fn take_trouble(&self) -> Option<DumpTrouble> {
        if self.trouble.load(Ordering::Relaxed) == 0 {
            return None;
        }
        let trouble = self.trouble.swap(0, Ordering::Relaxed);
        let errno = (trouble as u32).cast_signed();
        match trouble >> 32 {
            0 => None,
            1 => Some(DumpTrouble::HalfDropped { errno }),
            _ => Some(DumpTrouble::Ended { errno }),
        }
    }
}

/// A file, or a substitute in tests.
pub(crate) trait Store: Read + Write + Seek {
    fn set_len(&mut self, bytes: u64) -> io::Result<()>;
}

impl Store for File {
    fn set_len(&mut self, bytes: u64) -> io::Result<()> {
        Self::set_len(self, bytes)
    }
}

/// The cycle's end of the queue. It neither allocates nor waits.
pub(crate) struct DumpSender<'a> {
    queue: Producer<u8>,
    counters: &'a DumpCounters,
}

impl DumpSender<'_> {
    pub(crate) fn record(&mut self, direction: Direction, frame: &[u8]) {
        let Ok(length) = u16::try_from(frame.len()) else {
            return;
        };
        let Ok(chunk) = self.queue.write_chunk_uninit(HEADER + frame.len()) else {
            self.counters.lost.fetch_add(1, Ordering::Relaxed);
            return;
        };
        let time = monotonic_ns().to_le_bytes();
        let head = time
            .into_iter()
            .chain([direction as u8])
            .chain(length.to_le_bytes());
        chunk.fill_from_iter(head.chain(frame.iter().copied()));
    }
}

/// The writer's end of the queue.
#[derive(Debug)]
pub(crate) struct DumpWriter<'a, S = File> {
    queue: Consumer<u8>,
    counters: &'a DumpCounters,
    file: S,
    /// The older half, a file without a name, and its bytes.
    before: S,
    before_length: u64,
    half_bytes: u64,
    interface: String,
    /// Realtime minus monotonic, ns.
    epoch_ns: u64,
    length: u64,
    frame: Vec<u8>,
}

/// Checks that the file can be written, and keeps its contents.
pub(crate) fn check(settings: &DumpSettings) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(false);
    options.open(&settings.path).map(drop)
}

/// Opens a file and the queue to it.
pub(crate) fn open<'a>(
    settings: &DumpSettings,
    interface: &str,
    counters: &'a DumpCounters,
) -> io::Result<(DumpSender<'a>, DumpWriter<'a>)> {
    let open = |path: &Path| {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(true);
        options.open(path)
    };
    let file = open(&settings.path)?;
    let spare = settings
        .path
        .with_extension(format!("{}.part", std::process::id()));
    let before = open(&spare)?;
    std::fs::remove_file(&spare)?;
    pair(file, before, settings, interface, counters)
}

/// Creates a queue and the writer of these files.
fn pair<'a, S: Store>(
    file: S,
    before: S,
    settings: &DumpSettings,
    interface: &str,
    counters: &'a DumpCounters,
) -> io::Result<(DumpSender<'a>, DumpWriter<'a, S>)> {
    let (producer, consumer) = RingBuffer::new(QUEUE_BYTES);
    let now_ns = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default()
        .as_nanos() as u64;
    let mut writer = DumpWriter {
        queue: consumer,
        counters,
        file,
        before,
        before_length: 0,
        half_bytes: settings.max_bytes.max(MIN_DUMP_BYTES) / 2,
        interface: interface.to_owned(),
        epoch_ns: now_ns.wrapping_sub(monotonic_ns()),
        length: 0,
        frame: Vec::new(),
    };
    writer.begin()?;
    let sender = DumpSender {
        queue: producer,
        counters,
    };
    Ok((sender, writer))
}

impl<S: Store> DumpWriter<'_, S> {
    /// Writes frames until `ended` is set.
    ///
    /// # Errors
    /// A write fails, or the thread cannot drop its rights.
    pub(crate) fn run(mut self, ended: &AtomicBool) -> io::Result<()> {
        let _gaps = confine_writer()?;
        self.record(ended)
            .inspect_err(|error| self.counters.report(true, error))
    }

    fn record(&mut self, ended: &AtomicBool) -> io::Result<()> {
        loop {
            // Acquire: the queue then contains the last frames.
            let is_over = ended.load(Ordering::Acquire);
            self.drain()?;
            if is_over {
                return self.finish();
            }
            std::thread::sleep(POLL_INTERVAL);
        }
    }

    fn drain(&mut self) -> io::Result<()> {
        let mut blocks = Vec::new();
        while let Some((time_ns, direction)) = self.next_frame() {
            enhanced_packet(
                &mut blocks,
                time_ns.wrapping_add(self.epoch_ns),
                direction,
                &self.frame,
            );
            self.counters.written.fetch_add(1, Ordering::Relaxed);
            if self.length + blocks.len() as u64 >= self.half_bytes {
                self.write(&mut blocks)?;
                self.turn_over()?;
            }
        }
        self.write(&mut blocks)
    }

    /// The next frame of the queue, in `frame`.
    fn next_frame(&mut self) -> Option<(u64, u8)> {
        let head = self.queue.read_chunk(HEADER).ok()?;
        let mut bytes = [0; HEADER];
        let (first, second) = head.as_slices();
        bytes[..first.len()].copy_from_slice(first);
        bytes[first.len()..].copy_from_slice(second);
        head.commit_all();
        let [t0, t1, t2, t3, t4, t5, t6, t7, direction, l0, l1] = bytes;
        self.frame.clear();
        let chunk = self
            .queue
            .read_chunk(usize::from(u16::from_le_bytes([l0, l1])))
            .ok()?;
        let (first, second) = chunk.as_slices();
        self.frame.extend_from_slice(first);
        self.frame.extend_from_slice(second);
        chunk.commit_all();
        Some((u64::from_le_bytes([t0, t1, t2, t3, t4, t5, t6, t7]), direction))
    }

    /// Writes whole blocks. Without enough space the older half is dropped.
    fn write(&mut self, blocks: &mut Vec<u8>) -> io::Result<()> {
        if let Err(error) = self.append(blocks) {
            if self.before_length == 0 {
                return Err(error);
            }
            self.drop_older(&error)?;
            self.append(blocks)?;
        }
        blocks.clear();
        Ok(())
    }

    fn append(&mut self, blocks: &[u8]) -> io::Result<()> {
        if let Err(error) = self.file.write_all(blocks) {
            // Not a part of a block.
            self.cut()?;
            return Err(error);
        }
        self.length += blocks.len() as u64;
        Ok(())
    }

    /// Truncates the file to the complete blocks.
    fn cut(&mut self) -> io::Result<()> {
        self.file.set_len(self.length)?;
        self.file.seek(SeekFrom::Start(self.length))?;
        Ok(())
    }

    fn drop_older(&mut self, error: &io::Error) -> io::Result<()> {
        self.counters.report(false, error);
        self.empty_before()
    }

    fn empty_before(&mut self) -> io::Result<()> {
        self.before_length = 0;
        self.before.set_len(0)?;
        self.before.seek(SeekFrom::Start(0))?;
        Ok(())
    }

    /// Empties the file and writes the first blocks of a section.
    fn begin(&mut self) -> io::Result<()> {
        self.file.set_len(0)?;
        self.file.seek(SeekFrom::Start(0))?;
        self.length = 0;
        let mut blocks = Vec::new();
        section_header(&mut blocks);
        interface_description(&mut blocks, &self.interface);
        self.write(&mut blocks)
    }

    /// Moves the contents of the file to the older half.
    fn turn_over(&mut self) -> io::Result<()> {
        self.empty_before()?;
        self.file.seek(SeekFrom::Start(0))?;
        match copy(&mut self.file, &mut self.before, self.length) {
            Ok(()) => self.before_length = self.length,
            Err(error) => self.drop_older(&error)?,
        }
        self.begin()
    }

    /// Joins the halves: pcapng permits several sections in a file.
    fn finish(&mut self) -> io::Result<()> {
        let lost = self.counters.lost.load(Ordering::Relaxed);
        let mut blocks = Vec::new();
        interface_statistics(&mut blocks, monotonic_ns().wrapping_add(self.epoch_ns), lost);
        self.write(&mut blocks)?;
        if self.before_length > 0
            && let Err(error) = self.join()
        {
            self.cut()?;
            self.drop_older(&error)?;
        }
        self.file.flush()
    }

    /// Puts the older half before the newer one. This thread may open and rename no file (ADR 61), so what has no room is written first:
    /// the newer half is overwritten when all of the joined file has its place on the disk.
    ///
    /// # Errors
    /// There is not enough space. The first bytes of the file are the newer half, as before.
    fn join(&mut self) -> io::Result<()> {
        let (newer, older) = (self.length, self.before_length);
        // From its end: the halves may overlap.
        let mut buffer = vec![0; COPY_BYTES];
        let mut left = newer;
        while left > 0 {
            let count = left.min(COPY_BYTES as u64) as usize;
            left -= count as u64;
            self.file.seek(SeekFrom::Start(left))?;
            self.file.read_exact(&mut buffer[..count])?;
            self.file.seek(SeekFrom::Start(older + left))?;
            self.file.write_all(&buffer[..count])?;
        }
        let overlap = newer.min(older);
        for (from, until) in [(overlap, older), (0, overlap)] {
            self.before.seek(SeekFrom::Start(from))?;
            self.file.seek(SeekFrom::Start(from))?;
            copy(&mut self.before, &mut self.file, until - from)?;
        }
        self.length = newer + older;
        Ok(())
    }
}

const COPY_BYTES: usize = 1 << 16;

/// `std::io::copy` would use system calls that this thread has dropped.
fn copy(from: &mut impl Read, to: &mut impl Write, bytes: u64) -> io::Result<()> {
    let mut buffer = vec![0; COPY_BYTES];
    let mut left = bytes;
    while left > 0 {
        let count = left.min(COPY_BYTES as u64) as usize;
        from.read_exact(&mut buffer[..count])?;
        to.write_all(&buffer[..count])?;
        left -= count as u64;
    }
    Ok(())
}

/// A block: type, total length, body in words of four bytes, total length.
fn block(out: &mut Vec<u8>, kind: u32, body: impl FnOnce(&mut Vec<u8>)) {
    let begin = out.len();
    out.extend(kind.to_le_bytes());
    out.extend([0; 4]);
    body(out);
    out.resize(begin + (out.len() - begin).next_multiple_of(4), 0);
    let total = ((out.len() - begin + 4) as u32).to_le_bytes();
    out[begin + 4..begin + 8].copy_from_slice(&total);
    out.extend(total);
}

fn option(out: &mut Vec<u8>, code: u16, value: &[u8]) {
    out.extend(code.to_le_bytes());
    out.extend((value.len() as u16).to_le_bytes());
    out.extend(value);
    out.resize(out.len() + value.len().next_multiple_of(4) - value.len(), 0);
}

/// The end of options.
const END: [u8; 4] = [0; 4];

fn section_header(out: &mut Vec<u8>) {
    block(out, 0x0A0D_0D0A, |out| {
        out.extend(0x1A2B_3C4D_u32.to_le_bytes());
        // Version 1.0, of unknown length.
        out.extend([1, 0, 0, 0]);
        out.extend(u64::MAX.to_le_bytes());
        option(out, 4, b"evolvent bridge ethercat");
        out.extend(END);
    });
}

fn interface_description(out: &mut Vec<u8>, interface: &str) {
    block(out, 1, |out| {
        // Ethernet, no limit of the frame length.
        out.extend([1, 0, 0, 0, 0, 0, 0, 0]);
        option(out, 2, interface.as_bytes());
        // Times in ns.
        option(out, 9, &[9]);
        out.extend(END);
    });
}

/// Upper and lower 32 bits of a time.
fn time(out: &mut Vec<u8>, time_ns: u64) {
    out.extend(((time_ns >> 32) as u32).to_le_bytes());
    out.extend((time_ns as u32).to_le_bytes());
}

fn enhanced_packet(out: &mut Vec<u8>, time_ns: u64, direction: u8, frame: &[u8]) {
    block(out, 6, |out| {
        out.extend([0; 4]);
        time(out, time_ns);
        let length = (frame.len() as u32).to_le_bytes();
        out.extend(length);
        out.extend(length);
        out.extend(frame);
        out.resize(out.len() + frame.len().next_multiple_of(4) - frame.len(), 0);
        option(out, 2, &u32::from(direction).to_le_bytes());
        out.extend(END);
    });
}

fn interface_statistics(out: &mut Vec<u8>, time_ns: u64, lost: u64) {
    block(out, 5, |out| {
        out.extend([0; 4]);
        time(out, time_ns);
        option(out, 5, &lost.to_le_bytes());
        out.extend(END);
    });
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    fn settings(folder: &Path) -> DumpSettings {
        DumpSettings {
            path: folder.join("wire.pcapng"),
            max_bytes: MIN_DUMP_BYTES,
        }
    }

    /// Blocks of a file, type and body, by an independent reader.
    fn blocks(bytes: &[u8]) -> Vec<(u32, Vec<u8>)> {
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let (mut at, mut found) = (0, Vec::new());
        while at < bytes.len() {
            let total = word(at + 4) as usize;
            assert!(total.is_multiple_of(4) && total >= 12, "{total} at {at}");
            assert_eq!(word(at + total - 4) as usize, total, "both lengths");
            found.push((word(at), bytes[at + 8..at + total - 4].to_vec()));
            at += total;
        }
        found
    }

    /// Numbers of the frames in a file; the first bytes of each frame are its number.
    fn numbers(bytes: &[u8]) -> Vec<u32> {
        let packets = blocks(bytes).into_iter().filter(|(kind, _)| *kind == 6);
        packets
            .map(|(_, body)| u32::from_le_bytes(body[20..24].try_into().unwrap()))
            .collect()
    }

    #[test]
    fn a_file_keeps_the_last_frames_within_its_size() {
        let folder = tempfile::tempdir().unwrap();
        let counters = DumpCounters::default();
        let (mut sender, writer) = open(&settings(folder.path()), "ec0", &counters).unwrap();
        let ended = AtomicBool::new(false);
        const FRAMES: u32 = 20_000;
        std::thread::scope(|scope| {
            let writing = scope.spawn(|| writer.run(&ended));
            for number in 0..FRAMES {
                let mut frame = [0x55; 201];
                frame[..4].copy_from_slice(&number.to_le_bytes());
                let lost = counters.lost.load(Ordering::Relaxed);
                sender.record(Direction::Out, &frame);
                while counters.lost.load(Ordering::Relaxed) > lost {
                    // Not in a cycle: wait for the writer.
                    counters.lost.store(lost, Ordering::Relaxed);
                    std::thread::sleep(Duration::from_millis(1));
                    sender.record(Direction::Out, &frame);
                }
            }
            ended.store(true, Ordering::Relaxed);
            writing.join().unwrap().unwrap();
        });
        let bytes = std::fs::read(folder.path().join("wire.pcapng")).unwrap();
        assert!(
            bytes.len() as u64 <= MIN_DUMP_BYTES + 1024,
            "{} bytes",
            bytes.len()
        );
        assert!(bytes.len() as u64 > MIN_DUMP_BYTES / 2, "{} bytes", bytes.len());
        let numbers = numbers(&bytes);
        assert_eq!(numbers.last(), Some(&(FRAMES - 1)));
        assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "a gap");
        assert_eq!(counters.written.load(Ordering::Relaxed), u64::from(FRAMES));
        // The older half has no name.
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    /// A file on a disk of a certain size.
    struct Limited {
        file: File,
        length: u64,
        left: Arc<AtomicU64>,
    }

    impl Limited {
        fn new(folder: &Path, name: &str, left: &Arc<AtomicU64>) -> Self {
            let mut options = OpenOptions::new();
            let file = options.read(true).write(true).create(true).truncate(true);
            Self {
                file: file.open(folder.join(name)).unwrap(),
                length: 0,
                left: Arc::clone(left),
            }
        }
    }

    impl Read for Limited {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            self.file.read(buffer)
        }
    }

    impl Seek for Limited {
        fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
            self.file.seek(to)
        }
    }

    impl Write for Limited {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let at = self.file.stream_position()?;
            // A hole in a file takes room when it is filled; here already when it is made.
            let most = self.length + self.left.load(Ordering::Relaxed);
            let count = (bytes.len() as u64).min(most.saturating_sub(at)) as usize;
            if count == 0 && !bytes.is_empty() {
                return Err(io::Error::from_raw_os_error(ENOSPC));
            }
            let count = self.file.write(&bytes[..count])?;
            let grown = (at + count as u64).saturating_sub(self.length);
            self.length += grown;
            self.left.fetch_sub(grown, Ordering::Relaxed);
            Ok(count)
        }

        fn flush(&mut self) -> io::Result<()> {
            self.file.flush()
        }
    }

    impl Store for Limited {
        fn set_len(&mut self, bytes: u64) -> io::Result<()> {
            self.left
                .fetch_add(self.length.saturating_sub(bytes), Ordering::Relaxed);
            self.length = bytes;
            self.file.set_len(bytes)
        }
    }

    const ENOSPC: i32 = 28;

    /// Records frames on a disk of a size, of which others leave 10 kB from a frame on. Returns the numbers in the file, and what was told,
    /// with the number of the frame then.
    fn record_on(disk_bytes: u64, full_from: u32, frames: u32) -> (Vec<u32>, Vec<(u32, DumpTrouble)>) {
        let folder = tempfile::tempdir().unwrap();
        let (counters, left) = (DumpCounters::default(), Arc::new(AtomicU64::new(disk_bytes)));
        let [file, before] = ["wire.pcapng", "before"].map(|name| Limited::new(folder.path(), name, &left));
        let (mut sender, mut writer) =
            pair(file, before, &settings(folder.path()), "ec0", &counters).unwrap();
        let (mut reported, mut has_ended) = (Vec::new(), false);
        for number in 0..frames {
            let mut frame = [0x55; 201];
            frame[..4].copy_from_slice(&number.to_le_bytes());
            sender.record(Direction::Out, &frame);
            if number == full_from {
                left.store(10_000, Ordering::Relaxed);
            }
            if number % 10 == 9 && !has_ended {
                has_ended = writer
                    .drain()
                    .inspect_err(|error| counters.report(true, error))
                    .is_err();
            }
            reported.extend(counters.take_trouble().map(|trouble| (number, trouble)));
        }
        if !has_ended {
            writer.finish().unwrap();
        }
        reported.extend(counters.take_trouble().map(|trouble| (frames, trouble)));
        drop(writer);
        let bytes = std::fs::read(folder.path().join("wire.pcapng")).unwrap();
        assert!(bytes.len() as u64 <= disk_bytes.min(MIN_DUMP_BYTES + 1024));
        let numbers = numbers(&bytes);
        assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "a gap");
        (numbers, reported)
    }

    #[test]
    fn full_disk_drops_older_half_and_reports_at_once() {
        let (errno, half) = (ENOSPC, MIN_DUMP_BYTES / 2);
        // A frame takes 248 bytes, so that a half has some 2100.
        let (numbers, reported) = record_on(10 * MIN_DUMP_BYTES, u32::MAX, 10_000);
        assert!(reported.is_empty() && numbers.len() > 2114 && numbers.last() == Some(&9_999));
        // No space for two halves: the older one is dropped, the newest frames are kept, and all blocks are
        // whole.
        let (numbers, reported) = record_on(half + half / 2, u32::MAX, 10_000);
        assert!(
            numbers.len() > 100 && numbers.last() == Some(&9_999),
            "{}",
            numbers.len()
        );
        assert!(
            reported
                .iter()
                .all(|(_, trouble)| *trouble == DumpTrouble::HalfDropped { errno })
        );
        assert!(reported[0].0 > 2000 && reported[0].0 < 3400, "{reported:?}");
        // Other processes fill the disk while the newer half grows.
        let (numbers, reported) = record_on(10 * MIN_DUMP_BYTES, 3_000, 4_000);
        assert!(
            numbers[0] > 2000 && numbers.last() == Some(&3_999),
            "from {}",
            numbers[0]
        );
        assert!(
            matches!(reported[..], [(at, DumpTrouble::HalfDropped { .. })] if at < 3_060),
            "{reported:?}"
        );
        // Space for both halves, but not to join them: the newer one is unchanged.
        let (numbers, reported) = record_on(2 * half + 1024, u32::MAX, 3_000);
        assert!(
            numbers.len() > 500 && numbers.last() == Some(&2_999),
            "{}",
            numbers.len()
        );
        assert_eq!(reported, [(3_000, DumpTrouble::HalfDropped { errno })]);
        // Not even for a half: it ends, at once, with whole blocks.
        let (numbers, reported) = record_on(half / 2, u32::MAX, 3_000);
        assert!(numbers.len() > 900 && numbers[0] == 0, "{}", numbers.len());
        assert!(
            matches!(reported[..], [(at, DumpTrouble::Ended { .. })] if at < 1100),
            "{reported:?}"
        );
    }

    #[test]
    fn a_stalled_writer_loses_frames_and_does_not_block() {
        let folder = tempfile::tempdir().unwrap();
        let counters = DumpCounters::default();
        let (mut sender, writer) = open(&settings(folder.path()), "ec0", &counters).unwrap();
        for _ in 0..2 * QUEUE_BYTES / 1000 {
            sender.record(Direction::In, &[0; 1000]);
        }
        let lost = counters.lost.load(Ordering::Relaxed);
        assert!(lost >= QUEUE_BYTES as u64 / 1000, "{lost}");
        // The file has the frames of the queue and the number of lost ones. On a separate thread, because it drops its rights.
        std::thread::scope(|scope| scope.spawn(|| writer.run(&AtomicBool::new(true))).join().unwrap())
            .unwrap();
        let bytes = std::fs::read(folder.path().join("wire.pcapng")).unwrap();
        let (kind, body) = blocks(&bytes).pop().unwrap();
        assert_eq!(kind, 5, "statistics");
        assert_eq!(u64::from_le_bytes(body[16..24].try_into().unwrap()), lost);
    }
}
