//! Values as JSON, TOML and CSV texts. A value that the format cannot hold is an error, never an empty text.

use std::fmt::Display;

use serde::Serialize;

use super::hash::sha256;
use crate::base::InternalFinding;
use crate::provenance::ProvenanceFinding;

/// Separates an object from its hash, in the last line of a sealed JSON text.
const JSON_SEAL: &str = ",\n  \"sha256\": \"";
/// Begins the last line of a sealed TOML text.
const TOML_SEAL: &str = "# SHA-256 of the lines above: ";

fn not_written<E: Display>(form: &'static str) -> impl Fn(E) -> InternalFinding {
    move |why| InternalFinding::NotWritten { form, why: why.to_string() }
}

/// Indented JSON.
pub fn json(value: &impl Serialize) -> Result<String, InternalFinding> {
    serde_json::to_string_pretty(value).map_err(not_written("JSON"))
}

/// JSON in one line.
pub fn json_line(value: &impl Serialize) -> Result<String, InternalFinding> {
    serde_json::to_string(value).map_err(not_written("JSON"))
}

/// Indented JSON of an object, ending in a newline. Its last key, `sha256`, has the hash of the text without it.
pub fn sealed_json(value: &impl Serialize) -> Result<String, InternalFinding> {
    let text = json(value)?;
    let open = text.strip_suffix("\n}").unwrap_or(&text);
    Ok(format!("{open}{JSON_SEAL}{}\"\n}}\n", sha256(&text)))
}

/// Refuses a text that was edited after [`sealed_json`] wrote it. A text without a hash is accepted.
pub fn check_seal(text: &str) -> Result<(), ProvenanceFinding> {
    let Some((open, end)) = text.rsplit_once(JSON_SEAL) else { return Ok(()) };
    let actual = sha256(format!("{open}\n}}"));
    if end.trim_end() == format!("{actual}\"\n}}") { Ok(()) } else { Err(ProvenanceFinding::Edited) }
}

pub fn toml(value: &impl Serialize) -> Result<String, InternalFinding> {
    toml::to_string(value).map_err(not_written("TOML"))
}

/// Appends a comment line with the SHA-256 of the text above it.
pub fn sealed_toml(text: &str) -> String {
    format!("{text}{TOML_SEAL}{}\n", sha256(text))
}

/// Whether a text is as [`sealed_toml`] wrote it; `None` if it has no hash.
pub fn is_sealed_toml(text: &str) -> Option<bool> {
    let (above, end) = text.rsplit_once(TOML_SEAL)?;
    Some(sha256(above) == end.trim_end())
}

/// A CSV table whose columns are the fields of its rows.
pub fn csv(rows: impl IntoIterator<Item = impl Serialize>) -> Result<String, InternalFinding> {
    csv_rows(csv::Writer::from_writer(Vec::new()), rows)
}

/// A CSV table with these column names; each row is a tuple or a list of cells.
pub fn csv_table(
    columns: impl IntoIterator<Item = impl AsRef<[u8]>>,
    rows: impl IntoIterator<Item = impl Serialize>,
) -> Result<String, InternalFinding> {
    let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    writer.write_record(columns).map_err(not_written("CSV"))?;
    csv_rows(writer, rows)
}

fn csv_rows(
    mut writer: csv::Writer<Vec<u8>>,
    rows: impl IntoIterator<Item = impl Serialize>,
) -> Result<String, InternalFinding> {
    for row in rows {
        writer.serialize(row).map_err(not_written("CSV"))?;
    }
    let bytes = writer.into_inner().map_err(not_written("CSV"))?;
    String::from_utf8(bytes).map_err(not_written("CSV"))
}
