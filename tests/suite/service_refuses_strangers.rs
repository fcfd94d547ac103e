//! The statements of docs/reference/security.md, one by one.
#![cfg(unix)]

use std::io::{Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use dbbd_device::clock;

use crate::service::Server;

const TOKEN: &str = "0123456789abcdef-token";

fn with_token(dir: &Path) -> Server {
    let file = dir.join("token");
    std::fs::write(&file, format!("{TOKEN}\n")).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o600)).unwrap();
    Server::start_at(dir, "0.0.0.0:0", "token_file = \"token\"\nhosts = [\"cell-3.local\"]\n")
}

#[test]
fn foreign_hosts_and_origins_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    let host = |host: &str| {
        server.raw(
            format!("GET /api/v1/status HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").as_bytes(),
        )
    };
    let own = server.address.to_string();
    for good in [own.as_str(), "localhost:1", "[::1]"] {
        assert_eq!(host(good).status, 200, "{good}");
    }
    for bad in [
        "evil.example",
        "192.168.0.7",
        "127.0.0.1.evil.example",
        "",
        "localhost, evil.example",
        "[::1].evil.example",
        "127.0.0.1:80@evil.example",
        "localhost:",
    ] {
        assert_eq!(host(bad).status, 421, "{bad}");
    }
    let head = "GET /api/v1/status HTTP/1.1\r\nConnection: close\r\n";
    assert_eq!(server.raw(format!("{head}\r\n").as_bytes()).status, 400, "no Host");
    let twice = format!("{head}Host: {own}\r\nHost: evil.example\r\n\r\n");
    assert_eq!(server.raw(twice.as_bytes()).status, 400, "two Hosts");
    let absolute =
        format!("GET http://evil.example/metrics HTTP/1.1\r\nHost: {own}\r\nConnection: close\r\n\r\n");
    assert_eq!(server.raw(absolute.as_bytes()).status, 421, "another authority in the request line");

    let from = |origin: &str| {
        let headers = format!("Content-Type: application/json\r\nOrigin: {origin}\r\n");
        server.ask("POST", "/api/v1/run", &headers, "{\"name\":\"a\"}").status
    };
    // 409 because no port is selected: the request passed the access control.
    assert_eq!(from(&format!("http://{own}")), 409);
    for bad in ["http://evil.example", "null", "http://127.0.0.1:1", &own] {
        assert_eq!(from(bad), 403, "{bad}");
    }
    assert_eq!(from(&format!("http://{own}\r\nOrigin: http://evil.example")), 403, "a second Origin");
    assert_eq!(server.ask("POST", "/api/v1/run/stop", "Origin: http://evil.example\r\n", "").status, 403);
    assert_eq!(server.ask("GET", "/api/v1/runs", "Sec-Fetch-Site: cross-site\r\n", "").status, 403);
    let form = "Content-Type: text/plain\r\n";
    assert_eq!(server.ask("POST", "/api/v1/run", form, "{\"name\":\"a\"}").status, 415);
}

#[test]
fn requests_without_the_token_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let server = with_token(dir.path());
    for path in ["/api/v1/status", "/api/v1/stream", "/api/v1/runs/a/capture", "/metrics", "/api/v1/none"] {
        let answer = server.get(path);
        assert_eq!((answer.status, answer.json()["code"].as_str()), (401, Some(STRANGER)), "{path}");
        assert!(answer.head.contains("www-authenticate: Bearer"));
    }
    let bearer = |token: &str| {
        server.ask("GET", "/api/v1/status", &format!("Authorization: Bearer {token}\r\n"), "").status
    };
    assert_eq!(bearer(TOKEN), 200);
    for wrong in ["", "0123456789abcdef-tokeN", "0123456789abcdef", &format!("{TOKEN}{TOKEN}")] {
        assert_eq!(bearer(wrong), 401, "{wrong}");
    }
    // A token in the address is not accepted.
    assert_eq!(server.get(&format!("/api/v1/status?token={TOKEN}")).status, 401);
    // The page sends the token once and then has a cookie.
    assert_eq!(server.get("/").status, 200);
    assert_eq!(server.post("/api/v1/session", "{\"token\":\"wrong\"}").status, 401);
    let answer = server.post("/api/v1/session", &format!("{{\"token\":\"{TOKEN}\"}}"));
    assert_eq!(answer.status, 204);
    let cookie = answer.head.lines().find_map(|line| line.strip_prefix("set-cookie: ")).unwrap();
    assert!(cookie.contains("HttpOnly") && cookie.contains("SameSite=Strict") && !cookie.contains(TOKEN));
    let cookie = format!("Cookie: other=1; {}\r\n", cookie.split(';').next().unwrap());
    assert_eq!(server.ask("GET", "/api/v1/status", &cookie, "").status, 200);
    assert_eq!(server.ask("GET", "/api/v1/status", "Cookie: dbbd=\r\n", "").status, 401);
    let named = "GET / HTTP/1.1\r\nHost: CELL-3.local\r\nConnection: close\r\n\r\n";
    assert_eq!(server.raw(named.as_bytes()).status, 200, "a configured name");
    let rebound = "GET / HTTP/1.1\r\nHost: rebound.example\r\nConnection: close\r\n\r\n";
    assert_eq!(server.raw(rebound.as_bytes()).status, 421);
}

