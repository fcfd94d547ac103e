//! The telegrams of the program in a run: whether they are of the plan's program, and when it is over.

use std::collections::VecDeque;
use std::time::Duration;

use super::ekrl::{ChannelEvent, Server};
use super::recorder::Recorder;
use super::schedule::{Schedule, Stranger};
use crate::base::clock;
use crate::base::units::HostNs;
use crate::diagnostic::Diagnostic;
use crate::recording::Telegram;
use crate::recording::capture::Event;

/// The channel of a run.
pub(super) struct Telegrams {
    server: Server,
    schedule: Schedule,
    waiting: VecDeque<(HostNs, ChannelEvent)>,
    /// Whether the plan's last dwell is over.
    last_over: bool,
    closed: bool,
}

/// What the bar sent before a telegram is recorded before it, if it comes within this.
const BEFORE_S: f64 = 0.02;

impl Telegrams {
    pub(super) fn new(server: Server, schedule: Schedule) -> Self {
        Self { server, schedule, waiting: VecDeque::new(), last_over: false, closed: false }
    }

    /// How long the bar may be waited for while telegrams may come.
    pub(super) const PATIENCE: Duration = Duration::from_millis(4);

    /// Records and answers what came; all of it where the line is idle: nothing of the bar is waiting to be recorded.
    pub(super) fn step(&mut self, recorder: &mut Recorder, line: Line) -> Result<(), Diagnostic> {
        while let Some(event) = self.server.next() {
            self.waiting.push_back(event);
        }
        let now = clock::now();
        while let Some((host, event)) =
            self.waiting.pop_front_if(|(host, _)| line == Line::Idle || now.seconds_since(*host) > BEFORE_S)
        {
            match event {
                ChannelEvent::Telegram(telegram, answer) => {
                    let id = self.telegram(recorder, host, &telegram)?;
                    // A client that did not wait for it is gone.
                    let _ = answer.send(id);
                }
                ChannelEvent::Remark(text) => recorder.event(host, Event::Mark { text })?,
                ChannelEvent::Quiet => self.closed = self.last_over,
            }
        }
        Ok(())
    }

    /// Records a telegram of the plan's program; the `Id` to answer with.
    fn telegram(
        &mut self,
        recorder: &mut Recorder,
        host: HostNs,
        telegram: &Telegram,
    ) -> Result<u32, Diagnostic> {
        let Telegram { run, index, phase, axes_deg } = *telegram;
        if let Some(stranger) = self.schedule.stranger(telegram) {
            let why = match stranger {
                Stranger::Run { expected } => {
                    format!("it is of run {run}, the plan's program is run {expected}")
                }
                Stranger::NoDwell => format!("row {index} of the plan is no dwell"),
            };
            recorder.progress.refused += 1;
            recorder.event(host, Event::Mark { text: format!("EthernetKRL: refused a telegram: {why}") })?;
            return Ok(0);
        }
        recorder.progress.telegrams += 1;
        if phase == 2 {
            recorder.progress.dwells += 1;
            self.last_over |= self.schedule.is_last(index);
        }
        recorder.event(host, Event::Controller { index, phase, axes_deg })?;
        Ok(index)
    }

    /// Whether the program has reported its last dwell and closed the channel.
    pub(super) fn over(&self) -> bool {
        self.closed
    }
}

/// Whether bytes of the bar are waiting to be recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Line {
    Busy,
    Idle,
}
