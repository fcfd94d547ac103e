//! Harmonics of the deviation per sense, and their interpretation for a machine with two linear axes.

use nalgebra::{SMatrix, SVector};

use super::noise::TraceNoise;
use super::quantities::RadialTraces;
use super::{CircleSense, CircleTrace};

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
const NORMAL: f64 = 1.96;

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
    pub both_senses: bool,
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
        u95_mm: std::array::from_fn(|term| NORMAL * sigma * inverse[(term, term)].sqrt()),
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
