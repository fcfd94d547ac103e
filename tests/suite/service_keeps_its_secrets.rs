//! Whatever a client of any role sends, nothing of the secrets of the server comes back, and nobody waits for it. The requests
//! are made from the description of the API, so that a new path or field is asked too.
#![cfg(target_os = "linux")]

use std::fs;
use std::io::{Read, Write};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use dbbd::live;
use dbbd_device::clock;
use dbbd_model::base::hash::sha256;
use serde_json::{Map, Value, json};

use crate::months::calibrated_on;
use crate::service::{Answer, Server};
use crate::service_holds_out::memory_kb;

/// The secrets: the token of the service, a file beside the robots and one outside of the directory, and the environment of the
/// service.
const TOKEN: &str = "kept-from-clients-token-of-the-service";
const BESIDE: &str = "kept-from-clients-beside";
const OUTSIDE: &str = "kept-from-clients-outside";
const ENVIRONMENT: &str = "kept-from-clients-environment";
/// What all of them begin with.
const SECRET: &str = "kept-from-clients";

const ROLES: [&str; 3] = ["look", "measure", "plan"];
/// The longest time of an answer, and of one of the start page meanwhile, s.
const ANSWER_S: f64 = 10.0;
const START_PAGE_S: f64 = 1.0;
/// By how much the memory of the service may grow, kB: as in a storm of connections.
const GROWTH_KB: u64 = 64 * 1024;
/// One of so many requests is sent in the sample of every test run. It has no common factor with the number of roles.
const SAMPLE: usize = 97;
/// Of requests that plan or start a simulated cell one of so many is sent: each takes a process.
const SLOW: usize = 13;

fn token(role: &str) -> String {
    format!("token-of-the-user-who-may-{role}")
}

/// Robots, secrets, and links that lead to them.
fn set_up(dir: &Path, outside: &Path) {
    fs::write(dir.join("token"), format!("{TOKEN}\n")).unwrap();
    fs::set_permissions(dir.join("token"), fs::Permissions::from_mode(0o600)).unwrap();
    fs::write(dir.join("secret.toml"), format!("{BESIDE}\n")).unwrap();
    fs::write(outside.join("secret.toml"), format!("[bar]\n{OUTSIDE} = \"{OUTSIDE}\"\n")).unwrap();
    fs::write(outside.join("plan.csv"), format!("{OUTSIDE}\n")).unwrap();
    fs::write(outside.join("plan.json"), format!("{{\"{OUTSIDE}\": \"{OUTSIDE}\"}}\n")).unwrap();
    fs::write(outside.join("result.json"), format!("{{\"robot\": \"{OUTSIDE}\"}}\n")).unwrap();
    let cell = dir.join("a");
    fs::create_dir_all(cell.join("in")).unwrap();
    calibrated_on(&cell, "2026-02-28");
    symlink(outside.join("secret.toml"), cell.join("link.toml")).unwrap();
    symlink(outside.join("secret.toml"), cell.join("in/link.toml")).unwrap();
    symlink(outside, cell.join("linked")).unwrap();
    // Robots whose job, plan or result is elsewhere.
    for robot in ["linked-job", "linked-plan"] {
        fs::create_dir(dir.join(robot)).unwrap();
    }
    symlink(outside.join("secret.toml"), dir.join("linked-job/job.toml")).unwrap();
    fs::copy(cell.join("job.toml"), dir.join("linked-plan/job.toml")).unwrap();
    for name in ["plan", "result"] {
        symlink(outside, dir.join("linked-plan").join(name)).unwrap();
    }
    symlink(outside, dir.join("linked-robot")).unwrap();
    // The same by the files in a directory that is none.
    for (directory, files) in
        [("plan", &["plan.csv", "plan.json"][..]), ("result", &["result.json"]), ("check", &["check.json"])]
    {
        let directory = dir.join("linked-files").join(directory);
        fs::create_dir_all(&directory).unwrap();
        for file in files {
            symlink(outside.join(file.replace("check", "result")), directory.join(file)).unwrap();
        }
    }
    fs::copy(cell.join("job.toml"), dir.join("linked-files/job.toml")).unwrap();
    let run = dir.join("dbbd-runs/run-1");
    fs::create_dir_all(run.join("sync")).unwrap();
    fs::copy("fixtures/captures/run.dbbd", run.join("run.dbbd")).unwrap();
    symlink(outside.join("secret.toml"), run.join("sync/link.toml")).unwrap();
    symlink(outside, run.join("circle")).unwrap();
}

