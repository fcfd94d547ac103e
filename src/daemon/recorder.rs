//! The recorder writes arriving bytes raw, then decodes them and writes the samples and faults, and counts. It reads no
//! clock: the caller gives the time of each arrival, so that a recorded line can be replayed.

use std::path::Path;

use serde::Serialize;

use super::live_state::LiveFeed;
use crate::live::RunCounts;
use dbbd_device::port::Received;
use dbbd_device::protocol::{DecodedItem, LineFault, LineFaultKind, ProtocolDecoder, ProtocolDefinition};
use dbbd_job::recording::RecordingFinding;
use dbbd_job::recording::axes::{AxesReceiver, AxesRecords, PacketCounts};
use dbbd_job::recording::capture::{CaptureRecord, CaptureWriter, RunEvent};
use dbbd_job::recording::{ClockStamp, DeviceTime, SequenceStep, StrobeDecoder, StrobeEvent, sequence_step};
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;
use dbbd_model::provenance::DataOrigin;

/// A shorter silence is not recorded where sequence numbers show losses, s: radio links deliver the samples of a second
/// together.
const NUMBERED_SILENT_S: f64 = 2.5;
/// A shorter silence, or standstill of this computer, is no finding, s.
const SILENT_S: f64 = 1.0;
/// The first faults in a row have one record each. Further faults of the same kind share one record.
const ONE_BY_ONE: u32 = 16;
/// Interval between checks of the capture file, s.
const CHECK_S: f64 = 0.5;
/// Events of a second that have a record each: more than a bar of 1 kHz that loses every tenth sample makes.
const MAX_EVENTS: u32 = 200;
/// Without a plan the program is over when the strobe stays low for this time after an end mark, s.
const OVER_S: f64 = 20.0;

/// The reason for the end of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EndReason {
    /// The program's end mark.
    Mark,
    Duration,
    Stopped,
    /// The port was absent for too long.
    Gone,
}

impl EndReason {
    pub const fn reason(self) -> &'static str {
        match self {
            EndReason::Mark => "the program's end mark",
            EndReason::Duration => "the time was up",
            EndReason::Stopped => "stopped",
            EndReason::Gone => "the port stayed away",
        }
    }
}

/// The counts and readings of a run so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RunProgress {
    #[serde(flatten)]
    pub counts: RunCounts,
    /// Samples that the device flags as invalid.
    pub invalid: u64,
    /// Readings with a number of decimals of another unit.
    pub other_unit: u64,
    /// Whether the device flags the last reading as valid.
    pub valid: bool,
    /// Time in which the line was watched and nothing came for more than a second, or the port was absent.
    pub silent_s: f64,
    /// Time in which this computer did not watch the line for more than a second.
    pub stood_still_s: f64,
    /// Recorded telegrams of the program.
    pub telegrams: u64,
    /// Telegrams of another plan, or of a row without a dwell.
    pub refused: u64,
    /// Packets of a controller that publishes its axes.
    pub axes: Option<PacketCounts>,
}

/// The recorder of one run.
pub struct Recorder {
    capture: PendingCapture,
    decoder: ProtocolDecoder,
    decoded: Vec<DecodedItem>,
    stream: BarStream,
    upkeep: CaptureUpkeep,
    rate: EventRate,
    /// Device time of the samples, if the device has a clock.
    time: Option<DeviceTime>,
    program: ProgramEnd,
    axes: AxesRecords,
    pub progress: RunProgress,
    feed: Option<LiveFeed>,
}

/// The capture with the records that are not written yet.
struct PendingCapture {
    writer: CaptureWriter,
    /// Samples of one host time.
    samples: Vec<Sample>,
    samples_host: HostNs,
    /// The last fault; the next one may be joined to it.
    fault: Option<(HostNs, LineFault)>,
    /// Faults since the last sample.
    faults_in_a_row: u32,
}

impl PendingCapture {
    fn write(&mut self, host: HostNs, record: &CaptureRecord) -> Result<(), Diagnostic> {
        self.writer.write(host, record)
    }

    fn sample(&mut self, host: HostNs, sample: &Sample) -> Result<(), Diagnostic> {
        if self.samples_host != host {
            self.flush_samples()?;
            self.samples_host = host;
        }
        self.samples.push(*sample);
        Ok(())
    }

    fn fault(&mut self, host: HostNs, fault: LineFault) -> Result<(), Diagnostic> {
        self.flush_samples()?;
        self.faults_in_a_row = self.faults_in_a_row.saturating_add(1);
        let other = match &mut self.fault {
            Some((_, before)) => before.join(fault),
            None => Some(fault),
        };
        if let Some(other) = other {
            self.flush_fault()?;
            self.fault = Some((host, other));
        }
        if self.faults_in_a_row < ONE_BY_ONE { self.flush_fault() } else { Ok(()) }
    }

