//! The log of the service: events with fields.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::{Arc, Mutex};

use crate::live::Journal;
use dbbd_device::clock;
use dbbd_device::sync::lock;
use dbbd_model::base::units::HostNs;

/// Least time between two lines of an event that clients cause, s: they could fill the disk.
const REPEAT_S: f64 = 10.0;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogLevel {
    Info,
    Warning,
    Error,
}

/// Receives the events of the service, which prints nothing itself.
pub trait ServiceLog: Send + Sync {
    fn event(&self, level: LogLevel, event: &str, fields: &[(&str, &dyn Display)]);
}

/// Warnings that clients cause. Repeated events are counted and logged at intervals.
pub(super) struct RateLimitedLog {
    log: Arc<dyn ServiceLog>,
    repeats: Mutex<BTreeMap<&'static str, RepeatedEvent>>,
}

struct RepeatedEvent {
    logged: HostNs,
    times: u64,
}

impl Journal for RateLimitedLog {
    fn warn(&self, event: &'static str, fields: &[(&str, &dyn Display)]) {
        if let Some(times) = self.due(event) {
            let mut fields = fields.to_vec();
            fields.push(("times", &times));
            self.log.event(LogLevel::Warning, event, &fields);
        }
    }
}

impl RateLimitedLog {
    pub(super) fn new(log: Arc<dyn ServiceLog>) -> Self {
        Self { log, repeats: Mutex::default() }
    }

    /// The number of events since the last line, if a line is due.
    fn due(&self, event: &'static str) -> Option<u64> {
        let mut repeats = lock(&self.repeats);
        let now = clock::now();
        let Some(repeat) = repeats.get_mut(event) else {
            repeats.insert(event, RepeatedEvent { logged: now, times: 0 });
            return Some(1);
        };
        repeat.times += 1;
        if now.seconds_since(repeat.logged) < REPEAT_S {
            return None;
        }
        repeat.logged = now;
        Some(std::mem::take(&mut repeat.times))
    }
}
