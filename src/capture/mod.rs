//! A run on disk: an append-only log of records that survives a kill.

pub mod record;

pub use record::{Event, Record, Stamped};
