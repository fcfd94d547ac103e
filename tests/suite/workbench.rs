//! The work on a robot over HTTP: what a step makes is what the command line makes; nothing leaves the working directory.
#![cfg(unix)]

use std::fs;
use std::io::Write as _;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::{Value, json};

use crate::months::calibrated_on;
use crate::service::{Answer, Server};

const JOB: &str = "# by hand\nrobot = \"kr60ha\" # ours\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = 300.0\nstroke_mm = [-5.0, 5.0]\nmargin_mm = 0.5\n\
    [[centre]]\nid = 1\nxyz_mm = [1300.0, 0.0, 800.0]\n[[circle]]\nplane = \"XY\"\npoints = 12\namplitude_deg = 25.0\ntilt_deg = 30.0\n";

fn put(server: &Server, path: &str, body: &Value) -> Answer {
    server.ask("PUT", path, "Content-Type: application/json\r\n", &body.to_string())
}

fn step<'a>(work: &'a Value, name: &str) -> &'a Value {
    work["steps"].as_array().unwrap().iter().find(|step| step["step"] == name).unwrap()
}

/// Computes a step and waits for its end.
fn compute(server: &Server, robot: &str, name: &str) -> Value {
    let answer = server.post(&format!("/api/v1/workbench/{robot}/steps/{name}"), "{}");
    assert_eq!(answer.status, 202, "{answer:?}");
    let id = answer.json()["id"].clone();
    let over = |job: &Value| !["waiting", "running"].contains(&job["state"].as_str().unwrap());
    server.wait(&format!("/api/v1/jobs/{id}"), over)
}

/// Saves keys of a job that was read just before.
fn edit(server: &Server, robot: &str, keys: &Value) -> Answer {
    let path = format!("/api/v1/workbench/{robot}/job");
    let sha256 = server.get(&path).json()["sha256"].clone();
    put(server, &path, &json!({ "sha256": sha256, "keys": keys }))
}

fn dbbd(directory: &Path, command: &str) {
    let args = command.strip_prefix("dbbd ").unwrap().split(' ');
    let run = Command::new(env!("CARGO_BIN_EXE_dbbd")).args(args).current_dir(directory).output().unwrap();
    assert!(matches!(run.status.code(), Some(0 | 3)), "{run:?}");
}

#[test]
fn a_step_makes_the_files_of_the_command_beside_it() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    assert_eq!(server.get("/api/v1/workbench").json(), json!({ "robots": [] }));
    // The command line begins, the page goes on.
    let cell = dir.path().join("cell-1");
    fs::create_dir(&cell).unwrap();
    fs::write(cell.join("job.toml"), JOB).unwrap();
    let work = server.get("/api/v1/workbench/cell-1").json();
    let plan = step(&work, "plan");
    assert_eq!((plan["state"].as_str(), plan["action"].as_str()), (Some("ready"), Some("compute")));
    let command = plan["command"].as_str().unwrap().to_owned();
    let job = compute(&server, "cell-1", "plan");
    assert!(["done", "warned"].contains(&job["state"].as_str().unwrap()), "{job}");
    let twin = dir.path().join("twin");
    fs::create_dir(&twin).unwrap();
    fs::write(twin.join("job.toml"), JOB).unwrap();
    dbbd(&twin, &command);
    for file in ["plan.csv", "plan.json", "plan.html", "centres.csv"] {
        let [one, other] = [&cell, &twin].map(|at| fs::read(at.join("plan").join(file)).unwrap());
        assert!(one == other, "{file} differs");
    }
    // And the other way round: programs by the command line.
    let work = server.get("/api/v1/workbench/cell-1").json();
    assert_eq!(step(&work, "plan")["state"], "done");
    dbbd(&cell, step(&work, "programs")["command"].as_str().unwrap());
    let work = server.get("/api/v1/workbench/cell-1").json();
    assert_eq!(
        (&step(&work, "programs")["state"], &step(&work, "measure")["state"]),
        (&"done".into(), &"ready".into())
    );
    assert_eq!(step(&work, "measure")["plan"], "cell-1/plan");
    let listed = server.get("/api/v1/plans").json();
    assert!(listed["plans"].as_array().unwrap().iter().any(|plan| plan["name"] == "cell-1/plan"), "{listed}");
    let scene = server.get("/api/v1/workbench/cell-1/scene").json();
    // The tool ball of a drawn pose is where the plan has it, to the tenth that is drawn.
    let first = fs::read_to_string(cell.join("plan/plan.csv")).unwrap();
    let row: Vec<f64> =
        first.lines().nth(1).unwrap().split(',').filter_map(|cell| cell.parse().ok()).collect();
    let ball = scene["path"][0]["arm"].as_array().unwrap().last().unwrap().clone();
    for axis in 0..3 {
        // index, circle, centre, then x, y, z: kind and move are words.
        assert!((ball[axis].as_f64().unwrap() - row[3 + axis]).abs() < 0.06, "{ball} {row:?}");
    }
    // An edit of the job asks for a new plan, and keeps what was written by hand.
    let edited = edit(&server, "cell-1", &json!({ "circle": [{ "row": 0, "points": 16 }] }));
    assert_eq!(edited.status, 204, "{edited:?}");
    assert_eq!(fs::read_to_string(cell.join("job.toml")).unwrap(), JOB.replace("points = 12", "points = 16"));
    let work = server.get("/api/v1/workbench/cell-1").json();
    assert_eq!(
        (&step(&work, "plan")["state"], &step(&work, "plan")["text"]),
        (&"ready".into(), &"plan.stale".into())
    );
}

