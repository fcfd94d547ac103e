//! PostgreSQL with its roles, and workers that share the queue.

use std::path::Path;
use std::process::{Command, Output, Stdio};

use parquet::file::reader::{FileReader as _, SerializedFileReader};
use parquet::record::Field;
use postgres::{Client, NoTls};
use serde_json::Value;
use tempfile::{TempDir, tempdir};

use super::{archive, command, plant};
use crate::cell::{codes, stderr};

/// Where the databases of these tests are made: an address without a database, of a role that may make databases and
/// roles.
fn server() -> String {
    std::env::var("DBBD_TEST_POSTGRES").unwrap_or_else(|_| "postgres://postgres@127.0.0.1:5432".into())
}

/// A database with four roles, which is dropped at the end.
pub(crate) struct Plant {
    pub(crate) name: String,
    pub(crate) dir: TempDir,
    pub(crate) admin: Client,
}

impl Plant {
    pub(crate) fn new(name: &str, runs: u64) -> Self {
        let mut admin = Client::connect(&format!("{}/postgres", server()), NoTls)
            .unwrap_or_else(|error| panic!("PostgreSQL at {}: {error}", server()));
        let name = format!("dbbd_{name}_{}", std::process::id());
        admin.batch_execute(&format!("CREATE DATABASE {name}")).unwrap();
        let plant = Self { name, dir: tempdir().unwrap(), admin };
        plant::directory(&plant.dir.path().join("runs"), runs);
        let made = plant.run_as("postgres", &["init"]);
        assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
        let mut own = plant.client("postgres");
        for (role, group) in [("a", "cell"), ("b", "cell"), ("v", "viewer"), ("w", "worker")] {
            own.batch_execute(&format!("CREATE ROLE {} LOGIN IN ROLE dbbd_{group}", plant.role(role)))
                .unwrap();
        }
        plant
    }

    fn role(&self, short: &str) -> String {
        if short == "postgres" { short.into() } else { format!("{}_{short}", self.name) }
    }

    pub(crate) fn address(&self, role: &str) -> String {
        format!("postgres://{}@{}/{}", self.role(role), server().split('@').nth(1).unwrap(), self.name)
    }

    pub(super) fn client(&self, role: &str) -> Client {
        let mut client = Client::connect(&self.address(role), NoTls).unwrap();
        client.batch_execute("SET search_path TO dbbd").unwrap();
        client
    }

    pub(crate) fn run_as(&self, role: &str, args: &[&str]) -> Output {
        self.command(role, args).output().unwrap()
    }

    pub(crate) fn command(&self, role: &str, args: &[&str]) -> Command {
        let address = self.address(role);
        command(self.dir.path(), args, &[("DBBD_ARCHIVE", &address), ("DBBD_STORE", "file:objects")])
    }

    pub(crate) fn listed(&self, role: &str) -> usize {
        let output = self.run_as(role, &["list", "--json"]);
        serde_json::from_slice::<Value>(&output.stdout).unwrap().as_array().unwrap().len()
    }
}

impl Drop for Plant {
    fn drop(&mut self) {
        let roles = ["a", "b", "v", "w"].map(|role| self.role(role));
        let name = &self.name;
        let _ = self.admin.batch_execute(&format!("DROP DATABASE {name} WITH (FORCE)"));
        for role in roles {
            let _ = self.admin.batch_execute(&format!("DROP ROLE IF EXISTS {role}"));
        }
    }
}

