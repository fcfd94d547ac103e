//! The recorder writes arriving bytes raw, then decodes them and writes the samples and faults, and counts. It reads no
//! clock: the caller gives the time of each arrival, so that a recorded line can be replayed.

use std::path::Path;

use serde::Serialize;

use super::live_state::LiveFeed;
use super::program_end::ProgramEnd;
use dbbd_device::protocol::{DecodedItem, LineFault, LineFaultKind, ProtocolDecoder, ProtocolDefinition};
use dbbd_job::recording::RecordingFinding;
use dbbd_job::recording::axes::{AxesReceiver, AxesRecords, PacketCounts};
use dbbd_job::recording::capture::{CaptureRecord, CaptureWriter, RunEvent};
use dbbd_job::recording::{ClockStamp, DeviceTime, SequenceStep, sequence_step};
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;

/// Shorter silence is not recorded where sequence numbers show losses, s: radio links deliver batches of a second.
const SILENCE_S: f64 = 2.5;
/// Shorter silence may be caused by a busy host, s.
const SILENT_S: f64 = 1.0;
/// The first faults in a row have one record each. Further faults of the same kind share one.
const ONE_BY_ONE: u32 = 16;
/// Interval between checks of the capture file, s.
const CHECK_S: f64 = 0.5;

/// The counts of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RunProgress {
    /// Host time.
    pub elapsed_s: f64,
    /// Device time since the first sample, if the device has a clock.
    pub device_s: Option<f64>,
    pub bytes: u64,
    pub samples: u64,
    /// Samples that the device flags as invalid.
    pub invalid: u64,
    /// Over the last second.
    pub rate_hz: f64,
    /// The last reading, and whether the device flags it as valid.
    pub reading_mm: Option<f64>,
    pub valid: bool,
    pub faults: u64,
    /// Replies of the device without a reading.
    pub rejected: u64,
    pub unanswered: u64,
    pub gaps: u64,
    /// Time in which nothing came for more than a second, or the port was absent.
    pub silent_s: f64,
    /// Samples missing by their sequence numbers.
    pub missing: u64,
    /// Bytes lost between port and recorder.
    pub lost_bytes: u64,
    /// Completed dwells, by the strobe or by telegrams.
    pub dwells: u32,
    /// Completed modules, by their end marks.
    pub modules: u32,
    /// Recorded telegrams of the program.
    pub telegrams: u64,
    /// Telegrams of another plan or of no dwell.
    pub refused: u64,
    /// Packets of a controller that publishes its axes.
    pub axes: Option<PacketCounts>,
    /// Whether consecutive frames were decoded without a fault.
    pub in_step: bool,
    /// Whether the port is absent at this moment.
    pub gone: bool,
}

/// The recorder of one run.
pub struct Recorder {
    writer: CaptureWriter,
    decoder: ProtocolDecoder,
    decoded: Vec<DecodedItem>,
    /// Samples of one host time that are not written yet.
    batch: Vec<Sample>,
    batch_host: HostNs,
    /// Faults since the last sample.
    faults_in_a_row: u32,
    /// Not written yet: the next fault may join it.
    fault: Option<(HostNs, LineFault)>,
    program: ProgramEnd,
    time: Option<DeviceTime>,
    sequence_modulo: Option<u32>,
    last_sequence: Option<u32>,
    /// Longer silence is recorded, s.
    silence_s: Option<f64>,
    last_bytes: Option<HostNs>,
    last_sync: HostNs,
    last_check: HostNs,
    sync_s: f64,
    rate_since: HostNs,
    rate_samples: u64,
    /// Time of the last request of a polled device.
    requested: Option<HostNs>,
    /// Whether the reading belongs to the time of the request, `latch_delay_ns` later.
    at_request: bool,
    latch_delay_ns: u64,
    in_a_row: u32,
    sync_frames: u32,
    began: HostNs,
    pub progress: RunProgress,
    /// Interference of other programs with the capture file.
    pub(super) findings: Vec<Diagnostic>,
    axes: AxesRecords,
    pub(super) feed: Option<LiveFeed>,
}

impl Recorder {
    /// `modules` is the number of modules of the plan's program. The capture is synced to the disk every `sync_s` seconds.
    pub fn new(
        writer: CaptureWriter,
        definition: &ProtocolDefinition,
        modules: Option<usize>,
        sync_s: f64,
        now: HostNs,
    ) -> Self {
        let stall = definition.stall.map(|stall| stall.as_secs_f64());
        Self {
            writer,
            decoder: definition.decoder(),
            decoded: Vec::new(),
            batch: Vec::new(),
            batch_host: now,
            faults_in_a_row: 0,
            fault: None,
            program: ProgramEnd::new(modules),
            time: definition.clock.map(|clock| DeviceTime::new(clock.into())),
            sequence_modulo: definition.sequence_modulo,
            last_sequence: None,
            silence_s: stall.map(|s| if definition.sequence_modulo.is_some() { s.max(SILENCE_S) } else { s }),
            last_bytes: None,
            last_sync: now,
            last_check: now,
            sync_s,
            rate_since: now,
            rate_samples: 0,
            requested: None,
            at_request: definition.latch_at_request,
            latch_delay_ns: u64::try_from(definition.latch_delay.as_nanos()).unwrap_or(0),
            in_a_row: 0,
            sync_frames: definition.sync_frames,
            began: now,
            progress: RunProgress::default(),
            findings: Vec::new(),
            axes: AxesRecords::default(),
            feed: None,
        }
    }

