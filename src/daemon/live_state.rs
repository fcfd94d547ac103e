//! The live state of a run: frames a few times a second, and each dwell. No client can hold the recorder up: the stream
//! drops what is not read.

use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::broadcast;

use super::mount_detector::{MountDetector, Reading};
use super::schedule::Schedule;
use crate::base::clock;
use crate::base::sync::lock;
use crate::base::units::HostNs;
use crate::diagnostic::Finding;
use crate::live::{Alarm, Frame, Message, Mounting, MountingNote, Point};
use crate::measurement::sample::Sample;
use crate::recording::mounting::{Expected, MountedReading, MountingMonitor};

/// Host time that a picture gathers, s.
const PICTURE_S: f64 = 0.05;
/// Findings about the mounting that are kept.
const MOST_FINDINGS: usize = 20;

/// What is shared with the clients.
#[derive(Clone, Debug)]
pub struct LiveState {
    pub messages: broadcast::Sender<Message>,
    /// The dwells so far.
    pub points: Arc<Mutex<Vec<Point>>>,
    /// By how much the device's clock is ahead of the host's since the first sample, ms.
    pub clock_ahead_ms: Arc<Mutex<Option<f64>>>,
    pub mounting: Arc<Mutex<Mounting>>,
}

/// What the recorder has counted when it hands over a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counted {
    /// Dwells that are over.
    pub(super) dwells: u32,
    /// Since when the strobe is high, s.
    pub(super) high_since_s: Option<f64>,
}

/// The recorder's side.
#[derive(Debug)]
pub struct Feed {
    state: LiveState,
    schedule: Schedule,
    mount: MountDetector,
    monitor: MountingMonitor,
    temperature_c: Option<f64>,
    /// Wall clock less the host's monotonic one, ns.
    wall_ns: f64,
    first: Option<(HostNs, Option<f64>)>,
    picture: Option<(HostNs, Frame)>,
    frames: u64,
    strobe: StrobeMean,
    dwells: u32,
}

/// The readings while the strobe was high, since it rose.
#[derive(Clone, Copy, Debug, Default)]
struct StrobeMean {
    since_s: Option<f64>,
    sum_mm: f64,
    samples: u32,
}

impl Feed {
    pub fn new(state: LiveState, schedule: Schedule, expected: Expected) -> Self {
        let wall_ns = clock::unix_ns() as f64 - clock::now().0 as f64;
        Self {
            state,
            schedule,
            mount: MountDetector::default(),
            monitor: MountingMonitor::new(expected),
            temperature_c: None,
            wall_ns,
            first: None,
            picture: None,
            frames: 0,
            strobe: StrobeMean::default(),
            dwells: 0,
        }
    }

    /// A sample was written; `device_s` is its device time since the first one. What it shows of the mounting.
    pub(super) fn sample(
        &mut self,
        host: HostNs,
        device_s: Option<f64>,
        sample: &Sample,
        counted: Counted,
    ) -> Option<MountingNote> {
        let (first, first_device) = *self.first.get_or_insert((host, device_s));
        let host_s = host.seconds_since(first);
        let device_s = device_s.zip(first_device).map(|(now, first)| now - first);
        if let Some(device_s) = device_s {
            // A lock that nobody holds for longer than a copy.
            *lock(&self.state.clock_ahead_ms) = Some(1e3 * (device_s - host_s));
        }
        let reading = sample.reading_mm;
        let now = Reading { t_s: host_s, reading_mm: reading, valid: sample.valid, dwells: counted.dwells };
        let alarm = self.mount.alarm(&self.schedule, now);
        let (began, frame) = self.picture.get_or_insert((host, begun(self.frames + 1, reading)));
        frame.samples += 1;
        frame.t_s = device_s.unwrap_or(host_s);
        frame.unix_ms = (host.0 as f64 + self.wall_ns) * 1e-6;
        frame.span_ms = 1e3 * host.seconds_since(*began);
        frame.min_mm = frame.min_mm.min(reading);
        frame.max_mm = frame.max_mm.max(reading);
        frame.last_mm = reading;
        frame.alarm = frame.alarm.max(alarm.unwrap_or_default());
        frame.mounted &= alarm.is_some();
        frame.strobe = sample.trigger;
        frame.valid &= sample.valid;
        self.dwell(sample, counted);
        self.temperature_c = sample.temperature_c.or(self.temperature_c);
        let mounted = sample.valid && alarm.is_some_and(|alarm| alarm != Alarm::Over);
        let t_s = device_s.unwrap_or(host_s);
        let read = MountedReading { t_s, reading_mm: reading, mounted, strobe: sample.trigger };
        let named = self.monitor.push(read)?;
        let finding = named.finding();
        let unix_ms = ((host.0 as f64 + self.wall_ns) * 1e-6).max(0.0) as u64;
        let (code, text, size_um) = (finding.code(), finding.to_string(), 1e3 * named.size);
        let note = MountingNote { code, text, size_um, unix_ms };
        let mut mounting = self.mounting();
        if mounting.findings.len() >= MOST_FINDINGS {
            mounting.findings.remove(0);
        }
        mounting.findings.push(note.clone());
        drop(mounting);
        self.send("mounting", &note);
        Some(note)
    }

    fn mounting(&self) -> MutexGuard<'_, Mounting> {
        lock(&self.state.mounting)
    }

    fn dwell(&mut self, sample: &Sample, counted: Counted) {
        if counted.dwells > self.dwells && self.strobe.samples > 0 {
            let StrobeMean { sum_mm, samples, .. } = std::mem::take(&mut self.strobe);
            let point = self.schedule.point(counted.dwells, sum_mm / f64::from(samples));
            lock(&self.state.points).push(point);
            self.send("point", &point);
        }
        self.dwells = counted.dwells;
        if counted.high_since_s.is_some() && counted.high_since_s != self.strobe.since_s {
            self.strobe = StrobeMean { since_s: counted.high_since_s, ..StrobeMean::default() };
        }
        if sample.trigger == Some(true) {
            self.strobe.sum_mm += sample.reading_mm;
            self.strobe.samples += 1;
        }
    }

    /// Shows the picture if it has gathered for long enough.
    pub(super) fn tick(&mut self, now: HostNs) {
        if self.picture.is_some_and(|(began, _)| now.seconds_since(began) >= PICTURE_S)
            && let Some((_, frame)) = self.picture.take()
        {
            self.frames = frame.frame;
            let scatter = self.monitor.scatter().map(|scatter| scatter.map(|mm| 1e3 * mm));
            let mut mounting = self.mounting();
            mounting.state = self.monitor.state().name();
            (mounting.scatter_um, mounting.drift_um_s) = scatter.map(|[sd, drift]| (sd, drift)).unzip();
            mounting.temperature_c = self.temperature_c;
            drop(mounting);
            self.send("frame", &frame);
        }
    }

    fn send(&self, event: &'static str, content: &impl serde::Serialize) {
        // Nobody may be looking.
        let _ = self.state.messages.send(Message::new(event, content));
    }
}

/// The frame with this number, before its first sample, which reads so.
fn begun(number: u64, reading_mm: f64) -> Frame {
    Frame {
        frame: number,
        t_s: 0.0,
        unix_ms: 0.0,
        span_ms: 0.0,
        samples: 0,
        min_mm: reading_mm,
        max_mm: reading_mm,
        last_mm: reading_mm,
        alarm: Alarm::None,
        mounted: true,
        strobe: None,
        valid: true,
    }
}
