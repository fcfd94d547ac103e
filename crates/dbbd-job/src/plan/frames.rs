//! The frames of the program: converts poses into the commanded numbers, and back.

use super::{MotionTable, PlanRow};
use dbbd_model::robot::Pose;

/// $TOOL and $BASE. The tool's origin is the tool ball; only the tool's orientation is given by the job.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanFrames {
    /// The tool's orientation relative to the flange, without a shift.
    tool: Pose,
    /// The base frame in the robot base.
    base: Pose,
    /// Whether tool and base are null, so that poses are commanded as they are.
    null: bool,
}

impl MotionTable {
    /// The frames of the job; a frame that the job does not give is null.
    pub fn frames(&self) -> PlanFrames {
        let [.., a, b, c] = self.tool.unwrap_or_default();
        let [x, y, z, u, v, w] = self.base.unwrap_or_default();
        PlanFrames {
            tool: Pose::from_kuka([0.0; 3], [a, b, c]),
            base: Pose::from_kuka([x, y, z], [u, v, w]),
            null: [a, b, c, x, y, z, u, v, w].iter().all(|value| *value == 0.0),
        }
    }
}

impl PlanFrames {
    /// X, Y, Z and A, B, C of a pose (tool ball with the flange's orientation, robot base) as KRL prints them.
    pub(super) fn as_printed(&self, pose: &Pose) -> ([f64; 3], [f64; 3]) {
        let pose = if self.null { *pose } else { self.base.inverse().then(pose).then(&self.tool) };
        (<[f64; 3]>::from(pose.position).map(|x| rounded(x, 1e3)), pose.abc_deg().map(|x| rounded(x, 1e4)))
    }

    /// A row's numbers as KRL prints them.
    pub fn printed(&self, row: &PlanRow) -> ([f64; 3], [f64; 3]) {
        // At B = 90 degrees A and C are ambiguous: keep the angles of the row.
        if self.null {
            (row.xyz_mm, row.abc_deg)
        } else {
            self.as_printed(&Pose::from_kuka(row.xyz_mm, row.abc_deg))
        }
    }

    /// The pose that the controller drives for printed numbers, in the robot base: X, Y, Z and the flange's A, B, C.
    pub(super) fn as_driven(&self, (xyz_mm, abc_deg): ([f64; 3], [f64; 3])) -> ([f64; 3], [f64; 3]) {
        if self.null {
            return (xyz_mm, abc_deg);
        }
        let pose = self.base.then(&Pose::from_kuka(xyz_mm, abc_deg)).then(&self.tool.inverse());
        (pose.position.into(), pose.abc_deg())
    }
}

/// The value rounded to a fraction of 1, without a negative zero.
fn rounded(value: f64, parts: f64) -> f64 {
    (value * parts).round() / parts + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::PoseKind;
    use crate::plan::example::row;

    /// A base frame that is shifted and turned by 90 degrees about Z sees (X, Y) of the robot as (Y - y, x - X).
    #[test]
    fn pose_is_printed_in_the_frames_and_driven_back() {
        let motion = MotionTable {
            base: Some([100.0, 20.0, 3.0, 90.0, 0.0, 0.0]),
            tool: Some([0.0, 0.0, 0.0, 30.0, 0.0, 0.0]),
            ..MotionTable::default()
        };
        let frames = motion.frames();
        let row =
            PlanRow { xyz_mm: [107.0, 25.0, 13.0], abc_deg: [100.0, 0.0, 0.0], ..row(PoseKind::Measure) };
        let (xyz_mm, abc_deg) = frames.printed(&row);
        assert_eq!(xyz_mm, [5.0, -7.0, 10.0]);
        // The tool is turned by 30 degrees relative to the flange: 100 - 90 + 30.
        assert_eq!(abc_deg, [40.0, 0.0, 0.0]);
        let (driven_mm, driven_deg) = frames.as_driven((xyz_mm, abc_deg));
        for (found, expected) in
            driven_mm.iter().chain(&driven_deg).zip(row.xyz_mm.iter().chain(&row.abc_deg))
        {
            assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
        }
    }

    #[test]
    fn pose_is_printed_with_three_and_four_decimals() {
        let frames = MotionTable::default().frames();
        let pose = Pose::from_kuka([1.000_51, -2.000_49, 0.0], [10.000_051, -0.000_01, 5.0]);
        let (xyz_mm, abc_deg) = frames.as_printed(&pose);
        assert_eq!(xyz_mm, [1.001, -2.0, 0.0]);
        assert_eq!(abc_deg, [10.0001, 0.0, 5.0]);
        assert!(abc_deg[1].is_sign_positive());
        // Without frames the program has the numbers of the row, whatever A and C are at B = 90 degrees.
        let steep = PlanRow { abc_deg: [10.0, 90.0, 20.0], ..row(PoseKind::Measure) };
        assert_eq!(frames.printed(&steep).1, [10.0, 90.0, 20.0]);
    }
}
