//! Decodes the strobe of the controller into dwells and the marks at the start and end of a module, live and
//! recorded.
//!
//! A high strobe of less than 0.3 s is a pulse of a mark, a longer one is a dwell. Three pulses start a module, two
//! end it; five are the end of one module and the start of the next.

use super::dwell::Dwell;
use super::stream::SampleStream;

/// A strobe shorter than this is a pulse of a mark, s.
const PULSE_S: f64 = 0.3;
/// A mark is complete after the strobe was low for this time, s.
const QUIET_S: f64 = 1.0;
/// A shorter fall of the strobe is a bounce: no program lowers it for less, s.
const BOUNCE_S: f64 = 0.1;

/// A dwell from the rise to the fall of the strobe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StrobedDwell {
    pub dwell: Dwell,
    /// Index of the module by the marks, from 0.
    pub module: usize,
}

/// An event of the strobe, reported as soon as later samples cannot change it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StrobeEvent {
    Dwell(StrobedDwell),
    /// An end mark after at least one dwell, and a second of low strobe.
    ModuleEnd,
}

/// Decodes the strobe sample by sample.
#[derive(Clone, Debug, Default)]
pub struct StrobeDecoder {
    level: StrobeLevel,
    /// Start and last high sample of the present or latest pulse, s.
    start_s: f64,
    end_s: f64,
    previous_s: f64,
    /// Consecutive pulses.
    pulses: u32,
    since_dwell: PulseMarks,
    module: usize,
    dwells_of_module: u32,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum StrobeLevel {
    #[default]
    Low,
    High,
    /// The strobe is low, but for so short a time that it may be a bounce.
    Fell,
}

/// The marks since the last dwell.
#[derive(Clone, Copy, Debug, Default)]
struct PulseMarks {
    /// Any mark divides modules, even if one of its pulses was lost.
    any_pulse: bool,
    module_end: bool,
}

impl StrobeDecoder {
    /// The strobe at `t_s`, which must not decrease; `None` for a sample without it.
    pub fn push(&mut self, t_s: f64, strobe: Option<bool>) -> Option<StrobeEvent> {
        let mut event = None;
        if self.level == StrobeLevel::Fell {
            if t_s - self.end_s >= BOUNCE_S {
                event = self.fall();
            } else if strobe == Some(true) {
                self.level = StrobeLevel::High;
            }
        }
        match (self.level, strobe) {
            (StrobeLevel::Low, Some(true)) => (self.level, self.start_s) = (StrobeLevel::High, t_s),
            // The last high sample ends the pulse: the strobe may have fallen in a gap.
            (StrobeLevel::High, Some(false)) => {
                (self.level, self.end_s) = (StrobeLevel::Fell, self.previous_s)
            }
            (StrobeLevel::Low, Some(false)) if self.pulses > 0 && t_s - self.end_s >= QUIET_S => {
                event = self.mark();
            }
            _ => {}
        }
        self.previous_s = t_s;
        event
    }

    /// Ends the stream; a strobe that is still high ends with it.
    pub fn finish(&mut self) -> Option<StrobeEvent> {
        if self.level == StrobeLevel::High {
            self.end_s = self.previous_s;
        }
        if self.level == StrobeLevel::Low { None } else { self.fall() }
    }

    pub fn last_high_s(&self) -> f64 {
        if self.level == StrobeLevel::High { self.previous_s } else { self.end_s }
    }

    /// Start of the present pulse, s, regardless of bounces; `None` if the strobe is low.
    pub fn high_since_s(&self) -> Option<f64> {
        (self.level != StrobeLevel::Low).then_some(self.start_s)
    }

    fn fall(&mut self) -> Option<StrobeEvent> {
        self.level = StrobeLevel::Low;
        if self.end_s - self.start_s < PULSE_S {
            self.pulses += 1;
            self.since_dwell.any_pulse = true;
            return None;
        }
        if self.since_dwell.any_pulse && self.dwells_of_module > 0 {
            self.module += 1;
            self.dwells_of_module = 0;
        }
        (self.pulses, self.since_dwell) = (0, PulseMarks::default());
        self.dwells_of_module += 1;
        let dwell = Dwell::whole(self.start_s, self.end_s, 0.0);
        Some(StrobeEvent::Dwell(StrobedDwell { dwell, module: self.module }))
    }

