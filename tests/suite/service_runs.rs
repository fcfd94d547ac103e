//! Runs of the service: start, remarks and stop over HTTP, with clients that disconnect and processes that are killed.
#![cfg(unix)]

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;

use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::recording::capture::{self, RunEvent};
use dbbd_job::sim::bar::{self, SimulatedReading, Terminal, VirtualBarOptions};

use crate::cell;
use crate::process::Simulator;
use crate::service::Server;

/// A bar that swings over its stroke of 1 mm, with a dwell of half a second in each second.
pub(crate) fn swinging() -> String {
    let terminal = Terminal::new().unwrap();
    let name = terminal.address().to_string();
    let definition = ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap();
    let options = VirtualBarOptions { rate_hz: 1000.0, speed: 1.0, first_ticks: 0 };
    let source = |t_s: f64| {
        let (reading_mm, strobe) = (1.05 * (3.0 * t_s).sin(), (0.2..0.7).contains(&t_s.fract()));
        (t_s < 600.0).then_some(SimulatedReading { reading_mm, strobe, valid: true, temperature_c: 20.0 })
    };
    std::thread::spawn(move || bar::serve_bar(terminal, &definition, options, source));
    name
}

/// The events of the stream until `wanted` are complete: names and contents.
fn hear(server: &Server, wanted: &[&str]) -> Vec<(String, serde_json::Value)> {
    let mut stream = server.connect();
    stream.write_all(b"GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\n\r\n").unwrap();
    let (mut name, mut events) = (String::new(), Vec::new());
    for line in BufReader::new(stream).lines().map(Result::unwrap) {
        if let Some(event) = line.strip_prefix("event: ") {
            name = event.to_owned();
        } else if let Some(data) = line.strip_prefix("data: ") {
            events.push((name.clone(), serde_json::from_str(data).unwrap()));
            let came = |wanted: &&str| events.iter().any(|(name, _): &(String, _)| name == wanted);
            if wanted.iter().all(came) {
                break;
            }
        }
    }
    events
}

#[test]
fn runs_start_and_stop_with_any_number_of_clients() {
    let dir = tempfile::tempdir().unwrap();
    let port = swinging();
    let config = format!("[device]\nport = \"{port}\"\n[alarm]\nstroke_mm = [-1.0, 1.0]\n");
    let mut server = Server::start(dir.path(), &config);
    server.wait("/api/v1/status", |status| status["state"] == "idle");
    assert_eq!(server.post("/api/v1/run/stop", "").status, 409);
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"first\"}").status, 201);
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"second\"}").status, 409, "one at a time");
    // A client disconnects in the middle of the stream.
    let events = hear(&server, &["status", "points", "frame", "point"]);
    let all = |wanted: &str| {
        events.iter().filter(|(name, _)| name == wanted).map(|(_, data)| data.clone()).collect::<Vec<_>>()
    };
    for frame in all("frame") {
        let [least, most, last] = ["min_mm", "max_mm", "last_mm"].map(|key| frame[key].as_f64().unwrap());
        assert!(least <= last && last <= most && most - least < 1.0, "{frame}");
        assert!(frame["samples"].as_u64().unwrap() > 10, "{frame}");
    }
    assert_eq!(all("point")[0]["dwell"], 1);
    let mut broken = server.connect();
    broken.write_all(b"POST /api/v1/run/stop HTTP/1.1\r\nHost: loc").unwrap();
    drop(broken);
    assert_eq!(server.post("/api/v1/run/mark", "{\"text\":\"bar \\u00e4 mounted\"}").status, 202);
    assert_eq!(server.post("/api/v1/run/mark", "{\"text\":\" \"}").status, 422);
    let sync = "{\"kind\":\"sync\",\"run\":\"first\"}";
    assert_eq!(server.post("/api/v1/jobs", sync).status, 409, "its run is on");
    let status = server.wait("/api/v1/status", |status| status["run"]["dwells"].as_u64() >= Some(2));
    assert_eq!(status["state"], "running");
    let other = "{\"protocol\":\"dbb-csv-1\"}";
    assert_eq!(server.ask("PUT", "/api/v1/device", "Content-Type: application/json\r\n", other).status, 409);
    assert_eq!(server.get("/api/v1/runs/first").json()["state"], "running");
    assert_eq!(server.post("/api/v1/run/stop", "").status, 202);
    let status = server.wait("/api/v1/status", |status| status["state"] == "idle");
    assert_eq!(status["last"]["ending"], "stopped");

    let file = dir.path().join("dbbd-runs/first/run.dbbd");
    let bytes = fs::read(&file).unwrap();
    assert_eq!(server.get("/api/v1/runs/first/capture").body, bytes);
    let recorded = capture::read_capture(&bytes);
    assert!(recorded.ended() && recorded.damages.is_empty());
    assert!(
        recorded.events().any(|event| matches!(event, RunEvent::Mark { text } if text == "bar ä mounted"))
    );
    let missing = recorded.events().filter(|event| matches!(event, RunEvent::Gap { .. })).count();
    assert_eq!(missing, 0);
    assert_eq!(server.get("/api/v1/points").json()["points"][0]["dwell"], 1);
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"first\"}").status, 409, "a name is never used twice");

    // SIGTERM completes the run.
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"second\"}").status, 201);
    server.wait("/api/v1/status", |status| status["run"]["samples"].as_u64() > Some(100));
    assert_eq!(server.signal("TERM"), Some(0));
    assert!(capture::read_capture(&fs::read(dir.path().join("dbbd-runs/second/run.dbbd")).unwrap()).ended());
}

