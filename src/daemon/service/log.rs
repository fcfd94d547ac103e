//! What the service has to say while it goes on: events with fields, for a line each.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::sync::{Arc, Mutex};

use crate::base::clock;
use crate::base::sync::lock;
use crate::base::units::HostNs;
use crate::live::Journal;

/// Between two lines of an event that strangers cause, s: they could fill the disk with it.
const REPEAT_S: f64 = 10.0;

/// How much an event matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// As it should be.
    Info,
    /// To be seen.
    Warning,
    /// Something failed.
    Error,
}

/// Where the service says what happens; it prints nothing itself.
pub trait Log: Send + Sync {
    /// Says an event and its fields.
    fn say(&self, level: Level, event: &str, fields: &[(&str, &dyn Display)]);
}

/// Warnings, of which those that come again and again are counted.
pub(super) struct Warnings {
    log: Arc<dyn Log>,
    repeats: Mutex<BTreeMap<&'static str, Repeat>>,
}

struct Repeat {
    said: HostNs,
    times: u64,
}

impl Journal for Warnings {
    fn warn(&self, event: &'static str, fields: &[(&str, &dyn Display)]) {
        if let Some(times) = self.due(event) {
            let mut fields = fields.to_vec();
            fields.push(("times", &times));
            self.log.say(Level::Warning, event, &fields);
        }
    }
}

impl Warnings {
    pub(super) fn new(log: Arc<dyn Log>) -> Self {
        Self { log, repeats: Mutex::default() }
    }

    /// How often the event came since it was last said, where it is time to say it again.
    fn due(&self, event: &'static str) -> Option<u64> {
        let mut repeats = lock(&self.repeats);
        let now = clock::now();
        let Some(repeat) = repeats.get_mut(event) else {
            repeats.insert(event, Repeat { said: now, times: 0 });
            return Some(1);
        };
        repeat.times += 1;
        if now.seconds_since(repeat.said) < REPEAT_S {
            return None;
        }
        repeat.said = now;
        Some(std::mem::take(&mut repeat.times))
    }
}
