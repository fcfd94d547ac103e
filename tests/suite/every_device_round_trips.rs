//! Every shipped definition: encoded samples are decoded, and `acquire` on its virtual bar through a pseudo-terminal
//! gives the simulated lengths.

use std::process::Command;

use dbbd_device::protocol::{DecodedItem, ProtocolDefinition};
use dbbd_job::recording::capture::{self, CaptureRecord, StampedRecord};
use dbbd_job::sim::bar::{self, SimulatedReading, Terminal, VirtualBarOptions};
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::diagnostic::Finding;
use dbbd_model::measurement::sample::Sample;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::any_bytes_are_taken::entries;
use crate::process::{dbbd, end_when};

fn all() -> impl Iterator<Item = ProtocolDefinition> {
    ProtocolDefinition::built_in().iter().map(|(name, _)| ProtocolDefinition::by_name(name).unwrap().unwrap())
}

fn decode(definition: &ProtocolDefinition, bytes: &[u8]) -> Vec<DecodedItem> {
    let (mut decoder, mut out) = (definition.decoder(), Vec::new());
    decoder.push(bytes, &mut out);
    decoder.idle(&mut out);
    out
}

fn one(definition: &ProtocolDefinition, sample: &Sample) -> Option<Sample> {
    let mut bytes = Vec::new();
    definition.encoder().encode(sample, &mut bytes).ok()?;
    match decode(definition, &bytes)[..] {
        [DecodedItem::Sample(sample, length)] if length == bytes.len() as u64 => Some(sample),
        ref other => panic!("{}: {sample:?} gives {other:?}", definition.id),
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// The first encoding rounds to the resolution of the device; after that nothing changes.
    #[test]
    fn samples_round_trip(
        reading_mm in prop_oneof![-2.0..2.0, -60.0..60.0, -900.0..900.0f64],
        (sequence, ticks, status, valid) in (any::<u32>(), any::<u32>(), 0u32..64, any::<bool>()),
        temperature in -3000i16..9000,
    ) {
        for definition in all() {
            let sample = Sample {
                reading_mm,
                sequence: definition.sequence_modulo.map(|modulo| sequence % modulo),
                ticks: definition.clock.map(|_| DeviceTicks(ticks.into())),
                trigger: Some(status & 16 != 0),
                temperature_c: Some(f64::from(temperature) / 100.0),
                // A bar does not send contradicting flags.
                valid: valid && status & 0b1110 == 0,
                status,
                offset: 0,
            };
            let Some(said) = one(&definition, &sample) else { continue };
            let step = definition.resolution_mm();
            prop_assert!((said.reading_mm - reading_mm).abs() <= 0.5001 * step, "{}: {} {}", definition.id, said.reading_mm, reading_mm);
            prop_assert_eq!(said.sequence, sample.sequence);
            prop_assert_eq!(said.ticks, sample.ticks);
            prop_assert_eq!(one(&definition, &said), Some(said), "{}", definition.id);
        }
    }
}

/// The readings that a device can represent: over its whole range, or all of them if they are few.
#[test]
fn whole_range_of_a_device_round_trips() {
    let mut dice = Pcg64::seed_from_u64(11);
    for definition in all() {
        let (at, step) = (definition.sim.at_mm, definition.resolution_mm());
        let mut sample = Sample {
            sequence: definition.sequence_modulo.map(|_| 0),
            ticks: definition.clock.map(|_| DeviceTicks(0)),
            trigger: Some(false),
            temperature_c: Some(20.0),
            ..Sample::of(at)
        };
        let says = |steps: i64| {
            let mut bytes = Vec::new();
            let reading_mm = at + steps as f64 * step;
            definition.encoder().encode(&Sample { reading_mm, ..sample }, &mut bytes).is_ok()
        };
        // The last representable step on each side.
        let furthest = |sense: i64| {
            let (mut can, mut cannot) = (0i64, 1i64 << 40);
            while cannot - can > 1 {
                let middle = can + (cannot - can) / 2;
                if says(sense * middle) { can = middle } else { cannot = middle }
            }
            can
        };
        let (low, high) = (-furthest(-1), furthest(1));
        assert!(high - low > 10_000, "{}: {low} to {high}", definition.id);
        let few = high - low <= 70_000;
        let steps: Vec<i64> = if few {
            (low..=high).collect()
        } else {
            [low, high, 0].into_iter().chain((0..3000).map(|_| dice.random_range(low..=high))).collect()
        };
        for steps in steps {
            sample.reading_mm = at + steps as f64 * step;
            sample.sequence = definition.sequence_modulo.map(|modulo| dice.random_range(0..modulo));
            sample.ticks = definition.clock.map(|_| DeviceTicks(dice.random::<u32>().into()));
            let said = one(&definition, &sample).unwrap_or_else(|| panic!("{}: {steps}", definition.id));
            let off = (said.reading_mm - sample.reading_mm).abs();
            assert!(off <= 0.5001 * step, "{}: {} for {}", definition.id, said.reading_mm, sample.reading_mm);
            assert_eq!((said.sequence, said.ticks, said.valid), (sample.sequence, sample.ticks, true));
            // A decoded sample is encoded bit for bit.
            assert_eq!(one(&definition, &said), Some(said), "{}", definition.id);
        }
    }
}

/// Every device can represent its range around the bar's zero.
#[test]
fn bar_stroke_fits_the_protocol() {
    for definition in all() {
        for at in -10..=17 {
            let sample = Sample {
                sequence: Some(1),
                ticks: Some(DeviceTicks(5)),
                trigger: Some(false),
                temperature_c: Some(20.0),
                ..Sample::of(definition.sim.at_mm + f64::from(at) / 10.0)
            };
            let said = one(&definition, &sample).unwrap_or_else(|| panic!("{}: {at}", definition.id));
            assert!(said.valid, "{}", definition.id);
        }
    }
}

const NO_LENGTH: &str = "W0222";
const UNANSWERED: &str = "W0223";
const NOT_SENT: &str = "E0312";

const RATE_HZ: f64 = 100.0;

/// Lengths on a ramp, so that each sample is identified by its value.
fn ramp_mm(t_s: f64, rate_hz: f64) -> f64 {
    -0.9 + 0.01 * ((t_s * rate_hz).round() % 180.0)
}

/// The capture, exit code and output of `acquire` on a virtual bar with these readings.
fn acquired(
    definition: &ProtocolDefinition,
    protocol: &str,
    params: &[&str],
    read: impl Fn(f64) -> SimulatedReading + Send + 'static,
) -> (capture::Capture, Option<i32>, String) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    let terminal = Terminal::new().unwrap();
    let port = terminal.address().to_string();
    let options = VirtualBarOptions { rate_hz: RATE_HZ, speed: 1.0, first_ticks: 0 };
    let served = definition.clone();
    let _bar = std::thread::spawn(move || {
        bar::serve_bar(terminal, &served, options, |t_s: f64| (t_s < 60.0).then(|| read(t_s)))
    });
    let mut command =
        dbbd(&["acquire", "--port", &port, "--protocol", protocol, "--out", path.to_str().unwrap()]);
    let output = end_when(command.args(params).spawn().unwrap(), &path, |capture| {
        let decoded =
            |one: &StampedRecord| matches!(one.record, CaptureRecord::Samples(_) | CaptureRecord::Fault(_));
        capture.records.iter().filter(|one| decoded(one)).count() >= 15
    });
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    (capture::read_capture(&std::fs::read(&path).unwrap()), output.status.code(), said)
}

