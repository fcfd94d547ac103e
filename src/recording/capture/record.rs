//! What a capture holds.

use serde::{Deserialize, Serialize};

use crate::base::units::HostNs;
use crate::device::axes::AxesProtocol;
use crate::device::port::Stamps;
use crate::measurement::sample::Sample;

/// A record with the host's monotonic time at which it came about.
#[derive(Clone, Debug, PartialEq)]
pub struct Stamped {
    pub host: HostNs,
    pub record: Record,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// A file in force during the run: `plan.csv`, `plan.json`, `robot.toml`, `job.toml`, `protocol.toml`.
    Attachment { name: String, content: Vec<u8> },
    /// Bytes as they came; the stamp is that of the first.
    Raw(Vec<u8>),
    /// Decoded samples of one host time, in order.
    Samples(Vec<Sample>),
    /// A decoder's fault, as JSON of the protocol's fault.
    Fault(Vec<u8>),
    /// What came from the controller that publishes its axes: a datagram, or the bytes of one read.
    Axes(Vec<u8>),
    /// What happened around the bytes.
    Event(Event),
}

/// What happened around the bytes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The run began, at this wall-clock time (ns since the Unix epoch), with this version of dbbd.
    Started {
        /// Wall clock, ns since the Unix epoch.
        unix_ns: u64,
        version: String,
    },
    /// The port was opened.
    Opened {
        /// The port's address.
        port: String,
        /// What carries its bytes, and what their times are worth; captures of older versions have none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        stamps: Option<Stamps>,
    },
    /// The controller that publishes its axes is listened to, or was connected to.
    AxesOpened { address: String, protocol: AxesProtocol },
    /// Nothing was received for a while, or samples are missing by their sequence numbers.
    Gap {
        /// How long, s, where it is known.
        seconds: Option<f64>,
        /// How many samples are missing, where it is known.
        missing: Option<u64>,
        reason: String,
    },
    /// A report of the controller: phase 1 is the start of a dwell, 2 its end.
    Controller {
        index: u32,
        phase: u8,
        /// Measured axis angles, degrees.
        axes_deg: [f64; 6],
    },
    /// A remark of the operator.
    Mark { text: String },
    /// What the operator did on the page, before the run or during it.
    Operator {
        /// Wall clock, ms since the Unix epoch.
        unix_ms: u64,
        /// What: `connect`, `zero`, `checked`, ..
        action: String,
        /// With what.
        detail: String,
    },
    /// What the live reading showed of the mounting.
    Finding {
        /// Its code.
        code: String,
        /// Its sentence.
        text: String,
    },
    /// The run ended as it should, and why; a run without this was cut off.
    Ended(RunEnd),
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunEnd {
    pub reason: String,
    pub samples: u64,
    /// Samples that were lost on the way to the disk.
    pub lost: u64,
}
