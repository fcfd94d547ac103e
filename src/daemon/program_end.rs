//! Counts dwells and modules by the strobe during a run, and detects the end of the program.

use dbbd_job::recording::{StrobeDecoder, StrobeEvent};
use dbbd_model::measurement::sample::Sample;

/// Without a plan the program is over when the strobe stays low for this time after an end mark, s.
const OVER_S: f64 = 20.0;

#[derive(Clone, Debug)]
pub(super) struct ProgramEnd {
    decoder: StrobeDecoder,
    /// Modules of the plan; unknown without a plan.
    modules: Option<usize>,
    pub(super) dwells: u32,
    pub(super) modules_over: u32,
    now_s: f64,
}

impl ProgramEnd {
    pub(super) fn new(modules: Option<usize>) -> Self {
        Self { decoder: StrobeDecoder::default(), modules, dwells: 0, modules_over: 0, now_s: 0.0 }
    }

    /// Adds a sample. Times do not decrease.
    pub(super) fn push(&mut self, t_s: f64, sample: &Sample) {
        self.now_s = t_s;
        let event = self.decoder.push(t_s, sample.trigger);
        self.count(event);
    }

    pub(super) fn finish(&mut self) {
        let event = self.decoder.finish();
        self.count(event);
    }

    fn count(&mut self, event: Option<StrobeEvent>) {
        match event {
            Some(StrobeEvent::Dwell(_)) => self.dwells += 1,
            Some(StrobeEvent::ModuleEnd) => self.modules_over += 1,
            None => {}
        }
    }

    /// When the strobe rose, s, while it is high.
    pub(super) fn high_since_s(&self) -> Option<f64> {
        self.decoder.high_since_s()
    }

    pub(super) fn is_over(&self) -> bool {
        match self.modules {
            Some(modules) => self.modules_over as usize >= modules.max(1),
            None => self.modules_over > 0 && self.now_s - self.decoder.last_high_s() >= OVER_S,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples pulses (time low, time high) at 100 Hz, then `quiet_s` seconds of low strobe.
    fn play(end: &mut ProgramEnd, pulses: &[(f64, f64)], quiet_s: f64) {
        let spans = pulses.iter().flat_map(|(low_s, high_s)| [(*low_s, false), (*high_s, true)]);
        for (seconds, strobe) in spans.chain([(quiet_s, false)]) {
            for _ in 0..(seconds * 100.0).round() as u32 {
                let sample = Sample { trigger: Some(strobe), ..Sample::of(0.0) };
                end.push(end.now_s + 0.01, &sample);
            }
        }
    }

    const END: [(f64, f64); 2] = [(0.4, 0.2); 2];

    #[test]
    fn a_program_with_a_plan_ends_with_the_last_module() {
        let mut end = ProgramEnd::new(Some(2));
        for module in 1..=2 {
            play(&mut end, &[(2.0, 1.0), (3.0, 1.0)], 1.5);
            assert!(!end.is_over());
            play(&mut end, &END, 1.5);
            assert_eq!(end.modules_over, module);
        }
        assert!(end.is_over());
        assert_eq!(end.dwells, 4);
    }

    #[test]
    fn a_program_without_a_plan_ends_after_twenty_seconds_without_strobe() {
        let mut end = ProgramEnd::new(None);
        play(&mut end, &[(1.0, 1.0)], 2.0);
        play(&mut end, &END, 19.0);
        assert!(!end.is_over());
        play(&mut end, &[], 1.5);
        assert!(end.is_over());
        let mut busy = ProgramEnd::new(None);
        play(&mut busy, &[(1.0, 1.0), (2.0, 0.2), (0.4, 0.2), (15.0, 1.0)], 10.0);
        assert_eq!((busy.modules_over, busy.is_over()), (1, false));
    }
}
