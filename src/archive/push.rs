//! A run on its way into the archive: its files first, each read back, then its row.

use std::fs::File;

use super::Archive;
use super::local::{LocalFile, LocalRun};
use super::work::Settings;
use crate::base::files;
use crate::catalogue::ArchiveFinding::ChangedMeanwhile;
use crate::diagnostic::{Diagnostic, Finding as _};

/// What became of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pushed {
    New,
    /// The archive held it; files that it lacked were added.
    HeldAlready(Damage),
}

/// What the store had lost of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Objects that this push brought again.
    pub restored: usize,
    /// Files that are still missing.
    pub lost: Vec<String>,
}

/// What became of a file.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Stored {
    Now,
    Before,
}

impl Archive {
    /// Stores a run. When this returns, all of its files were read back from the store and its row is written; a push that
    /// ends anywhere before leaves objects that the next one finds.
    pub fn push(&mut self, run: &LocalRun) -> Result<Pushed, Diagnostic> {
        let known = "SELECT sha256 FROM run_file WHERE run = $1";
        let known = self.database.query(known, &[run.sha256().into()])?;
        let known: Vec<String> = known.iter().map(|row| row.text(0)).collect::<Result<_, _>>()?;
        let mut restored = 0;
        for file in &run.files {
            let stored = self.store_file(file)?;
            restored += usize::from(stored == Stored::Now && known.contains(&file.sha256));
        }
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
        if new {
            return Ok(Pushed::New);
        }
        Ok(Pushed::HeldAlready(Damage { restored, lost: self.lost(run)? }))
    }

    /// The files of a run and of its results that the store lacks, and that are not pushed with it.
    fn lost(&mut self, run: &LocalRun) -> Result<Vec<String>, Diagnostic> {
        let sql = "SELECT name, sha256, bytes FROM run_file WHERE run = $1 \
            UNION SELECT name, sha256, bytes FROM result_file WHERE run = $1 ORDER BY name";
        let mut lost = Vec::new();
        for row in self.database.query(sql, &[run.sha256().into()])? {
            let sha256 = row.text(1)?;
            let is_here = run.files.iter().any(|file| file.sha256 == sha256);
            if !is_here && !self.store.holds(&sha256, row.count(2)?)? {
                lost.push(row.text(0)?);
            }
        }
        lost.dedup();
        Ok(lost)
    }

    /// Stores a file unless it is there, and reads it back.
    fn store_file(&self, file: &LocalFile) -> Result<Stored, Diagnostic> {
        let named = |wrong: Diagnostic| {
            let changed = wrong.code == ChangedMeanwhile.code();
            if changed { Diagnostic::file(&file.path.display().to_string(), ChangedMeanwhile) } else { wrong }
        };
        // What is there may be damaged: then it is stored again.
        if self.store.holds(&file.sha256, file.bytes)? && self.store.verify(&file.sha256).is_ok() {
            return Ok(Stored::Before);
        }
        let mut from = File::open(&file.path).map_err(files::unreadable(file.path.display()))?;
        self.store.put(&file.sha256, &mut from, file.bytes).map_err(named)?;
        self.store.verify(&file.sha256).map(|()| Stored::Now)
    }
}
