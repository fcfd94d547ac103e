//! Commands: what is sent to the device, and what it must answer.

use std::time::Duration;

use toml::Spanned;

use super::source::Source;
use super::vectors;
use crate::diag::Diagnostic;
use crate::protocol::check::Check;
use crate::protocol::definition::Step;
use crate::protocol::table::StepTable;

/// Checks a step of a command and compiles it.
pub(super) fn compile(
    source: Source,
    table: &Spanned<StepTable>,
    check: Option<&Check>,
) -> Result<Step, Diagnostic> {
    let wrong = |message: &str| Err(source.wrong(table.span(), message));
    let duration = |ms: u32| Duration::from_millis(ms.into());
    let step = table.get_ref();
    let kinds = [
        step.send.is_some(),
        step.hex.is_some(),
        step.wait_ms.is_some(),
        step.drain_ms.is_some(),
        step.dtr_pulse_ms.is_some(),
    ];
    if kinds.iter().filter(|given| **given).count() != 1 {
        return wrong("a step has exactly one of send, hex, wait_ms, drain_ms, dtr_pulse_ms");
    }
    let mut bytes = match (&step.send, &step.hex) {
        (Some(text), _) => text.clone().into_bytes(),
        (_, Some(hex)) => match vectors::bytes(hex) {
            Some(bytes) => bytes,
            None => return wrong("hex is not pairs of hexadecimal digits"),
        },
        _ => Vec::new(),
    };
    if bytes.is_empty() && (step.check || step.expect.is_some()) {
        return wrong("`check` and `expect` belong to a step that sends");
    }
    if step.check {
        match check {
            Some(check) => check.append(&mut bytes),
            None => return wrong("`check` needs a [check]"),
        }
    }
    match (&step.expect, step.timeout_ms, step.retries) {
        (Some(expect), Some(timeout @ 1..), retries) if !expect.is_empty() => {
            return Ok(Step::Ask {
                send: bytes,
                expect: expect.clone().into_bytes(),
                timeout: duration(timeout),
                retries: retries.unwrap_or(0),
            });
        }
        (None, None, None) => {}
        _ => return wrong("`expect` needs `timeout_ms`, and they belong together"),
    }
    Ok(match (step.wait_ms, step.drain_ms, step.dtr_pulse_ms) {
        (Some(ms), ..) => Step::Wait(duration(ms)),
        (_, Some(ms), _) => Step::Drain(duration(ms)),
        (_, _, Some(ms)) => Step::DtrPulse(duration(ms)),
        _ => Step::Send(bytes),
    })
}