#[test]
fn a_calibration_that_is_over_is_renewed() {
    let dir = tempfile::tempdir().unwrap();
    let cell = dir.path().join("cell-1");
    fs::create_dir(&cell).unwrap();
    calibrated_on(&cell, "2020-02-29");
    let server = Server::start(dir.path(), "");
    let work = || server.get("/api/v1/workbench/cell-1").json();
    let (plan, result) = (step(&work(), "plan").clone(), step(&work(), "result").clone());
    assert_eq!((&plan["text"], &result["text"]), (&"plan.over".into(), &"result.over".into()));
    assert_eq!((&plan["state"], &result["verdict"]), (&"ready".into(), &"undecided".into()));
    assert_eq!(plan["values"]["until"], result["values"]["until"]);
    let command = "dbbd plan job.toml --renew --robot first/robot-identified.toml --out renewal-plan";
    assert_eq!(plan["command"], command);
    assert_eq!(server.get("/api/v1/workbench").json()["robots"][0]["text"], "result.over");
    let job = compute(&server, "cell-1", "plan");
    assert!(["done", "warned"].contains(&job["state"].as_str().unwrap()), "{job}");
    let planned = work();
    assert_eq!(step(&planned, "plan")["text"], "plan.found");
    assert!((20..40).contains(&step(&planned, "plan")["values"]["poses"].as_u64().unwrap()), "{planned}");
    compute(&server, "cell-1", "programs");
    assert_eq!(step(&work(), "measure")["state"], "ready");
    assert!(cell.join("renewal-program/DBB_MAIN.src").is_file());
    // Its run would continue the posterior of the calibration.
    let renewal = fs::read_to_string(cell.join("renewal-plan/plan.json")).unwrap();
    assert!(renewal.contains("posterior"));
}

#[test]
fn what_the_demo_of_the_command_line_left_is_shown_to_its_end() {
    let dir = tempfile::tempdir().unwrap();
    dbbd(dir.path(), "dbbd --quiet demo --circles --out shown");
    let server = Server::start(dir.path(), "");
    let work = server.get("/api/v1/workbench/shown").json();
    assert_eq!(work["simulated"], true);
    for name in ["robot", "cell", "plan", "programs", "measure", "result"] {
        assert_eq!(step(&work, name)["state"], "done", "{name}");
    }
    let result: Value =
        serde_json::from_str(&fs::read_to_string(dir.path().join("shown/result/result.json")).unwrap())
            .unwrap();
    let shown = &step(&work, "result")["values"]["headline"];
    assert_eq!(
        (&shown["u_mm"], &shown["k"]),
        (&result["budget"]["expanded_mm"], &result["budget"]["coverage_factor"])
    );
    // The arrows of the scene are the residuals of the result.
    let scene = server.get("/api/v1/workbench/shown/scene").json();
    let residuals =
        scene["residuals"].as_array().unwrap().iter().map(|one| one["residual_mm"].as_f64().unwrap());
    let (count, squares) = residuals.fold((0.0, 0.0), |(count, sum), mm| (count + 1.0, sum + mm * mm));
    let rms = f64::sqrt(squares / count);
    assert!((rms - result["residual_mm"]["after"]["rms"].as_f64().unwrap()).abs() < 1e-9, "{rms}");
}

