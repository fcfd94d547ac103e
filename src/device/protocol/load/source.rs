//! A definition's text, to point into.

use std::ops::Range;

use super::params::Resolved;
use crate::diagnostic::{Diagnostic, Finding};

/// Where messages point to.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) file: &'a str,
    pub(super) text: &'a str,
    pub(super) resolved: &'a Resolved,
}

impl Source<'_> {
    /// What is wrong at a place of the file.
    pub(super) fn wrong(&self, span: Range<usize>, finding: impl Finding) -> Diagnostic {
        Diagnostic::span(self.file, self.text, self.resolved.original(span), finding)
    }

    /// What is wrong with a table, at its head.
    pub(super) fn table(&self, table: &str, finding: impl Finding) -> Diagnostic {
        let start = self.resolved.text.find(&format!("[{table}]")).unwrap_or(0);
        self.wrong(start..start, finding)
    }

    /// What is wrong with the value of a key, at its first place behind the head of its table (empty: that of the file).
    pub(super) fn key(&self, table: &str, key: &str, finding: impl Finding) -> Diagnostic {
        let text = &self.resolved.text;
        let head = if table.is_empty() { Some(0) } else { text.find(&format!("[{table}]")) };
        let head = head.unwrap_or(0);
        let behind = text.get(head..).unwrap_or_default();
        let value = behind.match_indices(key).find_map(|(at, _)| {
            let (before, after) = (&behind[..at], &behind[at + key.len()..]);
            let value =
                after.trim_start_matches([' ', '\t']).strip_prefix('=')?.trim_start_matches([' ', '\t']);
            let whole = !before.ends_with(|c: char| c.is_alphanumeric() || c == '_');
            whole.then(|| behind.len() - value.len())
        });
        let start = head + value.unwrap_or(0);
        self.wrong(start..start, finding)
    }
}
