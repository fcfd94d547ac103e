//! How long the pages and queries of a plant take: `DBBD_RESULTS=500000 cargo test --features archive --test suite
//! figures_of_the_page -- --ignored --nocapture`; and how fast runs are pushed and identified: `rates_of_push_and_work`.

use std::process::{Child, Stdio};

use dbbd_device::clock;

use super::on_servers::Plant;
use crate::service::Server;

/// 1000 robots of 4 types, 40 bars and 50 cells over three years; a posterior has as many numbers as that of a robot of six
/// joints. The values are made by the database.
const FILL: &str = "
INSERT INTO run (sha256, pushed_at, cell, robot, type, bar, certificate, certified_on, operator, measured, bytes, decision, provenance)
SELECT encode(sha256(n::text::bytea), 'hex'), 0, 'cell ' || n % 50, 'KR-' || 10000 + n % 1000, 'type ' || n % 4,
       'B' || 100 + (n * 7919) % 40, 'K-' || 100 + (n * 7919) % 40, '2023-01-01', 'operator ' || n % 97,
       to_char(timestamp '2023-01-01' + n * interval '1095 days' / {results}, 'YYYY-MM-DD\"T\"HH24:MI:SS\"Z\"'), 200000,
       CASE n % 5 WHEN 0 THEN NULL WHEN 1 THEN 'fail' WHEN 2 THEN 'undecided' ELSE 'pass' END, '{}'
FROM generate_series(1::bigint, {results}) AS n;
INSERT INTO job (run, settings, version, state) SELECT sha256, '--model=geometric --prior=datasheet', '',
       CASE WHEN decision IS NULL THEN 'waiting' ELSE 'done' END FROM run;
INSERT INTO result SELECT sha256, '--model=geometric --prior=datasheet', '0.1.0', 0, 'w', 0, 48, 0.006, 1.1, 0.012,
       0.4 + 0.2 * random(), 0.09, (SELECT text FROM posterior) FROM run;
ANALYZE;";

const PATHS: [&str; 10] = [
    "/",
    "/?page=15",
    "/?decision=fail&order=check",
    "/robot?name=KR-10500",
    "/bars",
    "/bar?name=B120",
    "/runs",
    "/runs?robot=KR-10500&since=2024-01-01",
    "/runs?q=nothing+like+this",
    "/metrics",
];

const STATEMENTS: [(&str, &str); 4] = [
    ("view robot_state", "SELECT * FROM robot_state"),
    ("view queue", "SELECT * FROM queue"),
    ("view robot", "SELECT * FROM robot"),
    ("view history, one robot", "SELECT * FROM history WHERE robot = 'KR-10500'"),
];

/// The posterior that a worker wrote: as long as a real one.
fn posterior() -> String {
    let names =
        (1..=6).flat_map(|joint| ["a", "d", "alpha", "theta"].map(|name| format!("\"{name}{joint}\"")));
    let names: Vec<String> = names.chain(["\"bar_offset\"".into()]).collect();
    let number = |at: usize| format!("{:.17e}", (at as f64 * 0.618_034).fract() * 1e-3 + 1e-6);
    let row =
        |row: usize| format!("[{}]", (0..=row).map(|at| number(row * 31 + at)).collect::<Vec<_>>().join(","));
    let numbers = (0..names.len()).map(number).collect::<Vec<_>>().join(",");
    let rows = (0..names.len()).map(row).collect::<Vec<_>>().join(",");
    let prior = vec!["0.05"; names.len()].join(",");
    let names = names.join(",");
    format!(
        "{{\"parameters\":[{names}],\"corrections\":[{numbers}],\"covariance\":[{rows}],\"prior\":[{prior}]}}"
    )
}

fn measure(name: &str, times: usize, mut work: impl FnMut()) {
    let mut took: Vec<f64> = (0..times)
        .map(|_| {
            let begun = clock::now();
            work();
            1e-6 * (clock::now().0 - begun.0) as f64
        })
        .collect();
    took.sort_by(f64::total_cmp);
    let at = |share: f64| took[((times - 1) as f64 * share).round() as usize];
    eprintln!("{name:40} median {:7.1} ms, 99 % {:7.1} ms", at(0.5), at(0.99));
}

