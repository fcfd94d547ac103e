//! The order of packets by the controller's clock: late, doubled and lost packets.
//!
//! A controller sends one packet per cycle. The cycle is the most frequent step of its clock: losses make steps of
//! several cycles, which are rarer.

use std::collections::{BTreeMap, VecDeque};
use std::ops::Range;

use crate::recording::{ClockStamp, DeviceClock};
use dbbd_model::base::units::HostNs;

/// Longest delay of a packet, s; an older packet belongs to a clock that restarted.
const LATEST_S: f64 = 1.0;
/// Number of different steps that are counted.
const MAX_COUNTED_STEPS: usize = 4096;

/// The place of a packet in the order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketPlace {
    /// The packet comes after all other packets.
    Next,
    /// The packet comes before packets that were received already: it was overtaken.
    Late,
    /// A packet of this time came before.
    Doubled,
    /// The packet is far before or far ahead of all others: it is used only if the next packet follows it.
    Stray,
    /// The clock restarted with the stray packet before.
    Restart,
}

impl PacketPlace {
    pub const fn word(self) -> &'static str {
        match self {
            Self::Next => "next",
            Self::Late => "late",
            Self::Doubled => "doubled",
            Self::Stray => "stray",
            Self::Restart => "restart",
        }
    }
}

/// Puts packets in the order of the controller's clock.
#[derive(Clone, Debug)]
pub struct PacketOrder {
    clock: DeviceClock,
    /// First and last time since the clock started, ticks, and the arrival of the last.
    span: Option<(u64, ClockStamp)>,
    /// Missing times, in order, no older than [`LATEST_S`].
    gaps: VecDeque<Range<u64>>,
    stray: Option<ClockStamp>,
    /// The number of times that the clock made each step, in ticks.
    steps: BTreeMap<u64, u64>,
    late: u64,
}

impl PacketOrder {
    pub fn new(clock: DeviceClock) -> Self {
        let (gaps, steps) = (VecDeque::new(), BTreeMap::new());
        Self { clock, span: None, gaps, stray: None, steps, late: 0 }
    }

    /// The controller's cycle, ticks; `None` before two packets.
    pub fn cycle(&self) -> Option<u64> {
        // The shortest of the most frequent steps.
        self.steps.iter().rev().max_by_key(|(_, count)| **count).map(|(step, _)| *step)
    }

    /// Number of lost packets so far.
    pub fn lost(&self) -> u64 {
        let Some(cycle) = self.cycle() else { return 0 };
        let missing = |step: u64| ((step + cycle / 2) / cycle).saturating_sub(1);
        let missing: u64 = self.steps.iter().map(|(step, count)| missing(*step) * count).sum();
        missing.saturating_sub(self.late)
    }

    pub fn place(&mut self, stamp: ClockStamp) -> PacketPlace {
        let Some((first, last)) = self.span else {
            self.span = Some((stamp.ticks.0, stamp));
            return PacketPlace::Next;
        };
        let (now, latest) = (stamp.ticks.0, last.ticks.0);
        let reach = (LATEST_S / self.clock.seconds_per_tick) as u64;
        if now > latest && !self.clock.is_gross(last, stamp) {
            self.stray = None;
            self.advance(latest, stamp, reach);
            return PacketPlace::Next;
        }
        if now <= latest && latest - now <= reach {
            self.stray = None;
            return self.earlier(first, now);
        }
        match self.stray.replace(stamp) {
            Some(before) if (1..=reach).contains(&now.saturating_sub(before.ticks.0)) => {
                (self.stray, self.gaps) = (None, VecDeque::new());
                self.span = Some((before.ticks.0, before));
                self.advance(before.ticks.0, stamp, reach);
                PacketPlace::Restart
            }
            _ => PacketPlace::Stray,
        }
    }

    fn advance(&mut self, latest: u64, stamp: ClockStamp, reach: u64) {
        let now = stamp.ticks.0;
        self.step(now - latest);
        if now - latest > 1 {
            self.gaps.push_back(latest + 1..now);
        }
        while self.gaps.front().is_some_and(|gap| gap.end + reach < now) {
            self.gaps.pop_front();
        }
        if let Some((_, last)) = &mut self.span {
            *last = stamp;
        }
    }

