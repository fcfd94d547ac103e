//! The published axes of a run beside the bar's samples, both on the bar's time.

use std::ops::Range;

use super::lag::BarLag;
use super::passing::parabola;
use crate::catalogue::MatchingFinding as Finding;
use crate::recording::axes::{AxisTrack, Following, PacketCounts, Rest};
use crate::recording::stream::Stream;
use crate::robot::{AXES, Geometry};

/// Where no motion shows the lag it is taken to be 0 with this standard deviation, s.
const LAG_SD_S: f64 = 0.02;
/// Losses of packets up to this are interpolated, s.
const BRIDGED_S: f64 = 0.02;

/// The axes of a run and the robot that the controller takes itself for.
#[derive(Clone, Copy, Debug)]
pub struct PublishedAxes<'a> {
    pub track: &'a AxisTrack,
    pub geometry: &'a Geometry,
}

/// What the published axes of a run showed.
#[derive(Clone, Debug, PartialEq)]
pub struct AxesReport {
    pub protocol: &'static str,
    pub packets: PacketCounts,
    /// Drift of the controller's clock to the host's, host seconds per controller second less 1.
    pub drift: Option<f64>,
    /// How far a time of it may be off beyond the line's least delay, s.
    pub bound_s: Option<f64>,
    /// How much later the bar's reading comes than the axes that belong to it; `None` where no motion shows it.
    pub lag: Option<BarLag>,
    /// `None` where the controller does not send the commanded axes.
    pub following: Option<[Following; AXES]>,
    /// Intervals at rest.
    pub rests: usize,
    /// Measurements whose axes are measured ones.
    pub measured: usize,
    /// Pairs of axes and length in motion that the measurements on passes are made of, and how many independent pairs they
    /// are worth.
    pub pairs: usize,
    pub effective_pairs: f64,
}

impl AxesReport {
    /// That lengths are at measured axes.
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

/// The axes as the matching uses them.
pub(super) struct Published<'a> {
    pub(super) track: &'a AxisTrack,
    /// What is added to the track's time for that of the bar's stream, s.
    shift_s: f64,
    pub(super) rests: Vec<Rest>,
    pub(super) lag: Option<BarLag>,
}

impl<'a> Published<'a> {
    /// `None` without a packet, and where one of the clocks does not keep the host's pace.
    pub(super) fn of(track: &'a AxisTrack, stream: &Stream) -> Option<Self> {
        let shift_s = if track.is_empty() { None } else { track.shift_to(stream) }?;
        Some(Self { track, shift_s, rests: track.rests(), lag: None })
    }

    /// When the bar reads what belongs to a time of the track, s.
    pub(super) fn bar_s(&self, t_s: f64) -> f64 {
        self.bar_without_lag_s(t_s) + self.lag.map_or(0.0, |lag| lag.lag_s)
    }

    pub(super) fn bar_without_lag_s(&self, t_s: f64) -> f64 {
        t_s + self.shift_s
    }

    /// The track's time of a reading, s.
    fn track_s(&self, bar_s: f64) -> f64 {
        bar_s - self.bar_s(0.0)
    }

    pub(super) fn lag_sd_s(&self) -> f64 {
        self.lag.map_or(LAG_SD_S, |lag| lag.sd_s)
    }

    /// Whether no packets are missing for long between two times of the track.
    pub(super) fn is_whole(&self, from_s: f64, to_s: f64) -> bool {
        let range = self.track.at(from_s)..(self.track.at(to_s) + 1).min(self.track.len());
        self.track.is_whole(range, crate::recording::axes::LOSS_S)
    }

    /// Whether what is missing among samples can be interpolated.
    pub(super) fn bridged(&self, samples: Range<usize>) -> bool {
        self.track.is_whole(samples, BRIDGED_S)
    }

    /// The mean measured axes while the bar was read, degrees; `None` where packets are missing.
    pub(super) fn at_rest_deg(&self, from_s: f64, to_s: f64) -> Option<[f64; AXES]> {
        let samples = self.track.at(self.track_s(from_s))..self.track.at(self.track_s(to_s));
        let sound =
            samples.len() >= 3 && self.track.is_whole(samples.clone(), crate::recording::axes::LOSS_S);
        sound.then(|| self.track.mean_deg(&samples, &self.track.measured_deg))
    }

    /// The measured axes at a moment of a motion, by a parabola through the samples no more than `half_s` away, degrees, and
    /// how many these are; `None` where packets are missing.
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
