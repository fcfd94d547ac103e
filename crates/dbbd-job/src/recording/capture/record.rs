//! The records of a capture.

use serde::{Deserialize, Serialize};

use dbbd_device::axes::AxesProtocol;
use dbbd_device::port::StampAccuracy;
use dbbd_model::base::units::HostNs;
use dbbd_model::measurement::sample::Sample;
use dbbd_model::provenance::DataOrigin;

/// A record with the host's monotonic time.
#[derive(Clone, Debug, PartialEq)]
pub struct StampedRecord {
    pub host: HostNs,
    pub record: CaptureRecord,
}

#[derive(Clone, Debug, PartialEq)]
pub enum CaptureRecord {
    /// A file in force during the run: `plan.csv`, `plan.json`, `robot.toml`, `job.toml`, `protocol.toml`.
    Attachment {
        name: String,
        content: Vec<u8>,
    },
    /// Bytes of the bar as received, stamped with the time of the first.
    Raw(Vec<u8>),
    /// Decoded samples of one host time, in order.
    Samples(Vec<Sample>),
    /// A fault of the decoder, as JSON of [`dbbd_device::protocol::LineFault`].
    Fault(Vec<u8>),
    /// Bytes of the controller that publishes its axes: a datagram, or one read.
    Axes(Vec<u8>),
    Event(RunEvent),
}

/// An event of the run, besides the data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum RunEvent {
    Started {
        /// Wall clock, ns since the Unix epoch.
        unix_ns: u64,
        version: String,
    },
    Opened {
        port: String,
        /// Transport and delay of its time stamps; missing in captures of older versions.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        stamps: Option<StampAccuracy>,
    },
    /// Where the readings come from, as the line shows by now: written at each opening, and when the mark of a simulated bar
    /// comes. Missing in captures of older versions.
    Origin { origin: DataOrigin },
    /// A connection to the controller that publishes its axes.
    AxesOpened { address: String, protocol: AxesProtocol },
    /// Nothing was received for a while, or sequence numbers are missing.
    Gap {
        seconds: Option<f64>,
        /// Number of missing samples, if known.
        missing: Option<u64>,
        reason: String,
    },
    /// Events that have no record of their own, because too many came within a second.
    Withheld {
        gaps: u64,
        /// Number of samples that are missing in these gaps, as far as it is known.
        missing: u64,
        /// Remarks, actions and findings.
        others: u64,
    },
    /// A telegram of the controller: phase 1 at the start of a dwell, 2 at its end.
    Controller {
        index: u32,
        phase: u8,
        /// Measured axis angles, degrees.
        axes_deg: [f64; 6],
    },
    /// A remark of the operator.
    Mark { text: String },
    /// An action of the operator on the page, before the run or during it.
    Operator {
        /// Wall clock, ms since the Unix epoch.
        unix_ms: u64,
        /// `connect`, `zero`, `checked`, ..
        action: String,
        detail: String,
    },
    /// A finding of the mounting monitor.
    Finding { code: String, text: String },
    /// The run ended properly; a run without this record was cut off.
    Ended(RunEnd),
}

impl RunEvent {
    /// The number of gaps that the event records, and of the samples known to be missing in them.
    pub fn gaps(&self) -> (u64, u64) {
        match self {
            Self::Gap { missing, .. } => (1, missing.unwrap_or(0)),
            Self::Withheld { gaps, missing, .. } => (*gaps, *missing),
            Self::Started { .. }
            | Self::Opened { .. }
            | Self::Origin { .. }
            | Self::AxesOpened { .. }
            | Self::Controller { .. }
            | Self::Mark { .. }
            | Self::Operator { .. }
            | Self::Finding { .. }
            | Self::Ended(_) => (0, 0),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunEnd {
    pub reason: String,
    pub samples: u64,
    /// Samples that did not reach the disk.
    pub lost: u64,
}
