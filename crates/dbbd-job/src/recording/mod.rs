//! Makes measurements from recorded bytes: the capture file, the device's clock, dwells, the matching of dwells to
//! poses, whole runs, imported traces.

mod bar_catalogue;
pub use bar_catalogue::BarFinding;

mod catalogue;
pub use catalogue::RecordingFinding;

pub mod axes;
pub mod bar_check;
pub mod capture;
pub mod device_clock;
pub mod dwell;
pub mod import;
pub mod matching;
pub mod mounting;
pub mod reports;
pub mod run;
pub mod stream;
pub mod strobe_decoder;
pub mod telegram;

pub use device_clock::{
    ClockBreak, ClockMap, ClockSegment, ClockStamp, ClockStamps, DeviceClock, DeviceTime,
};
pub use dwell::{Dwell, DwellReading, reading_between};
pub use reports::{DwellReport, reported_axes};
pub use stream::{Readings, SampleStream, SampleTimeline, SequenceStep, StreamBuilder, sequence_step};
pub use strobe_decoder::{StrobeDecoder, StrobeEvent, StrobedDwell, strobed_dwells};
pub use telegram::{LONGEST_TELEGRAM, Telegram, TelegramReader, TelegramResult};

pub use crate::program::krl::run_number;

#[cfg(test)]
mod tests;
