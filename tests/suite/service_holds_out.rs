//! The service against clients and users with access to its directories: nobody locks out the operator, no
//! link leads out of the data directory, nothing hangs or grows, and its child processes end with it.
#![cfg(unix)]

use std::fs;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::Command;

use dbbd_device::clock;

use crate::service::Server;

const TOKEN: &str = "0123456789abcdef-token";

/// `more` follows in the configuration.
fn with_token_and(dir: &Path, more: &str) -> Server {
    let file = dir.join("token");
    fs::write(&file, TOKEN).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o600)).unwrap();
    Server::start_at(dir, "0.0.0.0:0", &format!("token_file = \"token\"\n{more}"))
}

fn with_token(dir: &Path) -> Server {
    with_token_and(dir, "")
}

fn bearer(server: &Server, token: &str) -> u16 {
    server.ask("GET", "/api/v1/status", &format!("Authorization: Bearer {token}\r\n"), "").status
}

/// Sends a request over a connection that stays open, and returns the beginning of the answer.
fn ask_and_stay(server: &Server, path: &str) -> Option<TcpStream> {
    let mut stream = server.connect();
    stream.write_all(format!("GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n").as_bytes()).ok()?;
    let mut first = [0; 12];
    stream.read_exact(&mut first).ok()?;
    Some(stream)
}

const TOO_MANY: &str = "E1506";

#[test]
fn unauthenticated_connections_do_not_lock_out_the_operator() {
    let dir = tempfile::tempdir().unwrap();
    let server = with_token(dir.path());
    let mut operator = server.connect();
    let ask =
        format!("GET /api/v1/status HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n\r\n");
    operator.write_all(ask.as_bytes()).unwrap();
    operator.read_exact(&mut [0; 12]).unwrap();
    let _held: Vec<_> = (0..300).map(|_| ask_and_stay(&server, "/")).collect();
    for _ in 0..20 {
        // None of those that are held is young any more.
        clock::sleep(0.03);
        assert_eq!(bearer(&server, TOKEN), 200);
    }
    operator.write_all(ask.as_bytes()).unwrap();
    let mut rest = vec![0; 1 << 16];
    assert!(operator.read(&mut rest).unwrap() > 0, "a connection that has shown the token is kept");
    assert_eq!(server.logged("connection_shed").len(), 1, "said once in ten seconds");
}

#[test]
fn unauthenticated_streams_do_not_lock_out_the_operator() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    let _held: Vec<_> = (0..300).map(|_| ask_and_stay(&server, "/api/v1/stream")).collect();
    for _ in 0..20 {
        clock::sleep(0.03);
        assert_eq!(server.post("/api/v1/run/stop", "").status, 409);
    }
}

/// Connects from another address of this machine.
#[cfg(target_os = "linux")]
fn connect_from(server: &Server, source: [u8; 4]) -> std::io::Result<TcpStream> {
    let socket = socket2::Socket::new(socket2::Domain::IPV4, socket2::Type::STREAM, None)?;
    socket.bind(&SocketAddr::from((source, 0)).into())?;
    socket.connect(&server.address.into())?;
    socket.set_read_timeout(Some(std::time::Duration::from_secs(5)))?;
    Ok(socket.into())
}

/// Memory of the service that is in use, kB.
#[cfg(target_os = "linux")]
pub(crate) fn memory_kb(server: &Server) -> u64 {
    let status = fs::read_to_string(format!("/proc/{}/status", server.child.id())).unwrap();
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
    line.trim().trim_end_matches(" kB").parse().unwrap()
}

