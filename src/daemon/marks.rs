//! What the strobe tells while a run goes on: dwells, and the marks that end a program.
//!
//! A pulse of less than 0.3 s of device time belongs to a mark, a longer one is a dwell. Three short
//! pulses in a row begin a module; exactly two, after at least one dwell and with a second of
//! quiet behind them, end it; five are the end of one module and the start of the next.

use crate::protocol::Clock;
use crate::sample::Sample;
use crate::units::DeviceTicks;

/// Pulses shorter than this belong to a mark, s.
const SHORT_S: f64 = 0.3;
/// A mark is over when the strobe has been low for so long, s.
const QUIET_S: f64 = 1.0;
/// Without a plan the program is over when nothing follows an end mark for so long, s.
const OVER_S: f64 = 20.0;

/// Unwraps the device's counter to seconds since its first sample.
#[derive(Clone, Debug)]
pub struct DeviceTime {
    clock: Clock,
    last: Option<DeviceTicks>,
    ticks: u64,
}

impl DeviceTime {
    /// Of a counter.
    pub fn new(clock: Clock) -> Self {
        Self { clock, last: None, ticks: 0 }
    }

    /// Seconds since the first sample; a counter that went back (the device restarted) stands still.
    pub fn seconds(&mut self, now: DeviceTicks) -> f64 {
        let mask = u64::MAX >> (64 - self.clock.wrap_bits.clamp(1, 64));
        let step = self.last.map_or(0, |last| now.0.wrapping_sub(last.0) & mask);
        if step <= mask / 2 {
            self.ticks = self.ticks.saturating_add(step);
        }
        self.last = Some(now);
        self.ticks as f64 * f64::from(self.clock.tick_ns) * 1e-9
    }
}

/// Counts dwells and end marks.
#[derive(Clone, Debug)]
pub struct Marks {
    /// Modules that the plan has; unknown without a plan.
    modules: Option<u32>,
    high_since: Option<f64>,
    last_high: f64,
    /// Short pulses in a row.
    pulses: u32,
    dwells: u32,
    dwells_of_module: u32,
    ends: u32,
    now: f64,
}

impl Marks {
    /// For a plan of so many modules, or without a plan.
    pub fn new(modules: Option<u32>) -> Self {
        Self {
            modules,
            high_since: None,
            last_high: 0.0,
            pulses: 0,
            dwells: 0,
            dwells_of_module: 0,
            ends: 0,
            now: 0.0,
        }
    }

    /// The strobe at a time, s; times do not go back.
    pub fn update(&mut self, t_s: f64, strobe: bool) {
        self.now = t_s;
        match (strobe, self.high_since) {
            (true, None) => self.high_since = Some(t_s),
            (false, Some(since)) => {
                self.high_since = None;
                if t_s - since < SHORT_S {
                    self.pulses += 1;
                } else {
                    self.pulses = 0;
                    self.dwells += 1;
                    self.dwells_of_module += 1;
                }
            }
            (false, None) if self.pulses > 0 && t_s - self.last_high >= QUIET_S => {
                if matches!(self.pulses, 2 | 5) && self.dwells_of_module > 0 {
                    self.ends += 1;
                    self.dwells_of_module = 0;
                }
                self.pulses = 0;
            }
            _ => {}
        }
        if strobe || self.high_since.is_some() {
            self.last_high = t_s;
        }
    }

    /// The strobe of a sample, where it has one, at a time, s.
    pub fn sample(&mut self, t_s: f64, sample: &Sample) {
        if let Some(strobe) = sample.trigger {
            self.update(t_s, strobe);
        }
    }

    /// Dwells that are over.
    pub fn dwells(&self) -> u32 {
        self.dwells
    }

    /// Modules that are over.
    pub fn ends(&self) -> u32 {
        self.ends
    }

