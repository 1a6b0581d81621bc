//! The description of a run: the metadata and attachments that make a trace self-contained for replay.

use std::collections::BTreeMap;
use std::path::PathBuf;

use evolvent_path::AxisLetter;

/// Key of [`RunInfo::extra`] in a file that continues another one: the number of its first cycle.
pub const CONTINUES_AT: &str = "continues_at";
/// Value of the metadata for cycles in columns.
const COLUMNS: &str = "columns";

/// Source of the program's text that is attached to the trace.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum ProgramSource {
    /// No program: jogging, or a program that is not kept.
    #[default]
    None,
    /// The text itself.
    Bytes(Vec<u8>),
    /// A file, copied piece by piece, whatever its size.
    File(PathBuf),
}

/// The description of a run at its start, written to the metadata `evolvent.run` and the attachments.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunInfo {
    /// Name of the program, the attachment's name.
    pub program_name: String,
    /// The program's text.
    pub program: ProgramSource,
    /// Name of the machine.
    pub machine_name: String,
    /// Name of the machine file, the attachment's name.
    pub machine_file_name: String,
    /// Text of the machine file.
    pub machine_file: String,
    /// Name and content of the tool table.
    pub tool_table: Option<(String, Vec<u8>)>,
    /// Name and content of the stored parameters (work offsets and so on) at the start of the program.
    pub parameters: Option<(String, Vec<u8>)>,
    /// Names and contents of the files that the machine file names: tables of screw errors.
    pub tables: Vec<(String, Vec<u8>)>,
    /// The machine's axes in the order of its file: which of the nine are written, and in what order.
    pub axes: Vec<AxisLetter>,
    /// The control period, ns.
    pub period_ns: u64,
    /// When the run started, Unix time in ns.
    pub start_time_ns: u64,
    /// Names and versions of the participating software, for example `("evolvent", "0.1.0")`.
    pub versions: BTreeMap<String, String>,
    /// Identifies the configuration; see [`configuration_hash`].
    pub configuration_hash: String,
    /// `realtime` or `virtual`.
    pub clock: String,
    /// The real-time settings in force, as text: scheduler, priority, core, locked memory.
    pub real_time: String,
    /// Whether the cycles are stored in columns (`/cycles`), with `/cycle` reduced and rounded for viewers;
    /// otherwise `/cycle` has one exact message per cycle.
    pub columns: bool,
    /// Anything else to keep, by key.
    pub extra: BTreeMap<String, String>,
}

/// Identifies a configuration by its bytes: 16 hexadecimal digits of FNV-1a, 64 bit (Fowler, Noll, Vo).
///
/// Distinguishes configurations; does not protect against forgery. Parts are separated, so that moving a byte
/// from one to the next gives another hash.
///
/// ```
/// use evolvent_trace::configuration_hash;
/// assert_ne!(configuration_hash(&[b"ab", b"c"]), configuration_hash(&[b"a", b"bc"]));
/// ```
#[must_use]
pub fn configuration_hash(parts: &[&[u8]]) -> String {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut eat = |byte: u8| hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    for part in parts {
        part.iter().copied().for_each(&mut eat);
        (part.len() as u64).to_le_bytes().into_iter().for_each(&mut eat);
    }
    format!("{hash:016x}")
}

impl RunInfo {
    /// The number of the first cycle: 0, except in a file that continues an earlier one.
    #[must_use]
    pub fn first_sequence(&self) -> u64 {
        let continued = self.extra.get(CONTINUES_AT);
        continued.and_then(|text| text.parse().ok()).unwrap_or(0)
    }

