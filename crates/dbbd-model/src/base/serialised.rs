//! Values as JSON, TOML and CSV texts. A value that the format cannot hold is an error, never an empty text.

use std::fmt::Display;

use serde::Serialize;

use super::hash::sha256;
use crate::base::InternalFinding;
use crate::provenance::ProvenanceFinding;

/// The SHA-256 of a text in its own last line. It shows that the text was edited after it was written.
#[derive(Clone, Copy, Debug)]
pub enum Seal {
    /// The last key of an indented object, `sha256`: the hash of the text without this key.
    Json,
    /// A comment line at the end: the hash of the lines above it.
    Toml,
}

impl Seal {
    /// The end of the text before the hash is added; the separator of text and hash; the text after the hash.
    fn marks(self) -> [&'static str; 3] {
        match self {
            Self::Json => ["\n}", ",\n  \"sha256\": \"", "\"\n}\n"],
            Self::Toml => ["", "# SHA-256 of the lines above: ", "\n"],
        }
    }

    /// The text with its hash.
    pub fn append(self, text: &str) -> String {
        let [end, before, after] = self.marks();
        let open = text.strip_suffix(end).unwrap_or(text);
        format!("{open}{before}{}{after}", sha256(text))
    }

    /// Refuses a text that was edited after [`Self::append`] made it. A text without a hash is accepted, and so are the line ends
    /// and the byte order mark that an editor or a version control of Windows adds.
    pub fn check(self, text: &str) -> Result<(), ProvenanceFinding> {
        let text = text.trim_start_matches('\u{feff}').split("\r\n").collect::<Vec<_>>().join("\n");
        let [end, before, after] = self.marks();
        let Some((open, hash)) = text.rsplit_once(before) else { return Ok(()) };
        let expected = format!("{}{after}", sha256(format!("{open}{end}")));
        if hash.trim_end() == expected.trim_end() { Ok(()) } else { Err(ProvenanceFinding::Edited) }
    }
}

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

/// Indented JSON of an object with its [`Seal`].
pub fn sealed_json(value: &impl Serialize) -> Result<String, InternalFinding> {
    Ok(Seal::Json.append(&json(value)?))
}

pub fn toml(value: &impl Serialize) -> Result<String, InternalFinding> {
    toml::to_string(value).map_err(not_written("TOML"))
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::diagnostic::Finding;

    /// `printf '{\n  "a": 1\n}' | sha256sum` and `printf 'a = 1\n' | sha256sum`.
    #[test]
    fn seal_is_the_hash_of_the_text_without_it() {
        let json = "{\n  \"a\": 1,\n  \"sha256\": \"8164669836e51c324aa26742645b519732d41a60b8047ebdea8e769ef8565d79\"\n}\n";
        let toml = "a = 1\n# SHA-256 of the lines above: cb78bd8a17f7b751fe0d4663366dcbc257204033ef7ddd64b1f2969573b5b2e2\n";
        assert_eq!(sealed_json(&BTreeMap::from([("a", 1)])).unwrap(), json);
        assert_eq!(Seal::Toml.append("a = 1\n"), toml);
        // A sealed JSON text is JSON, and its last key is the hash.
        assert_eq!(serde_json::from_str::<serde_json::Value>(json).unwrap()["a"], 1);
    }

    #[test]
    fn seal_breaks_where_the_text_is_edited() {
        let texts = [(Seal::Json, "{\n  \"a\": 1\n}"), (Seal::Toml, "a = 1\n")];
        for (seal, text) in texts {
            let sealed = seal.append(text);
            seal.check(text).unwrap();
            seal.check(&sealed).unwrap();
            // An editor adds or removes a newline at the end of a file.
            seal.check(&format!("{sealed}\n")).unwrap();
            seal.check(sealed.trim_end()).unwrap();
            seal.check(&format!("\u{feff}{}", sealed.replace('\n', "\r\n"))).unwrap();
            for edited in [sealed.replacen('1', "2", 1), sealed.replacen('a', "b", 1), format!("{sealed}x")] {
                assert!(seal.check(&edited).is_err(), "{edited}");
            }
        }
    }

    #[test]
    fn tables_have_their_columns_and_quotes() {
        assert_eq!(csv_table(["a", "b"], [(1, "x,y"), (2, "z")]).unwrap(), "a,b\n1,\"x,y\"\n2,z\n");
        assert_eq!(json_line(&[1, 2]).unwrap(), "[1,2]");
    }

    #[test]
    fn unserialisable_value_is_an_error() {
        let map = BTreeMap::from([([1, 2], 3)]);
        let texts = [json(&map), json_line(&map), toml(&map), csv_table(["a"], [&[1][..], &[1, 2]])];
        for text in texts {
            assert_eq!(text.unwrap_err().code().as_str(), "E0009");
        }
    }
}