#[test]
fn a_job_is_checked_as_on_the_command_line() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    let create = |name: &str, length_mm: f64| {
        let job = json!({
            "robot": "kr60ha", "bar": { "length_mm": length_mm, "stroke_mm": [-5, 5] },
            "tool": { "ball_mm": [30, 20, 10] },
            "centre": [{ "id": 1, "xyz_mm": [2500, 0, 800] }], "circle": [{ "plane": "XY", "points": 8 }],
        });
        server.post("/api/v1/workbench", &json!({ "name": name, "job": job }).to_string())
    };
    // Metres in place of millimetres.
    let refused = create("a", 0.3);
    assert_eq!(refused.status, 422, "{refused:?}");
    assert!(refused.json()["code"].as_str().unwrap().starts_with('E'));
    assert!(!dir.path().join("a").exists());
    for name in ["", "..", "../a", "a/b", ".a", "con", "a b"] {
        assert_eq!(create(name, 300.0).status, 422, "{name}");
    }
    assert_eq!(create("a", 300.0).status, 201);
    assert_eq!(create("a", 300.0).status, 409);
    // Out of reach: the refusal stands at the step, with its cause and cure.
    assert_eq!(compute(&server, "a", "plan")["state"], "failed");
    let work = server.get("/api/v1/workbench/a").json();
    let plan = step(&work, "plan");
    assert_eq!((plan["state"].as_str(), plan["verdict"].as_str()), (Some("attention"), Some("fail")));
    let first = &plan["findings"][0];
    assert_eq!((first["code"].as_str(), first["severity"].as_str()), (Some("E0702"), Some("error")));
    assert!(!first["cause"].as_str().unwrap().is_empty() && !first["cure"].as_str().unwrap().is_empty());
    // Nothing is planned: the later steps wait.
    assert_eq!(server.post("/api/v1/workbench/a/steps/programs", "{}").status, 409);
    assert_eq!(server.post("/api/v1/workbench/a/steps/nothing", "{}").status, 400);
    assert_eq!(server.get("/api/v1/workbench/nobody").status, 404);
    let wrong = edit(&server, "a", &json!({ "robot": { "name": "x" } }));
    assert_eq!((wrong.status, wrong.json()["code"].as_str()), (422, Some("E1505")));
}

/// Of two who opened the same job, the second one who saves is told that it was changed, and changes nothing.
#[test]
fn the_last_of_two_people_does_not_win() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    let cell = dir.path().join("a");
    fs::create_dir(&cell).unwrap();
    fs::write(cell.join("job.toml"), JOB).unwrap();
    let read = server.get("/api/v1/workbench/a/job").json();
    let saved = |keys: Value| {
        put(&server, "/api/v1/workbench/a/job", &json!({ "sha256": read["sha256"], "keys": keys }))
    };
    assert_eq!(saved(json!({ "bar": { "length_u_mm": 0.009 } })).status, 204);
    let second = saved(json!({ "bar": { "serial": "DBB-17" } }));
    assert_eq!((second.status, second.json()["code"].as_str()), (409, Some("E1512")));
    let text = fs::read_to_string(cell.join("job.toml")).unwrap();
    assert!(text.contains("length_u_mm = 0.009") && !text.contains("DBB-17"), "{text}");
    assert_eq!(edit(&server, "a", &json!({ "bar": { "serial": "DBB-17" } })).status, 204);
    let without = put(&server, "/api/v1/workbench/a/job", &json!({ "keys": {} }));
    assert_eq!(without.status, 409, "{without:?}");
}

