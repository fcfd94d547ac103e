//! The pages of the plant: content, access control, and names with markup and SQL.

use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use rusqlite::{Connection, params};
use serde_json::Value;
use tempfile::{TempDir, tempdir};

use super::on_servers::Plant;
use super::{archive, command, plant};
use crate::service::{Answer, Server};

const HOSTILE: &str = "<script>alert(1)</script>'\"; DROP TABLE run; -- &amp; ?#%2f";
const TOKEN: &str = "0123456789abcdef-token";
const AT_HOME: [(&str, &str); 2] = [("DBBD_ARCHIVE", "sqlite:plant.db"), ("DBBD_STORE", "file:objects")];

fn serve(dir: &Path, args: &[&str]) -> Server {
    Server::start_command(command(dir, &[&["serve", "--listen", "127.0.0.1:0"], args].concat(), &AT_HOME))
}

fn text(answer: &Answer) -> String {
    String::from_utf8(answer.body.clone()).unwrap()
}

/// The rows of the only table of a list.
fn rows(answer: &Answer) -> usize {
    assert_eq!(answer.status, 200, "{answer:?}");
    text(answer).matches("<tr><td").count()
}

/// A text as a part of an address.
fn encoded(text: &str) -> String {
    text.bytes().map(|byte| format!("%{byte:02x}")).collect()
}

/// An archive with `robots` robots of three runs each, a year apart; the error of each grows by 0.1 mm a year, and
/// every fourth was never checked.
fn filled(robots: usize) -> TempDir {
    let dir = tempdir().unwrap();
    assert_eq!(archive(dir.path(), &["init"]).status.code(), Some(0));
    let mut database = Connection::open(dir.path().join("plant.db")).unwrap();
    let batch = database.transaction().unwrap();
    for robot in 0..robots {
        let name = if robot == 0 { HOSTILE.into() } else { format!("R{robot:04}") };
        for year in 0..6 {
            let run = format!("{:064x}", robot * 10 + year);
            let decision = [Some("pass"), Some("fail"), Some("undecided"), None][robot % 4];
            let decision = decision.filter(|_| year < 5);
            batch
                .execute(
                    "INSERT INTO run VALUES (?1, '', 0, ?2, ?3, 'KR 60', ?4, 'K', '2020-01-01', ?2, ?5, NULL, 9, ?6, '{}')",
                    params![
                        run,
                        format!("cell {}", HOSTILE),
                        name,
                        format!("B{}", robot % 3),
                        format!("{}-03-01T00:00:{:02}Z", 2015 + year, robot % 60),
                        decision
                    ],
                )
                .unwrap();
            let offset = 0.01 * year as f64;
            let posterior = format!(
                "{{\"parameters\":[\"bar_offset\"],\"corrections\":[{offset}],\"covariance\":[[0.0001]],\"prior\":[0.05]}}"
            );
            let error = 0.2 + 0.1 * year as f64 + 0.001 * (year % 2) as f64;
            batch
                .execute(
                    "INSERT INTO result VALUES (?1, '--model=geometric --prior=datasheet', '0.1.0', 0, 'w', 0, 24, 0.01, 1, 0.1, ?2, 0.05, ?3)",
                    params![run, error, posterior],
                )
                .unwrap();
            batch
                .execute(
                    "INSERT INTO job (run, settings, version, state) VALUES (?1, 's', '', 'done')",
                    params![run],
                )
                .unwrap();
        }
    }
    batch.commit().unwrap();
    dir
}

