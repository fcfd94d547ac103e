//! A run: reader thread -> bounded channel -> recorder thread.

use dbbd_model::base::InternalFinding;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::RecvTimeoutError;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use serde::Serialize;

use super::OpenedBar;
use super::axes::{AxesArrival, AxesSource};
use super::ekrl::{BarLineState, EkrlServer, TelegramRecorder};
use super::live_state::LiveFeed;
use super::recorder::{EndReason, Recorder, RunProgress};
use super::schedule::{ALARM_SHARE, Schedule};
use super::session::{self, BarPolling};
use crate::live::ServiceFinding;
use dbbd_device::clock;
use dbbd_device::port::{self, Arrival, Port, PortAddress, PortDevice, PortReader, Received};
use dbbd_device::protocol::{ProtocolDefinition, ProtocolMode};
use dbbd_device::sync::lock;
use dbbd_job::recording::RecordingFinding;
use dbbd_job::recording::capture::{CaptureWriter, RunEvent};
use dbbd_job::recording::run::{ATTACHED_IDENTITY, PlanFiles};
use dbbd_model::base::serialised;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::{DataOrigin, Identity};

/// Longest pause between two attempts to reopen a port, s.
const LONGEST_BACKOFF_S: f64 = 0.5;
/// A reader that ends has reported its last bytes by then.
const LONGEST_WAIT: Duration = Duration::from_secs(5);
/// Arrivals that are recorded before the controller, clients and the disk have their turn.
const MAX_AT_ONCE: usize = 64;

/// Connections to the robot controller.
#[derive(Debug, Default)]
pub struct ControllerConnections {
    /// Receives the dwell reports of the program.
    pub ekrl: Option<EkrlServer>,
    /// Receives the published axes.
    pub axes: Option<AxesSource>,
}

#[derive(Debug)]
pub struct AcquisitionOptions {
    pub port: PortAddress,
    pub definition: ProtocolDefinition,
    /// The capture to write.
    pub out: PathBuf,
    /// The plan that the robot executes. Its files are attached to the capture.
    pub plan: Option<PlanFiles>,
    /// Identity data of this run, in addition to the identity data of the plan.
    pub identity: Identity,
    pub controller: ControllerConnections,
    /// The run ends after this host time.
    pub duration_s: Option<f64>,
    /// The run ends when the port has been absent for this time.
    pub gone_s: f64,
    /// Shows the run to clients.
    pub feed: Option<LiveFeed>,
    /// Time from one sync of the capture to the next, s: a power failure costs this time, and that of a sync on a slow disk.
    pub sync_s: f64,
}

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AcquisitionSummary {
    /// The capture. It differs from [`AcquisitionOptions::out`] if that file was removed or replaced during the run.
    pub capture: PathBuf,
    pub ending: EndReason,
    pub progress: RunProgress,
}

/// A run in progress, recorded by a thread of its own.
pub struct Acquisition {
    shared: Arc<AcquisitionShared>,
    recorder: JoinHandle<Result<AcquisitionSummary, Diagnostic>>,
}

struct AcquisitionShared {
    progress: Mutex<RunProgress>,
    /// Events of other threads that are to be written; `None` once the last ones were taken.
    notes: Mutex<Option<Vec<RunEvent>>>,
    /// Findings about interference with the capture file.
    findings: Mutex<Vec<Diagnostic>>,
    stop: Arc<AtomicBool>,
}

impl Acquisition {
    /// Opens the port, creates the capture and starts the recorder. Setting `stop` ends the run.
    pub fn start(options: AcquisitionOptions, stop: Arc<AtomicBool>) -> Result<Self, Diagnostic> {
        if options.out.exists() {
            let name = options.out.display().to_string();
            return Err(Diagnostic::file(&name, RecordingFinding::CaptureExists));
        }
        // The port is opened first: if that fails, no file is left behind.
        let opened = session::open_bar(&options.port, &options.definition)?;
        let writer = CaptureWriter::create(&options.out)?;
        Self::record(writer, options, opened, stop)
    }