#[test]
#[ignore = "needs PostgreSQL: .ci/run"]
fn a_cell_sees_and_writes_only_its_own_runs() {
    let plant = Plant::new("roles", 3);
    for (role, run) in [("a", "runs/run-0"), ("a", "runs/run-1"), ("b", "runs/run-2")] {
        let pushed = plant.run_as(role, &["push", run]);
        assert_eq!(pushed.status.code(), Some(0), "{}", stderr(&pushed));
    }
    // The run of another cell is stored once and not visible.
    let again = plant.run_as("b", &["push", "runs/run-0"]);
    assert_eq!((again.status.code(), codes(&again)), (Some(0), vec!["I2413".to_owned()]));
    assert_eq!(["a", "b", "v", "w"].map(|role| plant.listed(role)), [2, 1, 3, 3]);
    for role in ["v", "w"] {
        let refused = plant.run_as(role, &["push", "runs/run-0"]);
        assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec!["E2405".to_owned()]), "{role}");
    }
    let a = plant.role("a");
    let mut own = plant.client("a");
    let run: String = own.query("SELECT sha256 FROM run ORDER BY measured", &[]).unwrap()[0].get(0);
    for role in ["b", "v"] {
        let mut client = plant.client(role);
        if role == "b" {
            for table in ["run", "run_file", "job", "result", "history"] {
                let key = if ["run", "history"].contains(&table) { "sha256" } else { "run" };
                let sql = format!("SELECT count(*) FROM {table} WHERE {key} = $1");
                assert_eq!(client.query_one(&sql, &[&run]).unwrap().get::<_, i64>(0), 0, "{table}");
            }
        }
        for attempt in [
            format!("UPDATE run SET operator = 'x' WHERE sha256 = '{run}'"),
            format!("DELETE FROM run WHERE sha256 = '{run}'"),
            "TRUNCATE run CASCADE".into(),
            "DROP TABLE result".into(),
            format!(
                "INSERT INTO run (sha256, owner, pushed_at, cell, robot, type, bar, measured, bytes, provenance) VALUES ('f', '{a}', 0, '', '', '', '', '', 0, '')"
            ),
            format!("INSERT INTO run_file VALUES ('{run}', 'x', 'y', 0, 0)"),
            format!("INSERT INTO job (run, settings, version) VALUES ('{run}', 'x', '')"),
            format!("UPDATE job SET state = 'done' WHERE run = '{run}'"),
            format!(
                "INSERT INTO result (run, settings, version, made_at, worker, has_warnings, lengths) VALUES ('{run}', '', '', 0, '', 0, 0)"
            ),
            format!("SET ROLE {a}"),
            "ALTER TABLE run DISABLE ROW LEVEL SECURITY".into(),
            "DROP POLICY own_read ON run".into(),
            "UPDATE step SET sha256 = ''".into(),
            "CREATE TABLE dbbd.mine (x INT)".into(),
        ] {
            assert!(client.batch_execute(&attempt).is_err(), "{role}: {attempt}");
        }
    }
    let mut worker = plant.client("w");
    for attempt in [
        "UPDATE run SET operator = 'x'",
        "DELETE FROM run",
        "UPDATE result SET lengths = 0",
        "DELETE FROM job",
    ] {
        assert!(worker.batch_execute(attempt).is_err(), "{attempt}");
    }
    assert_eq!(plant.listed("a"), 2);
}

#[test]
#[ignore = "needs PostgreSQL: .ci/run"]
fn concurrent_pushes_and_killed_workers_process_each_run_once() {
    let plant = Plant::new("work", 4);
    let address = ["a", "b", "w"].map(|role| plant.address(role));
    let start = |address: &str, args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
        command
            .arg("archive")
            .args(args)
            .current_dir(plant.dir.path())
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        command.env("DBBD_ARCHIVE", address).env("DBBD_STORE", "file:objects").spawn().unwrap()
    };
    let pushers = [&address[0], &address[1], &address[0]].map(|address| start(address, &["push", "runs"]));
    for mut pusher in pushers {
        assert!(pusher.wait().unwrap().success());
    }
    assert_eq!(plant.listed("v"), 4);
    // Killed in the middle of a job; the others take it when the lease ends.
    let mut killed = start(&address[2], &["worker", "--lease", "1"]);
    let mut admin = plant.client("postgres");
    let count = |admin: &mut Client, sql: &str| admin.query_one(sql, &[]).unwrap().get::<_, i64>(0);
    while count(&mut admin, "SELECT count(*) FROM job WHERE state = 'running'") == 0 {
        std::thread::yield_now();
    }
    killed.kill().unwrap();
    killed.wait().unwrap();
    let workers = [0, 1].map(|_| start(&address[2], &["worker", "--until-empty", "--lease", "5"]));
    for mut worker in workers {
        assert!(worker.wait().unwrap().success());
    }
    for (sql, wanted) in [
        ("SELECT count(*) FROM job WHERE state = 'done'", 4),
        ("SELECT count(*) FROM result", 4),
        ("SELECT count(*) FROM result WHERE posterior IS NULL OR lengths <> 24", 0),
        (
            "SELECT count(*) FROM result_file f LEFT JOIN run ON run.sha256 = f.run WHERE run.sha256 IS NULL",
            0,
        ),
        ("SELECT count(*) FROM run_file WHERE name = 'run.dbbd'", 4),
    ] {
        assert_eq!(count(&mut admin, sql), wanted, "{sql}");
    }
}

