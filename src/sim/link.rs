//! A symlink that gives a pseudo terminal a name of the user's choice while it lives.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A symlink that is removed when it is dropped.
#[derive(Debug)]
pub struct Link {
    path: PathBuf,
    target: PathBuf,
}

impl Link {
    /// Makes the link; one that is left over from before is replaced, anything else is not.
    ///
    /// # Errors
    /// When something that is no link has that name, or the directory cannot be written.
    pub fn new(path: &Path, target: &str) -> io::Result<Self> {
        if fs::symlink_metadata(path).is_ok_and(|data| data.file_type().is_symlink()) {
            fs::remove_file(path)?;
        }
        std::os::unix::fs::symlink(target, path)?;
        Ok(Self { path: path.into(), target: target.into() })
    }

    /// Where it stands.
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
