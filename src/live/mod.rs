//! The web side of the service: HTTP API, live stream, pages, metrics.
//!
//! This module knows no ports and captures. It reads a watch channel and a lossy broadcast and calls a [`Service`], so
//! that no client can slow the recorder down or end a run by disconnecting.

mod catalogue;
pub use catalogue::ServiceFinding;

mod access;
mod api;
mod asking;
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
mod users;
mod view;
mod work;
mod workbench;

use std::fmt::Display;
use std::sync::{Arc, Mutex};

use axum::Router;
use axum::routing::MethodRouter;
use dbbd_job::page::PageFile;
use users::EventList;

pub use access::Access;
pub use api::{OPENAPI, cell_site, routes};
#[cfg(feature = "archive")]
pub use plant::plant_site;
pub use server::serve;
pub use service::{
    Act, Catalogue, CheckItem, ConnectRequest, Ended, JobKind, JobRequest, ResultFile, RunEntry, RunState,
    Service, StartRequest,
};
pub use users::{KnownUser, Role, Token, User};
pub use view::{
    Alarm, Archiving, Device, Frame, LastRun, Message, MountingNote, MountingState, NextPose, Point,
    ReadingRange, RunCounts, RunStatus, State, Status,
};

pub use work::{
    EvaluationJob, ExcludedRows, ExplainedFinding, JobEdit, JobInForce, JobState, NewRobot, ProgramUpload,
    RobotSummary, RobotWork, RunChoice, StepAction, StepOptions, StepReport, StepState, StepVerdict,
    UploadedFile, WorkStep, Workbench,
};

/// A path, its methods as `GET` or `GET, POST`, and its handlers.
type Route<A> = (&'static str, &'static str, MethodRouter<A>);

/// Receives warnings about clients.
pub trait Journal: Send + Sync + 'static {
    /// Logs a warning. Repeated warnings are counted and logged less often.
    fn warn(&self, event: &'static str, fields: &[(&str, &dyn Display)]);
}

/// The data of the middleware.
struct Gate {
    access: Arc<Access>,
    journal: Arc<dyn Journal>,
    files: &'static [PageFile],
    /// Source of `form-action` in the content security policy.
    form_action: &'static str,
    /// The page that asks for the token, if `files` has no page that asks for it.
    sign_in: Option<String>,
    /// List of the changes by users.
    events: Mutex<EventList>,
}

/// Pages and API behind the middleware.
#[derive(Clone)]
pub struct Site {
    router: Router,
    journal: Arc<dyn Journal>,
}