    /// Writes the pending samples. Records keep the order of arrival.
    fn flush_samples(&mut self) -> Result<(), Diagnostic> {
        if self.samples.is_empty() {
            return Ok(());
        }
        let record = CaptureRecord::Samples(std::mem::take(&mut self.samples));
        self.writer.write(self.samples_host, &record)?;
        if let CaptureRecord::Samples(mut samples) = record {
            samples.clear();
            self.samples = samples;
        }
        Ok(())
    }

    fn flush_fault(&mut self) -> Result<(), Diagnostic> {
        let Some((host, fault)) = self.fault.take() else { return Ok(()) };
        let json = serde_json::to_vec(&fault)
            .map_err(|error| RecordingFinding::EventNotWritten { why: error.to_string() })?;
        self.writer.write(host, &CaptureRecord::Fault(json))
    }

    fn flush(&mut self) -> Result<(), Diagnostic> {
        self.flush_samples()?;
        self.flush_fault()
    }
}

/// Limits the records of events that a broken or hostile line, client or controller can cause.
struct EventRate {
    second: HostNs,
    /// Events of this second.
    events: u32,
    /// Gaps, samples missing in them, and other events that had no record since the last record about withheld events.
    withheld: [u64; 3],
}

impl EventRate {
    fn new(now: HostNs) -> Self {
        Self { second: now, events: 0, withheld: [0; 3] }
    }

    /// The event with the counts of withheld events, when their second is over.
    fn due(&mut self, now: HostNs) -> Option<RunEvent> {
        if now.seconds_since(self.second) < 1.0 {
            return None;
        }
        (self.second, self.events) = (now, 0);
        self.withheld()
    }

    fn withheld(&mut self) -> Option<RunEvent> {
        let [gaps, missing, others] = std::mem::take(&mut self.withheld);
        (gaps + others > 0).then_some(RunEvent::Withheld { gaps, missing, others })
    }

    /// Whether the event may have a record; otherwise it is counted as withheld. Events that the evaluation needs
    /// always have one.
    fn admits(&mut self, event: &RunEvent) -> bool {
        let counts = match event {
            RunEvent::Gap { .. } => {
                let (gaps, missing) = event.gaps();
                [gaps, missing, 0]
            }
            RunEvent::Mark { .. } | RunEvent::Operator { .. } | RunEvent::Finding { .. } => [0, 0, 1],
            RunEvent::Started { .. }
            | RunEvent::Opened { .. }
            | RunEvent::Origin { .. }
            | RunEvent::AxesOpened { .. }
            | RunEvent::Withheld { .. }
            | RunEvent::Controller { .. }
            | RunEvent::Ended(_) => return true,
        };
        self.events = self.events.saturating_add(1);
        if self.events <= MAX_EVENTS {
            return true;
        }
        for (sum, count) in self.withheld.iter_mut().zip(counts) {
            *sum = sum.saturating_add(count);
        }
        false
    }
}

/// The state of the stream of the bar.
struct BarStream {
    silent: SilentTime,
    sequence: SequenceNumbers,
    sync: FrameSync,
    requests: PollRequests,
    /// When the reader of the line ended, and for how long it had watched the line since the last bytes, s.
    watched_to: Option<(HostNs, f64)>,
}

/// What the times between the bytes of the bar show: whether it was silent, or this computer stood still.
#[derive(Clone, Copy)]
struct SilentTime {
    /// The longest silence that is not recorded as a gap, s; `None` for a device that may be silent.
    limit_s: Option<f64>,
    last_bytes: Option<HostNs>,
    unexplained: Option<UnexplainedTime>,
}

/// Seconds without a byte, in which the line was watched, and in which it was not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Times {
    of_bar_s: f64,
    of_computer_s: f64,
}

/// Time without a byte. The samples after it show whether anything was lost: a driver keeps bytes for a while and loses the ones
/// after them, so that the first samples go on, and the step of the bar's clock comes behind them.
#[derive(Clone, Copy, Debug, PartialEq)]
struct UnexplainedTime {
    /// When the last bytes before it came.
    since: HostNs,
    times: Times,
    /// For how long the bar's clock went on without a step since, s; `None` before the first sample.
    went_on_s: Option<f64>,
}

/// How a sample follows the one before.
#[derive(Clone, Copy)]
struct Continuity {
    host: HostNs,
    /// The step of the bar's clock, s.
    step_s: Option<f64>,
    /// Whether its sequence number is the next one.
    is_next: bool,
}

impl SilentTime {
    fn new(definition: &ProtocolDefinition) -> Self {
        let numbered = definition.sequence_modulo.is_some();
        let stall_s = definition.stall.map(|stall| stall.as_secs_f64());
        let limit_s = stall_s.map(|s| if numbered { s.max(NUMBERED_SILENT_S) } else { s });
        Self { limit_s, last_bytes: None, unexplained: None }
    }