/// Every name of a run as a piece of SQL: it is stored, found and exported as it is.
#[test]
#[ignore = "needs PostgreSQL: .ci/run"]
fn sql_in_names_is_harmless() {
    let plant = Plant::new("inert", 0);
    let names =
        ["'; DROP TABLE run CASCADE; --", "$1); DELETE FROM job; --", "\" OR 1=1 \\", "%_' {now} {user}"];
    let case = plant::Case {
        robot: names[0].into(),
        bar: names[1].into(),
        cell: names[2].into(),
        ..plant::Case::number(0)
    };
    let other = plant::Case { robot: names[3].into(), ..plant::Case::number(1) };
    let plan = plant::plan(case.points);
    for (at, case) in [case, other].iter().enumerate() {
        let path = plant.dir.path().join(format!("run-{at}.dbbd"));
        plant::write(&path, &plan, &crate::cell::kr60().geometry, case);
        let pushed = plant.run_as("a", &["push", path.to_str().unwrap()]);
        assert_eq!(pushed.status.code(), Some(0), "{}", stderr(&pushed));
    }
    assert_eq!(plant.run_as("w", &["worker", "--until-empty"]).status.code(), Some(0));
    for (option, name) in
        [("--robot", 0), ("--bar", 1), ("--cell", 2), ("--search", 0), ("--robot", 3), ("--search", 3)]
    {
        let found = plant.run_as("v", &["list", "--json", option, names[name]]);
        let found: Vec<Value> = serde_json::from_slice(&found.stdout).unwrap();
        assert_eq!(found.len(), 1, "{option} {}", names[name]);
        assert_eq!(found[0]["robot"], if name == 3 { names[3] } else { names[0] });
    }
    assert_eq!(plant.run_as("v", &["export", "--out", "tables"]).status.code(), Some(0));
    let table = std::fs::read_to_string(plant.dir.path().join("tables/results.csv")).unwrap();
    assert_eq!(table.lines().count(), 3);
    let asked = plant.run_as("w", &["reprocess", "--ask-only", "--robot", names[0]]);
    assert_eq!(asked.status.code(), Some(0), "{}", stderr(&asked));
    let jobs: i64 = plant.client("postgres").query_one("SELECT count(*) FROM job", &[]).unwrap().get(0);
    assert_eq!(jobs, 3);
}

