//! The watch on a request while it is computed, and the reading of its inputs meanwhile.

use std::cell::RefCell;
use std::fmt::Display;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use flate2::bufread::MultiGzDecoder;

use crate::files;
use dbbd_model::base::table::{TableLayout, TableReader};
use dbbd_model::base::text::unreadable;
use dbbd_model::diagnostic::{Diagnostic, Finding};

/// A watch on a request while it is computed. Each method does nothing unless it is implemented.
pub trait RequestWatch {
    /// A finding, as soon as it is known.
    fn finding(&self, _finding: &Diagnostic) {}

    /// Progress of the request, per cent.
    fn done(&self, _percent: u8) {}

    /// Work begins that takes some time; `bytes` is the size of the file, if the work reads a file.
    fn busy(&self, _what: &str, _bytes: Option<u64>) -> Box<dyn BusyIndicator> {
        Box::new(NoIndicator)
    }
}

/// Shows that work goes on, until it is dropped.
pub trait BusyIndicator {
    /// This number of further bytes was read.
    fn advance(&self, bytes: u64);
}

/// Without a watch, the findings are only in the answer.
impl RequestWatch for () {}

struct NoIndicator;

impl BusyIndicator for NoIndicator {
    fn advance(&self, _bytes: u64) {}
}

/// A file whose reader shows how much of it was read.
struct WatchedFile {
    file: BufReader<File>,
    busy: Box<dyn BusyIndicator>,
}

impl WatchedFile {
    fn open(path: &Path, watch: &dyn RequestWatch) -> Result<Self, Diagnostic> {
        let name = path.display().to_string();
        let unreadable = unreadable(&name);
        let file = files::open(path)?;
        let bytes = file.metadata().map_err(&unreadable)?.len();
        Ok(Self { file: BufReader::new(file), busy: watch.busy(&format!("reading {name}"), Some(bytes)) })
    }
}

impl Read for WatchedFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.file.read(buffer)?;
        self.busy.advance(read as u64);
        Ok(read)
    }
}

impl BufRead for WatchedFile {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.file.fill_buf()
    }

    fn consume(&mut self, amount: usize) {
        self.busy.advance(amount as u64);
        self.file.consume(amount);
    }
}

/// Opens a text of the user, which may be compressed with gzip.
pub fn open_text(path: &Path, watch: &dyn RequestWatch) -> Result<Box<dyn BufRead>, Diagnostic> {
    const GZIP: [u8; 2] = [0x1f, 0x8b];
    let mut file = WatchedFile::open(path, watch)?;
    let begin = file.fill_buf().map_err(unreadable(path.display()))?;
    Ok(if begin.starts_with(&GZIP) {
        Box::new(BufReader::new(MultiGzDecoder::new(file)))
    } else {
        Box::new(file)
    })
}

/// Reads a table of the user with `read`. Returns its content, and a finding if its format is unusual.
pub fn read_table<T>(
    path: &Path,
    watch: &dyn RequestWatch,
    read: impl FnOnce(&mut TableReader<'_>) -> Result<T, Diagnostic>,
) -> Result<(T, Option<Diagnostic>), Diagnostic> {
    let file = open_text(path, watch)?;
    let mut table = TableReader::new(&path.display().to_string(), file, TableLayout::default())?;
    let content = read(&mut table)?;
    let unusual = table.findings();
    Ok((content, unusual))
}

/// A request that is being computed: it passes findings on as they come, and keeps them for the answer.
pub(super) struct RequestSession<'a> {
    watch: &'a dyn RequestWatch,
    findings: RefCell<Vec<Diagnostic>>,
}

impl<'a> RequestSession<'a> {
    pub(super) fn new(watch: &'a dyn RequestWatch) -> Self {
        Self { watch, findings: RefCell::default() }
    }

    pub(super) fn finding(&self, finding: impl Into<Diagnostic>) {
        let finding = finding.into();
        self.watch.finding(&finding);
        self.findings.borrow_mut().push(finding);
    }

    pub(super) fn findings<F: Into<Diagnostic>>(&self, findings: impl IntoIterator<Item = F>) {
        findings.into_iter().for_each(|finding| self.finding(finding));
    }

    /// Reports findings that concern a file.
    pub(super) fn findings_in<F: Finding>(&self, file: impl Display, findings: impl IntoIterator<Item = F>) {
        findings.into_iter().for_each(|finding| self.finding(Diagnostic::file(&file, finding)));
    }

    /// Reads a table of the user, and reports its format if it is unusual.
    pub(super) fn table<T>(
        &self,
        path: &Path,
        read: impl FnOnce(&mut TableReader<'_>) -> Result<T, Diagnostic>,
    ) -> Result<T, Diagnostic> {
        let (content, unusual) = read_table(path, self.watch, read)?;
        self.findings(unusual);
        Ok(content)
    }

    pub(super) fn busy(&self, what: &str) -> Box<dyn BusyIndicator> {
        self.watch.busy(what, None)
    }

    pub(super) fn done(&self, percent: u8) {
        self.watch.done(percent);
    }

    /// The findings of the request so far.
    pub(super) fn so_far(&self) -> Vec<Diagnostic> {
        self.findings.borrow().clone()
    }

    /// All findings of the request.
    pub(super) fn into_findings(self) -> Vec<Diagnostic> {
        self.findings.into_inner()
    }
}
