//! What server and page say to each other. TypeScript of the same is made from these types (`tests/generated.rs`).

mod finding;
mod from_page;
mod kept;
mod lease;
mod log_entry;
mod machine_info;
mod path_chunk;
mod program_info;
mod sample;
mod screen_status;
mod to_page;

pub use finding::Finding;
pub use from_page::{CommandMessage, FromPage};
pub use kept::{ToolEntry, WorkOffset};
pub use lease::Lease;
pub use log_entry::{LogEntry, LogKind};
pub use machine_info::{AxisInfo, MachineInfo};
pub use path_chunk::{PathChunk, VERTEX_BYTES};
pub use program_info::ProgramInfo;
pub use sample::{SAMPLE_BYTES, put_sample};
pub use screen_status::ScreenStatus;
pub use to_page::ToPage;
