//! What parts of a set of lengths determine, the most informative lengths first, and how many are enough.

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use serde::Serialize;

use super::{Criterion, Exchange};
use crate::estimation::{Observability, Posterior, outlook};
use crate::measurement::PreparedMeasurement;
use crate::robot::AXES;

/// Shares of the lengths that are taken, and all of them measured twice.
const SHARES: [f64; 6] = [0.15, 0.25, 0.5, 0.75, 1.0, 2.0];
/// Fewest lengths that are taken.
const FEWEST: usize = 6;
/// Twice as many lengths are worth their time when they leave less than this share of the error.
const WORTH: f64 = 0.9;

/// What a number of lengths determines.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LengthCount {
    /// More than there are lengths: all of them measured twice.
    pub lengths: usize,
    /// Rank of the scaled Jacobian of all parameters.
    pub rank: usize,
    /// Observability indices of what is determined.
    pub observability: Option<Observability>,
    /// Posterior standard deviation of each parameter, mm or rad.
    pub sd: BTreeMap<String, f64>,
    /// Mean 3-D error over the workspace after an identification, mm.
    pub error_mm: f64,
}

/// Growing parts of `readings` of standard deviation `sigma_mm`, with the 3-D error over the axis vectors of `poses` (rad).
pub fn by_count(
    posterior: &Posterior,
    readings: &[PreparedMeasurement],
    sigma_mm: f64,
    poses: &[[f64; AXES]],
) -> Vec<LengthCount> {
    let mut columns = DMatrix::zeros(posterior.root().ncols(), readings.len());
    for (mut column, reading) in columns.column_iter_mut().zip(readings) {
        if let Some(ball) = reading.datum.ball() {
            column.copy_from(&(posterior.design_row(&reading.axes, ball) / sigma_mm));
        }
    }
    let mut order = Exchange::new(&columns, &DMatrix::zeros(0, columns.nrows()));
    order.extend(readings.len(), Criterion::D);
    let ordered: Vec<PreparedMeasurement> =
        order.chosen().iter().filter_map(|&at| readings.get(at).copied()).collect();
    let mut counts: Vec<usize> =
        SHARES.iter().map(|share| ((readings.len() as f64 * share).round() as usize).max(FEWEST)).collect();
    counts.dedup();
    counts
        .into_iter()
        .filter_map(|count| {
            let part: Vec<PreparedMeasurement> = ordered.iter().cycle().take(count).copied().collect();
            let seen = outlook(posterior, &part, sigma_mm, poses)?;
            Some(LengthCount {
                lengths: count,
                rank: seen.analysis.base.rank,
                observability: seen.observability,
                sd: seen.parameters.iter().map(|known| (known.id.to_string(), known.after)).collect(),
                error_mm: seen.error_mm[1].mean,
            })
        })
        .collect()
}

/// Whether there are enough lengths; `planned` are all of them, `doubled` all measured twice.
pub enum Sufficiency<'a> {
    /// So many bring the 3-D error below the robot's repeatability.
    Enough {
        few: &'a LengthCount,
        repeatability_mm: f64,
        planned: &'a LengthCount,
        doubled: &'a LengthCount,
    },
    /// Twice as many leave hardly less.
    OthersNeeded {
        planned: &'a LengthCount,
        doubled: &'a LengthCount,
    },
    MoreHelp {
        planned: &'a LengthCount,
        doubled: &'a LengthCount,
    },
}

/// `None` where fewer than two numbers of lengths were taken.
pub fn sufficiency(counts: &[LengthCount], repeatability_mm: Option<f64>) -> Option<Sufficiency<'_>> {
    let [.., planned, doubled] = counts else { return None };
    let fine = repeatability_mm.and_then(|limit| {
        let few = counts.iter().find(|part| part.error_mm <= limit && part.lengths <= planned.lengths)?;
        Some(Sufficiency::Enough { few, repeatability_mm: limit, planned, doubled })
    });
    Some(fine.unwrap_or(if doubled.error_mm > WORTH * planned.error_mm {
        Sufficiency::OthersNeeded { planned, doubled }
    } else {
        Sufficiency::MoreHelp { planned, doubled }
    }))
}
