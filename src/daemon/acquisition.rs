//! A run: reading thread -> bounded channel -> recorder, until something ends it.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::Serialize;

use super::axes::{AxesArrival, AxesSource};
use super::ekrl::Server;
use super::live_state::Feed;
use super::polling::Polling;
use super::progress::Progress;
use super::recorder::Recorder;
use super::schedule::{ALARM_SHARE, Schedule};
use super::session::{self, Opened};
use super::telegrams::{Line, Telegrams};
use crate::base::sync::lock;
use crate::base::units::HostNs;
use crate::base::{clock, serialised};
use crate::catalogue::{RecordingFinding, ServiceFinding};
use crate::device::port::{self, Arrival, Port, PortAddress, Reader};
use crate::device::protocol::{Definition, Mode};
use crate::diagnostic::Diagnostic;
use crate::provenance::{self, Identity};
use crate::recording::capture::{Event, Writer};
use crate::recording::run::{ATTACHED_IDENTITY, PlanFiles};

/// Longest wait between two attempts to open a port that went away, s.
const LONGEST_BACKOFF_S: f64 = 0.5;

/// The lines to the controller beside the bar's.
#[derive(Debug, Default)]
pub struct Lines {
    /// The program reports its dwells here.
    pub ekrl: Option<Server>,
    /// The controller publishes its axes here.
    pub axes: Option<AxesSource>,
}

/// What a run is to do.
#[derive(Debug)]
pub struct Options {
    pub port: PortAddress,
    pub definition: Definition,
    /// The capture to write.
    pub out: PathBuf,
    /// The plan that the robot executes; the capture carries its files.
    pub plan: Option<PlanFiles>,
    /// What is stated of this run beside its plan.
    pub identity: Identity,
    /// Ends the run after so many seconds of host time.
    pub duration_s: Option<f64>,
    /// Ends the run when the port has been away for so many seconds.
    pub gone_s: f64,
    /// Shows the run to those who look on.
    pub feed: Option<Feed>,
    /// How often the disk is made to hold what was written, s: what a loss of power costs at most.
    pub sync_s: f64,
}

/// What ended a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// The program's end mark.
    Mark,
    /// The time was up.
    Duration,
    Stopped,
    /// The port stayed away.
    Gone,
}

/// A run that is over.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The capture: another than was asked for where that was taken away.
    pub capture: PathBuf,
    /// What ended it.
    pub ending: Ending,
    /// Its last counts.
    pub progress: Progress,
}

/// A run that goes on in a thread of its own.
pub struct Acquisition {
    shared: Arc<Shared>,
    recorder: JoinHandle<Result<Summary, Diagnostic>>,
}

struct Shared {
    progress: Mutex<Progress>,
    /// What others say that is to be written.
    notes: Mutex<Vec<Event>>,
    /// What others did to the capture.
    findings: Mutex<Vec<Diagnostic>>,
    stop: Arc<AtomicBool>,
}

impl Ending {
    pub fn reason(self) -> &'static str {
        match self {
            Ending::Mark => "the program's end mark",
            Ending::Duration => "the time was up",
            Ending::Stopped => "stopped",
            Ending::Gone => "the port stayed away",
        }
    }
}

impl Acquisition {
    /// Opens the port, makes the capture and begins. The run ends early when `stop` is raised.
    ///
    /// # Errors
    /// When the port cannot be opened or the capture not be made.
    pub fn start(options: Options, stop: Arc<AtomicBool>) -> Result<Self, Diagnostic> {
        Self::start_with(Lines::default(), options, stop)
    }