fn start(dir: &Path) -> Server {
    let users = ROLES.map(|role| {
        format!("[[user]]\nname = \"{role}\"\nrole = \"{role}\"\ntoken_hash = \"{}\"\n", sha256(token(role)))
    });
    let config = format!("address = \"127.0.0.1:0\"\ntoken_file = \"token\"\n{}", users.concat());
    fs::write(dir.join("dbbd.toml"), config).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
    command.env("DBBD_TEST_SECRET", ENVIRONMENT).args(["serve", "--config", "dbbd.toml"]).current_dir(dir);
    Server::start_command(command)
}

/// Texts that name files elsewhere, or that no sound program sends.
fn texts(dir: &Path, outside: &Path) -> Vec<String> {
    let absolute = [dir.join("token"), dir.join("secret.toml"), outside.join("secret.toml")];
    let absolute = absolute.map(|path| path.display().to_string());
    let mut texts: Vec<String> = [
        "..",
        ".",
        "",
        " ",
        "-",
        "../token",
        "../secret.toml",
        "../../token",
        "token",
        "link.toml",
        "in/link.toml",
        "linked",
        "linked/secret.toml",
        "linked-job",
        "linked-plan",
        "linked-robot",
        "linked-plan/plan",
        "linked-files",
        "linked-files/plan",
        "dbbd.toml",
        "/proc/self/environ",
        "/proc/self/fd/0",
        "/dev/zero",
        "/etc/passwd",
        "file:///proc/self/environ",
        "C:\\Windows\\win.ini",
        "C:token",
        "..\\token",
        "\\\\server\\share\\token",
        "\\\\?\\C:\\token",
        "CON",
        "nul.txt",
        "a\u{0}b",
        "\u{1}\u{1b}[31m",
        "a\nb",
        "\u{202e}x",
        "\u{e9}",
        "${DBBD_TEST_SECRET}",
        "$(cat ../token)",
        "`cat ../token`",
        "'; cat ../token #",
        "--out=../x",
        "@../token",
        "%s%n",
        "{DBBD_TEST_SECRET}",
        "<script>",
        "300 mm",
        "NaN",
        "1e400",
        "first",
        "result.json",
        "robot-identified.toml",
    ]
    .map(str::to_owned)
    .into();
    texts.extend(absolute);
    texts.extend(["x".repeat(300), "x".repeat(5000), "../".repeat(600)]);
    texts
}

/// JSON that is no text: numbers of any size, and values of other types.
const VALUES: [&str; 22] = [
    "0",
    "-1",
    "1",
    "-0.0",
    "0.5",
    "1e-308",
    "5e-324",
    "1e308",
    "1e400",
    "-1e400",
    "4294967296",
    "9007199254740993",
    "18446744073709551616",
    "1000000",
    "NaN",
    "Infinity",
    "null",
    "true",
    "[]",
    "{}",
    "[1,2,3]",
    "[[[[[[[[1]]]]]]]]",
];

/// A value where a request is changed.
const HOLE: &str = "@hole@";

/// A sound value for a schema. A text is that of its name, where a sound request needs one.
fn sound(name: &str, schema: &Value) -> Value {
    if let Some(constant) = schema.get("const") {
        return constant.clone();
    }
    if let Some(all) = schema["enum"].as_array() {
        return all[0].clone();
    }
    let kind = schema["type"].as_str().or(schema["type"][0].as_str()).unwrap_or("object");
    match kind {
        "string" => match name {
            "name" => "fresh".into(),
            "run" => "run-1".into(),
            "plan" => "a/plan".into(),
            "act" => "sound_on".into(),
            "port" | "protocol" | "sha256" => Value::Null,
            _ => "x".into(),
        },
        "number" | "integer" => 1.into(),
        "boolean" => true.into(),
        "array" => json!([sound(name, &schema["items"])]),
        _ => {
            let properties = schema["properties"].as_object().into_iter().flatten();
            properties.map(|(name, schema)| (name.clone(), sound(name, schema))).collect::<Map<_, _>>().into()
        }
    }
}

