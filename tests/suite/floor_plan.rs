//! A room imports only the rooms that the table of ARCHITECTURE.md allows: what the compiler does not hold of the walls.

use std::fs;
use std::path::{Path, PathBuf};

/// A room of a crate, and the rooms that it may import besides those of [`GROUND`].
pub(crate) struct Room {
    pub(crate) name: &'static str,
    pub(crate) uses: &'static [&'static str],
}

const fn room(name: &'static str, uses: &'static [&'static str]) -> Room {
    Room { name, uses }
}

/// What every room of its crate and of the crates above may use.
const GROUND: [&str; 11] = [
    "diagnostic",
    "base",
    "math",
    "plausibility",
    "clock",
    "sync",
    "files",
    "file_set",
    "child_process",
    "artefact",
    "page",
];

/// The crates with their rooms, in the order of the data flow. That a crate uses crates above it only, the compiler holds.
pub(crate) const CRATES: &[(&str, &[Room])] = &[
    (
        "crates/dbbd-model",
        &[
            room("diagnostic", &[]),
            room("base", &[]),
            room("plausibility", &[]),
            room("math", &[]),
            room("provenance", &[]),
            room("robot", &["provenance"]),
            room("measurement", &["robot"]),
            room("estimation", &["robot", "measurement"]),
            room("circular", &[]),
            room("conformity", &["provenance", "robot", "measurement", "estimation", "circular"]),
            room("design", &["robot", "measurement", "estimation", "conformity"]),
        ],
    ),
    (
        "crates/dbbd-device",
        &[
            room("clock", &[]),
            room("sync", &[]),
            room("axes", &["robot", "port"]),
            room("port", &[]),
            room("protocol", &["measurement", "port"]),
        ],
    ),
    (
        "crates/dbbd-job",
        &[
            room("files", &[]),
            room("file_set", &[]),
            room("child_process", &[]),
            room("artefact", &["provenance"]),
            room("page", &[]),
            room("robot_files", &["provenance", "robot", "estimation", "conformity"]),
            room("robot_description", &["robot", "estimation"]),
            room("plan", &["provenance", "robot", "measurement", "estimation", "conformity", "design"]),
            room("program", &["provenance", "robot", "measurement", "plan"]),
            room(
                "recording",
                &[
                    "provenance",
                    "robot",
                    "measurement",
                    "protocol",
                    "axes",
                    "port",
                    "plan",
                    "program",
                    "circular",
                ],
            ),
            room(
                "report",
                &[
                    "robot_description",
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
            room(
                "request",
                &[
                    "robot_files",
                    "provenance",
                    "robot",
                    "measurement",
                    "estimation",
                    "design",
                    "circular",
                    "conformity",
                    "protocol",
                    "plan",
                    "program",
                    "recording",
                    "report",
                ],
            ),
            room("sim", &["robot", "measurement", "protocol", "axes", "port", "program"]),
        ],
    ),
    (
        "crates/dbbd-plant",
        &[
            room("catalogue", &[]),
            room("fleet", &["robot", "catalogue"]),
            room(
                "archive",
                &[
                    "provenance",
                    "robot",
                    "measurement",
                    "estimation",
                    "conformity",
                    "recording",
                    "report",
                    "request",
                    "catalogue",
                ],
            ),
        ],
    ),
    (
        ".",
        &[
            room("live", &["port", "protocol", "report", "archive"]),
            room(
                "daemon",
                &[
                    "provenance",
                    "robot",
                    "measurement",
                    "conformity",
                    "protocol",
                    "axes",
                    "port",
                    "plan",
                    "recording",
                    "request",
                    "live",
                    "archive",
                ],
            ),
        ],
    ),
];

/// All rooms, in the order of the data flow.
pub(crate) fn rooms() -> impl Iterator<Item = &'static Room> {
    CRATES.iter().flat_map(|(_, rooms)| *rooms)
}

/// Rooms that do no input or output, read no clock and print nothing.
const PURE: &[&str] =
    &["plan", "program", "recording/axes", "recording/matching", "recording/import", "report"];

/// The crates all of whose rooms are pure, and the rooms of other crates that are.
fn pure_sources() -> Vec<PathBuf> {
    let mut found = rust_files(&root().join("crates/dbbd-model/src"));
    // Debug builds log there which codes the tests provoke.
    found.retain(|path| !path.ends_with("diagnostic/code_log.rs"));
    for room in ["axes", "protocol"] {
        found.extend(sources("crates/dbbd-device", room));
    }
    for room in PURE {
        found.extend(sources("crates/dbbd-job", room));
    }
    found
}

pub(crate) fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

/// Whether a file holds tests or what they share: tests use what they need.
fn is_test_code(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name == "tests" || name == "tests.rs" || name == "test_support")
}

/// The Rust files with product code below a directory.
pub(crate) fn rust_files(directory: &Path) -> Vec<PathBuf> {
    let (mut found, mut open) = (Vec::new(), vec![directory.to_owned()]);
    while let Some(dir) = open.pop() {
        for entry in fs::read_dir(dir).into_iter().flatten().flatten() {
            let path = entry.path();
            if is_test_code(&path) {
                continue;
            }
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    found
}

/// The files of a room.
pub(crate) fn sources(of_crate: &str, room: &str) -> Vec<PathBuf> {
    let src = root().join(of_crate).join("src");
    let single = src.join(format!("{room}.rs"));
    let mut found = rust_files(&src.join(room));
    found.extend(single.is_file().then_some(single));
    found
}

/// The files of the workspace's crates.
fn all_sources() -> Vec<PathBuf> {
    CRATES.iter().flat_map(|(of_crate, _)| rust_files(&root().join(of_crate).join("src"))).collect()
}

/// The rooms that a source names, as `crate::room` or `dbbd_model::room`, without comments.
fn imports(text: &str) -> Vec<String> {
    let heads = ["crate::", "dbbd_model::", "dbbd_device::", "dbbd_job::", "dbbd_plant::"];
    text.lines()
        .map(|line| line.split("//").next().unwrap_or(""))
        .flat_map(|line| {
            heads.iter().flat_map(move |head| line.match_indices(head)).map(move |(at, head)| {
                let name: String = line[at + head.len()..]
                    .chars()
                    .take_while(|c| c.is_alphanumeric() || *c == '_')
                    .collect();
                if head == "dbbd_plant::" { "archive".to_owned() } else { name }
            })
        })
        // Macros and types at the root of a crate belong to no room.
        // What tests share is of no room either.
        .filter(|name| {
            name.starts_with(|c: char| c.is_lowercase()) && name != "findings" && name != "test_support"
        })
        .collect()
}

#[test]
fn rooms_import_only_what_the_table_allows() {
    let mut wrong = Vec::new();
    for (of_crate, rooms) in CRATES {
        for Room { name, uses } in *rooms {
            for path in sources(of_crate, name) {
                for import in imports(&fs::read_to_string(&path).unwrap()) {
                    let ground = GROUND.contains(&import.as_str()) && !GROUND[..3].contains(name);
                    let below = GROUND.iter().position(|one| *one == import)
                        < GROUND.iter().position(|one| one == name);
                    if import != *name && !ground && !below && !uses.contains(&import.as_str()) {
                        wrong.push(format!("{}: `{name}` may not import `{import}`", path.display()));
                    }
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_room_is_in_the_table() {
    for (of_crate, rooms) in CRATES {
        for entry in fs::read_dir(root().join(of_crate).join("src")).unwrap().flatten() {
            let path = entry.path();
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            let known = ["lib", "main", "cli", "catalogue", "catalogue_head", "test_support"]
                .contains(&name.as_str())
                || rooms.iter().any(|room| room.name == name);
            assert!(known, "{} is not in the table of this test and of ARCHITECTURE.md", path.display());
        }
    }
}

/// The crate of each dependency that is to stay in one place.
#[test]
fn libraries_are_used_where_they_belong() {
    for (words, places) in [
        (["axum::", "hyper::", "hyper_util::"].as_slice(), ["src/live"].as_slice()),
        (&["clap::"], &["src/cli"]),
        // The simulated cell answers on a pseudo-terminal.
        (&["serialport::", "socket2::"], &["crates/dbbd-device", "crates/dbbd-job/src/sim"]),
    ] {
        let is_elsewhere = |path: &PathBuf| places.iter().all(|place| !path.starts_with(root().join(place)));
        for path in all_sources().into_iter().filter(is_elsewhere) {
            let text = fs::read_to_string(&path).unwrap();
            for word in words {
                assert!(!text.contains(word), "{} uses {word}", path.display());
            }
        }
    }
}

/// A scientist gets the mathematics without a web server, a command line, a port or a runtime.
#[test]
fn the_model_depends_on_mathematics_and_texts_alone() {
    let allowed = [
        "csv",
        "hmac-sha256",
        "nalgebra",
        "rand",
        "rand_distr",
        "rand_pcg",
        "serde",
        "serde_json",
        "strsim",
        "toml",
    ];
    let manifest = fs::read_to_string(root().join("crates/dbbd-model/Cargo.toml")).unwrap();
    let manifest: toml::Table = toml::from_str(&manifest).unwrap();
    for name in manifest["dependencies"].as_table().unwrap().keys() {
        assert!(allowed.contains(&name.as_str()), "dbbd-model depends on {name}");
    }
}

#[test]
fn pure_rooms_do_no_input_or_output() {
    let forbidden = [
        "std::fs",
        "dbbd_job::files",
        "crate::files",
        "std::net::Tcp",
        "std::net::Udp",
        "clock::",
        "println!",
        "eprintln!",
        "SystemTime",
    ];
    // A writer of a foreign file format writes to the stream that it is given.
    let writes = |path: &PathBuf| path.components().any(|part| part.as_os_str() == "export");
    for path in pure_sources().into_iter().filter(|path| !writes(path)) {
        let text = fs::read_to_string(&path).unwrap();
        for line in text.lines().map(|line| line.split("//").next().unwrap_or("")) {
            for word in forbidden {
                assert!(!line.contains(word), "{}: a pure room uses `{word}`: {line}", path.display());
            }
        }
    }
}

/// The command line alone names its options: a finding of a crate asks for an input. Excepted are the options that a crate
/// gives to a child of its own.
#[test]
fn the_crates_and_the_pages_name_no_option() {
    const CHILDREN: [&str; 2] = ["child_process.rs", "archive/work.rs"];
    let names_option = |line: &str| {
        let code = !line.trim_start().starts_with("//");
        let begins = |at: usize| {
            let before = &line[..at];
            before.ends_with(['"', ' ', '`', '(']) && !before.ends_with("var(")
        };
        let is_option = |at: usize| line[at + 2..].starts_with(|c: char| c.is_ascii_lowercase());
        code && line.match_indices("--").any(|(at, _)| begins(at) && is_option(at))
    };
    let is_child = |path: &PathBuf| CHILDREN.iter().any(|child| path.ends_with(child));
    let crates = CRATES.iter().filter(|(of_crate, _)| *of_crate != ".");
    let found = crates.flat_map(|(of_crate, _)| rust_files(&root().join(of_crate).join("src")));
    for path in found.chain(sources(".", "live")).filter(|path| !is_child(path)) {
        for line in fs::read_to_string(&path).unwrap().lines() {
            // A test of the pages breaks a line with an option in it.
            let is_sample = path.ends_with("report/scale.rs");
            assert!(is_sample || !names_option(line), "{} names an option: {line}", path.display());
        }
    }
}

#[test]
fn protocol_engine_names_no_vendor() {
    let vendors = [
        "sylvac",
        "heidenhain",
        "magnescale",
        "mitutoyo",
        "usdigital",
        "us digital",
        "epsilon",
        "magnescale",
        "riftek",
        "starrett",
        "renishaw",
        "keyence",
    ];
    for path in sources("crates/dbbd-device", "protocol") {
        let text = fs::read_to_string(&path).unwrap().to_lowercase();
        for vendor in vendors {
            assert!(!text.contains(vendor), "{} names {vendor}", path.display());
        }
    }
}

/// nalgebra's own decomposition loses digits on clustered values and does not return on a NaN.
#[test]
fn singular_values_are_computed_in_math_only() {
    let math = root().join("crates/dbbd-model/src/math");
    for path in all_sources().into_iter().filter(|path| !path.starts_with(&math)) {
        assert!(
            !fs::read_to_string(&path).unwrap().contains(".svd("),
            "{} calls nalgebra's svd",
            path.display()
        );
    }
}
