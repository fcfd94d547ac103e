//! Threads, channels and signals: the only place that knows all rooms.

mod acquisition;
mod asking;
mod attachments;
mod feed;
mod marks;
mod recorder;
mod service;
mod session;
mod signals;

pub use acquisition::{AcquireError, Acquisition, Ending, Options, Progress, Summary};
pub use attachments::{Attachments, PlanError};
pub use feed::{ALARM_SHARE, Feed, Outlook, Shown};
pub use marks::{DeviceTime, Marks};
pub use service::{Bench, Cell, Config, Level, Log, ServeError, serve};
pub use session::zero;
pub use signals::stop_on_signal;