/// The values in which [`HOLE`] is in the place of each of the values of a sound one.
fn holes(value: &Value) -> Vec<Value> {
    let mut all = vec![Value::from(HOLE)];
    if let Some(keys) = value.as_object() {
        for (key, inner) in keys {
            all.extend(holes(inner).into_iter().map(|hole| {
                let mut with = keys.clone();
                with.insert(key.clone(), hole);
                Value::from(with)
            }));
        }
    }
    if let Some(items) = value.as_array() {
        for (at, inner) in items.iter().enumerate() {
            all.extend(holes(inner).into_iter().map(|hole| {
                let mut with = items.clone();
                with[at] = hole;
                Value::from(with)
            }));
        }
    }
    all
}

/// A request of each role: method, path and body.
#[derive(Debug)]
struct Asked {
    method: String,
    path: String,
    body: String,
    /// Whether a process is started for it.
    is_slow: bool,
}

/// A text in a path: every byte that has a meaning there is encoded.
fn encoded(text: &str) -> String {
    let is_plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._-~".contains(&byte);
    text.bytes()
        .map(|byte| if is_plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") })
        .collect()
}

/// A sound part of a path.
fn part(route: &str, name: &str) -> &'static str {
    match (name, route.contains("/runs/")) {
        ("name", _) => "run-1",
        ("kind", _) => "sync",
        ("file", true) => "link.toml",
        ("file", false) => "result.json",
        ("directory", _) => "first",
        ("id", _) => "1",
        ("step", _) => "plan",
        _ => "a",
    }
}

/// The keys of a job: those that the service names when it refuses another key, in every table, so that a new key is among them.
fn job_keys(server: &Server, job: &Value) -> Value {
    let tables = job.as_object().unwrap().iter().filter(|(_, inner)| {
        inner.is_object() || inner.as_array().is_some_and(|all| all.iter().all(Value::is_object))
    });
    let mut with = job.clone();
    for table in std::iter::once(None).chain(tables.map(|(name, _)| Some(name.clone()))) {
        let keys = json!({ "no_key_of_a_job": 1 });
        let asked = match &table {
            None => keys,
            Some(name) if job[name].is_array() => json!({ name.as_str(): [keys] }),
            Some(name) => json!({ name.as_str(): keys }),
        };
        let answer = ask(
            server,
            "plan",
            "PUT",
            "/api/v1/workbench/a/job",
            &json!({ "sha256": null, "keys": asked }).to_string(),
        );
        let said = String::from_utf8_lossy(&answer.body).into_owned();
        let target = match &table {
            None => &mut with,
            Some(name) if job[name].is_array() => &mut with[name.as_str()][0],
            Some(name) => &mut with[name.as_str()],
        };
        for key in said.split('`').skip(3).step_by(2) {
            if target.get(key).is_none() {
                target[key] = Value::from(1);
            }
        }
    }
    with
}

/// All requests that follow from the description of the API.
fn requests(server: &Server, dir: &Path, outside: &Path) -> Vec<Asked> {
    let document: Value = serde_json::from_str(live::OPENAPI).unwrap();
    let texts = texts(dir, outside);
    let quoted = texts.iter().map(|text| serde_json::to_string(text).unwrap());
    let values: Vec<String> = quoted.chain(VALUES.map(str::to_owned)).collect();
    let job = ask(server, "plan", "GET", "/api/v1/workbench/a/job", "").json()["job"].clone();
    let job = job_keys(server, &job);
    let mut all = Vec::new();
    for (route, operations) in document["paths"].as_object().unwrap() {
        // The stream has no end: it is read all the time.
        for (method, operation) in
            operations.as_object().unwrap().iter().filter(|_| !route.ends_with("/stream"))
        {
            let names: Vec<&str> =
                route.split('{').skip(1).map(|rest| rest.split('}').next().unwrap()).collect();
            let path = |changed: &str, text: &str| {
                names.iter().fold(route.clone(), |path, name| {
                    let part = if *name == changed { text } else { part(route, name) };
                    path.replace(&format!("{{{name}}}"), part)
                })
            };
            let method = method.to_uppercase();
            let mut add = |path: String, body: String, is_slow: bool| {
                all.push(Asked { method: method.clone(), path, body, is_slow });
            };
            let schema = &operation["requestBody"]["content"]["application/json"]["schema"];
            let alternatives = schema["oneOf"].as_array().cloned().unwrap_or_else(|| vec![schema.clone()]);
            let alternatives = alternatives.iter().filter(|schema| schema.is_object());
            let bodies = alternatives.map(|schema| match route.as_str() {
                "/api/v1/workbench/{robot}/job" => json!({ "sha256": null, "keys": job }),
                "/api/v1/workbench/{robot}/trial" => job.clone(),
                "/api/v1/workbench" => json!({ "name": "fresh", "job": job }),
                _ => sound("", schema),
            });
            let bodies: Vec<Value> = bodies.collect();
            let starts = ["/trial", "/run", "/reading", "/steps/{step}", "/demo"];
            let is_slow = method == "POST" && starts.iter().any(|end| route.ends_with(end));
            let body = bodies.first().map_or(String::new(), Value::to_string);
            add(path("", ""), body.clone(), is_slow);
            for name in &names {
                for text in &texts {
                    add(path(name, &encoded(text)), body.clone(), false);
                    if text.bytes().all(|byte| byte.is_ascii_graphic() && byte != b'%') {
                        add(path(name, text), body.clone(), false);
                    }
                }
            }
            for hole in bodies.iter().flat_map(holes) {
                for value in &values {
                    add(path("", ""), hole.to_string().replace(&format!("\"{HOLE}\""), value), is_slow);
                }
            }
            let steps = operation["parameters"].as_array().into_iter().flatten();
            for step in steps
                .filter(|one| one["name"] == "step")
                .flat_map(|one| one["schema"]["enum"].as_array().unwrap())
            {
                add(path("step", step.as_str().unwrap()), "{}".into(), true);
            }
            if !bodies.is_empty() {
                for torn in [
                    "",
                    "{",
                    "[]",
                    "\"\u{0}\"",
                    "{\"a\":1,\"a\":2}",
                    &"[".repeat(20_000),
                    &"9".repeat(60_000),
                ] {
                    add(path("", ""), torn.into(), false);
                }
            }
        }
    }
    all
}

