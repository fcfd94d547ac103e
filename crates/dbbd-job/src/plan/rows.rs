//! The rows of a plan, and the place of each on its circle.

use serde::{Deserialize, Serialize};

use super::Plan;
use super::circle::PlannedCircle;
use dbbd_model::measurement::PoseKind;
use dbbd_model::robot::AXES;

/// How the robot moves to a row's pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MotionKind {
    /// All axes together, to the axis angles.
    Ptp,
    /// The ball on a straight line.
    Lin,
    /// The ball on an arc, through the auxiliary point in the transit row before.
    Circ,
}

/// One row of the plan: a pose of the tool ball and what happens there. The fields are the columns of `plan.csv`, in their order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanRow {
    /// From 1, over all rows.
    pub index: u32,
    /// Number of the circle, from 1; 0 for rows of no circle.
    pub circle: u32,
    /// Number of the base ball, from 1.
    pub centre: u32,
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
    /// How long the robot is at rest for the measurement, s; 0 in transit.
    pub dwell_s: f64,
}

impl PlanRow {
    /// Whether it is the auxiliary point of an arc, or the end of a pass.
    pub fn is_auxiliary(&self) -> bool {
        self.kind == PoseKind::Transit && self.motion == MotionKind::Circ
    }
}

/// The place of a dwell on its circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CirclePlace {
    /// Angle of its pose as rounded for the program, degrees from the plane's first axis, 0..360.
    pub angle_deg: f64,
    /// Whether the pass goes against growing angles.
    pub clockwise: bool,
    pub radius_mm: f64,
}

impl Plan {
    /// The place of each row on its circle; `None` for transit rows and rows of no circle.
    pub fn circle_places(&self) -> Vec<Option<CirclePlace>> {
        let job = &self.header.job;
        let mut measured = vec![0_u32; job.circles.len()];
        self.rows
            .iter()
            .map(|row| {
                let table = job.circle(row.circle).filter(|_| row.kind != PoseKind::Transit)?;
                let circle = PlannedCircle::new(job, table, row.circle).ok()?;
                let visited = measured.get_mut(row.circle as usize - 1)?;
                let clockwise = table.is_clockwise(*visited >= table.points);
                *visited += u32::from(row.kind == PoseKind::Measure);
                let angle_deg = circle.angle_deg(row.xyz_mm.into());
                Some(CirclePlace { angle_deg, clockwise, radius_mm: circle.radius })
            })
            .collect()
    }
}
