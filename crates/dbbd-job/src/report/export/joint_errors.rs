//! The errors of the joints as a table for post-processors: most targets leave them out.

use dbbd_model::estimation::{JointPoint, joint_curve};
use dbbd_model::robot::{Joint, Robot};

/// `joint-errors.csv`: the correction of each axis in the axis's own sense, by the sense of approach, with its standard
/// deviation.
pub fn csv(robot: &Robot) -> String {
    let row = |joint: Joint, JointPoint { angle_deg, rising, falling, sd }: JointPoint| {
        let [rising, falling, sd] = [rising, falling, sd].map(f64::to_degrees);
        format!("{},{angle_deg:.3},{rising:.6},{falling:.6},{sd:.6}\n", joint.number())
    };
    let rows = Joint::ALL
        .into_iter()
        .flat_map(|joint| joint_curve(robot, joint).into_iter().map(move |point| row(joint, point)));
    ["axis,angle_deg,rising_deg,falling_deg,sd_deg\n".to_owned()].into_iter().chain(rows).collect()
}