    /// Notes the time since the last bytes, of which the line was watched for `watched_s`. Returns the gap if it is to be
    /// recorded: longer than the device's limit and `min_s`.
    fn until(&mut self, host: HostNs, watched_s: f64, min_s: f64) -> Option<RunEvent> {
        let last = self.last_bytes?;
        let since_s = host.seconds_since(last);
        let of_bar_s = watched_s.min(since_s);
        let of_computer_s = since_s - of_bar_s;
        let limit_s = self.limit_s.unwrap_or(f64::INFINITY).max(min_s);
        let beyond = |s: f64, min_s: f64| if s > min_s { s } else { 0.0 };
        self.add(
            last,
            Times {
                of_bar_s: beyond(of_bar_s, limit_s.max(SILENT_S)),
                of_computer_s: beyond(of_computer_s, SILENT_S),
            },
        );
        let reason = if of_computer_s > SILENT_S {
            format!("this computer stood still for {of_computer_s:.1} s")
        } else {
            "nothing was received".to_owned()
        };
        (since_s > limit_s).then_some(RunEvent::Gap { seconds: Some(since_s), missing: None, reason })
    }

    fn add(&mut self, since: HostNs, times: Times) {
        match &mut self.unexplained {
            _ if times == Times::default() => {}
            Some(UnexplainedTime { times: before, went_on_s: None, .. }) => {
                before.of_bar_s += times.of_bar_s;
                before.of_computer_s += times.of_computer_s;
            }
            // What the line held of the time before was read meanwhile, and went on.
            Some(_) | None => self.unexplained = Some(UnexplainedTime { since, times, went_on_s: None }),
        }
    }

    /// The seconds that a sample shows to be lost: none while the bar's clock goes on, and none of the computer if the sequence
    /// number is the next one.
    fn explained_by(&mut self, sample: Continuity) -> Times {
        let Some(unexplained) = &mut self.unexplained else { return Times::default() };
        if let Some(step_s) = sample.step_s.filter(|step_s| (0.0..SILENT_S).contains(step_s)) {
            let went_on_s = unexplained.went_on_s.unwrap_or(0.0) + step_s;
            unexplained.went_on_s = Some(went_on_s);
            let behind_s = sample.host.seconds_since(unexplained.since) - went_on_s;
            if behind_s < SILENT_S {
                self.unexplained = None;
            }
            return Times::default();
        }
        let times = unexplained.times;
        self.unexplained = None;
        if sample.is_next { Times { of_computer_s: 0.0, ..times } } else { times }
    }

    /// The seconds that no sample explains to the end: the bar's clock has not come up to that of the host.
    fn left(&mut self) -> Times {
        self.unexplained.take().map(|unexplained| unexplained.times).unwrap_or_default()
    }
}

/// The sequence numbers of a device that has them.
struct SequenceNumbers {
    modulo: Option<u32>,
    last: Option<u32>,
}

impl SequenceNumbers {
    /// The number of samples that are missing before this one, if it is known, and the reason of the gap; `None`
    /// without a gap.
    fn gap(&mut self, sample: &Sample) -> Option<(Option<u64>, String)> {
        let (modulo, sequence) = (self.modulo?, sample.sequence?);
        let last = self.last.replace(sequence)?;
        match sequence_step(modulo, last, sequence) {
            SequenceStep::Next => None,
            SequenceStep::Missing(few) => {
                Some((Some(few), "samples are missing by their sequence numbers".to_owned()))
            }
            SequenceStep::Back => Some((None, format!("the sequence number went from {last} to {sequence}"))),
        }
    }
}

/// Whether the decoder is in step with the frames: enough of them in a row had no fault.
struct FrameSync {
    in_a_row: u32,
    needed: u32,
}

/// The requests of a polled device.
struct PollRequests {
    /// The time of the last request.
    last: Option<HostNs>,
    /// Whether the reading belongs to the time of the request, `latch_delay_ns` later.
    is_latched: bool,
    latch_delay_ns: u64,
}

impl PollRequests {
    /// The time of a reading whose reply came at `host`: up to 70 ms after its request.
    fn time_of_reading(&self, host: HostNs) -> HostNs {
        match self.last.filter(|_| self.is_latched) {
            Some(HostNs(ns)) => HostNs(ns.saturating_add(self.latch_delay_ns)),
            None => host,
        }
    }
}

/// The times and counts of the work that is done at intervals during a run.
struct CaptureUpkeep {
    began: HostNs,
    last_check: HostNs,
    rate_since: HostNs,
    /// Number of samples when the rate was last computed.
    rate_samples: u64,
    /// Interference of other programs with the capture file.
    findings: Vec<Diagnostic>,
}

