//! Where definitions come from: those that are built in, and files.

use super::definition::Definition;
use super::load;
use crate::diagnostic::Diagnostic;

/// The definitions that come with dbbd: name and file.
const BUILT_IN: &[(&str, &str)] = include!("../../../protocols/built-in.rs");

impl Definition {
    pub fn built_in() -> &'static [(&'static str, &'static str)] {
        BUILT_IN
    }

    /// A built-in definition by its name, with its parameters' defaults, if there is one.
    pub fn by_name(name: &str) -> Option<Result<Self, Diagnostic>> {
        Self::by_name_with(name, &[])
    }

    /// A built-in definition by its name with some parameters chosen, if there is one.
    pub fn by_name_with(name: &str, params: &[(String, String)]) -> Option<Result<Self, Diagnostic>> {
        let (_, text) = BUILT_IN.iter().find(|(built_in, _)| *built_in == name)?;
        Some(Self::from_toml_with(name, text, params))
    }

    /// Reads, checks and compiles a definition; its own test vectors are run.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        Self::from_toml_with(file, text, &[])
    }

    /// The same with some parameters chosen; the test vectors are run with their defaults.
    pub fn from_toml_with(file: &str, text: &str, params: &[(String, String)]) -> Result<Self, Diagnostic> {
        let load = || {
            let defaults = load::load(file, text, &[])?;
            load::test(file, text, &defaults)?;
            if params.is_empty() { Ok(defaults) } else { load::load(file, text, params) }
        };
        load().map_err(|wrong: Diagnostic| match wrong.help {
            Some(_) => wrong,
            None => wrong.help(
                "docs/reference/protocols.md has every key; `dbbd protocols show dbb-cobs-1` prints a complete definition",
            ),
        })
    }
}
