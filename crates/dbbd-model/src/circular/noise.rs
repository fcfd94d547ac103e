//! The standard uncertainty of a single length, for the Monte Carlo.

use super::quantities::RadialTraces;
use super::trace::{CircleSense, CircleTrace};
use crate::math::distributions::coverage_95_ratio;
use crate::math::robust::{SIGMA_OF_MAD, median};

/// The source of the standard uncertainty of a single length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum LengthSigmaSource {
    Given,
    /// The standard uncertainty of each length, without the repeatability of the robot.
    Lengths,
    /// The standard uncertainty of each length, but at least the difference of repeated passes.
    LengthsAndPasses,
    /// The difference of repeated passes.
    Passes,
    /// The scatter between neighbours.
    Neighbours,
}

impl LengthSigmaSource {
    /// The text in circle.json and on the page.
    pub fn word(self) -> &'static str {
        match self {
            Self::Given => "as given",
            Self::Lengths => "of each length; the repeatability of the robot is not in it",
            Self::LengthsAndPasses => "of each length, not less than the difference of repeated passes",
            Self::Passes => "difference of repeated passes",
            Self::Neighbours => "scatter between neighbours",
        }
    }
}

/// Standard deviation of a single length, mm, and its degrees of freedom.
struct LengthScatter {
    sigma_mm: f64,
    freedom: f64,
}

#[derive(Clone, Debug)]
pub(super) struct TraceNoise {
    /// Standard uncertainty per trace and point, mm.
    pub(super) sigma_mm: Vec<Vec<f64>>,
    pub(super) source: LengthSigmaSource,
    /// Degrees of freedom of an estimate; `None` if it is known.
    pub(super) freedom: Option<f64>,
}

impl TraceNoise {
    pub(super) fn mean(&self) -> f64 {
        let count = self.sigma_mm.iter().map(Vec::len).sum::<usize>().max(1);
        self.sigma_mm.iter().flatten().sum::<f64>() / count as f64
    }

    /// Ratio of the 95 % quantiles of Student's t and the normal distribution.
    pub(super) fn student(&self) -> f64 {
        self.freedom.map_or(1.0, coverage_95_ratio)
    }
}

/// The given uncertainty. Else the uncertainty of the points, but at least the difference of repeated passes. Else that
/// difference, else the scatter between neighbours.
pub(super) fn estimate_noise(traces: &[CircleTrace], rays: &RadialTraces, given: Option<f64>) -> TraceNoise {
    let all = |sigma: f64| traces.iter().map(|trace| vec![sigma; trace.points.len()]).collect();
    if let Some(sigma) = given {
        return TraceNoise { sigma_mm: all(sigma), source: LengthSigmaSource::Given, freedom: None };
    }
    let repeated = repeated(traces, rays);
    let own: Option<Vec<Vec<f64>>> =
        traces.iter().map(|trace| trace.points.iter().map(|point| point.sigma_mm).collect()).collect();
    let Some(mut sigma_mm) = own else {
        let (source, scatter) = match repeated {
            Some(repeated) => (LengthSigmaSource::Passes, repeated),
            None => (LengthSigmaSource::Neighbours, neighbours(traces, rays)),
        };
        return TraceNoise { sigma_mm: all(scatter.sigma_mm), source, freedom: Some(scatter.freedom) };
    };
    let Some(LengthScatter { sigma_mm: least_mm, freedom }) = repeated else {
        return TraceNoise { sigma_mm, source: LengthSigmaSource::Lengths, freedom: None };
    };
    sigma_mm.iter_mut().flatten().for_each(|sigma| *sigma = sigma.max(least_mm));
    TraceNoise { sigma_mm, source: LengthSigmaSource::LengthsAndPasses, freedom: Some(freedom) }
}

/// Indices of the points in the order of their angles.
fn by_angle(trace: &CircleTrace) -> Vec<usize> {
    let mut order: Vec<usize> = (0..trace.points.len()).collect();
    let angle = |at: usize| trace.points[at].angle_deg.rem_euclid(360.0);
    order.sort_by(|&a, &b| angle(a).total_cmp(&angle(b)));
    order
}

