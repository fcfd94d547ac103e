//! One request has one answer, whoever asks: the command line, `dbbd request`, the service, a worker of the archive.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::process::{Output, Stdio};

use dbbd_job::request::identify::RequestedPrior;
use dbbd_job::request::{AnswerOutcome, AnswerRecord, AnswerResult, Request, read_answer};
use serde_json::{Value, json};
use tempfile::{TempDir, tempdir};

use crate::cell::{codes, dbbd};
use crate::process;

/// A program with three points that the identified robot reaches.
const PROGRAM: &str = "DEF P( )\n$BASE = {X 0, Y 0, Z 0, A 0, B 0, C 0}\n$TOOL = {X 0, Y 0, Z 100, A 0, B 0, C 0}\n\
    PTP {A1 0, A2 -90, A3 90, A4 0, A5 30, A6 0}\nLIN {X 1300, Y 0, Z 900, A 0, B 90, C 0}\n\
    LIN {X 1300, Y 100, Z 900, A 0, B 90, C 0}\nEND\n";

/// A request of each kind: its command line, its JSON, and its exit code. A later one uses results of an earlier one.
fn requests() -> [(&'static [&'static str], Value, i32); 6] {
    const IDENTIFIED: &str = "identify/robot-identified.toml";
    [
        (
            &["plan", "job.toml", "--out", "plan"],
            json!({ "request": "plan", "job": "job.toml", "out": "plan" }),
            0,
        ),
        (
            &["identify", "run.dbbd", "--prior", "datasheet", "--out", "identify"],
            json!({ "request": "identify", "input": "run.dbbd", "prior": "datasheet", "out": "identify" }),
            3,
        ),
        (
            &["circle", "run.dbbd", "--out", "circle"],
            json!({ "request": "circle", "inputs": ["run.dbbd"], "out": "circle" }),
            3,
        ),
        (
            &["check", "run.dbbd", "--robot", IDENTIFIED, "--tolerance", "1", "--out", "check"],
            json!({
                "request": "check", "input": "run.dbbd", "robot": IDENTIFIED, "tolerance_mm": 1.0,
                "rule": { "guard_band": { "risk": 0.05 } }, "tool_repeat_mm": 0.01, "out": "check",
            }),
            3,
        ),
        (
            &["compensate", "P.src", "--robot", IDENTIFIED, "--limit", "20", "--out", "corrected"],
            json!({
                "request": "compensate", "program": "P.src", "robot": IDENTIFIED, "limit_mm": 20.0,
                "out": "corrected",
            }),
            3,
        ),
        (
            &["certificate", "identify", "--check", "check", "--out", "certificate"],
            json!({
                "request": "certificate", "result": "identify", "check": "check", "out": "certificate",
            }),
            3,
        ),
    ]
}

fn directory() -> TempDir {
    let dir = tempdir().unwrap();
    fs::copy("fixtures/captures/run.dbbd", dir.path().join("run.dbbd")).unwrap();
    let job = include_str!("../../examples/circles.toml").replace("points = 80", "points = 12");
    fs::write(dir.path().join("job.toml"), job).unwrap();
    fs::write(dir.path().join("P.src"), PROGRAM).unwrap();
    dir
}

/// The contents of all files in a directory.
fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    entries
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), fs::read(&path).unwrap()))
        .collect()
}