#[test]
fn robots_bars_and_runs_are_found_page_by_page() {
    let dir = filled(120);
    let server = serve(dir.path(), &["--interval", "100", "--limit", "1.0"]);
    for (path, found) in [
        ("/", 50),
        ("/?page=3", 20),
        ("/?page=9", 0),
        ("/?q=r000", 9),
        ("/?q=%25", 1),
        ("/?decision=fail", 30),
        ("/?decision=none&order=check", 30),
        ("/?q=R0001&decision=pass&order=name", 0),
        ("/bars", 3),
        ("/bars?q=b2", 1),
        ("/robot?name=R0005", 6),
        ("/bar?name=B1", 10),
        ("/runs", 50),
        ("/runs?robot=R0005", 6),
        ("/runs?robot=R0005&since=2017-01-01&until=2019-01-01", 2),
        ("/runs?q=cell", 50),
        ("/runs?bar=B1&cell=nowhere", 0),
    ] {
        assert_eq!(rows(&server.get(path)), found, "{path}");
    }
    // All runs, each once.
    let (mut path, mut seen) = ("/runs".to_owned(), std::collections::BTreeSet::new());
    loop {
        let page = text(&server.get(&path));
        for part in page.split("href=\"/runs/").skip(1) {
            assert!(seen.insert(part[..64].to_owned()), "{path}");
        }
        let Some((_, next)) =
            page.split_once("rel=\"next\"").map(|_| page.rsplit_once("<a href=\"").unwrap())
        else {
            break;
        };
        let next = page.split("<a href=\"").find(|part| part.contains("rel=\"next\"")).unwrap_or(next);
        path = next.split('"').next().unwrap().replace("&amp;", "&").replace("&#x2f;", "/");
    }
    assert_eq!(seen.len(), 120 * 6);
    let robot = text(&server.get("/robot?name=R0004"));
    // 0.7 mm in March 2020 and 0.1 mm a year: 1 mm in 2023.
    assert!(robot.contains("<svg") && robot.contains("on 2023-0"), "{robot}");
    assert!(text(&server.get("/bar?name=B1")).contains("<svg"));
    let metrics = text(&server.get("/metrics"));
    for line in [
        "dbbd_archive_runs 720",
        "dbbd_archive_results 720",
        "dbbd_archive_jobs{state=\"done\"} 720",
        "dbbd_archive_robots{decision=\"fail\"} 30",
        "dbbd_archive_robots{decision=\"none\"} 30",
        "dbbd_archive_oldest_waiting_seconds 0",
    ] {
        assert!(metrics.lines().any(|found| found == line), "{line}\n{metrics}");
    }
}

#[test]
fn names_with_markup_and_sql_are_escaped() {
    let dir = filled(4);
    let server = serve(dir.path(), &[]);
    let name = encoded(HOSTILE);
    let run = format!("/runs/{:064x}", 0);
    for path in [
        "/".to_owned(),
        format!("/?q={name}"),
        format!("/robot?name={name}"),
        "/bars".into(),
        "/bar?name=B0".into(),
        format!("/runs?q={name}&robot={name}"),
        run,
        format!("/robot?name=x{name}"),
        format!("/?order={name}"),
        format!("/{name}"),
    ] {
        let answer = server.get(&path);
        let page = text(&answer);
        assert!(!page.contains("<script>alert") && !page.contains("'\"; DROP"), "{path}: {page}");
        let policy = answer.head.to_lowercase();
        assert!(policy.contains("content-security-policy: default-src 'none'; script-src 'self'"), "{path}");
        assert!(policy.contains("x-frame-options: deny") && policy.contains("cache-control: no-store"));
    }
    // The link to the robot leads to the robot, and nothing was dropped.
    let list = text(&server.get("/"));
    let link =
        list.split("<a href=\"").find(|part| part.contains("script")).unwrap().split('"').next().unwrap();
    assert_eq!(rows(&server.get(&link.replace("&#x2f;", "/"))), 6, "{link}");
    assert_eq!(rows(&server.get(&format!("/runs?robot={name}"))), 6);
    for (path, status, code) in [
        ("/?page=one", 400, "E2430"),
        ("/?sort=robot", 400, "E2430"),
        ("/?decision=maybe", 400, "E2430"),
        ("/robot", 400, "E2430"),
        ("/runs?since=soon", 400, "E2430"),
        ("/runs?after=x", 400, "E2430"),
        ("/robot?name=nobody", 404, "E2431"),
        ("/bar?name=none", 404, "E2431"),
        ("/runs/abcdefabcdef", 404, "E2409"),
        ("/runs/x", 404, "E2409"),
        ("/nothing", 404, "E1503"),
    ] {
        let answer = server.get(path);
        assert_eq!(answer.status, status, "{path}");
        assert!(text(&answer).contains(code), "{path}: {}", text(&answer));
    }
    let report = server.get(&format!("/runs/{:064x}/report.html", 0));
    assert!(report.status == 404 && text(&report).contains("E2431"));
    assert_eq!(server.ask("POST", "/", "", "").status, 405);
}

