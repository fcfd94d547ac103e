//! Threads, channels and signals: the only place that knows all rooms.

mod acquisition;
mod asking;
mod attachments;
mod marks;
mod recorder;
mod session;
mod signals;

pub use acquisition::{AcquireError, Acquisition, Ending, Options, Progress, Summary};
pub use attachments::{Attachments, PlanError};
pub use marks::{DeviceTime, Marks};
pub use session::zero;
pub use signals::stop_on_signal;
