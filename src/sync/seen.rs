//! What was seen in the stream: where it stood still, and the dwells of these; and what lengths are expected.

/// No begin is known better, s: the controller's own waits and outputs jitter.
pub const LEAST_START_SD_S: f64 = 0.02;

/// A stretch in which the length did not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// Its begin, s of the stream.
    pub start_s: f64,
    /// Its end, s of the stream.
    pub end_s: f64,
    /// Standard deviation of the begin, s.
    pub start_sd_s: f64,
}

/// A dwell that was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Its begin, s of the stream.
    pub start_s: f64,
    /// Standard deviation of the begin, s; below [`LEAST_START_SD_S`] counts as that.
    pub start_sd_s: f64,
    /// How long it stood still, s, where that can be told.
    pub lasts_s: Option<f64>,
    /// Its reading plus the bar's length, mm.
    pub length_mm: f64,
    /// Whether the clock broke since the dwell before.
    pub after_break: bool,
}

/// Lengths that are expected, for each pose.
#[derive(Clone, Copy, Debug)]
pub struct Expected<'a> {
    /// Expected lengths, mm.
    pub length_mm: &'a [f64],
    /// Their standard deviation, mm.
    pub sigma_mm: f64,
}
