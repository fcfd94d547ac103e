//! Identifies a device: how well each definition explains its bytes, compared with chance.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use serde::Serialize;

use super::decoder::DecodedItem;
use super::definition::ProtocolDefinition;
use super::fault::{LineFault, LineFaultKind};

/// Number of bytes that are used.
const MAX_EVIDENCE_BYTES: usize = 8192;
/// Number of shuffles of the bytes, which show the rate of chance samples.
const SHUFFLES: usize = 4;
/// A definition identifies the device if it explains this share of the bytes, gives this number of samples, and
/// has this evidence against chance, bits.
const MIN_EXPLAINED: f64 = 0.8;
const MIN_EVIDENCE_SAMPLES: u64 = 3;
const MIN_EVIDENCE_BITS: f64 = 20.0;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProtocolEvidence {
    pub protocol: String,
    pub samples: u64,
    /// Messages that there is no reading.
    pub refusals: u64,
    /// Share of the bytes in samples, refusals and ignored records.
    pub explained: f64,
    /// 2^-bits is the probability of this number of samples by chance, at the rate that the same bytes give in
    /// random order: the strength of grammar and check.
    pub bits: f64,
}

#[derive(Default)]
struct EvidenceCount {
    samples: u64,
    refusals: u64,
    explained: u64,
}

impl EvidenceCount {
    fn of(definition: &ProtocolDefinition, bytes: &[u8]) -> Self {
        let (mut decoder, mut out) = (definition.decoder(), Vec::new());
        decoder.push(bytes, &mut out);
        decoder.idle(&mut out);
        let mut count = Self::default();
        for one in &out {
            match one {
                DecodedItem::Sample(..) => count.samples += 1,
                DecodedItem::Fault(LineFault { kind: LineFaultKind::Reject(_), .. }) => count.refusals += 1,
                DecodedItem::Fault(LineFault { kind: LineFaultKind::Ignored, .. }) => {}
                DecodedItem::Fault(_) => continue,
            }
            count.explained += one.bytes();
        }
        count
    }
}

impl ProtocolEvidence {
    pub fn of(definition: &ProtocolDefinition, bytes: &[u8]) -> Self {
        let bytes = &bytes[..bytes.len().min(MAX_EVIDENCE_BYTES)];
        let count = EvidenceCount::of(definition, bytes);
        let mut dice = Pcg64::seed_from_u64(1);
        let mut shuffled = bytes.to_vec();
        let mut chance = EvidenceCount::default();
        for _ in 0..SHUFFLES {
            for place in (1..shuffled.len()).rev() {
                shuffled.swap(place, dice.random_range(0..=place));
            }
            let EvidenceCount { samples, explained, .. } = EvidenceCount::of(definition, &shuffled);
            (chance.samples, chance.explained) = (chance.samples + samples, chance.explained + explained);
        }
        // Each unexplained byte is a position without a sample. Half a sample more keeps the rate of chance above 0.
        let places = |count: &EvidenceCount, times: usize| {
            (times * bytes.len()) as f64 - count.explained as f64 + count.samples as f64
        };
        let share = (chance.samples as f64 + 0.5) / (places(&chance, SHUFFLES) + 1.0);
        // A definition without a sample explains nothing, whatever it ignores.
        let explained = if count.samples == 0 { 0.0 } else { count.explained as f64 / bytes.len() as f64 };
        Self {
            protocol: definition.id.clone(),
            samples: count.samples,
            refusals: count.refusals,
            explained,
            bits: improbable_bits(count.samples as f64, places(&count, 1), share),
        }
    }

    /// The evidence of each definition, the best first.
    pub fn ranked(definitions: &[ProtocolDefinition], bytes: &[u8]) -> Vec<Self> {
        let mut ranked: Vec<_> = definitions.iter().map(|definition| Self::of(definition, bytes)).collect();
        ranked.sort_by(|a, b| b.weight().total_cmp(&a.weight()));
        ranked
    }

    fn weight(&self) -> f64 {
        self.bits * self.explained
    }

    /// Whether the evidence identifies the device.
    pub fn is_enough(&self) -> bool {
        self.explained >= MIN_EXPLAINED
            && self.samples >= MIN_EVIDENCE_SAMPLES
            && self.bits >= MIN_EVIDENCE_BITS
    }
}

/// Chernoff bound of a binomial tail: at most -log2 P(at least n of m), each with probability `share`.
fn improbable_bits(n: f64, m: f64, share: f64) -> f64 {
    let part = |is: f64, by_chance: f64| if is > 0.0 { is * (is / by_chance).log2() } else { 0.0 };
    if n <= m * share { 0.0 } else { m * (part(n / m, share) + part(1.0 - n / m, 1.0 - share)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// P(at least 3 of 4) at 1/2 is 5/16, P(4 of 4) at 1/4 is 2^-8.
    #[test]
    fn chernoff_bound_holds() {
        let bound = 2f64.powf(-improbable_bits(3.0, 4.0, 0.5));
        assert!(bound > 5.0 / 16.0 && bound < 2.0 * 5.0 / 16.0, "{bound}");
        assert!((improbable_bits(4.0, 4.0, 0.25) - 8.0).abs() < 1e-12);
        assert_eq!(improbable_bits(2.0, 4.0, 0.5), 0.0);
    }
}
