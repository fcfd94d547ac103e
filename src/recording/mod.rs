//! From recorded bytes to measurements: the capture file, the device's clock, dwells, the matching of dwells to poses,
//! whole runs, imported traces.

pub mod axes;
pub mod bar_check;
pub mod capture;
pub mod device_clock;
pub mod dwell;
pub mod import;
mod lower_hull;
pub mod matching;
pub mod mounting;
pub mod reports;
pub mod run;
pub mod stream;
pub mod strobe_decoder;
pub mod telegram;
pub mod timeline;

pub use device_clock::{Break, ClockMap, DeviceClock, DeviceTime, Stamp};
pub use dwell::{Dwell, DwellReading, measure};
pub use lower_hull::Segment;
pub use reports::{Report, reported_axes};
pub use stream::{SequenceStep, Stream, StreamBuilder, sequence_step};
pub use strobe_decoder::{StrobeDecoder, StrobeEvent, StrobedDwell, strobed_dwells};
pub use telegram::{Heard, LONGEST_TELEGRAM, Telegram, TelegramReader};
pub use timeline::Timeline;

pub use crate::program::krl::run_number;