/// Counts dwells and modules by the strobe during a run, and detects the end of the program.
#[derive(Clone, Debug)]
struct ProgramEnd {
    decoder: StrobeDecoder,
    /// Modules of the plan; unknown without a plan.
    modules: Option<usize>,
    dwells: u32,
    modules_over: u32,
    now_s: f64,
}

impl ProgramEnd {
    fn new(modules: Option<usize>) -> Self {
        Self { decoder: StrobeDecoder::default(), modules, dwells: 0, modules_over: 0, now_s: 0.0 }
    }

    /// Adds a sample. Times do not decrease.
    fn push(&mut self, t_s: f64, sample: &Sample) {
        self.now_s = t_s;
        let event = self.decoder.push(t_s, sample.trigger);
        self.count(event);
    }

    fn finish(&mut self) {
        let event = self.decoder.finish();
        self.count(event);
    }

    fn count(&mut self, event: Option<StrobeEvent>) {
        match event {
            Some(StrobeEvent::Dwell(_)) => self.dwells += 1,
            Some(StrobeEvent::ModuleEnd) => self.modules_over += 1,
            None => {}
        }
    }

    /// When the strobe rose, s, while it is high.
    fn high_since_s(&self) -> Option<f64> {
        self.decoder.high_since_s()
    }

    fn is_over(&self) -> bool {
        match self.modules {
            Some(modules) => self.modules_over as usize >= modules.max(1),
            None => self.modules_over > 0 && self.now_s - self.decoder.last_high_s() >= OVER_S,
        }
    }
}

impl Recorder {
    /// `modules` is the number of modules of the plan's program.
    pub fn new(
        mut writer: CaptureWriter,
        definition: &ProtocolDefinition,
        modules: Option<usize>,
        now: HostNs,
    ) -> Self {
        writer.hold_back();
        Self {
            capture: PendingCapture {
                writer,
                samples: Vec::new(),
                samples_host: now,
                fault: None,
                faults_in_a_row: 0,
            },
            decoder: definition.decoder(),
            decoded: Vec::new(),
            stream: BarStream {
                silent: SilentTime::new(definition),
                sequence: SequenceNumbers { modulo: definition.sequence_modulo, last: None },
                sync: FrameSync { in_a_row: 0, needed: definition.sync_frames },
                requests: PollRequests {
                    last: None,
                    is_latched: definition.latch_at_request,
                    latch_delay_ns: u64::try_from(definition.latch_delay.as_nanos()).unwrap_or(0),
                },
                watched_to: None,
            },
            upkeep: CaptureUpkeep {
                began: now,
                last_check: now,
                rate_since: now,
                rate_samples: 0,
                findings: Vec::new(),
            },
            rate: EventRate::new(now),
            time: definition.clock.map(|clock| DeviceTime::new(clock.into())),
            program: ProgramEnd::new(modules),
            axes: AxesRecords::default(),
            progress: RunProgress::default(),
            feed: None,
        }
    }

    /// Shows the run to clients.
    pub(super) fn show(&mut self, feed: LiveFeed) {
        self.feed = Some(feed);
    }

    /// The findings about the capture file since the last call.
    pub(super) fn take_findings(&mut self) -> Vec<Diagnostic> {
        std::mem::take(&mut self.upkeep.findings)
    }

    /// Whether the program's end marks have been seen.
    pub(super) fn over(&self) -> bool {
        self.program.is_over()
    }

    pub fn event(&mut self, host: HostNs, event: RunEvent) -> Result<(), Diagnostic> {
        if matches!(event, RunEvent::Gap { .. }) {
            self.progress.counts.gaps += 1;
        }
        self.progress.counts.simulated |= event == RunEvent::Origin { origin: DataOrigin::Simulated };
        if let Some(withheld) = self.rate.due(host) {
            self.capture.flush()?;
            self.capture.write(host, &CaptureRecord::Event(withheld))?;
        }
        if !self.rate.admits(&event) {
            return Ok(());
        }
        self.capture.flush()?;
        let record = CaptureRecord::Event(event);
        self.axes.add(host, &record, |_, _, _| {});
        self.capture.write(host, &record)
    }

    /// Records bytes of a controller that publishes its axes.
    pub fn axes(&mut self, host: HostNs, bytes: Vec<u8>) -> Result<(), Diagnostic> {
        let record = CaptureRecord::Axes(bytes);
        self.capture.write(host, &record)?;
        self.axes.add(host, &record, |_, _, _| {});
        Ok(())
    }

    pub(super) fn attach(&mut self, host: HostNs, name: &str, content: &[u8]) -> Result<(), Diagnostic> {
        self.capture.write(host, &CaptureRecord::Attachment { name: name.into(), content: content.to_vec() })
    }