/// Runs that are identified again are compared with what was found before; nothing is overwritten.
#[test]
fn jobs_are_done_once_per_settings() {
    let dir = tempdir().unwrap();
    let at: &Path = dir.path();
    plant::directory(&at.join("runs"), 2);
    assert_eq!(archive(at, &["init"]).status.code(), Some(0));
    let empty = archive(at, &["fleet", "--out", "fleet"]);
    assert_eq!((empty.status.code(), codes(&empty)), (Some(1), vec!["E2415".to_owned()]));
    assert_eq!(archive(at, &["push", "runs"]).status.code(), Some(0));
    let counts = |args: &[&str]| -> Value {
        let output = archive(at, args);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let none = archive(at, &["fleet", "--out", "fleet"]);
    assert_eq!((none.status.code(), codes(&none)), (Some(1), vec!["W2427".to_owned(), "E2415".to_owned()]));
    assert_eq!(counts(&["worker", "--until-empty", "--json"])["done"], 2);
    assert_eq!(counts(&["worker", "--until-empty", "--json"])["done"], 0);
    let fleet = counts(&["fleet", "--out", "fleet", "--json"]);
    assert_eq!((&fleet["results"], &fleet["robots"], &fleet["unusable"]), (&2.into(), &2.into(), &0.into()));
    let prior = std::fs::read_to_string(at.join("fleet/kuka-kr-60-ha.toml")).unwrap();
    assert!(dbbd_model::robot::Robot::from_toml("prior", &prior).unwrap().posterior.is_some());
    let again = counts(&["reprocess", "--robot", "R1", "--prior", "none", "--model", "geometric", "--json"]);
    assert_eq!(again["compared"].as_array().unwrap().len(), 1);
    assert_eq!(again["compared"][0]["robot"], "R1");
    let exported = counts(&["export", "--out", "tables", "--json"]);
    assert_eq!((&exported["runs"], &exported["results"]), (&2.into(), &3.into()));
    assert_eq!(counts(&["export", "--format", "parquet", "--out", "tables", "--json"]), exported);
    for table in ["runs", "results"] {
        tables_agree(&at.join("tables"), table);
    }
    let refused = archive(at, &["reprocess", "--estimate", "a1;rm -rf"]);
    assert_eq!((refused.status.code(), codes(&refused)), (Some(1), vec!["E2411".to_owned()]));
    // The worker was lost too often: the job fails. Requested again, it is done.
    let database = rusqlite::Connection::open(at.join("plant.db")).unwrap();
    let lost =
        "UPDATE job SET state = 'running', attempts = 5, lease_until = 0 WHERE version = '' AND run = ?1";
    let run = again["compared"][0]["run"].as_str().unwrap();
    assert_eq!(database.execute(lost, [run]).unwrap(), 1);
    let worked = archive(at, &["worker", "--until-empty"]);
    assert_eq!((worked.status.code(), codes(&worked)), (Some(3), vec!["W2414".to_owned()]));
    let shown = counts(&["show", run, "--json"]);
    let jobs: Vec<_> =
        shown["jobs"].as_array().unwrap().iter().filter(|job| job["state"] == "failed").collect();
    assert_eq!((jobs.len(), &jobs[0]["code"]), (1, &"E2417".into()));
    assert_eq!(database.execute("UPDATE job SET state = 'done' WHERE state = 'failed'", []).unwrap(), 1);
    // A capture without a plan is kept, and cannot be identified.
    std::fs::create_dir(at.join("bare")).unwrap();
    let mut writer = dbbd_job::recording::capture::CaptureWriter::create(&at.join("bare/run.dbbd")).unwrap();
    writer.finish(dbbd_model::base::units::HostNs(0), "end", 0).unwrap();
    assert_eq!(archive(at, &["push", "bare"]).status.code(), Some(0));
    let failed = archive(at, &["reprocess", "--prior", "datasheet"]);
    assert_eq!((failed.status.code(), codes(&failed)), (Some(3), vec!["W2414".to_owned()]));
}

/// A table as Parquet has the columns and values of the same as CSV.
fn tables_agree(dir: &Path, table: &str) {
    let file = std::fs::File::open(dir.join(format!("{table}.parquet"))).unwrap();
    let reader = SerializedFileReader::new(file).unwrap();
    let fields = reader.metadata().file_metadata().schema().get_fields();
    let names: Vec<&str> = fields.iter().map(|field| field.name()).collect();
    let mut csv = csv::Reader::from_path(dir.join(format!("{table}.csv"))).unwrap();
    assert_eq!(csv.headers().unwrap().iter().collect::<Vec<_>>(), names);
    let rows: Vec<_> = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
    let lines: Vec<_> = csv.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), lines.len());
    for (row, line) in rows.iter().zip(&lines) {
        for ((_, field), cell) in row.get_column_iter().zip(line) {
            match field {
                Field::Null => assert_eq!(cell, ""),
                Field::Str(text) => assert_eq!(text, cell),
                Field::Long(number) => assert_eq!(*number, cell.parse::<i64>().unwrap()),
                Field::Double(number) => assert_eq!(*number, cell.parse::<f64>().unwrap()),
                Field::Bool(flag) => assert_eq!(flag.to_string(), cell),
                other => panic!("{other}"),
            }
        }
    }
}
