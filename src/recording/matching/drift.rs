//! Whether the length at the repeated reference pose drifted over the run.

use super::outcome::PoseOutcome;
use crate::plan::{Kind, PlanRow};

/// Change of the length at the reference pose over the run, by a line through its readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// From the first reading to the last, mm.
    pub change_mm: f64,
    /// Its standard deviation from the readings' scatter about the line, mm; `None` of two readings.
    pub sd_mm: Option<f64>,
    pub readings: usize,
    /// Whether the change is beyond chance (95 %).
    pub significant: bool,
}

/// Student's t, two-sided 95 %, for 1, 2, .. degrees of freedom; then the normal distribution's.
const STUDENT: [f64; 10] = [12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23];
const NORMAL: f64 = 2.0;

/// A reading at the reference pose.
struct Point {
    t_s: f64,
    reading_mm: f64,
}

/// The greatest drift (in standard deviations, where known) of the poses that are read repeatedly.
pub(super) fn of(rows: &[&PlanRow], outcomes: &[PoseOutcome]) -> Option<Drift> {
    let mut groups: Vec<(&PlanRow, Vec<Point>)> = Vec::new();
    for (row, pose) in rows.iter().zip(outcomes).filter(|(row, _)| row.kind == Kind::Reference) {
        let Some(reading) = pose.reading() else { continue };
        let point = Point { t_s: reading.middle_s(), reading_mm: reading.reading_mm };
        match groups
            .iter_mut()
            .find(|(first, _)| first.centre == row.centre && first.axes_deg == row.axes_deg)
        {
            Some((_, points)) => points.push(point),
            None => groups.push((row, vec![point])),
        }
    }
    let weight = |drift: &Drift| drift.change_mm.abs() / drift.sd_mm.unwrap_or(f64::INFINITY);
    groups.iter().filter_map(|(_, points)| line(points)).max_by(|a, b| weight(a).total_cmp(&weight(b)))
}

fn line(points: &[Point]) -> Option<Drift> {
    let (first, last) = (points.first()?, points.last()?);
    let count = points.len() as f64;
    if points.len() < 2 || last.t_s <= first.t_s {
        return None;
    }
    let span_s = last.t_s - first.t_s;
    let mean = |of: fn(&Point) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (t, y) = (mean(|point| point.t_s), mean(|point| point.reading_mm));
    let tt: f64 = points.iter().map(|point| (point.t_s - t).powi(2)).sum();
    let slope = points.iter().map(|point| (point.t_s - t) * (point.reading_mm - y)).sum::<f64>() / tt;
    let change_mm = slope * span_s;
    if points.len() == 2 {
        return Some(Drift { change_mm, sd_mm: None, readings: 2, significant: false });
    }
    let residual = |point: &Point| (point.reading_mm - y - slope * (point.t_s - t)).powi(2);
    let rest: f64 = points.iter().map(residual).sum();
    let sd_mm = (rest / (count - 2.0) / tt).sqrt() * span_s;
    let factor = STUDENT.get(points.len() - 3).copied().unwrap_or(NORMAL);
    Some(Drift {
        change_mm,
        sd_mm: Some(sd_mm),
        readings: points.len(),
        significant: change_mm.abs() > factor * sd_mm,
    })
}
