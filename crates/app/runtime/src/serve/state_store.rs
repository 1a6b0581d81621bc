//! State that survives the process: offsets, tools and parameters, in files that are replaced as a whole.

use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use evolvent_control::ToolEntry;
use evolvent_gcode::{PersistentParameters, StoreError, Tool, ToolTable};
use evolvent_path::AXES;

use super::change_mark::ChangeMark;
use crate::memory::ProgramMemory;

/// Parameter that stores the number of the tool in the spindle.
const TOOL_PARAMETER: u32 = 5400;

/// What was saved, or the error.
pub(crate) type Saved = Result<ProgramMemory, StoreError>;

/// What a save does with the mark of a tool change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Marking {
    Leave,
    /// Set before anything else.
    Set(ChangeMark),
    /// Removed after everything else.
    Remove,
}

struct SaveOrder {
    memory: ProgramMemory,
    before: ProgramMemory,
    marking: Marking,
    folder: PathBuf,
    sender: Sender<Saved>,
}

impl SaveOrder {
    fn carry_out(&self) -> Result<(), StoreError> {
        for folder in [
            self.memory.kept_file.as_ref().and_then(|file| file.parent()),
            Some(&*self.folder),
        ] {
            // If this fails, writing fails too and reports why.
            let _ = std::fs::create_dir_all(folder.unwrap_or(Path::new("")));
        }
        if let Marking::Set(mark) = self.marking {
            return mark.write(&self.folder);
        }
        self.memory.save(&self.before)?;
        if self.marking == Marking::Remove {
            ChangeMark::remove(&self.folder)?;
        }
        Ok(())
    }
}

/// Starts the thread that writes; it ends with the sender. Without a thread every save returns an error.
fn saver() -> Option<(Sender<SaveOrder>, JoinHandle<()>)> {
    let (sender, orders) = mpsc::channel::<SaveOrder>();
    let started = thread::Builder::new().name("saver".into()).spawn(move || {
        for order in orders {
            let written = order.carry_out();
            let _gone = order.sender.send(written.map(|()| order.memory));
        }
    });
    started.ok().map(|thread| (sender, thread))
}

/// The memory of a machine, and its files.
#[derive(Debug)]
pub(crate) struct StateStore {
    pub memory: ProgramMemory,
    saved: ProgramMemory,
    /// The tool in the spindle.
    pub tool: u32,
    /// A tool change that has begun. Until it ends, or the operator declares the tool, the tool is unknown.
    pub change: Option<ChangeMark>,
    /// The change belongs to the present job.
    pub is_change_under_way: bool,
    folder: PathBuf,
    /// Messages about files that could not be read and were set aside.
    pub complaints: Vec<String>,
    /// The writing thread and its channel.
    saver: Option<(Sender<SaveOrder>, JoinHandle<()>)>,
}

