//! A symlink that gives a pseudo terminal a name of the user's choice while it lives.

use std::fs;
use std::path::{Path, PathBuf};

use crate::catalogue::SimulationFinding;
use crate::diagnostic::Diagnostic;

/// A symlink that is removed when it is dropped.
#[derive(Debug)]
pub struct Link {
    path: PathBuf,
    target: PathBuf,
}

impl Link {
    /// Makes the link; one that is left over from before is replaced, anything else is not.
    pub fn new(path: &Path, target: &str) -> Result<Self, Diagnostic> {
        let wrong = |error: std::io::Error| {
            let finding = SimulationFinding::NoLink { why: error.to_string() };
            Diagnostic::file(&path.display().to_string(), finding)
        };
        if fs::symlink_metadata(path).is_ok_and(|data| data.file_type().is_symlink()) {
            fs::remove_file(path).map_err(wrong)?;
        }
        std::os::unix::fs::symlink(target, path).map_err(wrong)?;
        Ok(Self { path: path.into(), target: target.into() })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        // Another simulator may have taken the name over.
        if fs::read_link(&self.path).is_ok_and(|target| target == self.target) {
            let _ = fs::remove_file(&self.path);
        }
    }
}
