//! Bytes of a bar identify its definition, or say that it is unknown.

use dbbd_device::protocol::{ProtocolDefinition, ProtocolEvidence, ProtocolMode};
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn built_in() -> Vec<ProtocolDefinition> {
    ProtocolDefinition::built_in()
        .iter()
        .map(|(name, _)| ProtocolDefinition::by_name(name).unwrap().unwrap())
        .collect()
}

/// Bytes of a device in two seconds at about one length; the line was opened within a frame.
fn two_seconds(definition: &ProtocolDefinition, seed: u64) -> Vec<u8> {
    let mut dice = Pcg64::seed_from_u64(seed);
    let rate_hz = match definition.mode {
        ProtocolMode::Poll { hz, .. } => hz,
        ProtocolMode::Stream | ProtocolMode::Push => definition.nominal_hz.unwrap_or(10.0),
    };
    let mut bytes = Vec::new();
    let begin: u32 = dice.random_range(0..1_000_000);
    for frame in 0..(2.0 * rate_hz) as u32 {
        let ticks = |tick_ns: u32| f64::from(begin) + f64::from(frame) / rate_hz * 1e9 / f64::from(tick_ns);
        let sample = Sample {
            sequence: definition.sequence_modulo.map(|modulo| (begin + frame) % modulo),
            ticks: definition.clock.map(|clock| DeviceTicks(ticks(clock.tick_ns) as u64)),
            trigger: Some(false),
            temperature_c: Some(21.5),
            ..Sample::of(definition.sim.at_mm + 0.1 + dice.random_range(-0.002..0.002))
        };
        definition.encoder().encode(&sample, &mut bytes).unwrap();
    }
    bytes.split_off(2)
}

fn named(ranked: &[ProtocolEvidence]) -> Option<&str> {
    ranked.first().filter(|evidence| evidence.is_enough()).map(|evidence| evidence.protocol.as_str())
}

#[test]
fn two_seconds_of_bytes_identify_the_definition() {
    let definitions = built_in();
    for definition in &definitions {
        for seed in 0..2 {
            let mut bytes = two_seconds(definition, seed);
            // One byte is damaged.
            let middle = bytes.len() / 2;
            bytes[middle] ^= 0x11;
            let ranked = ProtocolEvidence::ranked(&definitions, &bytes);
            assert_eq!(named(&ranked), Some(definition.id.as_str()), "{:?}", &ranked[..2]);
            assert!(!ranked[1].is_enough(), "{}: {:?}", definition.id, &ranked[..2]);
        }
    }
}

const GPS: &str = "$GPGGA,123519.00,4807.0380,N,01131.0000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n\
                   $GPGSA,A,3,04,05,,09,12,,,24,,,,,2.5,1.3,2.1*39\r\n\
                   $GPRMC,123519.00,A,4807.0380,N,01131.0000,E,022.4,084.4,230394,003.1,W*6A\r\n";

const MODEM: &str = "\r\nRING\r\n\r\nNO CARRIER\r\nAT\r\r\nOK\r\nAT+CSQ\r\r\n+CSQ: 15,99\r\n\r\nOK\r\nAT+CREG?\r\r\n\
                     +CREG: 0,1\r\n\r\nOK\r\n\r\nERROR\r\nNO DIALTONE\r\n";

/// Other sources: noise of each density, a satellite receiver, a modem, a stuck line.
fn strangers() -> Vec<(&'static str, Vec<u8>)> {
    let noise = |seed: u64, least: u8| -> Vec<u8> {
        let mut dice = Pcg64::seed_from_u64(seed);
        (0..8000).map(|_| dice.random::<u8>()).filter(|byte| *byte >= least).collect()
    };
    let digits: Vec<u8> =
        noise(3, 0).iter().map(|byte| b"0123456789+-. ,\r\n"[usize::from(*byte) % 17]).collect();
    vec![
        ("noise", noise(1, 0)),
        ("high noise", noise(2, 128)),
        ("noise of digits", digits),
        ("satellites", GPS.repeat(20).into_bytes()),
        ("modem", MODEM.repeat(20).into_bytes()),
        ("stuck low", vec![0; 4000]),
        ("stuck high", vec![255; 4000]),
    ]
}

#[test]
fn unknown_device_is_not_identified() {
    let definitions = built_in();
    for (name, bytes) in strangers() {
        let ranked = ProtocolEvidence::ranked(&definitions, &bytes);
        assert_eq!(named(&ranked), None, "{name}: {:?}", ranked[0]);
    }
}
