//! Commands: what is sent to the device, and what it must answer.

use std::time::Duration;

use super::vectors;
use crate::catalogue::ProtocolFinding::{
    self, StepActions, StepCheck, StepExpect, StepHex, StepSendsNothing,
};
use crate::device::protocol::check::Check;
use crate::device::protocol::definition::Step;
use crate::device::protocol::table::StepTable;

/// Checks a step of a command and compiles it.
pub(super) fn compile(step: &StepTable, check: Option<&Check>) -> Result<Step, ProtocolFinding> {
    let duration = |ms: u32| Duration::from_millis(ms.into());
    let mut bytes = match step {
        StepTable {
            send: Some(text), hex: None, wait_ms: None, drain_ms: None, dtr_pulse_ms: None, ..
        } => text.clone().into_bytes(),
        StepTable {
            send: None, hex: Some(hex), wait_ms: None, drain_ms: None, dtr_pulse_ms: None, ..
        } => vectors::bytes(hex).ok_or(StepHex)?,
        StepTable { send: None, hex: None, wait_ms, drain_ms, dtr_pulse_ms, .. } => {
            let action = match (wait_ms, drain_ms, dtr_pulse_ms) {
                (Some(ms), None, None) => Step::Wait(duration(*ms)),
                (None, Some(ms), None) => Step::Drain(duration(*ms)),
                (None, None, Some(ms)) => Step::DtrPulse(duration(*ms)),
                _ => return Err(StepActions),
            };
            return match (step.check || step.expect.is_some(), step.timeout_ms, step.retries) {
                (true, ..) => Err(StepSendsNothing),
                (false, None, None) => Ok(action),
                _ => Err(StepExpect),
            };
        }
        _ => return Err(StepActions),
    };
    if bytes.is_empty() && (step.check || step.expect.is_some()) {
        return Err(StepSendsNothing);
    }
    if step.check {
        check.ok_or(StepCheck)?.append(&mut bytes);
    }
    match (&step.expect, step.timeout_ms, step.retries) {
        (Some(expect), Some(timeout @ 1..), retries) if !expect.is_empty() => Ok(Step::Ask {
            send: bytes,
            expect: expect.clone().into_bytes(),
            timeout: duration(timeout),
            retries: retries.unwrap_or(0),
        }),
        (None, None, None) => Ok(Step::Send(bytes)),
        _ => Err(StepExpect),
    }
}
