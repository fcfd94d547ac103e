//! The live state of a run: frames a few times a second, and a point per dwell. The stream drops messages that are not
//! read, so that no client can hold up the recorder.

use std::sync::{Arc, Mutex};

use tokio::sync::broadcast;

use super::mount_detector::{MountDetector, MountReading};
use super::schedule::Schedule;
use crate::live::{Alarm, Frame, Message, Mounting, MountingNote, Point};
use dbbd_device::clock;
use dbbd_device::sync::lock;
use dbbd_job::recording::mounting::{ExpectedMounting, MountedReading, MountingMonitor};
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Finding;
use dbbd_model::measurement::sample::Sample;

/// Host time of a frame, s.
const FRAME_S: f64 = 0.05;
/// Findings about the mounting that are kept.
const MAX_FINDINGS: usize = 20;

/// The state that is shared with clients.
#[derive(Clone, Debug)]
pub struct LiveState {
    pub messages: broadcast::Sender<Message>,
    pub run: Arc<Mutex<LiveRun>>,
}

/// The current run, or the last one.
#[derive(Debug, Default)]
pub struct LiveRun {
    /// The completed dwells.
    pub points: Vec<Point>,
    /// Drift of the device's clock against the host's since the first sample, ms.
    pub clock_ahead_ms: Option<f64>,
    pub mounting: Mounting,
}

/// The recorder's side of the live state.
#[derive(Debug)]
pub struct LiveFeed {
    state: LiveState,
    schedule: Schedule,
    mount: MountDetector,
    monitor: MountingMonitor,
    temperature_c: Option<f64>,
    /// Wall clock minus monotonic host clock, ns.
    wall_ns: f64,
    first: Option<(HostNs, Option<f64>)>,
    /// The frame in progress and its begin.
    frame: Option<(HostNs, Frame)>,
    frames: u64,
    strobe: StrobeMean,
    dwells: u32,
}

/// The readings since the strobe rose.
#[derive(Clone, Copy, Debug, Default)]
struct StrobeMean {
    since_s: Option<f64>,
    sum_mm: f64,
    samples: u32,
}

impl LiveFeed {
    pub fn new(state: LiveState, schedule: Schedule, expected: ExpectedMounting) -> Self {
        let wall_ns = clock::unix_ns() as f64 - clock::now().0 as f64;
        Self {
            state,
            schedule,
            mount: MountDetector::default(),
            monitor: MountingMonitor::new(expected),
            temperature_c: None,
            wall_ns,
            first: None,
            frame: None,
            frames: 0,
            strobe: StrobeMean::default(),
            dwells: 0,
        }
    }

    /// Adds a recorded sample; `device_s` is its device time since the first one, `dwells` the completed dwells.
    /// Returns what it shows of the mounting.
    pub(super) fn sample(
        &mut self,
        host: HostNs,
        device_s: Option<f64>,
        sample: &Sample,
        dwells: u32,
    ) -> Option<MountingNote> {
        let (first, first_device) = *self.first.get_or_insert((host, device_s));
        let host_s = host.seconds_since(first);
        let device_s = device_s.zip(first_device).map(|(now, first)| now - first);
        if let Some(device_s) = device_s {
            lock(&self.state.run).clock_ahead_ms = Some(1e3 * (device_s - host_s));
        }
        let t_s = device_s.unwrap_or(host_s);
        let reading_mm = sample.reading_mm;
        let now = MountReading { t_s: host_s, reading_mm, valid: sample.valid, dwells };
        let alarm = self.mount.alarm(&self.schedule, now);
        let unix_ms = (host.0 as f64 + self.wall_ns) * 1e-6;
        let empty = Frame {
            frame: self.frames + 1,
            min_mm: reading_mm,
            max_mm: reading_mm,
            mounted: true,
            valid: true,
            ..Frame::default()
        };
        let (began, frame) = self.frame.get_or_insert((host, empty));
        frame.samples += 1;
        frame.t_s = t_s;
        frame.unix_ms = unix_ms;
        frame.span_ms = 1e3 * host.seconds_since(*began);
        frame.min_mm = frame.min_mm.min(reading_mm);
        frame.max_mm = frame.max_mm.max(reading_mm);
        frame.last_mm = reading_mm;
        frame.alarm = frame.alarm.max(alarm.unwrap_or_default());
        frame.mounted &= alarm.is_some();
        frame.strobe = sample.trigger;
        frame.valid &= sample.valid;
        self.temperature_c = sample.temperature_c.or(self.temperature_c);
        let mounted = sample.valid && alarm.is_some_and(|alarm| alarm != Alarm::Over);
        let named = self.monitor.push(MountedReading { t_s, reading_mm, mounted, strobe: sample.trigger })?;
        let finding = named.finding();
        let note = MountingNote {
            code: finding.code(),
            text: finding.to_string(),
            size_um: 1e3 * named.size,
            unix_ms: unix_ms.max(0.0) as u64,
        };
        let mut run = lock(&self.state.run);
        if run.mounting.findings.len() >= MAX_FINDINGS {
            run.mounting.findings.remove(0);
        }
        run.mounting.findings.push(note.clone());
        drop(run);
        self.send("mounting", &note);
        Some(note)
    }

    /// Adds a sample to the mean of its dwell, and publishes the point of a dwell that is complete.
    pub(super) fn dwell(&mut self, dwells: u32, strobe_high_since_s: Option<f64>, sample: &Sample) {
        if dwells > self.dwells && self.strobe.samples > 0 {
            let StrobeMean { sum_mm, samples, .. } = std::mem::take(&mut self.strobe);
            let point = self.schedule.point(dwells, sum_mm / f64::from(samples));
            lock(&self.state.run).points.push(point);
            self.send("point", &point);
        }
        self.dwells = dwells;
        if strobe_high_since_s.is_some() && strobe_high_since_s != self.strobe.since_s {
            self.strobe = StrobeMean { since_s: strobe_high_since_s, ..StrobeMean::default() };
        }
        if sample.trigger == Some(true) {
            self.strobe.sum_mm += sample.reading_mm;
            self.strobe.samples += 1;
        }
    }

    /// Publishes the frame if it is long enough.
    pub(super) fn tick(&mut self, now: HostNs) {
        let Some((_, frame)) = self.frame.take_if(|(began, _)| now.seconds_since(*began) >= FRAME_S) else {
            return;
        };
        self.frames = frame.frame;
        let scatter = self.monitor.scatter().map(|scatter| scatter.map(|mm| 1e3 * mm));
        let mut run = lock(&self.state.run);
        run.mounting.state = self.monitor.state().name();
        (run.mounting.scatter_um, run.mounting.drift_um_s) = scatter.map(|[sd, drift]| (sd, drift)).unzip();
        run.mounting.temperature_c = self.temperature_c;
        drop(run);
        self.send("frame", &frame);
    }

    fn send(&self, event: &'static str, content: &impl serde::Serialize) {
        // Fails without a receiver.
        let _ = self.state.messages.send(Message::new(event, content));
    }
}