    /// The same with lines to the controller.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_with(lines: Lines, options: Options, stop: Arc<AtomicBool>) -> Result<Self, Diagnostic> {
        if options.out.exists() {
            let name = options.out.display().to_string();
            return Err(Diagnostic::file(&name, RecordingFinding::CaptureExists));
        }
        // The port comes first: without it no file is left behind.
        let opened = session::open(&options.port, &options.definition)?;
        let writer = Writer::create(&options.out)?;
        Self::record(lines, options, opened, writer, stop)
    }

    /// As [`Acquisition::start`], into a capture that was begun elsewhere.
    ///
    /// # Errors
    /// When the port cannot be opened or the capture not be written.
    pub fn start_on(writer: Writer, options: Options, stop: Arc<AtomicBool>) -> Result<Self, Diagnostic> {
        let opened = session::open(&options.port, &options.definition)?;
        Self::record(Lines::default(), options, opened, writer, stop)
    }

    fn record(
        lines: Lines,
        mut options: Options,
        opened: Opened,
        writer: Writer,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, Diagnostic> {
        let began = opened.began;
        let plan = options.plan.take();
        let schedule = plan.as_ref().map(|files| Schedule::of(&files.plan, ALARM_SHARE)).unwrap_or_default();
        let mut recorder =
            Recorder::new(writer, &options.definition, schedule.modules(), options.sync_s, began);
        recorder.feed = options.feed.take();
        let version = provenance::VERSION.to_owned();
        recorder.event(began, Event::Started { unix_ns: clock::unix_ns(), version })?;
        for (name, content) in plan.into_iter().flat_map(PlanFiles::attachments) {
            recorder.attach(began, name, content.as_bytes())?;
        }
        if !options.identity.is_empty() {
            recorder.attach(began, ATTACHED_IDENTITY, serialised::toml(&options.identity)?.as_bytes())?;
        }
        recorder.attach(began, "protocol.toml", options.definition.text.as_bytes())?;
        let port = begin(&mut recorder, &options.port, opened)?;
        let shared = Arc::new(Shared {
            progress: Mutex::default(),
            notes: Mutex::default(),
            findings: Mutex::default(),
            stop,
        });
        let identity = port::identity(&options.port);
        let telegrams = lines.ekrl.map(|server| Telegrams::new(server, schedule));
        let axes = lines.axes;
        let run = Run { options, identity, recorder, telegrams, axes, shared: Arc::clone(&shared), began };
        let recorder = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || run.whole(port))
            .map_err(|error| ServiceFinding::NoSystem { why: error.to_string() })?;
        Ok(Self { shared, recorder })
    }

    /// How it is going.
    pub fn progress(&self) -> Progress {
        *lock(&self.shared.progress)
    }

    /// Writes a remark into the capture.
    pub fn mark(&self, text: String) {
        self.note(Event::Mark { text });
    }

    /// Writes what happened beside the line into the capture.
    pub fn note(&self, event: Event) {
        lock(&self.shared.notes).push(event);
    }

    /// What is to be said of the capture since it was asked for last.
    pub fn findings(&self) -> Vec<Diagnostic> {
        std::mem::take(&mut *lock(&self.shared.findings))
    }

    /// Whether it is over.
    pub fn is_over(&self) -> bool {
        self.recorder.is_finished()
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// When the capture could not be written on.
    pub fn join(self) -> Result<Summary, Diagnostic> {
        self.recorder.join().map_err(|_| ServiceFinding::RecorderDied)?
    }
}

/// Records that the bar was opened, and what came with its start.
fn begin(recorder: &mut Recorder, address: &PortAddress, opened: Opened) -> Result<Port, Diagnostic> {
    let now = clock::now();
    let Opened { port, stale, first, .. } = opened;
    recorder.event(now, Event::Opened { port: address.to_string(), stamps: Some(port.stamps()) })?;
    if stale > 0 {
        let text = format!("{stale} bytes of an earlier stream were thrown away before the start");
        recorder.event(now, Event::Mark { text })?;
    }
    if !first.is_empty() {
        recorder.bytes(now, first)?;
    }
    Ok(port)
}

/// The recorder's thread.
struct Run {
    options: Options,
    /// The address by which the port is found again.
    identity: PortAddress,
    recorder: Recorder,
    telegrams: Option<Telegrams>,
    axes: Option<AxesSource>,
    shared: Arc<Shared>,
    began: HostNs,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum PortState {
    Open,
    Gone,
}

/// How a session on an open port ended.
enum Session {
    Over(Ending),
    Gone(HostNs, String),
}

impl Run {
    fn whole(mut self, mut port: Port) -> Result<Summary, Diagnostic> {
        let ending = loop {
            let (since, why) = match self.session(&port)? {
                Session::Over(ending) => {
                    session::close(port, &self.options.definition);
                    break ending;
                }
                Session::Gone(since, why) => (since, why),
            };
            drop(port);
            self.recorder.interrupted(since)?;
            let reopened = self.reopen(since)?;
            let now = clock::now();
            let away_s = now.seconds_since(since);
            self.recorder.progress.silent_s += away_s;
            let seconds = Some(away_s);
            let reason = format!("the port was gone: {why}");
            self.recorder.event(now, Event::Gap { seconds, missing: None, reason })?;
            match reopened {
                Ok(again) => {
                    self.recorder.restarted();
                    port = begin(&mut self.recorder, &self.identity, again)?;
                }
                Err(ending) => break ending,
            }
        };
        self.write_notes()?;
        self.beside(Line::Idle)?;
        let progress = self.recorder.finish(clock::now(), ending.reason());
        self.say();
        Ok(Summary { capture: self.recorder.path().into(), ending, progress: progress? })
    }

