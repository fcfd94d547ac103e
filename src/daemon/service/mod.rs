//! The service: one device, one run at a time, jobs, and the state that everybody sees.

mod answers;
mod archiving;
mod begin;
mod catalogue;
mod config;
mod jobs;
mod log;
mod names;
mod notify;
mod reading;
mod runs;
mod serve;
mod state;
mod trial_cell;

pub use config::{Config, Door};
pub use log::{Level, Log};
#[cfg(feature = "archive")]
pub use serve::serve_plant;
pub use serve::{abort_on_panic, serve};
pub use trial_cell::{Bench, Cell, Program};
