//! What outlives the process: offsets, tools, parameters, in files that are replaced whole.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use evolvent_control::ToolEntry;
use evolvent_gcode::{KeptParameters, StoreError, Tool, ToolTable};
use evolvent_path::AXES;

use crate::memory::ProgramMemory;

/// Parameter that keeps which tool is in the spindle.
const TOOL_PARAMETER: u32 = 5400;

/// What was written, or why it was not.
pub(crate) type Saved = Result<ProgramMemory, StoreError>;

struct SaveOrder {
    memory: ProgramMemory,
    before: ProgramMemory,
    sender: Sender<Saved>,
}

/// Starts the thread that writes. It ends with the sender. Without it every save fails, and says so.
fn saver() -> Option<(Sender<SaveOrder>, JoinHandle<()>)> {
    let (sender, orders) = mpsc::channel::<SaveOrder>();
    let started = thread::Builder::new().name("saver".into()).spawn(move || {
        for order in orders {
            if let Some(folder) = order.memory.kept_file.as_ref().and_then(|file| file.parent()) {
                // Where this fails, writing fails too, and says why.
                let _ = std::fs::create_dir_all(folder);
            }
            let written = order.memory.save(&order.before);
            let _gone = order.sender.send(written.map(|_files| order.memory));
        }
    });
    started.ok().map(|thread| (sender, thread))
}

/// The memory of a machine, and its files.
#[derive(Debug)]
pub(crate) struct StateStore {
    pub memory: ProgramMemory,
    saved: ProgramMemory,
    /// Which tool is in the spindle.
    pub tool: u32,
    /// What could not be read, and was set aside.
    pub complaints: Vec<String>,
    /// The thread that writes, and the way to it.
    saver: Option<(Sender<SaveOrder>, JoinHandle<()>)>,
}

/// The folder of a machine's state: `$XDG_STATE_HOME/evolvent/NAME`, or that under `~/.local/state`.
#[must_use]
pub fn state_folder(machine_name: &str) -> PathBuf {
    let absolute = |variable: &str| {
        std::env::var_os(variable)
            .map(PathBuf::from)
            .filter(|path| path.is_absolute())
    };
    let base = absolute("XDG_STATE_HOME")
        .or_else(|| absolute("HOME").map(|home| home.join(".local/state")))
        .unwrap_or_else(|| PathBuf::from("/var/lib"));
    base.join("evolvent").join(machine_name)
}

impl StateStore {
    /// Takes what the machine file names, and what that leaves open from `folder`. A file that cannot be read is set
    /// aside as `NAME.damaged`, so that the machine can be started, and told of.
    pub(crate) fn open(mut memory: ProgramMemory, folder: &Path) -> Self {
        let mut complaints = Vec::new();
        let mut complain = |error: &StoreError, file: &Path| {
            let mut aside = file.as_os_str().to_owned();
            aside.push(".damaged");
            let moved = match std::fs::rename(file, &aside) {
                Ok(()) => format!("; it was set aside as {}", Path::new(&aside).display()),
                Err(_) => String::new(),
            };
            complaints.push(format!("{error}{moved}"));
        };
        if memory.kept_file.is_none() {
            let file = folder.join("parameters.var");
            if let Err(error) = memory.load_parameters(file.clone()) {
                complain(&error, &file);
                memory.kept = Some(KeptParameters::default());
                memory.kept_file = Some(file);
            }
        }
        if memory.tools_file.is_none() {
            let file = folder.join("tools.tbl");
            if file.exists()
                && let Err(error) = memory.load_tools(file.clone())
            {
                complain(&error, &file);
            }
            memory.tools.get_or_insert_with(ToolTable::default);
            memory.tools_file = Some(file);
        }
        let kept = memory.kept.as_ref().and_then(|kept| kept.get(TOOL_PARAMETER));
        let tool = kept.map_or(0.0, |number| number.clamp(0.0, 99_999.0)) as u32;
        Self {
            saved: memory.clone(),
            memory,
            tool,
            complaints,
            saver: saver(),
        }
    }

