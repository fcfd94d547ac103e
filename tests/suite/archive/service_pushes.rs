//! `dbbd serve` pushes its runs to the archive.

use std::fs;
use std::path::Path;

use serde_json::Value;
use tempfile::tempdir;

use super::archive;
use crate::cell::{codes, dbbd};
use crate::service::Server;
use crate::service_runs::swinging;

const CONFIG: &str = "[archive]\ndatabase = \"sqlite:plant.db\"\nstore = \"file:objects\"\nretry_s = 0.2\n";

fn config() -> String {
    format!("[device]\nport = \"{}\"\n[alarm]\nstroke_mm = [-1.0, 1.0]\n{CONFIG}", swinging())
}

fn begin(server: &Server, name: &str) {
    server.wait("/api/v1/status", |status| status["state"] == "idle");
    assert_eq!(server.post("/api/v1/run", &format!("{{\"name\":\"{name}\"}}")).status, 201);
    server.wait("/api/v1/status", |status| status["run"]["samples"].as_u64() > Some(50));
}

fn waiting(server: &Server, runs: u64) -> Value {
    server.wait("/api/v1/status", |status| status["archive"]["waiting"] == runs)
}

fn held(dir: &Path) -> Vec<(String, u64)> {
    let output = archive(dir, &["list", "--json"]);
    let listed: Vec<Value> = serde_json::from_slice(&output.stdout).unwrap();
    let text = |run: &Value| (run["sha256"].as_str().unwrap().to_owned(), run["bytes"].as_u64().unwrap());
    listed.iter().map(text).collect()
}

#[test]
fn the_service_pushes_its_runs() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    let config = config();
    let mut server = Server::start(at, &config);
    begin(&server, "first");
    assert_eq!(server.post("/api/v1/run/stop", "").status, 202);
    // There is no archive yet: the run waits in the spool, even if the recorded run is deleted.
    let status = waiting(&server, 1);
    assert!(status["archive"]["reason"].as_str().unwrap().contains("W2412"), "{status}");
    assert_eq!((&status["archive"]["confirmed"], &status["archive"]["refused"]), (&0.into(), &0.into()));
    let capture = fs::read(at.join("dbbd-runs/first/run.dbbd")).unwrap();
    fs::remove_dir_all(at.join("dbbd-runs/first")).unwrap();
    assert_eq!(archive(at, &["init"]).status.code(), Some(0));
    let status = waiting(&server, 0);
    assert_eq!((&status["archive"]["confirmed"], &status["archive"]["refused"]), (&1.into(), &0.into()));
    let first = held(at);
    assert_eq!(first.len(), 1);
    assert_eq!(archive(at, &["get", &first[0].0, "--out", "back"]).status.code(), Some(0));
    assert_eq!(fs::read(at.join("back/run.dbbd")).unwrap(), capture);
    // A run in progress is not pushed. A killed run is pushed once by the next service.
    begin(&server, "second");
    assert_eq!(held(at).len(), 1);
    server.child.kill().unwrap();
    server.child.wait().unwrap();
    for _ in 0..2 {
        let server = Server::start(at, &config);
        waiting(&server, 0);
        let bytes = fs::metadata(at.join("dbbd-runs/second/run.dbbd")).unwrap().len();
        let held = held(at);
        assert_eq!((held.len(), held.iter().filter(|run| run.1 == bytes).count()), (2, 1));
        assert!(at.join("dbbd-runs/second/run.dbbd").is_file(), "what is local stays");
    }
    // Later results are pushed as well.
    fs::create_dir(at.join("dbbd-runs/second/identify")).unwrap();
    fs::write(at.join("dbbd-runs/second/identify/result.json"), "{}").unwrap();
    let server = Server::start(at, &config);
    waiting(&server, 0);
    let second = held(at).into_iter().find(|run| run.0 != first[0].0).unwrap();
    assert_eq!(archive(at, &["get", &second.0, "--out", "later"]).status.code(), Some(0));
    assert_eq!(fs::read(at.join("later/identify/result.json")).unwrap(), b"{}");
    drop(server);
}

#[test]
fn an_invalid_archive_configuration_is_refused() {
    let dir = tempdir().unwrap();
    for (table, code) in [
        ("database = \"mysql:x\"\nstore = \"file:o\"", "E2402"),
        ("database = \"postgres://cell:secret@db/x\"\nstore = \"file:o\"", "E2403"),
    ] {
        fs::write(dir.path().join("dbbd.toml"), format!("[archive]\n{table}\n")).unwrap();
        let output = dbbd(dir.path(), &["serve", "--config", "dbbd.toml", "--check"]);
        assert_eq!((output.status.code(), codes(&output)), (Some(1), vec![code.to_owned()]), "{table}");
    }
}