    /// Records bytes of the bar: they are written before they are decoded.
    pub fn bytes(&mut self, received: Received) -> Result<(), Diagnostic> {
        let Received { host, watched_s, bytes } = received;
        self.silent_until(host, watched_s, 0.0)?;
        self.stream.silent.last_bytes = Some(host);
        self.progress.counts.bytes += bytes.len() as u64;
        let record = CaptureRecord::Raw(bytes);
        self.capture.write(host, &record)?;
        if let CaptureRecord::Raw(bytes) = &record {
            self.decoder.push(bytes, &mut self.decoded);
        }
        self.decoded(host)
    }

    /// Records the time without bytes, of which the line was watched for `watched_s`, if it exceeds the limit of the device and
    /// `min_s`.
    fn silent_until(&mut self, host: HostNs, watched_s: f64, min_s: f64) -> Result<(), Diagnostic> {
        match self.stream.silent.until(host, watched_s, min_s) {
            Some(gap) => self.event(host, gap),
            None => Ok(()),
        }
    }

    /// Notes when the reader of the line ended, and for how long it had watched the line since the last bytes.
    pub(super) fn watched_to_the_end(&mut self, host: HostNs, watched_s: f64) {
        self.stream.watched_to = Some((host, watched_s));
    }

    /// Notes a request to a polled device.
    pub(super) fn requested(&mut self, host: HostNs) {
        self.stream.requests.last = Some(host);
    }

    /// A request was not answered in time. Bytes of a partial reply do not belong to the next one.
    pub(super) fn unanswered(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        self.progress.counts.unanswered += 1;
        self.decoder.interrupt(&mut self.decoded);
        self.decoded(host)
    }

    /// Replies so far: samples and refusals.
    pub(super) fn answers(&self) -> u64 {
        let RunProgress { counts, other_unit, .. } = &self.progress;
        counts.samples + counts.rejected + other_unit
    }

    /// The line was idle for long enough to end a frame.
    pub(super) fn idle(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        self.decoder.idle(&mut self.decoded);
        self.decoded(host)
    }

    /// Bytes were lost between port and recorder.
    pub fn lost(&mut self, host: HostNs, bytes: u64) -> Result<(), Diagnostic> {
        self.progress.counts.lost_bytes += bytes;
        self.interrupted(host)?;
        let reason = format!("{bytes} bytes were lost: the recorder was too slow");
        self.event(host, RunEvent::Gap { seconds: None, missing: None, reason })
    }

    /// The stream was interrupted: a pending frame will not be completed.
    pub fn interrupted(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        self.decoder.interrupt(&mut self.decoded);
        self.stream.silent.last_bytes = None;
        self.decoded(host)
    }

    fn decoded(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        let mut decoded = std::mem::take(&mut self.decoded);
        for one in decoded.drain(..) {
            match one {
                DecodedItem::Sample(sample, _) => self.sample(host, &sample)?,
                DecodedItem::Fault(fault) => {
                    match fault.kind {
                        LineFaultKind::Ignored => {}
                        LineFaultKind::Reject(_) => self.progress.counts.rejected += 1,
                        LineFaultKind::OtherUnit => {
                            self.progress.other_unit += 1;
                            self.progress.counts.faults += 1;
                        }
                        LineFaultKind::Framing
                        | LineFaultKind::Check
                        | LineFaultKind::TooLong
                        | LineFaultKind::Content => {
                            self.progress.counts.faults += 1;
                            self.stream.sync.in_a_row = 0;
                        }
                    }
                    self.capture.fault(host, fault)?;
                }
            }
        }
        self.decoded = decoded;
        self.capture.flush_samples()
    }

    fn sample(&mut self, host: HostNs, sample: &Sample) -> Result<(), Diagnostic> {
        let host = self.stream.requests.time_of_reading(host);
        self.capture.flush_fault()?;
        self.capture.faults_in_a_row = 0;
        let is_next = self.missing(host, sample)?;
        self.capture.sample(host, sample)?;
        self.stream.sync.in_a_row = self.stream.sync.in_a_row.saturating_add(1);
        self.progress.counts.in_step |= self.stream.sync.in_a_row >= self.stream.sync.needed;
        self.progress.counts.samples += 1;
        self.progress.counts.reading_mm = Some(sample.reading_mm);
        self.progress.valid = sample.valid;
        self.progress.invalid += u64::from(!sample.valid);
        let device = self.time.as_mut().zip(sample.ticks);
        let device_s = device.map(|(time, ticks)| time.seconds(ClockStamp { host, ticks }));
        self.program.push(device_s.unwrap_or_else(|| host.seconds_since(self.upkeep.began)), sample);
        let step_s = device_s.and_then(|_| self.time.as_ref()?.step_s());
        let lost = self.stream.silent.explained_by(Continuity { host, step_s, is_next });
        self.add_silent(lost);
        self.progress.counts.device_s = device_s;
        self.progress.counts.dwells = self.progress.counts.dwells.max(self.program.dwells);
        self.progress.counts.modules = self.program.modules_over;
        let Some(feed) = &mut self.feed else { return Ok(()) };
        feed.dwell(self.progress.counts.dwells, self.program.high_since_s(), sample);
        match feed.sample(host, device_s, sample, self.progress.counts.dwells) {
            Some(note) => {
                self.event(host, RunEvent::Finding { code: note.code.as_str().into(), text: note.text })
            }
            None => Ok(()),
        }
    }