    /// Places a packet that is not later than the last one.
    fn earlier(&mut self, first: u64, now: u64) -> PacketPlace {
        if now < first {
            // The first packet that was received is not the first one that was sent.
            self.step(first - now);
            self.gaps.push_front(now + 1..first);
            if let Some((first, _)) = &mut self.span {
                *first = now;
            }
            return PacketPlace::Late;
        }
        let at = self.gaps.partition_point(|gap| gap.end <= now);
        let Some(gap) = self.gaps.get_mut(at).filter(|gap| gap.contains(&now)) else {
            return PacketPlace::Doubled;
        };
        let after = now + 1..gap.end;
        gap.end = now;
        if !after.is_empty() {
            self.gaps.insert(at + 1, after);
        }
        self.late += 1;
        PacketPlace::Late
    }

    fn step(&mut self, step: u64) {
        if self.steps.len() < MAX_COUNTED_STEPS || self.steps.contains_key(&step) {
            *self.steps.entry(step).or_default() += 1;
        }
    }

    /// Arrival of the last packet in order.
    pub fn last(&self) -> Option<HostNs> {
        self.span.map(|(_, last)| last.host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use dbbd_model::base::units::DeviceTicks;

    /// The places of packets that arrive at their time by a clock of milliseconds, and the order.
    fn placed(ticks: &[u64]) -> (Vec<PacketPlace>, PacketOrder) {
        let mut order = PacketOrder::new(DeviceClock { seconds_per_tick: 1e-3, wrap: None });
        let place = |(at, ticks): (u64, &u64)| {
            order.place(ClockStamp { host: HostNs(4_000_000 * at), ticks: DeviceTicks(*ticks) })
        };
        let places = (0..).zip(ticks).map(place).collect();
        (places, order)
    }

    use PacketPlace::{Doubled, Late, Next, Restart, Stray};

    #[test]
    fn overtaken_packet_is_late_and_not_lost() {
        let (places, order) = placed(&[100, 104, 108, 116, 112, 112, 108, 120]);
        assert_eq!(places, [Next, Next, Next, Next, Late, Doubled, Doubled, Next]);
        assert_eq!((order.cycle(), order.lost()), (Some(4), 0));
    }

    #[test]
    fn lost_packets_are_counted_by_the_cycle() {
        let (places, order) = placed(&[100, 104, 108, 116, 120, 132]);
        assert!(places.iter().all(|place| *place == Next));
        // One packet is lost at 112, and two are lost at 124 and 128.
        assert_eq!((order.cycle(), order.lost()), (Some(4), 3));
        assert_eq!(order.last(), Some(HostNs(20_000_000)));
        assert_eq!(placed(&[100]).1.cycle(), None);
        assert_eq!(placed(&[100]).1.lost(), 0);
    }

    #[test]
    fn shortest_of_equally_frequent_steps_is_the_cycle() {
        assert_eq!(placed(&[100, 104, 112]).1.cycle(), Some(4));
        assert_eq!(placed(&[100, 108, 112]).1.cycle(), Some(4));
    }

    #[test]
    fn packet_before_the_first_is_late() {
        let (places, order) = placed(&[100, 96, 104, 98, 96]);
        assert_eq!(places, [Next, Late, Next, Late, Doubled]);
        assert_eq!(order.cycle(), Some(4));
    }

    #[test]
    fn gap_is_split_by_a_late_packet() {
        let (places, _) = placed(&[100, 120, 110, 110, 105, 115, 105]);
        assert_eq!(places, [Next, Next, Late, Doubled, Late, Late, Doubled]);
    }

    /// A time more than a second back, or far ahead, is used with the next packet.
    #[test]
    fn clock_restarts_with_two_packets_in_order() {
        let (places, _) = placed(&[9_000, 9_004, 4, 8, 12]);
        assert_eq!(places, [Next, Next, Stray, Restart, Next]);
        let (places, _) = placed(&[9_000, 9_004, 4, 9_008, 8]);
        assert_eq!(places, [Next, Next, Stray, Next, Stray]);
        let (places, _) = placed(&[9_000, 90_000, 90_004]);
        assert_eq!(places, [Next, Stray, Restart]);
        // A packet that is a second late is late; with more it belongs to another clock.
        assert_eq!(placed(&[9_000, 9_500, 8_500]).0[2], Late);
        assert_eq!(placed(&[9_000, 9_500, 8_499]).0[2], Stray);
    }
}
