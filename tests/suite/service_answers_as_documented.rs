//! The API agrees with its OpenAPI document; configuration errors have line and column.
#![cfg(unix)]

use std::collections::BTreeSet;

use dbbd::live;
use serde_json::Value;

use crate::cell;
use crate::service::Server;

fn document() -> Value {
    serde_json::from_str(live::OPENAPI).unwrap()
}

#[test]
fn openapi_describes_exactly_the_routes() {
    let served: BTreeSet<(String, String)> = live::routes()
        .into_iter()
        .flat_map(|(path, methods)| {
            methods.split(", ").map(move |method| (path.to_owned(), method.to_owned()))
        })
        .collect();
    let document = document();
    let documented: BTreeSet<(String, String)> = document["paths"]
        .as_object()
        .unwrap()
        .iter()
        .flat_map(|(path, operations)| {
            operations.as_object().unwrap().keys().map(move |method| (path.clone(), method.to_uppercase()))
        })
        .collect();
    assert_eq!(served, documented);
}

/// Follows `$ref`.
fn resolved<'a>(document: &'a Value, schema: &'a Value) -> &'a Value {
    match schema["$ref"].as_str() {
        Some(path) => document.pointer(path.trim_start_matches('#')).unwrap(),
        None => schema,
    }
}

/// Checks that a JSON document has exactly the properties of its schema.
fn assert_fits(document: &Value, schema: &Value, content: &Value, at: &str) {
    let schema = resolved(document, schema);
    if let (Some(properties), Some(object)) = (schema["properties"].as_object(), content.as_object()) {
        for (name, value) in object {
            let inner = properties.get(name).unwrap_or_else(|| panic!("{at}.{name} is not documented"));
            assert_fits(document, inner, value, &format!("{at}.{name}"));
        }
        for name in schema["required"].as_array().unwrap() {
            assert!(object.contains_key(name.as_str().unwrap()), "{at} has no {name}");
        }
    }
    if let Some(items) = content.as_array() {
        items.iter().for_each(|item| assert_fits(document, &schema["items"], item, &format!("{at}[]")));
    }
}

#[test]
fn answers_have_the_documented_form() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    let document = document();
    for (path, operations) in document["paths"].as_object().unwrap() {
        let endless = path.ends_with("/stream");
        let Some(operation) = operations.get("get").filter(|_| !path.contains('{') && !endless) else {
            continue;
        };
        let answer = server.get(path);
        assert_eq!(answer.status, 200, "{path}");
        let content = operation["responses"]["200"]["content"].as_object().unwrap();
        let (kind, form) = content.iter().next().unwrap();
        assert!(answer.head.contains(&format!("content-type: {kind}")), "{path}: {}", answer.head);
        if kind == "application/json" {
            assert_fits(&document, &form["schema"], &answer.json(), path);
        }
    }
    let status = server.get("/api/v1/status").json();
    assert_eq!(status["state"], "no_device");
    assert!(server.get("/api/v1/protocols").json()["protocols"].as_array().unwrap().len() > 10);
    let metrics = String::from_utf8(server.get("/metrics").body).unwrap();
    assert!(metrics.contains("\ndbbd_running 0\n"), "{metrics}");
}

/// An invalid configuration, the reported position, and the code.
const CONFIGURATIONS: &[(&str, &str, &str)] = &[
    ("adress = \"127.0.0.1:1\"\n", "dbbd.toml:1:1:", "E0120"),
    ("[device]\nport = 7\n", "dbbd.toml:2:8:", "E0120"),
    ("address = \"localhost\"\n", "dbbd.toml:1:11:", "E1501"),
    ("address = \"0.0.0.0:8230\"\n", "dbbd.toml:1:11:", "E1501"),
    ("\n  hosts = [\"http://cell\"]\n", "dbbd.toml:2:12:", "E1501"),
    ("trusted_proxies = [\"proxy\"]\n", "dbbd.toml:1:20:", "E1501"),
    ("token_file = \"none\"\n", "dbbd.toml:1:14:", "E1501"),
    ("[[user]]\nname = \"A\"\nrole = \"plan\"\ntoken_hash = \"00\"\n", "dbbd.toml:1:1:", "E1501"),
    // Two users of one token.
    (
        "[[user]]\nname = \"A\"\nrole = \"plan\"\ntoken_hash = \"0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef\"\n\
         [[user]]\nname = \"B\"\nrole = \"look\"\ntoken_hash = \"0123456789ABCDEF0123456789ABCDEF0123456789ABCDEF0123456789ABCDEF\"\n",
        "dbbd.toml:1:1:",
        "E1501",
    ),
    ("token_file = \"short\"\n", "dbbd.toml:1:14:", "E1501"),
    ("[device]\nprotocol = \"dbb-cobs\"\n", "dbbd.toml:2:12:", "E1501"),
    ("[alarm]\nshare = 1.5\n", "dbbd.toml:2:9:", "E1501"),
    ("[alarm]\nshare = nan\n", "dbbd.toml:2:9:", "E1501"),
    ("[alarm]\nstroke_mm = [1.0, -1.0]\n", "dbbd.toml:2:13:", "E1501"),
];

#[test]
fn configuration_errors_have_line_and_column() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("short"), "too-short\n").unwrap();
    for (text, place, code) in CONFIGURATIONS {
        std::fs::write(dir.path().join("dbbd.toml"), text).unwrap();
        let output = cell::dbbd(dir.path(), &["serve", "--config", "dbbd.toml", "--check"]);
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(cell::stderr(&output).contains(place), "{text}{}", cell::stderr(&output));
        assert_eq!(cell::codes(&output), [*code], "{text}");
    }
    std::fs::write(dir.path().join("dbbd.toml"), "[alarm]\nshare = 0.5\n").unwrap();
    let output = cell::dbbd(dir.path(), &["serve", "--config", "dbbd.toml", "--check"]);
    assert_eq!(output.status.code(), Some(0), "{}", cell::stderr(&output));
}
