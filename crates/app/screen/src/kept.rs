//! Offsets and tools as stored by the service, and macros: polled, and sent to pages.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use evolvent_runtime::Setup;

use crate::macro_file::MacroWatch;
use crate::messages::{ToPage, ToolEntry, WorkOffset};
use crate::server::Server;

/// Poll interval of offsets, tools and macros.
const KEPT: Duration = Duration::from_millis(500);

/// The machine with the present offsets and tools.
pub(crate) fn present_setup(setup: &Setup, state_folder: Option<&Path>) -> Setup {
    let mut setup = setup.clone();
    let Some(state_folder) = state_folder else {
        return setup;
    };
    // The core reports unreadable files; the path is drawn without them.
    let kept = setup.memory.kept_file.clone();
    let _unread = setup
        .memory
        .load_parameters(kept.unwrap_or_else(|| state_folder.join("parameters.var")));
    let tools = setup.memory.tools_file.clone();
    let _unread = setup
        .memory
        .load_tools(tools.unwrap_or_else(|| state_folder.join("tools.tbl")));
    setup
}

/// The present offsets and tools.
fn kept(setup: &Setup, state_folder: Option<&Path>) -> ToPage {
    let memory = present_setup(setup, state_folder).memory;
    let text = memory.kept.map(|kept| kept.to_text()).unwrap_or_default();
    let parameter = |number: u32| {
        text.lines().find_map(|line| {
            let mut words = line.split_whitespace();
            (words.next()?.parse() == Ok(number)).then(|| words.next()?.parse::<f64>().ok())?
        })
    };
    let axes: Vec<usize> = setup
        .machine
        .axes
        .iter()
        .map(|axis| axis.letter.index())
        .collect();
    let offsets = (1..=9).map(|system| WorkOffset {
        system,
        values: axes
            .iter()
            .map(|&axis| parameter(5201 + 20 * system + axis as u32).unwrap_or(0.0))
            .collect(),
        rotation_deg: parameter(5210 + 20 * system).unwrap_or(0.0),
    });
    let tools = memory
        .tools
        .iter()
        .flat_map(|table| table.tools().iter().map(move |tool| (table, tool)))
        .map(|(table, tool)| ToolEntry {
            number: tool.number,
            offsets: axes.iter().map(|&axis| tool.offset[axis]).collect(),
            diameter: tool.diameter_mm,
            orientation: tool.orientation,
            angles_deg: [tool.front_angle_deg, tool.back_angle_deg],
            comment: table.remark(tool.number).to_owned(),
        });
    ToPage::Kept {
        offsets: offsets.collect(),
        tools: tools.collect(),
    }
}

/// Sends changed offsets, tools and macros to pages while the server runs.
pub(crate) async fn watch_kept(server: Arc<Server>) {
    let macros = Arc::new(Mutex::new(MacroWatch::default()));
    loop {
        let (of_thread, macros) = (Arc::clone(&server), Arc::clone(&macros));
        let read = move || {
            let kept = kept(&of_thread.setup, of_thread.state_folder.as_deref());
            of_thread.hub.tell_kept(kept);
            let mut macros = macros.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some((file, must_exist)) = &of_thread.macros
                && let Some(news) = macros.poll(file, *must_exist)
            {
                of_thread.hub.tell_macros(news);
            }
        };
        // It is read again soon.
        let _read = tokio::task::spawn_blocking(read).await;
        tokio::time::sleep(KEPT).await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tools_and_rotations_of_files_reach_pages() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        write(
            "tools.tbl",
            "T3 P3 Z12.5 D0.8 I95 J155 Q2 ; roughing, CNMG\nT4 P4 D6\n",
        );
        write("parameters.var", "5221 1.5\n5250 30\n");
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../config/machines/mill-3axis.toml");
        let machine = evolvent_machine::Machine::load(&file).unwrap();
        let setup = Setup::new(machine, file, String::new(), None).unwrap();
        let ToPage::Kept { offsets, tools } = kept(&setup, Some(folder.path())) else {
            unreachable!()
        };
        assert_eq!(offsets[0].values[0], 1.5);
        assert_eq!([offsets[0].rotation_deg, offsets[1].rotation_deg], [0.0, 30.0]);
        let [first, second] = tools.as_slice() else {
            panic!("{tools:?}")
        };
        assert_eq!((first.orientation, first.angles_deg), (2, [95.0, 155.0]));
        assert_eq!(first.comment, "roughing, CNMG");
        assert_eq!((second.orientation, second.comment.as_str()), (0, ""));
    }
}
