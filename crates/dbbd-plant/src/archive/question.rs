//! The question that a page of the plant answers, read from the page's address.

use serde::{Deserialize, Serialize};

/// A page of the plant.
#[derive(Clone, Debug, PartialEq)]
pub enum Question {
    Robots(Filter),
    Robot(Name),
    Bars(Filter),
    Bar(Name),
    Runs(RunFilter),
    /// The page of a run, found by the first digits of the SHA-256 of its capture.
    Run(String),
}

/// A search for robots or bars, and the page of the list.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Filter {
    /// A part of the name or the type.
    pub q: String,
    pub decision: Decided,
    pub order: Order,
    /// Number of the page, from 1. 0 also means the first page.
    pub page: u32,
}

/// The decision of a robot's last check.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Decided {
    #[default]
    #[serde(rename = "")]
    Any,
    Pass,
    Fail,
    Unchanged,
    Changed,
    Undecided,
    /// The robot was never checked.
    None,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    #[default]
    #[serde(alias = "")]
    Name,
    /// Sorted by the date of the last check, the oldest first.
    Check,
}

#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Name {
    pub name: String,
}

/// A search for runs.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct RunFilter {
    /// A part of robot, type, bar, cell or operator.
    pub q: String,
    pub robot: String,
    pub bar: String,
    pub cell: String,
    /// Dates. `until` is exclusive.
    pub since: String,
    pub until: String,
    /// Last run of the previous page: date, space, SHA-256.
    pub after: String,
}

/// The metrics of an archive: counts by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlantNumbers {
    pub runs: u64,
    pub results: u64,
    pub jobs: Vec<(&'static str, u64)>,
    pub robots: Vec<(&'static str, u64)>,
    /// Age of the oldest waiting job, s; 0 without one.
    pub oldest_waiting_s: f64,
}
