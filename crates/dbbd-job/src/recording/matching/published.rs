//! The published axes of a run together with the samples of the bar, on the time axis of the bar.
//!
//! The bar reads later than the axes are published. In a window of half a second, L(t) is the length of the nominal
//! robot at the measured axes, d(t) its derivative, and r(t) the reading at t + lag less L(t). A remaining lag shows
//! as r = .. + lag d. Errors of the robot and of the base ball change slowly: a constant, a trend and a scale of L
//! are removed from both first. The lag is the weighted median over all windows, so that windows without the bar on
//! its balls do not count.

use std::ops::Range;

use nalgebra::Vector3;
use serde::Serialize;

use super::parabola::Parabola;
use crate::recording::ClockMap;
use crate::recording::axes::{AxisTrack, FollowingError, LOSS_S, PacketCounts, RestInterval};
use crate::recording::matching::MatchingFinding as Finding;
use crate::recording::stream::SampleStream;
use dbbd_model::math::robust;
use dbbd_model::robot::{AXES, Geometry};

/// Standard deviation of a lag of 0 that is assumed if no motion shows it, s.
const LAG_SD_S: f64 = 0.02;
/// Longest loss of packets that is interpolated, s.
const BRIDGED_S: f64 = 0.02;

/// The axes of a run, and the robot as its controller models it.
#[derive(Clone, Copy, Debug)]
pub struct PublishedAxes<'a> {
    pub track: &'a AxisTrack,
    pub geometry: &'a Geometry,
}

#[derive(Clone, Debug, PartialEq)]
pub struct AxesReport {
    pub protocol: &'static str,
    pub packets: PacketCounts,
    /// Skew of the controller's clock against the host's, host seconds per controller second less 1.
    pub drift: Option<f64>,
    /// Bound on the error of the controller's times beyond the least delay of the line, s.
    pub bound_s: Option<f64>,
    /// Lag of the bar's reading behind the axes; `None` if no motion shows it.
    pub lag: Option<BarLag>,
    /// The following errors; `None` if the controller does not send the commanded axes.
    pub following: Option<[FollowingError; AXES]>,
    /// Number of intervals at rest.
    pub rests: usize,
    /// Number of measurements with measured axes.
    pub measured: usize,
    /// Number of pairs of axes and length in motion behind the measurements on passes, and number of independent pairs.
    pub pairs: usize,
    pub effective_pairs: f64,
}

impl AxesReport {
    pub(super) fn finding(&self) -> Finding {
        let Self { measured, protocol, .. } = *self;
        match self.lag {
            Some(BarLag { lag_s, sd_s, .. }) => {
                Finding::AxesMeasured { measured, protocol, lag_ms: 1e3 * lag_s, sd_ms: 1e3 * sd_s }
            }
            None => Finding::AxesMeasuredLagUnknown { measured, protocol },
        }
    }
}

pub(super) struct AlignedTrack<'a> {
    pub(super) track: &'a AxisTrack,
    /// Offset from the time of the track to the time of the bar's stream, s.
    shift_s: f64,
    pub(super) rests: Vec<RestInterval>,
    lag: Option<BarLag>,
}

impl<'a> AlignedTrack<'a> {
    /// The axes in the time of the bar. `None` without a packet, or if one of the clocks does not run at the host's
    /// pace.
    pub(super) fn of(track: &'a AxisTrack, stream: &SampleStream) -> Option<Self> {
        let shift_s = if track.is_empty() { None } else { track.shift_to(stream) }?;
        Some(Self { track, shift_s, rests: track.rests(), lag: None })
    }

    /// Determines the lag of the bar from the motion while the bar is on its balls.
    pub(super) fn determine_lag(
        &mut self,
        stream: &SampleStream,
        geometry: &Geometry,
        on_ball: &[BallInterval],
    ) {
        self.lag = lag_by_motion(self, stream, geometry, on_ball);
    }

    /// The report about the axes of a run with `measured` poses.
    pub(super) fn report(&self, measured: usize, pairs: usize, effective_pairs: f64) -> AxesReport {
        let clock = self.track.clock();
        AxesReport {
            protocol: self.track.protocol.name(),
            packets: self.track.counts,
            drift: clock.and_then(ClockMap::drift),
            bound_s: clock.and_then(ClockMap::bound_s),
            lag: self.lag,
            following: self.track.following(&self.rests),
            rests: self.rests.len(),
            measured,
            pairs,
            effective_pairs,
        }
    }

