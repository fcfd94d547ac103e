//! Where a capture goes.

use std::fs::File;
use std::io::{self, Write};

/// A file that only grows, or what stands in for one in a test: a disk that stalls or is full.
pub trait Disk: Write + Send {
    /// Has what was written put where a loss of power does not reach it.
    ///
    /// # Errors
    /// What the system says.
    fn sync(&mut self) -> io::Result<()>;

    /// Drops what was written beyond `bytes`.
    ///
    /// # Errors
    /// What the system says.
    fn cut(&mut self, bytes: u64) -> io::Result<()>;
}

/// Opened to append, a file goes on at its end after a cut.
impl Disk for File {
    fn sync(&mut self) -> io::Result<()> {
        self.sync_data()
    }

    fn cut(&mut self, bytes: u64) -> io::Result<()> {
        self.set_len(bytes)
    }
}