    /// Whether the program's end marks have been seen.
    pub(super) fn over(&self) -> bool {
        self.program.is_over()
    }

    pub fn event(&mut self, host: HostNs, event: RunEvent) -> Result<(), Diagnostic> {
        if matches!(event, RunEvent::Gap { .. }) {
            self.progress.gaps += 1;
        }
        self.flush()?;
        self.flush_fault()?;
        let record = CaptureRecord::Event(event);
        self.axes.add(host, &record, |_, _, _| {});
        self.writer.write(host, &record)
    }

    /// Records bytes of a controller that publishes its axes.
    pub fn axes(&mut self, host: HostNs, bytes: Vec<u8>) -> Result<(), Diagnostic> {
        let record = CaptureRecord::Axes(bytes);
        self.writer.write(host, &record)?;
        self.axes.add(host, &record, |_, _, _| {});
        Ok(())
    }

    pub(super) fn attach(&mut self, host: HostNs, name: &str, content: &[u8]) -> Result<(), Diagnostic> {
        self.writer.write(host, &CaptureRecord::Attachment { name: name.into(), content: content.to_vec() })
    }

    /// Records bytes of the bar: they are written before they are decoded.
    pub fn bytes(&mut self, host: HostNs, bytes: Vec<u8>) -> Result<(), Diagnostic> {
        self.silent(host, 0.0)?;
        self.last_bytes = Some(host);
        self.progress.bytes += bytes.len() as u64;
        let record = CaptureRecord::Raw(bytes);
        self.writer.write(host, &record)?;
        if let CaptureRecord::Raw(bytes) = &record {
            self.decoder.push(bytes, &mut self.decoded);
        }
        self.decoded(host)
    }

    /// Records a silence since the last bytes, if it exceeds the limit of the device and `least_s`.
    fn silent(&mut self, host: HostNs, least_s: f64) -> Result<(), Diagnostic> {
        let (Some(last), Some(limit)) = (self.last_bytes, self.silence_s) else { return Ok(()) };
        let silent_s = host.seconds_since(last);
        if silent_s <= limit.max(least_s) {
            return Ok(());
        }
        if silent_s > SILENT_S {
            self.progress.silent_s += silent_s;
        }
        let reason = "nothing was received".into();
        self.event(host, RunEvent::Gap { seconds: Some(silent_s), missing: None, reason })
    }

    /// Notes a request to a polled device.
    pub(super) fn requested(&mut self, host: HostNs) {
        self.requested = Some(host);
    }

    /// A request was not answered in time. Bytes of a partial reply do not belong to the next one.
    pub(super) fn unanswered(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        self.progress.unanswered += 1;
        self.decoder.interrupt(&mut self.decoded);
        self.decoded(host)
    }

    /// Replies so far: samples and refusals.
    pub(super) fn answers(&self) -> u64 {
        self.progress.samples + self.progress.rejected
    }

    /// The line was idle for long enough to end a frame.
    pub(super) fn silence(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        self.decoder.silence(&mut self.decoded);
        self.decoded(host)
    }

    /// Bytes were lost between port and recorder.
    pub fn lost(&mut self, host: HostNs, bytes: u64) -> Result<(), Diagnostic> {
        self.progress.lost_bytes += bytes;
        self.interrupted(host)?;
        let reason = format!("{bytes} bytes were lost: the recorder was too slow");
        self.event(host, RunEvent::Gap { seconds: None, missing: None, reason })
    }

