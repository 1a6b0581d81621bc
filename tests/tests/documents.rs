//! Documents: every link leads to a file, every page is in the book, every command exists with its options.
//! Test files: each is part of an executable.
#![expect(clippy::expect_used, reason = "tests fail as tests do")]

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use evolvent_tests::{repository, run};

/// Markdown files of the repository, except those in build folders.
fn pages() -> Vec<PathBuf> {
    let root = repository();
    let mut pages = Vec::new();
    let mut open = vec![
        root.join("docs"),
        root.join("tools"),
        root.join("crates"),
        root.join(".github"),
    ];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(&folder).expect("a folder of the repository") {
            let path = entry.expect("an entry").path();
            let foreign = path
                .file_name()
                .is_some_and(|name| name == "target" || name == "node_modules");
            if path.is_dir() && !foreign {
                open.push(path);
            } else if !foreign && path.extension().is_some_and(|ending| ending == "md") {
                pages.push(path);
            }
        }
    }
    for name in ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"] {
        pages.push(root.join(name));
    }
    pages.sort();
    assert!(pages.len() > 60, "{} pages", pages.len());
    pages
}

/// Targets of the links of a page, except those in code.
fn links(text: &str) -> Vec<String> {
    let mut links = Vec::new();
    let mut fenced = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            fenced = !fenced;
        }
        if fenced || line.starts_with("    ") {
            continue;
        }
        for (index, part) in line.split("](").enumerate() {
            if index > 0
                && let Some((target, _)) = part.split_once(')')
            {
                links.push(target.to_owned());
            }
        }
    }
    links
}