    fn add_silent(&mut self, Times { of_bar_s, of_computer_s }: Times) {
        self.progress.silent_s += of_bar_s;
        self.progress.stood_still_s += of_computer_s;
    }

    /// Records a gap in the sequence numbers. Returns whether the sample's number is the next one.
    fn missing(&mut self, host: HostNs, sample: &Sample) -> Result<bool, Diagnostic> {
        let is_numbered = self.stream.sequence.last.is_some() && sample.sequence.is_some();
        let Some((missing, reason)) = self.stream.sequence.gap(sample) else { return Ok(is_numbered) };
        self.progress.counts.missing += missing.unwrap_or(0);
        self.event(host, RunEvent::Gap { seconds: None, missing, reason })?;
        Ok(false)
    }

    /// The device was restarted: its sequence numbers may begin again.
    pub(super) fn restarted(&mut self) {
        self.stream.sequence.last = None;
    }

    /// Regular work: sync, rate, live frames, checks of the capture file.
    pub fn tick(&mut self, now: HostNs) -> Result<(), Diagnostic> {
        self.progress.counts.elapsed_s = now.seconds_since(self.upkeep.began);
        self.progress.axes = self.axes.receiver().map(AxesReceiver::counts);
        if self.capture.fault.as_ref().is_some_and(|(since, _)| now.seconds_since(*since) >= CHECK_S) {
            self.capture.flush_fault()?;
        }
        if let Some(feed) = &mut self.feed {
            feed.tick(now);
        }
        if let Some(withheld) = self.rate.due(now) {
            self.event(now, withheld)?;
        }
        let upkeep = &mut self.upkeep;
        let since_s = now.seconds_since(upkeep.rate_since);
        if since_s >= 1.0 {
            self.progress.counts.rate_hz =
                (self.progress.counts.samples - upkeep.rate_samples) as f64 / since_s;
            (upkeep.rate_since, upkeep.rate_samples) = (now, self.progress.counts.samples);
        }
        self.capture.writer.flush()?;
        if now.seconds_since(upkeep.last_check) >= CHECK_S {
            upkeep.last_check = now;
            self.check_file()?;
        }
        Ok(())
    }

    /// Number of received bytes that the disk did not take yet.
    pub(super) fn unwritten(&self) -> u64 {
        self.progress.counts.bytes.saturating_sub(self.capture.writer.raw_bytes())
    }

    fn check_file(&mut self) -> Result<(), Diagnostic> {
        self.upkeep.findings.extend(self.capture.writer.look_after()?);
        Ok(())
    }

    pub(super) fn path(&self) -> &Path {
        self.capture.writer.path()
    }

