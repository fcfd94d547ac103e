//! The archive of a plant: a database of the runs of many cells, and an object store with their files.
//!
//! The SHA-256 of its capture identifies a run; the SHA-256 of its content identifies a file. The row of a run is
//! written after all of its files have been stored and read back, so every run in the database is complete. The
//! database is SQLite or PostgreSQL, the store a directory or a bucket.

mod address;
mod database;
mod drift;
mod html;
mod local;
mod pages;
mod parquet;
mod plant;
mod push;
mod query;
mod question;
mod schema;
mod spool;
mod store;
mod work;

pub use address::{ArchiveAddresses, Secrets};
pub use database::Database;
pub use local::LocalRun;
pub use pages::{PlantOptions, PlantPages};
pub use parquet::{ColumnKind, parquet};
pub use plant::RunJob;
pub use push::{PushOutcome, StoreDamage};
pub use query::{ArchivedFile, ArchivedRun, RunSelection};
pub use question::{Decided, Filter, Name, Order, PlantNumbers, Question, RunFilter};
pub use spool::Spool;
pub use store::Store;
pub use work::{
    ArchivedResult, ClaimedJob, IdentifySettings, QueueCounts, ResultSummary, Worker, WrittenPosterior,
};

use dbbd_model::diagnostic::Diagnostic;

use crate::ArchiveFinding;

/// Whether the archive could not be reached, so that the operation may be repeated.
pub fn is_away(why: &Diagnostic) -> bool {
    matches!(why.finding(), Some(ArchiveFinding::NotReached { .. }))
}

pub struct Archive {
    pub(crate) database: Database,
    pub(crate) store: Store,
    addresses: ArchiveAddresses,
}

impl Archive {
    /// Opens an archive with the schema of this version.
    pub fn open(addresses: &ArchiveAddresses) -> Result<Self, Diagnostic> {
        let mut archive = Self::connect(addresses)?;
        schema::check_schema_version(&mut archive.database)?;
        Ok(archive)
    }

    /// The same as [`Self::open`], and checks that the store was initialised.
    pub fn open_whole(addresses: &ArchiveAddresses) -> Result<Self, Diagnostic> {
        let archive = Self::open(addresses)?;
        archive.store.check_mark()?;
        Ok(archive)
    }

    /// Creates or migrates an archive. Returns the number of migrations.
    pub fn init(addresses: &ArchiveAddresses) -> Result<usize, Diagnostic> {
        let mut archive = Self::connect(addresses)?;
        archive.store.check()?;
        schema::migrate(&mut archive.database)
    }

    fn connect(addresses: &ArchiveAddresses) -> Result<Self, Diagnostic> {
        let (database, store) = (Database::open(&addresses.archive)?, Store::open(&addresses.store)?);
        Ok(Self { database, store, addresses: addresses.clone() })
    }

    /// Connects to the database again after the connection was lost.
    pub fn reconnect(&mut self) -> Result<(), Diagnostic> {
        self.database = Database::open(&self.addresses.archive)?;
        Ok(())
    }
}
