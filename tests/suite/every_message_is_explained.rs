//! docs/troubleshooting.md has every message that the program can print, each in the family whose cause and cure it tells.
//!
//! A message is a string literal of the sources with three words or more (what is in braces becomes `…`). It must stand in
//! a block ```text of the document, a line each; a line there that no source has any more is wrong as well. Messages of two
//! words cannot be told from words of a table, so they stand there without being asked for.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// What is no message although it reads like one: the beginning of a path, the beginning of the literal, and why.
const NO_MESSAGE: &[(&str, &str, &str)] = &[
    ("src/report/svg.rs", "", "markup"),
    ("src/report/plot/", "", "words of a picture"),
    ("src/report/choices.rs", "", "words of a page"),
    ("src/report/circle.rs", "", "words of a page"),
    ("src/report/diagnosis.rs", "", "words of a page"),
    ("src/report/handing_back.rs", "", "words of a page"),
    ("src/report/identification.rs", "", "words of a page"),
    ("src/report/parameters.rs", "", "words of a page"),
    ("src/report/plan", "", "words of a page"),
    ("src/cli/plan/page.rs", "", "words of a page"),
    ("src/cli/identify/page.rs", "", "words of a page"),
    ("src/circular/noise.rs", "", "words of a page: how an uncertainty came about"),
    ("src/export/frames.rs", "", "text of a KRL data list"),
    ("src/export/urdf.rs", "", "markup"),
    ("src/krl/emit/ekrl.rs", "", "text of a KRL program and of its channel file"),
    ("src/live/metrics.rs", "", "descriptions for Prometheus"),
    ("src/live/", "default-src", "a header of HTTP"),
    ("src/live/", "HTTP/1.1", "a header of HTTP"),
    ("src/live/api.rs", "text/plain", "a header of HTTP"),
    ("src/live/api.rs", "…=", "a cookie"),
    ("src/cli/demo/", "", "the demo's headings, its table and its files"),
    ("src/cli/acquire/view.rs", "", "the line that shows a run going on"),
    ("src/cli/acquire/simulated.rs", "[[centre]]", "a file"),
    ("src/cli/mod.rs", "", "help"),
    ("src/cli/", "The run ends at", "help"),
    ("src/cli/", "Exit codes:", "help"),
    ("src/cli/", "Without ", "help"),
    ("src/protocol/layout.rs", "", "the layout that `protocols show` prints"),
    ("src/protocol/check.rs", "", "the layout that `protocols show` prints"),
    ("src/sim/truth.rs", "", "a robot's name"),
];

/// In the rooms that write KRL a literal is program text when it begins as KRL does.
fn program_text(path: &str, literal: &str) -> bool {
    let first = literal.split([' ', '(', '=', '[']).next().unwrap();
    let keyword = first.len() > 1 && first.chars().all(|c| c.is_ascii_uppercase() || c == '_');
    path.starts_with("src/krl/emit/")
        && (keyword || literal.starts_with([';', '&', '<']) || literal.contains("XP["))
}

/// Every string literal outside comments and unit tests, with its line.
fn literals(source: &str) -> Vec<(usize, String)> {
    let code: Vec<char> = source.split("#[cfg(test)]\nmod").next().unwrap().chars().collect();
    let (mut found, mut at, mut line) = (Vec::new(), 0, 1);
    while at < code.len() {
        let next = code.get(at + 1).copied();
        match code[at] {
            '\n' => line += 1,
            '/' if next == Some('/') => {
                while code.get(at + 1).is_some_and(|c| *c != '\n') {
                    at += 1;
                }
            }
            // A character, not a lifetime.
            '\'' if next == Some('\\') => {
                at += 3;
                while code.get(at).is_some_and(|c| *c != '\'') {
                    at += 1;
                }
            }
            '\'' if code.get(at + 2) == Some(&'\'') => at += 2,
            '"' => {
                let begin = line;
                let hashes = code[..at].iter().rev().take_while(|c| **c == '#').count();
                let raw = code[..at - hashes].last() == Some(&'r');
                let mut text = String::new();
                at += 1;
                while at < code.len() {
                    match code[at] {
                        '"' if !raw || code[at + 1..].iter().take_while(|c| **c == '#').count() >= hashes => {
                            break;
                        }
                        '\\' if !raw => {
                            at += 1;
                            match code[at] {
                                'n' | 't' => text.push(' '),
                                '\n' => {
                                    line += 1;
                                    while code[at + 1].is_whitespace() {
                                        at += 1;
                                        line += usize::from(code[at] == '\n');
                                    }
                                }
                                other => text.push(other),
                            }
                        }
                        c => {
                            line += usize::from(c == '\n');
                            text.push(c);
                        }
                    }
                    at += 1;
                }
                found.push((begin, text));
            }
            _ => {}
        }
        at += 1;
    }
    found
}

