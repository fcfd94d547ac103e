//! The quantities of ISO 230-4 from lengths. The Monte Carlo calls the same function.

use super::fit::{RadialMeasurement, fit_circle};
use super::zone::{extremes, minimum_zone, width};
use super::{CircleSense, CircleTrace, CircularQuantity, CoveredArc, MAX_CONDITION};

/// The quantities of a test: circular deviation about the least-squares centre and of the minimum zone (the largest of
/// the traces, each about its own centre), bi-directional circular deviation, mean radial deviation, largest and
/// smallest radial deviation, hysteresis (1996), and the base ball relative to the programmed centre.
pub const QUANTITY_NAMES: [&str; 9] = ["G_lsc", "G_mzc", "Gb", "D", "F_max", "F_min", "H", "x", "y"];
/// The quantities of a single trace, about its own centre (F about that of the test).
pub const TRACE_NAMES: [&str; 7] = ["G_lsc", "G_mzc", "D", "F_max", "F_min", "x", "y"];

#[derive(Clone, Debug)]
pub(super) struct RadialTraces {
    pub(super) traces: Vec<Vec<RadialMeasurement>>,
    pub(super) pairs: Vec<FacingTraces>,
    /// Centre of the deviations, mm.
    pub(super) centre: [f64; 2],
}

/// A counter-clockwise and a clockwise trace, and which of their points face each other.
#[derive(Clone, Debug)]
pub(super) struct FacingTraces {
    ccw: usize,
    cw: usize,
    /// A counter-clockwise point, the clockwise points on either side of it, and the weight of the second.
    points: Vec<(usize, [usize; 2], f64)>,
}

impl FacingTraces {
    /// The pair without its facing points.
    pub(super) fn unresolved(&self) -> Self {
        Self { points: Vec::new(), ..*self }
    }
}

#[derive(Clone, Copy, Debug)]
pub(super) struct FitConditions {
    /// Whether a centre can be fitted.
    pub(super) free_centre: bool,
    /// Whether F is about the fitted centre: on a full circle only.
    pub(super) full: bool,
    /// Whether both senses cover the same arc.
    pub(super) both: bool,
}

impl FitConditions {
    pub(super) fn of(arc: &CoveredArc) -> Self {
        let free_centre = arc.condition <= MAX_CONDITION;
        Self { free_centre, full: arc.full && free_centre, both: true }
    }
}

/// The values of all quantities; NaN if undefined.
#[derive(Clone, Debug, Default)]
pub(super) struct QuantityValues {
    /// By [`QUANTITY_NAMES`].
    pub(super) overall: [f64; QUANTITY_NAMES.len()],
    /// By [`TRACE_NAMES`], for each trace.
    pub(super) alone: Vec<[f64; TRACE_NAMES.len()]>,
}

impl RadialTraces {
    pub(super) fn new(traces: &[CircleTrace], radius_mm: f64) -> Self {
        let ray = |angle_deg: f64, length_mm: f64| {
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            RadialMeasurement { point: [radius_mm * cos, radius_mm * sin], length_mm }
        };
        let rays = |trace: &CircleTrace| {
            trace.points.iter().map(|point| ray(point.angle_deg, point.length_mm)).collect()
        };
        let of =
            |sense: CircleSense| traces.iter().enumerate().filter(move |(_, trace)| trace.sense == sense);
        // The n-th trace of one sense faces the n-th of the other.
        let pairs = of(CircleSense::CounterClockwise)
            .zip(of(CircleSense::Clockwise))
            .map(|((ccw, there), (cw, back))| FacingTraces { ccw, cw, points: facing(there, back) })
            .collect();
        Self { traces: traces.iter().map(rays).collect(), pairs, centre: [0.0; 2] }
    }

    /// The facing points of two traces, as in [`FacingTraces`].
    pub(super) fn facing(
        &self,
        ccw: usize,
        cw: usize,
    ) -> Option<impl Iterator<Item = (usize, [usize; 2], f64)> + '_> {
        let pair = self.pairs.iter().find(|pair| (pair.ccw, pair.cw) == (ccw, cw))?;
        Some(pair.points.iter().copied())
    }

    pub(super) fn all(&self) -> impl Iterator<Item = RadialMeasurement> + Clone {
        self.traces.iter().flatten().copied()
    }

    pub(super) fn deviation(&self, trace: usize, point: usize) -> f64 {
        self.traces[trace][point].deviation(self.centre)
    }
}

