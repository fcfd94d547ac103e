//! Types for the two times that are easily confused: the counter of a device and the clock of the host.
//!
//! Lengths and angles have their unit in their name (`length_mm`, `a1_deg`, `_rad`).

use serde::{Deserialize, Serialize};

/// Nanoseconds of the host's monotonic clock since an arbitrary start (see `dbbd_device::clock`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct HostNs(pub u64);

impl HostNs {
    /// Seconds from `earlier` to `self`; negative if `self` came first.
    pub fn seconds_since(self, earlier: HostNs) -> f64 {
        (self.0 as i128 - earlier.0 as i128) as f64 * 1e-9
    }
}

/// Ticks of a device's counter as sent, not unwrapped. The protocol defines the length of a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct DeviceTicks(pub u64);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_between_times_have_a_sign() {
        let [early, late] = [HostNs(1_000_000_000), HostNs(3_500_000_000)];
        assert_eq!((late.seconds_since(early), early.seconds_since(late)), (2.5, -2.5));
    }
}