/// A tolerance is in its range or refused, whoever asks: none becomes "no tolerance".
#[test]
fn a_tolerance_is_refused_alike_by_everybody() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    let cell = dir.path().join("cell-1");
    fs::create_dir(&cell).unwrap();
    calibrated_on(&cell, "2026-02-28");
    for tolerance in ["-1", "0", "1e400", "25", "1500"] {
        let asked = format!("{{\"tolerance_mm\":{tolerance}}}");
        let answer = server.post("/api/v1/workbench/cell-1/steps/check", &asked);
        assert!([400, 422].contains(&answer.status), "{tolerance}: {answer:?}");
        let check = ["check", "o.csv", "--robot", "r.toml", "--out", "c", "--tolerance", tolerance];
        let refused =
            Command::new(env!("CARGO_BIN_EXE_dbbd")).args(check).current_dir(&cell).output().unwrap();
        assert_eq!(refused.status.code(), Some(2), "{refused:?}");
        let request = json!({
            "request": "check", "input": "o.csv", "robot": "r.toml", "out": "c", "tolerance_mm": -1.0,
            "rule": { "guard_band": { "risk": 0.05 } }, "tool_repeat_mm": 0.01,
        });
        let mut asked = Command::new(env!("CARGO_BIN_EXE_dbbd"));
        let asked = asked.arg("request").current_dir(&cell).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut asked = asked.spawn().unwrap();
        asked.stdin.take().unwrap().write_all(request.to_string().as_bytes()).unwrap();
        let said = String::from_utf8(asked.wait_with_output().unwrap().stdout).unwrap();
        assert!(said.contains("E0130"), "{said}");
    }
    let text = server.post("/api/v1/workbench/cell-1/steps/check", "{\"tolerance_mm\":\"0.5 mm\"}");
    assert_eq!(text.status, 422, "{text:?}");
}

#[test]
fn nothing_is_read_or_written_outside() {
    let (dir, outside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let server = Server::start(dir.path(), "");
    let cell = dir.path().join("a");
    fs::create_dir(&cell).unwrap();
    fs::write(cell.join("job.toml"), JOB).unwrap();
    fs::write(outside.path().join("secret"), "secret").unwrap();
    symlink(outside.path(), cell.join("out")).unwrap();
    symlink(outside.path(), cell.join("plan")).unwrap();
    fs::create_dir(cell.join("in")).unwrap();
    symlink(outside.path().join("secret"), cell.join("in/link")).unwrap();
    for path in ["out/secret", "in/link", "..%2F../secret", "in/..%2F..%2Fdbbd.toml", "in/none"] {
        assert_eq!(server.get(&format!("/api/v1/workbench/a/files/{path}")).status, 404, "{path}");
    }
    let planned = server.post("/api/v1/workbench/a/steps/plan", "{}");
    assert_eq!((planned.status, planned.json()["code"].as_str()), (409, Some("E1504")));
    let upload = |name: &str, bytes: &str| {
        put(&server, "/api/v1/workbench/a/program", &json!({ "files": [{ "name": name, "bytes": bytes }] }))
    };
    for name in ["../x.src", "x.sh", "x", ".src", "/etc/x.src"] {
        assert_eq!(upload(name, "DEF").status, 422, "{name}");
    }
    // Every byte of another code page arrives as it was; a character that is no byte is refused.
    assert_eq!(upload("A.src", "; \u{e4}\u{0}\u{ff}").status, 204);
    assert_eq!(fs::read(cell.join("uploaded/A.src")).unwrap(), b"; \xe4\x00\xff");
    assert_eq!(upload("B.src", "\u{20ac}").status, 422);
    assert_eq!(upload("C.src", &"x".repeat((4 << 20) + 1)).status, 413);
    assert!(fs::read_dir(outside.path()).unwrap().count() == 1);
}

#[test]
fn pages_of_robots_need_no_token_and_their_answers_do() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("token"), "a-token-of-many-letters").unwrap();
    fs::set_permissions(dir.path().join("token"), std::os::unix::fs::PermissionsExt::from_mode(0o600))
        .unwrap();
    let server = Server::start(dir.path(), "token_file = \"token\"\n");
    for page in ["/", "/live", "/robot/any", "/vendor/three.js"] {
        assert_eq!(server.get(page).status, 200, "{page}");
    }
    for path in
        ["/robot/", "/robot/a/b", "/api/v1/workbench", "/api/v1/workbench/any", "/api/v1/jobs/1/answer"]
    {
        assert_eq!(server.get(path).status, 401, "{path}");
    }
}