fn ask(server: &Server, role: &str, method: &str, path: &str, body: &str) -> Answer {
    let headers = format!("Authorization: Bearer {}\r\nContent-Type: application/json\r\n", token(role));
    server.ask(method, path, &headers, body)
}

fn holds_secret(bytes: &[u8]) -> bool {
    bytes.windows(SECRET.len()).any(|part| part == SECRET.as_bytes())
}

/// Undoes what a request changed, so that the next one meets the same robots.
fn restore(dir: &Path, job: &[u8]) {
    let _ = fs::remove_dir_all(dir.join("fresh"));
    fs::write(dir.join("a/job.toml"), job).unwrap();
}

/// The files that a client may have made the service write.
fn written(directory: &Path, found: &mut Vec<std::path::PathBuf>) {
    for entry in fs::read_dir(directory).unwrap().flatten() {
        let kind = entry.file_type().unwrap();
        if kind.is_dir() {
            written(&entry.path(), found);
        } else if kind.is_file() {
            found.push(entry.path());
        }
    }
}

/// Sends one of `every` requests, by every role.
fn nothing_comes_back(every: usize) {
    let (dir, outside) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    set_up(dir.path(), outside.path());
    let server = start(dir.path());
    let job = fs::read(dir.path().join("a/job.toml")).unwrap();
    let all = requests(&server, dir.path(), outside.path());
    restore(dir.path(), &job);
    let idle_kb = memory_kb(&server);
    let (over, streamed, start_page_s) =
        (AtomicBool::new(false), Mutex::new(Vec::new()), Mutex::new(0.0_f64));
    let (mut longest_s, mut grown_kb, mut sent, mut statuses) =
        (0.0_f64, 0, 0, std::collections::BTreeMap::new());
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while !over.load(Ordering::Relaxed) {
                let begun = clock::now();
                assert_eq!(server.get("/").status, 200);
                let mut longest_s = start_page_s.lock().unwrap();
                *longest_s = longest_s.max(clock::now().seconds_since(begun));
                drop(longest_s);
                clock::sleep(0.1);
            }
        });
        scope.spawn(|| {
            let mut stream = server.connect();
            stream.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
            let head = format!(
                "GET /api/v1/stream HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {}\r\n\r\n",
                token("look")
            );
            stream.write_all(head.as_bytes()).unwrap();
            let mut piece = vec![0; 1 << 16];
            while !over.load(Ordering::Relaxed) {
                let read = stream.read(&mut piece).unwrap_or(0);
                streamed.lock().unwrap().extend_from_slice(&piece[..read]);
            }
        });
        let (fast, slow): (Vec<&Asked>, Vec<&Asked>) = all.iter().partition(|asked| !asked.is_slow);
        let chosen = fast.into_iter().step_by(every).chain(slow.into_iter().step_by(every * SLOW));
        let failed = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            for (number, Asked { method, path, body, .. }) in chosen.enumerate() {
                // A job is changed by who has read it.
                let body = if method == "PUT" && path.ends_with("/a/job") {
                    body.replace("\"sha256\":null", &format!("\"sha256\":\"{}\"", sha256(&job)))
                } else {
                    body.clone()
                };
                for role in ROLES {
                    let begun = clock::now();
                    let answer = ask(&server, role, method, path, &body);
                    let took_s = clock::now().seconds_since(begun);
                    let name =
                        || format!("{role} {method} {path} {}", body.chars().take(3000).collect::<String>());
                    let said = || String::from_utf8_lossy(&answer.body).into_owned();
                    assert!(
                        !holds_secret(&answer.body) && !answer.head.contains(SECRET),
                        "{}: {}",
                        name(),
                        said()
                    );
                    let is_answer = answer.status != 0 && answer.status != 500;
                    assert!(is_answer, "{}: {} {}", name(), answer.status, said());
                    assert!(took_s < ANSWER_S, "{}: {took_s} s, {}", name(), answer.status);
                    longest_s = longest_s.max(took_s);
                    *statuses.entry(answer.status).or_insert(0_u32) += 1;
                    sent += 1;
                    if answer.status == 204 || answer.status == 201 {
                        restore(dir.path(), &job);
                    }
                }
                if number % 100 == 0 {
                    grown_kb = grown_kb.max(memory_kb(&server).saturating_sub(idle_kb));
                }
            }
        }));
        over.store(true, Ordering::Relaxed);
        if let Err(failed) = failed {
            std::panic::resume_unwind(failed);
        }
    });
    // What the jobs say that were started.
    ask(&server, "measure", "POST", "/api/v1/run/stop", "");
    let is_over = || {
        let jobs = ask(&server, "look", "GET", "/api/v1/jobs", "").json();
        let mut jobs = jobs["jobs"].as_array().unwrap().iter();
        jobs.all(|job| !["waiting", "running"].contains(&job["state"].as_str().unwrap()))
    };
    for _ in 0..600 {
        if is_over() {
            break;
        }
        clock::sleep(0.5);
    }
    assert!(is_over(), "the jobs end");
    let jobs = ask(&server, "look", "GET", "/api/v1/jobs", "").json();
    let numbers = jobs["jobs"].as_array().unwrap().iter().map(|job| format!("/api/v1/jobs/{}", job["id"]));
    let more = [
        "/api/v1/jobs",
        "/api/v1/events",
        "/api/v1/status",
        "/api/v1/plans",
        "/api/v1/runs",
        "/api/v1/workbench",
    ];
    for path in numbers.flat_map(|job| [format!("{job}/answer"), job]).chain(more.map(str::to_owned)) {
        let answer = ask(&server, "look", "GET", &path, "");
        assert!(answer.status == 200 && !holds_secret(&answer.body), "{path}: {answer:?}");
    }
    assert!(!holds_secret(&streamed.lock().unwrap()), "the stream");
    let mut files = Vec::new();
    written(dir.path(), &mut files);
    let own = [dir.path().join("token"), dir.path().join("secret.toml")];
    for file in files.iter().filter(|file| !own.contains(file)) {
        assert!(!holds_secret(&fs::read(file).unwrap()), "{}", file.display());
    }
    let start_page_s = *start_page_s.lock().unwrap();
    grown_kb = grown_kb.max(memory_kb(&server).saturating_sub(idle_kb));
    eprintln!(
        "{sent} requests of {}, answers {statuses:?}, the longest after {longest_s:.2} s, the start page after {start_page_s:.2} s at \
         most, {:.1} MB more memory, no secret in an answer, a job, the stream or a file",
        3 * all.len(),
        grown_kb as f64 / 1024.0
    );
    assert!(start_page_s < START_PAGE_S, "{start_page_s} s for the start page");
    assert!(grown_kb < GROWTH_KB, "{grown_kb} kB");
}

/// A sample of [`secrets_campaign`].
#[test]
fn no_secret_comes_back() {
    nothing_comes_back(SAMPLE);
}

#[test]
#[ignore = "a campaign of ten minutes"]
fn secrets_campaign() {
    nothing_comes_back(1);
}
