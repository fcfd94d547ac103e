//! Poses of a workspace, from a table.

use std::collections::HashSet;
use std::path::Path;

use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::estimation::EstimationFinding;
use dbbd_model::measurement::{self, MeasurementFinding, Measurements};
use dbbd_model::robot::{AXES, AxisAngles, Robot};

use super::RequestSession;

/// Reads the poses of a workspace from a table with the columns a1_deg..a6_deg.
pub(super) fn read_workspace(
    path: &Path,
    robot: &Robot,
    session: &RequestSession<'_>,
) -> Result<Vec<[f64; AXES]>, Diagnostic> {
    let poses = session.table(path, Measurements::poses_from_table)?;
    let axes: Vec<AxisAngles> = poses.iter().map(|pose| pose.axes).collect();
    let (workspace, beyond) =
        checked_workspace(&axes, robot).map_err(|finding| Diagnostic::file(path.display(), finding))?;
    session.findings_in(path.display(), beyond);
    Ok(workspace)
}

/// The poses of a workspace, and a finding if the robot's limits do not allow them.
///
/// # Errors
/// There are too few of them.
pub fn checked_workspace(
    poses: &[AxisAngles],
    robot: &Robot,
) -> Result<(Vec<[f64; AXES]>, Option<MeasurementFinding>), EstimationFinding> {
    /// Minimum number of poses: with fewer, the rigid alignment would absorb the robot's error.
    const MIN_ALIGNED_POSES: usize = 10;
    let different: HashSet<_> = poses.iter().map(|axes| axes.degrees().map(f64::to_bits)).collect();
    if different.len() < MIN_ALIGNED_POSES {
        return Err(EstimationFinding::SmallWorkspace { poses: different.len(), least: MIN_ALIGNED_POSES });
    }
    let beyond = measurement::beyond((1..).zip(poses.iter().copied()), robot.controller());
    Ok((poses.iter().map(|axes| axes.radians()).collect(), beyond))
}