fn simulated_is_acquired(definition: &ProtocolDefinition, protocol: &str, params: &[&str]) {
    let reading = |t_s| SimulatedReading {
        reading_mm: ramp_mm(t_s, RATE_HZ),
        strobe: false,
        valid: true,
        temperature_c: 20.0,
    };
    let (capture, code, said) = acquired(definition, protocol, params, reading);
    // On a busy machine a reply may be late: that is reported, and gives no wrong length.
    let late = code == Some(3) && said.contains(UNANSWERED);
    assert!(code == Some(0) || late, "{protocol}: {said}");
    let samples: Vec<Sample> = capture.samples().map(|(_, sample)| *sample).collect();
    assert!(samples.len() >= 3, "{protocol}: {} samples", samples.len());
    for pair in samples.windows(2) {
        assert!(pair[0].valid, "{protocol}");
        // Each reading is on the ramp, after the one before.
        let place = |sample: &Sample| {
            let steps = (sample.reading_mm - definition.sim.at_mm + 0.9) / 0.01;
            assert!(
                (steps - steps.round()).abs() * 0.01 <= 0.5001 * definition.resolution_mm(),
                "{protocol}: {steps}"
            );
            steps.round() as i64
        };
        let step = (place(&pair[1]) - place(&pair[0])).rem_euclid(180);
        let polled = !definition.poll.is_empty();
        assert!(if polled { step >= 1 } else { step == 1 }, "{protocol}: a step of {step}");
    }
}