/// A literal as the document writes it: placeholders as `…`, blanks and line ends as one blank.
fn as_written(literal: &str) -> String {
    let (mut text, mut depth) = (String::new(), 0);
    let plain = literal.replace("{{", "\u{1}").replace("}}", "\u{2}");
    for letter in plain.chars() {
        match letter {
            '{' => {
                depth += 1;
                text.push('…');
            }
            '}' => depth -= 1,
            _ if depth > 0 => {}
            '\u{1}' => text.push('{'),
            '\u{2}' => text.push('}'),
            other => text.push(other),
        }
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn is_a_message(text: &str) -> bool {
    let letters = |word: &&str| word.as_bytes().windows(2).any(|two| two.iter().all(u8::is_ascii_alphabetic));
    text.replace('…', " ").split_whitespace().filter(letters).count() >= 3
}

fn sources(dir: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn every_message_stands_in_the_document() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let document = fs::read_to_string(root.join("docs/troubleshooting.md")).unwrap();
    let mut explained = BTreeSet::new();
    for block in document.split("```text\n").skip(1) {
        let lines = block.split("\n```").next().unwrap().lines();
        explained.extend(lines.map(|line| line.trim().trim_start_matches("help: ").to_owned()));
    }
    let mut files = Vec::new();
    sources(&root.join("src"), &mut files);
    let (mut printed, mut unused) = (BTreeSet::new(), vec![true; NO_MESSAGE.len()]);
    let mut missing = Vec::new();
    for file in files {
        let path = file.strip_prefix(root).unwrap().display().to_string();
        for (line, literal) in literals(&fs::read_to_string(&file).unwrap()) {
            let text = as_written(&literal).trim_start_matches("help: ").to_owned();
            let exempt = NO_MESSAGE
                .iter()
                .position(|(dir, begin, _)| path.starts_with(dir) && text.starts_with(begin));
            if let Some(at) = exempt.filter(|_| is_a_message(&text)) {
                unused[at] = false;
            }
            let needed = is_a_message(&text) && exempt.is_none() && !program_text(&path, &text);
            if needed && !explained.contains(&text) {
                missing.push(format!("{path}:{line}: {text}"));
            }
            printed.insert(text);
        }
    }
    let stale: Vec<&String> = explained.difference(&printed).collect();
    assert!(missing.is_empty(), "docs/troubleshooting.md lacks\n{}", missing.join("\n"));
    assert!(stale.is_empty(), "docs/troubleshooting.md has what nothing prints any more:\n{stale:#?}");
    let idle: Vec<_> = NO_MESSAGE.iter().zip(unused).filter(|(_, unused)| *unused).collect();
    assert!(idle.is_empty(), "exempt for nothing: {idle:?}");
}

#[test]
fn literals_are_read_as_the_compiler_reads_them() {
    let source = "let a = \"one {x:.3} {{two}} \\\n   three\\n  help: \\\"f\\\"\"; // \"no\"\nlet b = r#\"a \"b\" c\"#; let c = '\"';\n\"last\"";
    let found: Vec<(usize, String)> =
        literals(source).into_iter().map(|(at, text)| (at, as_written(&text))).collect();
    assert_eq!(
        found,
        [(1, "one … {two} three help: \"f\"".into()), (3, "a \"b\" c".into()), (4, "last".into())]
    );
    assert!(is_a_message("… cannot be read") && !is_a_message("…: … mm"));
}