    /// Time at which the bar reads the length at a time of the track, s.
    pub(super) fn bar_s(&self, t_s: f64) -> f64 {
        self.bar_without_lag_s(t_s) + self.lag.map_or(0.0, |lag| lag.lag_s)
    }

    fn bar_without_lag_s(&self, t_s: f64) -> f64 {
        t_s + self.shift_s
    }

    /// Time of the track at a time of the bar, s.
    fn track_s(&self, bar_s: f64) -> f64 {
        bar_s - self.bar_s(0.0)
    }

    pub(super) fn lag_sd_s(&self) -> f64 {
        self.lag.map_or(LAG_SD_S, |lag| lag.sd_s)
    }

    /// Whether the loss of packets between two times of the track is short.
    pub(super) fn is_whole(&self, from_s: f64, to_s: f64) -> bool {
        let range = self.track.at(from_s)..(self.track.at(to_s) + 1).min(self.track.len());
        self.track.is_whole(range, LOSS_S)
    }

    /// Whether lost packets among the samples can be interpolated.
    fn bridged(&self, samples: Range<usize>) -> bool {
        self.track.is_whole(samples, BRIDGED_S)
    }

    /// Mean measured axes of an interval of the bar's time, degrees; `None` if packets are missing.
    pub(super) fn at_rest_deg(&self, from_s: f64, to_s: f64) -> Option<[f64; AXES]> {
        let samples = self.track.at(self.track_s(from_s))..self.track.at(self.track_s(to_s));
        let sound = samples.len() >= 3 && self.track.is_whole(samples.clone(), LOSS_S);
        sound.then(|| self.track.mean_deg(&samples, &self.track.measured_deg))
    }

    /// Measured axes at a moment of a motion, degrees, from a parabola through the samples within `half_s`, and the
    /// number of these samples; `None` if packets are missing.
    pub(super) fn passing_deg(&self, t_s: f64, half_s: f64) -> Option<([f64; AXES], usize)> {
        let samples = self.track.at(t_s - half_s)..self.track.at(t_s + half_s);
        if !self.bridged(samples.clone()) {
            return None;
        }
        let mut axes_deg = [0.0; AXES];
        for (axis, deg) in axes_deg.iter_mut().enumerate() {
            let points = samples
                .clone()
                .map(|at| ((self.track.t_s[at] - t_s) / half_s, self.track.measured_deg[at][axis]));
            *deg = Parabola::through(points)?.value();
        }
        Some((axes_deg, samples.len()))
    }
}

/// Lag of the bar's line behind the controller's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BarLag {
    pub lag_s: f64,
    pub sd_s: f64,
    /// Number of windows of motion that show the lag.
    pub windows: usize,
}

/// An interval in which the bar is on a ball, in the time of the track.
#[derive(Clone, Debug)]
pub(super) struct BallInterval {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) centre_mm: Vector3<f64>,
}

const WINDOW_S: f64 = 0.5;
/// Least RMS change of d within a window, mm/s.
const MIN_RMS_SPEED_MM_S: f64 = 0.05;
const MIN_LAG_WINDOWS: usize = 5;
/// Largest lag, s.
const MAX_LAG_S: f64 = 0.5;
/// Largest standard deviation of a lag, s: with a larger one the lengths do not belong to the axes.
const WORST_SD_S: f64 = 0.005;
const ROUNDS: usize = 6;

struct LagWindow {
    t_s: Vec<f64>,
    length_mm: Vec<f64>,
    slope_mm_s: Vec<f64>,
}

/// The lag that motion shows; `None` if no motion shows it.
fn lag_by_motion(
    published: &AlignedTrack<'_>,
    stream: &SampleStream,
    geometry: &Geometry,
    on_ball: &[BallInterval],
) -> Option<BarLag> {
    let windows: Vec<LagWindow> =
        on_ball.iter().flat_map(|on| lag_windows(published, geometry, on)).collect();
    let mut lag_s = 0.0;
    let mut found = None;
    for _ in 0..ROUNDS {
        let mut lags: Vec<WindowLag> =
            windows.iter().filter_map(|window| window.lag(stream, lag_s)).collect();
        if lags.len() < MIN_LAG_WINDOWS {
            return None;
        }
        let left_s = weighted_median(&mut lags);
        lag_s += left_s;
        if lag_s.abs() > MAX_LAG_S {
            return None;
        }
        let mut off: Vec<f64> = lags.iter().map(|one| (one.lag_s - left_s).abs()).collect();
        let spread = robust::SIGMA_OF_MAD * robust::median(&mut off)?;
        // The median of normal values scatters by sqrt(pi / 2) more than their mean.
        let sd_s = (1.2533 * spread / (lags.len() as f64).sqrt()).max(1e-5);
        found = Some(BarLag { lag_s, sd_s, windows: lags.len() });
        if left_s.abs() < 1e-5 {
            break;
        }
    }
    found.filter(|lag| lag.sd_s < WORST_SD_S)
}

