//! What the alignment of dwells with poses rests on.

/// Evidence of a detected dwell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DwellEvidence {
    /// Start, s of the stream.
    pub start_s: f64,
    /// Standard deviation of the start, s.
    pub start_sd_s: f64,
    /// Duration, s, if it is known.
    pub duration_s: Option<f64>,
    /// Reading plus length of the bar, mm.
    pub length_mm: f64,
    /// Whether the clock broke since the dwell before.
    pub after_break: bool,
}

/// Lengths that a model predicts for each pose.
#[derive(Clone, Copy, Debug)]
pub struct ExpectedLengths<'a> {
    pub length_mm: &'a [f64],
    /// Their standard deviation, mm.
    pub sigma_mm: f64,
}
