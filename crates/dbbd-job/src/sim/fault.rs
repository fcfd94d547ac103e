//! Faults that the simulator can inject, and a line between the virtual bar and its terminal that has them.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::sim::SimulationFinding;
use dbbd_model::diagnostic::Diagnostic;

/// A fault by its name, with the range of its value.
struct FaultSetting {
    name: &'static str,
    field: fn(&mut InjectedFaults) -> &mut f64,
    range: [f64; 2],
}

macro_rules! faults {
    ($($(#[$doc:meta])* $name:ident: $range:expr,)+) => {
        /// The injected faults; 0 means none. Rates without another unit are probabilities per byte.
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct InjectedFaults { $($(#[$doc])* pub $name: f64,)+ }

        const KINDS: &[FaultSetting] =
            &[$(FaultSetting { name: stringify!($name), field: |faults| &mut faults.$name, range: $range }),+];
    };
}

faults! {
    /// A byte is lost.
    drop: [0.0, 1.0],
    /// A bit of a byte is flipped.
    flip: [0.0, 1.0],
    /// A byte is sent twice.
    double: [0.0, 1.0],
    /// A random byte is inserted.
    insert: [0.0, 1.0],
    /// Bytes are held back and delivered together at this interval, ms.
    batch_ms: [0.0, 60_000.0],
    /// Number of bytes of an earlier stream that the host receives when it opens the line.
    stale: [0.0, 1e6],
    /// The bar sends a banner before its first frame.
    banner: [0.0, 1.0],
    /// The bar echoes commands.
    echo: [0.0, 1.0],
    /// Probability per frame that it is not sent, as while the menu of the bar is open.
    silence: [0.0, 1.0],
    /// Probability per frame that the bar refuses the reading.
    refuse: [0.0, 1.0],
    /// Probability per frame that the sequence number skips one.
    skip: [0.0, 1.0],
    /// The device clock begins this many ticks before it wraps.
    wrap_ticks: [0.0, 4e9],
    /// The device clock is fast by this many parts per million.
    drift_ppm: [-1e6, 1e6],
    /// The bar is unplugged once, after this time, s.
    unplug_s: [0.0, 1e9],
    /// It comes back under another name after this time, s.
    away_s: [0.0, 1e9],
    /// Readings are longer by this, mm, and invalid.
    over_mm: [-1e6, 1e6],
    /// Probability that a packet of the controller's axes is lost.
    axes_drop: [0.0, 1.0],
    /// Probability that it is sent twice.
    axes_double: [0.0, 1.0],
    /// Probability that the next packet overtakes it.
    axes_swap: [0.0, 1.0],
    /// Probability that it is damaged: truncated, or of another recipe.
    axes_spoil: [0.0, 1.0],
    /// The clock of the controller is fast by this many parts per million.
    axes_drift_ppm: [-1e6, 1e6],
    /// Delay of the packets, ms.
    axes_delay_ms: [0.0, 10_000.0],
    /// The mounted bar is not seated and rocks by this, micrometres.
    unseated_um: [0.0, 1e6],
    /// A ball creeps by this in total after mounting, micrometres.
    creep_um: [-1e6, 1e6],
    /// A magnet slips by this from time to time, micrometres.
    slip_um: [-1e6, 1e6],
    /// The cable pulls by this from time to time, micrometres.
    cable_um: [-1e6, 1e6],
}

impl InjectedFaults {
    /// Sets a fault by its name: `--fault NAME=VALUE`.
    pub fn set(&mut self, name: &str, value: f64) -> Result<(), Diagnostic> {
        let Some(kind) = KINDS.iter().find(|kind| kind.name == name) else {
            let known = KINDS.iter().map(|kind| kind.name).collect::<Vec<_>>().join(", ");
            return Err(SimulationFinding::UnknownFault { name: name.into(), known }.into());
        };
        let [low, high] = kind.range;
        if !(low..=high).contains(&value) {
            let option = format!("fault {name}");
            return Err(SimulationFinding::OptionOutOfRange { option, value, low, high }.into());
        }
        *(kind.field)(self) = value;
        Ok(())
    }
}

/// A faulty line.
#[derive(Clone, Debug)]
pub struct FaultyLine {
    faults: InjectedFaults,
    seed: u64,
    random: Pcg64,
}

impl FaultyLine {
    pub fn new(faults: InjectedFaults, seed: u64) -> Self {
        Self { faults, seed, random: Pcg64::seed_from_u64(seed) }
    }

    pub fn faults(&self) -> &InjectedFaults {
        &self.faults
    }

    /// The seed of the line's random numbers.
    pub fn seed(&self) -> u64 {
        self.seed
    }

    /// Whether an event of this probability happens now.
    pub fn happens(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.random.random::<f64>() < probability
    }

    /// Damages bytes that pass through the line.
    pub fn carry(&mut self, bytes: &mut Vec<u8>) {
        let InjectedFaults { drop, flip, double, insert, .. } = self.faults;
        if [drop, flip, double, insert] == [0.0; 4] {
            return;
        }
        let mut received = Vec::with_capacity(bytes.len() + 2);
        for &byte in bytes.iter() {
            if self.happens(insert) {
                received.push(self.random.random::<u8>());
            }
            if self.happens(drop) {
                continue;
            }
            let flipped = self.happens(flip);
            let byte = if flipped { byte ^ (1 << self.random.random_range(0..8)) } else { byte };
            received.push(byte);
            if self.happens(double) {
                received.push(byte);
            }
        }
        *bytes = received;
    }

    /// Random bytes that look like the end of an earlier stream.
    pub fn noise(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.random.random::<u8>()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn carried(faults: InjectedFaults, count: u8) -> Vec<u8> {
        let mut bytes: Vec<u8> = (0..count).collect();
        FaultyLine::new(faults, 3).carry(&mut bytes);
        bytes
    }

    #[test]
    fn certain_faults_change_every_byte() {
        let none = InjectedFaults::default();
        let bytes: Vec<u8> = (0..100).collect();
        assert_eq!(carried(none, 100), bytes);
        assert!(carried(InjectedFaults { drop: 1.0, ..none }, 100).is_empty());
        let doubled: Vec<u8> = bytes.iter().flat_map(|byte| [*byte; 2]).collect();
        assert_eq!(carried(InjectedFaults { double: 1.0, ..none }, 100), doubled);
        let flipped = carried(InjectedFaults { flip: 1.0, ..none }, 100);
        assert!(flipped.iter().zip(&bytes).all(|(a, b)| (a ^ b).count_ones() == 1));
        let inserted = carried(InjectedFaults { insert: 1.0, ..none }, 100);
        assert!(inserted.iter().skip(1).step_by(2).eq(&bytes));
    }

    /// 10 000 events with a probability of 0.2: 2000 happen, with a standard deviation of 40.
    #[test]
    fn events_happen_with_their_probability() {
        let mut line = FaultyLine::new(InjectedFaults::default(), 8);
        let count = (0..10_000).filter(|_| line.happens(0.2)).count();
        assert!((1800..2200).contains(&count), "{count}");
        assert!(!line.happens(0.0));
    }

    #[test]
    fn faults_are_set_by_name_within_their_range() {
        let mut faults = InjectedFaults::default();
        faults.set("creep_um", -30.0).expect("it is in the range");
        faults.set("drop", 1.0).expect("it is in the range");
        assert_eq!(faults, InjectedFaults { creep_um: -30.0, drop: 1.0, ..InjectedFaults::default() });
        for (name, value) in [("drop", 1.01), ("drop", -0.1), ("unseated_um", -1.0), ("batch_ms", f64::NAN)] {
            let finding = faults.set(name, value).expect_err("it is out of the range");
            assert!(matches!(finding.finding(), Some(SimulationFinding::OptionOutOfRange { .. })), "{name}");
        }
        let finding = faults.set("drops", 0.1).expect_err("there is none of this name");
        assert!(matches!(finding.finding(), Some(SimulationFinding::UnknownFault { .. })));
    }
}
