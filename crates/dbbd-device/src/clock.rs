//! The only place that reads a clock.

use std::sync::OnceLock;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use dbbd_model::base::units::HostNs;

/// The time of the monotonic clock since the first call in this process.
#[allow(clippy::disallowed_methods)] // this is the one place
pub fn now() -> HostNs {
    static START: OnceLock<Instant> = OnceLock::new();
    let start = *START.get_or_init(Instant::now);
    HostNs(u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX))
}

/// The time of the wall clock in nanoseconds since the Unix epoch; 0 if the clock is set before it.
#[allow(clippy::disallowed_methods)] // this is the one place
pub fn unix_ns() -> u64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |since| u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
}

/// Sleeps for at least `seconds`; not at all if the number is not positive.
pub fn sleep(seconds: f64) {
    if seconds > 0.0 {
        std::thread::sleep(Duration::from_secs_f64(seconds.min(1e9)));
    }
}