/// `dbbd request` with this line on its stdin.
fn request(dir: &Path, line: &str) -> Output {
    let mut child = process::dbbd(&["request"]).current_dir(dir).stdin(Stdio::piped()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(format!("{line}\n").as_bytes()).unwrap();
    child.wait_with_output().unwrap()
}

fn answer(output: &Output) -> AnswerRecord {
    read_answer(&String::from_utf8_lossy(&output.stdout)).unwrap()
}

fn found(answer: &AnswerRecord) -> Vec<&str> {
    answer.findings.iter().map(|finding| finding.code.as_str()).collect()
}

#[test]
fn a_request_of_each_kind_is_answered_as_by_its_command() {
    let (by_command, by_request) = (directory(), directory());
    for (args, requested, code) in requests() {
        let printed = dbbd(by_command.path(), &[args, &["--json"]].concat());
        let answered = request(by_request.path(), &requested.to_string());
        assert_eq!([printed.status.code(), answered.status.code()], [Some(code); 2], "{requested}");
        let out = requested["out"].as_str().unwrap();
        let [wanted, written] = [&by_command, &by_request].map(|dir| files(&dir.path().join(out)));
        assert_eq!(wanted, written, "{requested}");
        let answer = answer(&answered);
        assert_eq!(found(&answer), codes(&printed), "{requested}");
        let AnswerResult::Result(result) = answer.result else { panic!("{requested} is refused") };
        assert_eq!(result.outcome == AnswerOutcome::Done, code == 0, "{requested}");
        let mut names = result.files;
        names.sort();
        assert!(names.iter().eq(written.keys()), "{requested}");
        // What `--json` prints is the document, with the findings that were reported before it.
        let printed: Value = serde_json::from_slice(&printed.stdout).unwrap();
        let [printed, document] = [printed, result.document].map(|mut document| {
            document.as_object_mut().unwrap().remove("findings");
            document
        });
        assert_eq!(printed, document, "{requested}");
    }
}

#[test]
fn a_request_is_read_as_it_is_written() {
    for (_, requested, _) in requests() {
        let read: Request = serde_json::from_value(requested).unwrap();
        let written = serde_json::to_string(&read).unwrap();
        assert_eq!(serde_json::from_str::<Request>(&written).unwrap(), read, "{written}");
    }
}

#[test]
fn a_refusal_carries_its_code_its_place_and_its_values() {
    let dir = directory();
    fs::write(dir.path().join("job.toml"), "[[circle]]\n").unwrap();
    let (args, requested, _) = &requests()[0];
    let [printed, answered] = [dbbd(dir.path(), args), request(dir.path(), &requested.to_string())];
    assert_eq!([printed.status.code(), answered.status.code()], [Some(1); 2]);
    let AnswerResult::Refusal(refusal) = answer(&answered).result else { panic!("it is not refused") };
    assert_eq!((vec![refusal.code], refusal.file.as_str()), (codes(&printed), "job.toml"));
    // Something else than a request.
    for line in ["", "{}", "{\"request\":\"identify\",\"input\":\"a\",\"out\":\"b\",\"holt\":\"c\"}"] {
        let output = request(dir.path(), line);
        assert_eq!((output.status.code(), codes(&output)), (Some(1), vec!["E0004".to_owned()]), "{line}");
    }
}

#[test]
fn openapi_describes_the_request_of_a_job() {
    use dbbd::live::{JobKind, JobRequest, OPENAPI};

    let request = JobRequest {
        kind: JobKind::Identify,
        run: "a".into(),
        prior: Some("datasheet".into()),
        estimate: Some("a1-5".into()),
        hold: Some("d4".into()),
    };
    let document: Value = serde_json::from_str(OPENAPI).unwrap();
    let path = "/paths/~1api~1v1~1jobs/post/requestBody/content/application~1json/schema/oneOf";
    let schemas = document.pointer(path).unwrap();
    let properties = schemas[0]["properties"].as_object().unwrap();
    let written = serde_json::to_value(&request).unwrap();
    assert!(properties.keys().eq(written.as_object().unwrap().keys()), "{properties:?}");
    let other_kinds = schemas[1]["properties"]["kind"]["enum"].as_array().unwrap();
    let kinds = other_kinds.iter().chain([&properties["kind"]["const"]]).collect::<Vec<_>>();
    let served = JobKind::ALL.map(|kind| serde_json::to_value(kind).unwrap());
    assert!(served.iter().all(|kind| kinds.contains(&kind)) && kinds.len() == served.len(), "{kinds:?}");
    let priors = [RequestedPrior::None, RequestedPrior::Datasheet, RequestedPrior::Posterior].map(Some);
    let documented: [Option<RequestedPrior>; 4] =
        serde_json::from_value(properties["prior"]["enum"].clone()).unwrap();
    assert!(documented.iter().eq(priors.iter().chain([&None])), "{documented:?}");
}

#[cfg(unix)]
#[test]
fn the_service_gives_the_files_of_the_command() {
    let (by_command, by_service) = (directory(), tempdir().unwrap());
    let run = by_service.path().join("dbbd-runs/a");
    fs::create_dir_all(&run).unwrap();
    fs::copy("fixtures/captures/run.dbbd", run.join("run.dbbd")).unwrap();
    let server = crate::service::Server::start(by_service.path(), "");
    for (kind, settings) in [("identify", ",\"prior\":\"datasheet\""), ("circle", "")] {
        let (args, ..) =
            requests().into_iter().find(|(args, ..)| args[0] == kind).expect("a request of the kind");
        assert_eq!(dbbd(by_command.path(), args).status.code(), Some(3));
        let job = server.post("/api/v1/jobs", &format!("{{\"kind\":\"{kind}\",\"run\":\"a\"{settings}}}"));
        assert_eq!(job.status, 202, "{job:?}");
        let path = format!("/api/v1/jobs/{}", job.json()["id"]);
        let job = server.wait(&path, |job| job["state"] != "waiting" && job["state"] != "running");
        assert_eq!((&job["state"], &job["percent"]), (&"warned".into(), &100.into()), "{job}");
        let [wanted, written] = [by_command.path().join(kind), run.join(kind)].map(|dir| files(&dir));
        assert_eq!(wanted, written, "{kind}");
    }
}

#[cfg(feature = "archive")]
#[test]
fn a_worker_of_the_archive_stores_the_files_of_the_command() {
    use crate::archive::archive;
    use dbbd_model::base::hash::sha256;

    let (by_command, plant) = (directory(), tempdir().unwrap());
    let at = plant.path();
    fs::create_dir_all(at.join("runs/a")).unwrap();
    fs::copy("fixtures/captures/run.dbbd", at.join("runs/a/run.dbbd")).unwrap();
    for args in [&["init"][..], &["push", "runs"], &["worker", "--until-empty"]] {
        let output = archive(at, args);
        assert!(matches!(output.status.code(), Some(0 | 3)), "{args:?}: {}", crate::cell::stderr(&output));
    }
    // The settings of every new run.
    let settings = ["identify", "run.dbbd", "--model=geometric", "--prior=datasheet", "--out", "result"];
    assert_eq!(dbbd(by_command.path(), &settings).status.code(), Some(3));
    let written = files(&by_command.path().join("result"));
    for name in ["result.json", "report.html", "robot-identified.toml", "lengths.csv"] {
        let hash = sha256(&written[name]);
        assert!(at.join("objects/objects").join(&hash[..2]).join(&hash).is_file(), "{name}");
    }
}