    /// Has `memory` written where it differs from what was written last; what comes of it is received. Nobody waits here: a disk
    /// may take long, or for ever. Of several, each is written after the one before.
    pub(crate) fn save(&self, mut memory: ProgramMemory) -> Receiver<Saved> {
        if let Some(kept) = &mut memory.kept {
            let known = kept.get(TOOL_PARAMETER).unwrap_or(0.0);
            if known != f64::from(self.tool) {
                kept.set(TOOL_PARAMETER, f64::from(self.tool));
            }
        }
        let (sender, result) = mpsc::channel();
        let order = SaveOrder {
            memory,
            before: self.saved.clone(),
            sender,
        };
        // Without its thread the sender is dropped, which is an answer too.
        if let Some((saver, _)) = &self.saver {
            let _gone = saver.send(order);
        }
        result
    }

    /// Waits, at most so long, until all is written that was to be.
    pub(crate) fn close(&mut self, timeout: Duration) {
        let Some((saver, thread)) = self.saver.take() else {
            return;
        };
        drop(saver);
        let begin = Instant::now();
        while !thread.is_finished() && begin.elapsed() < timeout {
            thread::sleep(Duration::from_millis(1));
        }
    }

    /// What was written counts from now on.
    pub(crate) fn take_saved(&mut self, memory: ProgramMemory) {
        self.saved.clone_from(&memory);
        self.memory = memory;
    }

    /// Takes over the tool table of the file.
    pub(crate) fn take_tools(&mut self, tools: ToolTable) {
        self.memory.tools = Some(tools);
        self.saved.tools.clone_from(&self.memory.tools);
    }

    /// The memory with a tool changed or added.
    pub(crate) fn with_tool(&self, entry: &ToolEntry) -> ProgramMemory {
        let mut memory = self.memory.clone();
        let tools = memory.tools.get_or_insert_with(ToolTable::default);
        let mut tool = tools
            .get(entry.number)
            .copied()
            .unwrap_or_else(|| Tool::new(entry.number));
        for i in 0..AXES {
            if entry.axes_mask >> i & 1 == 1 {
                tool.offset[i] = entry.offset[i];
            }
        }
        tool.diameter_mm = entry.diameter_mm.unwrap_or(tool.diameter_mm);
        tools.set(tool);
        memory
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evolvent_path::Axes;

    fn folder() -> tempfile::TempDir {
        tempfile::tempdir().unwrap()
    }

    #[test]
    fn offsets_tools_and_the_tool_in_the_spindle_outlive_a_restart() {
        let folder = folder();
        let inner = folder.path().join("made/on/demand");
        let mut keep = StateStore::open(ProgramMemory::default(), &inner);
        let offset = Axes::from_fn(|i, _| i as f64 + 0.1);
        assert!(keep.memory.kept.as_mut().unwrap().set_work_offset(3, &offset));
        keep.memory = keep.with_tool(&ToolEntry {
            number: 7,
            axes_mask: 0b100,
            offset: Axes::repeat(12.5),
            diameter_mm: Some(6.0),
        });
        keep.tool = 7;
        let saved = keep.save(keep.memory.clone()).recv().unwrap().unwrap();
        keep.take_saved(saved);
        let again = StateStore::open(ProgramMemory::default(), &inner);
        assert_eq!(again.memory.kept.as_ref().unwrap().work_offset(3), offset);
        let tool = again.memory.tools.as_ref().unwrap().get(7).copied().unwrap();
        assert_eq!(
            (tool.offset[2], tool.offset[0], tool.diameter_mm),
            (12.5, 0.0, 6.0)
        );
        assert_eq!(again.tool, 7);
        assert!(again.complaints.is_empty());
    }

    #[test]
    fn a_damaged_file_is_set_aside_and_told_of() {
        let folder = folder();
        std::fs::write(folder.path().join("parameters.var"), "rubbish").unwrap();
        std::fs::write(folder.path().join("tools.tbl"), "rubbish").unwrap();
        let keep = StateStore::open(ProgramMemory::default(), folder.path());
        assert_eq!(keep.complaints.len(), 2, "{:?}", keep.complaints);
        assert!(folder.path().join("parameters.var.damaged").exists());
        assert!(folder.path().join("tools.tbl.damaged").exists());
        assert!(keep.memory.kept.is_some() && keep.memory.tools.is_some());
    }
}
