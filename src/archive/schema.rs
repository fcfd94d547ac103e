//! The form of the database, step by step. A step that was released is never changed: the database holds its SHA-256.

use super::database::{Database, Value};
use crate::base::hash::sha256;
use crate::catalogue::ArchiveFinding::{Newer, NotInitialised, Older, OtherForm};
use crate::diagnostic::Diagnostic;

/// A step: what both databases do, and what PostgreSQL does besides.
struct Step {
    sql: &'static str,
    postgres: &'static str,
}

const STEPS: &[Step] = &[
    Step { sql: include_str!("schema/1.sql"), postgres: include_str!("schema/1-postgres.sql") },
    Step { sql: include_str!("schema/2.sql"), postgres: include_str!("schema/2-postgres.sql") },
];

/// Made before the first step; roles of the whole server are made once.
const GROUND: &str = include_str!("schema/0-postgres.sql");
const STEP_TABLE: &str =
    "CREATE TABLE IF NOT EXISTS step (number BIGINT PRIMARY KEY, sha256 TEXT NOT NULL, at BIGINT NOT NULL)";

impl Step {
    fn sha256(&self) -> String {
        sha256(format!("{}\n{}", self.sql, self.postgres))
    }
}

/// How many steps were made, each as this version would make it.
fn made(database: &mut Database) -> Result<usize, Diagnostic> {
    let rows = database.query("SELECT number, sha256 FROM step ORDER BY number", &[])?;
    for (at, row) in rows.iter().enumerate() {
        let Some(step) = STEPS.get(at) else {
            return Err(Newer { found: rows.len() as u64, known: STEPS.len() as u64 }.into());
        };
        if row.text(1)? != step.sha256() {
            return Err(OtherForm { step: at as u64 + 1 }.into());
        }
    }
    Ok(rows.len())
}

/// That the form is that of this version.
pub(super) fn check(database: &mut Database) -> Result<(), Diagnostic> {
    let there = match database {
        Database::Sqlite(_) => "SELECT count(*) FROM sqlite_master WHERE name = 'step'",
        Database::Postgres(_) => {
            "SELECT count(*) FROM pg_catalog.pg_tables WHERE schemaname = 'dbbd' AND tablename = 'step'"
        }
    };
    let there = database.query(there, &[])?.first().map_or(Ok(0), |row| row.int(0))?;
    if there == 0 {
        return Err(NotInitialised.into());
    }
    match made(database)? {
        found if found < STEPS.len() => Err(Older { found: found as u64, needed: STEPS.len() as u64 }.into()),
        _ => Ok(()),
    }
}

/// Makes the steps that are missing, all or none; how many.
pub(super) fn migrate(database: &mut Database) -> Result<usize, Diagnostic> {
    database.transaction(|database| {
        if database.is_postgres() {
            // One at a time, also where the schema does not exist yet.
            database.batch("SELECT pg_advisory_xact_lock(2401)")?;
            database.batch(GROUND)?;
        }
        database.batch(STEP_TABLE)?;
        let done = made(database)?;
        for (at, step) in STEPS.iter().enumerate().skip(done) {
            database.batch(step.sql)?;
            if database.is_postgres() {
                database.batch(step.postgres)?;
            }
            let number = Value::Int(at as i64 + 1);
            database
                .execute("INSERT INTO step VALUES ($1, $2, {now})", &[number, (&step.sha256()).into()])?;
        }
        Ok(STEPS.len() - done)
    })
}