/// The actions on the page before and during the run.
fn operator(recorded: &capture::Capture) -> Vec<String> {
    let acts = recorded.events().filter_map(|event| match event {
        RunEvent::Operator { action, detail, .. } => Some(format!("{action} {detail}").trim_end().to_owned()),
        _ => None,
    });
    acts.collect()
}

/// A bar that reads 1.5 mm, with a protocol that has a zero command.
fn resting(name: &str) -> String {
    let terminal = Terminal::new().unwrap();
    let port = terminal.address().to_string();
    let definition = ProtocolDefinition::by_name(name).unwrap().unwrap();
    let options = VirtualBarOptions { rate_hz: 50.0, speed: 1.0, first_ticks: 0 };
    let source = |t_s: f64| {
        (t_s < 600.0).then_some(SimulatedReading {
            reading_mm: 1.5,
            strobe: false,
            valid: true,
            temperature_c: 20.0,
        })
    };
    std::thread::spawn(move || bar::serve_bar(terminal, &definition, options, source));
    port
}

/// A simulated cell in place of the service's own bar: its bar speaks the protocol of its plan, and its run is simulated.
#[test]
fn a_simulated_cell_has_a_bar_of_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    plan(at);
    let port = resting("usdigital-qsb");
    let config = format!("[device]\nport = \"{port}\"\nprotocol = \"usdigital-qsb\"\n");
    let server = Server::start(at, &config);
    server.wait("/api/v1/status", |status| status["state"] == "idle");
    let start = "{\"name\":\"demo\",\"plan\":\"plan\",\"speed\":50}";
    assert_eq!(server.post("/api/v1/run", start).status, 201);
    server.wait("/api/v1/status", |status| status["run"]["samples"].as_u64() > Some(100));
    assert_eq!(server.post("/api/v1/run/stop", "").status, 202);
    server.wait("/api/v1/status", |status| status["run"].is_null());
    let info = cell::dbbd(at, &["info", "dbbd-runs/demo/run.dbbd", "--json"]);
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info["origin"], "simulated", "{info}");
}

