//! The job file: bar, base balls, circles, motion, limits.

use serde::{Deserialize, Serialize};

/// What is to be measured, with what, and within which limits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// Name or file of the robot.
    pub robot: String,
    /// The bar.
    pub bar: Bar,
    /// The motion.
    #[serde(default)]
    pub motion: MotionTable,
}

/// The ball-bar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bar {
    /// Distance between the ball centres at reading zero, mm.
    pub length_mm: f64,
    /// Lowest and highest reading, mm.
    pub stroke_mm: [f64; 2],
}

/// How the robot moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionTable {
    /// Greatest speed of the ball, mm/s.
    pub feed_mm_s: f64,
    /// Wait after arrival before the strobe, s.
    pub settle_s: f64,
    /// Strobe time at a pose, s.
    pub dwell_s: f64,
    /// Digital outputs.
    pub outputs: Outputs,
}

impl Default for MotionTable {
    fn default() -> Self {
        Self { feed_mm_s: 20.0, settle_s: 0.5, dwell_s: 1.0, outputs: Outputs::default() }
    }
}

/// Digital outputs of the controller that mark the dwells.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Outputs {
    /// High during a dwell.
    pub strobe: u32,
    /// First and last output of the index, eight in all.
    pub index: [u32; 2],
}

impl Default for Outputs {
    fn default() -> Self {
        Self { strobe: 1, index: [9, 16] }
    }
}