    /// Completes the capture.
    pub fn finish(&mut self, now: HostNs, ending: EndReason) -> Result<RunProgress, Diagnostic> {
        // After the end of the program the bar may be silent, and the host may wait for its disk.
        if ending != EndReason::Mark {
            // Shorter silence may be caused by the end of the run itself.
            // Stopping the bar afterwards takes its time, which nobody watches.
            let (ended, watched_s) = self.stream.watched_to.unwrap_or((now, 0.0));
            self.silent_until(ended, watched_s, SILENT_S)?;
            let left = self.stream.silent.left();
            self.add_silent(left);
        }
        self.interrupted(now)?;
        self.capture.flush_fault()?;
        if let Some(withheld) = self.rate.withheld() {
            self.event(now, withheld)?;
        }
        self.program.finish();
        self.progress.counts.dwells = self.progress.counts.dwells.max(self.program.dwells);
        self.progress.counts.elapsed_s = now.seconds_since(self.upkeep.began);
        self.progress.axes = self.axes.receiver().map(AxesReceiver::counts);
        self.check_file()?;
        self.capture.writer.finish(now, ending.reason(), self.progress.counts.missing)?;
        self.check_file()?;
        Ok(self.progress)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples pulses (time low, time high) at 100 Hz, then `quiet_s` seconds of low strobe.
    fn play(end: &mut ProgramEnd, pulses: &[(f64, f64)], quiet_s: f64) {
        let spans = pulses.iter().flat_map(|(low_s, high_s)| [(*low_s, false), (*high_s, true)]);
        for (seconds, strobe) in spans.chain([(quiet_s, false)]) {
            for _ in 0..(seconds * 100.0).round() as u32 {
                let sample = Sample { trigger: Some(strobe), ..Sample::of(0.0) };
                end.push(end.now_s + 0.01, &sample);
            }
        }
    }

    const END: [(f64, f64); 2] = [(0.4, 0.2); 2];

    #[test]
    fn a_program_with_a_plan_ends_with_the_last_module() {
        let mut end = ProgramEnd::new(Some(2));
        for module in 1..=2 {
            play(&mut end, &[(2.0, 1.0), (3.0, 1.0)], 1.5);
            assert!(!end.is_over());
            play(&mut end, &END, 1.5);
            assert_eq!(end.modules_over, module);
        }
        assert!(end.is_over());
        assert_eq!(end.dwells, 4);
    }

    #[test]
    fn a_program_without_a_plan_ends_after_twenty_seconds_without_strobe() {
        let mut end = ProgramEnd::new(None);
        play(&mut end, &[(1.0, 1.0)], 2.0);
        play(&mut end, &END, 19.0);
        assert!(!end.is_over());
        play(&mut end, &[], 1.5);
        assert!(end.is_over());
        let mut busy = ProgramEnd::new(None);
        play(&mut busy, &[(1.0, 1.0), (2.0, 0.2), (0.4, 0.2), (15.0, 1.0)], 10.0);
        assert_eq!((busy.modules_over, busy.is_over()), (1, false));
    }

    fn at(s: f64) -> HostNs {
        HostNs((s * 1e9) as u64)
    }

    fn silent(limit_s: Option<f64>, last_bytes: Option<HostNs>) -> SilentTime {
        SilentTime { limit_s, last_bytes, unexplained: None }
    }

    #[test]
    fn silence_is_recorded_beyond_the_limit_of_the_device() {
        let gap_s = |limit_s, last_bytes, now_s, min_s| match silent(limit_s, last_bytes).until(
            at(now_s),
            99.0,
            min_s,
        ) {
            Some(RunEvent::Gap { seconds, .. }) => seconds,
            _ => None,
        };
        let last = Some(at(10.0));
        assert_eq!(
            [gap_s(Some(0.5), last, 10.5, 0.0), gap_s(Some(0.5), last, 10.75, 0.0)],
            [None, Some(0.75)]
        );
        assert_eq!([gap_s(Some(0.5), last, 11.0, 1.0), gap_s(Some(0.5), last, 11.5, 1.0)], [None, Some(1.5)]);
        assert_eq!([gap_s(Some(0.5), None, 99.0, 0.0), gap_s(None, last, 99.0, 0.0)], [None, None]);
    }

    /// The last bytes came at 10 s, and the run ends at 15 s; the bar is stopped until 19 s.
    #[test]
    fn silence_after_the_end_of_the_program_is_no_loss() {
        let directory = tempfile::tempdir().unwrap();
        let definition = ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap();
        for (ending, silent_s, gaps) in [(EndReason::Stopped, 5.0, 1), (EndReason::Mark, 0.0, 0)] {
            let writer = CaptureWriter::create(&directory.path().join(format!("{gaps}.dbbd"))).unwrap();
            let mut recorder = Recorder::new(writer, &definition, Some(1), at(0.0));
            recorder.stream.silent.last_bytes = Some(at(10.0));
            recorder.watched_to_the_end(at(15.0), 5.0);
            let progress = recorder.finish(at(19.0), ending).unwrap();
            let found = (progress.silent_s, progress.stood_still_s, progress.counts.gaps);
            assert_eq!(found, (silent_s, 0.0, gaps));
        }
    }

    /// A sample of 13.0 s, its step of the bar's clock, and whether its number is the next one.
    fn lost(silent: &mut SilentTime, step_s: Option<f64>, is_next: bool) -> [f64; 2] {
        let Times { of_bar_s, of_computer_s } =
            silent.explained_by(Continuity { host: at(13.0), step_s, is_next });
        [of_bar_s, of_computer_s]
    }

    /// 3 s without a byte, of which the line was watched for all or 0.1 s. Nothing is lost if the bar's clock went on by one
    /// sample; a sequence number that is the next one acquits this computer, and not a bar that paused.
    #[test]
    fn only_watched_time_is_silence_of_the_bar() {
        let after = |watched_s: f64, step_s: Option<f64>, is_next: bool| {
            let mut silent = silent(Some(0.5), Some(at(10.0)));
            silent.until(at(13.0), watched_s, 0.0);
            lost(&mut silent, step_s, is_next)
        };
        for step_s in [None, Some(3.0)] {
            assert_eq!(after(3.0, step_s, false), [3.0, 0.0]);
            assert_eq!(after(0.1, step_s, false), [0.0, 2.9]);
            assert_eq!(after(3.0, step_s, true), [3.0, 0.0]);
            assert_eq!(after(0.1, step_s, true), [0.0, 0.0]);
        }
        for watched_s in [3.0, 0.1] {
            assert_eq!(after(watched_s, Some(0.9), false), [0.0, 0.0]);
        }
        // Half of it each is neither: a second is usual for both.
        let mut both = silent(Some(0.5), Some(at(10.0)));
        both.until(at(11.9), 0.95, 0.0);
        assert_eq!(both.unexplained, None);
    }

    /// The driver kept 0.7 s of the 3 s in which this computer stood still: samples go on first, and the step comes then.
    #[test]
    fn a_step_behind_what_the_driver_kept_is_lost_time() {
        let mut silent = silent(Some(0.5), Some(at(10.0)));
        silent.until(at(13.0), 0.0, 0.0);
        for _ in 0..7 {
            assert_eq!(lost(&mut silent, Some(0.1), false), [0.0, 0.0]);
        }
        assert_eq!(lost(&mut silent, Some(2.3), false), [0.0, 3.0]);
        assert_eq!(silent.unexplained, None);
        // Where all of it was kept the bar's clock catches up, and a later step is another matter.
        silent.until(at(13.0), 0.0, 0.0);
        for _ in 0..21 {
            assert_eq!(lost(&mut silent, Some(0.1), false), [0.0, 0.0]);
        }
        assert_eq!(lost(&mut silent, Some(2.3), false), [0.0, 0.0]);
        // What the line held was read, and then the bar was silent.
        silent.until(at(13.0), 0.0, 0.0);
        assert_eq!(lost(&mut silent, Some(0.1), false), [0.0, 0.0]);
        silent.until(at(13.0), 3.0, 0.0);
        assert_eq!(silent.left(), Times { of_bar_s: 3.0, of_computer_s: 0.0 });
        // The run is over when what the driver kept was read: what it lost did not come any more.
        silent.until(at(13.0), 0.0, 0.0);
        assert_eq!(lost(&mut silent, Some(0.7), false), [0.0, 0.0]);
        assert_eq!(silent.left(), Times { of_bar_s: 0.0, of_computer_s: 3.0 });
    }

    #[test]
    fn gap_is_the_number_of_samples_between_two_sequence_numbers() {
        let mut numbers = SequenceNumbers { modulo: Some(256), last: None };
        let mut missing = |sequence| {
            let sample = Sample { sequence: Some(sequence), ..Sample::of(0.0) };
            numbers.gap(&sample).map(|(missing, _)| missing)
        };
        assert_eq!([missing(5), missing(6), missing(10)], [None, None, Some(Some(3))]);
        // The counter wraps: 221 to 255 and 0 and 1 are 37. More than half of the range is a step back.
        assert_eq!([missing(130), missing(220), missing(2)], [119, 89, 37].map(|few| Some(Some(few))));
        assert_eq!(missing(250), Some(None));
        let mut none = SequenceNumbers { modulo: None, last: Some(1) };
        assert_eq!(none.gap(&Sample { sequence: Some(9), ..Sample::of(0.0) }), None);
    }

    #[test]
    fn events_beyond_the_rate_are_counted() {
        let mut rate = EventRate::new(at(1.0));
        let gap = || RunEvent::Gap { seconds: None, missing: Some(3), reason: String::new() };
        assert_eq!((0..300).filter(|_| rate.admits(&gap())).count(), 200);
        assert!(!rate.admits(&RunEvent::Mark { text: String::new() }));
        let telegram = RunEvent::Controller { index: 1, phase: 1, axes_deg: [0.0; 6] };
        assert!(rate.admits(&telegram));
        assert_eq!(rate.due(at(1.9)), None);
        assert_eq!(rate.due(at(2.0)), Some(RunEvent::Withheld { gaps: 100, missing: 300, others: 1 }));
        assert!(rate.admits(&gap()));
        assert_eq!((rate.due(at(2.9)), rate.due(at(3.0)), rate.withheld()), (None, None, None));
    }

    #[test]
    fn polled_reading_has_the_time_of_its_request() {
        let requests = PollRequests { last: Some(at(2.0)), is_latched: true, latch_delay_ns: 3_000_000 };
        assert_eq!(requests.time_of_reading(at(2.07)), HostNs(2_003_000_000));
        assert_eq!(PollRequests { is_latched: false, ..requests }.time_of_reading(at(2.07)), at(2.07));
        let unasked = PollRequests { last: None, is_latched: true, latch_delay_ns: 3_000_000 };
        assert_eq!(unasked.time_of_reading(at(2.07)), at(2.07));
    }
}
