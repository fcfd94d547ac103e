//! The test vectors of a definition: bytes and what they must decode to.

use toml::Spanned;

use crate::protocol::ProtocolFinding::{VectorDiffers, VectorDoesNotSurvive, VectorHasMore, VectorHex};
use crate::protocol::decoder::DecodedItem;
use crate::protocol::definition::ProtocolDefinition;
use crate::protocol::fault::{LineFault, LineFaultKind};
use crate::protocol::layout;
use crate::protocol::source::DefinitionSource;
use crate::protocol::source::hex_bytes;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;
use serde::Deserialize;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TestTable {
    rx: Spanned<String>,
    expect: Vec<Spanned<Expectation>>,
}

/// Expected result of test bytes: a sample, a reject, or skipped bytes.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Expectation {
    seq: Option<u32>,
    t_dev_us: Option<u64>,
    length_mm: Option<f64>,
    tol: Option<f64>,
    temp_c: Option<f64>,
    flags: Option<Vec<String>>,
    reject: Option<String>,
    resync: Option<u64>,
    ignored: Option<u64>,
}

pub(super) fn run(
    source: &DefinitionSource,
    definition: &ProtocolDefinition,
    test: &Spanned<TestTable>,
) -> Result<(), Diagnostic> {
    let TestTable { rx, expect } = test.get_ref();
    let bytes = hex_bytes(rx.get_ref()).ok_or_else(|| source.wrong(rx.span(), VectorHex))?;
    let mut out = Vec::new();
    let mut decoder = definition.decoder();
    decoder.push(&bytes, &mut out);
    // No more bytes follow.
    decoder.interrupt(&mut out);
    for (at, expectation) in expect.iter().enumerate() {
        let got = out.get(at).map_or("nothing".into(), |decoded| describe(definition, decoded, &bytes));
        let met = out.get(at).is_some_and(|decoded| meets(definition, decoded, expectation.get_ref()));
        if !met {
            return Err(source.wrong(expectation.span(), VectorDiffers { got }));
        }
    }
    if let Some(more) = out.get(expect.len()) {
        let more = describe(definition, more, &bytes);
        return Err(source.wrong(rx.span(), VectorHasMore { got: more }));
    }
    for decoded in &out {
        if let DecodedItem::Sample(sample, _) = decoded
            && !survives(definition, sample)
        {
            return Err(source.wrong(rx.span(), VectorDoesNotSurvive));
        }
    }
    Ok(())
}

/// Whether the sample survives encoding and decoding; a reading in another unit is rounded once.
fn survives(definition: &ProtocolDefinition, sample: &Sample) -> bool {
    let Some(again) = round_trip(definition, sample) else { return false };
    let same = Sample { reading_mm: sample.reading_mm, ..again } == *sample;
    let near = (again.reading_mm - sample.reading_mm).abs() <= 0.5001 * definition.resolution_mm();
    same && near && round_trip(definition, &again) == Some(again)
}

/// The sample, encoded and decoded, with its own offset.
fn round_trip(definition: &ProtocolDefinition, sample: &Sample) -> Option<Sample> {
    let mut bytes = Vec::new();
    definition.encoder().encode(sample, &mut bytes).ok()?;
    let mut out = Vec::new();
    let mut decoder = definition.decoder();
    decoder.push(&bytes, &mut out);
    decoder.idle(&mut out);
    match &out[..] {
        [DecodedItem::Sample(again, _)] => Some(Sample { offset: sample.offset, ..*again }),
        _ => None,
    }
}

fn meets(definition: &ProtocolDefinition, decoded: &DecodedItem, expected: &Expectation) -> bool {
    let of_sample = expected.seq.is_some()
        || expected.t_dev_us.is_some()
        || expected.length_mm.is_some()
        || expected.temp_c.is_some()
        || expected.flags.is_some();
    let of_fault = (expected.reject.as_ref(), expected.resync, expected.ignored);
    match decoded {
        DecodedItem::Sample(sample, _) => {
            let tolerance = expected.tol.unwrap_or(0.0);
            let device_us = || {
                let tick_ns = definition.clock.map_or(0, |clock| u64::from(clock.tick_ns));
                sample.ticks.and_then(|ticks| ticks.0.checked_mul(tick_ns)).map(|ns| ns / 1000)
            };
            of_sample
                && of_fault == (None, None, None)
                && expected.seq.is_none_or(|seq| sample.sequence == Some(seq))
                && expected.t_dev_us.is_none_or(|us| device_us() == Some(us))
                && expected.length_mm.is_none_or(|mm| (sample.reading_mm - mm).abs() <= tolerance)
                && expected.temp_c.is_none_or(|c| sample.temperature_c == Some(c))
                && expected.flags.as_ref().is_none_or(|flags| definition.flags(sample.status) == *flags)
        }
        DecodedItem::Fault(LineFault { kind, bytes, .. }) => {
            let fault = match kind {
                LineFaultKind::Reject(word) => (Some(word), None, None),
                LineFaultKind::Ignored => (None, None, Some(*bytes)),
                LineFaultKind::Framing
                | LineFaultKind::Check
                | LineFaultKind::TooLong
                | LineFaultKind::OtherUnit
                | LineFaultKind::Content => (None, Some(*bytes), None),
            };
            !of_sample && of_fault == fault
        }
    }
}

/// What was decoded from `rx`, in the words of a test.
fn describe(definition: &ProtocolDefinition, decoded: &DecodedItem, rx: &[u8]) -> String {
    match decoded {
        DecodedItem::Sample(sample, _) => {
            let flags = definition.flags(sample.status);
            format!("length_mm = {}, seq {:?}, flags {flags:?}", sample.reading_mm, sample.sequence)
        }
        DecodedItem::Fault(LineFault { kind: LineFaultKind::Reject(word), .. }) => {
            format!("reject = \"{word}\"")
        }
        DecodedItem::Fault(LineFault { kind: LineFaultKind::Ignored, bytes, .. }) => {
            format!("ignored = {bytes}")
        }
        DecodedItem::Fault(LineFault { kind, bytes, offset, .. }) => {
            let frame = rx.get(*offset as usize..(*offset + *bytes) as usize).unwrap_or_default();
            let is_content = *kind == LineFaultKind::Content;
            let mismatch = is_content.then(|| layout::mismatch(&definition.engine, frame)).flatten();
            let mismatch = mismatch.map_or(String::new(), |mismatch| format!(": {mismatch}"));
            format!("resync = {bytes} ({kind:?}){mismatch}")
        }
    }
}
