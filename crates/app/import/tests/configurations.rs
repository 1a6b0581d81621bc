//! Every configuration in a folder gives a machine file or an error, never a crash.
//!
//! LinuxCNC's own configurations are not part of this repository. The folder is that of
//! EVOLVENT_LINUXCNC_CONFIGS, or the samples of Debian's linuxcnc-uspace if installed; otherwise the test
//! prints "not measured".

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use evolvent_import::import;

fn ini_files(folder: &Path, out: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    for entry in entries.flatten() {
        let path = entry.path();
        if path.is_dir() && !path.is_symlink() {
            ini_files(&path, out);
        } else if path.extension().is_some_and(|ending| ending == "ini") {
            out.push(path);
        }
    }
}

#[test]
fn linuxcnc_configurations_convert_or_are_refused() {
    let folder = std::env::var_os("EVOLVENT_LINUXCNC_CONFIGS")
        .unwrap_or_else(|| "/usr/share/doc/linuxcnc/examples/sample-configs".into());
    let mut files = Vec::new();
    ini_files(Path::new(&folder), &mut files);
    files.sort();
    if files.is_empty() {
        println!(
            "not measured: no configurations of LinuxCNC in {}",
            Path::new(&folder).display()
        );
        return;
    }
    let (mut good, mut refused) = (0, BTreeMap::<String, Vec<PathBuf>>::new());
    for file in &files {
        match import(file, "machine") {
            Ok(import) => {
                good += 1;
                let dropped = &import.report().dropped;
                assert!(
                    dropped
                        .iter()
                        .all(|line| !line.reason.is_empty() && line.line > 0),
                    "{}",
                    file.display()
                );
            }
            Err(error) => {
                let text = error.to_string();
                assert!(
                    text.contains(&*file.parent().unwrap_or(file).to_string_lossy()) || text.contains(';'),
                    "{text}"
                );
                let reason = text.split(": ").skip(1).collect::<Vec<_>>().join(": ");
                refused.entry(reason).or_default().push(file.clone());
            }
        }
    }
    println!("{} configurations, {good} became machines", files.len());
    for (reason, files) in &refused {
        println!("{} refused: {reason} ({})", files.len(), files[0].display());
    }
    assert!(2 * good > files.len());
}
