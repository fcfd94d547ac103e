//! An archive that was lost is restored from its backup; TLS with `verify-full`.

use std::ffi::OsString;
use std::fs;
use std::path::Path;
use std::process::Command;

use postgres::{Client, NoTls};
use serde_json::Value;

use super::on_servers::Plant;
use super::servers::{Cluster, copy_directory, program, run};
use super::{archive, archive_with, plant};
use crate::cell::{codes, stderr};

/// Everything that can be asked of an archive: runs with their files, as `show` gives them, and the exported tables.
fn content(ask: &dyn Fn(&[&str]) -> std::process::Output, dir: &Path) -> Vec<String> {
    let text = |args: &[&str]| {
        let output = ask(args);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        String::from_utf8(output.stdout).unwrap()
    };
    let listed: Vec<Value> = serde_json::from_str(&text(&["list", "--json"])).unwrap();
    let mut all = vec![format!("{listed:?}")];
    for run in listed.iter().map(|run| run["sha256"].as_str().unwrap()) {
        all.push(text(&["show", run, "--json"]));
        // Every object is compared with its SHA-256.
        text(&["get", run, "--out", run]);
    }
    text(&["export", "--out", "tables"]);
    all.extend(
        ["runs.csv", "results.csv"].map(|name| fs::read_to_string(dir.join("tables").join(name)).unwrap()),
    );
    all
}

#[test]
#[ignore = "needs PostgreSQL with pg_dump: .ci/night"]
fn a_lost_archive_on_postgresql_is_restored() {
    let [dump, restore] = ["pg_dump", "pg_restore"].map(program);
    let mut plant = Plant::new("restore", 3);
    assert_eq!(plant.run_as("a", &["push", "runs"]).status.code(), Some(0));
    assert_eq!(plant.run_as("w", &["worker", "--until-empty"]).status.code(), Some(0));
    let dir = plant.dir.path().to_owned();
    let before = content(&|args| plant.run_as("v", args), &dir);
    let address = plant.address("postgres");
    let file = dir.join("plant.dump");
    let args = |parts: [&str; 4]| parts.map(OsString::from);
    assert!(run(&dump, &args(["--format=custom", "--file", file.to_str().unwrap(), &address])));
    copy_directory(&dir.join("objects"), &dir.join("copy"));
    // All is lost, the roles of the server too.
    fs::remove_dir_all(dir.join("objects")).unwrap();
    let name = plant.name.clone();
    plant.admin.batch_execute(&format!("DROP DATABASE {name} WITH (FORCE)")).unwrap();
    plant.admin.batch_execute(&format!("CREATE DATABASE {name}")).unwrap();
    let lost = plant.run_as("v", &["list"]);
    assert_eq!((lost.status.code(), codes(&lost)), (Some(1), vec!["E2407".to_owned()]));
    assert!(run(&restore, &args(["--exit-on-error", "--dbname", &address, file.to_str().unwrap()])));
    copy_directory(&dir.join("copy"), &dir.join("objects"));
    assert_eq!(content(&|args| plant.run_as("v", args), &dir), before);
    // It goes on: a run that is there is not stored again, a cell still sees its own alone, and nothing is to be migrated.
    let again = plant.run_as("b", &["push", "runs"]);
    assert_eq!((again.status.code(), codes(&again)), (Some(0), vec!["I2413".to_owned(); 3]));
    assert_eq!(["a", "b", "v"].map(|role| plant.listed(role)), [3, 0, 3]);
    assert_eq!(plant.run_as("postgres", &["init"]).status.code(), Some(0));
}

