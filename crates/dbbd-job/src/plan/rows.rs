//! The rows of a plan.

use serde::{Deserialize, Serialize};

use dbbd_model::measurement::PoseKind;
use dbbd_model::robot::{AXES, Approach, BallId};

/// The kind of motion to a row's pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MotionKind {
    /// All axes move together, to the axis angles.
    Ptp,
    /// The ball moves on a straight line.
    Lin,
    /// The ball moves on an arc, through the auxiliary point in the transit row before.
    Circ,
}

/// One row of the plan: a pose of the tool ball and what happens there. The fields are the columns of `plan.csv`, in their order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanRow {
    /// Number of the row, from 1, over all rows.
    pub index: u32,
    /// Number of the circle, from 1; 0 for rows of no circle.
    pub circle: u32,
    /// The base ball.
    pub centre: BallId,
    pub kind: PoseKind,
    pub motion: MotionKind,
    /// Tool ball in the robot base, mm, as KRL prints it (three decimals).
    pub xyz_mm: [f64; 3],
    /// KUKA's A, B, C of the flange's orientation, degrees, as KRL prints them (four decimals).
    pub abc_deg: [f64; 3],
    /// The controller's axis angles, degrees.
    pub axes_deg: [f64; AXES],
    pub status: u8,
    pub turn: u8,
    /// Nominal distance between the ball centres, mm.
    pub length_mm: f64,
    /// Time at rest for the measurement, s; 0 in transit.
    pub dwell_s: f64,
}

impl PlanRow {
    /// Whether the row is the auxiliary point of an arc, or the end of a pass.
    pub fn is_auxiliary(&self) -> bool {
        self.kind == PoseKind::Transit && self.motion == MotionKind::Circ
    }
}

/// The sense in which each axis approaches each row.
pub(super) fn approaches(rows: &[PlanRow]) -> impl Iterator<Item = Approach> {
    Approach::along(rows.iter().map(|row| row.axes_deg.map(f64::to_radians)))
}
