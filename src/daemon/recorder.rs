//! Writes what arrives, raw first, then what it decodes to, and counts. It reads no clock: who hands over the
//! bytes says when they came, so a recorded line can be put through it again.

use std::path::Path;

use super::live_state::{Counted, Feed};
use super::program_end::ProgramEnd;
use super::progress::Progress;
use crate::base::units::HostNs;
use crate::catalogue::RecordingFinding;
use crate::device::protocol::{Decoded, Decoder, Definition, Fault, FaultKind};
use crate::diagnostic::Diagnostic;
use crate::measurement::sample::Sample;
use crate::recording::axes::{AxesReceiver, AxesRecords};
use crate::recording::capture::{Event, Record, Writer};
use crate::recording::{DeviceTime, SequenceStep, Stamp, sequence_step};

/// Silence below this is not worth a record where sequence numbers show what is missing, s: radio links
/// hand over batches of a second.
const SILENCE_S: f64 = 2.5;
/// Silence below this may be that of a host that is busy, s.
const SILENT_S: f64 = 1.0;
/// So many faults in a row have a record each; more of the same kind share one.
const ONE_BY_ONE: u32 = 16;
/// How often the capture is looked after, s.
const LOOK_S: f64 = 0.5;

/// The recorder of one run.
pub struct Recorder {
    writer: Writer,
    decoder: Decoder,
    decoded: Vec<Decoded>,
    /// Samples of one host time that are not written yet.
    batch: Vec<Sample>,
    batch_host: HostNs,
    /// Faults since the last sample.
    faults_in_a_row: u32,
    /// The fault that is not written yet.
    fault: Option<(HostNs, Fault)>,
    program: ProgramEnd,
    time: Option<DeviceTime>,
    sequence_modulo: Option<u32>,
    last_sequence: Option<u32>,
    /// Silence that is recorded, s.
    silence_s: Option<f64>,
    last_bytes: Option<HostNs>,
    last_sync: HostNs,
    last_look: HostNs,
    sync_s: f64,
    rate_since: HostNs,
    rate_samples: u64,
    /// When the reading that is on its way was asked for, where that dates it.
    requested: Option<HostNs>,
    at_request: bool,
    latch_delay_ns: u64,
    in_a_row: u32,
    sync_frames: u32,
    began: HostNs,
    /// The counts so far.
    pub progress: Progress,
    /// What others did to the capture.
    pub(super) findings: Vec<Diagnostic>,
    axes: AxesRecords,
    /// Who looks on.
    pub(super) feed: Option<Feed>,
}