#[test]
#[ignore = "a campaign; needs PostgreSQL"]
fn figures_of_the_page() {
    let results = std::env::var("DBBD_RESULTS").unwrap_or_else(|_| "5000".into());
    let plant = Plant::new("figures", 0);
    let mut owner = plant.client("postgres");
    let posterior = posterior();
    eprintln!("{results} results, a posterior of {} bytes", posterior.len());
    owner.batch_execute("CREATE TEMPORARY TABLE posterior (text TEXT)").unwrap();
    owner.execute("INSERT INTO posterior VALUES ($1)", &[&posterior]).unwrap();
    owner.batch_execute(&FILL.replace("{results}", &results)).unwrap();
    let sizes = "SELECT pg_size_pretty(pg_database_size(current_database()))";
    eprintln!("database {}", owner.query_one(sizes, &[]).unwrap().get::<_, String>(0));
    let server =
        Server::start_command(plant.command("v", &["serve", "--listen", "127.0.0.1:0", "--limit", "0.8"]));
    for path in PATHS {
        measure(path, 100, || assert_eq!(server.get(path).status, 200, "{path}"));
    }
    let mut viewer = plant.client("v");
    for (name, statement) in STATEMENTS {
        measure(name, 100, || drop(viewer.query(statement, &[]).unwrap()));
    }
}

/// Seconds that some work takes.
fn seconds(work: impl FnOnce()) -> f64 {
    let begun = clock::now();
    work();
    1e-9 * (clock::now().0 - begun.0) as f64
}

/// Identifies all runs again with so many workers; the time that takes, s.
fn identified(plant: &Plant, workers: usize) -> f64 {
    let again = "DELETE FROM result_file; DELETE FROM result; UPDATE job SET state = 'waiting', attempts = 0";
    plant.client("postgres").batch_execute(again).unwrap();
    seconds(|| {
        let start = |_| {
            let mut command = plant.command("w", &["worker", "--until-empty", "--quiet"]);
            command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
        };
        let started: Vec<Child> = (0..workers).map(start).collect();
        started.into_iter().for_each(|mut child| assert!(child.wait().unwrap().success()));
    })
}

#[test]
#[ignore = "a campaign; needs PostgreSQL"]
fn rates_of_push_and_work() {
    const RUNS: u64 = 120;
    let plant = Plant::new("rates", RUNS);
    let load = || std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let push = || assert_eq!(plant.run_as("a", &["push", "runs"]).status.code(), Some(0));
    let pushed = seconds(push);
    eprintln!("push: {:.1} runs a second", RUNS as f64 / pushed);
    let again = seconds(push);
    eprintln!("push of runs that are held: {:.1} a second", RUNS as f64 / again);
    for _ in 0..2 {
        let mut one = None;
        for workers in [1, 2, 4] {
            let took = identified(&plant, workers);
            let one = *one.get_or_insert(took);
            let rate = 60.0 * RUNS as f64 / took;
            eprintln!(
                "{workers} workers: {rate:.0} runs a minute, {:.2} times one; load {}",
                one / took,
                load().trim()
            );
        }
    }
    let mut owner = plant.client("postgres");
    let results: i64 = owner.query_one("SELECT count(*) FROM result", &[]).unwrap().get(0);
    assert_eq!(results as u64, RUNS);
    for (what, sql) in [
        ("files of a run", "SELECT sum(bytes)::BIGINT FROM run_file"),
        ("files of its result", "SELECT sum(bytes)::BIGINT FROM result_file"),
        ("database", "SELECT pg_database_size(current_database())"),
    ] {
        let bytes: i64 = owner.query_one(sql, &[]).unwrap().get(0);
        eprintln!("{what}: {:.1} kB a run", bytes as f64 * 1e-3 / RUNS as f64);
    }
}
