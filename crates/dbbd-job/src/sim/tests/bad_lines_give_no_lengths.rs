//! A bad line loses frames and never invents lengths: the campaign over `dbb-cobs-1`.

use dbbd_device::protocol::{DecodedItem, ProtocolDefinition};
use dbbd_job::sim::fault::{FaultyLine, InjectedFaults};
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;

/// Result of a campaign.
#[derive(Debug, Default, PartialEq)]
struct Tally {
    frames: u64,
    bytes: u64,
    /// Frames that were decoded undamaged, after an undamaged delimiter.
    intact: u64,
    recovered: u64,
    /// Samples that were not sent.
    made_up: u64,
}

/// The content of a frame identifies its number, so an invented frame is detected.
fn sample(frame: u64) -> Sample {
    let mixed = frame.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    Sample {
        sequence: Some((frame % 65536) as u32),
        ticks: Some(DeviceTicks((frame * 1000) % (1 << 32))),
        trigger: Some(mixed & 1 == 1),
        temperature_c: Some(f64::from((mixed >> 8) as u16 % 5000) / 100.0),
        status: if mixed & 1 == 1 { 17 } else { 1 },
        ..Sample::of(((mixed >> 40) as f64 - 8e6) / 1e5)
    }
}

fn campaign(frames: u64, faults: InjectedFaults, seed: u64) -> Tally {
    let definition = ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap();
    let (encoder, mut decoder) = (definition.encoder(), definition.decoder());
    let mut line = FaultyLine::new(faults, seed);
    let mut tally = Tally { frames, ..Tally::default() };
    let (mut out, mut accounted) = (Vec::new(), 0);
    let (mut clean, mut carried) = (Vec::new(), Vec::new());
    let mut behind_delimiter = true;
    let mut next = 0u64;
    for frame in 0..frames {
        clean.clear();
        encoder.encode(&sample(frame), &mut clean).unwrap();
        carried.clear();
        carried.extend_from_slice(&clean);
        line.carry(&mut carried);
        let intact = behind_delimiter && carried == clean;
        behind_delimiter = carried.last() == Some(&0);
        tally.bytes += carried.len() as u64;
        tally.intact += u64::from(intact);
        decoder.push(&carried, &mut out);
        let mut seen = false;
        for decoded in out.drain(..) {
            accounted += decoded.bytes();
            if let DecodedItem::Sample(got, _) = decoded {
                // This frame, or one before it that a damaged delimiter held back.
                let sent = (next..=frame).rev().find(|sent| sample(*sent) == Sample { offset: 0, ..got });
                match sent {
                    Some(sent) => {
                        next = sent + 1;
                        seen |= sent == frame;
                    }
                    None => tally.made_up += 1,
                }
            }
        }
        next = next.max(frame.saturating_sub(4));
        tally.recovered += u64::from(intact && seen);
    }
    assert_eq!(accounted + decoder.pending(), tally.bytes, "every byte is accounted for");
    tally
}

fn rates() -> Vec<InjectedFaults> {
    // A bit error rate b spoils a byte with probability 8 b.
    let bits =
        [1e-5, 1e-4, 1e-3, 1e-2].map(|rate| InjectedFaults { flip: 8.0 * rate, ..InjectedFaults::default() });
    let bytes = [
        InjectedFaults { drop: 1e-3, ..InjectedFaults::default() },
        InjectedFaults { insert: 1e-3, double: 1e-3, ..InjectedFaults::default() },
    ];
    bits.into_iter().chain(bytes).collect()
}

fn holds(frames: u64, seed: u64) {
    for faults in rates() {
        let tally = campaign(frames, faults, seed);
        eprintln!("{faults:?}\n  {tally:?}");
        assert_eq!(tally.recovered, tally.intact, "{faults:?}");
        let damaged = (tally.frames - tally.recovered) as f64;
        // A 16-bit check lets 2^-16 of damaged frames pass at most; four standard deviations.
        let expected = damaged / 65536.0;
        assert!(tally.made_up as f64 <= expected + 4.0 * expected.sqrt() + 0.5, "{faults:?}: {tally:?}");
    }
}

#[test]
fn bad_line_invents_no_length() {
    holds(20_000, 1);
}

/// cargo test --release bad_lines -- --ignored --nocapture
#[test]
#[ignore = "ten million frames at each of six rates"]
fn ten_million_frames_make_nothing_up() {
    holds(10_000_000, 7);
}
