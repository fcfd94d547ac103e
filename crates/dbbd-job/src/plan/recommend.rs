//! Recommendations for a refused plan: another orientation of the tool where a circle fails at the axis limits or the
//! wrist, or a stage before the plan where the length may leave the stroke.

use super::job::CircleTable;
use super::quantity::{CheckQuantity, PlanCheck};
use super::rig::runs;
use super::steps::circle_steps;
use super::{Job, PlanKinematics, PlanRow};
use crate::plan::PlanFinding;

/// The coarse grid of tilts and spins that are tried, degrees.
const TILTS_DEG: [f64; 7] = [0.0, 15.0, 30.0, 45.0, -15.0, -30.0, -45.0];
const SPINS_DEG: [f64; 12] =
    [0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 120.0, -120.0, 150.0, -150.0, 180.0];
/// Number of points by which a circle is tried, and the margin that these must keep, degrees.
const POINTS: u32 = 40;
const MARGIN_DEG: f64 = 1.0;
const STAGE_POINTS: u32 = 20;

/// For each circle that fails at axis limits, wrist or branch: a tilt and a spin that keep them at its points. For a
/// length that might leave the stroke: a stage. `lost` are the poses and paths that cannot be reached, `broken` the
/// limits that are not kept.
pub(super) fn recommendations(
    rig: &PlanKinematics<'_>,
    rows: &[PlanRow],
    lost: &[PlanFinding],
    broken: &[PlanCheck],
) -> Vec<PlanFinding> {
    let lost_row = |finding: &PlanFinding| {
        if let PlanFinding::Unreachable { row, .. } | PlanFinding::BranchLeft { row, .. } = finding {
            Some(*row)
        } else {
            None
        }
    };
    let by_orientation = |check: &&PlanCheck| {
        matches!(
            check.quantity,
            CheckQuantity::AxisMarginDeg
                | CheckQuantity::WristDeg
                | CheckQuantity::AxisJumpDeg
                | CheckQuantity::AxisSpeedPercent
        )
    };
    let steps = circle_steps(rig.job).unwrap_or_default();
    let circle_of = |row: u32| {
        let at = (row as usize).checked_sub(1)?;
        rows.get(at).map(|row| row.circle).or_else(|| steps.get(at).map(|step| step.circle))
    };
    let turned = broken.iter().filter(by_orientation).map(|check| check.row);
    let mut circles: Vec<u32> =
        lost.iter().filter_map(lost_row).chain(turned).filter_map(circle_of).collect();
    circles.sort_unstable();
    circles.dedup();
    let risky = broken
        .iter()
        .any(|check| matches!(check.quantity, CheckQuantity::StrokeRisk | CheckQuantity::RunRisk));
    let stage =
        (risky && !rig.job.circles.is_empty()).then_some(PlanFinding::StageFirst { points: STAGE_POINTS });
    circles.into_iter().filter_map(|number| orientation(rig, number)).chain(stage).collect()
}

fn orientation(rig: &PlanKinematics<'_>, circle: u32) -> Option<PlanFinding> {
    let table = rig.job.circle(circle)?;
    let mut grid = TILTS_DEG.iter().flat_map(|tilt| SPINS_DEG.iter().map(move |spin| (*tilt, *spin)));
    let found = grid.find(|&(tilt_deg, spin_deg)| {
        let points = table.points.min(POINTS);
        let tried = CircleTable { tilt_deg, spin_deg, points, ..table.clone() };
        let alone = Job { optimise: None, circles: vec![tried], ..rig.job.clone() };
        passes(&PlanKinematics { job: &alone, ..*rig })
    });
    Some(match found {
        Some((tilt_deg, spin_deg)) => PlanFinding::OrientationPasses { circle, tilt_deg, spin_deg },
        None => PlanFinding::NoOrientationPasses { circle },
    })
}

fn passes(rig: &PlanKinematics<'_>) -> bool {
    let Ok(steps) = circle_steps(rig.job) else { return false };
    runs(&steps).into_iter().all(|run| {
        let run = steps.get(run).unwrap_or_default();
        let starts = run.first().and_then(|first| rig.starts(first).ok()).unwrap_or_default();
        starts.iter().any(|start| {
            rig.follow(run, 1, start).is_ok_and(|branch| {
                let began = branch.rows.first().map(|row| row.status);
                branch
                    .starts
                    .iter()
                    .any(|(margin_deg, _)| *margin_deg >= MARGIN_DEG.max(rig.job.limits.min_axis_margin_deg))
                    && branch.rows.iter().all(|row| Some(row.status) == began)
            })
        })
    })
}