#[test]
fn a_lost_archive_on_one_machine_is_restored() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    plant::directory(&at.join("runs"), 2);
    for args in [&["init"][..], &["push", "runs"], &["worker", "--until-empty"]] {
        assert_eq!(archive(at, args).status.code(), Some(0));
    }
    let before = content(&|args| archive(at, args), at);
    rusqlite::Connection::open(at.join("plant.db"))
        .unwrap()
        .execute("VACUUM INTO ?1", [at.join("copy.db").to_str()])
        .unwrap();
    copy_directory(&at.join("objects"), &at.join("copy"));
    for name in ["plant.db", "plant.db-wal", "plant.db-shm"] {
        let _ = fs::remove_file(at.join(name));
    }
    fs::remove_dir_all(at.join("objects")).unwrap();
    fs::rename(at.join("copy.db"), at.join("plant.db")).unwrap();
    // A store that was not restored is found out.
    let run = serde_json::from_slice::<Value>(&archive(at, &["list", "--json"]).stdout).unwrap();
    let lost = archive(at, &["get", run[0]["sha256"].as_str().unwrap(), "--out", "lost"]);
    assert_eq!((lost.status.code(), codes(&lost)), (Some(1), vec!["E2408".to_owned()]));
    let _ = fs::remove_dir_all(at.join("objects"));
    copy_directory(&at.join("copy"), &at.join("objects"));
    assert_eq!(content(&|args| archive(at, args), at), before);
}

/// The key and certificate of an authority, and of the host `localhost` by it.
fn certificates(openssl: &Path, at: &Path) {
    let key = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"];
    let call = |args: &[&str]| {
        let output = Command::new(openssl).args(args).current_dir(at).output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
    };
    for name in ["plant", "other"] {
        let (out, keyout, subject) = (format!("{name}.pem"), format!("{name}.key"), format!("/CN={name}"));
        let own = ["req", "-x509", "-days", "2", "-subj", &subject, "-keyout", &keyout, "-out", &out];
        call(&[&own[..], &key].concat());
    }
    call(
        &[&["req", "-subj", "/CN=localhost", "-keyout", "server.key", "-out", "server.csr"][..], &key]
            .concat(),
    );
    fs::write(at.join("names"), "subjectAltName=DNS:localhost\nbasicConstraints=CA:FALSE\n").unwrap();
    call(&[
        "x509",
        "-req",
        "-in",
        "server.csr",
        "-CA",
        "plant.pem",
        "-CAkey",
        "plant.key",
        "-CAcreateserial",
        "-days",
        "2",
        "-extfile",
        "names",
        "-out",
        "server.crt",
    ]);
}

#[test]
#[ignore = "needs initdb of PostgreSQL and openssl: .ci/night"]
fn a_certificate_of_another_host_or_authority_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let at = dir.path();
    certificates(&program("openssl"), at);
    let mut cluster = Cluster::new(|data| {
        for name in ["server.crt", "server.key"] {
            fs::copy(at.join(name), data.join(name)).unwrap();
        }
        // Without TLS only the superuser gets in, who waits for the start here.
        let rules = "host all postgres 127.0.0.1/32 trust\nhostssl all all 127.0.0.1/32 trust\n";
        fs::write(data.join("pg_hba.conf"), rules).unwrap();
        "ssl = on\n".into()
    });
    for sql in ["CREATE ROLE owner SUPERUSER LOGIN", "CREATE DATABASE plant"] {
        cluster.client("postgres").batch_execute(sql).unwrap();
    }
    let port = cluster.port;
    let ask = |host: &str, options: &str| {
        let address = format!("postgres://owner@{host}:{port}/plant?{options}");
        archive_with(at, &["init"], &[("DBBD_ARCHIVE", &address), ("DBBD_STORE", "file:objects")])
    };
    for (host, options) in [
        ("127.0.0.1", "sslmode=verify-full&sslrootcert=plant.pem"),
        ("localhost", "sslmode=verify-full&sslrootcert=other.pem"),
        ("localhost", "sslmode=disable"),
    ] {
        let refused = ask(host, options);
        assert_eq!(
            (refused.status.code(), codes(&refused)),
            (Some(1), vec!["E2404".to_owned()]),
            "{host} {options}"
        );
    }
    let made = ask("localhost", "sslmode=verify-full&sslrootcert=plant.pem");
    assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
    let mut client = Client::connect(&cluster.address("postgres", "plant"), NoTls).unwrap();
    let steps: i64 = client.query_one("SELECT count(*) FROM dbbd.step", &[]).unwrap().get(0);
    assert!(steps > 0);
}
