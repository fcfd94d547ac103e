//! The rows of `plan.csv`.

use serde::{Deserialize, Serialize};

use crate::measurement::Kind;
use crate::robot::AXES;

/// How the robot comes to a row's pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Motion {
    /// All axes together, to the axis angles.
    Ptp,
    /// The ball on a straight line.
    Lin,
    /// The ball on an arc, through the auxiliary point in the transit row before.
    Circ,
}

/// One row of the plan: a pose of the tool ball and what happens there.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanRow {
    /// Number from 1, over all rows.
    pub index: u32,
    /// Number of the circle, from 1; 0 for rows of no circle.
    pub circle: u32,
    /// Number of the base ball, from 1.
    pub centre: u32,
    /// What the row is for.
    pub kind: Kind,
    /// How the robot comes there.
    pub motion: Motion,
    /// Tool ball in the robot base, mm, as KRL prints it (three decimals).
    pub xyz_mm: [f64; 3],
    /// KUKA's A, B, C of the flange's orientation, degrees, as KRL prints them (four decimals).
    pub abc_deg: [f64; 3],
    /// The controller's axis angles there, degrees.
    pub axes_deg: [f64; AXES],
    /// KUKA's status bits.
    pub status: u8,
    /// KUKA's turn bits.
    pub turn: u8,
    /// Nominal distance between the ball centres, mm.
    pub length_mm: f64,
    /// How long the robot is at rest for the measurement, s; 0 in transit.
    pub dwell_s: f64,
}

impl PlanRow {
    /// Whether it is no pose to measure at but a point through which an arc goes, or the end of a pass.
    pub fn is_auxiliary(&self) -> bool {
        self.kind == Kind::Transit && self.motion == Motion::Circ
    }
}
