//! Newtypes for the quantities that are easily confused at the edges.
//!
//! Lengths and angles carry their unit in their name (`length_mm`, `a1_deg`, `_rad`); what has a
//! type of its own here is time, where a device's counter and the host's clock meet.

use serde::{Deserialize, Serialize};

/// Nanoseconds of the host's monotonic clock since an arbitrary start (see [`crate::base::clock`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct HostNs(pub u64);

impl HostNs {
    /// Seconds from `earlier` to `self`; negative when `self` came first.
    pub fn seconds_since(self, earlier: HostNs) -> f64 {
        (self.0 as i128 - earlier.0 as i128) as f64 * 1e-9
    }
}

/// Ticks of a device's own counter, as sent (not unwrapped); the tick's length is the protocol's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct DeviceTicks(pub u64);