    fn mark(&mut self) -> Option<StrobeEvent> {
        let ends = matches!(self.pulses, 2 | 5) && self.dwells_of_module > 0 && !self.since_dwell.module_end;
        self.pulses = 0;
        self.since_dwell.module_end |= ends;
        ends.then_some(StrobeEvent::ModuleEnd)
    }
}

/// Whether the stream has a strobe that was high at least once.
pub fn has_strobe(stream: &SampleStream) -> bool {
    (0..stream.len()).any(|at| stream.strobe(at) == Some(true))
}

pub fn strobed_dwells(stream: &SampleStream) -> Vec<StrobedDwell> {
    let mut decoder = StrobeDecoder::default();
    let mut events: Vec<StrobeEvent> =
        stream.t_s.iter().enumerate().filter_map(|(at, t_s)| decoder.push(*t_s, stream.strobe(at))).collect();
    events.extend(decoder.finish());
    let dwell = |event| match event {
        StrobeEvent::Dwell(dwell) => Some(dwell),
        StrobeEvent::ModuleEnd => None,
    };
    events.into_iter().filter_map(dwell).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Plays pulses (low before, high) sampled at 100 Hz, then `quiet` seconds.
    struct Player {
        decoder: StrobeDecoder,
        samples: u32,
        dwells: Vec<(usize, f64)>,
        ends: u32,
    }

    const START: [(f64, f64); 3] = [(0.4, 0.2); 3];
    const END: [(f64, f64); 2] = [(0.4, 0.2); 2];

    impl Player {
        fn new() -> Self {
            Self { decoder: StrobeDecoder::default(), samples: 0, dwells: Vec::new(), ends: 0 }
        }

        fn run(&mut self, seconds: f64, strobe: bool) {
            for _ in 0..(seconds * 100.0).round() as u32 {
                match self.decoder.push(f64::from(self.samples) * 0.01, Some(strobe)) {
                    Some(StrobeEvent::Dwell(one)) => {
                        self.dwells.push((one.module, one.dwell.end_s - one.dwell.start_s));
                    }
                    Some(StrobeEvent::ModuleEnd) => self.ends += 1,
                    None => {}
                }
                self.samples += 1;
            }
        }

        fn play(&mut self, pulses: &[(f64, f64)], quiet_s: f64) {
            for (low_s, high_s) in pulses {
                self.run(*low_s, false);
                self.run(*high_s, true);
            }
            self.run(quiet_s, false);
        }
    }

    #[test]
    fn marks_divide_modules_and_end_them_after_a_second() {
        let mut player = Player::new();
        for module in 1..=2 {
            player.play(&START, 1.5);
            player.play(&[(2.0, 1.0), (3.0, 1.0)], 1.5);
            player.play(&END, 0.5);
            assert_eq!(player.ends, module - 1, "the mark is not over before a second of quiet");
            player.play(&[], 1.0);
            assert_eq!(player.ends, module);
        }
        let modules: Vec<usize> = player.dwells.iter().map(|(module, _)| *module).collect();
        assert_eq!(modules, [0, 0, 1, 1]);
    }

    #[test]
    fn modules_may_follow_each_other_immediately() {
        let mut player = Player::new();
        player.play(&[(2.0, 1.0)], 1.5);
        player.play(&[END.as_slice(), &START].concat(), 1.5);
        player.play(&[(2.0, 1.0)], 1.5);
        assert_eq!(player.ends, 1);
        assert_eq!(player.dwells[1].0, 1);
    }

    #[test]
    fn start_marks_and_marks_before_a_dwell_end_no_module() {
        let mut player = Player::new();
        player.play(&END, 30.0);
        player.play(&START, 30.0);
        player.play(&[(1.0, 1.0)], 2.0);
        player.play(&START, 30.0);
        assert_eq!(player.ends, 0);
    }

    #[test]
    fn bounce_does_not_split_a_dwell() {
        let mut player = Player::new();
        player.play(&[(1.0, 0.5), (0.05, 0.5)], 1.0);
        assert_eq!(player.dwells.len(), 1);
        assert!((player.dwells[0].1 - 1.04).abs() < 1e-9, "{:?}", player.dwells);
        player.run(0.7, true);
        assert!(matches!(player.decoder.finish(), Some(StrobeEvent::Dwell(one)) if one.module == 0));
    }
}
