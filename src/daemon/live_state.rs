//! The live state of a run: frames a few times a second, and a point per dwell. The stream drops messages that are not
//! read, so that no client can hold up the recorder.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use tokio::sync::broadcast;

use super::mount_detector::{MountDetector, MountReading};
use super::schedule::Schedule;
use crate::live::{Alarm, Frame, Message, MountingNote, MountingState, Point, ReadingRange};
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

/// Seconds of readings that a page gets when it connects: half an hour is the longest circle of poses.
const MAX_TRACE_S: usize = 1800;

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
    pub mounting: MountingState,
    /// The range of the readings in each second, the newest last.
    pub trace: VecDeque<ReadingRange>,
}

impl LiveRun {
    /// Adds a frame to the trace: to the second in which it lies.
    fn add_to_trace(&mut self, frame: &Frame) {
        let Frame { t_s, min_mm, max_mm, .. } = *frame;
        match self.trace.back_mut().filter(|last| last.t_s.floor() == t_s.floor()) {
            Some(last) => {
                *last =
                    ReadingRange { t_s, min_mm: last.min_mm.min(min_mm), max_mm: last.max_mm.max(max_mm) };
            }
            None => {
                if self.trace.len() >= MAX_TRACE_S {
                    self.trace.pop_front();
                }
                self.trace.push_back(ReadingRange { t_s, min_mm, max_mm });
            }
        }
    }
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

    /// Adds a recorded sample; `device_s` is its device time since the first one, `dwells` the number of completed
    /// dwells. Returns a note about the mounting if the sample shows a fault of it.
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
        if frame.mounted {
            run.add_to_trace(&frame);
        }
        drop(run);
        self.send("frame", &frame);
    }

    fn send(&self, event: &'static str, content: &impl serde::Serialize) {
        // Fails without a receiver.
        let _ = self.state.messages.send(Message::new(event, content));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn feed() -> (LiveFeed, broadcast::Receiver<Message>) {
        let (messages, receiver) = broadcast::channel(64);
        let state = LiveState { messages, run: Arc::default() };
        let schedule = Schedule::bare(Some([-1.0, 3.0]), 0.9);
        (LiveFeed::new(state, schedule, ExpectedMounting::standing(2.0)), receiver)
    }

    fn host(ms: u64) -> HostNs {
        HostNs(1_000_000_000 + ms * 1_000_000)
    }

    #[test]
    fn frame_has_the_extremes_of_its_readings() {
        let (mut feed, _receiver) = feed();
        for (ms, reading_mm, valid) in [(0, 0.5, true), (10, -0.2, true), (20, 1.5, false), (30, 0.7, true)] {
            let sample = Sample { valid, ..Sample::of(reading_mm) };
            feed.sample(host(ms), Some(1e-3 * ms as f64), &sample, 0);
        }
        let (began, frame) = feed.frame.expect("a frame is in progress");
        assert_eq!((began, frame.samples, frame.frame), (host(0), 4, 1));
        assert_eq!([frame.min_mm, frame.max_mm, frame.last_mm], [-0.2, 1.5, 0.7]);
        assert!((frame.span_ms - 30.0).abs() < 1e-9 && !frame.valid);
        // The frame is published after 50 ms.
        feed.tick(host(49));
        assert!(feed.frame.is_some());
        feed.tick(host(50));
        assert_eq!((feed.frame.is_some(), feed.frames), (false, 1));
    }

    #[test]
    fn the_trace_has_the_extremes_of_each_second() {
        let mut run = LiveRun::default();
        for (t_s, min_mm, max_mm) in [(0.2, 1.0, 2.0), (0.9, 0.5, 1.5), (1.0, 7.0, 8.0)] {
            run.add_to_trace(&Frame { t_s, min_mm, max_mm, ..Frame::default() });
        }
        let range = |t_s, min_mm, max_mm| ReadingRange { t_s, min_mm, max_mm };
        assert_eq!(run.trace, [range(0.9, 0.5, 2.0), range(1.0, 7.0, 8.0)]);
        for second in 2..=MAX_TRACE_S {
            run.add_to_trace(&Frame { t_s: second as f64, ..Frame::default() });
        }
        assert_eq!((run.trace.len(), run.trace[0].t_s), (MAX_TRACE_S, 1.0));
    }

    #[test]
    fn clock_of_the_device_is_ahead_by_its_time_less_that_of_the_host() {
        let (mut feed, _receiver) = feed();
        feed.sample(host(0), Some(5.0), &Sample::of(0.0), 0);
        feed.sample(host(1000), Some(6.003), &Sample::of(0.0), 0);
        let ahead_ms = lock(&feed.state.run).clock_ahead_ms.expect("the device has a clock");
        assert!((ahead_ms - 3.0).abs() < 1e-6, "{ahead_ms}");
    }

    #[test]
    fn point_of_a_dwell_is_the_mean_while_the_strobe_is_high() {
        let (mut feed, _receiver) = feed();
        let strobed = |reading_mm, high| Sample { trigger: Some(high), ..Sample::of(reading_mm) };
        feed.dwell(0, None, &strobed(9.0, false));
        for reading_mm in [1.0, 2.0, 6.0] {
            feed.dwell(0, Some(4.0), &strobed(reading_mm, true));
        }
        feed.dwell(1, None, &strobed(9.0, false));
        let points = lock(&feed.state.run).points.clone();
        assert_eq!(
            points.iter().map(|point| (point.dwell, point.reading_mm)).collect::<Vec<_>>(),
            [(1, 3.0)]
        );
        // A strobe that rises again begins a new mean.
        feed.dwell(1, Some(7.0), &strobed(8.0, true));
        feed.dwell(1, Some(8.0), &strobed(4.0, true));
        feed.dwell(2, None, &strobed(9.0, false));
        assert_eq!(lock(&feed.state.run).points[1].reading_mm, 4.0);
    }
}
