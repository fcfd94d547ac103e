//! The service: one device, one run at a time, jobs, and the state that everybody sees.

mod answers;
mod bench;
mod catalogue;
mod config;
mod jobs;
mod log;
mod names;
mod notify;
mod runs;
mod serve;
mod state;

pub use bench::{Bench, Cell};
pub use config::Config;
pub use log::{Level, Log};
pub use serve::{ServeError, serve};
