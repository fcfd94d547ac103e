//! What goes wrong on a line: a seeded model of a bad one, between the virtual bar and its terminal.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// The faults by name; rates are probabilities per byte, and all are off at 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Faults {
    /// A byte is lost.
    pub drop: f64,
    /// A bit of a byte is flipped.
    pub flip: f64,
    /// A byte comes twice.
    pub double: f64,
    /// A byte comes in addition.
    pub insert: f64,
    /// Bytes are held back and handed over together, every so many ms.
    pub batch_ms: f64,
    /// Bytes of a stale stream are there when the host opens the line.
    pub stale: f64,
    /// The bar says who it is before its first frame.
    pub banner: f64,
    /// The bar sends commands back.
    pub echo: f64,
    /// A frame is not sent, as a probability per frame: the bar's menu is open.
    pub silence: f64,
    /// The bar refuses a reading, as a probability per frame.
    pub refuse: f64,
    /// The sequence number skips one, as a probability per frame.
    pub skip: f64,
    /// The counter begins so many ticks before it wraps.
    pub wrap_ticks: f64,
    /// The bar's clock is fast by so many parts per million.
    pub drift_ppm: f64,
    /// The bar is unplugged after so many s, once.
    pub unplug_s: f64,
    /// It comes back after so many s, under another name.
    pub away_s: f64,
    /// Readings are this much further out, mm.
    pub over_mm: f64,
}

impl Faults {
    /// Their names, as `--fault NAME=VALUE` takes them.
    pub const NAMES: [&'static str; 16] = [
        "drop",
        "flip",
        "double",
        "insert",
        "batch_ms",
        "stale",
        "banner",
        "echo",
        "silence",
        "refuse",
        "skip",
        "wrap_ticks",
        "drift_ppm",
        "unplug_s",
        "away_s",
        "over_mm",
    ];

    /// Sets one.
    ///
    /// # Errors
    /// An unknown name, or a value that makes no sense.
    pub fn set(&mut self, name: &str, value: f64) -> Result<(), String> {
        let (field, most) = match name {
            "drop" => (&mut self.drop, 1.0),
            "flip" => (&mut self.flip, 1.0),
            "double" => (&mut self.double, 1.0),
            "insert" => (&mut self.insert, 1.0),
            "silence" => (&mut self.silence, 1.0),
            "refuse" => (&mut self.refuse, 1.0),
            "skip" => (&mut self.skip, 1.0),
            "batch_ms" => (&mut self.batch_ms, 60_000.0),
            "stale" => (&mut self.stale, 1e6),
            "banner" => (&mut self.banner, 1.0),
            "echo" => (&mut self.echo, 1.0),
            "wrap_ticks" => (&mut self.wrap_ticks, 4e9),
            "drift_ppm" => (&mut self.drift_ppm, 1e6),
            "unplug_s" => (&mut self.unplug_s, 1e9),
            "away_s" => (&mut self.away_s, 1e9),
            "over_mm" => (&mut self.over_mm, 1e6),
            _ => return Err(format!("no fault `{name}`; there are: {}", Self::NAMES.join(", "))),
        };
        let least = if matches!(name, "drift_ppm" | "over_mm") { -most } else { 0.0 };
        if !(least..=most).contains(&value) {
            return Err(format!("{name} must be {least} to {most}"));
        }
        *field = value;
        Ok(())
    }
}

/// A bad line with its dice.
#[derive(Clone, Debug)]
pub struct BadLine {
    faults: Faults,
    dice: Pcg64,
}

impl BadLine {
    /// With a seed.
    pub fn new(faults: Faults, seed: u64) -> Self {
        Self { faults, dice: Pcg64::seed_from_u64(seed) }
    }

    /// The faults.
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
                carried.push(self.dice.random());
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
        (0..count).map(|_| self.dice.random()).collect()
    }
}
