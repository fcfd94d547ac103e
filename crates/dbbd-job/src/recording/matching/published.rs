//! The published axes of a run together with the samples of the bar, on the time axis of the bar.

use std::ops::Range;

use super::lag::BarLag;
use super::passing::parabola;
use crate::recording::axes::{AxisTrack, FollowingError, PacketCounts, RestInterval};
use crate::recording::matching::MatchingFinding as Finding;
use crate::recording::stream::SampleStream;
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
    /// Bound on the error of its times beyond the least delay of the line, s.
    pub bound_s: Option<f64>,
    /// Lag of the bar's reading behind the axes; `None` if no motion shows it.
    pub lag: Option<BarLag>,
    /// `None` if the controller does not send the commanded axes.
    pub following: Option<[FollowingError; AXES]>,
    /// Number of intervals at rest.
    pub rests: usize,
    /// Number of measurements with measured axes.
    pub measured: usize,
    /// Number of pairs of axes and length in motion behind the measurements on passes, and of independent ones.
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
    /// Offset from the time of the track to that of the bar's stream, s.
    shift_s: f64,
    pub(super) rests: Vec<RestInterval>,
    pub(super) lag: Option<BarLag>,
}

impl<'a> AlignedTrack<'a> {
    /// `None` without a packet, or if one of the clocks does not run at the host's pace.
    pub(super) fn of(track: &'a AxisTrack, stream: &SampleStream) -> Option<Self> {
        let shift_s = if track.is_empty() { None } else { track.shift_to(stream) }?;
        Some(Self { track, shift_s, rests: track.rests(), lag: None })
    }

    /// Time at which the bar reads the length at a time of the track, s.
    pub(super) fn bar_s(&self, t_s: f64) -> f64 {
        self.bar_without_lag_s(t_s) + self.lag.map_or(0.0, |lag| lag.lag_s)
    }

    pub(super) fn bar_without_lag_s(&self, t_s: f64) -> f64 {
        t_s + self.shift_s
    }

    /// Time of the track of a reading, s.
    fn track_s(&self, bar_s: f64) -> f64 {
        bar_s - self.bar_s(0.0)
    }

    pub(super) fn lag_sd_s(&self) -> f64 {
        self.lag.map_or(LAG_SD_S, |lag| lag.sd_s)
    }

    /// Whether the loss of packets between two times of the track is short.
    pub(super) fn is_whole(&self, from_s: f64, to_s: f64) -> bool {
        let range = self.track.at(from_s)..(self.track.at(to_s) + 1).min(self.track.len());
        self.track.is_whole(range, crate::recording::axes::LOSS_S)
    }

    /// Whether lost packets among the samples can be interpolated.
    pub(super) fn bridged(&self, samples: Range<usize>) -> bool {
        self.track.is_whole(samples, BRIDGED_S)
    }

    /// Mean measured axes of an interval of the bar's time, degrees; `None` if packets are missing.
    pub(super) fn at_rest_deg(&self, from_s: f64, to_s: f64) -> Option<[f64; AXES]> {
        let samples = self.track.at(self.track_s(from_s))..self.track.at(self.track_s(to_s));
        let sound =
            samples.len() >= 3 && self.track.is_whole(samples.clone(), crate::recording::axes::LOSS_S);
        sound.then(|| self.track.mean_deg(&samples, &self.track.measured_deg))
    }

    /// Measured axes at a moment of a motion, degrees, by a parabola through the samples within `half_s`, and the
    /// number of these; `None` if packets are missing.
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
            *deg = parabola(points)?.value();
        }
        Some((axes_deg, samples.len()))
    }
}
