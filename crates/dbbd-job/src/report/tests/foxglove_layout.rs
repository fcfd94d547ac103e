//! The shipped Foxglove layout asks for topics and fields that the MCAP export has.

use std::collections::BTreeMap;
use std::fs::File;

use dbbd_job::report::export::mcap::{CHANNELS, McapFile};
use serde_json::Value;
use tempfile::tempdir;

/// Every message path of a layout: `topic` or `topic.field`.
fn paths(value: &Value, found: &mut Vec<String>) {
    match value {
        Value::Object(map) => {
            for (key, inner) in map {
                match inner.as_str() {
                    Some(path) if key == "value" || key == "topicPath" => found.push(path.to_owned()),
                    _ => paths(inner, found),
                }
            }
        }
        Value::Array(list) => list.iter().for_each(|inner| paths(inner, found)),
        _ => {}
    }
}

#[test]
fn the_layout_uses_channels_of_the_export() {
    let dir = tempdir().unwrap();
    let path = dir.path().join("empty.mcap");
    McapFile::new(File::create(&path).unwrap(), None).unwrap().finish().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let is_json = |channel: &&std::sync::Arc<mcap::Channel<'_>>| channel.message_encoding == "json";
    let fields: BTreeMap<String, Value> = summary
        .channels
        .values()
        .filter(is_json)
        .map(|channel| {
            let schema = channel.schema.as_ref().unwrap();
            (
                channel.topic.clone(),
                serde_json::from_slice::<Value>(&schema.data).unwrap()["properties"].clone(),
            )
        })
        .collect();
    assert_eq!(fields.len() + 2, CHANNELS.len());
    let layout: Value = serde_json::from_str(include_str!(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../examples/foxglove/dbbd.json"
    )))
    .unwrap();
    let mut asked = Vec::new();
    paths(&layout, &mut asked);
    assert!(asked.len() >= 8, "{asked:?}");
    for path in asked {
        let (topic, field) = path.split_once('.').unwrap_or((&path, ""));
        let has = fields.get(topic).unwrap_or_else(|| panic!("no topic {topic}: {path}"));
        assert!(field.is_empty() || has.get(field).is_some(), "no field {field}: {path}");
    }
    // What the layout shows side by side exists as a panel.
    let panels = layout["configById"].as_object().unwrap();
    let mut shown = Vec::new();
    fn leaves(value: &Value, shown: &mut Vec<String>) {
        match value {
            Value::String(name) => shown.push(name.clone()),
            _ => ["first", "second"].iter().for_each(|side| leaves(&value[side], shown)),
        }
    }
    leaves(&layout["layout"], &mut shown);
    assert!(shown.len() == panels.len() && shown.iter().all(|name| panels.contains_key(name)), "{shown:?}");
}
