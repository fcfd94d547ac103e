//! The traces of a circular test, the arc that they cover, their lengths referred to 20 degrees Celsius, and the settings.

use crate::base::expansion::ThermalExpansion;

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

impl CoveredArc {
    /// The arc that all points of some traces cover; `condition` is that of their circle.
    pub(super) fn of<'a>(traces: impl IntoIterator<Item = &'a CircleTrace>, condition: f64) -> Self {
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
        Self { from_deg, span_deg, largest_gap_deg, full, condition }
    }
}

impl CircleTrace {
    /// Whether most steps are in the sense of the self.
    pub(super) fn is_in_sense(&self) -> bool {
        let steps = self.points.windows(2).map(|pair| {
            let step = (pair[1].angle_deg - pair[0].angle_deg + 180.0).rem_euclid(360.0) - 180.0;
            if step == 0.0 {
                0
            } else if (step > 0.0) == (self.sense == CircleSense::CounterClockwise) {
                1
            } else {
                -1
            }
        });
        steps.sum::<i64>() >= 0
    }
}

/// The traces with lengths at 20 degrees; `None` if no expansion is known or a point has no temperature.
pub(super) fn referred(traces: &[CircleTrace], expansion: ThermalExpansion) -> Option<Vec<CircleTrace>> {
    if expansion.bar_per_k.is_none() && expansion.machine_per_k.is_none() {
        return None;
    }
    let mut referred = traces.to_vec();
    for point in referred.iter_mut().flat_map(|trace| &mut trace.points) {
        point.length_mm = expansion.referred_mm(point.length_mm, point.temp_c?);
    }
    Some(referred)
}

/// The inputs of a test besides its traces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircularSettings {
    pub radius_mm: f64,
    /// Standard uncertainty of a single length; `None`: it follows from the points, or from their scatter.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn trace(sense: CircleSense, angles: impl IntoIterator<Item = f64>) -> CircleTrace {
        let point = |angle_deg| CirclePoint {
            angle_deg,
            length_mm: 100.0,
            sigma_mm: None,
            t_s: None,
            temp_c: Some(25.0),
            axes_deg: None,
            drives: None,
        };
        CircleTrace { run: "1".into(), sense, points: angles.into_iter().map(point).collect() }
    }

    #[test]
    fn lengths_with_a_temperature_are_referred_to_20_degrees() {
        let expansion = ThermalExpansion { bar_per_k: Some(11.5e-6), ..ThermalExpansion::default() };
        let traces = [trace(CircleSense::CounterClockwise, [0.0, 90.0])];
        let found = referred(&traces, expansion).unwrap();
        assert!((found[0].points[1].length_mm - 100.0 * (1.0 + 57.5e-6)).abs() < 1e-12);
        assert!(referred(&traces, ThermalExpansion::default()).is_none());
        let mut unknown = traces;
        unknown[0].points[0].temp_c = None;
        assert!(referred(&unknown, expansion).is_none());
    }

    #[test]
    fn the_covered_arc_begins_after_the_largest_gap() {
        let of = |angles: &[f64]| {
            CoveredArc::of(&[trace(CircleSense::CounterClockwise, angles.iter().copied())], 3.0)
        };
        let around: Vec<f64> = (0..12).map(|at| 30.0 * f64::from(at)).collect();
        let full = of(&around);
        assert_eq!((full.full, full.from_deg, full.span_deg, full.largest_gap_deg), (true, 0.0, 360.0, 30.0));
        // 300 to 60 degrees, in any order; the same angle counts once.
        let arc = of(&[0.0, 20.0, 40.0, 60.0, -20.0, 320.0, 300.0, 660.0]);
        assert_eq!((arc.full, arc.from_deg, arc.span_deg, arc.largest_gap_deg), (false, 300.0, 120.0, 240.0));
        assert_eq!(arc.condition, 3.0);
        // Three times the usual spacing of 360 / 9 is more than 60 degrees, which is the most.
        assert!(of(&[0.0, 60.0, 120.0, 180.0, 240.0, 300.0]).full);
        assert!(!of(&[0.0, 61.0, 120.0, 180.0, 240.0, 300.0]).full);
        // 120 points: gaps of up to 9 degrees.
        let without = |missing: i32| {
            let angles = (0..120).filter(|at| !(50..50 + missing).contains(at)).map(|at| 3.0 * f64::from(at));
            of(&angles.collect::<Vec<_>>()).full
        };
        assert!(without(2) && !without(3));
    }

    #[test]
    fn the_sense_is_that_of_most_steps() {
        let ccw = |angles: &[f64]| trace(CircleSense::CounterClockwise, angles.iter().copied()).is_in_sense();
        assert!(ccw(&[340.0, 350.0, 0.0, 10.0]) && !ccw(&[10.0, 0.0, 350.0, 340.0]));
        assert!(ccw(&[0.0, 10.0, 10.0, 5.0]), "as many against it");
        assert!(trace(CircleSense::Clockwise, [10.0, 0.0, 350.0, 340.0]).is_in_sense());
        assert!(!trace(CircleSense::Clockwise, [0.0, 10.0, 20.0]).is_in_sense());
    }
}