#[test]
fn a_user_may_do_what_the_role_allows() {
    let dir = tempfile::tempdir().unwrap();
    let user = |name: &str, role: &str, token: &str| {
        let hash = dbbd_model::base::hash::sha256(token);
        format!("[[user]]\nname = \"{name}\"\nrole = \"{role}\"\ntoken_hash = \"{hash}\"\n")
    };
    let tokens = ["a-token-that-looks", "a-token-that-measures", "a-token-that-plans"];
    let names = [("Lea", "look"), ("Max", "measure"), ("Pia", "plan")];
    let users: String =
        names.iter().zip(tokens).map(|((name, role), token)| user(name, role, token)).collect();
    let server = Server::start(dir.path(), &users);
    let ask = |token: &str, method: &str, path: &str, body: &str| {
        let headers = format!("Authorization: Bearer {token}\r\nContent-Type: application/json\r\n");
        server.ask(method, path, &headers, body)
    };
    assert_eq!(server.get("/api/v1/status").status, 401);
    // Of each request the statuses for the three roles; 409 passed the access control: no run is on, no port was chosen.
    for (method, path, body, statuses) in [
        ("GET", "/api/v1/runs", "", [200, 200, 200]),
        ("POST", "/api/v1/run/stop", "", [403, 409, 409]),
        ("POST", "/api/v1/run", "{\"name\":\"a\"}", [403, 409, 409]),
        ("POST", "/api/v1/act", "{\"act\":\"sound_on\"}", [403, 202, 202]),
        ("POST", "/api/v1/demo", "", [403, 403, 201]),
        // The file is another one than that which nobody read.
        ("PUT", "/api/v1/workbench/demo/job", "{\"sha256\":null,\"keys\":{}}", [403, 403, 409]),
    ] {
        let found = tokens.map(|token| ask(token, method, path, body).status);
        assert_eq!(found, statuses, "{method} {path}");
    }
    let refused = ask(tokens[0], "POST", "/api/v1/run/stop", "");
    assert_eq!(refused.json()["code"], STRANGER);
    let asked = ask(tokens[1], "GET", "/api/v1/session", "").json();
    assert_eq!((&asked["name"], &asked["role"]), (&"Max".into(), &"measure".into()));
    // What was changed is listed with who did it, the newest first; what was refused is not.
    let events = ask(tokens[0], "GET", "/api/v1/events", "").json();
    let listed = events["events"].as_array().unwrap().iter();
    let listed: Vec<_> =
        listed.map(|event| [&event["user"], &event["act"]].map(|text| text.as_str().unwrap())).collect();
    let expected = [["Pia", "POST /api/v1/demo"], ["Pia", "POST /api/v1/act"], ["Max", "POST /api/v1/act"]];
    assert_eq!(listed, expected);
    // The page signs in with the same token.
    let answer = server.post("/api/v1/session", &format!("{{\"token\":\"{}\"}}", tokens[0]));
    let cookie = answer.head.lines().find_map(|line| line.strip_prefix("set-cookie: ")).unwrap();
    let cookie = format!("Cookie: {}\r\n", cookie.split(';').next().unwrap());
    assert_eq!(server.ask("POST", "/api/v1/demo", &cookie, "").status, 403);
    assert_eq!(server.ask("GET", "/api/v1/runs", &cookie, "").status, 200);
}