#[test]
#[cfg(target_os = "linux")]
fn a_storm_of_connections_keeps_no_memory_and_nobody_out() {
    let dir = tempfile::tempdir().unwrap();
    let server = with_token(dir.path());
    let idle_kb = memory_kb(&server);
    let ask =
        format!("GET /api/v1/status HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {TOKEN}\r\n\r\n");
    let answered = |stream: &mut TcpStream| {
        let mut first = [0; 12];
        stream.write_all(ask.as_bytes()).and_then(|()| stream.read_exact(&mut first)).is_ok()
            && first == *b"HTTP/1.1 200"
    };
    let mut open = connect_from(&server, [127, 0, 0, 9]).unwrap();
    assert!(answered(&mut open));
    let over = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut held = std::collections::VecDeque::new();
            while !over.load(std::sync::atomic::Ordering::Relaxed) {
                let source = [127, 0, 0, 1 + (held.len() % 8) as u8];
                held.extend(connect_from(&server, source));
                // The test has 1024 descriptors.
                if held.len() > 600 {
                    held.pop_front();
                }
            }
        });
        clock::sleep(0.5);
        let came = (0..50).filter(|_| {
            clock::sleep(0.01);
            connect_from(&server, [127, 0, 0, 9]).is_ok_and(|mut stream| answered(&mut stream))
        });
        let came = came.count();
        let descriptors = fs::read_dir(format!("/proc/{}/fd", server.child.id())).unwrap().count();
        let (grown_kb, mut rest) = (memory_kb(&server).saturating_sub(idle_kb), vec![0; 1 << 16]);
        let stays = open.read(&mut rest).is_ok() && answered(&mut open);
        over.store(true, std::sync::atomic::Ordering::Relaxed);
        assert!(came >= 48, "{came} of 50 new connections of another address are answered");
        assert!(stays, "an open connection is kept");
        assert!(descriptors < 220, "{descriptors}: 128 without token, and those of the service");
        assert!(grown_kb < 64 * 1024, "{grown_kb} kB");
    });
}

#[test]
fn wrong_tokens_are_rate_limited() {
    let dir = tempfile::tempdir().unwrap();
    let server = with_token(dir.path());
    let login = |token: &str| server.post("/api/v1/session", &format!("{{\"token\":\"{token}\"}}"));
    let cookie = |answer: crate::service::Answer| {
        let line = answer.head.lines().find_map(|line| line.strip_prefix("set-cookie: ")).unwrap().to_owned();
        format!("Cookie: {}\r\n", line.split(';').next().unwrap())
    };
    let (first, second) = (cookie(login(TOKEN)), cookie(login(TOKEN)));
    let status = |cookie: &str| server.ask("GET", "/api/v1/status", cookie, "").status;
    assert_eq!([status(&first), status(&second)], [200, 200]);
    assert_eq!(server.ask("DELETE", "/api/v1/session", &first, "").status, 204);
    assert_eq!([status(&first), status(&second)], [401, 200], "only that page is logged out");
    for _ in 0..10 {
        assert_eq!(bearer(&server, "0123456789abcdef-wrong"), 401);
    }
    let answer = login("0123456789abcdef-wrong");
    assert_eq!((answer.status, answer.json()["code"].as_str()), (429, Some(TOO_MANY)));
    assert_eq!(bearer(&server, TOKEN), 200, "the right one is not limited");
    assert_eq!(login(TOKEN).status, 204);
    assert_eq!(status(&second), 200, "who is logged in stays so");
    let stop = format!("Authorization: Bearer {TOKEN}\r\n");
    assert_eq!(server.ask("POST", "/api/v1/run/stop", &stop, "").status, 409, "there is no run to stop");
    assert_eq!(server.logged("wrong_token").len(), 1);
}

#[test]
fn only_a_trusted_proxy_names_its_clients() {
    let wrong = |server: &Server, client: &str| {
        let headers =
            format!("X-Forwarded-For: {client}\r\nAuthorization: Bearer 0123456789abcdef-wrong\r\n");
        server.ask("GET", "/api/v1/status", &headers, "").status
    };
    for (proxies, other) in [("", 429), ("trusted_proxies = [\"127.0.0.1\"]\n", 401)] {
        let dir = tempfile::tempdir().unwrap();
        let server = with_token_and(dir.path(), proxies);
        let answers: Vec<u16> = (0..11).map(|_| wrong(&server, "192.168.7.1")).collect();
        assert_eq!(answers[9..], [401, 429]);
        assert_eq!(wrong(&server, "192.168.7.2"), other, "{proxies}");
    }
}

