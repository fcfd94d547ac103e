//! What the recorder shows of a run: pictures a few times a second, and each dwell. Nobody who looks can
//! hold it up: the stream forgets what is not read.

use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::broadcast;

use crate::clock;
use crate::live::{Alarm, Frame, Message, Point};
use crate::plan::{Kind, Plan};
use crate::sample::Sample;
use crate::units::HostNs;

/// Host time that a picture gathers, s.
const PICTURE_S: f64 = 0.05;
/// Share of the stroke from its middle beyond which the alarm is raised.
pub const ALARM_SHARE: f64 = 0.9;

/// What a plan says about the dwells to come.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outlook {
    /// Length of the bar at reading zero, mm.
    pub bar_length_mm: Option<f64>,
    /// Lowest and highest reading that the bar allows, mm.
    pub stroke_mm: Option<[f64; 2]>,
    /// Share of the stroke from its middle beyond which the alarm is raised.
    pub alarm_share: f64,
    dwells: Vec<Expected>,
}

/// A dwell of the plan.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Expected {
    index: u32,
    circle: u32,
    angle_deg: Option<f64>,
    clockwise: bool,
    length_mm: f64,
}

impl Outlook {
    /// Without a plan.
    pub fn bare(stroke_mm: Option<[f64; 2]>, alarm_share: f64) -> Self {
        Self { stroke_mm, alarm_share, ..Self::default() }
    }

    /// Of a plan.
    pub fn of(plan: &Plan, alarm_share: f64) -> Self {
        let places = plan.circle_places();
        let dwells = plan.rows.iter().zip(&places).filter(|(row, _)| row.kind != Kind::Transit);
        let dwells = dwells.map(|(row, place)| Expected {
            index: row.index,
            circle: row.circle,
            // A reference pose is no part of the circle's picture.
            angle_deg: place.filter(|_| row.kind == Kind::Measure).map(|place| place.angle_deg),
            clockwise: place.is_some_and(|place| place.clockwise),
            length_mm: row.length_mm,
        });
        let bar = &plan.header.job.bar;
        Self {
            bar_length_mm: Some(bar.length_mm),
            stroke_mm: Some(bar.stroke_mm),
            alarm_share,
            dwells: dwells.collect(),
        }
    }

    /// Dwells of the plan; none without a plan.
    pub fn poses(&self) -> Option<u32> {
        self.bar_length_mm.and_then(|_| u32::try_from(self.dwells.len()).ok())
    }

    /// How near a reading is to the end of the stroke.
    pub fn alarm(&self, reading_mm: f64) -> Alarm {
        let Some([low, high]) = self.stroke_mm else { return Alarm::None };
        let share = (reading_mm - 0.5 * (low + high)).abs() / (0.5 * (high - low));
        // A bar at its end stop reads the end of its stroke.
        if share >= 1.0 {
            Alarm::Over
        } else if share > self.alarm_share {
            Alarm::Near
        } else {
            Alarm::None
        }
    }

    /// The dwell of number `dwell` (from 1) with its mean reading.
    fn point(&self, dwell: u32, reading_mm: f64) -> Point {
        let expected = (dwell as usize).checked_sub(1).and_then(|at| self.dwells.get(at));
        Point {
            dwell,
            index: expected.map(|expected| expected.index),
            circle: expected.map(|expected| expected.circle),
            angle_deg: expected.and_then(|expected| expected.angle_deg),
            clockwise: expected.is_some_and(|expected| expected.clockwise),
            reading_mm,
            deviation_mm: expected
                .zip(self.bar_length_mm)
                .map(|(expected, length_mm)| length_mm + reading_mm - expected.length_mm),
        }
    }
}

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
    outlook: Outlook,
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
    pub fn new(shown: Shown, outlook: Outlook) -> Self {
        let wall_ns = clock::unix_ns() as f64 - clock::now().0 as f64;
        Self { shown, outlook, wall_ns, first: None, picture: None, frames: 0, strobe: (0.0, 0), dwells: 0 }
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
        let alarm = self.outlook.alarm(reading);
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
                alarm,
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
        frame.alarm = frame.alarm.max(alarm);
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
            let point = self.outlook.point(dwells, sum / f64::from(count));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_alarm_follows_the_stroke() {
        let outlook = Outlook::bare(Some([-1.0, 3.0]), 0.9);
        for (reading, alarm) in [
            (1.0, Alarm::None),
            (2.79, Alarm::None),
            (2.81, Alarm::Near),
            (-0.9, Alarm::Near),
            (3.0, Alarm::Over),
            (-1.01, Alarm::Over),
        ] {
            assert_eq!(outlook.alarm(reading), alarm, "{reading}");
        }
        assert_eq!(Outlook::bare(None, 0.9).alarm(1e9), Alarm::None);
    }
}
