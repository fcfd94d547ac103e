//! The circular test: the quantities of ISO 230-4 from the lengths of a ball-bar.
//!
//! `docs/reference/circular-test.md` gives the definitions and their sources, and says which parts of the standard were not
//! available. This room must not know a robot's model: it takes lengths at programmed angles.

mod catalogue;
pub use catalogue::CircularFinding;

mod harmonics;
mod input;
mod noise;
mod plausibility;
mod quantities;
mod reference_circle;
mod reversal;
mod trace;
mod uncertainty;

pub use harmonics::{HarmonicDiagnosis, Harmonics, TERM_NAMES};
pub use input::{traces_from_csv, traces_from_table};
pub use quantities::{CircularQuantity, QUANTITY_NAMES, TRACE_NAMES};
pub use reversal::{DriveBacklash, DriveId};
pub use trace::{CirclePoint, CircleSense, CircleTrace, CircularSettings, DriveState};

use crate::circular::CircularFinding as Finding;
use crate::diagnostic::Diagnostic;

use noise::LengthSigmaSource;
use quantities::{FitConditions, MAX_CONDITION, RadialTraces, evaluate};
use reference_circle::{RadialMeasurement, fit_circle};
use reversal::Reversal;
use trace::CoveredArc;

/// Minimum number of points that determine centre, radius and a deviation.
const MIN_CIRCLE_POINTS: usize = 5;
/// Largest relative difference of a length from the radius.
const FAR_OFF: f64 = 0.2;

#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct TraceResult {
    pub run: String,
    pub sense: CircleSense,
    pub points: usize,
    /// The quantities of the trace in the order of [`TRACE_NAMES`], mm.
    pub quantities: Vec<CircularQuantity>,
    /// Angle (degrees) and deviation about the joint centre (mm), in the order of the motion.
    pub deviations: Vec<[f64; 2]>,
}

#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct CircularEvaluation {
    pub radius_mm: f64,
    pub arc: CoveredArc,
    /// The quantities of the test in the order of [`QUANTITY_NAMES`], mm, referred to 20 degrees if possible.
    pub quantities: Vec<CircularQuantity>,
    /// The quantities without the temperature correction, if there is one.
    pub as_measured: Option<Vec<Option<f64>>>,
    /// Whether F is about the least-squares centre (b) or the centre of the instrument (a).
    pub free_centre: bool,
    pub traces: Vec<TraceResult>,
    pub diagnosis: HarmonicDiagnosis,
    pub reversals: Vec<Reversal>,
    /// The backlash of each axis or joint, if identifiable.
    pub steps: Vec<DriveBacklash>,
    /// Standard uncertainty of a single length, mean over the points.
    pub sigma_mm: f64,
    pub sigma_source: LengthSigmaSource,
    pub draws: usize,
    pub notes: Vec<Diagnostic>,
}

impl CircularEvaluation {
    /// A quantity by its name in [`QUANTITY_NAMES`].
    pub fn get(&self, name: &str) -> CircularQuantity {
        let at = QUANTITY_NAMES.iter().position(|known| *known == name);
        at.and_then(|at| self.quantities.get(at)).copied().unwrap_or_default()
    }
}

