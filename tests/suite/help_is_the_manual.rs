//! The text of a command is written once, above its `Args`. `--help`, the manual page and docs/reference/commands.md repeat it.
//! `DBBD_BLESS=1 cargo test help_is_the_manual` writes the document.

use std::fs;
use std::path::Path;

use crate::cell::dbbd;

const BEGIN: &str = "<!-- begin of the generated list -->\n";
const END: &str = "<!-- end of the generated list -->\n";

fn said(args: &[&str]) -> String {
    let output = dbbd(Path::new("."), args);
    assert!(output.status.success(), "{args:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// The commands in the order of `dbbd --help`.
fn verbs() -> Vec<String> {
    let help = said(&["--help"]);
    let list = help.split("Commands:\n").nth(1).unwrap().split("\n\n").next().unwrap();
    let names = list.lines().filter(|line| !line.starts_with("     "));
    names
        .map(|line| line.split_whitespace().next().unwrap().to_owned())
        .filter(|verb| verb != "help")
        .collect()
}

/// The help of a command before its "Usage:", one paragraph per entry, and the usage.
fn paragraphs_and_usage(verb: &str) -> (Vec<String>, String) {
    let help = said(&[verb, "--help"]);
    let (text, rest) = help.split_once("\nUsage: ").unwrap();
    let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let usage = rest.split("\n\n").next().unwrap_or_default();
    (text.trim().split("\n\n").map(words).collect(), words(usage))
}

fn paragraphs(verb: &str) -> Vec<String> {
    paragraphs_and_usage(verb).0
}

/// A paragraph with links in place of the names of pages, for a page in docs/reference.
fn with_links(paragraph: &str) -> String {
    let link = |word: &str| match word.strip_prefix("docs/").and_then(|page| page.split_once(".md")) {
        Some((page, rest)) => format!("[{page}](../{page}.md){rest}"),
        None => word.to_owned(),
    };
    paragraph.split(' ').map(link).collect::<Vec<_>>().join(" ")
}

/// Compares the generated part of a document, or writes it.
fn assert_generated(document: &str, wanted: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(document);
    let text = fs::read_to_string(&path).unwrap();
    let (before, rest) = text.split_once(BEGIN).expect("the first marker");
    let (section, after) = rest.split_once(END).expect("the second marker");
    if std::env::var_os("DBBD_BLESS").is_some() {
        fs::write(&path, format!("{before}{BEGIN}{wanted}{END}{after}")).unwrap();
        return;
    }
    for (is, wanted) in section.lines().zip(wanted.lines()) {
        assert_eq!(is, wanted, "{document} differs; DBBD_BLESS=1 writes it again");
    }
    assert_eq!(section.lines().count(), wanted.lines().count(), "{document}: DBBD_BLESS=1 writes it again");
}

#[test]
fn reference_has_the_text_of_every_command() {
    let section = |verb: &String| {
        let (paragraphs, usage) = paragraphs_and_usage(verb);
        let text: String = paragraphs.iter().map(|p| format!("{}\n\n", with_links(p))).collect();
        format!("## {verb}\n\n{text}    {usage}\n\n")
    };
    let sections: String = verbs().iter().map(section).collect();
    assert_generated("docs/reference/commands.md", &format!("\n{sections}"));
}

/// Compares the manual page, without roff escapes and line breaks, with the text of each command and its options.
#[test]
fn manual_page_has_every_command_and_option() {
    let page = said(&["man"]).replace("\\-", "-").replace("\\fB", "").replace("\\fR", "").replace("\\fI", "");
    let page = page.replace("\\'", "'").replace("\\*(Aq", "'").replace("\\&", "");
    let page = page.split_whitespace().collect::<Vec<_>>().join(" ");
    for verb in verbs() {
        for paragraph in paragraphs(&verb) {
            assert!(page.contains(&paragraph), "{verb}: the manual page lacks `{paragraph}`");
        }
        let help = said(&[&verb, "--help"]);
        let options = help.split_whitespace().filter(|word| word.starts_with("--") && word.len() > 2);
        for option in options {
            let name: String = option.chars().take_while(|c| c.is_ascii_lowercase() || *c == '-').collect();
            assert!(page.contains(&name), "{verb}: the manual page lacks {name}");
        }
    }
}

#[test]
fn completions_have_every_command() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = said(&["completions", shell]);
        for verb in verbs() {
            assert!(script.contains(&verb), "{shell} lacks {verb}");
        }
    }
}
