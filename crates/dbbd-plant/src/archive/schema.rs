//! The schema of the database and its migrations. A released migration is never changed: the database holds its
//! SHA-256.

use super::database::Database;
use crate::ArchiveFinding::{Newer, NotInitialised, Older, OtherForm};
use dbbd_model::base::hash::sha256;
use dbbd_model::diagnostic::Diagnostic;

/// A migration: the statements for both databases, and further ones for PostgreSQL.
struct Migration {
    sql: &'static str,
    postgres: &'static str,
}

const MIGRATIONS: &[Migration] = &[
    Migration { sql: include_str!("schema/1.sql"), postgres: include_str!("schema/1-postgres.sql") },
    Migration { sql: include_str!("schema/2.sql"), postgres: include_str!("schema/2-postgres.sql") },
];

/// Creates the schema and, once per server, the roles.
const GROUND: &str = include_str!("schema/0-postgres.sql");
const STEP_TABLE: &str =
    "CREATE TABLE IF NOT EXISTS step (number BIGINT PRIMARY KEY, sha256 TEXT NOT NULL, at BIGINT NOT NULL)";

impl Migration {
    fn sha256(&self) -> String {
        sha256(format!("{}\n{}", self.sql, self.postgres))
    }
}

/// The number of applied migrations. Each must be the one of this version.
fn applied(database: &mut Database) -> Result<usize, Diagnostic> {
    let applied: Vec<String> = database.tuples("SELECT sha256 FROM step ORDER BY number", ())?;
    for (at, sha256) in applied.iter().enumerate() {
        let Some(migration) = MIGRATIONS.get(at) else {
            return Err(Newer { found: applied.len() as u64, known: MIGRATIONS.len() as u64 }.into());
        };
        if *sha256 != migration.sha256() {
            return Err(OtherForm { step: at as u64 + 1 }.into());
        }
    }
    Ok(applied.len())
}

/// Checks that the schema is the one of this version.
pub(super) fn check_schema_version(database: &mut Database) -> Result<(), Diagnostic> {
    let exists = match database {
        Database::Sqlite(_) => "SELECT count(*) FROM sqlite_master WHERE name = 'step'",
        Database::Postgres(_) => {
            "SELECT count(*) FROM pg_catalog.pg_tables WHERE schemaname = 'dbbd' AND tablename = 'step'"
        }
    };
    if database.tuples::<u64>(exists, ())? == [0] {
        return Err(NotInitialised.into());
    }
    let (found, needed) = (applied(database)? as u64, MIGRATIONS.len() as u64);
    if found < needed { Err(Older { found, needed }.into()) } else { Ok(()) }
}

/// Applies the missing migrations in one transaction, and returns their number.
pub(super) fn migrate(database: &mut Database) -> Result<usize, Diagnostic> {
    database.transaction(|database| {
        if database.is_postgres() {
            // Only one process migrates at a time, even before the schema exists.
            database.batch("SELECT pg_advisory_xact_lock(2401)")?;
            database.batch(GROUND)?;
        }
        database.batch(STEP_TABLE)?;
        let done = applied(database)?;
        for (at, migration) in MIGRATIONS.iter().enumerate().skip(done) {
            database.batch(migration.sql)?;
            if database.is_postgres() {
                database.batch(migration.postgres)?;
            }
            database.execute("INSERT INTO step VALUES ($1, $2, {now})", (at + 1, migration.sha256()))?;
        }
        Ok(MIGRATIONS.len() - done)
    })
}
