//! How far from the base balls a result is valid.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::Job;

/// Distances from the nearest base ball that are told apart, mm.
const WITHIN_MM: [f64; 5] = [300.0, 600.0, 1000.0, 1500.0, f64::INFINITY];
/// Up to this many times the least error of a shell the result counts as equally good.
const ALIKE: f64 = 2.0;
/// Poses below which a shell says nothing.
const FEWEST: usize = 10;

/// What is left in a shell about the base balls.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Region {
    /// Farther than this from the nearest base ball, mm,
    pub beyond_mm: f64,
    /// and up to this; absent for all that is beyond.
    pub within_mm: Option<f64>,
    /// Root mean square of the predicted 3-D error there, mm.
    pub error_mm: f64,
}

/// The shells about the job's base balls in which a map (ball, mm, and its error there, mm) has poses.
pub(crate) fn regions(job: &Job, map: &[([f64; 3], f64)]) -> Vec<Region> {
    let far = |place: &[f64; 3]| {
        let off = |ball: &[f64; 3]| (Vector3::from(*place) - Vector3::from(*ball)).norm();
        job.centres.iter().map(|table| off(&table.xyz_mm)).fold(f64::INFINITY, f64::min)
    };
    let mut beyond_mm = 0.0;
    let mut regions = Vec::new();
    for within in WITHIN_MM {
        let there = map.iter().filter(|(place, _)| (beyond_mm..within).contains(&far(place)));
        let errors: Vec<f64> = there.map(|(_, error)| *error).collect();
        if errors.len() >= FEWEST {
            let square = errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64;
            let within_mm = within.is_finite().then_some(within);
            regions.push(Region { beyond_mm, within_mm, error_mm: square.sqrt() });
        }
        beyond_mm = within;
    }
    regions
}

/// The same in a sentence; `None` without a region.
pub(crate) fn words(regions: &[Region]) -> Option<String> {
    let least = regions.iter().map(|region| region.error_mm).fold(f64::INFINITY, f64::min);
    let good = regions.iter().take_while(|region| region.error_mm <= ALIKE * least).last()?;
    let worst = regions.iter().map(|region| region.error_mm).fold(0.0, f64::max);
    Some(match good.within_mm {
        Some(within) if worst > ALIKE * least => format!(
            "the result is valid up to {within} mm from the base balls, where {least:.3} to {:.3} mm are left; farther \
             out up to {worst:.3} mm",
            good.error_mm.max(least)
        ),
        _ => format!("the result is valid over the whole workspace, with {least:.3} to {worst:.3} mm left"),
    })
}
