//! The stream in blocks of equal width, with slope and scatter of the block means around each.

use crate::recording::stream::SampleStream;
use dbbd_model::math::robust;

/// Mean reading of a short interval.
pub(super) struct ReadingBlock {
    pub(super) t_s: f64,
    pub(super) mean_mm: f64,
    /// Number of clock breaks before it.
    pub(super) epoch: usize,
}

/// Width of windows: at most `count` blocks of `block_s` seconds.
#[derive(Clone, Copy)]
pub(super) struct WindowWidth {
    pub(super) count: usize,
    pub(super) block_s: f64,
    /// Longest window as a share of the shortest dwell to be detected.
    pub(super) share: f64,
}

/// Blocks, and the windows of several blocks around each.
pub(super) struct ReadingWindows {
    pub(super) blocks: Vec<ReadingBlock>,
    pub(super) block_s: f64,
    pub(super) count: usize,
    pub(super) window_s: f64,
    /// Slope around each block, mm/s; infinite if the window is incomplete.
    pub(super) slopes: Vec<f64>,
    /// Scatter of the block means about the line of the window, mm.
    pub(super) scatters: Vec<f64>,
}

impl ReadingWindows {
    /// Windows for dwells of at least `least_s`; at least four blocks each.
    pub(super) fn of(stream: &SampleStream, width: WindowWidth, least_s: f64) -> Self {
        let block_s = width.block_s.max(1.001 * stream.period_s());
        let count = width.count.min((width.share * least_s / block_s) as usize).max(4);
        let blocks = blocks(stream, block_s);
        let window_s = count as f64 * block_s;
        let mut slopes = vec![f64::INFINITY; blocks.len()];
        let mut scatters = vec![f64::INFINITY; blocks.len()];
        let mut scratch = Vec::new();
        let mut points = Vec::with_capacity(count);
        for (first, window) in blocks.windows(count).enumerate() {
            let (head, tail) = (&window[0], &window[count - 1]);
            if tail.t_s - head.t_s > 1.5 * window_s || tail.epoch != head.epoch {
                continue;
            }
            points.clear();
            points.extend(window.iter().map(|block| (block.t_s - head.t_s, block.mean_mm)));
            let slope = robust::slope(&points, &mut scratch);
            let centre = first + count / 2;
            slopes[centre] = slope;
            scratch.clear();
            scratch.extend(points.iter().map(|(t, y)| y - slope * t));
            let level = robust::median(&mut scratch).unwrap_or(0.0);
            scratch.iter_mut().for_each(|value| *value = (*value - level).abs());
            scatters[centre] = robust::SIGMA_OF_MAD * robust::median(&mut scratch).unwrap_or(0.0);
        }
        Self { blocks, block_s, count, window_s, slopes, scatters }
    }

    /// Standard deviation of a window's slope, mm/s, for independent blocks of standard deviation `block_mm`.
    pub(super) fn white_slope(&self, block_mm: f64) -> f64 {
        let count = self.count as f64;
        block_mm / (self.block_s * (count * (count * count - 1.0) / 12.0).sqrt())
    }
}

/// Trimmed means of the valid readings in blocks of `block_s`; blocks without one are left out.
fn blocks(stream: &SampleStream, block_s: f64) -> Vec<ReadingBlock> {
    let mut blocks = Vec::new();
    let mut values: Vec<f64> = Vec::new();
    let mut breaks = stream.breaks.iter().peekable();
    let (mut begin_s, mut epoch) = (0.0, 0);
    let mut close = |values: &mut Vec<f64>, begin_s: f64, epoch: usize| {
        if let Some(mean_mm) = robust::trimmed_mean(values) {
            blocks.push(ReadingBlock { t_s: begin_s + 0.5 * block_s, mean_mm, epoch });
        }
        values.clear();
    };
    for (at, (&t_s, &reading_mm)) in stream.t_s.iter().zip(&stream.reading_mm).enumerate() {
        let broke = breaks.next_if(|&&broken| broken <= at).is_some();
        if broke || t_s >= begin_s + block_s {
            close(&mut values, begin_s, epoch);
            epoch += usize::from(broke);
            begin_s = if broke { t_s } else { (t_s / block_s).floor() * block_s };
            // Rounding must not open the block before the closed one again.
            begin_s = begin_s.max(t_s - block_s);
        }
        if stream.valid(at) {
            values.push(reading_mm);
        }
    }
    close(&mut values, begin_s, epoch);
    blocks
}
