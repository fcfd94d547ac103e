//! A definition's own tests: bytes and what they must give. A definition that fails one is refused.

use toml::Spanned;

use super::Source;
use crate::catalogue::ProtocolFinding::{VectorDiffers, VectorDoesNotSurvive, VectorHasMore, VectorHex};
use crate::device::protocol::decoder::Decoded;
use crate::device::protocol::definition::Definition;
use crate::device::protocol::fault::{Fault, FaultKind};
use crate::device::protocol::table::{Expectation, TestTable};
use crate::diagnostic::Diagnostic;
use crate::measurement::sample::Sample;

/// Bytes of pairs of hexadecimal digits; white space between them is free.
pub(super) fn bytes(hex: &str) -> Option<Vec<u8>> {
    let digits: Option<Vec<u8>> = hex
        .chars()
        .filter(|c| !c.is_whitespace())
        .map(|c| c.to_digit(16).and_then(|digit| u8::try_from(digit).ok()))
        .collect();
    let digits = digits.filter(|digits| digits.len().is_multiple_of(2))?;
    Some(digits.chunks_exact(2).map(|pair| 16 * pair[0] + pair[1]).collect())
}

pub(super) fn run(
    source: Source,
    definition: &Definition,
    test: &Spanned<TestTable>,
) -> Result<(), Diagnostic> {
    let TestTable { rx, expect } = test.get_ref();
    let bytes = bytes(rx.get_ref()).ok_or_else(|| source.wrong(rx.span(), VectorHex))?;
    let mut out = Vec::new();
    let mut decoder = definition.decoder();
    decoder.push(&bytes, &mut out);
    // What does not end within the test's bytes is not to come.
    decoder.interrupt(&mut out);
    for (at, expectation) in expect.iter().enumerate() {
        let got = out.get(at).map_or("nothing".into(), |decoded| describe(definition, decoded));
        let met = out.get(at).is_some_and(|decoded| meets(definition, decoded, expectation.get_ref()));
        if !met {
            return Err(source.wrong(expectation.span(), VectorDiffers { got }));
        }
    }
    if let Some(more) = out.get(expect.len()) {
        let more = describe(definition, more);
        return Err(source.wrong(rx.span(), VectorHasMore { got: more }));
    }
    for decoded in &out {
        if let Decoded::Sample(sample, _) = decoded
            && !survives(definition, sample)
        {
            return Err(source.wrong(rx.span(), VectorDoesNotSurvive));
        }
    }
    Ok(())
}

/// Whether the sample can be written and read; what was sent in another unit is rounded once.
fn survives(definition: &Definition, sample: &Sample) -> bool {
    let Some(again) = round_trip(definition, sample) else { return false };
    let same = Sample { reading_mm: sample.reading_mm, ..again } == *sample;
    let near = (again.reading_mm - sample.reading_mm).abs() <= 0.5001 * definition.resolution_mm();
    same && near && round_trip(definition, &again) == Some(again)
}

/// The sample encoded and decoded again, at its own offset.
fn round_trip(definition: &Definition, sample: &Sample) -> Option<Sample> {
    let mut bytes = Vec::new();
    definition.encoder().encode(sample, &mut bytes).ok()?;
    let mut out = Vec::new();
    let mut decoder = definition.decoder();
    decoder.push(&bytes, &mut out);
    decoder.silence(&mut out);
    match &out[..] {
        [Decoded::Sample(again, _)] => Some(Sample { offset: sample.offset, ..*again }),
        _ => None,
    }
}

fn meets(definition: &Definition, decoded: &Decoded, expected: &Expectation) -> bool {
    let of_sample = expected.seq.is_some()
        || expected.t_dev_us.is_some()
        || expected.length_mm.is_some()
        || expected.temp_c.is_some()
        || expected.flags.is_some();
    match (decoded, expected) {
        (Decoded::Sample(sample, _), Expectation { reject: None, resync: None, ignored: None, .. }) => {
            let tolerance = expected.tol.unwrap_or(0.0);
            let device_us = || {
                let tick_ns = definition.clock.map_or(0, |clock| u64::from(clock.tick_ns));
                sample.ticks.and_then(|ticks| ticks.0.checked_mul(tick_ns)).map(|ns| ns / 1000)
            };
            of_sample
                && expected.seq.is_none_or(|seq| sample.sequence == Some(seq))
                && expected.t_dev_us.is_none_or(|us| device_us() == Some(us))
                && expected.length_mm.is_none_or(|mm| (sample.reading_mm - mm).abs() <= tolerance)
                && expected.temp_c.is_none_or(|c| sample.temperature_c == Some(c))
                && expected.flags.as_ref().is_none_or(|flags| definition.flags(sample.status) == *flags)
        }
        (Decoded::Fault(_), _) if of_sample => false,
        (
            Decoded::Fault(Fault { kind: FaultKind::Reject(word), .. }),
            Expectation { reject: Some(expected), resync: None, ignored: None, .. },
        ) => word == expected,
        (
            Decoded::Fault(Fault { kind: FaultKind::Ignored, bytes, .. }),
            Expectation { reject: None, resync: None, ignored: Some(expected), .. },
        ) => bytes == expected,
        (
            Decoded::Fault(Fault { kind, bytes, .. }),
            Expectation { reject: None, resync: Some(expected), ignored: None, .. },
        ) => !matches!(kind, FaultKind::Reject(_) | FaultKind::Ignored) && bytes == expected,
        _ => false,
    }
}

fn describe(definition: &Definition, decoded: &Decoded) -> String {
    match decoded {
        Decoded::Sample(sample, _) => {
            let flags = definition.flags(sample.status);
            format!("length_mm = {}, seq {:?}, flags {flags:?}", sample.reading_mm, sample.sequence)
        }
        Decoded::Fault(Fault { kind: FaultKind::Reject(word), .. }) => format!("reject = \"{word}\""),
        Decoded::Fault(Fault { kind: FaultKind::Ignored, bytes, .. }) => format!("ignored = {bytes}"),
        Decoded::Fault(Fault { kind, bytes, .. }) => format!("resync = {bytes} ({kind:?})"),
    }
}
