//! The axes of a run as columns on the host's clock, and their intervals at rest.

use std::ops::{Deref, Range};

use super::order::PacketPlace;
use super::receiver::{AxesRecords, PacketCounts, clock};
use crate::recording::ClockStamp;
use crate::recording::capture::CaptureRecord;
use crate::recording::stream::SampleTimeline;
use dbbd_device::axes::{AxesProtocol, AxesSample, EXTERNAL_AXES};
use dbbd_model::base::units::HostNs;
use dbbd_model::math::robust;
use dbbd_model::robot::AXES;

/// Axes in the order of the controller's clock.
#[derive(Clone, Debug)]
pub struct AxisTrack {
    time: SampleTimeline,
    pub measured_deg: Vec<[f64; AXES]>,
    /// The commanded axes, degrees; empty unless every packet has them.
    pub commanded_deg: Vec<[f64; AXES]>,
    /// The external axis that moved farthest, if one moved.
    pub external: Option<ExternalMotion>,
    pub protocol: AxesProtocol,
    pub counts: PacketCounts,
}

/// The motion of an external axis in a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExternalMotion {
    /// 1 for E1.
    pub number: usize,
    /// From the least to the largest position, mm or degrees.
    pub range: f64,
}

impl ExternalMotion {
    /// An axis at rest reads its noise, mm or degrees: a rail's encoder has some hundredths of a millimetre.
    const AT_REST: f64 = 0.1;

    /// The axis that moved farthest.
    fn of<'a>(samples: impl Iterator<Item = &'a AxesSample> + Clone) -> Option<Self> {
        let positions = samples.filter_map(|sample| sample.external.as_ref());
        let range = |at: usize| {
            let ends = positions.clone().filter_map(|all| all.get(at));
            let [low, high] = ends.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], position| {
                [position.min(low), position.max(high)]
            });
            Self { number: at + 1, range: high - low }
        };
        let moved = (0..EXTERNAL_AXES).map(range).max_by(|a, b| a.range.total_cmp(&b.range));
        moved.filter(|moved| moved.range > Self::AT_REST)
    }
}

impl Deref for AxisTrack {
    type Target = SampleTimeline;

    fn deref(&self) -> &SampleTimeline {
        &self.time
    }
}

impl AxisTrack {
    /// Whether no gap between the samples is longer than `most_s` and the clock did not break.
    pub fn is_whole(&self, range: Range<usize>, most_s: f64) -> bool {
        let times = self.t_s.get(range.clone()).unwrap_or_default();
        let broken = self.breaks.iter().any(|at| range.contains(at) && *at != range.start);
        !broken && times.windows(2).all(|pair| pair[1] - pair[0] <= most_s)
    }
}

#[derive(Clone, Debug, Default)]
pub struct AxisTrackBuilder {
    records: AxesRecords,
    samples: Vec<(ClockStamp, AxesSample)>,
    /// Index of the first sample since the clock started.
    epoch: usize,
}

impl AxisTrackBuilder {
    pub fn add(&mut self, host: HostNs, record: &CaptureRecord) {
        let Self { records, samples, epoch } = self;
        records.add(host, record, |place, stamp, sample| match place {
            PacketPlace::Next => samples.push((stamp, sample)),
            PacketPlace::Restart => {
                *epoch = samples.len();
                samples.push((stamp, sample));
            }
            PacketPlace::Late => {
                let since = samples.get(*epoch..).unwrap_or_default();
                let later = since.iter().rev().take_while(|(other, _)| other.ticks > stamp.ticks).count();
                samples.insert(samples.len() - later, (stamp, sample));
            }
            PacketPlace::Doubled | PacketPlace::Stray => {}
        });
    }

    /// Puts the samples on the host's clock; `None` if no controller was connected.
    pub fn build(self) -> Option<AxisTrack> {
        let receiver = self.records.receiver()?;
        let (protocol, counts) = (receiver.protocol(), receiver.counts());
        let (stamps, samples): (Vec<ClockStamp>, Vec<AxesSample>) = self.samples.into_iter().unzip();
        let commanded: Option<Vec<_>> = samples.iter().map(|sample| sample.commanded_deg).collect();
        Some(AxisTrack {
            time: SampleTimeline::new(stamps.into_iter().collect(), Some(clock(protocol))),
            measured_deg: samples.iter().map(|sample| sample.measured_deg).collect(),
            commanded_deg: commanded.unwrap_or_default(),
            external: ExternalMotion::of(samples.iter()),
            protocol,
            counts,
        })
    }
}

