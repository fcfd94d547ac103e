//! The web side of the service: HTTP API, live stream, pages, metrics.
//!
//! This module knows no ports and captures. It reads a watch channel and a lossy broadcast and calls a [`Service`], so
//! that no client can slow the recorder down or end a run by disconnecting.

mod catalogue;
pub use catalogue::ServiceFinding;

mod access;
mod api;
mod connections;
mod downloads;
mod failed_logins;
mod guard;
mod json;
mod metrics;
#[cfg(feature = "archive")]
mod plant;
mod server;
mod service;
mod stream;
mod view;

pub use access::{Access, Token};
pub use api::{OPENAPI, cell_site, routes};
pub use guard::{Journal, Site};
#[cfg(feature = "archive")]
pub use plant::plant_site;
pub use server::serve;
pub use service::{
    Act, Catalogue, CheckItem, Ended, EvaluationJob, JobKind, JobRequest, JobState, ResultFile, RunEntry,
    RunState, Service, StartRequest,
};
pub use view::{
    Alarm, Archiving, Device, Frame, LastRun, Message, Mounting, MountingNote, NextPose, Point, RunStatus,
    State, Status,
};