    /// The metadata `evolvent.run`.
    pub(crate) fn to_metadata(&self) -> BTreeMap<String, String> {
        let mut map: BTreeMap<String, String> = self
            .extra
            .iter()
            .map(|(key, value)| (format!("extra.{key}"), value.clone()))
            .collect();
        for (name, version) in &self.versions {
            map.insert(format!("version.{name}"), version.clone());
        }
        let mut put = |key: &str, value: String| map.insert(key.to_owned(), value);
        put("program", self.program_name.clone());
        put("machine", self.machine_name.clone());
        put("machine_file", self.machine_file_name.clone());
        put(
            "tool_table",
            self.tool_table
                .as_ref()
                .map(|(name, _)| name.clone())
                .unwrap_or_default(),
        );
        put(
            "parameters",
            self.parameters
                .as_ref()
                .map(|(name, _)| name.clone())
                .unwrap_or_default(),
        );
        put("axes", self.axes.iter().map(|axis| axis.letter()).collect());
        put("period_ns", self.period_ns.to_string());
        put("start_time_ns", self.start_time_ns.to_string());
        put("configuration_hash", self.configuration_hash.clone());
        put(
            "cycles",
            if self.columns { COLUMNS } else { "messages" }.to_owned(),
        );
        put("clock", self.clock.clone());
        put("real_time", self.real_time.clone());
        map
    }

    /// Reads the metadata; the attachments are not loaded. `None` if a key is missing or not a number.
    pub(crate) fn from_metadata(map: &BTreeMap<String, String>) -> Option<Self> {
        let get = |key: &str| map.get(key).cloned();
        let with_prefix = |prefix: &str| {
            map.iter()
                .filter_map(|(key, value)| Some((key.strip_prefix(prefix)?.to_owned(), value.clone())))
                .collect()
        };
        Some(Self {
            program_name: get("program")?,
            program: ProgramSource::None,
            machine_name: get("machine")?,
            machine_file_name: get("machine_file")?,
            machine_file: String::new(),
            tool_table: None,
            parameters: None,
            tables: Vec::new(),
            axes: get("axes")?
                .chars()
                .map(AxisLetter::from_letter)
                .collect::<Option<_>>()?,
            period_ns: get("period_ns")?.parse().ok()?,
            start_time_ns: get("start_time_ns")?.parse().ok()?,
            versions: with_prefix("version."),
            configuration_hash: get("configuration_hash")?,
            clock: get("clock")?,
            real_time: get("real_time")?,
            columns: get("cycles").is_some_and(|cycles| cycles == COLUMNS),
            extra: with_prefix("extra."),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hash_is_fnv_1a_and_tells_parts_apart() {
        // The offset basis is the hash of nothing; "a" has af63dc4c8601ec8c (reference vectors of the
        // authors), then comes the part's length.
        assert_eq!(configuration_hash(&[]), "cbf29ce484222325");
        assert_ne!(
            configuration_hash(&[b"ab", b"c"]),
            configuration_hash(&[b"a", b"bc"])
        );
        let mut expected = 0xaf63_dc4c_8601_ec8c_u64;
        for byte in 1_u64.to_le_bytes() {
            expected = (expected ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
        assert_eq!(configuration_hash(&[b"a"]), format!("{expected:016x}"));
    }

    #[test]
    fn metadata_carries_everything_but_the_attachments() {
        let info = RunInfo {
            program_name: "part.ngc".into(),
            machine_name: "mill".into(),
            machine_file_name: "mill.toml".into(),
            axes: vec![AxisLetter::X, AxisLetter::C, AxisLetter::Z],
            period_ns: 123_457,
            start_time_ns: 1_700_000_000_000_000_001,
            versions: [("evolvent".to_owned(), "0.1.0".to_owned())].into(),
            configuration_hash: configuration_hash(&[b"x"]),
            clock: "virtual".into(),
            real_time: "none".into(),
            columns: true,
            extra: [("lead".to_owned(), "2".to_owned())].into(),
            ..RunInfo::default()
        };
        assert_eq!(RunInfo::from_metadata(&info.to_metadata()), Some(info));
        assert_eq!(RunInfo::from_metadata(&BTreeMap::new()), None);
    }
}
