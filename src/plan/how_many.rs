//! How what is told grows with the number of lengths, and how many are enough.

use std::collections::BTreeMap;

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};

use crate::identifiability::{Belief, Criterion, Exchange, Observability, outlook};
use crate::model::{AXES, Reading};

/// Shares of a plan's lengths that are looked at, and the plan measured twice.
const SHARES: [f64; 6] = [0.15, 0.25, 0.5, 0.75, 1.0, 2.0];
/// Fewest lengths that are looked at.
const FEWEST: usize = 6;
/// Twice as many lengths are worth their time when they leave less than this share of the error.
const WORTH: f64 = 0.9;

/// What so many of a plan's lengths tell, the most telling ones first.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Against {
    /// Lengths; more than the plan has are the plan measured twice.
    pub lengths: usize,
    /// Rank of the scaled Jacobian of all parameters.
    pub rank: usize,
    /// Observability indices of what is told.
    pub observability: Option<Observability>,
    /// Standard deviation of each parameter, with what is known beforehand, mm or rad.
    pub sd: BTreeMap<String, f64>,
    /// Mean 3-D error over the workspace after an identification, mm.
    pub error_mm: f64,
}

/// What growing parts of `readings` of standard deviation `sigma_mm` add to `belief`, with the 3-D error over the axis
/// vectors of `poses` (rad).
pub(crate) fn against(
    belief: &Belief,
    readings: &[Reading],
    sigma_mm: f64,
    poses: &[[f64; AXES]],
) -> Vec<Against> {
    let mut columns = DMatrix::zeros(belief.root().ncols(), readings.len());
    for (mut column, reading) in columns.column_iter_mut().zip(readings) {
        column.copy_from(&(belief.swing(&reading.axes, reading.centre) / sigma_mm));
    }
    let mut order = Exchange::new(&columns, &DMatrix::zeros(0, columns.nrows()));
    order.extend(readings.len(), Criterion::D);
    let ordered: Vec<Reading> = order.chosen().iter().filter_map(|&at| readings.get(at).copied()).collect();
    let mut counts: Vec<usize> =
        SHARES.iter().map(|share| ((readings.len() as f64 * share).round() as usize).max(FEWEST)).collect();
    counts.dedup();
    counts
        .into_iter()
        .filter_map(|count| {
            let part: Vec<Reading> = ordered.iter().cycle().take(count).copied().collect();
            let seen = outlook(belief, &part, sigma_mm, poses)?;
            Some(Against {
                lengths: count,
                rank: seen.analysis.base.rank,
                observability: seen.observability,
                sd: seen.parameters.iter().map(|known| (known.id.to_string(), known.after)).collect(),
                error_mm: seen.error_mm[1].mean,
            })
        })
        .collect()
}

/// How many lengths are enough, in words: as many as bring the 3-D error below the robot's repeatability, or of which
/// twice as many leave hardly less. `None` where fewer than two numbers were looked at.
pub(crate) fn enough(against: &[Against], repeatability_mm: Option<f64>) -> Option<String> {
    let (planned, more) = match against {
        [.., planned, more] => (planned, more),
        _ => return None,
    };
    let fine = repeatability_mm.and_then(|limit| {
        let first = against.iter().find(|part| part.error_mm <= limit)?;
        Some((first, limit))
    });
    let at = |part: &Against| format!("{} lengths leave {:.3} mm", part.lengths, part.error_mm);
    Some(match fine {
        Some((first, limit)) if first.lengths <= planned.lengths => format!(
            "{} are enough: {} of 3-D error, less than the robot's repeatability of {limit} mm; {}, {}",
            first.lengths,
            format_args!("{:.3} mm", first.error_mm),
            at(planned),
            at(more)
        ),
        _ if more.error_mm > WORTH * planned.error_mm => format!(
            "{}, and twice as many hardly less ({:.3} mm): only other poses, another base ball or a better known bar \
             (length_u_mm) would tell more",
            at(planned),
            more.error_mm
        ),
        _ => format!(
            "{}; twice as many would leave {:.3} mm: more would tell more",
            at(planned),
            more.error_mm
        ),
    })
}
