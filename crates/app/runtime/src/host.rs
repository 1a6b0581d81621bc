//! Disturbances of a real-time loop on a host, read from files of the kernel and systemd.

use std::collections::BTreeMap;
use std::fs::{read_dir, read_to_string};
use std::path::Path;

/// Interrupts of every core since the start of the host, by source.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Interrupts(BTreeMap<String, Vec<u64>>);

impl Interrupts {
    /// Reads `/proc/interrupts`; empty if it does not exist.
    pub(crate) fn now() -> Self {
        Self::parse(&read_to_string("/proc/interrupts").unwrap_or_default())
    }

    fn parse(text: &str) -> Self {
        let mut lines = text.lines();
        let cores = lines.next().unwrap_or_default().split_whitespace().count();
        let mut sources = BTreeMap::new();
        for line in lines {
            let Some((label, rest)) = line.split_once(':') else {
                continue;
            };
            let counts: Vec<u64> = rest
                .split_whitespace()
                .take(cores)
                .map_while(|word| word.parse().ok())
                .collect();
            if counts.len() == cores {
                sources.insert(label.trim().to_owned(), counts);
            }
        }
        Self(sources)
    }

    /// Interrupts of a core since `before`, most frequent first. The loop's own timer (LOC) is excluded.
    pub(crate) fn since(&self, before: &Self, core: usize) -> Vec<(String, u64)> {
        let mut found: Vec<(String, u64)> = self
            .0
            .iter()
            .filter(|(label, _)| *label != "LOC")
            .filter_map(|(label, counts)| {
                let old = before.0.get(label).and_then(|counts| counts.get(core)).copied();
                let new = counts.get(core)?.saturating_sub(old.unwrap_or(0));
                (new > 0).then(|| (label.clone(), new))
            })
            .collect();
        found.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
        found
    }
}

/// Whether a list of cores such as `0-2,5` contains a core.
pub(crate) fn names_core(list: &str, core: usize) -> bool {
    list.split(',').any(|range| {
        let mut ends = range.splitn(2, '-').map(|end| end.trim().parse::<usize>().ok());
        match (ends.next().flatten(), ends.next()) {
            (Some(first), None) => first == core,
            (Some(first), Some(Some(last))) => (first..=last).contains(&core),
            _ => false,
        }
    })
}

/// Device interrupts that may be delivered to a core, by number.
pub(crate) fn interrupts_allowed_on(core: usize) -> Vec<u32> {
    let mut found: Vec<u32> = read_dir("/proc/irq")
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| {
            let number = entry.file_name().to_str()?.parse().ok()?;
            let list = read_to_string(entry.path().join("smp_affinity_list")).ok()?;
            names_core(list.trim(), core).then_some(number)
        })
        .collect();
    found.sort_unstable();
    found
}

/// What logind does with a user's shared memory at logout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RemoveIpc {
    /// There is no logind.
    NoLogind,
    /// It is kept.
    Kept,
    /// It is deleted.
    Removed,
}

/// Reads logind's configuration. Its built-in default is to remove.
pub(crate) fn remove_ipc() -> RemoveIpc {
    if !Path::new("/run/systemd/seats").exists() && !Path::new("/run/systemd/users").exists() {
        return RemoveIpc::NoLogind;
    }
    let mut texts = vec![read_to_string("/etc/systemd/logind.conf").unwrap_or_default()];
    for folder in [
        "/usr/lib/systemd/logind.conf.d",
        "/run/systemd/logind.conf.d",
        "/etc/systemd/logind.conf.d",
    ] {
        let mut files: Vec<_> = read_dir(folder)
            .into_iter()
            .flatten()
            .flatten()
            .map(|entry| entry.path())
            .collect();
        files.sort();
        texts.extend(files.iter().filter_map(|file| read_to_string(file).ok()));
    }
    removes(&texts)
}

/// The last setting applies.
fn removes(texts: &[String]) -> RemoveIpc {
    let value = texts
        .iter()
        .flat_map(|text| text.lines())
        .filter_map(|line| line.trim().strip_prefix("RemoveIPC="))
        .next_back()
        .unwrap_or("yes")
        .trim()
        .to_ascii_lowercase();
    if matches!(value.as_str(), "no" | "false" | "off" | "0") {
        RemoveIpc::Kept
    } else {
        RemoveIpc::Removed
    }
}

/// The governors of all cores, without duplicates.
pub(crate) fn governors() -> Vec<String> {
    let mut found: Vec<String> = read_dir("/sys/devices/system/cpu")
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| read_to_string(entry.path().join("cpufreq/scaling_governor")).ok())
        .map(|governor| governor.trim().to_owned())
        .collect();
    found.sort();
    found.dedup();
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEFORE: &str = "           CPU0       CPU1
  0:         10          0   IO-APIC    2-edge      timer
 24:        100          7   PCI-MSI 524288-edge      nvme0q0
LOC:       5000       6000   Local timer interrupts
RES:          1          2   Rescheduling interrupts
ERR:          0
";

    #[test]
    fn interrupts_count_by_source_except_the_local_timer() {
        let after = BEFORE
            .replace("         7  ", "        27  ")
            .replace("          2   Res", "          5   Res")
            .replace("6000", "9000")
            .replace("100 ", "999 ");
        let (before, after) = (Interrupts::parse(BEFORE), Interrupts::parse(&after));
        assert_eq!(
            after.since(&before, 1),
            [("24".to_owned(), 20), ("RES".to_owned(), 3)]
        );
        assert_eq!(after.since(&before, 0), [("24".to_owned(), 899)]);
        assert_eq!(after.since(&before, 7), []);
        assert_eq!(Interrupts::parse("").since(&before, 0), []);
    }

    #[test]
    fn lists_of_cores_are_read() {
        for (list, core, named) in [
            ("0-2,5", 1, true),
            ("0-2,5", 5, true),
            ("0-2,5", 3, false),
            ("3", 3, true),
            ("", 0, false),
            ("x-y", 0, false),
            ("1-", 1, false),
        ] {
            assert_eq!(names_core(list, core), named, "{list} {core}");
        }
    }

    #[test]
    fn last_remove_ipc_setting_wins_and_default_removes() {
        let case = |texts: &[&str]| removes(&texts.iter().map(|text| (*text).to_owned()).collect::<Vec<_>>());
        assert_eq!(case(&["[Login]\n#RemoveIPC=no\n"]), RemoveIpc::Removed);
        assert_eq!(case(&["[Login]\nRemoveIPC=no\n"]), RemoveIpc::Kept);
        assert_eq!(
            case(&["RemoveIPC=no\n", "[Login]\nRemoveIPC=Yes\n"]),
            RemoveIpc::Removed
        );
        assert_eq!(case(&[]), RemoveIpc::Removed);
    }
}