/// Standard deviation between passes in the same sense at the same angles; `None` without such passes.
fn repeated(traces: &[CircleTrace], rays: &RadialTraces) -> Option<LengthScatter> {
    let (mut squares, mut freedom) = (0.0, 0);
    for sense in [CircleSense::CounterClockwise, CircleSense::Clockwise] {
        let passes: Vec<(usize, Vec<usize>)> = (0..traces.len())
            .filter(|&at| traces[at].sense == sense)
            .map(|at| (at, by_angle(&traces[at])))
            .collect();
        let Some((first, order)) = passes.first() else { continue };
        let same = |(other, theirs): &(usize, Vec<usize>)| {
            theirs.len() == order.len()
                && order.iter().zip(theirs).all(|(&a, &b)| {
                    (traces[*first].points[a].angle_deg - traces[*other].points[b].angle_deg).abs() < 1e-6
                })
        };
        if passes.len() < 2 || !passes.iter().all(same) {
            continue;
        }
        for place in 0..order.len() {
            let values = || passes.iter().map(|(at, order)| rays.deviation(*at, order[place]));
            let mean = values().sum::<f64>() / passes.len() as f64;
            squares += values().map(|value| (value - mean).powi(2)).sum::<f64>();
            freedom += passes.len() - 1;
        }
    }
    (freedom > 0)
        .then(|| LengthScatter { sigma_mm: (squares / freedom as f64).sqrt(), freedom: freedom as f64 })
}

/// Robust scatter of second differences between neighbours. On a sparse circle it includes the form.
fn neighbours(traces: &[CircleTrace], rays: &RadialTraces) -> LengthScatter {
    /// Degrees of freedom per second difference: the median has 0.37 of the efficiency of the variance, and the
    /// correlations of neighbours, -2/3 and 1/6, cost a factor 1 + 2 (4/9 + 1/36).
    const FREEDOM: f64 = 0.19;
    let mut second = differences(traces, rays, [1.0, -2.0, 1.0]);
    let freedom = FREEDOM * second.len() as f64;
    LengthScatter { sigma_mm: SIGMA_OF_MAD * median(&mut second).unwrap_or(0.0), freedom }
}

/// Robust scatter of fourth differences, which include less of the form, mm.
pub(super) fn without_form(traces: &[CircleTrace], rays: &RadialTraces) -> f64 {
    let mut fourth = differences(traces, rays, [1.0, -4.0, 6.0, -4.0, 1.0]);
    SIGMA_OF_MAD * median(&mut fourth).unwrap_or(0.0)
}

