//! Storing a run: first its files, each of which is read back, then its row.

use dbbd_model::base::text::unreadable;
use std::fs::File;

use serde_json::json;

use super::Archive;
use super::local::{LocalFile, LocalRun};
use super::work::IdentifySettings;
use crate::ArchiveFinding::ChangedMeanwhile;
use dbbd_model::diagnostic::Diagnostic;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PushOutcome {
    New,
    /// The archive had the run already. Missing files were added.
    HeldAlready(StoreDamage),
}

/// Objects that the store had lost.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StoreDamage {
    /// Objects that this push restored.
    pub restored: usize,
    /// Files that are still missing.
    pub lost: Vec<String>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum StoreOutcome {
    Now,
    Before,
}

impl Archive {
    /// Stores a run. When this returns, all of its files have been read back from the store and its row is written. A
    /// push that is interrupted leaves objects that the next one uses.
    pub fn push(&mut self, run: &LocalRun) -> Result<PushOutcome, Diagnostic> {
        let known = "SELECT sha256 FROM run_file WHERE run = $1";
        let known: Vec<String> = self.database.tuples(known, run.sha256())?;
        let mut restored = 0;
        for file in &run.files {
            let stored = self.store_file(file)?;
            restored += usize::from(stored == StoreOutcome::Now && known.contains(&file.sha256));
        }
        let new = self.database.transaction(|database| {
            let new = run.record.insert(database)?;
            let sha256 = run.sha256();
            // The run of another cell is invisible to this role, and complete as that cell pushed it.
            let visible = "SELECT 1 FROM run WHERE sha256 = $1";
            if !new && database.tuples::<u64>(visible, sha256)?.is_empty() {
                return Ok(false);
            }
            for file in &run.files {
                let LocalFile { name, sha256: content, bytes, .. } = file;
                let row = json!({ "run": sha256, "name": name, "sha256": content, "bytes": bytes });
                database.insert("run_file", row, Some("pushed_at"))?;
            }
            if new {
                let job = json!({ "run": sha256, "settings": IdentifySettings::DEFAULT, "version": "" });
                database.insert("job", job, None)?;
            }
            Ok(new)
        })?;
        if new {
            return Ok(PushOutcome::New);
        }
        Ok(PushOutcome::HeldAlready(StoreDamage { restored, lost: self.lost(run)? }))
    }

    /// The files of a run and its results that are neither in the store nor among the pushed files.
    fn lost(&mut self, run: &LocalRun) -> Result<Vec<String>, Diagnostic> {
        let sql = "SELECT name, sha256, bytes FROM run_file WHERE run = $1 \
            UNION SELECT name, sha256, bytes FROM result_file WHERE run = $1 ORDER BY name";
        let mut lost = Vec::new();
        for (name, sha256, bytes) in self.database.tuples::<(String, String, u64)>(sql, run.sha256())? {
            let is_here = run.files.iter().any(|file| file.sha256 == sha256);
            if !is_here && !self.store.holds(&sha256, bytes)? {
                lost.push(name);
            }
        }
        lost.dedup();
        Ok(lost)
    }

    /// Stores a file unless the store has it, and reads it back.
    fn store_file(&self, file: &LocalFile) -> Result<StoreOutcome, Diagnostic> {
        let named = |wrong: Diagnostic| {
            let changed = wrong.finding() == Some(&ChangedMeanwhile);
            if changed { wrong.in_file(file.path.display()) } else { wrong }
        };
        // A damaged object is stored again.
        if self.store.holds(&file.sha256, file.bytes)? && self.store.verify(&file.sha256).is_ok() {
            return Ok(StoreOutcome::Before);
        }
        let mut from = File::open(&file.path).map_err(unreadable(file.path.display()))?;
        self.store.put(&file.sha256, &mut from, file.bytes).map_err(named)?;
        self.store.verify(&file.sha256).map(|()| StoreOutcome::Now)
    }
}
