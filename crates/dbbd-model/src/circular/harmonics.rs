//! Harmonics of the deviation per sense, and their interpretation for a machine with two linear axes.

use nalgebra::{SMatrix, SVector};

use super::noise::TraceNoise;
use super::quantities::RadialTraces;
use super::trace::{CircleSense, CircleTrace};
use crate::math::distributions::COVERAGE_95;

/// r + a cos + b sin + c2 cos 2 + s2 sin 2 of the deviation about the joint centre, mm.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Harmonics {
    pub sense: CircleSense,
    /// r, a, b, c2, s2, mm.
    pub values_mm: [f64; TERMS],
    /// Half widths of their 95 % intervals from the noise of the lengths, mm.
    pub u95_mm: [f64; TERMS],
}

pub const TERM_NAMES: [&str; TERMS] = ["r", "a", "b", "c2", "s2"];
const TERMS: usize = 5;

/// The interpretation of the harmonics. Empty for an arc, where they are linearly dependent.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct HarmonicDiagnosis {
    pub harmonics: Vec<Harmonics>,
    /// Scale error of the first axis minus that of the second: 2 c2 / R, mean of the senses. With half width.
    pub scale_mismatch: Option<[f64; 2]>,
    /// Squareness, rad: s2 / R summed over both senses. With one sense, twice its value, which includes a servo
    /// mismatch.
    pub squareness_rad: Option<[f64; 2]>,
    /// Whether both senses separate squareness from servo mismatch.
    both_senses: bool,
    /// Lag of the second axis behind the first, s, if times give the speed.
    pub servo_mismatch_s: Option<[f64; 2]>,
}

pub(super) fn diagnose(
    traces: &[CircleTrace],
    rays: &RadialTraces,
    radius_mm: f64,
    noise: &TraceNoise,
) -> HarmonicDiagnosis {
    let of = |sense| fit_sense(traces, rays, noise, sense);
    let (ccw, cw) = (of(CircleSense::CounterClockwise), of(CircleSense::Clockwise));
    let harmonics: Vec<Harmonics> = [ccw, cw].into_iter().flatten().collect();
    if harmonics.is_empty() {
        return HarmonicDiagnosis::default();
    }
    let count = harmonics.len() as f64;
    // Mean over the senses with its half width.
    let mean = |term: usize| {
        let value = harmonics.iter().map(|found| found.values_mm[term]).sum::<f64>() / count;
        let u = harmonics.iter().map(|found| found.u95_mm[term].powi(2)).sum::<f64>().sqrt() / count;
        [2.0 * value / radius_mm, 2.0 * u / radius_mm]
    };
    let servo_mismatch_s = ccw.zip(cw).zip(speed_mm_s(traces, radius_mm)).map(|((ccw, cw), speed)| {
        [(cw.values_mm[4] - ccw.values_mm[4]) / speed, ccw.u95_mm[4].hypot(cw.u95_mm[4]) / speed]
    });
    HarmonicDiagnosis {
        scale_mismatch: Some(mean(3)),
        squareness_rad: Some(mean(4)),
        both_senses: harmonics.len() == 2,
        servo_mismatch_s,
        harmonics,
    }
}

fn fit_sense(
    traces: &[CircleTrace],
    rays: &RadialTraces,
    noise: &TraceNoise,
    sense: CircleSense,
) -> Option<Harmonics> {
    let mut normal = SMatrix::<f64, TERMS, TERMS>::zeros();
    let mut right = SVector::<f64, TERMS>::zeros();
    let mut variance = 0.0;
    let mut count = 0;
    for (at, trace) in traces.iter().enumerate().filter(|(_, trace)| trace.sense == sense) {
        for ((place, point), sigma) in trace.points.iter().enumerate().zip(&noise.sigma_mm[at]) {
            let (sin, cos) = point.angle_deg.to_radians().sin_cos();
            let row = SVector::from([1.0, cos, sin, cos * cos - sin * sin, 2.0 * sin * cos]);
            normal += row * row.transpose();
            right += row * rays.deviation(at, place);
            variance += sigma * sigma;
            count += 1;
        }
    }
    let inverse = normal.try_inverse()?;
    let solved = inverse * right;
    let solved = solved + inverse * (right - normal * solved);
    let sigma = (variance / f64::from(count.max(1))).sqrt();
    Some(Harmonics {
        sense,
        values_mm: solved.into(),
        u95_mm: std::array::from_fn(|term| COVERAGE_95 * sigma * inverse[(term, term)].sqrt()),
    })
}

/// Median speed along the circle, mm/s, if all points have times.
fn speed_mm_s(traces: &[CircleTrace], radius_mm: f64) -> Option<f64> {
    let mut speeds = Vec::new();
    for trace in traces {
        for pair in trace.points.windows(2) {
            let turned = (pair[1].angle_deg - pair[0].angle_deg).abs().to_radians();
            let elapsed_s = pair[1].t_s? - pair[0].t_s?;
            if elapsed_s > 0.0 && turned < 1.0 {
                speeds.push(radius_mm * turned / elapsed_s);
            }
        }
    }
    speeds.sort_by(f64::total_cmp);
    let median = speeds.get(speeds.len() / 2).copied()?;
    (median > 0.0).then_some(median)
}