/// Magnitudes of weighted differences of neighbours, scaled to the variance of a single length.
fn differences<const N: usize>(traces: &[CircleTrace], rays: &RadialTraces, weights: [f64; N]) -> Vec<f64> {
    let norm = weights.iter().map(|weight| weight * weight).sum::<f64>().sqrt();
    let mut found: Vec<f64> = Vec::new();
    for (at, trace) in traces.iter().enumerate() {
        let values: Vec<f64> = by_angle(trace).into_iter().map(|point| rays.deviation(at, point)).collect();
        let sum = |near: &[f64]| near.iter().zip(&weights).map(|(value, weight)| value * weight).sum::<f64>();
        found.extend(values.windows(N).map(|near| sum(near).abs() / norm));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace(sense: CircleSense, deviations: &[f64]) -> CircleTrace {
        let step = 360.0 / deviations.len() as f64;
        let point = |(at, deviation): (usize, &f64)| crate::circular::CirclePoint {
            angle_deg: step * at as f64,
            length_mm: 100.0 + deviation,
            sigma_mm: Some(0.001 * (1.0 + at as f64)),
            t_s: None,
            temp_c: None,
            axes_deg: None,
            drives: None,
        };
        CircleTrace { run: "1".into(), sense, points: deviations.iter().enumerate().map(point).collect() }
    }

    fn noise(traces: &[CircleTrace], given: Option<f64>) -> TraceNoise {
        estimate_noise(traces, &RadialTraces::new(traces, 100.0), given)
    }

    #[test]
    fn what_is_given_counts_then_what_the_points_state() {
        let traces = [trace(CircleSense::CounterClockwise, &[0.0; 4])];
        let given = noise(&traces, Some(0.002));
        assert_eq!((given.source, given.freedom, given.mean()), (LengthSigmaSource::Given, None, 0.002));
        assert_eq!(given.student(), 1.0);
        let own = noise(&traces, None);
        assert_eq!((own.source, own.freedom), (LengthSigmaSource::Lengths, None));
        // Mean of 1, 2, 3 and 4 um.
        assert!((own.mean() - 0.0025).abs() < 1e-15);
    }

    /// Two passes that differ by d at each of n points: s^2 = sum (d / 2)^2 2 / n = mean d^2 / 2, with n degrees of freedom.
    #[test]
    fn repeated_passes_show_the_repeatability() {
        let [one, two] = [[0.0, 0.004, 0.002, 0.0], [0.004, 0.0, 0.002, 0.004]];
        let ccw = CircleSense::CounterClockwise;
        let mut traces = vec![trace(ccw, &one), trace(ccw, &two)];
        let least_mm = (3.0 * 16e-6 / 8.0_f64).sqrt();
        let found = noise(&traces, None);
        assert_eq!((found.source, found.freedom), (LengthSigmaSource::LengthsAndPasses, Some(4.0)));
        for (sigma, stated) in found.sigma_mm[1].iter().zip([0.001, 0.002, 0.003, 0.004]) {
            assert!((sigma - f64::max(stated, least_mm)).abs() < 1e-12);
        }
        traces[0].points[2].sigma_mm = None;
        let found = noise(&traces, None);
        assert_eq!((found.source, found.freedom), (LengthSigmaSource::Passes, Some(4.0)));
        assert!((found.mean() - least_mm).abs() < 1e-12);
        // Other angles, or the other sense, are no repetition.
        traces[1].points[0].angle_deg += 1.0;
        assert_eq!(noise(&traces, None).source, LengthSigmaSource::Neighbours);
        let both = [trace(ccw, &one), trace(CircleSense::Clockwise, &two)];
        assert_eq!(noise(&both, None).source, LengthSigmaSource::Lengths);
    }

    /// Deviations of +-a in turn have second differences of 4 a / sqrt(6) and fourth ones of 16 a / sqrt(70).
    #[test]
    fn scatter_between_neighbours_is_that_of_differences() {
        let star: Vec<f64> = (0..40).map(|at| if at % 2 == 0 { 0.003 } else { -0.003 }).collect();
        let mut traces = [trace(CircleSense::Clockwise, &star)];
        traces[0].points[0].sigma_mm = None;
        let found = noise(&traces, None);
        assert_eq!(found.source, LengthSigmaSource::Neighbours);
        assert!((found.mean() - SIGMA_OF_MAD * 0.012 / 6f64.sqrt()).abs() < 1e-9, "{}", found.mean());
        // 38 second differences.
        assert!((found.freedom.unwrap() - 0.19 * 38.0).abs() < 1e-12);
        let rays = RadialTraces::new(&traces, 100.0);
        let fourth = without_form(&traces, &rays);
        assert!((fourth - SIGMA_OF_MAD * 0.048 / 70f64.sqrt()).abs() < 1e-9, "{fourth}");
        // A straight line has no second difference.
        assert!(differences(&traces, &rays, [1.0, -2.0, 1.0]).len() == 38);
    }

    /// scipy.stats.t.ppf(0.975, f) / scipy.stats.norm.ppf(0.975).
    #[test]
    fn students_factor_is_right_to_a_percent() {
        for (freedom, expected) in [
            (3.0, 1.6237269308958933),
            (5.0, 1.3115454446677266),
            (10.0, 1.1368264261800467),
            (40.0, 1.0311798615935077),
        ] {
            let noise = TraceNoise {
                sigma_mm: Vec::new(),
                source: LengthSigmaSource::Passes,
                freedom: Some(freedom),
            };
            assert!((noise.student() / expected - 1.0).abs() < 0.011, "{freedom}: {}", noise.student());
        }
        let few = TraceNoise { sigma_mm: Vec::new(), source: LengthSigmaSource::Passes, freedom: Some(1.0) };
        assert!(few.student() < 1.63);
    }
}
