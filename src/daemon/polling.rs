//! Asks a polled device for its readings, one at a time.

use std::time::Duration;

use super::recorder::Recorder;
use super::session;
use crate::base::clock;
use crate::base::units::HostNs;
use crate::catalogue::PortFinding;
use crate::device::port::Port;
use crate::device::protocol::Definition;
use crate::diagnostic::Diagnostic;

/// When the next request is due, and what the last one waits for.
pub(super) struct Polling {
    port: Port,
    period_s: f64,
    timeout_s: f64,
    /// The request that is not answered yet.
    asked: Option<HostNs>,
    last: Option<HostNs>,
}

impl Polling {
    pub(super) fn new(port: Port, hz: f64, timeout: Duration) -> Self {
        Self { port, period_s: 1.0 / hz, timeout_s: timeout.as_secs_f64(), asked: None, last: None }
    }

    /// The reply to the request has come.
    pub(super) fn answered(&mut self) {
        self.asked = None;
    }

    /// Sends a request if one is due; how long until there is something to do again. A reply that
    /// stays out is counted, and what came of it is no part of the next one.
    pub(super) fn step(
        &mut self,
        definition: &Definition,
        recorder: &mut Recorder,
    ) -> Result<Result<Duration, PortFinding>, Diagnostic> {
        let now = clock::now();
        let left = |since: HostNs, span: f64| span - now.seconds_since(since);
        let wait = match (self.asked, self.last) {
            (Some(asked), _) if left(asked, self.timeout_s) > 0.0 => left(asked, self.timeout_s),
            (None, Some(last)) if left(last, self.period_s) > 0.0 => left(last, self.period_s),
            (unanswered, _) => {
                if unanswered.is_some() {
                    recorder.unanswered(now)?;
                }
                recorder.requested(clock::now());
                if let Err(gone) = session::ask(&mut self.port, definition) {
                    return Ok(Err(gone));
                }
                (self.asked, self.last) = (Some(now), Some(now));
                self.timeout_s.min(self.period_s)
            }
        };
        Ok(Ok(Duration::from_secs_f64(wait.clamp(0.0, 1.0))))
    }
}
