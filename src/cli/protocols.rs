//! `dbbd protocols`.

use std::error::Error;
use std::path::{Path, PathBuf};

use serde_json::json;

use super::{Outcome, Output, Verdict, files};
use crate::diag::{Diagnostic, nearest};
use crate::protocol::Definition;

/// Arguments of the verb.
#[derive(clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: Option<What>,
}

#[derive(clap::Subcommand)]
enum What {
    /// List the built-in definitions (the default).
    List,
    /// Print a built-in definition, as a start for one's own.
    Show {
        /// Its name.
        name: String,
    },
    /// Check a definition file and run its test vectors.
    Check {
        /// The TOML file.
        file: PathBuf,
    },
}

pub(crate) fn run(args: &Args, out: &Output) -> Verdict {
    match &args.what {
        None | Some(What::List) => list(out),
        Some(What::Show { name }) => {
            let definition = match Definition::by_name(name) {
                Some(definition) => definition?,
                None => return Err(unknown(name).into()),
            };
            out.document(&summary(&definition))?;
            out.result(definition.text.trim_end());
            Ok(Outcome::Done)
        }
        Some(What::Check { file }) => {
            let definition = from_file(file)?;
            out.document(&summary(&definition))?;
            out.result(format!("{}: `{}` is sound; its test vectors pass", file.display(), definition.id));
            Ok(Outcome::Done)
        }
    }
}

/// A definition by built-in name or by file.
///
/// # Errors
/// An unknown name, or what is wrong in the file.
pub(crate) fn load(name: &str) -> Result<Definition, Box<dyn Error>> {
    if let Some(built_in) = Definition::by_name(name) {
        return Ok(built_in?);
    }
    let path = Path::new(name);
    if path.exists() || name.ends_with(".toml") {
        return Ok(from_file(path)?);
    }
    Err(unknown(name).into())
}

fn from_file(path: &Path) -> Result<Definition, Diagnostic> {
    Definition::from_toml(&path.display().to_string(), &files::read(path)?)
}

fn unknown(name: &str) -> String {
    let known: Vec<&str> = Definition::built_in().iter().map(|(name, _)| *name).collect();
    let meant = nearest(name, known.iter().copied())
        .map_or(String::new(), |near| format!("; did you mean `{near}`?"));
    format!(
        "no protocol `{name}`: neither built in nor a file{meant}\n  help: built in are: {}; a file ends in .toml",
        known.join(", ")
    )
}

fn summary(definition: &Definition) -> serde_json::Value {
    json!({
        "id": definition.id,
        "title": definition.title,
        "confidence": definition.confidence,
        "source": definition.source,
        "tested_on": definition.tested_on,
        "baud": definition.line.baud,
        "nominal_hz": definition.nominal_hz,
    })
}

fn list(out: &Output) -> Verdict {
    let mut all = Vec::new();
    for (name, text) in Definition::built_in() {
        let definition = Definition::from_toml(name, text)?;
        out.result(format!("{name:12}  {} [{}]", definition.title, definition.confidence));
        all.push(summary(&definition));
    }
    out.document(&all)?;
    Ok(Outcome::Done)
}
