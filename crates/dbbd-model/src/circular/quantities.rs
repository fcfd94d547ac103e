//! The quantities of ISO 230-4 from lengths. The Monte Carlo calls the same function.

use super::reference_circle::{RadialMeasurement, extremes, fit_circle, minimum_zone, width};
use super::trace::{CircleSense, CircleTrace, CoveredArc};

/// The quantities of a test: circular deviation about the least-squares centre and of the minimum zone (the largest of
/// the traces, each about its own centre), bi-directional circular deviation, mean radial deviation, largest and
/// smallest radial deviation, hysteresis (1996), and the base ball relative to the programmed centre.
pub const QUANTITY_NAMES: [&str; 9] = ["G_lsc", "G_mzc", "Gb", "D", "F_max", "F_min", "H", "x", "y"];
/// The quantities of a single trace, about its own centre (F about that of the test).
pub const TRACE_NAMES: [&str; 7] = ["G_lsc", "G_mzc", "D", "F_max", "F_min", "x", "y"];

/// Largest condition number for a free centre: excludes arcs of about 75 degrees and less.
pub(super) const MAX_CONDITION: f64 = 30.0;

/// A value and the half width of its 95 % interval; `None` if undefined.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct CircularQuantity {
    pub value: Option<f64>,
    pub u95: Option<f64>,
}

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
    /// Values in the order of [`QUANTITY_NAMES`].
    overall: [f64; QUANTITY_NAMES.len()],
    /// Values in the order of [`TRACE_NAMES`], for each trace.
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

#[cfg(test)]
mod tests {
    use super::*;

    const RADIUS_MM: f64 = 100.0;
    const ALL: FitConditions = FitConditions { free_centre: true, full: true, both: true };

    fn trace(sense: CircleSense, points: &[(f64, f64)]) -> CircleTrace {
        let point = |&(angle_deg, deviation): &(f64, f64)| crate::circular::CirclePoint {
            angle_deg,
            length_mm: RADIUS_MM + deviation,
            sigma_mm: None,
            t_s: None,
            temp_c: None,
            axes_deg: None,
            drives: None,
        };
        CircleTrace { run: "1".into(), sense, points: points.iter().map(point).collect() }
    }

    /// Eight points whose deviations are offset +- amplitude in turn: the centre of the circle stays where it is.
    fn star(sense: CircleSense, offset: f64, amplitude: f64) -> CircleTrace {
        let sign = |at: i32| if at % 2 == 0 { amplitude } else { -amplitude };
        trace(sense, &(0..8).map(|at| (45.0 * f64::from(at), offset + sign(at))).collect::<Vec<_>>())
    }

    fn value(found: &QuantityValues, name: &str) -> f64 {
        found.overall[QUANTITY_NAMES.iter().position(|known| *known == name).unwrap()]
    }

    #[test]
    fn quantities_are_those_of_their_definitions() {
        let traces =
            [star(CircleSense::CounterClockwise, 0.010, 0.004), star(CircleSense::Clockwise, -0.006, 0.002)];
        let rays = RadialTraces::new(&traces, RADIUS_MM);
        let found = evaluate(&rays, ALL).unwrap();
        for (name, expected) in [
            // The larger of 2 * 0.004 and 2 * 0.002.
            ("G_lsc", 0.008),
            ("G_mzc", 0.008),
            // From -0.006 - 0.002 to 0.010 + 0.004.
            ("Gb", 0.022),
            ("D", 0.002),
            ("F_max", 0.014),
            ("F_min", -0.008),
            // The senses differ by 0.016 +- 0.002.
            ("H", 0.018),
            ("x", 0.0),
            ("y", 0.0),
        ] {
            assert!((value(&found, name) - expected).abs() < 1e-10, "{name}: {}", value(&found, name));
        }
        // G_lsc, G_mzc, D, F_max, F_min of the clockwise trace alone.
        for (found, expected) in found.alone[1].iter().zip([0.004, 0.004, -0.006, -0.004, -0.008, 0.0, 0.0]) {
            assert!((found - expected).abs() < 1e-10, "{found} for {expected}");
        }
        let (overall, alone) = found.with(Some(&(0..23).map(f64::from).collect()));
        assert_eq!((overall[8].u95, alone[0][0].u95, alone[1][6].u95), (Some(8.0), Some(9.0), Some(22.0)));
        assert_eq!(overall[3].value.map(|mm| (1e6 * mm).round()), Some(2000.0));
        assert_eq!((overall.len(), alone.len(), alone[1].len()), (9, 2, 7));
    }

