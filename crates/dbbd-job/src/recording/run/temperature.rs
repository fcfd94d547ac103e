//! Temperature of the bar during a run.

use crate::recording::RecordingFinding;

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
    /// Lowest and highest.
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

    /// Mean of the block of a sample, or of the nearest block with a temperature.
    pub(super) fn at(&self, sample: usize) -> Option<f64> {
        let block = sample / BLOCK;
        let mean = |at: usize| {
            let block = self.blocks.get(at)?;
            (block.count > 0).then(|| block.sum_c / f64::from(block.count))
        };
        (0..=NEAR).find_map(|off| block.checked_sub(off).and_then(mean).or_else(|| mean(block + off)))
    }

    /// A finding if no bar can have these temperatures in a workshop.
    pub(super) fn doubt(&self) -> Option<RecordingFinding> {
        const ROOM_C: [f64; 2] = [-10.0, 60.0];
        /// Largest change of a bar between consecutive readings, K.
        const MAX_STEP_K: f64 = 3.0;
        let [low_c, high_c] = self.range_c?;
        if self.step_k > MAX_STEP_K {
            return Some(RecordingFinding::TemperatureJumps { step_k: self.step_k });
        }
        // A missing sensor reads 0.
        let is_zero = low_c == 0.0 && high_c == 0.0;
        (is_zero || low_c < ROOM_C[0] || high_c > ROOM_C[1])
            .then_some(RecordingFinding::NoTemperature { low_c, high_c })
    }

    pub(super) fn mean(&self) -> Option<f64> {
        let sum_c: f64 = self.blocks.iter().fold(0.0, |sum, block| sum + block.sum_c);
        let count: f64 = self.blocks.iter().map(|block| f64::from(block.count)).sum();
        (count > 0.0).then(|| sum_c / count)
    }
}