#[test]
fn operator_actions_before_a_run_are_in_its_capture() {
    let dir = tempfile::tempdir().unwrap();
    let port = resting("usdigital-qsb");
    let config = format!(
        "[device]\nport = \"{port}\"\nprotocol = \"usdigital-qsb\"\n[alarm]\nstroke_mm = [-5.0, 5.0]\n"
    );
    let server = Server::start(dir.path(), &config);
    server.wait("/api/v1/status", |status| status["state"] == "idle");
    let refused = server.post("/api/v1/reading/zero", "");
    assert_eq!((refused.status, refused.json()["code"].as_str()), (409, Some(NOT_ZEROED)), "it is not read");
    assert_eq!(server.post("/api/v1/reading", "{\"plan\":\"none\"}").status, 404);
    assert_eq!(server.post("/api/v1/reading", "{}").status, 202);
    let status = server.wait("/api/v1/status", |status| status["reading"]["mounting"]["state"] == "stable");
    assert_eq!((&status["run"], &status["state"]), (&serde_json::Value::Null, &"idle".into()));
    assert_eq!(status["reading"]["can_zero"], true);
    assert_eq!(server.post("/api/v1/run/stop", "").status, 409, "a reading is no run");
    assert_eq!(server.post("/api/v1/reading/zero", "").status, 202);
    let near_zero = |status: &serde_json::Value| {
        status["reading"]["reading_mm"].as_f64().is_some_and(|mm| mm.abs() < 0.01)
    };
    server.wait("/api/v1/status", near_zero);
    assert_eq!(server.post("/api/v1/act", "{\"act\":\"sound_off\"}").status, 202);
    assert_eq!(server.post("/api/v1/act", "{\"act\":\"sound\"}").status, 422);
    let start = "{\"name\":\"first\",\"checked\":[\"ball_clean\",\"t1\"]}";
    assert_eq!(server.post("/api/v1/run", start).status, 201, "the reading gives way");
    let status = server.wait("/api/v1/status", |status| status["run"]["samples"].as_u64() > Some(20));
    assert_eq!(status["reading"], serde_json::Value::Null);
    assert_eq!(server.post("/api/v1/reading", "{}").status, 409);
    assert_eq!(server.post("/api/v1/run/stop", "").status, 202);
    server.wait("/api/v1/status", |status| status["run"].is_null());
    let recorded = capture::read_capture(&fs::read(dir.path().join("dbbd-runs/first/run.dbbd")).unwrap());
    assert!(recorded.ended() && recorded.damages.is_empty());
    let acts = operator(&recorded);
    assert_eq!(acts.len(), 6, "{acts:?}");
    assert_eq!(acts[0], "connect");
    assert!(acts[1].starts_with("zero ") && acts[1].ends_with(" mm before"), "{acts:?}");
    assert_eq!(acts[2..], ["sound_off", "checked ball_clean t1", "start first", "stop"]);
    // The bar is read again after the run. The next run has only the later actions.
    assert_eq!(server.post("/api/v1/reading", "{}").status, 202);
    assert_eq!(server.ask("DELETE", "/api/v1/reading", "", "").status, 202);
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"second\"}").status, 201);
    server.wait("/api/v1/status", |status| status["run"]["samples"].as_u64() > Some(20));
    assert_eq!(server.post("/api/v1/run/stop", "").status, 202);
    server.wait("/api/v1/status", |status| status["run"].is_null());
    let recorded = capture::read_capture(&fs::read(dir.path().join("dbbd-runs/second/run.dbbd")).unwrap());
    assert_eq!(operator(&recorded), ["connect", "disconnect", "checked", "start second", "stop"]);
}

