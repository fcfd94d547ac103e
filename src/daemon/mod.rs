//! Threads, channels and signals: the only place that knows all rooms.

mod acquisition;
mod axes;
mod ekrl;
mod identify;
mod live_state;
mod mount_detector;
mod polling;
mod program_end;
mod progress;
mod recorder;
mod schedule;
mod service;
mod session;
mod signals;
mod telegrams;

pub use acquisition::{Acquisition, Ending, Lines, Options, Summary};
pub use axes::AxesSource;
pub use ekrl::Server;
pub use identify::{Attempt, Search};
pub use live_state::{Feed, LiveState};
pub use mount_detector::{MountDetector, Reading};
pub use progress::Progress;
pub use recorder::Recorder;
pub use schedule::{ALARM_SHARE, Schedule};
#[cfg(feature = "archive")]
pub use service::serve_plant;
pub use service::{Bench, Cell, Config, Door, Level, Log, Program, abort_on_panic, serve};
pub use session::zero;
pub use signals::stop_on_signal;