impl Recorder {
    /// Of a device's stream into a capture that was begun, of a program of so many modules. The disk is made to hold what
    /// was written every `sync_s` seconds.
    pub fn new(
        writer: Writer,
        definition: &Definition,
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
            last_look: now,
            sync_s,
            rate_since: now,
            rate_samples: 0,
            requested: None,
            at_request: definition.latch_at_request,
            latch_delay_ns: u64::try_from(definition.latch_delay.as_nanos()).unwrap_or(0),
            in_a_row: 0,
            sync_frames: definition.sync_frames,
            began: now,
            progress: Progress::default(),
            findings: Vec::new(),
            axes: AxesRecords::default(),
            feed: None,
        }
    }

    /// Whether the program's end marks have been seen.
    pub(super) fn over(&self) -> bool {
        self.program.is_over()
    }

    /// Something happened around the bytes.
    ///
    /// # Errors
    /// When the capture cannot be written.
    pub fn event(&mut self, host: HostNs, event: Event) -> Result<(), Diagnostic> {
        if matches!(event, Event::Gap { .. }) {
            self.progress.gaps += 1;
        }
        self.flush()?;
        self.flush_fault()?;
        let record = Record::Event(event);
        self.axes.add(host, &record, |_, _, _| {});
        self.writer.write(host, &record)
    }

    /// Bytes came from the controller that publishes its axes.
    ///
    /// # Errors
    /// When the capture cannot be written.
    pub fn axes(&mut self, host: HostNs, bytes: Vec<u8>) -> Result<(), Diagnostic> {
        let record = Record::Axes(bytes);
        self.writer.write(host, &record)?;
        self.axes.add(host, &record, |_, _, _| {});
        Ok(())
    }

    pub(super) fn attach(&mut self, host: HostNs, name: &str, content: &[u8]) -> Result<(), Diagnostic> {
        self.writer.write(host, &Record::Attachment { name: name.into(), content: content.to_vec() })
    }

    /// Bytes came: they are on their way to the disk before anyone looks into them.
    ///
    /// # Errors
    /// When the capture cannot be written.
    pub fn bytes(&mut self, host: HostNs, bytes: Vec<u8>) -> Result<(), Diagnostic> {
        self.silent(host, 0.0)?;
        self.last_bytes = Some(host);
        self.progress.bytes += bytes.len() as u64;
        let record = Record::Raw(bytes);
        self.writer.write(host, &record)?;
        if let Record::Raw(bytes) = &record {
            self.decoder.push(bytes, &mut self.decoded);
        }
        self.decoded(host)
    }

    /// Records that nothing came for long, if so; for at least `least_s`.
    fn silent(&mut self, host: HostNs, least_s: f64) -> Result<(), Diagnostic> {
        let silent_s = self.last_bytes.map(|last| host.seconds_since(last));
        match silent_s.zip(self.silence_s).filter(|(silent_s, limit)| *silent_s > limit.max(least_s)) {
            Some((silent_s, _)) => {
                if silent_s > SILENT_S {
                    self.progress.silent_s += silent_s;
                }
                let reason = "nothing was received".into();
                self.event(host, Event::Gap { seconds: Some(silent_s), missing: None, reason })
            }
            None => Ok(()),
        }
    }

    /// A reading was asked for.
    pub(super) fn requested(&mut self, host: HostNs) {
        self.requested = Some(host);
    }

    /// A reading that was asked for did not come: what came of it is no part of the next.
    pub(super) fn unanswered(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        self.progress.unanswered += 1;
        self.decoder.interrupt(&mut self.decoded);
        self.decoded(host)
    }

    /// Readings and refusals so far.
    pub(super) fn answers(&self) -> u64 {
        self.progress.samples + self.progress.rejected
    }

    /// Nothing came for as long as ends a frame, where silence does.
    pub(super) fn silence(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        self.decoder.silence(&mut self.decoded);
        self.decoded(host)
    }

    /// Bytes were thrown away before they came here.
    ///
    /// # Errors
    /// When the capture cannot be written.
    pub fn lost(&mut self, host: HostNs, bytes: u64) -> Result<(), Diagnostic> {
        self.progress.lost_bytes += bytes;
        self.interrupted(host)?;
        let reason = format!("{bytes} bytes were lost: the recorder was too slow");
        self.event(host, Event::Gap { seconds: None, missing: None, reason })
    }

    /// The stream broke off: what is pending will not be completed.
    ///
    /// # Errors
    /// When the capture cannot be written.
    pub fn interrupted(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        self.decoder.interrupt(&mut self.decoded);
        self.last_bytes = None;
        self.decoded(host)
    }

    fn decoded(&mut self, host: HostNs) -> Result<(), Diagnostic> {
        let mut decoded = std::mem::take(&mut self.decoded);
        for one in decoded.drain(..) {
            match one {
                Decoded::Sample(sample, _) => self.sample(host, &sample)?,
                Decoded::Fault(fault) => {
                    match fault.kind {
                        FaultKind::Ignored => {}
                        FaultKind::Reject(_) => self.progress.rejected += 1,
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

    fn fault(&mut self, host: HostNs, fault: Fault) -> Result<(), Diagnostic> {
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
        self.writer.write(host, &Record::Fault(json))
    }

    /// Writes the samples that wait: what comes after them must not stand before them.
    fn flush(&mut self) -> Result<(), Diagnostic> {
        if self.batch.is_empty() {
            return Ok(());
        }
        let record = Record::Samples(std::mem::take(&mut self.batch));
        self.writer.write(self.batch_host, &record)?;
        if let Record::Samples(mut batch) = record {
            batch.clear();
            self.batch = batch;
        }
        Ok(())
    }

    fn sample(&mut self, host: HostNs, sample: &Sample) -> Result<(), Diagnostic> {
        // A polled reading is that of its request, not of the reply, which comes up to 70 ms later.
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
        let device_s = device.map(|(time, ticks)| time.seconds(Stamp { host, ticks }));
        self.program.push(device_s.unwrap_or_else(|| host.seconds_since(self.began)), sample);
        self.progress.device_s = device_s;
        self.progress.dwells = self.progress.dwells.max(self.program.dwells);
        self.progress.modules = self.program.modules_over;
        if let Some(feed) = &mut self.feed {
            let high_since_s = self.program.high_since_s();
            let counted = Counted { dwells: self.progress.dwells, high_since_s };
            if let Some(note) = feed.sample(host, device_s, sample, counted) {
                self.event(host, Event::Finding { code: note.code.0.into(), text: note.text })?;
            }
        }
        Ok(())
    }

    /// Compares the sequence number with the one before.
    fn missing(&mut self, host: HostNs, sample: &Sample) -> Result<(), Diagnostic> {
        let (Some(modulo), Some(sequence)) = (self.sequence_modulo, sample.sequence) else { return Ok(()) };
        let last = self.last_sequence.replace(sequence);
        let Some(last) = last else { return Ok(()) };
        let (missing, reason) = match sequence_step(modulo, last, sequence) {
            SequenceStep::Next => return Ok(()),
            SequenceStep::Missing(few) => {
                (Some(few), "samples are missing by their sequence numbers".to_owned())
            }
            SequenceStep::Back => (None, format!("the sequence number went from {last} to {sequence}")),
        };
        self.progress.missing += missing.unwrap_or(0);
        self.event(host, Event::Gap { seconds: None, missing, reason })
    }

    /// The device was stopped and started: its numbers may begin again.
    pub(super) fn restarted(&mut self) {
        self.last_sequence = None;
    }

    /// Every so often the disk is made to hold what was written; once a second the rate is taken.
    ///
    /// # Errors
    /// When the capture cannot be written.
    pub fn tick(&mut self, now: HostNs) -> Result<(), Diagnostic> {
        self.progress.elapsed_s = now.seconds_since(self.began);
        self.progress.axes = self.axes.receiver().map(AxesReceiver::counts);
        if self.fault.as_ref().is_some_and(|(since, _)| now.seconds_since(*since) >= LOOK_S) {
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
        if now.seconds_since(self.last_look) >= LOOK_S {
            self.last_look = now;
            self.look_after()?;
        }
        Ok(())
    }

    fn look_after(&mut self) -> Result<(), Diagnostic> {
        self.findings.extend(self.writer.look_after()?);
        Ok(())
    }

    /// Where the capture is.
    pub(super) fn path(&self) -> &Path {
        self.writer.path()
    }

    /// Ends the file.
    ///
    /// # Errors
    /// When the capture cannot be written.
    pub fn finish(&mut self, now: HostNs, reason: &str) -> Result<Progress, Diagnostic> {
        // Shorter than this the end of the run may be what ended the stream.
        self.silent(now, SILENT_S)?;
        self.interrupted(now)?;
        self.flush_fault()?;
        self.program.finish();
        self.progress.dwells = self.progress.dwells.max(self.program.dwells);
        self.progress.elapsed_s = now.seconds_since(self.began);
        self.progress.axes = self.axes.receiver().map(AxesReceiver::counts);
        self.look_after()?;
        self.writer.finish(now, reason, self.progress.missing)?;
        self.look_after()?;
        Ok(self.progress)
    }
}
