//! Links and paths in the documents resolve, every page is in docs/SUMMARY.md, and mdBook renders the pages.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::tempdir;

use crate::cell::dbbd;
use crate::floor_plan::{CRATES, rooms};

const DOCUMENTS: [&str; 8] = [
    "README.md",
    "ARCHITECTURE.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "fixtures/README.md",
    "fixtures/krl/README.md",
    "fuzz/README.md",
    "protocols/README.md",
];

/// Directories of the repository. A path in a document that begins with one of them must exist.
const ROOTS: [&str; 13] = [
    "src",
    "tests",
    "docs",
    "examples",
    "fixtures",
    "fuzz",
    "protocols",
    "robots",
    "packaging",
    "benches",
    ".ci",
    "controllers",
    "python",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn files(dir: &str, extensions: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![root().join(dir)];
    while let Some(dir) = open.pop() {
        for entry in fs::read_dir(&dir).into_iter().flatten().flatten() {
            let path = entry.path();
            let wanted = |extension| extensions.iter().any(|wanted| extension == *wanted);
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(wanted) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

fn pages() -> Vec<PathBuf> {
    files("docs", &["md"])
}

/// The text without fenced code.
fn prose(text: &str) -> String {
    let mut inside = false;
    let mut kept = String::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            inside = !inside;
        } else if !inside {
            kept.push_str(line);
            kept.push('\n');
        }
    }
    kept
}

/// The targets of the links and images of a Markdown text, without code.
fn links(text: &str) -> Vec<String> {
    let prose = prose(text);
    let without_code: String = prose.split('`').step_by(2).collect::<Vec<_>>().join("code");
    let mut targets = Vec::new();
    for (at, _) in without_code.match_indices("](") {
        if let Some((target, _)) = without_code[at + 2..].split_once(')') {
            targets.push(target.to_owned());
        }
    }
    targets
}

/// Anchors of the headings as GitHub and mdBook make them.
fn anchors(text: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    for heading in prose(text).lines().filter_map(|line| line.strip_prefix('#')) {
        let kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
        let slug: String = heading.trim_start_matches('#').trim().chars().filter(kept).collect();
        let slug = slug.to_lowercase().replace(' ', "-");
        let again = found.iter().filter(|other| **other == slug).count();
        found.push(if again == 0 { slug } else { format!("{slug}-{again}") });
    }
    found
}

/// What is wrong with the target of a link in a document.
fn broken(document: &Path, target: &str) -> Option<String> {
    if ["http://", "https://", "mailto:"].iter().any(|scheme| target.starts_with(scheme)) {
        return None;
    }
    let (path, anchor) = target.split_once('#').unwrap_or((target, ""));
    let file = if path.is_empty() { document.to_owned() } else { document.parent()?.join(path) };
    if !file.exists() {
        return Some(format!("{}: {target}: there is no such file", document.display()));
    }
    if !anchor.is_empty() && !anchors(&read(&file)).iter().any(|known| known == anchor) {
        return Some(format!("{}: {target}: there is no such heading", document.display()));
    }
    None
}

/// The book has at most 25 000 words, without its table of contents and the pages that are generated: a page that is added replaces one.
#[test]
fn the_book_stays_small() {
    const OTHERS: [&str; 4] = [
        "docs/SUMMARY.md",
        "docs/evidence/README.md",
        "docs/reference/commands.md",
        "docs/troubleshooting.md",
    ];
    let others = OTHERS.map(|page| root().join(page));
    let pages = pages().into_iter().filter(|page| !others.contains(page));
    let words: usize = pages.map(|page| read(&page).split_whitespace().count()).sum();
    assert!((20_000..=25_000).contains(&words), "{words}");
}

#[test]
fn every_link_and_anchor_resolves() {
    let documents = DOCUMENTS.map(|name| root().join(name));
    let mut wrong = Vec::new();
    for document in documents.into_iter().chain(pages()) {
        wrong.extend(links(&read(&document)).iter().filter_map(|target| broken(&document, target)));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The book contains only docs/: a link to a file elsewhere would be broken in it.
#[test]
fn pages_link_only_to_pages() {
    let docs = root().join("docs").canonicalize().unwrap();
    for page in pages() {
        for target in links(&read(&page)).iter().filter(|target| !target.contains("://")) {
            let path = target.split('#').next().unwrap_or_default();
            let file = page.parent().unwrap().join(path).canonicalize();
            assert!(
                path.is_empty() || file.is_ok_and(|file| file.starts_with(&docs)),
                "{}: {target}",
                page.display()
            );
        }
    }
}

/// Words that look like a path of the repository, without what follows a colon.
fn paths(text: &str) -> impl Iterator<Item = &str> {
    let is_part = |c: char| c.is_ascii_alphanumeric() || "./_-*".contains(c);
    text.split(move |c: char| !is_part(c))
        .map(|word| word.trim_end_matches(['.', '-']))
        .filter(|word| word.split_once('/').is_some_and(|(first, _)| ROOTS.contains(&first)))
}

/// `*` and NAME stand for any name.
fn is_placeholder(path: &str) -> bool {
    path.contains('*') || path.split(['/', '.', '_']).any(|part| part == "NAME" || part == "MODULE")
}

#[test]
fn paths_of_the_repository_exist() {
    let mut wrong = BTreeSet::new();
    for document in DOCUMENTS.map(|name| root().join(name)).into_iter().chain(pages()) {
        let text = read(&document);
        // Code spans name paths of the repository; code blocks name the user's.
        let prose = prose(&text);
        for span in prose.split('`').skip(1).step_by(2) {
            for path in paths(span).filter(|path| !is_placeholder(path)) {
                if !root().join(path).exists() {
                    wrong.insert(format!("{}: {path}", document.display()));
                }
            }
        }
    }
    for source in ["src", "tests/suite", "packaging", "examples", "tests/independent", "tests/clients"]
        .iter()
        .flat_map(|dir| files(dir, &["rs", "toml", "py", "md", "service", "rules"]))
    {
        for path in paths(&read(&source)).filter(|path| path.starts_with("docs/") && path.ends_with(".md")) {
            if !root().join(path).exists() {
                wrong.insert(format!("{}: {path}", source.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.into_iter().collect::<Vec<_>>().join("\n"));
}

/// Paths of sources in ARCHITECTURE.md are relative to the sources of a crate unless they begin with a directory of the
/// repository.
#[test]
fn sources_in_the_architecture_exist() {
    let text = read(&root().join("ARCHITECTURE.md"));
    let mut wrong = Vec::new();
    for span in prose(&text).split('`').skip(1).step_by(2) {
        let is_source = span.contains('/') && (span.ends_with(".rs") || span.ends_with('/'));
        let mut places = CRATES.iter().map(|(of_crate, _)| root().join(of_crate).join("src"));
        if is_source && !root().join(span).exists() && !places.any(|src| src.join(span).exists()) {
            wrong.push(span.to_owned());
        }
    }
    assert!(wrong.is_empty(), "ARCHITECTURE.md names {wrong:?}");
}

/// The last column of the table of modules is that of the floor plan. `DBBD_BLESS=1` writes it.
#[test]
fn architecture_has_the_floor_plan() {
    let path = root().join("ARCHITECTURE.md");
    let text = read(&path);
    let mut listed = Vec::new();
    let with_imports = |line: &str| {
        let module = line.strip_prefix("| `").and_then(|rest| rest.split('`').next()).unwrap_or_default();
        let Some(room) = rooms().find(|room| room.name == module) else {
            return line.to_owned();
        };
        listed.push(room.name);
        let head = line.rsplitn(3, '|').last().unwrap_or_default();
        let imports: Vec<String> = room.uses.iter().map(|import| format!("`{import}`")).collect();
        format!("{head}| {} |", imports.join(" ")).replace("|  |", "| |")
    };
    let wanted: Vec<String> = text.lines().map(with_imports).collect();
    let wanted = wanted.join("\n") + "\n";
    for (at, module) in listed.iter().enumerate() {
        let room = rooms().find(|room| room.name == *module).unwrap();
        let below: Vec<_> = room.uses.iter().filter(|import| !listed[..at].contains(import)).collect();
        assert!(below.is_empty(), "`{module}` imports {below:?}, which the table lists below it");
    }
    assert_eq!(listed.len(), rooms().count(), "the table lists {listed:?}");
    if std::env::var_os("DBBD_BLESS").is_some() {
        fs::write(&path, &wanted).unwrap();
    } else {
        assert_eq!(text, wanted, "DBBD_BLESS=1 writes the column again");
    }
}

#[test]
fn every_page_is_in_the_summary_once() {
    let docs = root().join("docs");
    let summary = links(&read(&docs.join("SUMMARY.md")));
    let listed: BTreeSet<PathBuf> = summary.iter().map(|target| docs.join(target)).collect();
    assert_eq!(listed.len(), summary.len(), "a page is listed twice");
    let pages: BTreeSet<PathBuf> = pages().into_iter().filter(|page| !page.ends_with("SUMMARY.md")).collect();
    assert_eq!(listed, pages);
}

/// Names of functions with their modules, as filters of `cargo test` see them.
fn functions() -> Vec<String> {
    let mut found = Vec::new();
    for source in ["tests/suite", "src", "crates"].iter().flat_map(|directory| files(directory, &["rs"])) {
        let below = source.strip_prefix(root()).unwrap().with_extension("");
        let module: Vec<_> = below.iter().map(|part| part.to_string_lossy()).collect();
        for line in read(&source).lines().filter_map(|line| line.trim_start().strip_prefix("fn ")) {
            let name = line.split(['(', '<']).next().unwrap_or_default();
            found.push(format!("{}::{name}", module.join("::")));
        }
    }
    found
}

/// The filters in a command `cargo test ..`.
fn filters(command: &str) -> Vec<&str> {
    let Some((_, arguments)) = command.split_once("cargo test") else { return Vec::new() };
    arguments.split_whitespace().filter(|word| !word.starts_with('-') && *word != "suite").collect()
}

#[test]
fn tests_in_commands_exist() {
    let functions = functions();
    let mut wrong = BTreeSet::new();
    for document in DOCUMENTS.map(|name| root().join(name)).into_iter().chain(pages()) {
        let text = prose(&read(&document));
        for command in text.split('`').skip(1).step_by(2).filter(|span| span.contains("cargo test")) {
            for filter in filters(command).into_iter().filter(|filter| *filter != "NAME") {
                if !functions.iter().any(|function| function.contains(filter)) {
                    wrong.insert(format!("{}: no test is named {filter}", document.display()));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.into_iter().collect::<Vec<_>>().join("\n"));
}

#[test]
fn every_key_of_a_result_is_described() {
    let out = tempdir().unwrap();
    let dir = out.path().to_string_lossy();
    let args = [
        "identify",
        "examples/paper/observations.csv",
        "--robot",
        "kr60ha",
        "--tool",
        "30,20,10",
        "--centres",
    ];
    let more = ["examples/paper/centres.csv", "--estimate", "alpha1-5,a1-5,d4-6", "--out", &*dir];
    let identified = dbbd(root(), &[&args[..], &more].concat());
    assert!(identified.status.success());
    let result: serde_json::Value = serde_json::from_str(&read(&out.path().join("result.json"))).unwrap();
    let page = read(&root().join("docs/reference/files.md"));
    for key in result.as_object().unwrap().keys() {
        let quoted = [format!("`{key}`"), format!("`{key}."), format!("`{key}[")];
        assert!(quoted.iter().any(|key| page.contains(key)), "docs/reference/files.md lacks `{key}`");
    }
    for file in fs::read_dir(out.path()).unwrap().flatten() {
        let name = file.file_name().to_string_lossy().into_owned();
        assert!(page.contains(&format!("`{name}`")), "docs/reference/files.md lacks {name}");
    }
}

#[test]
#[ignore = "needs mdbook: .ci/night"]
fn the_book_is_rendered() {
    let out = tempdir().unwrap();
    let mut mdbook = Command::new("mdbook");
    let built = mdbook.arg("build").arg("--dest-dir").arg(out.path()).current_dir(root()).output();
    let output = built.expect("mdbook is installed: cargo install mdbook");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !said.contains("ERROR"), "{said}");
    assert!(out.path().join("tutorial/first-calibration.html").is_file());
}
