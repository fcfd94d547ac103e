//! One pass over the records of a capture on disk.

use std::error::Error;
use std::fs::File;
use std::path::Path;

use super::reader::{Damage, Part, Reader};
use super::record::Stamped;
use crate::diag::Diagnostic;

/// Damages that are said one by one.
const SAID: usize = 20;

/// What a pass found besides the records.
pub struct Pass {
    /// The format's version; none when the header is damaged.
    pub version: Option<u32>,
    /// What could not be read.
    pub damages: Vec<Damage>,
    /// Number of whole records.
    pub records: u64,
}

impl Pass {
    /// Gives each whole record of the capture at `path` to `each`; damages are no error.
    ///
    /// # Errors
    /// When the file cannot be read, holds no whole record, or is of a newer version; those of `each`.
    pub fn over(
        path: &Path,
        mut each: impl FnMut(Stamped) -> Result<(), Box<dyn Error>>,
    ) -> Result<Self, Box<dyn Error>> {
        let name = path.display().to_string();
        let unreadable = |error| Diagnostic::file(&name, format!("cannot be read: {error}"));
        let reader = Reader::new(File::open(path).map_err(unreadable)?).map_err(unreadable)?;
        if reader.is_newer() {
            return Err(Diagnostic::file(&name, "was written by a newer dbbd")
                .help("read it with that version")
                .into());
        }
        let mut pass = Self { version: reader.version(), damages: Vec::new(), records: 0 };
        for part in reader {
            match part.map_err(unreadable)? {
                Part::Record(stamped) => {
                    pass.records += 1;
                    each(stamped)?;
                }
                Part::Damage(damage) => pass.damages.push(damage),
            }
        }
        if pass.records == 0 {
            let what = if pass.version.is_some() {
                "no whole record is left"
            } else {
                "is no capture: no whole record is in it"
            };
            return Err(Diagnostic::file(&name, what)
                .help("a capture is what `dbbd acquire --out RUN` writes")
                .into());
        }
        Ok(pass)
    }

    /// The damages in words, those at the end of many as their number.
    pub fn remarks(&self) -> Vec<String> {
        let said = self.damages.iter().take(SAID);
        let mut remarks: Vec<String> = said
            .map(|Damage { offset, bytes, what }| {
                format!("byte {offset}: {what}; {bytes} bytes are passed over")
            })
            .collect();
        if let more @ 1.. = self.damages.len().saturating_sub(SAID) {
            remarks.push(format!("{more} damages more (`dbbd info --json` lists all)"));
        }
        remarks
    }

    /// Bytes that could not be read.
    pub fn lost_bytes(&self) -> u64 {
        self.damages.iter().map(|damage| damage.bytes).sum()
    }
}
