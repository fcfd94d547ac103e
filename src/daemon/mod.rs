//! Acquisition threads, channels and signals, and the service.

mod acquisition;
mod axes;
mod ekrl;
mod identify;
mod live_state;
mod mount_detector;
mod recorder;
mod schedule;
mod service;
mod session;
mod signals;

use dbbd_device::port::Port;
use dbbd_model::base::units::HostNs;

pub use acquisition::{Acquisition, AcquisitionOptions, AcquisitionSummary, ControllerConnections};
pub use axes::AxesSource;
pub use ekrl::EkrlServer;
pub use identify::{ProbeAttempt, ProtocolSearch};
pub use live_state::{LiveFeed, LiveRun, LiveState};
pub use mount_detector::{MountDetector, MountReading};
pub use recorder::{EndReason, Recorder, RunProgress};
pub use schedule::{ALARM_SHARE, Schedule};
#[cfg(feature = "archive")]
pub use service::serve_plant;
pub use service::{
    CellRequest, Endpoint, Explain, HaltBehaviour, LogLevel, MakeCell, MakeDemo, ServiceConfig, ServiceLog,
    ServiceParts, SimulatedCell, abort_on_panic, serve,
};
pub use session::zero_bar;
pub use signals::stop_on_signal;

/// An open and started bar.
struct OpenedBar {
    port: Port,
    /// Host time before the line was opened.
    began: HostNs,
    /// Number of discarded bytes of an earlier stream.
    stale: u64,
    /// Bytes of the stream that followed the answer to the start command.
    first: Vec<u8>,
}

/// Why a telegram does not belong to the program of the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TelegramMismatch {
    Run { expected: u32 },
    NoDwell,
}