/// Measured axes at rest stay within this, degrees, or within a multiple of their noise.
const STILL_DEG: f64 = 0.003;
const STILL_NOISES: f64 = 10.0;
/// Shortest rest, s.
const MIN_REST_S: f64 = 0.25;
/// Longest interruption of one rest, s: a push by hand, missing packets.
const TORN_S: f64 = 0.12;
/// Longest loss of packets with a known position in between, s.
pub(crate) const LOSS_S: f64 = 0.25;

/// An interval at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct RestInterval {
    pub samples: Range<usize>,
    pub start_s: f64,
    pub end_s: f64,
    /// Mean of the commanded axes if they are known, else of the measured axes, degrees.
    pub axes_deg: [f64; AXES],
}

impl AxisTrack {
    /// The intervals at rest, in order.
    pub fn rests(&self) -> Vec<RestInterval> {
        let still_deg = self.still_deg();
        let mut rests: Vec<RestInterval> = Vec::new();
        let mut first = 0;
        for at in 1..=self.len() {
            let goes_on = at < self.len()
                && self.t_s[at] - self.t_s[at - 1] <= LOSS_S
                && !self.breaks.contains(&at)
                && within(&self.measured_deg[first], &self.measured_deg[at], still_deg);
            if goes_on {
                continue;
            }
            self.add(&mut rests, first..at, still_deg);
            first = at;
        }
        rests.retain(|rest| rest.end_s - rest.start_s >= MIN_REST_S);
        rests
    }

    /// Adds a run of samples at one position, or merges it into the rest before if the position is the same.
    fn add(&self, rests: &mut Vec<RestInterval>, samples: Range<usize>, still_deg: f64) {
        let (Some(start_s), Some(end_s)) = (self.t_s.get(samples.start), self.t_s.get(samples.end - 1))
        else {
            return;
        };
        // A slow motion is a chain of short runs.
        if end_s - start_s < 0.5 * MIN_REST_S {
            return;
        }
        let axes_deg = self.mean_deg(&samples, self.commanded());
        if let Some(last) = rests.last_mut()
            && start_s - last.end_s <= TORN_S
            && within(&last.axes_deg, &axes_deg, still_deg)
        {
            last.samples.end = samples.end;
            last.end_s = *end_s;
            return;
        }
        rests.push(RestInterval { samples, start_s: *start_s, end_s: *end_s, axes_deg });
    }

    /// The commanded axes if they are known, else the measured axes.
    fn commanded(&self) -> &[[f64; AXES]] {
        if self.commanded_deg.is_empty() { &self.measured_deg } else { &self.commanded_deg }
    }

    /// Mean of a range of samples of a column, degrees.
    pub(in crate::recording) fn mean_deg(
        &self,
        samples: &Range<usize>,
        column: &[[f64; AXES]],
    ) -> [f64; AXES] {
        let rows = column.get(samples.clone()).unwrap_or_default();
        std::array::from_fn(|axis| rows.iter().map(|row| row[axis]).sum::<f64>() / rows.len() as f64)
    }

    /// Largest distance between measured axes at rest, degrees.
    fn still_deg(&self) -> f64 {
        /// Standard deviation of a second difference of independent values.
        const SECOND_DIFFERENCE: f64 = 2.449_489_742_783_178;
        let stride = (self.len() / 20_000).max(1);
        let noise = |axis: usize| {
            let bends = self.measured_deg.windows(3).step_by(stride);
            let mut bends: Vec<f64> =
                bends.map(|w| (w[0][axis] - 2.0 * w[1][axis] + w[2][axis]).abs()).collect();
            robust::median(&mut bends).unwrap_or(0.0) * robust::SIGMA_OF_MAD / SECOND_DIFFERENCE
        };
        (0..AXES).map(noise).fold(STILL_DEG, |still, noise| still.max(STILL_NOISES * noise))
    }
}

fn within(a: &[f64; AXES], b: &[f64; AXES], deg: f64) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() <= deg)
}