struct WindowLag {
    lag_s: f64,
    weight: f64,
}

fn weighted_median(lags: &mut [WindowLag]) -> f64 {
    lags.sort_by(|a, b| a.lag_s.total_cmp(&b.lag_s));
    let half = 0.5 * lags.iter().map(|one| one.weight).sum::<f64>();
    let mut sum = 0.0;
    let middle = lags.iter().find(|one| {
        sum += one.weight;
        sum >= half
    });
    middle.map_or(0.0, |one| one.lag_s)
}

/// The windows of motion while the bar is on a ball, in the time of the bar.
fn lag_windows(published: &AlignedTrack<'_>, geometry: &Geometry, on: &BallInterval) -> Vec<LagWindow> {
    let track = published.track;
    let all = track.at(on.from_s)..track.at(on.to_s);
    let mut found = Vec::new();
    let mut first = all.start;
    while first < all.end {
        let end = track.at(track.t_s[first] + WINDOW_S).min(all.end);
        let times = &track.t_s[first..end];
        let moves = track.measured_deg[first] != track.measured_deg[end - 1];
        if times.len() >= 8 && moves && published.bridged(first..end) {
            let lengths: Vec<f64> = track.measured_deg[first..end]
                .iter()
                .map(|axes| geometry.length(&axes.map(f64::to_radians), &on.centre_mm, 0.0))
                .collect();
            let inner = 1..times.len() - 1;
            let slope = |at: usize| (lengths[at + 1] - lengths[at - 1]) / (times[at + 1] - times[at - 1]);
            found.push(LagWindow {
                t_s: inner.clone().map(|at| published.bar_without_lag_s(times[at])).collect(),
                length_mm: lengths[inner.clone()].to_vec(),
                slope_mm_s: inner.map(slope).collect(),
            });
        }
        first = end.max(first + 1);
    }
    found
}

impl LagWindow {
    /// The remaining lag that this window shows.
    fn lag(&self, stream: &SampleStream, lag_s: f64) -> Option<WindowLag> {
        let mut left = Vec::with_capacity(self.t_s.len());
        for (t_s, length) in self.t_s.iter().zip(&self.length_mm) {
            left.push(interpolated_reading(stream, t_s + lag_s)? - length);
        }
        let mut slopes = self.slope_mm_s.clone();
        let mut removed: Vec<Vec<f64>> = Vec::new();
        for part in [vec![1.0; left.len()], self.t_s.clone(), self.length_mm.clone()] {
            let whole = norm(&part);
            let mut part = part;
            removed.iter().for_each(|other| remove(&mut part, other));
            let rest = norm(&part);
            // A part that is zero within rounding is skipped.
            if rest > 1e-7 * whole {
                part.iter_mut().for_each(|value| *value /= rest);
                remove(&mut slopes, &part);
                remove(&mut left, &part);
                removed.push(part);
            }
        }
        let weight = slopes.iter().map(|slope| slope * slope).sum::<f64>();
        let products: f64 = slopes.iter().zip(&left).map(|(slope, left)| slope * left).sum();
        let shows = (weight / slopes.len() as f64).sqrt() > MIN_RMS_SPEED_MM_S;
        // A reading that comes later belongs to earlier axes.
        shows.then_some(WindowLag { lag_s: -products / weight, weight })
    }
}

fn norm(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>().sqrt()
}

/// Removes the component along a unit vector.
fn remove(from: &mut [f64], unit: &[f64]) {
    let share: f64 = from.iter().zip(unit).map(|(a, b)| a * b).sum();
    from.iter_mut().zip(unit).for_each(|(value, unit)| *value -= share * unit);
}