    /// Whether the program is over.
    pub fn over(&self) -> bool {
        match self.modules {
            Some(modules) => self.ends >= modules.max(1),
            None => self.ends > 0 && self.now - self.last_high >= OVER_S,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Plays pulses (low before, high) sampled at 100 Hz, then `quiet` seconds.
    fn play(marks: &mut Marks, from: &mut f64, pulses: &[(f64, f64)], quiet: f64) {
        let mut run = |seconds: f64, strobe: bool| {
            for _ in 0..(seconds * 100.0).round() as u32 {
                marks.update(*from, strobe);
                *from += 0.01;
            }
        };
        for (low, high) in pulses {
            run(*low, false);
            run(*high, true);
        }
        run(quiet, false);
    }

    const START: [(f64, f64); 3] = [(0.4, 0.2); 3];
    const END: [(f64, f64); 2] = [(0.4, 0.2); 2];

    #[test]
    fn a_plan_ends_with_its_last_module() {
        let (mut marks, mut t) = (Marks::new(Some(2)), 0.0);
        for module in 1..=2 {
            play(&mut marks, &mut t, &START, 1.5);
            play(&mut marks, &mut t, &[(2.0, 1.0), (3.0, 1.0)], 1.5);
            assert!(!marks.over());
            play(&mut marks, &mut t, &END, 0.5);
            assert_eq!(marks.ends(), module - 1, "the mark is not over before a second of quiet");
            play(&mut marks, &mut t, &[], 1.0);
            assert_eq!(marks.ends(), module);
        }
        assert!(marks.over());
        assert_eq!(marks.dwells(), 4);
    }

    #[test]
    fn modules_may_follow_each_other_at_once() {
        let (mut marks, mut t) = (Marks::new(Some(2)), 0.0);
        play(&mut marks, &mut t, &START, 1.5);
        play(&mut marks, &mut t, &[(2.0, 1.0)], 1.5);
        play(&mut marks, &mut t, &[END.as_slice(), &START].concat(), 1.5);
        assert_eq!((marks.ends(), marks.over()), (1, false));
        play(&mut marks, &mut t, &[(2.0, 1.0)], 1.5);
        play(&mut marks, &mut t, &END, 1.5);
        assert!(marks.over());
    }

    #[test]
    fn start_marks_and_marks_before_a_dwell_end_nothing() {
        let (mut marks, mut t) = (Marks::new(None), 0.0);
        play(&mut marks, &mut t, &END, 30.0);
        play(&mut marks, &mut t, &START, 30.0);
        play(&mut marks, &mut t, &[(1.0, 1.0)], 2.0);
        play(&mut marks, &mut t, &START, 30.0);
        assert_eq!((marks.ends(), marks.over()), (0, false));
    }

    #[test]
    fn without_a_plan_twenty_quiet_seconds_end_it() {
        let (mut marks, mut t) = (Marks::new(None), 0.0);
        play(&mut marks, &mut t, &[(1.0, 1.0)], 2.0);
        play(&mut marks, &mut t, &END, 19.0);
        assert!(!marks.over());
        play(&mut marks, &mut t, &[], 1.5);
        assert!(marks.over());
        let mut busy = Marks::new(None);
        let mut t = 0.0;
        play(&mut busy, &mut t, &[(1.0, 1.0), (2.0, 0.2), (0.4, 0.2), (15.0, 1.0)], 10.0);
        assert_eq!((busy.ends(), busy.over()), (1, false));
    }

    #[test]
    fn the_counter_is_unwrapped() {
        let mut time = DeviceTime::new(Clock { tick_ns: 1000, wrap_bits: 32 });
        assert_eq!(time.seconds(DeviceTicks(u64::from(u32::MAX) - 499_999)), 0.0);
        assert_eq!(time.seconds(DeviceTicks(500_000)), 1.0);
        assert_eq!(time.seconds(DeviceTicks(0)), 1.0);
        assert_eq!(time.seconds(DeviceTicks(1_000_000)), 2.0);
    }
}