    /// Records from an open port until it is gone or the run is over.
    fn session(&mut self, port: &Port) -> Result<Session, Diagnostic> {
        let (_reader, arrivals) = Reader::start(port.handle()?)?;
        let mut polling = match self.options.definition.mode {
            Mode::Poll { hz, timeout } => Some(Polling::new(port.handle()?, hz, timeout)),
            Mode::Stream | Mode::Push => None,
        };
        let idle = self.options.definition.idle;
        loop {
            if let Some(ending) = self.ending() {
                return Ok(Session::Over(ending));
            }
            let beside = self.telegrams.is_some() || self.axes.is_some();
            let unhurried = if beside { Telegrams::PATIENCE } else { Duration::from_millis(50) };
            let mut patience = idle.unwrap_or(unhurried);
            if let Some(polling) = &mut polling {
                match polling.step(&self.options.definition, &mut self.recorder)? {
                    Ok(wait) => patience = patience.min(wait),
                    Err(gone) => return Ok(Session::Gone(clock::now(), gone.to_string())),
                }
            }
            let arrival = arrivals.recv_timeout(patience);
            let line = if arrival.is_err() { Line::Idle } else { Line::Busy };
            match arrival {
                Ok(Arrival::Bytes(host, bytes)) => {
                    let before = self.recorder.answers();
                    self.recorder.bytes(host, bytes)?;
                    if let Some(polling) = &mut polling
                        && self.recorder.answers() > before
                    {
                        polling.answered();
                    }
                }
                Ok(Arrival::Lost(host, bytes)) => self.recorder.lost(host, bytes)?,
                Ok(Arrival::Gone(host, why)) => return Ok(Session::Gone(host, why)),
                Err(RecvTimeoutError::Timeout) => {
                    if idle.is_some() {
                        self.recorder.silence(clock::now())?;
                    }
                }
                Err(RecvTimeoutError::Disconnected) => {
                    return Ok(Session::Gone(clock::now(), "the reading thread ended".into()));
                }
            }
            self.beside(line)?;
            self.publish(PortState::Open)?;
        }
    }

    /// Records what came from the controller.
    fn beside(&mut self, line: Line) -> Result<(), Diagnostic> {
        while let Some((host, arrival)) = self.axes.as_ref().and_then(AxesSource::next) {
            match arrival {
                AxesArrival::Bytes(bytes) => self.recorder.axes(host, bytes)?,
                AxesArrival::Event(event) => self.recorder.event(host, event)?,
            }
        }
        match &mut self.telegrams {
            Some(telegrams) => telegrams.step(&mut self.recorder, line),
            None => Ok(()),
        }
    }

    fn ending(&self) -> Option<Ending> {
        if self.recorder.over() || self.telegrams.as_ref().is_some_and(Telegrams::over) {
            Some(Ending::Mark)
        } else if self.shared.stop.load(Ordering::Relaxed) {
            Some(Ending::Stopped)
        } else {
            let elapsed = clock::now().seconds_since(self.began);
            self.options.duration_s.is_some_and(|limit| elapsed >= limit).then_some(Ending::Duration)
        }
    }

    /// Waits for the port to come back: more patiently each time, until it has been away too long.
    fn reopen(&mut self, since: HostNs) -> Result<Result<Opened, Ending>, Diagnostic> {
        let mut backoff = 0.1;
        let mut next = 0.0;
        loop {
            self.beside(Line::Idle)?;
            self.publish(PortState::Gone)?;
            if let Some(ending) = self.ending() {
                return Ok(Err(ending));
            }
            let away = clock::now().seconds_since(since);
            if away >= next {
                if self.identity.may_return()
                    && let Ok(opened) = session::open(&self.identity, &self.options.definition)
                {
                    return Ok(Ok(opened));
                }
                next = away + backoff;
                backoff = (2.0 * backoff).min(LONGEST_BACKOFF_S);
            }
            if away >= self.options.gone_s {
                return Ok(Err(Ending::Gone));
            }
            clock::sleep(0.02);
        }
    }

    /// Hands over what was found about the capture.
    fn say(&mut self) {
        let mut findings = lock(&self.shared.findings);
        findings.append(&mut self.recorder.findings);
    }

    fn write_notes(&mut self) -> Result<(), Diagnostic> {
        let notes = std::mem::take(&mut *lock(&self.shared.notes));
        notes.into_iter().try_for_each(|event| self.recorder.event(clock::now(), event))
    }

    /// Writes the notes of others and publishes the counts.
    fn publish(&mut self, port: PortState) -> Result<(), Diagnostic> {
        self.write_notes()?;
        self.recorder.tick(clock::now())?;
        self.say();
        let progress = Progress { gone: port == PortState::Gone, ..self.recorder.progress };
        *lock(&self.shared.progress) = progress;
        Ok(())
    }
}
