//! Kills and network cuts while cells push and workers identify: no run is lost or duplicated, no result lacks its run.

use std::collections::BTreeMap;
use std::fs;
use std::process::{Child, Command, Stdio};

use dbbd_device::clock;
use dbbd_job::files;
use postgres::Client;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;
use tempfile::TempDir;

use super::servers::{Cluster, Fault, Line, S3, copy_directory};
use super::{archive_with, plant};
use crate::cell::stderr;

const CELLS: usize = 2;
const WORKERS: usize = 2;

/// What a campaign does.
struct Campaign {
    cluster: Cluster,
    s3: S3,
    database: Line,
    store: Line,
    dir: TempDir,
    rng: Pcg64,
    /// Runs of each cell that no push has taken yet.
    waiting: Vec<Vec<String>>,
    pushers: Vec<Option<(Child, Vec<String>)>>,
    workers: Vec<Option<Child>>,
    counts: BTreeMap<&'static str, u64>,
}

impl Campaign {
    /// A plant with `runs` runs, of which every tenth is in both cells.
    fn new(seed: u64, runs: u64) -> Self {
        let mut cluster = Cluster::new(|_| String::new());
        let s3 = S3::new();
        let dir = tempfile::tempdir().unwrap();
        plant::directory(&dir.path().join("runs"), runs);
        let mut waiting = vec![Vec::new(); CELLS];
        for run in 0..runs as usize {
            for (cell, waiting) in waiting.iter_mut().enumerate() {
                if run % CELLS == cell || run % 10 == 0 {
                    let (from, to) = (format!("runs/run-{run}"), format!("cell-{cell}/run-{run}"));
                    copy_directory(&dir.path().join(from), &dir.path().join(&to));
                    waiting.push(to);
                }
            }
        }
        cluster.client("postgres").batch_execute("CREATE DATABASE plant").unwrap();
        let lines = [cluster.port, s3.port].map(Line::to);
        let [database, store] = lines;
        let campaign = Self {
            cluster,
            s3,
            database,
            store,
            dir,
            rng: Pcg64::seed_from_u64(seed),
            waiting,
            pushers: (0..CELLS).map(|_| None).collect(),
            workers: (0..WORKERS).map(|_| None).collect(),
            counts: BTreeMap::new(),
        };
        let made = campaign.run("postgres", &["init"]);
        assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
        let mut own =
            Client::connect(&campaign.cluster.address("postgres", "plant"), postgres::NoTls).unwrap();
        own.batch_execute(
            "CREATE ROLE cell_0 LOGIN IN ROLE dbbd_cell; CREATE ROLE cell_1 LOGIN IN ROLE dbbd_cell; \
             CREATE ROLE work LOGIN IN ROLE dbbd_worker",
        )
        .unwrap();
        campaign
    }

