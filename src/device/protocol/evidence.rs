//! How well a definition explains bytes, against chance: which device sends them.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::Serialize;

use super::decoder::Decoded;
use super::definition::Definition;
use super::fault::{Fault, FaultKind};

/// Bytes that are looked at; more say nothing new.
const MOST_BYTES: usize = 8192;
/// How often the bytes are shuffled to see what chance gives.
const SHUFFLES: usize = 4;
/// A definition that names its device explains at least this share of the bytes, with so many readings, and is this much
/// likelier than chance, bits.
const LEAST_EXPLAINED: f64 = 0.8;
const LEAST_SAMPLES: u64 = 3;
const LEAST_BITS: f64 = 20.0;

/// What a definition makes of bytes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evidence {
    pub protocol: String,
    /// Readings.
    pub samples: u64,
    /// Times that the device would have said that it has no reading.
    pub refusals: u64,
    /// The share of the bytes that are in readings, refusals and what the device may say beside them.
    pub explained: f64,
    /// How improbable it is, as 2^-bits, that so many of the places at which a reading may begin begin one, by what the same
    /// bytes in random order give: the strength of grammar and check.
    pub bits: f64,
}

#[derive(Default)]
struct Count {
    samples: u64,
    refusals: u64,
    explained: u64,
}

impl Count {
    fn of(definition: &Definition, bytes: &[u8]) -> Self {
        let (mut decoder, mut out) = (definition.decoder(), Vec::new());
        decoder.push(bytes, &mut out);
        decoder.silence(&mut out);
        let mut count = Self::default();
        for one in &out {
            match one {
                Decoded::Sample(..) => count.samples += 1,
                Decoded::Fault(Fault { kind: FaultKind::Reject(_), .. }) => count.refusals += 1,
                Decoded::Fault(Fault { kind: FaultKind::Ignored, .. }) => {}
                Decoded::Fault(_) => continue,
            }
            count.explained += one.bytes();
        }
        count
    }
}

impl Evidence {
    /// Of one definition.
    pub fn of(definition: &Definition, bytes: &[u8]) -> Self {
        let bytes = &bytes[..bytes.len().min(MOST_BYTES)];
        let count = Count::of(definition, bytes);
        let mut dice = Pcg64::seed_from_u64(1);
        let mut shuffled = bytes.to_vec();
        let mut chance = Count::default();
        for _ in 0..SHUFFLES {
            for place in (1..shuffled.len()).rev() {
                shuffled.swap(place, dice.random_range(0..=place));
            }
            let Count { samples, explained, .. } = Count::of(definition, &shuffled);
            (chance.samples, chance.explained) = (chance.samples + samples, chance.explained + explained);
        }
        // Each byte that is not explained is a place at which no reading begins. Half a reading more keeps chance above 0.
        let places = |count: &Count, times: usize| {
            (times * bytes.len()) as f64 - count.explained as f64 + count.samples as f64
        };
        let share = (chance.samples as f64 + 0.5) / (places(&chance, SHUFFLES) + 1.0);
        // A definition without a reading explains nothing, whatever it passes over.
        let explained = if count.samples == 0 { 0.0 } else { count.explained as f64 / bytes.len() as f64 };
        Self {
            protocol: definition.id.clone(),
            samples: count.samples,
            refusals: count.refusals,
            explained,
            bits: improbable_bits(count.samples as f64, places(&count, 1), share),
        }
    }

    /// Of every definition, the best first.
    pub fn ranked(definitions: &[Definition], bytes: &[u8]) -> Vec<Self> {
        let mut ranked: Vec<_> = definitions.iter().map(|definition| Self::of(definition, bytes)).collect();
        ranked.sort_by(|a, b| b.weight().total_cmp(&a.weight()));
        ranked
    }

    fn weight(&self) -> f64 {
        self.bits * self.explained
    }

    /// Whether it is enough to name the device.
    pub fn is_enough(&self) -> bool {
        self.explained >= LEAST_EXPLAINED && self.samples >= LEAST_SAMPLES && self.bits >= LEAST_BITS
    }
}

/// Chernoff's bound of a binomial tail: at most -log2 P(at least n of m), each with probability `share`.
fn improbable_bits(n: f64, m: f64, share: f64) -> f64 {
    let part = |is: f64, by_chance: f64| if is > 0.0 { is * (is / by_chance).log2() } else { 0.0 };
    if n <= m * share { 0.0 } else { m * (part(n / m, share) + part(1.0 - n / m, 1.0 - share)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// P(at least 3 of 4) at 1/2 is 5/16, P(4 of 4) at 1/4 is 2^-8.
    #[test]
    fn the_bound_holds() {
        let bound = 2f64.powf(-improbable_bits(3.0, 4.0, 0.5));
        assert!(bound > 5.0 / 16.0 && bound < 2.0 * 5.0 / 16.0, "{bound}");
        assert!((improbable_bits(4.0, 4.0, 0.25) - 8.0).abs() < 1e-12);
        assert_eq!(improbable_bits(2.0, 4.0, 0.5), 0.0);
    }
}
