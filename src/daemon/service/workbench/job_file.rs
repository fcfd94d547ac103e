//! Edits the file of a job: keys are set or removed, comments and all other keys stay.

use serde_json::Value;
use toml_edit::{ArrayOfTables, DocumentMut, Item, Table, value};

use crate::live::ServiceFinding::{self, JobKey};

/// First line of a new file.
pub(super) const HEAD: &str =
    "# A job for `dbbd plan`: lengths in mm, angles in degrees. examples/circles.toml explains every key.\n";

/// The key that says which table of the file an object of a list is: its place from 0. An object without it is new.
const ROW: &str = "row";

/// Sets the keys of `keys` in a table. Null removes a key; an object is set in the table of that name; a list of
/// objects is the whole list of tables: each object names its table by [`ROW`], which keeps its other keys and comments.
/// Tables that no object names are removed.
pub(super) fn set_keys(document: &mut DocumentMut, keys: &Value) -> Result<(), ServiceFinding> {
    set_in(document.as_table_mut(), keys, "job")
}

fn set_in(table: &mut Table, keys: &Value, at: &str) -> Result<(), ServiceFinding> {
    let wrong = |key: &str| JobKey { key: key.into() };
    let keys = keys.as_object().ok_or_else(|| wrong(at))?;
    for (key, wanted) in keys {
        let is_tables = |all: &Vec<Value>| !all.is_empty() && all.iter().all(Value::is_object);
        match wanted {
            Value::Null => {
                table.remove(key);
            }
            Value::Object(_) => {
                let inner = table.entry(key).or_insert_with(|| Item::Table(Table::new()));
                let inner = inner.as_table_mut().ok_or_else(|| wrong(key))?;
                set_in(inner, wanted, key)?;
            }
            Value::Array(all) if is_tables(all) => {
                let list = table.entry(key).or_insert_with(|| Item::ArrayOfTables(ArrayOfTables::new()));
                let list = list.as_array_of_tables_mut().ok_or_else(|| wrong(key))?;
                *list = edited_tables(list, all, key)?;
            }
            // An empty list removes a list of tables.
            Value::Array(all) if all.is_empty() && table.get(key).is_some_and(Item::is_array_of_tables) => {
                table.remove(key);
            }
            Value::Bool(_) | Value::Number(_) | Value::String(_) | Value::Array(_) => {
                let new = of_json(wanted).ok_or_else(|| wrong(key))?;
                set_value(table, key, new);
            }
        }
    }
    Ok(())
}

/// The tables of a list that objects name, with their keys set, and new ones.
fn edited_tables(before: &ArrayOfTables, all: &[Value], key: &str) -> Result<ArrayOfTables, ServiceFinding> {
    let wrong = || JobKey { key: key.into() };
    let mut left: Vec<Option<&Table>> = before.iter().map(Some).collect();
    let mut after = ArrayOfTables::new();
    for wanted in all {
        let mut keys = wanted.as_object().cloned().ok_or_else(wrong)?;
        let mut table = match keys.remove(ROW) {
            None => Table::new(),
            Some(row) => {
                let row = row.as_u64().and_then(|row| usize::try_from(row).ok()).ok_or_else(wrong)?;
                // No two objects are the same table.
                left.get_mut(row).and_then(Option::take).ok_or_else(wrong)?.clone()
            }
        };
        set_in(&mut table, &Value::Object(keys), key)?;
        after.push(table);
    }
    Ok(after)
}

/// Sets a value unless it is there already, and keeps the comment behind the old one.
fn set_value(table: &mut Table, key: &str, mut new: toml_edit::Value) {
    if let Some(old) = table.get(key).and_then(Item::as_value) {
        if is_same(old, &new) {
            return;
        }
        *new.decor_mut() = old.decor().clone();
    }
    match table.get_mut(key) {
        Some(item) => *item = Item::Value(new),
        None => {
            table.insert(key, value(new));
        }
    }
}

