//! The service: one device, one run at a time, jobs, and the state that all clients see.

mod answers;
#[cfg(feature = "archive")]
mod archiving;
mod begin;
mod catalogue;
mod config;
mod jobs;
mod log;
mod runs;
mod serve;
mod state;

pub use config::{Endpoint, ServiceConfig};
pub use log::{LogLevel, ServiceLog};
#[cfg(feature = "archive")]
pub use serve::serve_plant;
pub use serve::{abort_on_panic, serve};
pub use state::{HaltBehaviour, MakeCell, SimulatedCell};
