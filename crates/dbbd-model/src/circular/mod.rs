//! The circular test: the quantities of ISO 230-4 from the lengths of a ball-bar.
//!
//! `docs/reference/circular-test.md` gives the definitions and their sources, and says which parts of the standard were not
//! available.

mod catalogue;
pub use catalogue::CircularFinding;

mod fit;
mod harmonics;
mod input;
mod noise;
mod plausibility;
mod quantities;
mod reversal;
mod temperature;
mod uncertainty;
mod zone;

pub use fit::{FittedCircle, RadialMeasurement, fit_circle};
pub use harmonics::{HarmonicDiagnosis, Harmonics, TERM_NAMES};
pub use input::{traces_from_csv, traces_from_table};
pub use noise::LengthSigmaSource;
pub use quantities::{QUANTITY_NAMES, TRACE_NAMES};
pub use reversal::{DriveBacklash, DriveId, Reversal};
pub use temperature::ThermalExpansion;
pub use zone::{MinimumZone, minimum_zone};

use crate::circular::CircularFinding as Finding;

use quantities::{FitConditions, RadialTraces, evaluate};

/// The sense of motion along a circle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, serde::Serialize, serde::Deserialize)]
pub enum CircleSense {
    #[serde(rename = "ccw")]
    CounterClockwise,
    #[serde(rename = "cw")]
    Clockwise,
}

impl CircleSense {
    /// `ccw` or `cw`.
    pub fn word(self) -> &'static str {
        match self {
            Self::CounterClockwise => "ccw",
            Self::Clockwise => "cw",
        }
    }
}

/// A length on the circle. Optional values are known or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CirclePoint {
    /// Programmed angle, degrees, counter-clockwise from the plane's first axis; need not be wrapped.
    pub angle_deg: f64,
    /// Distance between the ball centres, mm.
    pub length_mm: f64,
    /// Standard uncertainty.
    pub sigma_mm: Option<f64>,
    pub t_s: Option<f64>,
    /// Temperature of bar and machine.
    pub temp_c: Option<f64>,
    pub axes_deg: Option<[f64; 6]>,
    /// The joints, for the estimation of backlash.
    pub drives: Option<[DriveState; 6]>,
}

/// The state of a joint at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriveState {
    /// Derivative of the length by the joint angle, mm/rad.
    pub lever_mm: f64,
    /// Sense of the joint's last motion to the point: 1 or -1; 0 if unknown.
    pub sense: i8,
}

/// One pass of the circle, in the order of the motion.
#[derive(Clone, Debug, PartialEq)]
pub struct CircleTrace {
    pub run: String,
    pub sense: CircleSense,
    pub points: Vec<CirclePoint>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircularSettings {
    pub radius_mm: f64,
    /// Standard uncertainty of a single length; `None`: that of the points, or their scatter.
    pub sigma_mm: Option<f64>,
    /// Standard uncertainty of the bar's length, which is common to all lengths.
    pub bar_u_mm: f64,
    pub temperature: ThermalExpansion,
    /// Monte Carlo draws; 0 for none.
    pub draws: usize,
    pub seed: u64,
}

impl CircularSettings {
    pub fn new(radius_mm: f64) -> Self {
        let temperature = ThermalExpansion::default();
        Self { radius_mm, sigma_mm: None, bar_u_mm: 0.0, temperature, draws: 1000, seed: 1 }
    }
}

/// Fewest points that determine centre, radius and a deviation.
pub const MIN_CIRCLE_POINTS: usize = 5;
/// Largest relative difference of a length from the radius.
const FAR_OFF: f64 = 0.2;
/// Largest condition number for a free centre: excludes arcs of about 75 degrees and less.
pub const MAX_CONDITION: f64 = 30.0;
/// Largest spacing of a full circle, degrees.
const GAP_DEG: f64 = 60.0;

/// The covered arc.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct CoveredArc {
    /// First angle, degrees, 0..360.
    pub from_deg: f64,
    /// 360 for a full circle.
    pub span_deg: f64,
    /// Largest gap between neighbours.
    pub largest_gap_deg: f64,
    pub full: bool,
    /// Condition number of centre and radius.
    pub condition: f64,
}

/// A value and the half width of its 95 % interval; `None` if undefined.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct CircularQuantity {
    pub value: Option<f64>,
    pub u95: Option<f64>,
}