    fn variables(&self, role: &str) -> [(&'static str, String); 7] {
        [
            ("DBBD_ARCHIVE", format!("postgres://{role}@127.0.0.1:{}/plant", self.database.port)),
            ("DBBD_STORE", "s3://dbbd/plant".into()),
            ("AWS_ENDPOINT", format!("http://127.0.0.1:{}", self.store.port)),
            ("AWS_ALLOW_HTTP", "true".into()),
            ("AWS_REGION", "eu-central-1".into()),
            ("AWS_ACCESS_KEY_ID", "test".into()),
            ("AWS_SECRET_ACCESS_KEY", "test".into()),
        ]
    }

    fn run(&self, role: &str, args: &[&str]) -> std::process::Output {
        let variables = self.variables(role);
        let variables: Vec<_> = variables.iter().map(|(name, value)| (*name, value.as_str())).collect();
        archive_with(self.dir.path(), args, &variables)
    }

    fn start(&self, role: &str, args: &[&str]) -> Child {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
        command.arg("archive").args(args).current_dir(self.dir.path()).envs(self.variables(role));
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    }

    /// Restarts workers and pushers that ended. Runs that were pushed (exit code) are deleted in the cell.
    fn tend(&mut self) {
        for worker in 0..WORKERS {
            let ended = self.workers[worker].as_mut().is_none_or(|child| child.try_wait().unwrap().is_some());
            if ended {
                self.workers[worker] = Some(self.start("work", &["worker", "--lease", "2"]));
            }
        }
        for cell in 0..CELLS {
            self.reap(cell);
            if self.pushers[cell].is_none() && !self.waiting[cell].is_empty() {
                let few = self.waiting[cell].len().min(2);
                self.push(cell, few);
            }
        }
    }

    fn push(&mut self, cell: usize, runs: usize) {
        let runs = self.waiting[cell][..runs].to_vec();
        let spool = format!("spool-{cell}");
        let mut args = vec!["push", "--spool", &spool];
        args.extend(runs.iter().map(String::as_str));
        self.pushers[cell] = Some((self.start(&format!("cell_{cell}"), &args), runs.clone()));
    }

    fn reap(&mut self, cell: usize) {
        let Some((child, runs)) = &mut self.pushers[cell] else { return };
        let Some(status) = child.try_wait().unwrap() else { return };
        if matches!(status.code(), Some(0 | 3)) {
            for run in runs.iter() {
                fs::remove_dir_all(self.dir.path().join(run)).unwrap();
            }
            self.waiting[cell].retain(|run| !runs.contains(run));
        }
        *self.counts.entry("pushes").or_default() += 1;
        self.pushers[cell] = None;
    }

    fn wait(&mut self, seconds: f64) {
        let until = clock::unix_ns() + (seconds * 1e9) as u64;
        while clock::unix_ns() < until {
            self.tend();
            clock::sleep(0.02);
        }
    }

    /// Injects one fault at a time.
    fn fault(&mut self) {
        let pause = self.rng.random_range(0.05..0.6);
        self.wait(pause);
        let name = match self.rng.random_range(0..10) {
            0..3 => {
                let cell = self.rng.random_range(0..CELLS);
                let Some((child, _)) = &mut self.pushers[cell] else { return self.fault() };
                child.kill().unwrap();
                child.wait().unwrap();
                self.pushers[cell] = None;
                "kills of pushers"
            }
            3..6 => {
                let worker = self.rng.random_range(0..WORKERS);
                if let Some(mut child) = self.workers[worker].take() {
                    child.kill().unwrap();
                    child.wait().unwrap();
                }
                "kills of workers"
            }
            6 => {
                self.cluster.kill_and_start();
                let _ = self.cluster.client("plant");
                "kills of PostgreSQL"
            }
            7 => self.broken("cuts of the database", |own| &own.database, Fault::Cut),
            8 => self.broken("cuts of the store", |own| &own.store, Fault::Cut),
            _ => self.broken("errors of the store", |own| &own.store, Fault::Status500),
        };
        *self.counts.entry(name).or_default() += 1;
    }

    fn broken(&mut self, name: &'static str, line: fn(&Self) -> &Line, fault: Fault) -> &'static str {
        line(self).set(fault);
        let pause = self.rng.random_range(0.1..1.5);
        self.wait(pause);
        line(self).set(Fault::None);
        name
    }

    /// Waits for the end of all work without further faults.
    fn settle(&mut self) {
        let spooled = |own: &Self| -> usize {
            let count =
                |cell| fs::read_dir(own.dir.path().join(format!("spool-{cell}"))).map_or(0, Iterator::count);
            (0..CELLS).map(count).sum()
        };
        for _ in 0..100 {
            for cell in 0..CELLS {
                if let Some((child, _)) = &mut self.pushers[cell] {
                    child.wait().unwrap();
                    self.reap(cell);
                }
                self.push(cell, self.waiting[cell].len());
            }
            if self.pushers.iter().flatten().all(|(_, runs)| runs.is_empty()) && spooled(self) == 0 {
                break;
            }
        }
        for (mut child, _) in self.pushers.iter_mut().filter_map(Option::take) {
            child.wait().unwrap();
        }
        for mut child in self.workers.iter_mut().filter_map(Option::take) {
            child.kill().unwrap();
            child.wait().unwrap();
        }
        let worked = self.run("work", &["worker", "--until-empty", "--lease", "2"]);
        assert_eq!(worked.status.code(), Some(0), "{}", stderr(&worked));
    }

    /// Compares the archive with what the cells had.
    fn check(&mut self, runs: u64) {
        let mut client = self.cluster.client("plant");
        client.batch_execute("SET search_path TO dbbd").unwrap();
        let mut count = |sql: &str| client.query_one(sql, &[]).unwrap().get::<_, i64>(0) as u64;
        for (sql, wanted) in [
            ("SELECT count(*) FROM run", runs),
            ("SELECT count(*) FROM run_file WHERE name = 'run.dbbd' AND sha256 = run", runs),
            ("SELECT count(*) FROM run_file", 2 * runs),
            ("SELECT count(*) FROM job WHERE state = 'done'", runs),
            ("SELECT count(*) FROM job", runs),
            ("SELECT count(*) FROM result", runs),
            ("SELECT count(DISTINCT run) FROM result JOIN run ON run.sha256 = result.run", runs),
            ("SELECT count(*) FROM result WHERE lengths <> 24 OR posterior IS NULL", 0),
            ("SELECT count(DISTINCT run) FROM result_file WHERE name = 'result.json'", runs),
        ] {
            assert_eq!(count(sql), wanted, "{sql} {:?}", self.counts);
        }
        for row in client.query("SELECT sha256 FROM result_file", &[]).unwrap() {
            let sha256: String = row.get(0);
            // The store accepts any signature.
            let place = format!("/dbbd/plant/objects/{}/{sha256}?Signature=x", &sha256[..2]);
            assert_eq!(self.s3.ask("GET", &place), Some(200), "{place}");
        }
        for run in 0..runs {
            let own = self.dir.path().join(format!("runs/run-{run}"));
            let sha256 = files::sha256(&own.join("run.dbbd")).unwrap();
            let name = format!("back-{run}");
            let got = self.run("work", &["get", &sha256, "--out", &name]);
            assert_eq!(got.status.code(), Some(0), "{}", stderr(&got));
            let back = self.dir.path().join(name);
            for name in ["run.dbbd", "check/check.json"] {
                let back = back.join(name);
                assert_eq!(fs::read(back).unwrap(), fs::read(own.join(name)).unwrap());
            }
        }
        let attempts = count_of(&mut client, "SELECT coalesce(sum(attempts), 0)::BIGINT FROM job");
        eprintln!("{runs} runs, {attempts} attempts of jobs, {:?}", self.counts);
    }
}

impl Drop for Campaign {
    fn drop(&mut self) {
        let pushers = self.pushers.iter_mut().filter_map(Option::take).map(|(child, _)| child);
        for mut child in pushers.chain(self.workers.iter_mut().filter_map(Option::take)) {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn count_of(client: &mut Client, sql: &str) -> i64 {
    client.query_one(sql, &[]).unwrap().get(0)
}

fn campaign(seed: u64, faults: u64, runs: u64) {
    let mut campaign = Campaign::new(seed, runs);
    campaign.tend();
    for _ in 0..faults {
        campaign.fault();
    }
    campaign.settle();
    campaign.check(runs);
}

#[test]
#[ignore = "needs initdb of PostgreSQL and moto_server: .ci/night"]
fn faults_lose_nothing() {
    campaign(1, 6, 4);
}

#[test]
#[ignore = "minutes; needs initdb of PostgreSQL and moto_server"]
fn campaign_of_200_faults() {
    campaign(22, 200, 200);
}
