//! What the recorder shows of a run: pictures a few times a second, and each dwell. Nobody who looks can
//! hold it up: the stream forgets what is not read.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::broadcast;

use super::course::{Course, Watch};
use crate::clock;
use crate::live::{Alarm, Frame, Message, Point};
use crate::sample::Sample;
use crate::units::HostNs;

/// Host time that a picture gathers, s.
const PICTURE_S: f64 = 0.05;

/// What is shared with those who look.
#[derive(Clone, Debug)]
pub struct Shown {
    /// The stream.
    pub messages: broadcast::Sender<Message>,
    /// The dwells so far.
    pub points: Arc<Mutex<Vec<Point>>>,
    /// By how much the device's clock is ahead of the host's since the first sample, ms.
    pub clock_ahead_ms: Arc<Mutex<Option<f64>>>,
}

/// The recorder's side.
#[derive(Debug)]
pub struct Feed {
    shown: Shown,
    course: Course,
    watch: Watch,
    /// Wall clock less the host's monotonic one, ns.
    wall_ns: f64,
    first: Option<(HostNs, Option<f64>)>,
    picture: Option<(HostNs, Frame)>,
    frames: u64,
    /// Sum and number of the readings while the strobe is high.
    strobe: (f64, u32),
    dwells: u32,
}

impl Feed {
    /// For a run.
    pub fn new(shown: Shown, course: Course) -> Self {
        let wall_ns = clock::unix_ns() as f64 - clock::now().0 as f64;
        Self {
            shown,
            course,
            watch: Watch::default(),
            wall_ns,
            first: None,
            picture: None,
            frames: 0,
            strobe: (0.0, 0),
            dwells: 0,
        }
    }

    /// A sample was written; `device_s` is its device time since the first one, `dwells` how many are over.
    pub(super) fn sample(&mut self, host: HostNs, device_s: Option<f64>, sample: &Sample, dwells: u32) {
        let (first, first_device) = *self.first.get_or_insert((host, device_s));
        let host_s = host.seconds_since(first);
        let device_s = device_s.zip(first_device).map(|(now, first)| now - first);
        if let Some(device_s) = device_s {
            // A lock that nobody holds for longer than a copy.
            *self.shown.clock_ahead_ms.lock().unwrap_or_else(PoisonError::into_inner) =
                Some(1e3 * (device_s - host_s));
        }
        let reading = sample.reading_mm;
        let alarm = self.watch.alarm(&self.course, host_s, reading, sample.valid, dwells);
        let (began, frame) = self.picture.get_or_insert((
            host,
            Frame {
                frame: self.frames + 1,
                t_s: 0.0,
                unix_ms: 0.0,
                span_ms: 0.0,
                samples: 0,
                min_mm: reading,
                max_mm: reading,
                last_mm: reading,
                alarm: Alarm::None,
                mounted: true,
                strobe: None,
                valid: true,
            },
        ));
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
        self.dwell(sample, dwells);
    }

    fn dwell(&mut self, sample: &Sample, dwells: u32) {
        if sample.trigger == Some(true) {
            self.strobe = (self.strobe.0 + sample.reading_mm, self.strobe.1 + 1);
            return;
        }
        let (sum, count) = std::mem::take(&mut self.strobe);
        if dwells > self.dwells && count > 0 {
            let point = self.course.point(dwells, sum / f64::from(count));
            self.shown.points.lock().unwrap_or_else(PoisonError::into_inner).push(point);
            self.send("point", &point);
        }
        self.dwells = dwells;
    }

    /// Shows the picture if it has gathered for long enough.
    pub(super) fn tick(&mut self, now: HostNs) {
        if self.picture.is_some_and(|(began, _)| now.seconds_since(began) >= PICTURE_S)
            && let Some((_, frame)) = self.picture.take()
        {
            self.frames = frame.frame;
            self.send("frame", &frame);
        }
    }

    fn send(&self, event: &'static str, content: &impl serde::Serialize) {
        // Nobody may be looking.
        let _ = self.shown.messages.send(Message::new(event, content));
    }
}
