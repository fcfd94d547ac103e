//! For any input: bytes = bytes of samples + bytes of faults + pending bytes.

use dbbd_device::protocol::{DecodedItem, ProtocolDecoder, ProtocolDefinition};
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;
use proptest::prelude::*;

fn definition(name: &str) -> ProtocolDefinition {
    ProtocolDefinition::by_name(name).unwrap().unwrap()
}

/// Samples that `dbb-cobs-1` and `dbb-nmea-1` can represent: steps of 10 nm and 0.01 C.
fn samples() -> impl Strategy<Value = Vec<Sample>> {
    let one = (any::<u16>(), any::<u32>(), -2_000_000i32..2_000_000, any::<i16>(), 0u32..64).prop_map(
        |(sequence, ticks, length, temperature, status)| Sample {
            reading_mm: f64::from(length) / 1e5,
            sequence: Some(sequence.into()),
            ticks: Some(DeviceTicks(ticks.into())),
            trigger: Some(status & 16 != 0),
            temperature_c: Some(f64::from(temperature) / 100.0),
            valid: status & 0b1111 == 1,
            // A bar does not send contradicting flags.
            status: if status & 0b1110 != 0 { status & !1 } else { status },
            offset: 0,
        },
    );
    prop::collection::vec(one, 1..30)
}

fn encode(definition: &ProtocolDefinition, samples: &[Sample]) -> Vec<u8> {
    let encoder = definition.encoder();
    let mut bytes = Vec::new();
    for sample in samples {
        encoder.encode(sample, &mut bytes).unwrap();
    }
    bytes
}

/// Decodes the whole stream, and checks the account and the offsets.
fn decode(definition: &ProtocolDefinition, bytes: &[u8]) -> (Vec<DecodedItem>, ProtocolDecoder) {
    let (mut decoder, mut out) = (definition.decoder(), Vec::new());
    decoder.push(bytes, &mut out);
    let accounted: u64 = out.iter().map(DecodedItem::bytes).sum::<u64>() + decoder.pending();
    assert_eq!(accounted, bytes.len() as u64);
    let mut at = 0;
    for one in &out {
        let offset = match one {
            DecodedItem::Sample(sample, _) => sample.offset,
            DecodedItem::Fault(fault) => fault.offset,
        };
        assert_eq!(offset, at);
        assert!(one.bytes() > 0);
        at += one.bytes();
    }
    (out, decoder)
}

fn only_samples(decoded: &[DecodedItem]) -> Vec<Sample> {
    let samples = decoded.iter().filter_map(|one| match one {
        DecodedItem::Sample(sample, _) => Some(Sample { offset: 0, ..*sample }),
        DecodedItem::Fault(_) => None,
    });
    samples.collect()
}

/// Damage of a byte.
#[derive(Clone, Copy, Debug)]
enum Harm {
    Flip(u8),
    Drop,
    Insert(u8),
}

fn harms() -> impl Strategy<Value = Vec<(prop::sample::Index, Harm)>> {
    let harm =
        prop_oneof![(0u8..8).prop_map(Harm::Flip), Just(Harm::Drop), any::<u8>().prop_map(Harm::Insert)];
    prop::collection::vec((any::<prop::sample::Index>(), harm), 0..6)
}

fn harm(bytes: &mut Vec<u8>, harms: &[(prop::sample::Index, Harm)]) {
    for (index, harm) in harms {
        if bytes.is_empty() {
            return;
        }
        let at = index.index(bytes.len());
        match harm {
            Harm::Flip(bit) => bytes[at] ^= 1 << bit,
            Harm::Drop => drop(bytes.remove(at)),
            Harm::Insert(byte) => bytes.insert(at, *byte),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn encoded_samples_are_decoded(samples in samples()) {
        for name in ["dbb-cobs-1", "dbb-nmea-1"] {
            let definition = definition(name);
            let (decoded, mut decoder) = decode(&definition, &encode(&definition, &samples));
            prop_assert_eq!(decoder.pending(), 0);
            prop_assert_eq!(only_samples(&decoded), samples.clone());
            // Nothing is pending, so an interruption is no fault.
            let mut cut_off = Vec::new();
            decoder.interrupt(&mut cut_off);
            prop_assert_eq!(cut_off, vec![]);
        }
    }

    #[test]
    fn damaged_streams_are_fully_accounted_for(samples in samples(), harms in harms(), cuts in prop::collection::vec(1usize..40, 1..20)) {
        for name in ["dbb-cobs-1", "dbb-nmea-1", "dbb-csv-1"] {
            let definition = definition(name);
            let mut bytes = encode(&definition, &samples);
            harm(&mut bytes, &harms);
            let (whole, _) = decode(&definition, &bytes);
            // Each damage spoils at most two frames.
            let decoded = only_samples(&whole).len();
            prop_assert!(decoded + 2 * harms.len() >= samples.len(), "{}: {} of {}", name, decoded, samples.len());
            // Other splits of the same bytes give the same result.
            let (mut decoder, mut pieces) = (definition.decoder(), Vec::new());
            let mut rest = &bytes[..];
            for cut in cuts.iter().cycle() {
                let (piece, tail) = rest.split_at((*cut).min(rest.len()));
                decoder.push(piece, &mut pieces);
                rest = tail;
                if rest.is_empty() {
                    break;
                }
            }
            prop_assert_eq!(pieces, whole);
        }
    }

    #[test]
    fn noise_yields_only_faults(bytes in prop::collection::vec(any::<u8>(), 0..9000)) {
        for (name, _) in ProtocolDefinition::built_in() {
            decode(&definition(name), &bytes);
        }
    }
}

/// A frame without end is reported in bounded pieces, and the next frame is decoded.
#[test]
fn overlong_frames_become_faults() {
    for name in ["dbb-cobs-1", "dbb-nmea-1"] {
        let definition = definition(name);
        let mut bytes = vec![b'x'; 10_000];
        let (endless, decoder) = decode(&definition, &bytes);
        assert_eq!(endless.len(), 2, "{name}");
        assert!(decoder.pending() < 4096);
        let sample = Sample {
            sequence: Some(1),
            ticks: Some(DeviceTicks(2)),
            trigger: Some(true),
            temperature_c: Some(20.0),
            status: 17,
            ..Sample::of(0.5)
        };
        bytes.extend(encode(&definition, &[sample, sample]));
        let (decoded, _) = decode(&definition, &bytes);
        assert_eq!(only_samples(&decoded), [sample], "{name}: the first frame ends the endless one");
    }
}

/// A CRC-16 detects every single flipped bit.
#[test]
fn flipped_bits_yield_no_sample() {
    let definition = definition("dbb-cobs-1");
    let frame = [7, 1, 2, 1, 0x40, 0x42, 0x0f, 0x0a, 0xc7, 0xcf, 0xff, 0xff, 0x66, 8, 1, 0x84, 0x9e, 0];
    for bit in 0..8 * frame.len() {
        let mut bytes = frame;
        bytes[bit / 8] ^= 1 << (bit % 8);
        let (decoded, _) = decode(&definition, &bytes);
        assert!(only_samples(&decoded).is_empty(), "bit {bit}");
    }
}

#[test]
fn interruption_turns_pending_bytes_into_faults() {
    let definition = definition("dbb-cobs-1");
    let (mut out, mut decoder) = decode(&definition, &[7, 1, 2]);
    decoder.interrupt(&mut out);
    assert_eq!((out.iter().map(DecodedItem::bytes).sum::<u64>(), decoder.pending()), (3, 0));
}
