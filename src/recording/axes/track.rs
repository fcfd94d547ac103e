//! The axes of a run as columns, on the host's clock: a stream of samples like the bar's.

use std::ops::{Deref, Range};

use super::order::Place;
use super::receiver::{AxesRecords, PacketCounts, clock};
use crate::base::units::HostNs;
use crate::device::axes::{AxesProtocol, AxesSample};
use crate::recording::Stamp;
use crate::recording::capture::Record;
use crate::recording::timeline::Timeline;
use crate::robot::AXES;

/// Axes in the order of the controller's clock.
#[derive(Clone, Debug)]
pub struct AxisTrack {
    time: Timeline,
    pub measured_deg: Vec<[f64; AXES]>,
    /// Empty unless every packet has them.
    pub commanded_deg: Vec<[f64; AXES]>,
    pub protocol: AxesProtocol,
    pub counts: PacketCounts,
}

impl Deref for AxisTrack {
    type Target = Timeline;

    fn deref(&self) -> &Timeline {
        &self.time
    }
}

impl AxisTrack {
    /// Whether no packet is missing for long within samples; long is more than `most_s`.
    pub fn is_whole(&self, range: Range<usize>, most_s: f64) -> bool {
        let times = self.t_s.get(range.clone()).unwrap_or_default();
        let broken = self.breaks.iter().any(|at| range.contains(at) && *at != range.start);
        !broken && times.windows(2).all(|pair| pair[1] - pair[0] <= most_s)
    }
}

/// A track whose packets are still coming.
#[derive(Clone, Debug, Default)]
pub struct AxisTrackBuilder {
    records: AxesRecords,
    samples: Vec<(Stamp, AxesSample)>,
    /// The first sample since the clock began.
    epoch: usize,
}

impl AxisTrackBuilder {
    /// Takes the next record of a capture, whatever it is.
    pub fn add(&mut self, host: HostNs, record: &Record) {
        let Self { records, samples, epoch } = self;
        records.add(host, record, |place, stamp, sample| match place {
            Place::Next => samples.push((stamp, sample)),
            Place::Restart => {
                *epoch = samples.len();
                samples.push((stamp, sample));
            }
            Place::Late => {
                let since = samples.get(*epoch..).unwrap_or_default();
                let later = since.iter().rev().take_while(|(other, _)| other.ticks > stamp.ticks).count();
                samples.insert(samples.len() - later, (stamp, sample));
            }
            Place::Doubled | Place::Stray => {}
        });
    }

    /// Lays the samples on the host's clock; `None` where no controller was listened to.
    pub fn build(self) -> Option<AxisTrack> {
        let receiver = self.records.receiver()?;
        let (protocol, counts) = (receiver.protocol(), receiver.counts());
        let (stamps, samples): (Vec<Stamp>, Vec<AxesSample>) = self.samples.into_iter().unzip();
        let commanded: Option<Vec<_>> = samples.iter().map(|sample| sample.commanded_deg).collect();
        Some(AxisTrack {
            time: Timeline::new(&stamps, Some(clock(protocol))),
            measured_deg: samples.iter().map(|sample| sample.measured_deg).collect(),
            commanded_deg: commanded.unwrap_or_default(),
            protocol,
            counts,
        })
    }
}