#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct TraceResult {
    pub run: String,
    pub sense: CircleSense,
    pub points: usize,
    /// In the order of [`TRACE_NAMES`], mm.
    pub quantities: Vec<CircularQuantity>,
    /// Angle (degrees) and deviation about the joint centre (mm), in the order of the motion.
    pub deviations: Vec<[f64; 2]>,
}

#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct CircularEvaluation {
    pub radius_mm: f64,
    pub arc: CoveredArc,
    /// In the order of [`QUANTITY_NAMES`], mm, referred to 20 degrees if possible.
    pub quantities: Vec<CircularQuantity>,
    /// The same without the temperature correction, if there is one.
    pub as_measured: Option<Vec<Option<f64>>>,
    /// Whether F is about the least-squares centre (b) or that of the instrument (a).
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
    pub notes: Vec<Finding>,
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
    let corrected = settings.temperature.apply(traces);
    let rays = |traces: &[CircleTrace]| RadialTraces::new(traces, settings.radius_mm);
    let mut measured = rays(corrected.as_deref().unwrap_or(traces));
    let joint = fit_circle(measured.all()).ok_or(Finding::NoCircle)?;
    let arc = arc(traces, joint.condition);
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
    let mut notes: Vec<Finding> = arc_finding(&arc, allowed).into_iter().collect();
    for trace in traces.iter().filter(|trace| !in_sense(trace)) {
        notes.push(Finding::AgainstDirection { run: trace.run.clone(), direction: trace.sense.word() });
    }
    notes.extend(plausibility::check_plausibility(traces, settings.radius_mm));
    let g_mm = quantities.first().and_then(|quantity| quantity.value);
    notes.extend(g_mm.and_then(|g_mm| plausibility::too_large(g_mm, settings.radius_mm)));
    if arc.full && unequal.is_none() {
        notes.extend(plausibility::centres_differ(traces, &measured));
    }
    notes.extend(unequal);
    notes.extend(
        settings.sigma_mm.and_then(|sigma_mm| plausibility::other_sigma(traces, &measured, sigma_mm)),
    );
    if corrected.is_none() {
        notes.push(Finding::AsMeasured);
    }
    let reversals = reversal::reversals(traces);
    let steps = if arc.full { reversal::backlash(traces, &measured) } else { Vec::new() };
    let joints: std::collections::BTreeSet<usize> = reversals.iter().map(|reversal| reversal.joint).collect();
    if steps.is_empty() && !joints.is_empty() {
        notes.push(Finding::StepsNotSeparable { joints: joints.len() });
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

/// Whether most steps are in the sense of the trace.
fn in_sense(trace: &CircleTrace) -> bool {
    let steps = trace.points.windows(2).map(|pair| {
        let step = (pair[1].angle_deg - pair[0].angle_deg + 180.0).rem_euclid(360.0) - 180.0;
        if step == 0.0 {
            0
        } else if (step > 0.0) == (trace.sense == CircleSense::CounterClockwise) {
            1
        } else {
            -1
        }
    });
    steps.sum::<i64>() >= 0
}

fn arc<'a>(traces: impl IntoIterator<Item = &'a CircleTrace>, condition: f64) -> CoveredArc {
    let points = traces.into_iter().flat_map(|trace| &trace.points);
    let mut angles: Vec<f64> = points.map(|point| point.angle_deg.rem_euclid(360.0)).collect();
    angles.sort_by(f64::total_cmp);
    angles.dedup_by(|b, a| (*b - *a) < 1e-6);
    let around = angles.first().map(|first| first + 360.0);
    let gaps = angles.iter().zip(angles.iter().skip(1).copied().chain(around)).map(|(a, b)| b - a);
    let (at, largest_gap_deg) =
        gaps.enumerate().fold((0, 0.0), |most, gap| if gap.1 > most.1 { gap } else { most });
    let usual_deg = 360.0 / angles.len().max(1) as f64;
    let full = largest_gap_deg <= (3.0 * usual_deg).clamp(2.0, GAP_DEG);
    let from_deg = if full { 0.0 } else { angles.get(at + 1).or(angles.first()).copied().unwrap_or(0.0) };
    let span_deg = if full { 360.0 } else { 360.0 - largest_gap_deg };
    CoveredArc { from_deg, span_deg, largest_gap_deg, full, condition }
}