/// Recording continues in a new file, and the run counts as failed.
#[test]
fn a_run_with_a_removed_capture_fails() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), &format!("[device]\nport = \"{}\"\n", swinging()));
    server.wait("/api/v1/status", |status| status["state"] == "idle");
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"first\"}").status, 201);
    let status = server.wait("/api/v1/status", |status| status["run"]["samples"].as_u64() > Some(100));
    let before = status["run"]["samples"].as_u64().unwrap();
    fs::remove_dir_all(dir.path().join("dbbd-runs/first")).unwrap();
    server.wait("/api/v1/status", |status| status["run"]["samples"].as_u64() > Some(before + 1500));
    assert_eq!(server.post("/api/v1/run/stop", "").status, 202);
    let status = server.wait("/api/v1/status", |status| status["run"].is_null());
    assert_eq!((&status["state"], &status["code"]), (&"failed".into(), &"W0415".into()), "{status}");
    assert_eq!(status["last"]["failed"], true);
    let recorded = capture::read_capture(&fs::read(dir.path().join("dbbd-runs/first/run.dbbd")).unwrap());
    assert!(recorded.ended() && recorded.damages.is_empty() && recorded.samples().count() > 1500);
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"second\"}").status, 201, "a new run may begin");
    assert_eq!(server.post("/api/v1/run/mark", "{\"text\":\"a\\u001b[2Jb\"}").status, 422);
}

#[test]
fn a_missing_device_does_not_end_the_service() {
    let dir = tempfile::tempdir().unwrap();
    let link = dir.path().join("bar");
    let server = Server::start(dir.path(), "data = \"file\"\n[device]\nport = \"bar\"\n");
    let status = server.get("/api/v1/status").json();
    assert_eq!((&status["state"], &status["device"]["present"]), (&"no_device".into(), &false.into()));
    let refused = server.post("/api/v1/run", "{\"name\":\"a\"}");
    assert_eq!(refused.status, 409);
    assert_eq!(refused.json()["code"], "E0201", "{}", refused.json());
    // A run that could not begin leaves its name free.
    assert!(!dir.path().join("file/a").exists());
    std::os::unix::fs::symlink(swinging(), &link).unwrap();
    server.wait("/api/v1/status", |status| status["state"] == "idle");
    // A data directory that cannot be created is an error as well.
    fs::remove_dir_all(dir.path().join("file")).unwrap();
    fs::write(dir.path().join("file"), "in the way").unwrap();
    let refused = server.post("/api/v1/run", "{\"name\":\"a\"}");
    assert_eq!(refused.status, 409);
    assert_eq!(refused.json()["code"], "E1504", "{}", refused.json());
    fs::remove_file(dir.path().join("file")).unwrap();
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"a\"}").status, 201);
}

/// The demo's plan with few points, and its programs.
fn plan(dir: &Path) {
    let job = include_str!("../../examples/circles.toml").replace("points = 80", "points = 12");
    fs::write(dir.join("job.toml"), job).unwrap();
    for args in [["plan", "job.toml", "--out", "plan"], ["krl", "plan/plan.csv", "--out", "krl"]] {
        let output = cell::dbbd(dir, &args);
        assert_eq!(output.status.code(), Some(0), "{}", cell::stderr(&output));
    }
}