/// The points of `back` on either side of each point of `there`, if they are near.
fn facing(there: &CircleTrace, back: &CircleTrace) -> Vec<(usize, [usize; 2], f64)> {
    let wrapped = |trace: &CircleTrace, at: usize| trace.points[at].angle_deg.rem_euclid(360.0);
    let mut order: Vec<usize> = (0..back.points.len()).collect();
    order.sort_by(|&a, &b| wrapped(back, a).total_cmp(&wrapped(back, b)));
    let count = order.len();
    let near_deg = 3.0 * 360.0 / count as f64;
    (0..there.points.len())
        .filter_map(|at| {
            let angle = wrapped(there, at);
            let next = order.partition_point(|&other| wrapped(back, other) <= angle + 1e-9);
            let (left, right) = (order[(next + count - 1) % count], order[next % count]);
            let before = (angle - wrapped(back, left) + 1e-9).rem_euclid(360.0);
            let after = (wrapped(back, right) - angle).rem_euclid(360.0);
            if before < 2e-9 {
                return Some((at, [left, left], 0.0));
            }
            (before + after <= near_deg).then(|| (at, [left, right], before / (before + after)))
        })
        .collect()
}

/// `None` if the points determine no circle.
pub(super) fn evaluate(rays: &RadialTraces, allowed: FitConditions) -> Option<QuantityValues> {
    let nothing = f64::NAN;
    let joint = if allowed.free_centre { Some(fit_circle(rays.all())?) } else { None };
    let centre = joint.map_or([0.0; 2], |circle| circle.centre);
    let f_centre = if allowed.full { centre } else { [0.0; 2] };
    let alone: Vec<[f64; TRACE_NAMES.len()]> = rays
        .traces
        .iter()
        .map(|trace| {
            let [f_min, f_max] = extremes(trace, f_centre);
            let own = joint
                .and_then(|_| fit_circle(trace.iter().copied()))
                .filter(|own| own.condition <= MAX_CONDITION);
            let Some(own) = own else {
                return [nothing, nothing, nothing, f_max, f_min, nothing, nothing];
            };
            let zone = minimum_zone(trace, own.centre).map_or(nothing, |zone| zone.width_mm);
            let [x, y] = own.centre;
            [width(trace, own.centre), zone, own.offset_mm, f_max, f_min, x, y]
        })
        .collect();
    let most = |at: usize| alone.iter().map(|values| values[at]).fold(f64::NEG_INFINITY, f64::max);
    // The largest value is undefined if that of any trace is.
    let most_of_all =
        |at: usize| if alone.iter().any(|values| values[at].is_nan()) { nothing } else { most(at) };
    let least = alone.iter().map(|values| values[4]).fold(f64::INFINITY, f64::min);
    let both = joint.filter(|_| allowed.both && !rays.pairs.is_empty());
    let gb = both.map_or(nothing, |circle| {
        let ranges = rays.traces.iter().map(|trace| extremes(trace, circle.centre));
        let [low, high] = ranges.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], range| {
            [low.min(range[0]), high.max(range[1])]
        });
        high - low
    });
    let h = both.map_or(nothing, |circle| hysteresis(rays, circle.centre));
    let offset = joint.map_or(nothing, |circle| circle.offset_mm);
    let [x, y] = joint.map_or([nothing; 2], |circle| circle.centre);
    let overall = [most_of_all(0), most_of_all(1), gb, offset, most(3), least, h, x, y];
    Some(QuantityValues { overall, alone })
}

/// Largest difference between the two senses at the same angle, mm.
fn hysteresis(rays: &RadialTraces, centre: [f64; 2]) -> f64 {
    let mut most = f64::NAN;
    for FacingTraces { ccw, cw, points } in &rays.pairs {
        let (there, back) = (&rays.traces[*ccw], &rays.traces[*cw]);
        for &(at, [left, right], weight) in points {
            let facing =
                (1.0 - weight) * back[left].deviation(centre) + weight * back[right].deviation(centre);
            most = most.max((there[at].deviation(centre) - facing).abs());
        }
    }
    most
}

impl QuantityValues {
    /// All values in one row.
    pub(super) fn row(&self) -> impl Iterator<Item = f64> {
        self.overall.iter().copied().chain(self.alone.iter().flatten().copied())
    }

    pub(super) fn overall_options(&self) -> Vec<Option<f64>> {
        self.overall.iter().map(|value| value.is_finite().then_some(*value)).collect()
    }

    /// The values with their uncertainties, which are in the order of [`QuantityValues::row`].
    pub(super) fn with(&self, u95: Option<&Vec<f64>>) -> (Vec<CircularQuantity>, Vec<Vec<CircularQuantity>>) {
        let mut all = self.row().enumerate().map(|(at, value)| CircularQuantity {
            value: value.is_finite().then_some(value),
            u95: u95.and_then(|u95| u95.get(at)).copied().filter(|u| u.is_finite() && value.is_finite()),
        });
        let overall = all.by_ref().take(QUANTITY_NAMES.len()).collect();
        let alone = self.alone.iter().map(|_| all.by_ref().take(TRACE_NAMES.len()).collect()).collect();
        (overall, alone)
    }
}