/// The reading interpolated between two valid samples.
fn interpolated_reading(stream: &SampleStream, t_s: f64) -> Option<f64> {
    /// Samples further apart than this have a gap between them, s.
    const APART_S: f64 = 0.05;
    let after = stream.at(t_s);
    let before = after.checked_sub(1)?;
    let (a_s, b_s) = (*stream.t_s.get(before)?, *stream.t_s.get(after)?);
    if !stream.valid(before) || !stream.valid(after) || b_s - a_s > APART_S {
        return None;
    }
    let share = if b_s > a_s { (t_s - a_s) / (b_s - a_s) } else { 0.0 };
    Some(stream.reading_mm[before] + share * (stream.reading_mm[after] - stream.reading_mm[before]))
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::recording::stream::StreamBuilder;
    use dbbd_model::base::units::HostNs;
    use dbbd_model::measurement::sample::Sample;

    /// Readings of a function of time, mm, at 1 kHz for two seconds.
    fn stream(reading_mm: impl Fn(f64) -> f64) -> SampleStream {
        let mut builder = StreamBuilder::new(None);
        for at in 0..2000_u32 {
            let sample = Sample::of(reading_mm(1e-3 * f64::from(at)));
            builder.push(HostNs(u64::from(at) * 1_000_000), &sample);
        }
        builder.build()
    }

    /// The axes between 0.5 s and 1 s, with the length 5 sin 8 t.
    fn window() -> LagWindow {
        let t_s: Vec<f64> = (0..125).map(|at| 0.5 + 0.004 * f64::from(at)).collect();
        LagWindow {
            length_mm: t_s.iter().map(|t| 5.0 * (8.0 * t).sin()).collect(),
            slope_mm_s: t_s.iter().map(|t| 40.0 * (8.0 * t).cos()).collect(),
            t_s,
        }
    }

    /// The bar reads 3 ms late; the robot is 0.2 mm off, drifts by 0.1 mm/s, and its lengths are 0.1 % too long.
    #[test]
    fn window_shows_the_lag_beside_slow_errors() {
        let read = stream(|t| {
            let moved = t - 0.003;
            1.001 * 5.0 * (8.0 * moved).sin() + 0.2 + 0.1 * t
        });
        let first = window().lag(&read, 0.0).unwrap();
        // The second order of the lag remains.
        assert!((first.lag_s - 0.003).abs() < 1e-4, "{}", first.lag_s);
        let last = window().lag(&read, 0.003).unwrap();
        assert!(last.lag_s.abs() < 2e-6, "{}", last.lag_s);
        assert!(window().lag(&read, 1.5).is_none());
    }

    #[test]
    fn window_without_motion_shows_no_lag() {
        let still = LagWindow { slope_mm_s: vec![0.04; 125], ..window() };
        assert!(still.lag(&stream(|_| 0.0), 0.0).is_none());
    }

    #[test]
    fn median_is_weighted() {
        let median = |lags: &[(f64, f64)]| {
            let mut lags: Vec<WindowLag> =
                lags.iter().map(|(lag_s, weight)| WindowLag { lag_s: *lag_s, weight: *weight }).collect();
            weighted_median(&mut lags)
        };
        assert_eq!(median(&[(3.0, 1.0), (1.0, 1.0), (2.0, 1.0)]), 2.0);
        assert_eq!(median(&[(3.0, 5.0), (1.0, 1.0), (2.0, 1.0)]), 3.0);
        assert_eq!(median(&[(1.0, 1.0), (2.0, 1.0)]), 1.0);
        assert_eq!(median(&[]), 0.0);
    }

    #[test]
    fn component_along_a_unit_vector_is_removed() {
        let mut values = [3.0, 4.0];
        remove(&mut values, &[0.6, 0.8]);
        assert!(values.iter().all(|value| value.abs() < 1e-12));
        let mut values = [-4.0, 3.0];
        remove(&mut values, &[0.6, 0.8]);
        assert!((values[0] + 4.0).abs() < 1e-12 && (values[1] - 3.0).abs() < 1e-12);
        assert_eq!(norm(&[-4.0, 3.0]), 5.0);
    }

    #[test]
    fn reading_is_interpolated_between_near_samples() {
        let mut builder = StreamBuilder::new(None);
        for (host_ms, reading_mm) in [(0, 1.0), (40, 2.0), (100, 3.0), (140, 1e9), (180, 1.0)] {
            let sample = Sample { valid: reading_mm < 10.0, ..Sample::of(reading_mm) };
            builder.push(HostNs(host_ms * 1_000_000), &sample);
        }
        let read = builder.build();
        assert!((interpolated_reading(&read, 0.01).unwrap() - 1.25).abs() < 1e-12);
        assert!((interpolated_reading(&read, 0.04).unwrap() - 2.0).abs() < 1e-12);
        // 60 ms are a gap; an invalid sample and the ends show nothing.
        for t_s in [0.05, 0.12, 0.16, -0.01, 0.0, 0.2] {
            assert_eq!(interpolated_reading(&read, t_s), None, "{t_s}");
        }
    }
}
