//! A definition's text, to point into.

use std::ops::Range;

use super::params::Resolved;
use crate::diag::Diagnostic;

/// Where messages point to.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) file: &'a str,
    pub(super) text: &'a str,
    pub(super) resolved: &'a Resolved,
}

impl Source<'_> {
    /// What is wrong at a place of the file.
    pub(super) fn wrong(&self, span: Range<usize>, message: impl Into<String>) -> Diagnostic {
        Diagnostic::span(self.file, self.text, self.resolved.original(span), message)
    }
}
