//! A protocol's sample and a capture's are the same numbers; neither room knows the other.

use crate::capture;
use crate::protocol;
use crate::units::DeviceTicks;

impl From<&protocol::Sample> for capture::Sample {
    fn from(sample: &protocol::Sample) -> Self {
        Self {
            reading_mm: sample.reading_mm,
            sequence: sample.sequence,
            ticks: sample.ticks.map(|ticks| ticks.0),
            trigger: sample.trigger,
            temperature_c: sample.temperature_c,
            valid: sample.valid,
            status: sample.status,
            offset: sample.offset,
        }
    }
}

impl From<&capture::Sample> for protocol::Sample {
    fn from(sample: &capture::Sample) -> Self {
        Self {
            reading_mm: sample.reading_mm,
            sequence: sample.sequence,
            ticks: sample.ticks.map(DeviceTicks),
            trigger: sample.trigger,
            temperature_c: sample.temperature_c,
            valid: sample.valid,
            status: sample.status,
            offset: sample.offset,
        }
    }
}
