//! Values as texts. A value that its form cannot hold is an error, never an empty text.

use serde::Serialize;

use crate::catalogue::CliFinding;

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
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row).map_err(|error| unfit("CSV")(&error))?;
    }
    let bytes = writer.into_inner().map_err(|error| unfit("CSV")(&error))?;
    String::from_utf8(bytes).map_err(|error| unfit("CSV")(&error))
}