/// A request that is refused: method, path, body, status and code.
const REQUESTS: &[(&str, &str, &str, u16, &str)] = &[
    ("POST", "/api/v1/run", "", 400, "E1509"),
    ("POST", "/api/v1/run", "{", 400, "E1509"),
    ("POST", "/api/v1/run", "[]", 422, "E1505"),
    ("POST", "/api/v1/run", "{}", 422, "E1505"),
    ("POST", "/api/v1/run", "{\"name\":\"a\",\"hurry\":1}", 422, "E1505"),
    ("POST", "/api/v1/run", "{\"name\":\"a\",\"duration_s\":-1}", 422, "E1505"),
    ("POST", "/api/v1/run", "{\"name\":7}", 422, "E1505"),
    ("POST", "/api/v1/run", "{\"name\":\"../a\"}", 422, "E1505"),
    ("POST", "/api/v1/run", "{\"name\":\"a\"}", 409, "E1504"),
    ("POST", "/api/v1/run/stop", "", 409, "E1504"),
    ("POST", "/api/v1/run/mark", "{\"text\":\" \"}", 422, "E1505"),
    ("POST", "/api/v1/jobs", "{\"kind\":\"sync\",\"run\":\"none\"}", 404, "E1503"),
    ("PUT", "/api/v1/device", "{\"port\":\"/dev/ttyNONE7\"}", 404, "E1503"),
    ("GET", "/api/v1/runs/none", "", 404, "E1503"),
    ("GET", "/api/v1/nothing", "", 404, "E1503"),
    ("GET", "/api/v1/runs/%ff%fe", "", 400, "E1509"),
    ("DELETE", "/api/v1/run", "", 405, "E1509"),
];

/// The code for a client without valid credentials.
const STRANGER: &str = "E1508";

#[test]
fn bodies_and_heads_are_limited() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    let long = format!("{{\"name\":\"{}\"}}", "a".repeat(70_000));
    assert_eq!(server.post("/api/v1/run", &long).status, 413);
    for (method, path, body, status, code) in REQUESTS {
        let answer = server.ask(method, path, "Content-Type: application/json\r\n", body);
        assert_eq!((answer.status, answer.json()["code"].as_str()), (*status, Some(*code)), "{path} {body}");
    }
    let mut bad = b"POST /api/v1/run HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\
        Content-Type: application/json\r\nContent-Length: 12\r\n\r\n{\"name\":\"a"
        .to_vec();
    bad.extend(b"\xff\"");
    assert_eq!(server.raw(&bad).status, 400, "bad UTF-8 in a body");
    assert_eq!(server.get("/api/v1/runs/%ff%fe").status, 400, "bad UTF-8 in a path");
    assert_eq!(server.get(&format!("/{}", "a".repeat(3000))).status, 414);
    assert_eq!(server.get(&format!("/{}", "a".repeat(70_000))).status, 431, "longer than any head");
    let headers = format!("X-Long: {}\r\n", "a".repeat(70_000));
    assert_eq!(server.ask("GET", "/", &headers, "").status, 431);
    let many = (0..200).map(|at| format!("X-{at}: 1\r\n")).collect::<String>();
    assert_eq!(server.ask("GET", "/", &many, "").status, 431);
    assert_eq!(server.raw(b"nonsense\r\n\r\n").status, 400);
    assert_eq!(server.ask("DELETE", "/api/v1/run", "", "").status, 405);
    assert_eq!(server.get("/api/v1/nothing").status, 404);
    assert_eq!(server.get("/api/v1/status").status, 200, "it goes on");
}

