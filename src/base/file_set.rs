//! The files of one result: all of them, or those that were there before.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::files::{self, Beside, Exclusive};
use crate::diagnostic::Diagnostic;

/// Files that are written beside their names, and take them together at the end.
#[must_use = "nothing is there before it is finished"]
#[derive(Debug)]
pub struct FileSet {
    directory: PathBuf,
    written: Vec<Beside>,
    removed: Vec<PathBuf>,
    _own: Exclusive,
}

/// A file of an earlier result, where it is while the new ones take their names.
struct Earlier {
    place: PathBuf,
    kept: PathBuf,
}

impl FileSet {
    /// Makes the directory, and waits until others have written theirs.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn begin(directory: &Path) -> Result<Self, Diagnostic> {
        let own = files::exclusive(directory)?;
        Ok(Self { directory: directory.into(), written: Vec::new(), removed: Vec::new(), _own: own })
    }

    /// # Errors
    /// The file cannot be written.
    pub fn write(&mut self, name: &str, content: impl AsRef<[u8]>) -> Result<(), Diagnostic> {
        self.write_pieces(name, [content]).map(drop)
    }

    /// The same in pieces; where the file is until the set is finished.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write_pieces(
        &mut self,
        name: &str,
        pieces: impl IntoIterator<Item = impl AsRef<[u8]>>,
    ) -> Result<PathBuf, Diagnostic> {
        let path = self.directory.join(name);
        let Some(written) = files::write_beside(&path, pieces)? else { return Ok(path) };
        let beside = written.beside.clone();
        self.written.push(written);
        Ok(beside)
    }

    /// Removes a file of an earlier result; that there is none is no error.
    pub fn remove(&mut self, name: &str) {
        self.removed.push(self.directory.join(name));
    }

    /// Gives the files their names.
    ///
    /// # Errors
    /// One cannot be replaced or removed: then all that was there is there as before.
    pub fn finish(mut self) -> Result<(), Diagnostic> {
        let mut earlier = Vec::new();
        let mut placed = 0;
        let done = self.replace(&mut earlier, &mut placed);
        for Beside { target, .. } in self.written.drain(..placed) {
            let was_there = earlier.iter().any(|one: &Earlier| one.place == target);
            if done.is_err() && !was_there {
                // It is of the set that is not there.
                let _ = fs::remove_file(target);
            }
        }
        for Earlier { place, kept } in earlier {
            // What cannot have its name again is kept under the other one.
            if done.is_ok() || fs::rename(&kept, place).is_ok() {
                // Gone already where it was renamed; what was not replaced yet has both names.
                let _ = fs::remove_file(kept);
            }
        }
        done
    }

    fn replace(&self, earlier: &mut Vec<Earlier>, placed: &mut usize) -> Result<(), Diagnostic> {
        for Beside { beside, target } in &self.written {
            let wrong = files::unwritable(target);
            earlier.extend(keep(target).map_err(&wrong)?);
            fs::rename(beside, target).map_err(&wrong)?;
            *placed += 1;
        }
        for place in &self.removed {
            if place.is_file() {
                let kept = files::beside(place, "old.part");
                fs::rename(place, &kept).map_err(files::unwritable(place))?;
                earlier.push(Earlier { place: place.clone(), kept });
            }
        }
        Ok(())
    }
}

/// Keeps an earlier file under another name, and under its own until it is replaced; `None` where there is none.
fn keep(place: &Path) -> io::Result<Option<Earlier>> {
    if !place.is_file() {
        return Ok(None);
    }
    let kept = files::beside(place, "old.part");
    // Not every file system has links.
    if fs::hard_link(place, &kept).is_err() {
        fs::copy(place, &kept)?;
    }
    Ok(Some(Earlier { place: place.into(), kept }))
}

impl Drop for FileSet {
    fn drop(&mut self) {
        for Beside { beside, .. } in &self.written {
            // A part of a set is of no use.
            let _ = fs::remove_file(beside);
        }
    }
}