/// A changed job is tried: planned as the command line plans it, or refused with the same code; nothing of it stays.
#[test]
fn a_trial_plans_a_changed_job_and_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    let cell = dir.path().join("cell-1");
    fs::create_dir(&cell).unwrap();
    fs::write(cell.join("job.toml"), JOB).unwrap();
    let moved = |x: f64| {
        let keys = json!({ "centre": [{ "row": 0, "xyz_mm": [x, 0.0, 800.0] }] });
        server.post("/api/v1/workbench/cell-1/trial", &keys.to_string())
    };
    let far = moved(2500.0);
    assert_eq!(far.status, 200, "{far:?}");
    let codes = far.json();
    let codes: Vec<_> =
        codes["findings"].as_array().unwrap().iter().map(|one| one["code"].as_str().unwrap()).collect();
    assert!(codes.contains(&"E0702") && far.json()["checks"].is_null(), "{codes:?}");
    let near = moved(1250.0).json();
    let margin = |checks: &Value| {
        let checks = checks.as_array().unwrap();
        checks.iter().find(|check| check["quantity"] == "axis_margin_deg").unwrap()["worst"].as_f64().unwrap()
    };
    assert_eq!(near["scene"]["balls"][0][0], 1250.0);
    let twin = dir.path().join("twin");
    fs::create_dir(&twin).unwrap();
    fs::write(twin.join("job.toml"), JOB.replace("1300.0", "1250.0")).unwrap();
    dbbd(&twin, "dbbd plan job.toml --out plan");
    let plan: Value =
        serde_json::from_str(&fs::read_to_string(twin.join("plan/plan.json")).unwrap()).unwrap();
    assert_eq!(margin(&near["checks"]), margin(&plan["checks"]));
    assert_eq!(fs::read_to_string(cell.join("job.toml")).unwrap(), JOB);
    assert_eq!(fs::read_dir(&cell).unwrap().count(), 1);
}

/// A client that may plan writes the job: no file of the server outside of the robot's directory is read by it, and nothing
/// that is no file keeps anybody waiting.
#[test]
fn a_job_names_no_file_outside_of_its_directory() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("secret.toml"), "main-token-0123456789abcdef\n").unwrap();
    let server = Server::start(dir.path(), "");
    let plans = dir.path().join("a");
    fs::create_dir(&plans).unwrap();
    fs::write(plans.join("job.toml"), JOB).unwrap();
    let secret = dir.path().join("secret.toml").display().to_string();
    symlink(&secret, plans.join("link.toml")).unwrap();
    for name in
        ["../../secret.toml", &secret, "/proc/self/environ", "/dev/zero", "../a/link.toml", "link.toml"]
    {
        for keys in [json!({ "robot": name }), json!({ "bar": { "protocol": name } })] {
            for path in ["/api/v1/workbench/a/job", "/api/v1/workbench/a/trial"] {
                let answer = if path.ends_with("job") {
                    edit(&server, "a", &keys)
                } else {
                    server.post(path, &keys.to_string())
                };
                let said = String::from_utf8_lossy(&answer.body).into_owned();
                assert_eq!(
                    (answer.status, answer.json()["code"].as_str()),
                    (422, Some("E1510")),
                    "{path} {keys}: {said}"
                );
                assert!(!said.contains("main-token"), "{said}");
            }
        }
    }
    // However the file came there, a pipe keeps nobody waiting.
    assert!(Command::new("mkfifo").arg(plans.join("pipe.toml")).status().unwrap().success());
    let text = fs::read_to_string(plans.join("job.toml")).unwrap();
    fs::write(plans.join("job.toml"), text.replace("\"kr60ha\"", "\"pipe.toml\"")).unwrap();
    let begun = dbbd_device::clock::now();
    assert_eq!(server.get("/api/v1/workbench").status, 200);
    assert_eq!(server.get("/api/v1/workbench/a").status, 200);
    assert!(dbbd_device::clock::now().seconds_since(begun) < 5.0);
}
