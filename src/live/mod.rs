//! The service as others see it: HTTP API, live stream, page, metrics.
//!
//! This room knows nothing of ports and captures: it reads a watch channel and a lossy broadcast, and asks
//! a [`Service`] to act. No client can slow the recorder or end a run by going away.

mod access;
mod api;
mod connections;
mod downloads;
mod guard;
mod guesses;
mod json;
mod metrics;
mod page;
#[cfg(feature = "archive")]
mod plant;
mod routes;
mod server;
mod service;
mod stall;
mod stream;
mod view;

pub use access::{Access, Token};
pub use api::OPENAPI;
pub use guard::{Journal, PageFile, Site};
#[cfg(feature = "archive")]
pub use plant::{Decided, Filter, Name, Order, Plant, PlantNumbers, Question, RunFilter, plant_site};
pub use routes::{cell_site, routes};
pub use server::serve;
pub use service::{
    Act, Catalogue, CheckItem, Download, Ended, Job, JobKind, JobRequest, JobState, ResultFile, RunEntry,
    RunState, Service, StartRequest,
};
pub use view::{
    Alarm, Archiving, Device, Frame, LastRun, Message, Mounting, MountingNote, NextPose, Point, RunStatus,
    State, Status,
};