/// A request head without an end blocks its own connection for ten seconds, and no other.
#[test]
fn slow_request_heads_time_out() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    let mut slow = server.connect();
    slow.write_all(b"GET / HTTP/1.1\r\nHost: localhost\r\n").unwrap();
    let mut late = server.connect();
    late.write_all(
        b"POST /api/v1/run HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 9\r\n\r\n{",
    )
    .unwrap();
    for _ in 0..8 {
        clock::sleep(1.0);
        slow.write_all(b"X-Drip: 1\r\n").unwrap();
        assert_eq!(server.get("/api/v1/status").status, 200);
    }
    let mut rest = Vec::new();
    let _ = slow.read_to_end(&mut rest);
    assert!(!String::from_utf8_lossy(&rest).contains(" 200 "), "it was not answered");
    let mut answer = [0; 12];
    late.read_exact(&mut answer).unwrap();
    assert_eq!(&answer, b"HTTP/1.1 408");
}

#[test]
fn names_cannot_leave_the_data_directory() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("secret"), "secret").unwrap();
    std::fs::create_dir_all(dir.path().join("dbbd-runs/a/identify")).unwrap();
    std::fs::write(dir.path().join("dbbd-runs/a/run.dbbd"), "x").unwrap();
    std::os::unix::fs::symlink(dir.path().join("secret"), dir.path().join("dbbd-runs/a/identify/link"))
        .unwrap();
    let server = Server::start(dir.path(), "[device]\nport = \"/dev/none\"\n");
    for name in
        ["..", ".", "%2e%2e", "..%2fsecret", "%2fetc%2fpasswd", "a%2f..%2f..%2fsecret", "a%00", "%5c..%5c"]
    {
        for path in [
            format!("/api/v1/runs/{name}"),
            format!("/api/v1/runs/{name}/capture"),
            format!("/api/v1/runs/a/identify/{name}"),
            format!("/api/v1/runs/a/{name}/secret"),
            format!("/api/v1/runs/{name}/identify/secret"),
        ] {
            let answer = server.get(&path);
            assert_eq!(answer.status, 404, "{path}");
            assert!(
                !answer.body.windows(6).any(|six| six == b"secret") || answer.json()["error"].is_string()
            );
        }
    }
    assert_eq!(server.get("/api/v1/runs/a/identify/link").status, 404, "a link is not followed");
    for name in ["..", "../x", "a/b", "/tmp/x", "-x", ".x", "", "é", "a b", &"a".repeat(65)] {
        let quoted = serde_json::to_string(name).unwrap();
        assert_eq!(server.post("/api/v1/run", &format!("{{\"name\":{quoted}}}")).status, 422, "{name}");
        let job = format!("{{\"kind\":\"sync\",\"run\":{quoted}}}");
        assert_eq!(server.post("/api/v1/jobs", &job).status, 404, "{name}");
        if !name.is_empty() {
            let plan = format!("{{\"name\":\"free\",\"plan\":{quoted}}}");
            assert_eq!(server.post("/api/v1/run", &plan).status, 404, "plan {name}");
        }
    }
    for option in
        ["\"prior\":\"../x\"", "\"estimate\":\"--out=/tmp/x\"", "\"hold\":\"a b\"", "\"prior\":\"x\""]
    {
        let job = format!("{{\"kind\":\"identify\",\"run\":\"a\",{option}}}");
        assert_eq!(server.post("/api/v1/jobs", &job).status, 422, "{option}");
    }
    let port = "{\"port\":\"/etc/passwd\"}";
    assert_eq!(server.ask("PUT", "/api/v1/device", "Content-Type: application/json\r\n", port).status, 404);
}

#[test]
fn answers_have_security_headers() {
    let dir = tempfile::tempdir().unwrap();
    let server = Server::start(dir.path(), "");
    for path in ["/", "/app.js", "/api/v1/status", "/nothing"] {
        let head = server.get(path).head;
        for line in [
            "content-security-policy: default-src 'none'; script-src 'self'",
            "x-content-type-options: nosniff",
            "x-frame-options: DENY",
            "referrer-policy: no-referrer",
            "cache-control: no-store",
        ] {
            assert!(head.contains(line), "{path}: {line} is not in {head}");
        }
    }
    let page = String::from_utf8(server.get("/").body).unwrap();
    for word in ["http:", "https:", "style=", "onclick", "<script>"] {
        assert!(!page.contains(word), "the page holds {word}");
    }
    assert!(page.contains("data-text=\"safety.title\""));
}
