//! The parts of a page in a browser, independent of how the page is served.

use std::fs::File;

/// A file of a page. It is served without a token, so it must hold no secret.
#[derive(Clone, Copy, Debug)]
pub struct PageFile {
    pub path: &'static str,
    /// Content type.
    pub kind: &'static str,
    pub content: &'static str,
}

/// An open file to send.
#[derive(Debug)]
pub struct Download {
    pub file: File,
    pub name: String,
    /// Size of the file when it was opened, bytes.
    pub bytes: u64,
}
