//! What would help: another hold of the tool where a circle fails at the axis limits or the wrist, a stage before it
//! where the stroke is at risk.

use super::check::Finding;
use super::quantity::Quantity;
use super::rig::Rig;
use super::solve::runs;
use super::steps::steps;
use super::{Job, PlanRow};

/// The coarse grid, degrees.
const TILTS_DEG: [f64; 7] = [0.0, 15.0, 30.0, 45.0, -15.0, -30.0, -45.0];
const SPINS_DEG: [f64; 12] =
    [0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 120.0, -120.0, 150.0, -150.0, 180.0];
/// Points by which a circle is tried, and the margin that these must keep, degrees.
const POINTS: u32 = 40;
const MARGIN_DEG: f64 = 1.0;

/// For each circle that fails so: tilt and spin that keep axis limits, wrist and branch at its points. For a length
/// that might leave the stroke: a stage.
pub(crate) fn advice(job: &Job, rig: &Rig<'_>, rows: &[PlanRow], findings: &[Finding]) -> Vec<String> {
    let held = |finding: &Finding| match finding {
        Finding::Beyond(check) => matches!(
            check.quantity,
            Quantity::AxisMarginDeg | Quantity::WristDeg | Quantity::AxisJumpDeg | Quantity::AxisSpeedPercent
        )
        .then_some(check.row),
        Finding::Unsolved { row, .. } | Finding::Branch { row, .. } => Some(*row),
    };
    let whole = steps(job);
    let circle_of = |row: u32| {
        let at = row.saturating_sub(1) as usize;
        rows.get(at).map(|row| row.circle).or_else(|| whole.get(at).map(|step| step.circle))
    };
    let mut circles: Vec<u32> = findings.iter().filter_map(held).filter_map(circle_of).collect();
    circles.dedup();
    circles.sort_unstable();
    circles.dedup();
    let risky = findings.iter().any(|finding| match finding {
        Finding::Beyond(check) => matches!(check.quantity, Quantity::StrokeRisk | Quantity::RunRisk),
        _ => false,
    });
    let stage = (risky && !job.circles.is_empty()).then(|| {
        "help: the robot is not known well enough for these circles and this stroke; `dbbd plan JOB --stage 20` chooses \
         poses whose length is safe as it is known now: measure them, identify, and plan again with --robot \
         robot-identified.toml"
            .to_owned()
    });
    circles.into_iter().filter_map(|number| other_hold(job, rig, number)).chain(stage).collect()
}

fn other_hold(job: &Job, rig: &Rig<'_>, number: u32) -> Option<String> {
    let table = job.circles.get(number.checked_sub(1)? as usize)?;
    let mut alone = job.clone();
    alone.optimise = None;
    alone.circles = vec![table.clone()];
    for tilt_deg in TILTS_DEG {
        for spin_deg in SPINS_DEG {
            for circle in &mut alone.circles {
                (circle.tilt_deg, circle.spin_deg) = (tilt_deg, spin_deg);
                circle.points = table.points.min(POINTS);
            }
            if passes(&alone, rig) {
                return Some(format!(
                    "help: circle {number}: tilt_deg = {tilt_deg}, spin_deg = {spin_deg} would pass \
                     (axis limits, wrist and branch at its points)"
                ));
            }
        }
    }
    Some(format!(
        "help: circle {number}: no tilt_deg and spin_deg of a coarse grid would pass; make amplitude_deg \
         smaller, or move the base ball"
    ))
}

fn passes(job: &Job, rig: &Rig<'_>) -> bool {
    let steps = steps(job);
    runs(&steps).into_iter().all(|(first, past)| {
        let run = steps.get(first..past).unwrap_or_default();
        let starts = run.first().and_then(|first| rig.starts(first).ok()).unwrap_or_default();
        starts.iter().any(|start| {
            rig.follow(job, run, 1, start).is_ok_and(|branch| {
                let began = branch.rows.first().map(|row| row.status);
                branch.margin_deg >= MARGIN_DEG && branch.rows.iter().all(|row| Some(row.status) == began)
            })
        })
    })
}