    /// The same as [`Self::start`], into an open writer.
    pub fn start_on(
        writer: CaptureWriter,
        options: AcquisitionOptions,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, Diagnostic> {
        let opened = session::open_bar(&options.port, &options.definition)?;
        Self::record(writer, options, opened, stop)
    }

    fn record(
        mut writer: CaptureWriter,
        mut options: AcquisitionOptions,
        opened: OpenedBar,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, Diagnostic> {
        let began = opened.began;
        let plan = options.plan.take();
        let schedule = plan.as_ref().map(|files| Schedule::of(&files.plan, ALARM_SHARE)).unwrap_or_default();
        // Readings that are not kept are never synced.
        if let Ok(interval) = Duration::try_from_secs_f64(options.sync_s) {
            writer.sync_every(interval)?;
        }
        let mut recorder = Recorder::new(writer, &options.definition, schedule.modules(), began);
        if let Some(feed) = options.feed.take() {
            recorder.show(feed);
        }
        let version = dbbd_job::artefact::VERSION.to_owned();
        recorder.event(began, RunEvent::Started { unix_ns: clock::unix_ns(), version })?;
        for (name, content) in plan.into_iter().flat_map(PlanFiles::attachments) {
            recorder.attach(began, name, content.as_bytes())?;
        }
        if !options.identity.is_empty() {
            recorder.attach(began, ATTACHED_IDENTITY, serialised::toml(&options.identity)?.as_bytes())?;
        }
        recorder.attach(began, "protocol.toml", options.definition.text.as_bytes())?;
        let port = record_opened(&mut recorder, &options.port, opened)?;
        let shared = Arc::new(AcquisitionShared {
            progress: Mutex::default(),
            notes: Mutex::new(Some(Vec::new())),
            findings: Mutex::new(port.finding().into_iter().map(Diagnostic::new).collect()),
            stop,
        });
        let identity = port::identity(&options.port);
        let device = PortDevice::behind(&identity);
        let telegrams = options.controller.ekrl.take().map(|server| TelegramRecorder::new(server, schedule));
        let run = RecorderThread {
            options,
            identity,
            device,
            recorder,
            telegrams,
            shared: Arc::clone(&shared),
            began,
        };
        let recorder = std::thread::Builder::new()
            .name("recorder".into())
            .spawn(move || run.record(port))
            .map_err(|error| InternalFinding::NoSystem { why: error.to_string() })?;
        Ok(Self { shared, recorder })
    }

    pub fn progress(&self) -> RunProgress {
        *lock(&self.shared.progress)
    }

    /// Writes a remark into the capture, and returns whether the run still takes one.
    pub fn mark(&self, text: String) -> bool {
        self.note(RunEvent::Mark { text })
    }

    /// Writes an event into the capture, and returns whether the run still takes one.
    pub fn note(&self, event: RunEvent) -> bool {
        lock(&self.shared.notes).as_mut().map(|notes| notes.push(event)).is_some()
    }

    /// The findings about the capture file since the last call.
    pub fn findings(&self) -> Vec<Diagnostic> {
        std::mem::take(&mut *lock(&self.shared.findings))
    }

    pub fn is_over(&self) -> bool {
        self.recorder.is_finished()
    }

    pub fn join(self) -> Result<AcquisitionSummary, Diagnostic> {
        self.recorder.join().map_err(|_| ServiceFinding::RecorderDied)?
    }
}

/// Records that the bar was opened, and the bytes that followed its start command.
fn record_opened(
    recorder: &mut Recorder,
    address: &PortAddress,
    opened: OpenedBar,
) -> Result<Port, Diagnostic> {
    let now = clock::now();
    let OpenedBar { port, stale, first, .. } = opened;
    recorder.event(now, RunEvent::Opened { port: address.to_string(), stamps: Some(port.stamps()) })?;
    record_origin(recorder, now, port.is_simulated())?;
    if stale > 0 {
        let text = format!("{stale} bytes of an earlier stream were discarded before the start");
        recorder.event(now, RunEvent::Mark { text })?;
    }
    if !first.is_empty() {
        recorder.bytes(Received { host: now, watched_s: 0.0, bytes: first })?;
    }
    Ok(port)
}

/// Records where the readings come from.
fn record_origin(recorder: &mut Recorder, now: HostNs, is_simulated: bool) -> Result<(), Diagnostic> {
    let origin = if is_simulated { DataOrigin::Simulated } else { DataOrigin::Measured };
    recorder.event(now, RunEvent::Origin { origin })
}

/// The state of the recorder thread.
struct RecorderThread {
    options: AcquisitionOptions,
    /// The address under which the port is opened again.
    identity: PortAddress,
    /// The device that was behind it first.
    device: Option<PortDevice>,
    recorder: Recorder,
    telegrams: Option<TelegramRecorder>,
    shared: Arc<AcquisitionShared>,
    began: HostNs,
}

/// The reason why the recording from an open port ended.
enum PortSessionEnd {
    Over(EndReason),
    /// The port is gone: since when, and the reason.
    Gone(HostNs, String),
}

impl RecorderThread {
    fn record(mut self, port: Port) -> Result<AcquisitionSummary, Diagnostic> {
        let recorded = self.recorded(port);
        // A run that failed takes no remark either.
        *lock(&self.shared.notes) = None;
        recorded
    }

    fn recorded(&mut self, mut port: Port) -> Result<AcquisitionSummary, Diagnostic> {
        let ending = loop {
            let (since, why) = match self.session(&port)? {
                PortSessionEnd::Over(ending) => {
                    session::close(port, &self.options.definition);
                    break ending;
                }
                PortSessionEnd::Gone(since, why) => (since, why),
            };
            drop(port);
            self.recorder.interrupted(since)?;
            self.recorder.progress.counts.gone = true;
            let reopened = self.reopen(since)?;
            self.recorder.progress.counts.gone = false;
            let now = clock::now();
            let away_s = now.seconds_since(since);
            self.recorder.progress.silent_s += away_s;
            let reason = format!("the port was gone: {why}");
            self.recorder.event(now, RunEvent::Gap { seconds: Some(away_s), missing: None, reason })?;
            match reopened {
                Ok(again) => {
                    self.recorder.restarted();
                    port = record_opened(&mut self.recorder, &self.identity, again)?;
                }
                Err(ending) => break ending,
            }
        };
        self.record_controller(BarLineState::Idle)?;
        let last = lock(&self.shared.notes).take();
        self.write(last.unwrap_or_default())?;
        let progress = self.recorder.finish(clock::now(), ending);
        self.publish_findings();
        Ok(AcquisitionSummary { capture: self.recorder.path().into(), ending, progress: progress? })
    }

    /// Records from an open port until it is gone or the run is over, and all that was received by then.
    fn session(&mut self, port: &Port) -> Result<PortSessionEnd, Diagnostic> {
        let reader = PortReader::start(port.handle()?)?;
        let mut polling = match self.options.definition.mode {
            ProtocolMode::Poll { hz, timeout } => Some(BarPolling::new(port.handle()?, hz, timeout)),
            ProtocolMode::Stream | ProtocolMode::Push => None,
        };
        let ended = self.read(&reader, &mut polling);
        reader.end();
        let drained = ended.and_then(|ended| {
            while let Ok(arrival) = reader.next(LONGEST_WAIT) {
                _ = self.arrived(arrival, &mut polling)?;
            }
            self.publish()?;
            Ok(ended)
        });
        if drained.is_err() {
            self.count_refused(&reader);
        }
        drained
    }

    /// Counts what was received, and what the disk did not take any more.
    fn count_refused(&mut self, reader: &PortReader) {
        let mut bytes = self.recorder.unwritten();
        while let Ok(arrival) = reader.next(LONGEST_WAIT) {
            bytes += match arrival {
                Arrival::Bytes(received) => received.bytes.len() as u64,
                Arrival::Lost(_, bytes) => bytes,
                Arrival::Simulated(_) | Arrival::Ended(..) | Arrival::Gone(..) => 0,
            };
        }
        let name = self.recorder.path().display().to_string();
        lock(&self.shared.findings).push(Diagnostic::file(name, RecordingFinding::Refused { bytes }));
    }

    /// Records until the port is gone or the run is to end.
    fn read(
        &mut self,
        reader: &PortReader,
        polling: &mut Option<BarPolling>,
    ) -> Result<PortSessionEnd, Diagnostic> {
        let idle = self.options.definition.idle;
        let has_controller = self.telegrams.is_some() || self.options.controller.axes.is_some();
        let longest = if has_controller { TelegramRecorder::PATIENCE } else { Duration::from_millis(50) };
        loop {
            if let Some(ending) = self.ending() {
                return Ok(PortSessionEnd::Over(ending));
            }
            let mut patience = idle.unwrap_or(longest);
            if let Some(polling) = polling {
                match polling.step(&self.options.definition, &mut self.recorder)? {
                    Ok(wait) => patience = patience.min(wait),
                    Err(gone) => return Ok(PortSessionEnd::Gone(clock::now(), gone.to_string())),
                }
            }
            let mut line = BarLineState::Idle;
            // Of a slow disk many arrivals wait, which are written at once.
            for _ in 0..MAX_AT_ONCE {
                match reader.next(patience) {
                    Ok(arrival) => {
                        if let Some(gone) = self.arrived(arrival, polling)? {
                            return Ok(gone);
                        }
                    }
                    Err(RecvTimeoutError::Timeout) => {
                        if idle.is_some() && line == BarLineState::Idle {
                            self.recorder.idle(clock::now())?;
                        }
                        break;
                    }
                    Err(RecvTimeoutError::Disconnected) => {
                        return Ok(PortSessionEnd::Gone(clock::now(), "the reading thread ended".into()));
                    }
                }
                (line, patience) = (BarLineState::Busy, Duration::ZERO);
            }
            self.record_controller(line)?;
            self.publish()?;
        }
    }

    /// Records an arrival; returns the end of the session if the port is gone.
    fn arrived(
        &mut self,
        arrival: Arrival,
        polling: &mut Option<BarPolling>,
    ) -> Result<Option<PortSessionEnd>, Diagnostic> {
        match arrival {
            Arrival::Bytes(received) => {
                let before = self.recorder.answers();
                self.recorder.bytes(received)?;
                if let Some(polling) = polling
                    && self.recorder.answers() > before
                {
                    polling.answered();
                }
            }
            Arrival::Simulated(host) => record_origin(&mut self.recorder, host, true)?,
            Arrival::Lost(host, bytes) => self.recorder.lost(host, bytes)?,
            Arrival::Ended(host, watched_s) => self.recorder.watched_to_the_end(host, watched_s),
            Arrival::Gone(host, why) => return Ok(Some(PortSessionEnd::Gone(host, why))),
        }
        Ok(None)
    }

    /// Records the axes and telegrams of the controller.
    fn record_controller(&mut self, line: BarLineState) -> Result<(), Diagnostic> {
        while let Some((host, arrival)) = self.options.controller.axes.as_ref().and_then(AxesSource::next) {
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

    fn ending(&self) -> Option<EndReason> {
        if self.recorder.over() || self.telegrams.as_ref().is_some_and(TelegramRecorder::over) {
            Some(EndReason::Mark)
        } else if self.shared.stop.load(Ordering::Relaxed) {
            Some(EndReason::Stopped)
        } else {
            let elapsed = clock::now().seconds_since(self.began);
            self.options.duration_s.is_some_and(|limit| elapsed >= limit).then_some(EndReason::Duration)
        }
    }

    /// Opens the port again, with growing pauses between the attempts, or returns the reason if the run ends meanwhile.
    fn reopen(&mut self, since: HostNs) -> Result<Result<OpenedBar, EndReason>, Diagnostic> {
        let mut backoff = 0.1;
        let mut next = 0.0;
        let mut warned = None;
        loop {
            self.record_controller(BarLineState::Idle)?;
            self.publish()?;
            if let Some(ending) = self.ending() {
                return Ok(Err(ending));
            }
            let away = clock::now().seconds_since(since);
            if away >= next {
                if self.identity.may_return()
                    && self.is_same_device(&mut warned)?
                    && let Ok(opened) = session::open_bar(&self.identity, &self.options.definition)
                {
                    return Ok(Ok(opened));
                }
                next = away + backoff;
                backoff = (2.0 * backoff).min(LONGEST_BACKOFF_S);
            }
            if away >= self.options.gone_s {
                return Ok(Err(EndReason::Gone));
            }
            clock::sleep(0.02);
        }
    }

    /// Whether the name of the port is still that of the bar's device. Another one is reported, unless it was the last
    /// time.
    fn is_same_device(&mut self, warned: &mut Option<PortDevice>) -> Result<bool, Diagnostic> {
        let now = PortDevice::behind(&self.identity);
        let Some((began, now)) = self.device.as_ref().zip(now).filter(|(began, now)| !began.may_be(now))
        else {
            return Ok(true);
        };
        if warned.as_ref() != Some(&now) {
            let finding = now.instead_of(began, &self.identity.to_string());
            self.recorder.event(clock::now(), RunEvent::Mark { text: finding.to_string() })?;
            lock(&self.shared.findings).push(finding.into());
            *warned = Some(now);
        }
        Ok(false)
    }

    fn publish_findings(&mut self) {
        lock(&self.shared.findings).append(&mut self.recorder.take_findings());
    }

    fn write(&mut self, notes: Vec<RunEvent>) -> Result<(), Diagnostic> {
        notes.into_iter().try_for_each(|event| self.recorder.event(clock::now(), event))
    }

    fn publish(&mut self) -> Result<(), Diagnostic> {
        let notes = lock(&self.shared.notes).as_mut().map(std::mem::take);
        self.write(notes.unwrap_or_default())?;
        self.recorder.tick(clock::now())?;
        self.publish_findings();
        *lock(&self.shared.progress) = self.recorder.progress;
        Ok(())
    }
}
