//! A module imports only the modules that the table of ARCHITECTURE.md allows.

use std::fs;
use std::path::{Path, PathBuf};

/// What every module may use.
const BASE: [&str; 4] = ["diagnostic", "catalogue", "base", "math"];

/// Each module, and what it may import besides these.
pub(crate) const TABLE: &[(&str, &[&str])] = &[
    ("diagnostic", &[]),
    ("catalogue", &["diagnostic"]),
    ("base", &["diagnostic", "catalogue"]),
    ("math", &[]),
    ("provenance", &[]),
    ("robot", &["provenance"]),
    ("measurement", &["robot"]),
    ("device", &["robot", "measurement"]),
    ("estimation", &["robot", "measurement"]),
    ("design", &["robot", "measurement", "estimation"]),
    ("plan", &["provenance", "robot", "measurement", "estimation", "design"]),
    ("program", &["provenance", "robot", "measurement", "plan"]),
    ("circular", &[]),
    ("conformity", &["provenance", "robot", "measurement", "estimation", "circular"]),
    ("recording", &["provenance", "robot", "measurement", "device", "plan", "program", "circular"]),
    (
        "report",
        &[
            "provenance",
            "robot",
            "measurement",
            "recording",
            "estimation",
            "design",
            "plan",
            "program",
            "circular",
            "conformity",
        ],
    ),
    ("live", &[]),
    (
        "archive",
        &["provenance", "robot", "measurement", "estimation", "conformity", "recording", "report", "live"],
    ),
    ("sim", &["robot", "measurement", "device", "program"]),
    ("daemon", &["provenance", "robot", "measurement", "device", "plan", "recording", "live", "archive"]),
];

/// Modules that do no input or output, read no clock and print nothing.
const PURE: &[&str] = &[
    "robot",
    "measurement",
    "device/axes",
    "device/protocol",
    "estimation",
    "design",
    "plan",
    "program",
    "circular",
    "conformity",
    "recording/axes",
    "recording/matching",
    "recording/import",
    "report",
];

/// The files of a module.
pub(crate) fn sources(room: &str) -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let single = root.join(format!("{room}.rs"));
    let mut found = if single.is_file() { vec![single] } else { vec![] };
    let mut open = vec![root.join(room)];
    while let Some(dir) = open.pop() {
        for entry in fs::read_dir(dir).into_iter().flatten().flatten() {
            let path = entry.path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    found
}

/// The modules that a source names as `crate::module`, without comments.
fn imports(text: &str) -> Vec<String> {
    text.lines()
        .map(|line| line.split("//").next().unwrap_or(""))
        .flat_map(|line| {
            line.match_indices("crate::").map(|(at, found)| &line[at + found.len()..]).collect::<Vec<_>>()
        })
        .map(|rest| rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect())
        .collect()
}

#[test]
fn modules_import_only_what_the_table_allows() {
    let mut wrong = Vec::new();
    for (room, allowed) in TABLE {
        for path in sources(room) {
            for import in imports(&fs::read_to_string(&path).unwrap()) {
                let ground = BASE.contains(&import.as_str()) && !BASE.contains(room);
                if import != *room && !ground && !allowed.contains(&import.as_str()) {
                    wrong.push(format!("{}: `{room}` may not import `{import}`", path.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_module_is_in_the_table() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for entry in fs::read_dir(root).unwrap().flatten() {
        let name = entry.path().file_stem().unwrap().to_string_lossy().into_owned();
        let known =
            ["lib", "main", "cli"].contains(&name.as_str()) || TABLE.iter().any(|(room, _)| *room == name);
        assert!(known, "src/{name} is not in the table of this test and of ARCHITECTURE.md");
    }
}

#[test]
fn web_framework_is_used_in_live_only() {
    for (room, _) in TABLE.iter().filter(|(room, _)| *room != "live") {
        for path in sources(room).into_iter().chain(sources("cli")) {
            let text = fs::read_to_string(&path).unwrap();
            for word in ["axum::", "hyper::", "hyper_util::"] {
                assert!(!text.contains(word), "{} uses {word}", path.display());
            }
        }
    }
}

#[test]
fn pure_modules_do_no_input_or_output() {
    let forbidden = [
        "std::fs",
        "crate::base::files",
        "std::io",
        "std::net::Tcp",
        "std::net::Udp",
        "std::thread",
        "clock::",
        "println!",
        "eprintln!",
        "SystemTime",
    ];
    // A writer of a foreign file format writes to the stream that it is given.
    let writes = |path: &PathBuf| path.components().any(|part| part.as_os_str() == "export");
    for room in PURE {
        for path in sources(room).into_iter().filter(|path| !writes(path)) {
            let text = fs::read_to_string(&path).unwrap();
            for line in text.lines().map(|line| line.split("//").next().unwrap_or("")) {
                for word in forbidden {
                    assert!(!line.contains(word), "{}: a pure room uses `{word}`: {line}", path.display());
                }
            }
        }
    }
}

#[test]
fn protocol_engine_names_no_vendor() {
    let vendors = [
        "sylvac",
        "heidenhain",
        "mitutoyo",
        "usdigital",
        "micro-epsilon",
        "riftek",
        "starrett",
        "renishaw",
        "keyence",
    ];
    for path in sources("device/protocol") {
        let text = fs::read_to_string(&path).unwrap().to_lowercase();
        for vendor in vendors {
            assert!(!text.contains(vendor), "{} names {vendor}", path.display());
        }
    }
}

/// nalgebra's own decomposition loses digits on clustered values and does not return on a NaN.
#[test]
fn singular_values_are_computed_in_math_only() {
    for (room, _) in TABLE.iter().filter(|(room, _)| *room != "math") {
        for path in sources(room) {
            assert!(
                !fs::read_to_string(&path).unwrap().contains(".svd("),
                "{} calls nalgebra's svd",
                path.display()
            );
        }
    }
}
