//! Values as texts. A value that its form cannot hold is an error, never an empty text.

use serde::Serialize;

use super::hash::sha256;
use crate::catalogue::{CliFinding, ProvenanceFinding};

fn unfit(form: &'static str) -> impl Fn(&dyn std::fmt::Display) -> CliFinding {
    move |why| CliFinding::NotWritten { form, why: why.to_string() }
}

/// Indented JSON.
///
/// # Errors
/// What JSON cannot hold.
pub fn json(value: &impl Serialize) -> Result<String, CliFinding> {
    serde_json::to_string_pretty(value).map_err(|error| unfit("JSON")(&error))
}

/// Indented JSON of an object, a line at its end, whose last key has the SHA-256 of the text without it.
///
/// # Errors
/// As [`json`].
pub fn sealed_json(value: &impl Serialize) -> Result<String, CliFinding> {
    let text = json(value)?;
    let open = text.strip_suffix("\n}").unwrap_or(&text);
    Ok(format!("{open}{SEAL}{}\"\n}}\n", sha256(&text)))
}

const SEAL: &str = ",\n  \"sha256\": \"";

/// That nobody changed a text since [`sealed_json`] made it; one without a hash is as good as any.
///
/// # Errors
/// Its hash is of another text.
pub fn check_seal(text: &str) -> Result<(), ProvenanceFinding> {
    let Some((open, end)) = text.rsplit_once(SEAL) else { return Ok(()) };
    let sha256_is = sha256(format!("{open}\n}}"));
    if end.trim_end() == format!("{sha256_is}\"\n}}") { Ok(()) } else { Err(ProvenanceFinding::Edited) }
}

/// A TOML text with a last line, a comment, that has the SHA-256 of what is above.
pub fn sealed_toml(text: &str) -> String {
    format!("{text}{TOML_SEAL}{}\n", sha256(text))
}

const TOML_SEAL: &str = "# SHA-256 of the lines above: ";

/// Whether a text is as [`sealed_toml`] made it; `None` of one without a hash.
pub fn is_sealed_toml(text: &str) -> Option<bool> {
    let (above, end) = text.rsplit_once(TOML_SEAL)?;
    Some(sha256(above) == end.trim_end())
}

/// JSON in one line.
///
/// # Errors
/// As [`json`].
pub fn json_line(value: &impl Serialize) -> Result<String, CliFinding> {
    serde_json::to_string(value).map_err(|error| unfit("JSON")(&error))
}

/// A TOML file.
///
/// # Errors
/// What TOML cannot hold.
pub fn toml(value: &impl Serialize) -> Result<String, CliFinding> {
    toml::to_string(value).map_err(|error| unfit("TOML")(&error))
}

/// A table whose columns are the fields of its rows.
///
/// # Errors
/// What a cell cannot hold.
pub fn csv(rows: impl IntoIterator<Item = impl Serialize>) -> Result<String, CliFinding> {
    lines(csv::Writer::from_writer(Vec::new()), rows)
}

/// The same without its header.
///
/// # Errors
/// As [`csv()`].
pub fn csv_rows(rows: impl IntoIterator<Item = impl Serialize>) -> Result<String, CliFinding> {
    lines(csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new()), rows)
}

fn lines(
    mut writer: csv::Writer<Vec<u8>>,
    rows: impl IntoIterator<Item = impl Serialize>,
) -> Result<String, CliFinding> {
    for row in rows {
        writer.serialize(row).map_err(|error| unfit("CSV")(&error))?;
    }
    let bytes = writer.into_inner().map_err(|error| unfit("CSV")(&error))?;
    String::from_utf8(bytes).map_err(|error| unfit("CSV")(&error))
}