#[cfg(test)]
mod tests {
    use super::*;

    const RADIUS_MM: f64 = 200.0;
    const POINTS: usize = 72;
    const STEP_S: f64 = 0.05;

    fn trace(sense: CircleSense, [r, a, b, c2, s2]: [f64; 5]) -> CircleTrace {
        let sign = if sense == CircleSense::CounterClockwise { 1.0 } else { -1.0 };
        let point = |at: usize| {
            let angle_deg = sign * 5.0 * at as f64;
            let theta = angle_deg.to_radians();
            let second = c2 * (2.0 * theta).cos() + s2 * (2.0 * theta).sin();
            crate::circular::CirclePoint {
                angle_deg,
                length_mm: RADIUS_MM + r + a * theta.cos() + b * theta.sin() + second,
                sigma_mm: None,
                t_s: Some(STEP_S * at as f64),
                temp_c: None,
                axes_deg: None,
                drives: None,
            }
        };
        CircleTrace { run: "1".into(), sense, points: (0..POINTS).map(point).collect() }
    }

    fn diagnosed(traces: &[CircleTrace]) -> HarmonicDiagnosis {
        let rays = RadialTraces::new(traces, RADIUS_MM);
        let sigma_mm = vec![vec![0.002; POINTS]; traces.len()];
        let noise =
            TraceNoise { sigma_mm, source: crate::circular::noise::LengthSigmaSource::Given, freedom: None };
        diagnose(traces, &rays, RADIUS_MM, &noise)
    }

    #[test]
    fn harmonics_and_their_intervals_are_recovered() {
        let terms = [0.01, 0.02, -0.03, 0.004, 0.005];
        let found = diagnosed(&[trace(CircleSense::CounterClockwise, terms)]);
        assert!(!found.both_senses && found.servo_mismatch_s.is_none() && found.harmonics.len() == 1);
        for (value, expected) in found.harmonics[0].values_mm.iter().zip(terms) {
            assert!((value - expected).abs() < 1e-12, "{value} for {expected}");
        }
        // The columns are orthogonal on a full circle: variance sigma^2 / n of the mean, 2 sigma^2 / n of the others.
        for (u95, share) in found.harmonics[0].u95_mm.iter().zip([1.0, 2.0, 2.0, 2.0, 2.0]) {
            assert!((u95 - 1.96 * 0.002 * (share / 72.0_f64).sqrt()).abs() < 1e-12);
        }
        // 2 c2 / R and 2 s2 / R.
        let ([scale, scale_u], [square, square_u]) =
            (found.scale_mismatch.unwrap(), found.squareness_rad.unwrap());
        assert!((scale - 4e-5).abs() < 1e-13 && (square - 5e-5).abs() < 1e-13);
        let u = 2.0 / RADIUS_MM * 1.96 * 0.002 / 6.0;
        assert!((scale_u - u).abs() < 1e-12 && (square_u - u).abs() < 1e-12);
    }

    #[test]
    fn both_senses_separate_squareness_from_servo_mismatch() {
        let found = diagnosed(&[
            trace(CircleSense::CounterClockwise, [0.0, 0.0, 0.0, 0.004, 0.001]),
            trace(CircleSense::Clockwise, [0.0, 0.0, 0.0, 0.006, 0.009]),
        ]);
        assert!(found.both_senses);
        assert_eq!(found.harmonics.iter().map(|found| found.sense.word()).collect::<Vec<_>>(), ["ccw", "cw"]);
        let ([scale, scale_u], [square, _]) = (found.scale_mismatch.unwrap(), found.squareness_rad.unwrap());
        assert!((scale - 0.01 / RADIUS_MM).abs() < 1e-13 && (square - 0.01 / RADIUS_MM).abs() < 1e-13);
        let u95 = 1.96 * 0.002 / 6.0;
        assert!((scale_u - 2.0 / RADIUS_MM * u95 / 2f64.sqrt()).abs() < 1e-13);
        // The lag is the difference of s2 over the speed along the circle.
        let speed = RADIUS_MM * 5f64.to_radians() / STEP_S;
        let [lag, lag_u] = found.servo_mismatch_s.unwrap();
        assert!((lag - 0.008 / speed).abs() < 1e-12 && (lag_u - 2f64.sqrt() * u95 / speed).abs() < 1e-12);
    }

    #[test]
    fn speed_is_the_median_and_needs_all_times() {
        let mut traces = [trace(CircleSense::Clockwise, [0.0; 5])];
        let speed = RADIUS_MM * 5f64.to_radians() / STEP_S;
        traces[0].points[10].t_s = Some(STEP_S * 9.1);
        assert!((speed_mm_s(&traces, RADIUS_MM).unwrap() - speed).abs() < 1e-6);
        traces[0].points[10].t_s = None;
        assert_eq!(speed_mm_s(&traces, RADIUS_MM), None);
        let empty = CircleTrace { points: Vec::new(), ..traces[0].clone() };
        assert_eq!(diagnosed(&[empty]), HarmonicDiagnosis::default());
    }
}
