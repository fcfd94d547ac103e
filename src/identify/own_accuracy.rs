//! Whether a run looks as if the controller corrected its commands by an accuracy model of its own.

use super::{Identified, tolerance};
use crate::identifiability::factor;
use crate::model::{LengthModel, Observations, ParamId, Reading, Robot, parameter};

/// A robot drawn from its tolerance is off by less than this share of what is expected in no run of a thousand.
const SHARE: f64 = 0.04;

/// A doubt about lengths that agree with the nominal robot better than its tolerance lets any robot do: then the
/// axes most likely did not stand where they were commanded to.
pub fn own_accuracy(robot: &Robot, found: &Identified, lengths: &Observations) -> Option<String> {
    // Planned on a robot that was identified before: then they should agree.
    if robot.nominal.is_some() {
        return None;
    }
    let nominal = robot.controller();
    let ids = parameter::parse_list("geometric", &nominal.parallel_joints(), 0_usize).ok()?;
    let model = LengthModel { geometry: nominal.geometry.clone(), ..found.model.clone() };
    let readings: Vec<Reading> = lengths.rows.iter().map(Reading::from).collect();
    let rows = factor(&model, readings.as_slice(), &ids);
    let sd = |id: &ParamId| tolerance(nominal, *id).unwrap_or(0.0);
    let squares = rows.column_iter().zip(&ids).map(|(column, id)| column.norm_squared() * sd(id).powi(2));
    let expected_mm = (squares.sum::<f64>() / readings.len().max(1) as f64).sqrt();
    let seen_mm = found.result.residual_mm.before.rms;
    (seen_mm < SHARE * expected_mm).then(|| {
        format!(
            "the lengths agree with the nominal robot to {seen_mm:.3} mm, its tolerance lets {expected_mm:.2} mm expect: \
             most likely the controller corrects by an accuracy model of its own and its axes stood elsewhere; \
             give the axes that the program logged: `dbbd sync --axes`, then identify its observations"
        )
    })
}