#[test]
fn acquire_reads_every_virtual_bar() {
    std::thread::scope(|scope| {
        for definition in all() {
            scope.spawn(move || simulated_is_acquired(&definition, &definition.id, &[]));
        }
    });
}

/// A device that is not built in, with other framing and fields.
const OUTSIDE: &str = include_str!("../../fuzz/length.toml");

/// A reading of 1 mm, with its number and nothing else.
fn numbered(sequence: u32) -> Sample {
    Sample { sequence: Some(sequence), ..Sample::of(1.0) }
}

#[test]
fn definition_from_a_file_is_acquired() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("outside.toml");
    std::fs::write(&path, OUTSIDE).unwrap();
    let params = [("gain".to_owned(), "2.0".to_owned())];
    let exact = ProtocolDefinition::from_toml_with("outside.toml", OUTSIDE, &params).unwrap();
    let mut bytes = Vec::new();
    let sample = numbered(5);
    exact.encoder().encode(&sample, &mut bytes).unwrap();
    // aa 55, 3 + 11 = 14 bytes less the three before, 5, 0.5 as IEEE 754, sum of what follows the sync.
    assert_eq!(bytes, [0xaa, 0x55, 0x0b, 5, 0, 0x3f, 0xe0, 0, 0, 0, 0, 0, 0, 0x2f]);
    let terminal = Terminal::new().unwrap();
    let port = terminal.address().to_string();
    let _served = std::thread::spawn(move || {
        let source = |t_s: f64| {
            (t_s < 9.0).then_some(SimulatedReading {
                reading_mm: 0.25,
                strobe: false,
                valid: true,
                temperature_c: 20.0,
            })
        };
        bar::serve_bar(
            terminal,
            &exact,
            VirtualBarOptions { rate_hz: 100.0, speed: 1.0, first_ticks: 0 },
            source,
        )
    });
    let run = directory.path().join("run");
    let output = Command::new(env!("CARGO_BIN_EXE_dbbd"))
        .args(["acquire", "--port", &port, "--protocol", path.to_str().unwrap(), "--param", "gain=2.0"])
        .args(["--out", run.to_str().unwrap(), "--duration", "0.5"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let capture = capture::read_capture(&std::fs::read(&run).unwrap());
    let readings: Vec<f64> = capture.samples().map(|(_, sample)| sample.reading_mm).collect();
    assert!(readings.len() > 10 && readings.iter().all(|mm| *mm == 0.25), "{readings:?}");
    // The capture contains the parameter in force.
    let kept = String::from_utf8(capture.attachment("protocol.toml").unwrap().to_vec()).unwrap();
    assert!(kept.contains("default = 2.0"), "{kept}");
}

#[test]
fn parameters_are_checked() {
    let load = |name: &str, value: &str| {
        ProtocolDefinition::by_name_with("microepsilon-ild1420", &[(name.into(), value.into())]).unwrap()
    };
    assert_eq!(load("range_mm", "10").unwrap().params, [("range_mm".to_owned(), "10.0".to_owned())]);
    let wrong = load("range", "10").unwrap_err();
    assert_eq!(wrong.code().as_str(), "E0310");
    assert_eq!(wrong.values()["known"], "range_mm");
    let wrong = load("range_mm", "-1").unwrap_err();
    assert_eq!((&wrong.values()["least"], &wrong.values()["most"]), (&1.0.into(), &1000.0.into()), "{wrong}");
    for (old, new) in [
        ("len_adds = 3", "len_adds = 4096"),
        ("len_at = 2", "len_at = 4096"),
        ("len_at = 2", "len_at = 2\nlen_bytes = 3"),
    ] {
        let wrong = ProtocolDefinition::from_toml("bar.toml", &OUTSIDE.replace(old, new)).unwrap_err();
        assert_eq!(wrong.code().as_str(), "E0304", "{new}: {wrong}");
    }
    let text = OUTSIDE.replace("${gain}", "${gian}");
    let wrong = ProtocolDefinition::from_toml("bar.toml", &text).unwrap_err();
    let line = text.lines().position(|line| line.contains("gian")).unwrap() + 1;
    assert_eq!((wrong.code().as_str(), wrong.line_number()), ("E0310", line), "{wrong}");
    assert!(wrong.help_line().is_some_and(|help| help.contains("gain")));
}

/// Beyond its stroke a bar sets a flag, or sends the value for no reading.
#[test]
fn readings_beyond_the_stroke_are_invalid() {
    for protocol in ["dbb-cobs-1", "microepsilon-ild1420"] {
        let definition = ProtocolDefinition::by_name(protocol).unwrap().unwrap();
        let out = |_| SimulatedReading { reading_mm: 0.5, strobe: false, valid: false, temperature_c: 20.0 };
        let (capture, code, said) = acquired(&definition, protocol, &[], out);
        let readings = capture.samples().count();
        assert!(capture.samples().all(|(_, sample)| !sample.valid), "{protocol}");
        match protocol {
            "dbb-cobs-1" => assert!(code == Some(3) && readings > 10, "{said}"),
            _ => assert!(code == Some(3) && said.contains(NO_LENGTH), "{said}"),
        }
    }
}

/// A field takes the values of its bits and no others.
#[test]
fn values_that_do_not_fit_are_rejected() {
    let text = OUTSIDE.replace(
        "{ kind = \"bits\", bits = 4, role = \"seq\", modulo = 16 },\n  { kind = \"bits\", bits = 12 },",
        "{ kind = \"uint\", bits = 8, role = \"seq\", modulo = 256 },\n  { kind = \"skip\", bytes = 1 },",
    );
    let definition = ProtocolDefinition::from_toml("outside.toml", &text).unwrap();
    let encoded = |sequence| definition.encoder().encode(&numbered(sequence), &mut Vec::new());
    assert!(encoded(0).is_ok() && encoded(255).is_ok());
    assert_eq!(encoded(256).unwrap_err().code().as_str(), NOT_SENT);
}

/// Records terminated by silence.
#[test]
fn silence_ends_a_frame() {
    let text = entries::ended_by_silence();
    let definition = ProtocolDefinition::from_toml("bar.toml", &text).unwrap();
    let (mut decoder, mut out) = (definition.decoder(), Vec::new());
    let mut frame = vec![0, 0, 0, 7, 0, 0x3f, 0xe0, 0, 0, 0, 0, 0, 0];
    frame.push(frame[2..].iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte)));
    decoder.push(&frame, &mut out);
    assert_eq!(out, []);
    decoder.idle(&mut out);
    assert!(
        matches!(out[..], [DecodedItem::Sample(Sample { reading_mm: 0.5, sequence: Some(7), .. }, 14)]),
        "{out:?}"
    );
}
