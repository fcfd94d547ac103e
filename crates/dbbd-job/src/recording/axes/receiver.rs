//! Counts the packets of a controller and passes their samples on.

use std::collections::BTreeMap;

use serde::Serialize;

use super::order::{PacketOrder, PacketPlace};
use crate::recording::capture::{CaptureRecord, RunEvent};
use crate::recording::{ClockStamp, DeviceClock};
use dbbd_device::axes::{AxesDecoder, AxesFault, AxesProtocol, AxesSample, PacketContent};
use dbbd_model::base::units::HostNs;

/// Each packet is counted once: packets = used + late + doubled + stray + control + malformed. Each byte belongs to a
/// packet or is pending.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PacketCounts {
    pub bytes: u64,
    pub packets: u64,
    /// Packets in order, including the first one after a restart.
    pub used: u64,
    /// Packets that were overtaken; they are used as well.
    pub late: u64,
    /// Packets of a time that a packet had before.
    pub doubled: u64,
    /// Packets of a time far from all others; the first packet after a restart of the clock is one.
    pub stray: u64,
    /// Packets without axes.
    pub control: u64,
    pub malformed: u64,
    /// Bytes of malformed packets.
    malformed_bytes: u64,
    /// Bytes of an unfinished packet.
    pub pending: u64,
    /// Packets that are missing by the controller's clock.
    pub lost: u64,
    /// Restarts of the controller's clock.
    pub restarts: u64,
    /// Answers that the controller counted as late, if it counts them.
    pub late_answers: u32,
    /// The controller's cycle, us; 0 if unknown.
    pub cycle_us: u64,
}

/// The packets with axes among the records of a capture.
#[derive(Clone, Debug, Default)]
pub struct AxesRecords {
    receiver: Option<AxesReceiver>,
}

impl AxesRecords {
    /// Takes the next record of any kind; calls `each` with the samples in it.
    pub fn add(
        &mut self,
        host: HostNs,
        record: &CaptureRecord,
        each: impl FnMut(PacketPlace, ClockStamp, AxesSample),
    ) {
        match (record, &mut self.receiver) {
            (CaptureRecord::Event(RunEvent::AxesOpened { protocol, .. }), Some(receiver))
                if receiver.protocol == *protocol =>
            {
                receiver.reconnected();
            }
            (CaptureRecord::Event(RunEvent::AxesOpened { protocol, .. }), receiver) => {
                *receiver = Some(AxesReceiver::new(*protocol));
            }
            (CaptureRecord::Axes(bytes), Some(receiver)) => receiver.push(host, bytes, each),
            _ => {}
        }
    }

    /// The receiver; `None` before a controller was connected.
    pub fn receiver(&self) -> Option<&AxesReceiver> {
        self.receiver.as_ref()
    }
}

/// Receives the packets of one controller.
#[derive(Clone, Debug)]
pub struct AxesReceiver {
    protocol: AxesProtocol,
    decoder: AxesDecoder,
    order: PacketOrder,
    counts: PacketCounts,
    faults: BTreeMap<AxesFault, u64>,
}

impl AxesReceiver {
    pub fn new(protocol: AxesProtocol) -> Self {
        Self {
            protocol,
            decoder: AxesDecoder::new(protocol),
            order: PacketOrder::new(clock(protocol)),
            counts: PacketCounts::default(),
            faults: BTreeMap::new(),
        }
    }

    pub fn protocol(&self) -> AxesProtocol {
        self.protocol
    }

    /// Drops the pending bytes: after a new connection they will not be completed.
    fn reconnected(&mut self) {
        let pending = self.decoder.pending();
        if pending > 0 {
            self.fault(AxesFault::Framing, pending);
        }
        self.decoder = AxesDecoder::new(self.protocol);
    }

    /// Takes a datagram, or the next bytes of a stream, received at `host`.
    pub fn push(
        &mut self,
        host: HostNs,
        bytes: &[u8],
        mut each: impl FnMut(PacketPlace, ClockStamp, AxesSample),
    ) {
        self.counts.bytes += bytes.len() as u64;
        let mut decoder = std::mem::replace(&mut self.decoder, AxesDecoder::Rsi);
        decoder.push(bytes, |packet| match packet.content {
            PacketContent::Sample(sample) => {
                self.counts.packets += 1;
                let stamp = ClockStamp { host, ticks: sample.ticks };
                let place = self.order.place(stamp);
                self.count(place);
                self.counts.late_answers = sample.late.unwrap_or(self.counts.late_answers);
                each(place, stamp, sample);
            }
            PacketContent::Answer { .. } | PacketContent::Other => {
                self.counts.packets += 1;
                self.counts.control += 1;
            }
            PacketContent::Fault(fault) => self.fault(fault, packet.bytes),
        });
        self.decoder = decoder;
    }

    fn count(&mut self, place: PacketPlace) {
        match place {
            PacketPlace::Next => self.counts.used += 1,
            PacketPlace::Late => self.counts.late += 1,
            PacketPlace::Doubled => self.counts.doubled += 1,
            PacketPlace::Stray => self.counts.stray += 1,
            PacketPlace::Restart => {
                self.counts.used += 1;
                self.counts.restarts += 1;
            }
        }
    }

    fn fault(&mut self, fault: AxesFault, bytes: u64) {
        self.counts.packets += 1;
        self.counts.malformed += 1;
        self.counts.malformed_bytes += bytes;
        *self.faults.entry(fault).or_default() += 1;
    }

    pub fn counts(&self) -> PacketCounts {
        let tick_us = f64::from(self.protocol.tick_ns()) * 1e-3;
        PacketCounts {
            pending: self.decoder.pending(),
            lost: self.order.lost(),
            cycle_us: self.order.cycle().map_or(0, |ticks| (ticks as f64 * tick_us).round() as u64),
            ..self.counts
        }
    }

    /// Number of malformed packets by fault.
    pub fn faults(&self) -> &BTreeMap<AxesFault, u64> {
        &self.faults
    }
}

/// The controller's clock. Its wrap is unknown, so a wrap counts as a restart.
pub(super) fn clock(protocol: AxesProtocol) -> DeviceClock {
    DeviceClock { seconds_per_tick: f64::from(protocol.tick_ns()) * 1e-9, wrap: None }
}