/// Evaluates the traces of one circle.
pub fn circular(traces: &[CircleTrace], settings: &CircularSettings) -> Result<CircularEvaluation, Finding> {
    check_input(traces, settings)?;
    let corrected = trace::referred(traces, settings.temperature);
    let rays = |traces: &[CircleTrace]| RadialTraces::new(traces, settings.radius_mm);
    let mut measured = rays(corrected.as_deref().unwrap_or(traces));
    let joint = fit_circle(measured.all()).ok_or(Finding::NoCircle)?;
    let arc = CoveredArc::of(traces, joint.condition);
    let unequal = plausibility::unequal(traces, &arc);
    let allowed = FitConditions { both: unequal.is_none(), ..FitConditions::of(&arc) };
    measured.centre = if allowed.free_centre { joint.centre } else { [0.0; 2] };
    let values = evaluate(&measured, allowed).ok_or(Finding::NoCircle)?;
    let as_measured = corrected
        .as_ref()
        .and_then(|_| evaluate(&rays(traces), allowed))
        .map(|values| values.overall_options());
    let noise = noise::estimate_noise(traces, &measured, settings.sigma_mm);
    let u95 = uncertainty::u95(&measured, &values, allowed, &noise, settings);
    let (quantities, alone) = values.with(u95.as_ref());
    let results = traces.iter().zip(&measured.traces).zip(alone);
    let results =
        results.map(|((trace, rays), quantities)| TraceResult::new(trace, rays, measured.centre, quantities));
    let mut notes: Vec<Diagnostic> = arc_finding(&arc, allowed).into_iter().map(Diagnostic::from).collect();
    for trace in traces.iter().filter(|trace| !trace.is_in_sense()) {
        notes
            .push(Finding::AgainstDirection { run: trace.run.clone(), direction: trace.sense.word() }.into());
    }
    notes.extend(plausibility::check_plausibility(traces, settings.radius_mm));
    let g_mm = quantities.first().and_then(|quantity| quantity.value);
    let too_large = g_mm.and_then(|g_mm| plausibility::too_large(g_mm, settings.radius_mm));
    notes.extend(too_large.map(Diagnostic::from));
    if arc.full && unequal.is_none() {
        notes.extend(plausibility::centres_differ(traces, &measured).map(Diagnostic::from));
    }
    notes.extend(unequal.map(Diagnostic::from));
    let other_sigma =
        settings.sigma_mm.and_then(|sigma_mm| plausibility::other_sigma(traces, &measured, sigma_mm));
    notes.extend(other_sigma.map(Diagnostic::from));
    if corrected.is_none() {
        notes.push(Finding::AsMeasured.into());
    }
    let reversals = reversal::reversals(traces);
    let steps = if arc.full { reversal::backlash(traces, &measured) } else { Vec::new() };
    let joints: std::collections::BTreeSet<usize> = reversals.iter().map(|reversal| reversal.joint).collect();
    if steps.is_empty() && !joints.is_empty() {
        notes.push(Finding::StepsNotSeparable { joints: joints.len() }.into());
    }
    Ok(CircularEvaluation {
        radius_mm: settings.radius_mm,
        arc,
        quantities,
        as_measured,
        free_centre: arc.full,
        traces: results.collect(),
        diagnosis: if arc.full && allowed.free_centre && allowed.both {
            harmonics::diagnose(traces, &measured, settings.radius_mm, &noise)
        } else {
            HarmonicDiagnosis::default()
        },
        reversals,
        steps,
        sigma_mm: noise.mean(),
        sigma_source: noise.source,
        draws: if u95.is_some() { settings.draws } else { 0 },
        notes,
    })
}

impl TraceResult {
    fn new(
        trace: &CircleTrace,
        rays: &[RadialMeasurement],
        centre: [f64; 2],
        quantities: Vec<CircularQuantity>,
    ) -> Self {
        let points = trace.points.iter().zip(rays);
        Self {
            run: trace.run.clone(),
            sense: trace.sense,
            points: trace.points.len(),
            quantities,
            deviations: points.map(|(point, ray)| [point.angle_deg, ray.deviation(centre)]).collect(),
        }
    }
}

fn arc_finding(arc: &CoveredArc, allowed: FitConditions) -> Option<Finding> {
    let &CoveredArc { span_deg, condition, full, .. } = arc;
    if !allowed.free_centre {
        Some(Finding::ArcWithoutCentre { span_deg, condition, most: MAX_CONDITION })
    } else if !full {
        Some(Finding::PartialArc { span_deg, condition })
    } else {
        None
    }
}

fn check_input(traces: &[CircleTrace], settings: &CircularSettings) -> Result<(), Finding> {
    let radius_mm = settings.radius_mm;
    if !(radius_mm.is_finite() && radius_mm > 0.0) {
        return Err(Finding::Radius { radius_mm });
    }
    if traces.is_empty() {
        return Err(Finding::NoLength);
    }
    for CircleTrace { run, sense, points } in traces {
        let (run, direction) = (run.clone(), sense.word());
        if points.len() < MIN_CIRCLE_POINTS {
            return Err(Finding::TooFewPoints {
                run,
                direction,
                points: points.len(),
                least: MIN_CIRCLE_POINTS,
            });
        }
        // NaN counts as far from the radius.
        let near = |point: &&CirclePoint| (point.length_mm - radius_mm).abs() <= FAR_OFF * radius_mm;
        if let Some(&CirclePoint { angle_deg, length_mm, .. }) = points.iter().find(|point| !near(point)) {
            return Err(Finding::FarFromRadius { run, direction, angle_deg, length_mm, radius_mm });
        }
    }
    Ok(())
}

#[cfg(test)]
mod evaluation_tests {
    use super::*;

