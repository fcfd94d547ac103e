//! Matches the stream of lengths of a run to the poses of its plan: detects dwells, and decides which dwell
//! belongs to which pose. Pure and deterministic.
//!
//! Dwells come from the published axes if there are any, else from the controller's reports (which carry the index
//! of the pose), else from its strobe, else from intervals in which the length does not change.

mod catalogue;
pub use catalogue::MatchingFinding;

mod alignment;
mod by_axes;
mod detection;
mod inferred;
mod input;
mod markers;
mod outcome;
mod parabola;
mod passes;
mod pose_matching;
mod program;
mod published;
mod stillness;
mod visits;

use std::sync::Arc;

use super::reports;
use crate::plan::Plan;
use crate::recording::matching::MatchingFinding as Finding;
use dbbd_model::measurement::{
    AxisAngles, BallId, BarId, CircleId, ContextColumn, Measurement, MeasurementContext, Measurements,
};
use dbbd_model::robot::{AXES, Approach, Datum, PayloadId, TargetId};

pub use alignment::{DwellEvidence, ExpectedLengths, Pairing, PoseAlignment, align};
pub use input::{MatchingInput, MeasuredAxes};
pub use markers::MarkerFit;
pub use outcome::{DwellSource, MatchOutcome, PoseOutcome};
pub use passes::PassLag;
pub use pose_matching::{CodeOdds, LengthDrift, ModuleOdds, PoseMatching, nothing_matched};
pub use program::CommandedDwell;
pub use published::{AxesReport, BarLag, PublishedAxes};
pub use stillness::still_dwells;

use detection::{DwellDetection, detect_dwells};
use passes::PassPoint;
use pose_matching::{axes_deviation, detect_frozen_reading, largest_drift, run_findings};
use program::DwellPoses;

/// Lengths that a model predicts for the dwells of the plan, in order, mm. `length_mm` takes the base ball and the axis
/// angles in degrees: measured angles if there are any.
pub fn expected_lengths(
    plan: &Plan,
    axes_deg: Option<&MeasuredAxes>,
    length_mm: impl Fn(BallId, &[f64; AXES]) -> f64,
) -> Vec<f64> {
    let dwells = plan.rows.iter().filter(|row| program::stops(row));
    dwells
        .map(|row| {
            let measured = axes_deg.and_then(|axes| axes.get(&row.index));
            length_mm(row.centre, measured.unwrap_or(&row.axes_deg))
        })
        .collect()
}

/// Matches the dwells of a run to the poses of its plan.
pub fn match_poses(input: &MatchingInput<'_>) -> PoseMatching {
    let poses = DwellPoses::of(input.plan);
    let detection = by_axes::detect_by_axes(input, &poses).unwrap_or_else(|| detect_dwells(input, &poses));
    let mut outcomes = detection.outcomes(input, &poses);
    let code = detection.code_odds(input, &poses);
    let drift = largest_drift(&poses.rows, &outcomes, input.bar_sigma_mm);
    let frozen = detect_frozen_reading(input.stream, &outcomes);
    let spurious = detection.spurious();
    let DwellDetection { source, override_factor, passes, axes_deg, report, mut findings, .. } = detection;
    let observations = measurements(input, &axes_deg, &outcomes, &passes.points);
    outcomes.extend(passes.points.into_iter().map(|point| point.pose));
    outcomes.sort_by_key(|pose| pose.index);
    let one_way = |circle| Finding::OneWayCircle { circle, lag_sd_ms: 1000.0 * passes::LAG_SD_S };
    findings.extend(frozen);
    findings.extend(passes.one_way.into_iter().map(one_way));
    let external = input.published.and_then(|axes| axes.track.external);
    findings.extend(
        external.map(|moved| Finding::ExternalAxisMoved { number: moved.number, range: moved.range }),
    );
    findings.extend(match &report {
        Some(report) => Some(report.finding()),
        None => reports::unused(input.reports, input.stream),
    });
    let mut matching = PoseMatching {
        observations,
        outcomes,
        spurious,
        source,
        override_factor: override_factor.filter(|_| !poses.rows.is_empty()),
        lags: passes.lags,
        drift,
        code,
        axes: report,
        findings,
    };
    let more = run_findings(&matching, input);
    matching.findings.extend(more);
    let deviation = axes_deviation(&matching, input.plan);
    matching.findings.extend(deviation);
    matching
}

const COLUMNS: [ContextColumn; 6] = [
    ContextColumn::Kind,
    ContextColumn::TimeS,
    ContextColumn::Samples,
    ContextColumn::Creep,
    ContextColumn::Circle,
    ContextColumn::AngleDeg,
];

/// The measurements of the poses at which the robot stopped, and of the poses that it passed.
fn measurements(
    input: &MatchingInput<'_>,
    axes_deg: &MeasuredAxes,
    stopped: &[PoseOutcome],
    passed: &[PassPoint],
) -> Measurements {
    let plan = input.plan;
    let (places, approaches) = (plan.circle_places(), plan.approaches().collect::<Vec<Approach>>());
    let measurement = |pose: &PoseOutcome, timing_mm: f64| {
        let reading = pose.reading()?;
        let at = (pose.index as usize).checked_sub(1)?;
        let row = plan.rows.get(at)?;
        let place = places.get(at).copied().flatten();
        let taught = plan.taught().find(|taught| taught.centre == row.centre.number());
        let context = MeasurementContext {
            kind: Some(row.kind),
            time_s: Some(reading.middle_s()),
            samples: Some(reading.samples),
            creep: Some(reading.creep_mm.is_some()),
            circle: place.and_then(|_| CircleId::new(row.circle)),
            angle_deg: place.map(|place| place.angle_deg),
            taught_deg: taught.map(|taught| Box::new(taught.axes_deg)),
            force_n: plan.header.job.bar.force_n,
            ..MeasurementContext::default()
        };
        Some(Measurement {
            index: row.index,
            datum: Datum::Ball(row.centre, BarId::FIRST),
            target: TargetId::FIRST,
            axes: AxisAngles::from_degrees(*axes_deg.get(&row.index).unwrap_or(&row.axes_deg)),
            approach: approaches.get(at).copied().unwrap_or_default(),
            length_mm: plan.header.job.bar.length_mm + reading.reading_mm,
            sigma_mm: Some(reading.u_mm.hypot(timing_mm).max(input.bar_sigma_mm)),
            payload: PayloadId::at(usize::from(plan.header.job.payload.is_some())),
            context: Some(Arc::new(context)),
        })
    };
    let stopped = stopped.iter().filter_map(|pose| measurement(pose, 0.0));
    let passed = passed.iter().filter_map(|point| measurement(&point.pose, point.timing_mm));
    let mut rows: Vec<Measurement> = stopped.chain(passed).collect();
    rows.sort_by_key(|row| row.index);
    let taught = plan.taught().next().map(|_| ContextColumn::TaughtDeg);
    let force = plan.header.job.bar.force_n.map(|_| ContextColumn::ForceN);
    Measurements {
        rows,
        columns: COLUMNS.into_iter().chain(taught).chain(force).collect(),
        // The first name is the payload of rows that name none.
        payloads: plan.header.job.payload.iter().flat_map(|name| [String::new(), name.clone()]).collect(),
    }
}
