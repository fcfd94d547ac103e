//! The effect of the number of lengths, most informative lengths first, and how many are enough.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::candidates::columns;
use super::{Criterion, Exchange};
use crate::estimation::{Observability, PlannedLengths, Posterior};
use crate::math::map_items;
use crate::measurement::Measurement;

/// Fractions of the planned lengths; 2 is all of them measured twice.
const SHARES: [f64; 4] = [0.25, 0.5, 1.0, 2.0];
/// Least number of lengths.
const MIN_LENGTHS: usize = 6;
/// Twice as many lengths are worthwhile if they reduce the error below this fraction.
const WORTH: f64 = 0.9;

/// The predicted result of a number of lengths.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LengthCount {
    pub lengths: usize,
    /// Rank of the scaled Jacobian of all parameters.
    pub rank: usize,
    /// Observability of the identifiable parameters.
    pub observability: Option<Observability>,
    /// Posterior standard deviation of each parameter, mm or rad.
    pub sd: BTreeMap<String, f64>,
    /// Mean position error over the workspace, mm.
    pub error_mm: f64,
}

/// Growing subsets of the planned lengths, of standard deviation `sigma_mm`, and all of them measured twice.
pub fn by_count(posterior: &Posterior, lengths: &PlannedLengths<'_>, sigma_mm: f64) -> Vec<LengthCount> {
    let size = posterior.root().ncols();
    let row = |row: &Measurement| match row.datum.ball() {
        Some(ball) => posterior.design_row(&row.axes.radians(), ball) / sigma_mm,
        None => DVector::zeros(size),
    };
    let count = lengths.planned().len();
    let rows = columns(size, lengths.planned().iter().map(row));
    let mut order = Exchange::new(&rows, &DMatrix::zeros(0, size));
    order.extend(count, Criterion::D);
    let mut counts = SHARES.map(|share| ((count as f64 * share).round() as usize).max(MIN_LENGTHS)).to_vec();
    counts.dedup();
    let predicted = map_items(&counts, |&part| {
        let places = order.chosen().iter().copied().cycle().take(part);
        let predicted = lengths.predict(posterior, places, sigma_mm)?;
        Some(LengthCount {
            lengths: part,
            rank: predicted.analysis.base.rank,
            observability: predicted.observability,
            sd: predicted.parameters.iter().map(|known| (known.id.to_string(), known.after)).collect(),
            error_mm: predicted.forecast.position_mm.mean,
        })
    });
    predicted.into_iter().flatten().collect()
}

/// Whether the planned lengths are enough; `doubled` are all of them measured twice.
pub enum Sufficiency<'a> {
    /// `few` of them bring the position error below the robot's repeatability.
    Enough {
        few: &'a LengthCount,
        repeatability_mm: f64,
        planned: &'a LengthCount,
        doubled: &'a LengthCount,
    },
    /// Twice as many hardly reduce the error.
    OthersNeeded {
        planned: &'a LengthCount,
        doubled: &'a LengthCount,
    },
    MoreHelp {
        planned: &'a LengthCount,
        doubled: &'a LengthCount,
    },
}

/// `None` with fewer than two counts.
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