    /// The stream was interrupted: a pending frame will not be completed.
    pub fn interrupted(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        self.decoder.interrupt(&mut self.decoded);
        self.last_bytes = None;
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
                        LineFaultKind::Reject(_) => self.progress.rejected += 1,
                        _ => {
                            self.progress.faults += 1;
                            self.in_a_row = 0;
                        }
                    }
                    self.fault(host, fault)?;
                }
            }
        }
        self.decoded = decoded;
        self.flush()
    }

    fn fault(&mut self, host: HostNs, fault: LineFault) -> Result<(), Diagnostic> {
        self.flush()?;
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

    fn flush_fault(&mut self) -> Result<(), Diagnostic> {
        let Some((host, fault)) = self.fault.take() else { return Ok(()) };
        let json = serde_json::to_vec(&fault)
            .map_err(|error| RecordingFinding::EventNotWritten { why: error.to_string() })?;
        self.writer.write(host, &CaptureRecord::Fault(json))
    }

    /// Writes the pending samples. Records keep the order of arrival.
    fn flush(&mut self) -> Result<(), Diagnostic> {
        if self.batch.is_empty() {
            return Ok(());
        }
        let record = CaptureRecord::Samples(std::mem::take(&mut self.batch));
        self.writer.write(self.batch_host, &record)?;
        if let CaptureRecord::Samples(mut batch) = record {
            batch.clear();
            self.batch = batch;
        }
        Ok(())
    }

    fn sample(&mut self, host: HostNs, sample: &Sample) -> Result<(), Diagnostic> {
        // A polled reading belongs to the time of its request. The reply comes up to 70 ms later.
        let host = match self.requested.filter(|_| self.at_request) {
            Some(HostNs(ns)) => HostNs(ns.saturating_add(self.latch_delay_ns)),
            None => host,
        };
        self.flush_fault()?;
        self.faults_in_a_row = 0;
        self.missing(host, sample)?;
        if self.batch_host != host {
            self.flush()?;
            self.batch_host = host;
        }
        self.batch.push(*sample);
        self.in_a_row = self.in_a_row.saturating_add(1);
        self.progress.in_step |= self.in_a_row >= self.sync_frames;
        self.progress.samples += 1;
        self.progress.reading_mm = Some(sample.reading_mm);
        self.progress.valid = sample.valid;
        self.progress.invalid += u64::from(!sample.valid);
        let device = self.time.as_mut().zip(sample.ticks);
        let device_s = device.map(|(time, ticks)| time.seconds(ClockStamp { host, ticks }));
        self.program.push(device_s.unwrap_or_else(|| host.seconds_since(self.began)), sample);
        self.progress.device_s = device_s;
        self.progress.dwells = self.progress.dwells.max(self.program.dwells);
        self.progress.modules = self.program.modules_over;
        let Some(feed) = &mut self.feed else { return Ok(()) };
        feed.dwell(self.progress.dwells, self.program.high_since_s(), sample);
        match feed.sample(host, device_s, sample, self.progress.dwells) {
            Some(note) => {
                self.event(host, RunEvent::Finding { code: note.code.as_str().into(), text: note.text })
            }
            None => Ok(()),
        }
    }

    /// Records a gap in the sequence numbers.
    fn missing(&mut self, host: HostNs, sample: &Sample) -> Result<(), Diagnostic> {
        let (Some(modulo), Some(sequence)) = (self.sequence_modulo, sample.sequence) else { return Ok(()) };
        let Some(last) = self.last_sequence.replace(sequence) else { return Ok(()) };
        let (missing, reason) = match sequence_step(modulo, last, sequence) {
            SequenceStep::Next => return Ok(()),
            SequenceStep::Missing(few) => {
                (Some(few), "samples are missing by their sequence numbers".to_owned())
            }
            SequenceStep::Back => (None, format!("the sequence number went from {last} to {sequence}")),
        };
        self.progress.missing += missing.unwrap_or(0);
        self.event(host, RunEvent::Gap { seconds: None, missing, reason })
    }

    /// The device was restarted: its sequence numbers may begin again.
    pub(super) fn restarted(&mut self) {
        self.last_sequence = None;
    }

    /// Regular work: sync, rate, live frames, checks of the capture file.
    pub fn tick(&mut self, now: HostNs) -> Result<(), Diagnostic> {
        self.progress.elapsed_s = now.seconds_since(self.began);
        self.progress.axes = self.axes.receiver().map(AxesReceiver::counts);
        if self.fault.as_ref().is_some_and(|(since, _)| now.seconds_since(*since) >= CHECK_S) {
            self.flush_fault()?;
        }
        if let Some(feed) = &mut self.feed {
            feed.tick(now);
        }
        let since = now.seconds_since(self.rate_since);
        if since >= 1.0 {
            self.progress.rate_hz = (self.progress.samples - self.rate_samples) as f64 / since;
            (self.rate_since, self.rate_samples) = (now, self.progress.samples);
        }
        if now.seconds_since(self.last_sync) >= self.sync_s {
            self.writer.sync()?;
            self.last_sync = now;
        }
        if now.seconds_since(self.last_check) >= CHECK_S {
            self.last_check = now;
            self.check_file()?;
        }
        Ok(())
    }

    fn check_file(&mut self) -> Result<(), Diagnostic> {
        self.findings.extend(self.writer.look_after()?);
        Ok(())
    }

    pub(super) fn path(&self) -> &Path {
        self.writer.path()
    }

    /// Completes the capture.
    pub fn finish(&mut self, now: HostNs, reason: &str) -> Result<RunProgress, Diagnostic> {
        // Shorter silence may be caused by the end of the run itself.
        self.silent(now, SILENT_S)?;
        self.interrupted(now)?;
        self.flush_fault()?;
        self.program.finish();
        self.progress.dwells = self.progress.dwells.max(self.program.dwells);
        self.progress.elapsed_s = now.seconds_since(self.began);
        self.progress.axes = self.axes.receiver().map(AxesReceiver::counts);
        self.check_file()?;
        self.writer.finish(now, reason, self.progress.missing)?;
        self.check_file()?;
        Ok(self.progress)
    }
}
