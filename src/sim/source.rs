//! What a virtual bar measures, and where it has that from.

/// What the bar measures at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Reading, mm; longer is positive.
    pub reading_mm: f64,
    /// Whether the controller's strobe is high.
    pub strobe: bool,
    /// Whether the reading can be trusted (inside the stroke, not too fast).
    pub valid: bool,
    /// Temperature of the bar, degrees Celsius.
    pub temperature_c: f64,
}

/// What the bar is mounted on. A closure `FnMut(f64) -> Option<Reading>` is one too.
pub trait Source {
    /// The reading at a device time, s since the first start; times only go forward. None ends it.
    fn reading(&mut self, t_s: f64) -> Option<Reading>;

    /// Whether the robot's program has ended: readings may go on, and the bar ends when the host
    /// says stop or goes away. Until then it waits for the host to come again.
    fn over(&self) -> bool {
        false
    }

    /// Spoils a frame on its way, to try what a bad line does.
    fn spoil(&mut self, _frame: &mut Vec<u8>) {}
}

impl<F: FnMut(f64) -> Option<Reading>> Source for F {
    fn reading(&mut self, t_s: f64) -> Option<Reading> {
        self(t_s)
    }
}