#[test]
fn a_killed_run_is_listed_and_can_be_identified() {
    let dir = tempfile::tempdir().unwrap();
    plan(dir.path());
    // An older plan whose name sorts first.
    fs::create_dir(dir.path().join("again")).unwrap();
    for name in ["plan.csv", "plan.json"] {
        fs::copy(dir.path().join("plan").join(name), dir.path().join("again").join(name)).unwrap();
    }
    let old = fs::File::options().write(true).open(dir.path().join("again/plan.csv")).unwrap();
    old.set_modified(std::time::UNIX_EPOCH).unwrap();
    let program = ["--program", "krl/DBB_MAIN.src", "--speed", "60", "--link", "bar"];
    let _simulator = Simulator::start(dir.path(), &program);
    let config = "[device]\nport = \"bar\"\n";
    let mut server = Server::start(dir.path(), config);
    let plans = server.get("/api/v1/plans").json();
    let names: Vec<_> =
        plans["plans"].as_array().unwrap().iter().map(|plan| plan["name"].as_str().unwrap()).collect();
    assert_eq!((names, &plans["plans"][0]["error"]), (vec!["plan", "again"], &serde_json::Value::Null));
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"killed\",\"plan\":\"plan\"}").status, 201);
    server.wait("/api/v1/status", |status| status["run"]["dwells"].as_u64() >= Some(20));
    let points = server.get("/api/v1/points").json();
    let point = &points["points"][3];
    assert!(point["deviation_mm"].as_f64().unwrap().abs() < 1.0 && point["angle_deg"].is_number(), "{point}");
    server.signal("KILL");

    let server = Server::start(dir.path(), config);
    let run = server.get("/api/v1/runs").json()["runs"][0].clone();
    assert_eq!((&run["name"], &run["state"]), (&"killed".into(), &"ended_early".into()));
    let job =
        server.post("/api/v1/jobs", "{\"kind\":\"identify\",\"run\":\"killed\",\"prior\":\"datasheet\"}");
    assert_eq!(job.status, 202, "{job:?}");
    let path = format!("/api/v1/jobs/{}", job.json()["id"]);
    let job = server.wait(&path, |job| job["state"] != "waiting" && job["state"] != "running");
    assert_eq!(job["state"], "warned", "a run that was cut off has a warning: {job}");
    let report = server.get("/api/v1/runs/killed/identify/report.html");
    assert_eq!(report.status, 200);
    for part in ["default-src 'none'; script-src 'sha256-", "; sandbox allow-scripts; "] {
        assert!(report.head.contains(part), "{}", report.head);
    }
    assert_eq!(report.body, fs::read(dir.path().join("dbbd-runs/killed/identify/report.html")).unwrap());
    // Errors are reported.
    let job =
        server.post("/api/v1/jobs", "{\"kind\":\"identify\",\"run\":\"killed\",\"estimate\":\"nonsense\"}");
    let path = format!("/api/v1/jobs/{}", job.json()["id"]);
    let job = server.wait(&path, |job| job["state"] == "failed");
    assert!(job["log"].to_string().contains("nonsense"), "{job}");
    assert_eq!(server.get("/api/v1/jobs/99").status, 404);
}

#[test]
fn the_simulated_cell_needs_no_files() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "[device]\nport = \"sim\"\n");
    server.wait("/api/v1/status", |status| status["device"]["present"] == true);
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"tried\"}").status, 201);
    let status = server.wait("/api/v1/status", |status| status["run"]["samples"].as_u64() > Some(50));
    assert_eq!((&status["run"]["poses"], &status["run"]["stroke_mm"][1]), (&252.into(), &5.0.into()));
    assert_eq!(server.post("/api/v1/run/stop", "").status, 202);
    server.wait("/api/v1/status", |status| status["last"]["name"] == "tried");
}

/// The codes of missing system resources: the address is in use, the directory cannot be created.
const COMPUTER: [&str; 2] = ["E1502", "E1507"];
/// The code for a bar that cannot be set to zero.
const NOT_ZEROED: &str = "E1520";

#[test]
fn missing_system_resources_have_a_code() {
    let dir = tempfile::tempdir().unwrap();
    let [taken, unreadable] = COMPUTER;
    let server = Server::start(dir.path(), "data = \"runs\"\n");
    let second = tempfile::tempdir().unwrap();
    std::fs::write(second.path().join("dbbd.toml"), format!("address = \"{}\"\n", server.address)).unwrap();
    let output = cell::dbbd(second.path(), &["serve", "--config", "dbbd.toml"]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(cell::codes(&output), [taken]);
    let _ = std::fs::remove_dir_all(dir.path().join("runs"));
    std::fs::write(dir.path().join("runs"), "no directory").unwrap();
    let answer = server.get("/api/v1/runs");
    assert_eq!((answer.status, answer.json()["code"].as_str()), (500, Some(unreadable)));
}
