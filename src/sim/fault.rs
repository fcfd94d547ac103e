//! What goes wrong on a line: a seeded model of a bad one, between the virtual bar and its terminal.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::loose::{Loose, Looseness};
use crate::catalogue::SimulationFinding;
use crate::diagnostic::Diagnostic;

/// A fault by name, with the range of its value.
struct Kind {
    name: &'static str,
    field: fn(&mut Faults) -> &mut f64,
    range: [f64; 2],
}

macro_rules! faults {
    ($($(#[$doc:meta])* $name:ident: $range:expr,)+) => {
        /// The faults by name; rates are probabilities per byte, and all are off at 0.
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct Faults { $($(#[$doc])* pub $name: f64,)+ }

        const KINDS: &[Kind] =
            &[$(Kind { name: stringify!($name), field: |faults| &mut faults.$name, range: $range }),+];
    };
}

faults! {
    /// A byte is lost.
    drop: [0.0, 1.0],
    /// A bit of a byte is flipped.
    flip: [0.0, 1.0],
    /// A byte comes twice.
    double: [0.0, 1.0],
    /// A byte comes in addition.
    insert: [0.0, 1.0],
    /// Bytes are held back and handed over together, every so many ms.
    batch_ms: [0.0, 60_000.0],
    /// Bytes of a stale stream are there when the host opens the line.
    stale: [0.0, 1e6],
    /// The bar says who it is before its first frame.
    banner: [0.0, 1.0],
    /// The bar sends commands back.
    echo: [0.0, 1.0],
    /// A frame is not sent, as a probability per frame: the bar's menu is open.
    silence: [0.0, 1.0],
    /// The bar refuses a reading, as a probability per frame.
    refuse: [0.0, 1.0],
    /// The sequence number skips one, as a probability per frame.
    skip: [0.0, 1.0],
    /// The counter begins so many ticks before it wraps.
    wrap_ticks: [0.0, 4e9],
    /// The bar's clock is fast by so many parts per million.
    drift_ppm: [-1e6, 1e6],
    /// The bar is unplugged after so many s, once.
    unplug_s: [0.0, 1e9],
    /// It comes back after so many s, under another name.
    away_s: [0.0, 1e9],
    /// Readings are this much further out, mm.
    over_mm: [-1e6, 1e6],
    /// A packet of the controller's axes is lost, as a probability per packet.
    axes_drop: [0.0, 1.0],
    /// It comes twice.
    axes_double: [0.0, 1.0],
    /// It is overtaken by the next one.
    axes_swap: [0.0, 1.0],
    /// It is spoiled: cut, or of another recipe.
    axes_spoil: [0.0, 1.0],
    /// The controller's clock is fast by so many parts per million.
    axes_drift_ppm: [-1e6, 1e6],
    /// Packets come so much later, ms.
    axes_delay_ms: [0.0, 10_000.0],
    /// The mounted bar rocks by so much, micrometres.
    unseated_um: [0.0, 1e6],
    /// A ball creeps by so much in all after mounting, micrometres.
    creep_um: [-1e6, 1e6],
    /// A magnet slips by so much every now and then, micrometres.
    slip_um: [-1e6, 1e6],
    /// The cable pulls by so much every now and then, micrometres.
    cable_um: [-1e6, 1e6],
}

impl Faults {
    /// Sets the one that `--fault NAME=VALUE` names.
    pub fn set(&mut self, name: &str, value: f64) -> Result<(), Diagnostic> {
        let Some(kind) = KINDS.iter().find(|kind| kind.name == name) else {
            let known = KINDS.iter().map(|kind| kind.name).collect::<Vec<_>>().join(", ");
            return Err(SimulationFinding::UnknownFault { name: name.into(), known }.into());
        };
        let [low, high] = kind.range;
        if !(low..=high).contains(&value) {
            let option = format!("--fault {name}");
            return Err(SimulationFinding::OptionOutOfRange { option, value, low, high }.into());
        }
        *(kind.field)(self) = value;
        Ok(())
    }
}

/// A bad line with its dice, and the mounting of the bar at its end.
#[derive(Clone, Debug)]
pub struct BadLine {
    faults: Faults,
    dice: Pcg64,
    pub(super) loose: Loose,
}

impl BadLine {
    pub fn new(faults: Faults, seed: u64) -> Self {
        let Faults { unseated_um, creep_um, slip_um, cable_um, .. } = faults;
        let loose = Loose::new(Looseness { unseated_um, creep_um, slip_um, cable_um }, seed);
        Self { faults, dice: Pcg64::seed_from_u64(seed), loose }
    }

    pub fn faults(&self) -> &Faults {
        &self.faults
    }

    /// Whether something of such a probability happens now.
    pub fn happens(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.dice.random::<f64>() < probability
    }

    /// Bytes as they come out of the line.
    pub fn carry(&mut self, bytes: &mut Vec<u8>) {
        let Faults { drop, flip, double, insert, .. } = self.faults;
        if [drop, flip, double, insert] == [0.0; 4] {
            return;
        }
        let mut carried = Vec::with_capacity(bytes.len() + 2);
        for &byte in bytes.iter() {
            if self.happens(insert) {
                carried.push(self.dice.random::<u8>());
            }
            if self.happens(drop) {
                continue;
            }
            let flipped = self.happens(flip);
            let byte = if flipped { byte ^ (1 << self.dice.random_range(0..8)) } else { byte };
            carried.push(byte);
            if self.happens(double) {
                carried.push(byte);
            }
        }
        *bytes = carried;
    }

    /// Bytes of an earlier stream: the tail of nothing in particular.
    pub fn noise(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.dice.random::<u8>()).collect()
    }
}