#[test]
fn links_lead_to_files() {
    let (mut broken, mut count) = (Vec::new(), 0);
    for page in pages() {
        let folder = page.parent().unwrap_or(Path::new("."));
        for link in links(&fs::read_to_string(&page).expect("a page")) {
            let file = link.split('#').next().unwrap_or_default();
            if file.is_empty() || file.contains("://") || file.starts_with("mailto:") {
                continue;
            }
            count += 1;
            if !folder.join(file).exists() {
                broken.push(format!("{}: {link}", page.display()));
            }
        }
    }
    assert!(count > 200, "{count} links");
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

#[test]
fn every_page_is_in_the_book() {
    let docs = repository().join("docs");
    let summary = fs::read_to_string(docs.join("SUMMARY.md")).expect("the summary");
    let listed = links(&summary);
    let mut missing = Vec::new();
    for page in pages() {
        if let Ok(page) = page.strip_prefix(&docs) {
            let page = page.display().to_string();
            if page != "SUMMARY.md" && !listed.contains(&page) {
                missing.push(page);
            }
        }
    }
    assert!(missing.is_empty(), "not in docs/SUMMARY.md: {missing:?}");
}

#[test]
fn every_page_is_in_the_list_of_the_documentation() {
    let docs = repository().join("docs");
    let listed = links(&fs::read_to_string(docs.join("README.md")).expect("the list"));
    let own = ["README.md", "SUMMARY.md"];
    let missing: Vec<String> = pages()
        .iter()
        .filter_map(|page| page.strip_prefix(&docs).ok())
        .map(|page| page.display().to_string())
        .filter(|page| !own.contains(&page.as_str()) && !listed.contains(page))
        .collect();
    assert!(missing.is_empty(), "not in docs/README.md: {missing:?}");
}

/// The crates of a folder of `crates`, each with the crates of this repository on which it depends (except
/// for tests).
fn dependencies() -> BTreeMap<String, Vec<String>> {
    let mut all = BTreeMap::new();
    for layer in LAYERS {
        let crates = fs::read_dir(repository().join("crates").join(layer)).expect("a layer");
        for folder in crates.flatten() {
            let Ok(manifest) = fs::read_to_string(folder.path().join("Cargo.toml")) else {
                continue;
            };
            let section = manifest
                .split("\n[")
                .find_map(|section| section.strip_prefix("dependencies]"));
            let own = section.unwrap_or_default().lines();
            let own = own.filter_map(|line| line.strip_prefix("evolvent-"));
            let names = own.filter_map(|line| line.split(['.', ' ', '=']).next());
            let name = format!("{layer}/{}", folder.file_name().to_string_lossy());
            all.insert(name, names.map(str::to_owned).collect());
        }
    }
    all
}

/// The layers of docs/architecture.md, from the top.
const LAYERS: [&str; 8] = [
    "core",
    "program",
    "planning",
    "process",
    "execution",
    "io",
    "app",
    "testing",
];

#[test]
fn crates_depend_on_layers_above_or_documented_ones() {
    let text = fs::read_to_string(repository().join("docs/architecture.md")).expect("the page");
    let all = dependencies();
    assert!(all.len() > 30, "{all:?}");
    let layer = |name: &str| {
        name.split('/')
            .next()
            .and_then(|own| LAYERS.iter().position(|layer| *layer == own))
    };
    let mut downward = Vec::new();
    for (user, used) in &all {
        for used in used {
            let ending = format!("/{used}");
            let used = all.keys().find(|name| name.ends_with(&ending)).expect("a crate");
            if layer(used) > layer(user) {
                downward.push((user.as_str(), used.as_str()));
            }
        }
    }
    assert_eq!(
        downward,
        [
            ("app/cli", "testing/bridge-sim"),
            ("app/cli", "testing/bridge-test"),
            ("app/replay", "testing/verifier"),
            ("execution/motion", "io/wire"),
        ]
    );
    for name in downward.iter().flat_map(|(user, used)| [user, used]) {
        assert!(text.contains(&format!("`{name}`")), "{name} is not named");
    }
}

#[test]
fn every_crate_has_a_short_readme() {
    let crates = repository().join("crates");
    for floor in fs::read_dir(&crates).expect("the floors") {
        for entry in fs::read_dir(floor.expect("a floor").path()).expect("the crates") {
            let folder = entry.expect("a crate").path();
            if !folder.join("Cargo.toml").exists() {
                continue;
            }
            let readme = fs::read_to_string(folder.join("README.md")).unwrap_or_default();
            let lines = readme.lines().count();
            assert!(
                (5..=15).contains(&lines),
                "{}/README.md: {lines} lines",
                folder.display()
            );
            let manifest = fs::read_to_string(folder.join("Cargo.toml")).expect("a manifest");
            let name = readme
                .lines()
                .next()
                .and_then(|line| line.strip_prefix("# "))
                .unwrap_or_default();
            assert!(
                manifest.contains(&format!("name = \"{name}\"")),
                "{}: heading",
                folder.display()
            );
        }
    }
}

/// Commands in a page: the subcommands after `evolvent`, and the options.
fn typed(page: &str) -> Vec<(Vec<String>, Vec<String>)> {
    let mut found = Vec::new();
    for line in page.lines() {
        let code = line.strip_prefix("    evolvent ").into_iter();
        let inline = line
            .split('`')
            .skip(1)
            .step_by(2)
            .filter_map(|code| code.strip_prefix("evolvent "));
        for command in code.chain(inline) {
            // The command of an indented shell line ends before its explanation.
            let command = command.split(" -- ").next().unwrap_or_default();
            let words: Vec<&str> = command
                .split_whitespace()
                .take_while(|word| !matches!(*word, "|" | "#" | ">"))
                .collect();
            let plain = |word: &&&str| {
                word.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'-') && !word.starts_with('-')
            };
            let commands = words
                .iter()
                .take_while(plain)
                .take(2)
                .map(ToString::to_string)
                .collect();
            let options = words
                .iter()
                .map(|word| {
                    word.trim_start_matches('[')
                        .split(['=', ']', ',', ';', '/'])
                        .next()
                        .unwrap_or_default()
                })
                .filter(|word| word.starts_with("--"))
                .map(str::to_owned)
                .collect();
            found.push((commands, options));
        }
    }
    found
}

