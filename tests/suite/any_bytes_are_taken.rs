//! Whatever bytes come in, nothing panics: the corpus of each entrance and mutations of it. The entrances and
//! their laws stand in `fuzz/entries.rs`; what a fuzzer once found stays in `fuzz/corpus/` for ever.

#[path = "../../fuzz/entries.rs"]
pub(crate) mod entries;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// What is put in here and there: numbers at the edge, and what separates.
const WORDS: [&str; 28] = [
    "NaN",
    "inf",
    "-inf",
    "1e999",
    "-1e999",
    "1e-999",
    "0",
    "-0.0",
    "-1",
    "1e12",
    "1e-12",
    "255",
    "256",
    "65536",
    "4294967296",
    "18446744073709551616",
    "-9223372036854775808",
    "\0",
    "\n",
    "\r\n",
    "\"",
    ",",
    "=",
    "[[",
    "]",
    "{",
    "}",
    "ä",
];
/// Longer ones are cut: a find is to be small.
const LONGEST: usize = 20_000;

fn files(directory: &Path, end: &str) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(directory) else { return Vec::new() };
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.is_file() && path.to_string_lossy().ends_with(end));
    files.sort();
    files
}

/// The corpus, and the shipped files that come in there.
fn seeds(name: &str) -> Vec<Vec<u8>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut paths = files(&root.join("fuzz/corpus").join(name), "");
    assert!(!paths.is_empty(), "no fuzz/corpus/{name}");
    let (shipped, end) = match name {
        "definition" => ("protocols", ".toml"),
        "job" => ("examples", ".toml"),
        "robot" => ("robots", ".toml"),
        "capture" => ("fixtures/captures", ".dbbd"),
        _ => ("", "none"),
    };
    paths.extend(files(&root.join(shipped), end));
    let read = |path: PathBuf| {
        let mut bytes = std::fs::read(path).unwrap();
        bytes.truncate(LONGEST);
        bytes
    };
    paths.into_iter().map(read).collect()
}

/// One to four changes.
fn mutated(seeds: &[Vec<u8>], dice: &mut Pcg64) -> Vec<u8> {
    let mut bytes = seeds[dice.random_range(0..seeds.len())].clone();
    for _ in 0..dice.random_range(1..=4) {
        let at = dice.random_range(0..=bytes.len());
        let to = dice.random_range(at..=bytes.len().min(at + 40));
        match dice.random_range(0..8) {
            0 if at < bytes.len() => bytes[at] ^= 1 << dice.random_range(0..8),
            1 if at < bytes.len() => bytes[at] = dice.random(),
            2 => drop(bytes.drain(at..to)),
            3 => bytes.splice(at..at, bytes[at..to].to_vec()).for_each(drop),
            4 => bytes.truncate(at),
            5 => {
                let other = &seeds[dice.random_range(0..seeds.len())];
                let from = dice.random_range(0..=other.len());
                bytes.splice(at..to, other[from..other.len().min(from + 60)].to_vec()).for_each(drop);
            }
            6 => {
                let word = WORDS[dice.random_range(0..WORDS.len())];
                bytes.splice(at..at, word.bytes()).for_each(drop);
            }
            _ => {
                // A number becomes another.
                let digit = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'-');
                let Some(from) = bytes[at..].iter().position(digit).map(|more| at + more) else { continue };
                let len = bytes[from..].iter().take_while(|byte| digit(byte)).count();
                let word = WORDS[dice.random_range(0..17)];
                bytes.splice(from..from + len, word.bytes()).for_each(drop);
            }
        }
    }
    bytes
}

/// Sends the corpus and so many mutations through an entrance.
fn takes(name: &str, mutations: u64, seed: u64) {
    let seeds = seeds(name);
    let mut dice = Pcg64::seed_from_u64(seed);
    let more = (0..mutations).map(|_| mutated(&seeds, &mut dice));
    for bytes in seeds.iter().cloned().chain(more) {
        if catch_unwind(AssertUnwindSafe(|| entries::run(name, &bytes))).is_err() {
            let find = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("find-{name}"));
            std::fs::write(&find, &bytes).unwrap();
            panic!("{}: mend it, and keep it in fuzz/corpus/{name}/", find.display());
        }
    }
}

/// One test for each entrance, with the number of mutations.
macro_rules! sent {
    ($(#[$test:meta] $name:ident: $mutations:literal,)*) => {
        $(#[$test]
        fn $name() {
            takes(stringify!($name), $mutations, 1);
        })*

        const SENT: &[&str] = &[$(stringify!($name)),*];
    };
}

sent! {
    #[test]
    axes: 3000,
    #[test]
    capture: 1000,
    #[test]
    circle: 500,
    #[test]
    decoder: 6000,
    #[test]
    definition: 3000,
    #[test]
    description: 2000,
    #[test]
    fanuc: 1000,
    #[test]
    http: 3000,
    #[test]
    job: 2000,
    #[test]
    krl: 2000,
    #[test]
    plan: 1500,
    #[test]
    rapid: 1000,
    #[test]
    result: 1000,
    #[test]
    robot: 3000,
    #[test]
    settings: 3000,
    #[test]
    tables: 4000,
    #[test]
    trace: 4000,
    #[test]
    urscript: 1000,
}

#[test]
fn every_entrance_is_sent_and_has_a_target() {
    assert_eq!(entries::ENTRIES.map(|(name, _)| name), SENT);
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz");
    let manifest = std::fs::read_to_string(root.join("Cargo.toml")).unwrap();
    for name in SENT {
        assert!(manifest.contains(&format!("name = \"{name}\"")), "{name} is not in fuzz/Cargo.toml");
        let target = std::fs::read_to_string(root.join(format!("fuzz_targets/{name}.rs"))).unwrap();
        assert!(target.contains(&format!("run(\"{name}\", data)")), "{target}");
    }
}

/// `cargo test --release --test suite any_bytes_are_taken::a_million -- --ignored --nocapture`
#[test]
#[ignore = "a campaign"]
fn a_million_mutations() {
    for (name, _) in entries::ENTRIES {
        takes(name, 120_000, 2);
        eprintln!("{name}: 120000 mutations");
    }
}