    /// 36 points of a ball that is off by 0.2 and -0.1 mm, in both senses.
    fn traces(clockwise_mm: f64) -> Vec<CircleTrace> {
        let trace = |sense, offset_mm: f64| {
            let turn = if sense == CircleSense::CounterClockwise { 10.0 } else { -10.0 };
            let points = (0..36).map(|at| {
                let angle_deg = turn * f64::from(at);
                let (sin, cos) = angle_deg.to_radians().sin_cos();
                CirclePoint {
                    angle_deg,
                    length_mm: (150.0 * cos - 0.2).hypot(150.0 * sin + 0.1) + offset_mm,
                    sigma_mm: None,
                    t_s: None,
                    temp_c: None,
                    axes_deg: None,
                    drives: None,
                }
            });
            CircleTrace { run: "1".into(), sense, points: points.collect() }
        };
        vec![trace(CircleSense::CounterClockwise, 0.010), trace(CircleSense::Clockwise, clockwise_mm)]
    }

    fn settings() -> CircularSettings {
        CircularSettings { sigma_mm: Some(0.001), draws: 0, ..CircularSettings::new(150.0) }
    }

    #[test]
    fn a_circle_is_evaluated_about_its_centre() {
        let found = circular(&traces(0.006), &settings()).unwrap();
        for (name, expected) in
            [("D", 0.008), ("x", 0.2), ("y", -0.1), ("H", 0.004), ("Gb", 0.004), ("F_max", 0.010)]
        {
            assert!((found.get(name).value.unwrap() - expected).abs() < 1e-9, "{name}");
        }
        assert_eq!(found.get("unknown"), CircularQuantity::default());
        assert!(found.free_centre && found.arc.full && found.as_measured.is_none());
        assert!((found.sigma_mm - 0.001).abs() < 1e-15);
        assert_eq!((found.sigma_source, found.draws), (LengthSigmaSource::Given, 0));
        assert!(found.notes.iter().any(|note| matches!(note.finding(), Some(Finding::AsMeasured))));
        assert_eq!(found.traces.len(), 2);
        assert!((found.traces[1].deviations[9][0] + 90.0).abs() < 1e-12);
        assert!((found.traces[1].deviations[9][1] - 0.006).abs() < 1e-9);
    }

    #[test]
    fn an_arc_has_a_finding_and_no_diagnosis() {
        let arc = |points: usize| {
            let mut traces = traces(0.010);
            traces.iter_mut().for_each(|trace| trace.points.truncate(points));
            circular(&traces[..1], &settings()).unwrap()
        };
        let half = arc(19);
        assert!(
            !half.free_centre && half.get("G_lsc").value.is_some() && half.diagnosis.harmonics.is_empty()
        );
        assert!(half.notes.iter().any(
            |note| matches!(note.finding(), Some(Finding::PartialArc { span_deg, .. }) if (span_deg - 180.0).abs() < 1e-9)
        ));
        let short = arc(6);
        assert!(short.get("G_lsc").value.is_none() && short.get("F_max").value.is_some());
        assert!(
            short.notes.iter().any(|note| matches!(note.finding(), Some(Finding::ArcWithoutCentre { .. })))
        );
    }

    #[test]
    fn impossible_input_is_refused() {
        let error = |traces: &[CircleTrace], radius_mm| {
            circular(traces, &CircularSettings { radius_mm, ..settings() }).unwrap_err()
        };
        assert!(matches!(error(&traces(0.0), f64::NAN), Finding::Radius { .. }));
        assert!(matches!(error(&traces(0.0), 0.0), Finding::Radius { .. }));
        assert!(matches!(error(&[], 150.0), Finding::NoLength));
        let mut few = traces(0.0);
        few[1].points.truncate(4);
        assert!(matches!(error(&few, 150.0), Finding::TooFewPoints { points: 4, least: 5, .. }));
        // A fifth of the radius is the most.
        let mut far = traces(0.0);
        far[0].points[3].length_mm = 180.01;
        assert!(matches!(error(&far, 150.0), Finding::FarFromRadius { angle_deg, .. } if angle_deg == 30.0));
        far[0].points[3].length_mm = 119.99;
        assert!(matches!(error(&far, 150.0), Finding::FarFromRadius { .. }));
        far[0].points[3].length_mm = 179.99;
        assert!(circular(&far, &settings()).is_ok());
    }

    #[test]
    fn a_trace_against_its_direction_is_reported() {
        let mut traces = traces(0.010);
        traces[0].points.reverse();
        let found = circular(&traces, &settings()).unwrap();
        let against = found.notes.iter().filter(|note| {
            matches!(note.finding(), Some(Finding::AgainstDirection { direction: "ccw", .. }))
        });
        assert_eq!(against.count(), 1);
    }
}

#[cfg(test)]
mod tests;