    #[test]
    fn what_the_points_do_not_determine_is_not_a_number() {
        let traces =
            [star(CircleSense::CounterClockwise, 0.010, 0.004), star(CircleSense::Clockwise, -0.006, 0.002)];
        let rays = RadialTraces::new(&traces, RADIUS_MM);
        let one_arc = evaluate(&rays, FitConditions { both: false, ..ALL }).unwrap();
        assert!(value(&one_arc, "Gb").is_nan() && value(&one_arc, "H").is_nan());
        assert!((value(&one_arc, "G_lsc") - 0.008).abs() < 1e-10);
        let fixed = evaluate(&rays, FitConditions { free_centre: false, full: false, both: true }).unwrap();
        assert_eq!(fixed.overall_options().iter().filter(|value| value.is_some()).count(), 2);
        assert!(
            (value(&fixed, "F_max") - 0.014).abs() < 1e-12 && (value(&fixed, "F_min") + 0.008).abs() < 1e-12
        );
        let ccw = RadialTraces::new(&traces[..1], RADIUS_MM);
        assert!(value(&evaluate(&ccw, ALL).unwrap(), "H").is_nan());
    }

    #[test]
    fn facing_points_are_interpolated_by_angle() {
        let ccw =
            trace(CircleSense::CounterClockwise, &[(25.0, 0.0), (40.0, 0.0), (350.0, 0.0), (722.0, 0.0)]);
        let angles: Vec<(f64, f64)> = (0..18).rev().map(|at| (20.0 * f64::from(at), 0.0)).collect();
        let cw = trace(CircleSense::Clockwise, &angles);
        // The clockwise point at 20 k degrees has the number 17 - k.
        let found = facing(&ccw, &cw);
        let expected = [(0, [16, 15], 0.25), (1, [15, 15], 0.0), (2, [0, 17], 0.5), (3, [17, 16], 0.1)];
        assert_eq!(found.len(), 4);
        for ((at, sides, weight), (at_expected, sides_expected, expected)) in found.into_iter().zip(expected)
        {
            assert_eq!((at, sides), (at_expected, sides_expected));
            assert!((weight - expected).abs() < 1e-8, "{weight} for {expected}");
        }
    }

    #[test]
    fn points_in_a_gap_face_nothing() {
        let ccw = trace(CircleSense::CounterClockwise, &[(5.0, 0.0), (100.0, 0.0)]);
        // Ten points: neighbours are near up to 108 degrees.
        let cw = |last: f64| {
            let angles = (0..9).map(|at| (f64::from(at) * 10.0, 0.0)).chain([(last, 0.0)]);
            trace(CircleSense::Clockwise, &angles.collect::<Vec<_>>())
        };
        assert_eq!(facing(&ccw, &cw(187.0)).len(), 2);
        assert_eq!(facing(&ccw, &cw(189.0)).len(), 1);
    }

    /// The deviation of the other sense is 0.002 at 0 and 0.006 at 10 degrees: 0.003 at 2.5 and 0.004 at 5 degrees.
    #[test]
    fn hysteresis_is_interpolated_between_facing_points() {
        let back: Vec<(f64, f64)> =
            (0..36).map(|at| (10.0 * f64::from(at), 0.002 + 0.004 * f64::from(at % 2))).collect();
        let cw = trace(CircleSense::Clockwise, &back);
        for (angle, facing_mm) in [(2.5, 0.003), (5.0, 0.004), (10.0, 0.006), (17.5, 0.003), (352.5, 0.005)] {
            let ccw = trace(CircleSense::CounterClockwise, &[(angle, 0.010)]);
            let rays = RadialTraces::new(&[ccw, cw.clone()], RADIUS_MM);
            let found = hysteresis(&rays, [0.0; 2]);
            assert!((found - (0.010 - facing_mm)).abs() < 1e-9, "{angle}: {found}");
        }
        // The largest magnitude counts, whichever sense is longer.
        let ccw = trace(CircleSense::CounterClockwise, &[(0.0, 0.003), (20.0, -0.011)]);
        let rays = RadialTraces::new(&[cw, ccw], RADIUS_MM);
        assert!((hysteresis(&rays, [0.0; 2]) - 0.013).abs() < 1e-12);
        assert_eq!(rays.facing(1, 0).map(Iterator::count), Some(2));
        assert!(rays.facing(0, 1).is_none());
    }

    #[test]
    fn conditions_follow_the_arc() {
        let arc = |condition, full| CoveredArc {
            from_deg: 0.0,
            span_deg: 360.0,
            largest_gap_deg: 1.0,
            full,
            condition,
        };
        let of = |condition, full| {
            let FitConditions { free_centre, full, both } = FitConditions::of(&arc(condition, full));
            [free_centre, full, both]
        };
        assert_eq!(of(MAX_CONDITION, true), [true, true, true]);
        assert_eq!(of(MAX_CONDITION, false), [true, false, true]);
        assert_eq!(of(MAX_CONDITION + 0.1, true), [false, false, true]);
    }
}
