//! The predicted error by the distance from the base balls: up to where a result is valid.

use nalgebra::Vector3;
use serde::Serialize;

use super::Job;
use crate::plan::PlanFinding;
use dbbd_model::estimation::result::MapPoint;

/// Outer radii of the shells about the base balls, mm.
const WITHIN_MM: [f64; 5] = [300.0, 600.0, 1000.0, 1500.0, f64::INFINITY];
/// A result is valid in shells with an error of up to this many times the least one.
const ALIKE: f64 = 2.0;
/// Fewest poses of a shell.
const MIN_SHELL_POSES: usize = 10;

/// The error in a shell about the base balls.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ErrorShell {
    /// Least distance from the nearest base ball, mm.
    pub beyond_mm: f64,
    /// Greatest distance, absent for the outermost shell.
    pub within_mm: Option<f64>,
    /// Root mean square of the predicted 3-D error, mm.
    pub error_mm: f64,
}

/// The shells about the job's base balls in which the map has enough poses.
pub(crate) fn regions(job: &Job, map: &[MapPoint]) -> Vec<ErrorShell> {
    let far = |place: &Vector3<f64>| {
        let off = |ball: &[f64; 3]| (place - Vector3::from(*ball)).norm();
        job.centres.iter().map(|table| off(&table.xyz_mm)).fold(f64::INFINITY, f64::min)
    };
    let mut beyond_mm = 0.0;
    let mut regions = Vec::new();
    for within in WITHIN_MM {
        let there = map.iter().filter(|point| (beyond_mm..within).contains(&far(&point.position)));
        let errors: Vec<f64> = there.map(|point| point.rms_mm).collect();
        if errors.len() >= MIN_SHELL_POSES {
            let square = errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64;
            let within_mm = within.is_finite().then_some(within);
            regions.push(ErrorShell { beyond_mm, within_mm, error_mm: square.sqrt() });
        }
        beyond_mm = within;
    }
    regions
}

/// Up to which distance the result is valid.
pub(crate) fn validity(regions: &[ErrorShell]) -> Option<PlanFinding> {
    let least_mm = regions.iter().map(|region| region.error_mm).fold(f64::INFINITY, f64::min);
    let good = regions.iter().take_while(|region| region.error_mm <= ALIKE * least_mm).last()?;
    let worst = regions.iter().map(|region| region.error_mm).fold(0.0, f64::max);
    Some(match good.within_mm {
        Some(within_mm) if worst > ALIKE * least_mm => {
            let most_mm = good.error_mm.max(least_mm);
            PlanFinding::ValidNear { within_mm, least_mm, most_mm, farther_mm: worst }
        }
        _ => PlanFinding::ValidEverywhere { least_mm, most_mm: worst },
    })
}
