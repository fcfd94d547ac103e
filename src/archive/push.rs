//! A run on its way into the archive: its files first, each read back, then its row.

use std::fs::File;

use super::Archive;
use super::local::{LocalFile, LocalRun};
use super::work::Settings;
use crate::base::files;
use crate::catalogue::ArchiveFinding::ChangedMeanwhile;
use crate::diagnostic::{Diagnostic, Finding as _};

/// What became of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pushed {
    New,
    /// The archive held it; files that it lacked were added.
    HeldAlready,
}

impl Archive {
    /// Stores a run. When this returns, all of its files were read back from the store and its row is written; a push that
    /// ends anywhere before leaves objects that the next one finds.
    pub fn push(&mut self, run: &LocalRun) -> Result<Pushed, Diagnostic> {
        run.files.iter().try_for_each(|file| self.store_file(file))?;
        let new = self.database.transaction(|database| {
            let new = run.record.insert(database)?;
            let sha256 = run.sha256();
            // A run of another cell is not seen here, and whole as that pushed it.
            let seen = "SELECT 1 FROM run WHERE sha256 = $1";
            if !new && database.query(seen, &[sha256.into()])?.is_empty() {
                return Ok(false);
            }
            for file in &run.files {
                let sql = "INSERT INTO run_file (run, name, sha256, bytes, pushed_at) \
                    VALUES ($1, $2, $3, $4, {now}) ON CONFLICT DO NOTHING";
                let values = [sha256.into(), (&file.name).into(), (&file.sha256).into(), file.bytes.into()];
                database.execute(sql, &values)?;
            }
            if new {
                let sql =
                    "INSERT INTO job (run, settings, version) VALUES ($1, $2, '') ON CONFLICT DO NOTHING";
                database.execute(sql, &[sha256.into(), Settings::USUAL.into()])?;
            }
            Ok(new)
        })?;
        Ok(if new { Pushed::New } else { Pushed::HeldAlready })
    }

    /// Stores a file unless it is there, and reads it back.
    fn store_file(&self, file: &LocalFile) -> Result<(), Diagnostic> {
        let named = |wrong: Diagnostic| {
            let changed = wrong.code == ChangedMeanwhile.code();
            if changed { Diagnostic::file(&file.path.display().to_string(), ChangedMeanwhile) } else { wrong }
        };
        // What is there may be damaged: then it is stored again.
        if self.store.holds(&file.sha256, file.bytes)? && self.store.verify(&file.sha256).is_ok() {
            return Ok(());
        }
        let mut from = File::open(&file.path).map_err(files::unreadable(file.path.display()))?;
        self.store.put(&file.sha256, &mut from, file.bytes).map_err(named)?;
        self.store.verify(&file.sha256)
    }
}
