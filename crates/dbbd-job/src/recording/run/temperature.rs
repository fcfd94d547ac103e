//! Temperature of the bar during a run.

use crate::recording::RecordingFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::plausibility::Quantity;

/// Number of samples whose temperatures are averaged.
const BLOCK: usize = 256;
/// A temperature applies to this many blocks before and after it.
const NEAR: usize = 200;

#[derive(Clone, Copy, Debug, Default)]
struct TemperatureBlock {
    sum_c: f64,
    count: u32,
}

/// Temperatures by the index of the sample, degrees Celsius.
#[derive(Clone, Debug, Default)]
pub(super) struct SampleTemperatures {
    blocks: Vec<TemperatureBlock>,
    samples: usize,
    /// Lowest and highest temperature, degrees Celsius.
    range_c: Option<[f64; 2]>,
    last_c: Option<f64>,
    /// Largest change between consecutive temperatures, K.
    step_k: f64,
}

impl SampleTemperatures {
    /// Takes the temperature of the next sample.
    pub(super) fn push(&mut self, temperature_c: Option<f64>) {
        let block = self.samples / BLOCK;
        self.samples += 1;
        if let Some(temperature_c) = temperature_c.filter(|c| c.is_finite()) {
            let [low, high] = self.range_c.unwrap_or([temperature_c; 2]);
            self.range_c = Some([low.min(temperature_c), high.max(temperature_c)]);
            let last_c = self.last_c.replace(temperature_c).unwrap_or(temperature_c);
            self.step_k = self.step_k.max((temperature_c - last_c).abs());
            self.blocks.resize(self.blocks.len().max(block + 1), TemperatureBlock::default());
            let block = &mut self.blocks[block];
            block.sum_c += temperature_c;
            block.count += 1;
        }
    }

    /// Mean temperature of the block of a sample, or of the nearest block with a temperature.
    pub(super) fn at(&self, sample: usize) -> Option<f64> {
        let block = sample / BLOCK;
        let mean = |at: usize| {
            let block = self.blocks.get(at)?;
            (block.count > 0).then(|| block.sum_c / f64::from(block.count))
        };
        (0..=NEAR).find_map(|off| block.checked_sub(off).and_then(mean).or_else(|| mean(block + off)))
    }

    /// The warning if no bar can have these temperatures in a workshop.
    pub(super) fn finding(&self) -> Option<Diagnostic> {
        const KEY: &str = "temperature of the bar";
        /// Largest change of a bar between consecutive readings, K.
        const MAX_STEP_K: f64 = 3.0;
        let [low_c, high_c] = self.range_c?;
        if self.step_k > MAX_STEP_K {
            return Some(RecordingFinding::TemperatureJumps { step_k: self.step_k }.into());
        }
        if low_c == 0.0 && high_c == 0.0 {
            return Some(Quantity::Temperature.always_zero(KEY).into());
        }
        [low_c, high_c]
            .into_iter()
            .find_map(|c| Quantity::Temperature.impossible(KEY, c))
            .map(Diagnostic::from)
    }

    pub(super) fn mean(&self) -> Option<f64> {
        let sum_c: f64 = self.blocks.iter().fold(0.0, |sum, block| sum + block.sum_c);
        let count: f64 = self.blocks.iter().map(|block| f64::from(block.count)).sum();
        (count > 0.0).then(|| sum_c / count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn temperatures(blocks: &[(usize, Option<f64>)]) -> SampleTemperatures {
        let mut temperatures = SampleTemperatures::default();
        for (samples, temperature_c) in blocks {
            (0..*samples).for_each(|_| temperatures.push(*temperature_c));
        }
        temperatures
    }

    #[test]
    fn temperature_is_the_mean_of_its_block() {
        let bar = temperatures(&[(128, Some(20.0)), (128, Some(21.0)), (256, Some(22.0))]);
        assert_eq!([0, 255, 256, 511].map(|sample| bar.at(sample)), [20.5, 20.5, 22.0, 22.0].map(Some));
        assert_eq!(bar.mean(), Some(21.25));
        assert_eq!(temperatures(&[(9, None)]).mean(), None);
    }

    #[test]
    fn nearest_block_with_a_temperature_counts() {
        let bar = temperatures(&[(256, Some(20.0)), (3 * 256, None), (256, Some(23.0))]);
        // If two blocks are equally near, the one before counts.
        assert_eq!([256, 512, 768, 1024].map(|sample| bar.at(sample)), [20.0, 20.0, 23.0, 23.0].map(Some));
        assert_eq!([204, 205].map(|block| bar.at(256 * block)), [Some(23.0), None]);
    }

    #[test]
    fn temperatures_of_no_workshop_have_a_warning() {
        let code = |readings: &[f64]| {
            temperatures(&readings.iter().map(|c| (1, Some(*c))).collect::<Vec<_>>()).finding()
        };
        let jumps = |step_k| Some(RecordingFinding::TemperatureJumps { step_k }.into());
        const KEY: &str = "temperature of the bar";
        let none = |celsius| Quantity::Temperature.impossible(KEY, celsius).map(Diagnostic::from);
        let zero = Some(Quantity::Temperature.always_zero(KEY).into());
        assert_eq!(code(&[20.0, 23.0, 20.0]), None);
        assert_eq!(code(&[20.0, 16.5, 20.0]), jumps(3.5));
        assert_eq!(code(&[0.0, 0.0]), zero);
        assert_eq!(code(&[0.0, 0.5]), None);
        assert_eq!([code(&[60.0]), code(&[60.5])], [None, none(60.5)]);
        assert_eq!([code(&[-10.0]), code(&[-10.5])], [None, none(-10.5)]);
        assert_eq!(code(&[]), None);
    }
}
