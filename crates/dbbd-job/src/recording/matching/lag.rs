//! The lag of the bar's reading behind the published axes.
//!
//! In a window of half a second, L(t) is the length of the nominal robot at the measured axes, d(t) its
//! derivative, and r(t) the reading at t + lag less L(t). A remaining lag shows as r = .. + lag d. Errors of the
//! robot and of the base ball change slowly: a constant, a trend and a scale of L are removed from both first. The
//! lag is the weighted median over all windows, so that windows without the bar on its balls do not count.

use nalgebra::Vector3;
use serde::Serialize;

use super::published::AlignedTrack;
use crate::recording::stream::SampleStream;
use dbbd_model::math::robust;
use dbbd_model::robot::Geometry;

/// Lag of the bar's line behind the controller's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BarLag {
    pub lag_s: f64,
    pub sd_s: f64,
    /// Windows of motion that show it.
    pub windows: usize,
}

/// When the bar is on a ball, in the time of the track.
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
/// A lag with a larger standard deviation is rejected: these lengths do not belong to these axes, s.
const WORST_SD_S: f64 = 0.005;
const ROUNDS: usize = 6;

struct LagWindow {
    t_s: Vec<f64>,
    length_mm: Vec<f64>,
    slope_mm_s: Vec<f64>,
}

/// `None` if no motion shows it.
pub(super) fn determine(
    published: &AlignedTrack<'_>,
    stream: &SampleStream,
    geometry: &Geometry,
    on_ball: &[BallInterval],
) -> Option<BarLag> {
    let windows: Vec<LagWindow> = on_ball.iter().flat_map(|on| windows(published, geometry, on)).collect();
    let mut lag_s = 0.0;
    let mut found = None;
    for _ in 0..ROUNDS {
        let mut lags: Vec<WindowLag> =
            windows.iter().filter_map(|window| window.lag(stream, lag_s)).collect();
        if lags.len() < MIN_LAG_WINDOWS {
            return None;
        }
        let left_s = median(&mut lags);
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

fn median(lags: &mut [WindowLag]) -> f64 {
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
fn windows(published: &AlignedTrack<'_>, geometry: &Geometry, on: &BallInterval) -> Vec<LagWindow> {
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
    /// The remaining lag by this window.
    fn lag(&self, stream: &SampleStream, lag_s: f64) -> Option<WindowLag> {
        let mut left = Vec::with_capacity(self.t_s.len());
        for (t_s, length) in self.t_s.iter().zip(&self.length_mm) {
            left.push(reading(stream, t_s + lag_s)? - length);
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
        // Later readings belong to earlier axes.
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
fn reading(stream: &SampleStream, t_s: f64) -> Option<f64> {
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