/// Whether two values mean the same: `300` and `300.0` do.
fn is_same(a: &toml_edit::Value, b: &toml_edit::Value) -> bool {
    let number =
        |one: &toml_edit::Value| one.as_float().or_else(|| one.as_integer().map(|whole| whole as f64));
    match (number(a), number(b)) {
        (Some(a), Some(b)) => a == b,
        _ => match (a.as_array(), b.as_array()) {
            (Some(a), Some(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same(a, b)),
            _ => {
                a.as_str().is_some() && a.as_str() == b.as_str()
                    || a.as_bool().is_some() && a.as_bool() == b.as_bool()
            }
        },
    }
}

fn of_json(json: &Value) -> Option<toml_edit::Value> {
    Some(match json {
        Value::Bool(flag) => (*flag).into(),
        Value::String(text) => text.as_str().into(),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => whole.into(),
            None => number.as_f64()?.into(),
        },
        Value::Array(all) => {
            let all: Option<toml_edit::Array> = all.iter().map(of_json).collect();
            all?.into()
        }
        Value::Null | Value::Object(_) => return None,
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const HAND_WRITTEN: &str = "\
# My cell.
robot = \"kr60ha\"  # the new one

[tool]
ball_mm = [30.0, 20.0, 10.0]
[bar]
length_mm = 300.0 # certificate of May
stroke_mm = [-5.0, 5.0]
own_key = 1

# the post
[[centre]]
id = 1
xyz_mm = [1300.0, 0.0, 800.0]

[[circle]]
plane = \"XY\" # the first
points = 80
";

    fn edited(keys: &Value) -> String {
        let mut document: DocumentMut = HAND_WRITTEN.parse().unwrap();
        set_keys(&mut document, keys).unwrap();
        document.to_string()
    }

    #[test]
    fn the_same_values_leave_the_file_as_it_is() {
        let keys = json!({
            "robot": "kr60ha", "bar": { "length_mm": 300, "stroke_mm": [-5, 5] },
            "centre": [{ "row": 0, "id": 1, "xyz_mm": [1300, 0, 800] }], "circle": [{ "row": 0 }],
        });
        assert_eq!(edited(&keys), HAND_WRITTEN);
    }

    #[test]
    fn a_changed_value_keeps_comments_and_unknown_keys() {
        let text = edited(
            &json!({ "bar": { "length_mm": 299.5 }, "circle": [{ "row": 0, "points": 40 }, { "points": 12 }] }),
        );
        let wanted = HAND_WRITTEN.replace("300.0 #", "299.5 #").replace("points = 80", "points = 40");
        assert!(text.starts_with(&wanted), "{text}");
        assert!(text.trim_end().ends_with("[[circle]]\npoints = 12"), "{text}");
    }

    /// A ball that is removed takes its own keys and comments with it, not those of its neighbour.
    #[test]
    fn a_removed_table_leaves_the_others_as_they_are() {
        let second =
            "\n# the shelf\n[[centre]]\nid = 2\nxyz_mm = [950.0, 700.0, 1100.0]\ncup_axis = [1, 0, 0]\n";
        let text = HAND_WRITTEN.replace("\n[[circle]]", &format!("{second}\n[[circle]]"));
        let mut document: DocumentMut = text.parse().unwrap();
        set_keys(&mut document, &json!({ "centre": [{ "row": 1 }] })).unwrap();
        let first = "\n# the post\n[[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n";
        assert_eq!(document.to_string(), text.replace(first, ""));
        for rows in [json!([{ "row": 0 }, { "row": 0 }]), json!([{ "row": 2 }]), json!([{ "row": -1 }])] {
            let mut document: DocumentMut = text.parse().unwrap();
            let refused = set_keys(&mut document, &json!({ "centre": rows }));
            assert!(matches!(refused, Err(JobKey { key }) if key == "centre"));
        }
    }

    #[test]
    fn null_and_shorter_lists_remove() {
        let text = edited(&json!({ "bar": { "own_key": null }, "circle": [] }));
        let wanted = HAND_WRITTEN.replace("own_key = 1\n", "");
        assert_eq!(text, wanted[..wanted.find("\n[[circle]]").unwrap()]);
    }

    #[test]
    fn a_table_in_place_of_a_number_is_refused() {
        let mut document: DocumentMut = HAND_WRITTEN.parse().unwrap();
        let refused = set_keys(&mut document, &json!({ "robot": { "name": "x" } }));
        assert!(matches!(refused, Err(JobKey { key }) if key == "robot"));
    }
}
