//! Acquisition threads, channels and signals, and the service.

mod acquisition;
mod axes;
mod ekrl;
mod identify;
mod live_state;
mod mount_detector;
mod program_end;
mod recorder;
mod schedule;
mod service;
mod session;
mod signals;

pub use acquisition::{Acquisition, Controller, Ending, Options, Summary};
pub use axes::AxesSource;
pub use ekrl::Server;
pub use identify::{Attempt, Search};
pub use live_state::{Feed, LiveRun, LiveState};
pub use mount_detector::{MountDetector, Reading};
pub use recorder::{Progress, Recorder};
pub use schedule::{ALARM_SHARE, Schedule};
#[cfg(feature = "archive")]
pub use service::serve_plant;
pub use service::{Cell, Config, Endpoint, Halt, Level, Log, MakeCell, abort_on_panic, serve};
pub use session::zero;
pub use signals::stop_on_signal;
