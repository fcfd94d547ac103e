//! Noise of the bar at rest, from which the thresholds of stillness follow.
//!
//! It is taken from an interval in which the robot is surely at rest: the first HALT, at which the bar is mounted
//! and the program waits. A run without such a start (an imported trace) takes it from the quietest of its still
//! intervals. The measure is the slope itself, so that correlated noise and slow wander count as they are; its
//! lower limit is the white part, which adjacent blocks show much better. For a bar that stays on a step of its
//! scale, the step is the noise.

use super::windows::ReadingWindows;
use crate::recording::dwell::Dwell;
use crate::recording::stream::SampleStream;
use dbbd_model::math::robust;

/// Smallest change of the reading within a window that counts, mm.
const MIN_CHANGE_MM: f64 = 0.0002;
/// Least duration of the dwell at the start, s.
const START_S: f64 = 2.0;
/// The ends of a dwell are not used, s: there the motion is rounded off.
const INSET_S: f64 = 0.1;
/// Ratio of the lower quartile of the slopes' RMS to the true one, in dwells of a second or two.
const QUARTILE: f64 = 0.75;
/// Limit for the noise at the start, as a multiple of the quiet quarter: with more the bar was still being handled.
const UNQUIET: f64 = 2.0;

/// Noise at rest for windows of one width.
#[derive(Clone, Copy, Debug)]
pub(super) struct RestNoise {
    /// Standard deviation of a window's slope, mm/s.
    pub(super) slope_sigma: f64,
    /// Median scatter of the block means about the line of a window, mm.
    pub(super) scatter_sigma: f64,
    /// Slope that cannot be distinguished from zero, mm/s.
    pub(super) slope_floor: f64,
}

impl RestNoise {
    /// First pass: by the bulk of the whole run, which contains slow moves.
    pub(super) fn of_bulk(windows: &ReadingWindows, rests: f64, least_mm: f64) -> Self {
        let finite = windows.slopes.iter().filter(|slope| slope.is_finite());
        let slope_sigma = robust::bulk_scale(&mut finite.map(|slope| slope.abs()).collect::<Vec<_>>());
        let slope_floor = least_mm / windows.window_s;
        let mut scatters: Vec<f64> = windows
            .slopes
            .iter()
            .zip(&windows.scatters)
            .filter(|(slope, _)| slope.abs() <= rests * slope_sigma + slope_floor)
            .map(|(_, scatter)| *scatter)
            .collect();
        let scatter_sigma = robust::median(&mut scatters).unwrap_or(0.0).max(least_mm);
        Self { slope_sigma, scatter_sigma, slope_floor }
    }

    /// By the dwells of the first pass; `None` if no window lies within any.
    pub(super) fn at_rest(windows: &ReadingWindows, first_pass: &[Dwell], least_mm: f64) -> Option<Self> {
        let mut rms: Vec<f64> = Vec::new();
        let mut scatters: Vec<f64> = Vec::new();
        let mut start = None;
        let mut before_start = true;
        for dwell in first_pass {
            let at_start = before_start && dwell.duration_s() >= START_S;
            before_start &= !at_start;
            let Some([slope, scatter]) = within(windows, dwell) else { continue };
            if at_start {
                start = Some([slope.max(windows.white_slope(block_noise(windows, dwell))), scatter]);
            }
            rms.push(slope);
            scatters.push(scatter);
        }
        rms.sort_by(f64::total_cmp);
        let quarter = *rms.get(rms.len() / 4)?;
        let [slope_sigma, scatter] = match start {
            Some([slope, scatter]) if quarter > 0.0 => [slope.clamp(quarter, UNQUIET * quarter), scatter],
            Some(start) => start,
            None => [quarter / QUARTILE, robust::median(&mut scatters)?],
        };
        let slope_floor = least_mm / windows.window_s;
        Some(Self { slope_sigma, scatter_sigma: scatter.max(least_mm), slope_floor })
    }
}

/// RMS of the slopes and median of the scatters of the windows within a dwell.
fn within(windows: &ReadingWindows, dwell: &Dwell) -> Option<[f64; 2]> {
    let inset_s = INSET_S + 0.5 * windows.window_s;
    let at = |t_s: f64| windows.blocks.partition_point(|block| block.t_s < t_s);
    let range = at(dwell.start_s + inset_s)..at(dwell.end_s - inset_s);
    let whole = |at: &usize| windows.slopes[*at].is_finite();
    let slopes: Vec<f64> = range.clone().filter(whole).map(|at| windows.slopes[at]).collect();
    let mut scatters: Vec<f64> = range.filter(whole).map(|at| windows.scatters[at]).collect();
    let mean_square = slopes.iter().map(|slope| slope * slope).sum::<f64>() / slopes.len() as f64;
    Some([mean_square.sqrt(), robust::median(&mut scatters)?])
}

/// Standard deviation of a block mean by differences of neighbours within a dwell, mm.
fn block_noise(windows: &ReadingWindows, dwell: &Dwell) -> f64 {
    let inside = |t_s: f64| t_s >= dwell.start_s + INSET_S && t_s <= dwell.end_s - INSET_S;
    let inside = windows.blocks.iter().filter(|block| inside(block.t_s));
    let means: Vec<f64> = inside.map(|block| block.mean_mm).collect();
    let mut steps: Vec<f64> = means.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    robust::SIGMA_OF_MAD * robust::median(&mut steps).unwrap_or(0.0) / 2f64.sqrt()
}

/// Change of the reading that may be zero, mm: half a step of the scale if the noise does not carry the reading
/// across steps, so that averaging does not help.
pub(super) fn least_change_mm(stream: &SampleStream) -> f64 {
    const ENOUGH: usize = 100_000;
    let stride = (stream.len() / ENOUGH).max(1);
    let pairs = (1..stream.len()).step_by(stride).filter(|&at| stream.valid(at) && stream.valid(at - 1));
    let changes = pairs.map(|at| (stream.reading_mm[at] - stream.reading_mm[at - 1]).abs());
    let changes: Vec<f64> = changes.collect();
    let mut steps: Vec<f64> = changes.iter().copied().filter(|change| *change > 0.0).collect();
    // In fast moves the reading skips steps.
    let quarter = steps.len() / 4;
    if 2 * steps.len() >= changes.len() || steps.is_empty() {
        return MIN_CHANGE_MM;
    }
    let (_, step_mm, _) = steps.select_nth_unstable_by(quarter, f64::total_cmp);
    (0.5 * *step_mm).max(MIN_CHANGE_MM)
}
