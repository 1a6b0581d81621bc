//! Messages between server and page. The page's TypeScript is generated from these types
//! (`tests/generated.rs`).

mod finding;
mod from_page;
mod handwheel_info;
mod kept;
mod lease;
mod log_entry;
mod log_fact;
mod machine_info;
mod macro_button;
mod path_chunk;
mod process_info;
mod program_info;
mod refusal;
mod restart_info;
mod sample;
mod screen_status;
mod signal_info;
mod spindle_status;
mod to_page;
mod trace_entry;

pub use finding::Finding;
pub use from_page::{CommandMessage, FromPage};
pub use handwheel_info::HandwheelInfo;
pub use kept::{ToolEntry, WorkOffset};
pub use lease::Lease;
pub use log_entry::{LogEntry, LogKind};
pub use log_fact::LogFact;
pub use machine_info::{AxisInfo, MachineInfo};
pub use macro_button::MacroButton;
pub use path_chunk::{CHUNK_HEADER_BYTES, PathChunk, PathKind, VERTEX_BYTES};
pub use process_info::ProcessInfo;
pub use program_info::ProgramInfo;
pub use refusal::Refusal;
pub use restart_info::RestartInfo;
pub use sample::{SAMPLE_BYTES, SampleAnswer, put_sample};
pub use screen_status::ScreenStatus;
pub use signal_info::{SignalInfo, SignalValues};
pub use spindle_status::SpindleStatus;
pub use to_page::{EndOf, ToPage};
pub use trace_entry::{TraceEntry, TraceJob};
