//! Threads, channels and signals: the only place that knows all rooms.

mod acquisition;
mod attachments;
mod course;
mod ekrl;
mod feed;
mod marks;
mod polling;
mod progress;
mod recorder;
mod reports;
mod service;
mod session;
mod signals;

pub use acquisition::{AcquireError, Acquisition, Ending, Options, Summary};
pub use attachments::{Attachments, PlanError};
pub use course::{ALARM_SHARE, Course, Watch};
pub use ekrl::{ListenError, Server};
pub use feed::{Feed, Shown};
pub use marks::{DeviceTime, Marks};
pub use progress::Progress;
pub use recorder::Recorder;
pub use reports::Driven;
pub use service::{Bench, Cell, Config, Level, Log, ServeError, serve};
pub use session::zero;
pub use signals::stop_on_signal;