#[test]
fn links_and_pipes_are_not_opened() {
    let dir = tempfile::tempdir().unwrap();
    let runs = dir.path().join("dbbd-runs");
    let outside = dir.path().join("outside");
    fs::create_dir_all(runs.join("a")).unwrap();
    fs::create_dir_all(runs.join("pipe")).unwrap();
    fs::create_dir_all(&outside).unwrap();
    fs::copy("fixtures/captures/run.dbbd", runs.join("a/run.dbbd")).unwrap();
    fs::copy("fixtures/captures/run.dbbd", outside.join("run.dbbd")).unwrap();
    fs::write(outside.join("circle.json"), "secret").unwrap();
    symlink(&outside, runs.join("linked")).unwrap();
    symlink(&outside, runs.join("a/circle")).unwrap();
    assert!(Command::new("mkfifo").arg(runs.join("pipe/run.dbbd")).status().unwrap().success());
    let mut server = Server::start(dir.path(), "");
    let listed = server.get("/api/v1/runs").json();
    let names: Vec<_> = listed["runs"].as_array().unwrap().iter().map(|run| run["name"].clone()).collect();
    assert_eq!(names, ["a"], "neither the link nor the pipe");
    assert_eq!(listed["runs"][0]["results"].as_array().unwrap().len(), 0);
    for path in ["linked", "linked/capture", "a/circle/circle.json", "pipe", "pipe/capture"] {
        assert_eq!(server.get(&format!("/api/v1/runs/{path}")).status, 404, "{path}");
    }
    for (job, status, code) in [
        ("{\"kind\":\"circle\",\"run\":\"a\"}", 409, "E1504"),
        ("{\"kind\":\"sync\",\"run\":\"linked\"}", 404, "E1503"),
        ("{\"kind\":\"sync\",\"run\":\"pipe\"}", 404, "E1503"),
    ] {
        let answer = server.post("/api/v1/jobs", job);
        assert_eq!((answer.status, answer.json()["code"].as_str()), (status, Some(code)), "{job}");
    }
    assert_eq!(fs::read_dir(&outside).unwrap().count(), 2, "nothing was written there");
    assert_eq!(server.signal("TERM"), Some(0));
}

#[test]
fn a_huge_plan_is_not_read() {
    let dir = tempfile::tempdir().unwrap();
    let plan = dir.path().join("plan");
    fs::create_dir(&plan).unwrap();
    fs::write(plan.join("plan.csv"), "index\n").unwrap();
    fs::File::create(plan.join("plan.json")).unwrap().set_len(20_000_000).unwrap();
    let server = Server::start(dir.path(), "");
    for _ in 0..20 {
        let plans = server.get("/api/v1/plans").json();
        assert_eq!(plans["plans"][0]["code"], "E0101", "{plans}");
    }
    let status = fs::read_to_string(format!("/proc/{}/status", server.child.id())).unwrap_or_default();
    let peak_kb = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .map(|rest| rest.trim().trim_end_matches(" kB").parse::<u64>().unwrap());
    assert!(peak_kb.is_none_or(|kb| kb < 60_000), "{peak_kb:?} kB");
}

/// The id of a child process whose command line has this word.
#[cfg(target_os = "linux")]
fn child_of(parent: u32, word: &str) -> Option<u32> {
    let of_parent = |id: &u32| {
        let stat = fs::read_to_string(format!("/proc/{id}/stat")).unwrap_or_default();
        let after = stat.rsplit_once(')').map_or("", |(_, rest)| rest);
        after.split_whitespace().nth(1) == Some(parent.to_string().as_str())
    };
    let named = |id: &u32| {
        let line = fs::read(format!("/proc/{id}/cmdline")).unwrap_or_default();
        String::from_utf8_lossy(&line).split('\0').any(|part| part == word)
    };
    let ids = fs::read_dir("/proc").unwrap().flatten();
    let mut ids = ids.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    ids.find(|id| of_parent(id) && named(id))
}

