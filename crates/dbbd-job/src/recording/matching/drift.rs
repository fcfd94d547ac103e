//! Drift of the length at the repeated reference pose.

use super::outcome::PoseOutcome;
use crate::plan::{PlanRow, PoseKind};
use dbbd_model::math::straight_line::RegressionLine;

/// Change of the length at the reference pose over the run, by a line through its readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LengthDrift {
    /// From the first reading to the last, mm.
    pub change_mm: f64,
    /// Standard deviation from the scatter of the readings about the line, mm; `None` for two readings.
    pub sd_mm: Option<f64>,
    pub readings: usize,
    /// Whether the change is significant (95 %) and exceeds the bar's standard deviation.
    pub significant: bool,
}

/// Student's t, two-sided 95 %, for 1, 2, .. degrees of freedom; then that of the normal distribution.
const STUDENT: [f64; 10] = [12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23];
const NORMAL: f64 = 2.0;

/// The largest drift (in standard deviations, or in mm if none has one) of the repeated poses.
pub(super) fn largest(rows: &[&PlanRow], outcomes: &[PoseOutcome], bar_sigma_mm: f64) -> Option<LengthDrift> {
    let mut groups: Vec<(&PlanRow, Vec<[f64; 2]>)> = Vec::new();
    for (row, pose) in rows.iter().zip(outcomes).filter(|(row, _)| row.kind == PoseKind::Reference) {
        let Some(reading) = pose.reading() else { continue };
        let point = [reading.middle_s(), reading.reading_mm];
        match groups
            .iter_mut()
            .find(|(first, _)| first.centre == row.centre && first.axes_deg == row.axes_deg)
        {
            Some((_, points)) => points.push(point),
            None => groups.push((row, vec![point])),
        }
    }
    let weight = |drift: &LengthDrift| drift.change_mm.abs() / drift.sd_mm.unwrap_or(f64::INFINITY);
    let lines = groups.iter().filter_map(|(_, points)| line(points));
    let worth = |drift: LengthDrift| LengthDrift {
        significant: drift.significant && drift.change_mm.abs() > bar_sigma_mm,
        ..drift
    };
    lines.map(worth).max_by(|a, b| {
        let by_size = a.change_mm.abs().total_cmp(&b.change_mm.abs());
        weight(a).total_cmp(&weight(b)).then(by_size)
    })
}

/// Points are times, s, and readings, mm, in order of time.
fn line(points: &[[f64; 2]]) -> Option<LengthDrift> {
    let readings = points.len();
    let span_s = points.last()?[0] - points.first()?[0];
    let line = RegressionLine::through(points).filter(|_| span_s > 0.0)?;
    let change_mm = line.slope * span_s;
    let sd_mm = (readings > 2).then_some(line.slope_sd * span_s);
    let factor = STUDENT.get(readings.saturating_sub(3)).copied().unwrap_or(NORMAL);
    let significant = sd_mm.is_some_and(|sd_mm| change_mm.abs() > factor * sd_mm);
    Some(LengthDrift { change_mm, sd_mm, readings, significant })
}