/// The folder of a machine's state: `$XDG_STATE_HOME/evolvent/NAME`, or `~/.local/state/evolvent/NAME`.
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
    /// Opens the files that the machine file names, and the others in `folder`. A file that cannot be read is
    /// set aside as `NAME.damaged` and reported, so that the machine can start.
    pub(crate) fn open(mut memory: ProgramMemory, folder: &Path) -> Self {
        let mut complaints = Vec::new();
        let mut change = ChangeMark::read(folder);
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
                // The file contained the tool in the spindle. The tool is unknown until the operator declares
                // it, also after another restart.
                if change.is_none() {
                    let mark = ChangeMark::UNKNOWN;
                    // If this fails, the next start finds the same damaged file and reports it again.
                    let _unwritten = mark.write(folder);
                    change = Some(mark);
                }
                memory.kept = Some(PersistentParameters::default());
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
            change,
            is_change_under_way: false,
            folder: folder.to_path_buf(),
            complaints,
            saver: saver(),
        }
    }

    /// Saves `memory` as far as it differs from what was saved last; the result is sent to the receiver. Does
    /// not wait, because a disk may take any time. Saves are carried out in order.
    pub(crate) fn save(&self, memory: ProgramMemory) -> Receiver<Saved> {
        self.save_and_mark(memory, Marking::Leave)
    }

    /// Writes the mark of a tool change. The change may begin once it is written.
    pub(crate) fn begin_change(&mut self, to: u32) -> Receiver<Saved> {
        let mark = ChangeMark::new(self.tool, to);
        (self.change, self.is_change_under_way) = (Some(mark), true);
        self.save_and_mark(self.memory.clone(), Marking::Set(mark))
    }

    /// Notes that another tool is in the spindle. With `is_random` the previous one is now in its pocket.
    pub(crate) fn take_tool(&mut self, tool: u32, is_random: bool) -> Receiver<Saved> {
        if is_random && let Some(tools) = &mut self.memory.tools {
            tools.swap_pockets(tool, self.tool);
        }
        (self.tool, self.change, self.is_change_under_way) = (tool, None, false);
        let saving = self.save_and_mark(self.memory.clone(), Marking::Remove);
        // A later save writes the difference from this one.
        self.saved = self.with_tool_kept(self.memory.clone());
        saving
    }

    /// What is on disk is unknown: the next save writes everything.
    pub(crate) fn forget_saved(&mut self) {
        self.saved = ProgramMemory::default();
    }

    /// Removes the mark of a tool change that has not begun.
    pub(crate) fn forget_change(&mut self) -> Receiver<Saved> {
        (self.change, self.is_change_under_way) = (None, false);
        self.save_and_mark(self.memory.clone(), Marking::Remove)
    }

    /// The memory with the tool in the spindle among its parameters.
    fn with_tool_kept(&self, mut memory: ProgramMemory) -> ProgramMemory {
        if let Some(kept) = &mut memory.kept {
            let known = kept.get(TOOL_PARAMETER).unwrap_or(0.0);
            if known != f64::from(self.tool) {
                kept.set(TOOL_PARAMETER, f64::from(self.tool));
            }
        }
        memory
    }

    fn save_and_mark(&self, memory: ProgramMemory, marking: Marking) -> Receiver<Saved> {
        let memory = self.with_tool_kept(memory);
        let (sender, result) = mpsc::channel();
        let order = SaveOrder {
            memory,
            before: self.saved.clone(),
            marking,
            folder: self.folder.clone(),
            sender,
        };
        // Without its thread the sender is dropped, which reports the failure.
        if let Some((saver, _)) = &self.saver {
            let _gone = saver.send(order);
        }
        result
    }

    /// Waits until all pending saves are written, at most for `timeout`.
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

    /// Makes the saved memory the present one.
    pub(crate) fn take_saved(&mut self, memory: ProgramMemory) {
        self.saved.clone_from(&memory);
        self.memory = memory;
    }

    /// Takes over the tool table from its file.
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
            if entry.axes.contains(i) {
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
    fn offsets_tools_and_loaded_tool_survive_a_restart() {
        let folder = folder();
        let inner = folder.path().join("made/on/demand");
        let mut store = StateStore::open(ProgramMemory::default(), &inner);
        let offset = Axes::from_fn(|i, _| i as f64 + 0.1);
        assert!(store.memory.kept.as_mut().unwrap().set_work_offset(3, &offset));
        store.memory = store.with_tool(&ToolEntry {
            number: 7,
            axes: evolvent_path::AxisMask::one(2),
            offset: Axes::repeat(12.5),
            diameter_mm: Some(6.0),
        });
        store.tool = 7;
        let saved = store.save(store.memory.clone()).recv().unwrap().unwrap();
        store.take_saved(saved);
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
        let store = StateStore::open(ProgramMemory::default(), folder.path());
        assert_eq!(store.complaints.len(), 2, "{:?}", store.complaints);
        assert!(folder.path().join("parameters.var.damaged").exists());
        assert!(folder.path().join("tools.tbl.damaged").exists());
        assert!(store.memory.kept.is_some() && store.memory.tools.is_some());
        // The damaged file stored the tool in the spindle, so the tool is unknown, also after another
        // restart.
        assert_eq!(store.change, Some(ChangeMark::UNKNOWN));
        let again = StateStore::open(ProgramMemory::default(), folder.path());
        assert_eq!(
            (again.change, again.complaints.len()),
            (Some(ChangeMark::UNKNOWN), 0)
        );
    }
}