#[test]
#[cfg(target_os = "linux")]
fn the_simulator_gets_no_secret_and_ends_with_the_service() {
    let dir = tempfile::tempdir().unwrap();
    let mut server = Server::start(dir.path(), "[device]\nport = \"sim\"\n");
    server.wait("/api/v1/status", |status| status["state"] == "idle");
    assert_eq!(server.post("/api/v1/run", "{\"name\":\"tried\"}").status, 201);
    let simulator = child_of(server.child.id(), "simulate").expect("a simulator");
    let environment = fs::read(format!("/proc/{simulator}/environ")).unwrap();
    assert!(!String::from_utf8_lossy(&environment).contains("DBBD_TEST_SECRET"));
    let place = fs::read_link(format!("/proc/{simulator}/cwd")).unwrap();
    assert_eq!(fs::metadata(&place).unwrap().permissions().mode() & 0o777, 0o700, "{}", place.display());
    assert_eq!(server.signal("KILL"), None);
    for _ in 0..100 {
        if !fs::exists(format!("/proc/{simulator}/environ")).unwrap() {
            let _ = fs::remove_dir_all(place);
            return;
        }
        clock::sleep(0.1);
    }
    panic!("the simulator lives on");
}

#[test]
#[cfg(target_os = "linux")]
fn whatever_is_at_work_ends_with_the_service() {
    let dir = tempfile::tempdir().unwrap();
    let mut server = Server::start(dir.path(), "[device]\nport = \"sim\"\n");
    server.wait("/api/v1/status", |status| status["state"] == "idle");
    let mut asking = server.connect();
    let body = "{\"name\":\"tried\"}";
    let head =
        "POST /api/v1/run HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length:";
    asking.write_all(format!("{head} {}\r\n\r\n{body}", body.len()).as_bytes()).unwrap();
    let at_work = || {
        clock::sleep(0.02);
        child_of(server.child.id(), dbbd_job::child_process::UNTIL_STDIN_CLOSES)
    };
    let child = (0..500).find_map(|_| at_work()).expect("a command is at work");
    assert_eq!(server.signal("KILL"), None);
    let gone = |_: &i32| {
        clock::sleep(0.1);
        !fs::exists(format!("/proc/{child}/environ")).unwrap()
    };
    assert!((0..100).find(gone).is_some(), "it lives on");
}

#[test]
#[cfg(target_os = "linux")]
fn a_replaced_program_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let program = dir.path().join("dbbd");
    fs::copy(env!("CARGO_BIN_EXE_dbbd"), &program).unwrap();
    fs::create_dir_all(dir.path().join("dbbd-runs/a")).unwrap();
    fs::copy("fixtures/captures/run.dbbd", dir.path().join("dbbd-runs/a/run.dbbd")).unwrap();
    let server = Server::start_program(&program, dir.path(), "127.0.0.1:0", "");
    fs::remove_file(&program).unwrap();
    fs::write(&program, "another version").unwrap();
    assert_eq!(server.post("/api/v1/jobs", "{\"kind\":\"sync\",\"run\":\"a\"}").status, 202);
    let over = |job: &serde_json::Value| !["waiting", "running"].contains(&job["state"].as_str().unwrap());
    let job = server.wait("/api/v1/jobs/1", over);
    let log = job["log"].to_string();
    assert!(!log.contains("E1507"), "the command was run: {log}");
}

#[test]
fn long_values_are_cut_in_the_log_and_answers_have_no_date() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "[device]\nport = \"/dev/none\"\n");
    let request = format!("{{\"name\":\"a\",\"plan\":\"{}\"}}", "p".repeat(60_000));
    assert_eq!(server.post("/api/v1/run", &request).status, 404);
    let lines = server.logged("run_refused");
    assert!(lines.len() == 1 && lines[0].len() < 1000, "{lines:?}");
    // The date header of the library panics in the year 10000.
    assert!(!server.get("/").head.contains("\ndate:"));
}
