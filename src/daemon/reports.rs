//! What the telegrams of the program mean for a run: whether they are the plan's, and when it is over.

use std::collections::{BTreeSet, VecDeque};
use std::time::Duration;

use super::ekrl::{Server, Told};
use super::recorder::Recorder;
use crate::capture::{Event, WriteError};
use crate::clock;
use crate::sync::Telegram;
use crate::units::HostNs;

/// The dwells of a plan and the number of its program, by which a telegram of another one is known.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Driven {
    /// The number that the program gives in `Run`.
    pub run: Option<u32>,
    /// The plan's indices of the dwells.
    pub dwells: BTreeSet<u32>,
}

/// The channel of a run.
pub(super) struct Reports {
    server: Server,
    plan: Option<Driven>,
    waiting: VecDeque<(HostNs, Told)>,
    /// Whether the plan's last dwell is over.
    last_over: bool,
    closed: bool,
}

/// What the bar sent before a telegram is recorded before it, if it comes within this.
const BEFORE_S: f64 = 0.02;

impl Reports {
    pub(super) fn new(server: Server, plan: Option<Driven>) -> Self {
        Self { server, plan, waiting: VecDeque::new(), last_over: false, closed: false }
    }

    /// How long the bar may be waited for while telegrams may come.
    pub(super) const PATIENCE: Duration = Duration::from_millis(4);

    /// Records and answers what was told; `idle` when nothing of the bar is waiting to be recorded.
    pub(super) fn step(&mut self, recorder: &mut Recorder, idle: bool) -> Result<(), WriteError> {
        while let Some(told) = self.server.told() {
            self.waiting.push_back(told);
        }
        let now = clock::now();
        while let Some((host, told)) =
            self.waiting.pop_front_if(|(host, _)| idle || now.seconds_since(*host) > BEFORE_S)
        {
            match told {
                Told::Telegram(telegram, answer) => {
                    let id = self.telegram(recorder, host, &telegram)?;
                    // A client that did not wait for it is gone.
                    let _ = answer.send(id);
                }
                Told::Remark(text) => recorder.event(host, Event::Mark { text })?,
                Told::Quiet => self.closed = self.last_over,
            }
        }
        Ok(())
    }

    /// Records a telegram that is the plan's; the `Id` to answer with.
    fn telegram(
        &mut self,
        recorder: &mut Recorder,
        host: HostNs,
        telegram: &Telegram,
    ) -> Result<u32, WriteError> {
        let Telegram { index, phase, axes_deg, .. } = *telegram;
        if let Some(why) = self.objection(telegram) {
            recorder.progress.refused += 1;
            recorder.event(host, Event::Mark { text: format!("EthernetKRL: refused a telegram: {why}") })?;
            return Ok(0);
        }
        recorder.progress.telegrams += 1;
        if phase == 2 {
            recorder.progress.dwells += 1;
            self.last_over |= self.plan.as_ref().is_some_and(|plan| plan.dwells.last() == Some(&index));
        }
        recorder.event(host, Event::Controller { index, phase, axes_deg })?;
        Ok(index)
    }

    fn objection(&self, telegram: &Telegram) -> Option<String> {
        let plan = self.plan.as_ref()?;
        if let Some(run) = plan.run.filter(|run| *run != telegram.run) {
            return Some(format!("it is of run {}, the plan's program is run {run}", telegram.run));
        }
        (!plan.dwells.contains(&telegram.index))
            .then(|| format!("row {} of the plan is no dwell", telegram.index))
    }

    /// Whether the program has told its last dwell and closed the channel.
    pub(super) fn over(&self) -> bool {
        self.closed
    }
}
