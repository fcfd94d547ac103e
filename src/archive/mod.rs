//! Runs of many cells: a database with who measured what and when, and an object store with the files.
//!
//! A run is known by the SHA-256 of its capture, and so is every file. A row of the database is written when all files of
//! its run are in the store and were read back, so a run in the list is whole. On one machine the database is SQLite and
//! the store a directory; the verbs are the same.

mod address;
mod database;
mod drift;
mod local;
mod pages;
mod parquet;
mod plant;
mod posterior;
mod push;
mod query;
mod schema;
mod spool;
mod store;
mod tls;
mod work;

pub use address::{Addresses, Secrets};
pub use database::Database;
pub use local::LocalRun;
pub use pages::{PlantOptions, PlantPages};
pub use parquet::{ColumnKind, parquet};
pub use plant::RunJob;
pub use posterior::WrittenPosterior;
pub use push::{Damage, Pushed};
pub use query::{ArchivedFile, ArchivedRun, Selection};
pub use spool::Spool;
pub use store::Store;
pub use work::{ArchivedResult, Job, Queue, Settings, Summary, Worker};

use crate::catalogue::ArchiveFinding;
use crate::diagnostic::{Diagnostic, Finding as _};

/// Whether the archive could not be reached: what failed may be tried again.
pub fn is_away(why: &Diagnostic) -> bool {
    why.code == ArchiveFinding::NotReached { what: String::new(), why: String::new() }.code()
}

/// A database with its store.
pub struct Archive {
    pub(crate) database: Database,
    pub(crate) store: Store,
    addresses: Addresses,
}

impl Archive {
    /// Opens an archive whose form is that of this version.
    ///
    /// # Errors
    /// It cannot be reached, or has another form.
    pub fn open(addresses: &Addresses) -> Result<Self, Diagnostic> {
        let mut archive = Self::connect(addresses)?;
        schema::check(&mut archive.database)?;
        Ok(archive)
    }

    /// The same, for what reads or writes objects: the store is that of an archive.
    ///
    /// # Errors
    /// The store was not initialised.
    pub fn open_whole(addresses: &Addresses) -> Result<Self, Diagnostic> {
        let archive = Self::open(addresses)?;
        archive.store.check_mark()?;
        Ok(archive)
    }

    /// Makes a new archive, or brings an older one forward; how many steps that took.
    ///
    /// # Errors
    /// It cannot be reached, or is of a newer version.
    pub fn init(addresses: &Addresses) -> Result<usize, Diagnostic> {
        let mut archive = Self::connect(addresses)?;
        archive.store.check()?;
        schema::migrate(&mut archive.database)
    }

    fn connect(addresses: &Addresses) -> Result<Self, Diagnostic> {
        let (database, store) = (Database::open(&addresses.archive)?, Store::open(&addresses.store)?);
        Ok(Self { database, store, addresses: addresses.clone() })
    }

    /// Connects to the database anew, after the connection was lost.
    ///
    /// # Errors
    /// It cannot be reached.
    pub fn reconnect(&mut self) -> Result<(), Diagnostic> {
        self.database = Database::open(&self.addresses.archive)?;
        Ok(())
    }
}
