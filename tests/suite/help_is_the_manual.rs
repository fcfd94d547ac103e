//! The text of a verb stands once, above its `Args`: `--help`, the manual page and the README's section "Commands" say it
//! alike. `DBBD_BLESS=1 cargo test help_is_the_manual` writes the README's section anew.

use std::fs;
use std::path::Path;

use crate::cell::dbbd;

const BEGIN: &str = "<!-- begin of what the verbs say of themselves -->\n";
const END: &str = "<!-- end of what the verbs say of themselves -->\n";

fn said(args: &[&str]) -> String {
    let output = dbbd(Path::new("."), args);
    assert!(output.status.success(), "{args:?}");
    String::from_utf8(output.stdout).unwrap()
}

/// The verbs in the order of `dbbd --help`.
fn verbs() -> Vec<String> {
    let help = said(&["--help"]);
    let list = help.split("Commands:\n").nth(1).unwrap().split("\n\n").next().unwrap();
    let names = list.lines().filter(|line| !line.starts_with("     "));
    names
        .map(|line| line.split_whitespace().next().unwrap().to_owned())
        .filter(|verb| verb != "help")
        .collect()
}

/// What stands before "Usage:", a paragraph an entry.
fn paragraphs(verb: &str) -> Vec<String> {
    let help = said(&[verb, "--help"]);
    let text = help.split("\nUsage:").next().unwrap();
    text.trim()
        .split("\n\n")
        .map(|paragraph| paragraph.split_whitespace().collect::<Vec<_>>().join(" "))
        .collect()
}

#[test]
fn readme_has_the_text_of_every_verb() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    let readme = fs::read_to_string(&path).unwrap();
    let (before, rest) = readme.split_once(BEGIN).expect("the README's marker");
    let (section, after) = rest.split_once(END).expect("the README's second marker");
    let wanted: String =
        verbs().iter().map(|verb| format!("- **`{verb}`** {}\n", paragraphs(verb).join(" "))).collect();
    if std::env::var_os("DBBD_BLESS").is_some() {
        fs::write(&path, format!("{before}{BEGIN}{wanted}{END}{after}")).unwrap();
        return;
    }
    for (stands, wanted) in section.lines().zip(wanted.lines()) {
        assert_eq!(stands, wanted, "the README differs; DBBD_BLESS=1 writes it anew");
    }
    assert_eq!(
        section.lines().count(),
        wanted.lines().count(),
        "the README lacks a verb, or has one too many"
    );
}

/// Roff escapes and line breaks aside, the manual page has each verb's text and each of its options.
#[test]
fn manual_page_has_every_verb_and_option() {
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
fn completions_know_every_verb() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = said(&["completions", shell]);
        for verb in verbs() {
            assert!(script.contains(&verb), "{shell} lacks {verb}");
        }
    }
}
