//! The bar that is read without a run: connect, zero, and what the operator did before the run.

use std::sync::atomic::Ordering;

use super::begin::Aim;
use super::log::Level;
use super::state::{Run, Running, Supervisor};
use crate::base::clock;
use crate::catalogue::ServiceFinding::{
    Ending, NoPortChosen, NoZeroCommand, NotRead, RunIsOn, RunIsStarting,
};
use crate::daemon::session;
use crate::diagnostic::Diagnostic;
use crate::recording::capture::Event;

/// Notes that are kept until a run begins; the oldest go.
const MOST_NOTES: usize = 100;

impl Supervisor {
    /// Takes the place of the run, which is free or holds a reading; that ends.
    pub(super) fn take_place(&self) -> Result<Option<Running>, Diagnostic> {
        let mut inner = self.inner();
        if inner.ending {
            return Err(Ending.into());
        }
        match std::mem::replace(&mut inner.run, Run::Starting) {
            Run::None => Ok(None),
            Run::Reading(running) => Ok(Some(*running)),
            taken @ (Run::On(_) | Run::Starting) => {
                let refusal = if matches!(taken, Run::On(_)) { RunIsOn } else { RunIsStarting };
                inner.run = taken;
                Err(refusal.into())
            }
        }
    }

    /// Gives the place to a reading, or frees it.
    fn give_place(&self, begun: Result<Option<Running>, Diagnostic>) -> Result<(), Diagnostic> {
        let (run, refusal) = match begun {
            Ok(running) => (running.map_or(Run::None, |running| Run::Reading(Box::new(running))), None),
            Err(refusal) => (Run::None, Some(refusal)),
        };
        self.inner().run = run;
        self.tick();
        refusal.map_or(Ok(()), Err)
    }

    pub(super) fn read(&self, plan: Option<String>) -> Result<(), Diagnostic> {
        let before = self.take_place()?;
        let detail = plan.clone().unwrap_or_default();
        if let Some(before) = before {
            before.end();
        }
        let (port, protocol) = {
            let inner = self.inner();
            (inner.port.clone(), inner.protocol.clone())
        };
        let begun = match port {
            Some(port) => self.begin(Aim::Reading { plan }, port, protocol),
            None => Err(NoPortChosen.into()),
        };
        self.give_place(begun.map(Some))?;
        self.note("connect", &detail);
        Ok(())
    }

    pub(super) fn end_reading(&self) -> Result<(), Diagnostic> {
        let before = self.take_place()?;
        let read = before.is_some();
        if let Some(before) = before {
            before.end();
        }
        self.give_place(Ok(None))?;
        if read {
            self.note("disconnect", "");
        }
        Ok(())
    }

    /// Sets the reading to zero: the line is the command's alone meanwhile.
    pub(super) fn set_zero(&self) -> Result<(), Diagnostic> {
        let Some(running) = self.take_place()? else {
            self.give_place(Ok(None))?;
            return Err(NotRead.into());
        };
        let definition = running.definition.clone();
        if definition.zero.is_empty() {
            self.give_place(Ok(Some(running)))?;
            return Err(NoZeroCommand { protocol: definition.id }.into());
        }
        let Running { plan, line, acquisition, stop, .. } = running;
        let before_mm = acquisition.progress().reading_mm;
        stop.store(true, Ordering::Relaxed);
        let zeroed = acquisition.join().and_then(|_| Ok(session::zero(&line.port, &definition)?));
        self.give_place(self.open(Aim::Reading { plan }, line).map(Some))?;
        zeroed?;
        self.note("zero", &before_mm.map_or(String::new(), |mm| format!("{mm:.4} mm before")));
        Ok(())
    }

    /// Notes what the operator did: in the log, and in the capture of the run that is on or of the next one.
    pub(super) fn note(&self, action: &str, detail: &str) {
        self.log.say(Level::Info, "operator", &[("action", &action), ("detail", &detail)]);
        let unix_ms = clock::unix_ns() / 1_000_000;
        let event = Event::Operator { unix_ms, action: action.into(), detail: detail.into() };
        let mut inner = self.inner();
        match &inner.run {
            Run::On(running) => running.acquisition.note(event),
            _ => {
                if inner.notes.len() >= MOST_NOTES {
                    inner.notes.remove(0);
                }
                inner.notes.push(event);
            }
        }
    }
}

impl Running {
    /// Ends it and waits for that; how a reading without a run ended is nobody's matter.
    pub(super) fn end(self) {
        self.stop.store(true, Ordering::Relaxed);
        let _ = self.acquisition.join();
    }
}
