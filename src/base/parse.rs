//! What is wrong with a text that a parser of a library refused.

use crate::catalogue::FileFinding::{NotToml, NotTomlButAnother};
use crate::diagnostic::Diagnostic;

/// What is wrong with a TOML text.
pub fn wrong_toml(file: &str, text: &str, error: &toml::de::Error) -> Diagnostic {
    let why = error.message().to_owned();
    let finding = match file.rsplit_once('.') {
        Some((_, kind @ ("csv" | "json" | "src" | "dat"))) => NotTomlButAnother { why, kind: kind.into() },
        _ => NotToml { why },
    };
    match error.span() {
        Some(span) => Diagnostic::span(file, text, span, finding),
        None => Diagnostic::file(file, finding),
    }
}