/// A run as a cell pushed it and a worker identified it: its page and its stored report.
#[test]
fn reports_are_sandboxed() {
    let dir = tempdir().unwrap();
    let at = dir.path();
    plant::directory(&at.join("runs"), 1);
    for args in [&["init"][..], &["push", "runs"], &["worker", "--until-empty"]] {
        assert_eq!(archive(at, args).status.code(), Some(0), "{args:?}");
    }
    let listed: Value = serde_json::from_slice(&archive(at, &["list", "--json"]).stdout).unwrap();
    let run = listed[0]["sha256"].as_str().unwrap();
    let server = serve(at, &[]);
    let page = text(&server.get(&format!("/runs/{}", &run[..8])));
    assert!(page.contains(&format!("href=\"/runs/{run}/report.html\"")), "{page}");
    assert!(page.contains("K-B0") && page.contains("Op 0") && page.contains("check&#x2f;check.json"));
    let report = server.get(&format!("/runs/{run}/report.html"));
    assert_eq!(report.status, 200);
    assert!(report.head.contains("sandbox allow-scripts") && text(&report).contains("KUKA KR 60 HA"));
    assert!(text(&server.get("/robot?name=R0")).contains("<svg"));
}

#[test]
fn requests_without_a_token_get_the_sign_in_page() {
    let dir = filled(1);
    let at = dir.path();
    std::fs::write(at.join("token"), format!("{TOKEN}\n")).unwrap();
    std::fs::set_permissions(at.join("token"), std::fs::Permissions::from_mode(0o600)).unwrap();
    for (args, code) in [
        (&["--listen", "0.0.0.0:0"][..], "E1501"),
        (&["--listen", "here"], "E1501"),
        (&["--listen", "127.0.0.1:0", "--host", "http://plant"], "E1501"),
        (&["--listen", "127.0.0.1:0", "--token-file", "none"], "E1501"),
    ] {
        let refused = archive(at, &[&["serve"], args].concat());
        assert_eq!((refused.status.code(), crate::cell::codes(&refused)), (Some(1), vec![code.to_owned()]));
    }
    let server = serve(at, &["--token-file", "token"]);
    let html = "Accept: text/html\r\n";
    for path in ["/", "/robot?name=R0001", "/metrics", "/runs/000000/report.html"] {
        let asked = server.ask("GET", path, html, "");
        assert_eq!(asked.status, 401, "{path}");
        assert!(text(&asked).contains("sign-in.js") && !text(&asked).contains("KR 60"), "{path}");
        assert!(text(&server.get(path)).contains("E1508"), "{path}");
    }
    for file in ["/style.css", "/sign-in.js"] {
        assert_eq!(server.get(file).status, 200, "{file}");
    }
    assert_eq!(server.post("/api/v1/session", "{\"token\":\"0123456789abcdef-wrong\"}").status, 401);
    let entered = server.post("/api/v1/session", &format!("{{\"token\":\"{TOKEN}\"}}"));
    assert_eq!(entered.status, 204);
    let cookie = entered.head.lines().find_map(|line| line.strip_prefix("set-cookie: ")).unwrap();
    let cookie = format!("Cookie: {}\r\n", cookie.split(';').next().unwrap());
    assert_eq!(rows(&server.ask("GET", "/", &cookie, "")), 1);
    let bearer = format!("Authorization: Bearer {TOKEN}\r\n");
    assert_eq!(server.ask("GET", "/metrics", &bearer, "").status, 200);
    let foreign = server.raw(b"GET / HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n");
    assert_eq!(foreign.status, 421);
}

#[test]
fn an_unreachable_archive_gives_an_error_page() {
    let dir = tempdir().unwrap();
    let none = archive(dir.path(), &["serve", "--listen", "127.0.0.1:0"]);
    assert_eq!((none.status.code(), crate::cell::codes(&none)), (Some(1), vec!["E2407".to_owned()]));
}

/// Every query of the dashboard is one that a viewer may ask of PostgreSQL.
#[test]
#[ignore = "needs PostgreSQL: .ci/run"]
fn the_dashboard_example_matches_the_views() {
    let plant = Plant::new("grafana", 1);
    let dashboard: Value =
        serde_json::from_str(include_str!("../../../examples/grafana/archive.json")).unwrap();
    let mut viewer = plant.client("v");
    let panels = dashboard["panels"].as_array().unwrap().iter();
    let of_panels = panels.map(|panel| panel["targets"][0]["rawSql"].as_str().unwrap());
    let of_variables = dashboard["templating"]["list"][1]["query"].as_str();
    let queries: Vec<&str> = of_panels.chain(of_variables).collect();
    assert_eq!(queries.len(), 7);
    for query in queries {
        let query = query
            .replace("$__timeFilter(measured::timestamptz)", "measured::timestamptz > '2020-01-01'")
            .replace("$robot", "'R0'");
        viewer.query(&query, &[]).unwrap_or_else(|error| panic!("{query}: {error}"));
    }
}