#[test]
fn commands_in_documents_exist_with_their_options() {
    let mut helps: BTreeMap<Vec<String>, Option<String>> = BTreeMap::new();
    let mut help = |commands: &[String]| {
        helps
            .entry(commands.to_vec())
            .or_insert_with(|| {
                let arguments: Vec<String> = commands.iter().cloned().chain(["--help".into()]).collect();
                let done = run(arguments);
                (done.code == Some(0)).then_some(done.out)
            })
            .clone()
    };
    let (mut wrong, mut count) = (Vec::new(), 0);
    for page in pages() {
        // The change log and the decisions describe their own time.
        if page.ends_with("CHANGELOG.md") || page.components().any(|part| part.as_os_str() == "adr") {
            continue;
        }
        for (commands, options) in typed(&fs::read_to_string(&page).expect("a page")) {
            if commands.is_empty() {
                continue;
            }
            count += 1;
            // The second word may be an argument of the first command.
            let Some(text) = help(&commands).or_else(|| help(&commands[..1])) else {
                wrong.push(format!("{}: evolvent {}", page.display(), commands.join(" ")));
                continue;
            };
            for option in options {
                if option != "--help" && option != "--version" && !text.contains(&option) {
                    wrong.push(format!(
                        "{}: evolvent {} {option}",
                        page.display(),
                        commands.join(" ")
                    ));
                }
            }
        }
    }
    assert!(count > 60, "{count} commands");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_command_has_a_man_page_and_completions() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().display().to_string();
    run(["man", &path]).expect_code(&[0]);
    for name in [
        "evolvent",
        "evolvent-run",
        "evolvent-trace-verify",
        "evolvent-bridge-sim",
        "evolvent-ctl-home",
    ] {
        let page = fs::read_to_string(folder.path().join(format!("{name}.1"))).expect(name);
        assert!(page.contains(".SH SYNOPSIS"), "{name}: {page}");
    }
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = run(["completions", shell]).expect_code(&[0]).out;
        assert!(
            script.contains("evolvent") && script.contains("machine"),
            "{shell}"
        );
    }
    run(["completions", "csh"]).expect_code(&[2]);
    run(["man", "/proc/none/man"]).expect_code(&[1]);
}

/// A file that no `main.rs` names would not be compiled, and its missing tests would not be noticed.
#[test]
fn every_test_file_is_in_its_crate_executable() {
    let root = repository();
    let (mut left_out, mut count) = (Vec::new(), 0);
    let floors = fs::read_dir(root.join("crates")).expect("the crates");
    let crates = floors
        .filter_map(|floor| fs::read_dir(floor.expect("a floor").path()).ok())
        .flatten()
        .map(|entry| entry.expect("a crate").path())
        .chain([root.join("tests")]);
    for folder in crates {
        let Ok(manifest) = fs::read_to_string(folder.join("Cargo.toml")) else {
            continue;
        };
        let Some(main) = manifest
            .lines()
            .find_map(|line| line.strip_prefix("path = \"")?.strip_suffix("main.rs\""))
            .filter(|_| manifest.contains("autotests = false"))
        else {
            continue;
        };
        let tests = folder.join(main);
        let listed = fs::read_to_string(tests.join("main.rs")).expect("the list of tests");
        for entry in fs::read_dir(&tests).expect("the tests") {
            let name = entry.expect("a file").file_name().to_string_lossy().into_owned();
            let Some(name) = name.strip_suffix(".rs").filter(|name| *name != "main") else {
                continue;
            };
            count += 1;
            let has_own = manifest.contains(&format!("path = \"{main}{name}.rs\""));
            if !has_own && !listed.contains(&format!("mod {name};")) {
                left_out.push(format!("{}/{name}.rs", tests.display()));
            }
        }
    }
    assert!(count > 60, "{count} files");
    assert!(left_out.is_empty(), "name them in main.rs: {left_out:#?}");
}

/// The first command of the README names no executable, and simulators for tests are executables, too.
#[test]
fn cargo_run_in_the_root_is_the_command_line() {
    let members = repository().join("crates");
    let mut runs = Vec::new();
    for floor in fs::read_dir(members).expect("a folder") {
        for member in fs::read_dir(floor.expect("a folder").path()).expect("a folder") {
            let manifest = member.expect("a folder").path().join("Cargo.toml");
            let Ok(text) = fs::read_to_string(&manifest) else {
                continue;
            };
            runs.extend(
                text.lines()
                    .filter(|line| line.starts_with("default-run"))
                    .map(str::to_owned),
            );
        }
    }
    // Cargo uses that of the only member that has one.
    assert_eq!(runs, ["default-run = \"evolvent\""]);
}
