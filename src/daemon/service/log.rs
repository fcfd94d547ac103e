//! What the service has to say while it goes on: events with fields, for a line each.

use std::fmt::Display;

/// How much an event matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// As it should be.
    Info,
    /// To be seen.
    Warning,
    /// Something failed.
    Error,
}

/// Where the service says what happens; it prints nothing itself.
pub trait Log: Send + Sync {
    /// Says an event and its fields.
    fn say(&self, level: Level, event: &str, fields: &[(&str, &dyn Display)]);
}
