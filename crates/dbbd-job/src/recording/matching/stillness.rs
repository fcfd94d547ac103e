//! Detects dwells by stillness: intervals of the stream without slope.
//!
//! On a circle the length of the bar changes only by the error of the robot, some 10 um per move. The detector
//! therefore uses slopes of block means over two windows, a short one for fast moves and a long one for faint
//! ones, with thresholds from the noise of the bar at rest. A first pass, with thresholds from the bulk of the
//! run, finds the rests.
//!
//! The noise at rest is that of most dwells of the first pass, weighted alike: no single interval decides, for a bar that
//! lies on a table before it is mounted is quieter than the robot, and one that is handled is louder. The measure is the
//! slope itself, so that correlated noise and slow wander are included; its lower limit is the white part, which adjacent
//! blocks show much better. For a bar that stays on a step of its scale, the step is the noise.

use std::ops::RangeInclusive;

use crate::recording::dwell::Dwell;
use crate::recording::stream::SampleStream;
use dbbd_model::math::robust;

/// The short and the long window. The shortest dwell to be detected is half of a commanded one, so the long window
/// fits into a whole dwell.
const SHORT: WindowWidth = WindowWidth { count: 12, block_s: 0.02, share: 0.6 };
const LONG: WindowWidth = WindowWidth { count: 10, block_s: 0.06, share: 1.2 };
/// Least slope of a move, and largest slope at rest, in standard deviations.
const MOVES: f64 = 4.0;
const RESTS: f64 = 2.5;
/// Standard deviation of a sharp start, s, which acceleration rounds off, and of a start that cannot be seen.
const MIN_START_SD_S: f64 = 0.04;
const UNSEEN_BEGIN_S: f64 = 0.4;
/// Shortest move of a plan, s: dwells closer than this at one level are one.
const MIN_MOVE_S: f64 = 0.3;

/// Passes after the first one. A long quiet time hides most dwells from the first pass, and its noise is too low.
const PASSES: usize = 3;

pub fn still_dwells(stream: &SampleStream, min_s: f64) -> Vec<Dwell> {
    let short = ReadingWindows::of(stream, SHORT, min_s);
    let long = ReadingWindows::of(stream, LONG, min_s);
    let min_mm = least_change_mm(stream);
    let bulk = |windows| WindowScale { windows, quiet: RestNoise::of_bulk(windows, RESTS, min_mm) };
    let mut dwells = detect_still_dwells(&bulk(&short), &bulk(&long), min_s);
    for _ in 0..PASSES {
        let at_rest = |windows| {
            let quiet = RestNoise::at_rest(windows, &dwells, min_mm)?;
            Some(WindowScale { windows, quiet })
        };
        let Some((fine, coarse)) = at_rest(&short).zip(at_rest(&long)) else { break };
        dwells = detect_still_dwells(&fine, &coarse, min_s);
    }
    dwells
}

/// Detects the dwells with these thresholds.
fn detect_still_dwells(fine: &WindowScale<'_>, coarse: &WindowScale<'_>, min_s: f64) -> Vec<Dwell> {
    let block_s = fine.windows.block_s;
    let reach = (0.5 * coarse.windows.window_s / block_s).ceil() as usize + 2;
    let settled: Vec<StillRun> = quiet_runs(fine, coarse)
        .into_iter()
        .filter(|run| fine.is_still(run))
        .map(|run| fine.extend_to_level(&run, reach))
        .collect();
    let half = 0.5 * block_s;
    joined(settled, fine)
        .into_iter()
        .map(|run| {
            let start = fine.change_point(&run, reach, DwellEdge::Start);
            let end_s = fine.change_point(&run, reach, DwellEdge::End).t_s;
            Dwell::whole(start.t_s - half, end_s.max(start.t_s) + half, start.sd_s)
        })
        .filter(|dwell| dwell.duration_s() >= min_s)
        .collect()
}

/// Runs of blocks that are quiet in both windows.
fn quiet_runs(fine: &WindowScale<'_>, coarse: &WindowScale<'_>) -> Vec<RangeInclusive<usize>> {
    let (blocks, around) = (&fine.windows.blocks, &coarse.windows.blocks);
    let mut runs = Vec::new();
    let mut open: Option<usize> = None;
    let mut over = 0; // the coarse block at or after the fine one
    for (at, block) in blocks.iter().enumerate() {
        while over + 1 < around.len() && around[over].t_s < block.t_s {
            over += 1;
        }
        if fine.is_quiet(at) && coarse.is_quiet(over) {
            open.get_or_insert(at);
        } else if let Some(from) = open.take() {
            runs.push(from..=at - 1);
        }
    }
    runs.extend(open.map(|from| from..=blocks.len() - 1));
    runs
}

/// A still run of fine blocks, from its first to its last block, with its level.
#[derive(Clone, Copy)]
struct StillRun {
    from: usize,
    to: usize,
    level_mm: f64,
}

#[derive(Clone, Copy)]
enum DwellEdge {
    Start,
    End,
}

struct ChangePoint {
    t_s: f64,
    sd_s: f64,
}

/// Fit of a line followed by a level: sum of squares, and slope of the line.
struct LineAndLevel {
    squares: f64,
    slope: f64,
}

/// Windows with their thresholds.
struct WindowScale<'a> {
    windows: &'a ReadingWindows,
    quiet: RestNoise,
}

impl WindowScale<'_> {
    /// Whether neither slope nor scatter shows a move.
    fn is_quiet(&self, at: usize) -> bool {
        let ReadingWindows { slopes, scatters, .. } = self.windows;
        let (Some(slope), Some(scatter)) = (slopes.get(at), scatters.get(at)) else { return false };
        let RestNoise { slope_sigma, scatter_sigma, slope_floor } = self.quiet;
        slope.abs() <= MOVES * slope_sigma + slope_floor && *scatter <= 4.0 * scatter_sigma
    }

    /// Whether a quiet run is still for the most part: a slow move is quiet but slopes throughout.
    fn is_still(&self, run: &RangeInclusive<usize>) -> bool {
        let limit = RESTS * self.quiet.slope_sigma + self.quiet.slope_floor;
        let slopes = &self.windows.slopes[run.clone()];
        let low = slopes.iter().filter(|slope| slope.abs() <= limit).count();
        10 * low >= 7 * slopes.len()
    }

    /// The start or end of the run: the change point between a level and an adjacent slope, fitted to the blocks
    /// on both sides. With the tolerance of the level alone, a slow move would be detected late.
    fn change_point(&self, run: &StillRun, reach: usize, at: DwellEdge) -> ChangePoint {
        let StillRun { from, to, .. } = *run;
        let inside = reach.min(to - from);
        let (edge, sign, blocks) = match at {
            DwellEdge::Start => (from, 1.0, from.saturating_sub(reach)..=from + inside),
            DwellEdge::End => (to, -1.0, to - inside..=(to + reach).min(self.windows.blocks.len() - 1)),
        };
        let ReadingBlock { t_s: edge_s, epoch, .. } = self.windows.blocks[edge];
        // Time counts from the edge into the run. Blocks across a gap or a broken clock are excluded.
        let points: Vec<(f64, f64)> = self.windows.blocks[blocks]
            .iter()
            .filter(|block| block.epoch == epoch)
            .map(|block| (sign * (block.t_s - edge_s), block.mean_mm))
            .filter(|(x, _)| x.abs() <= (reach + 1) as f64 * self.windows.block_s)
            .collect();
        let fits = points.iter().map(|&(x, _)| (x, fit_change(&points, x)));
        let none = (0.0, LineAndLevel { squares: f64::INFINITY, slope: 0.0 });
        let (x, LineAndLevel { slope, .. }) =
            fits.fold(none, |best, next| if next.1.squares < best.1.squares { next } else { best });
        let sd_s = (1.5 * self.quiet.scatter_sigma / slope.abs().max(1e-9))
            .min(UNSEEN_BEGIN_S)
            .hypot(MIN_START_SD_S);
        ChangePoint { t_s: edge_s + sign * x, sd_s }
    }

    /// Moves the ends of the run to where the level is left: the windows blur them by half their width.
    fn extend_to_level(&self, run: &RangeInclusive<usize>, reach: usize) -> StillRun {
        const NEAR: usize = 15;
        let (from, to) = (*run.start(), *run.end());
        let tolerance = 4.0 * self.quiet.scatter_sigma;
        let head_mm = self.level_mm(from..=to.min(from + NEAR));
        let tail_mm = self.level_mm(from.max(to.saturating_sub(NEAR))..=to);
        let on = |at: usize, level_mm: f64| (self.windows.blocks[at].mean_mm - level_mm).abs() <= tolerance;
        let adjoins = |a: usize, b: usize| {
            let [a, b] = [a, b].map(|at| &self.windows.blocks[at]);
            a.epoch == b.epoch && b.t_s - a.t_s < MIN_MOVE_S
        };
        let (mut first, mut last) = (from, to);
        while first < to && !on(first, head_mm) {
            first += 1;
        }
        while last > first && !on(last, tail_mm) {
            last -= 1;
        }
        for _ in 0..reach {
            if first > 0 && adjoins(first - 1, first) && on(first - 1, head_mm) {
                first -= 1;
            }
            if last + 1 < self.windows.blocks.len() && adjoins(last, last + 1) && on(last + 1, tail_mm) {
                last += 1;
            }
        }
        StillRun { from: first, to: last, level_mm: self.level_mm(first..=last) }
    }

    /// Median of the block means, mm.
    fn level_mm(&self, run: RangeInclusive<usize>) -> f64 {
        let mut values: Vec<f64> = self.windows.blocks[run].iter().map(|block| block.mean_mm).collect();
        robust::median(&mut values).unwrap_or(0.0)
    }
}

/// Fits a line up to `change` and a level from there.
fn fit_change(points: &[(f64, f64)], change: f64) -> LineAndLevel {
    let count = points.len() as f64;
    let (mut x, mut y, mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let origin = points.first().map_or(0.0, |point| point.1);
    for (at, value) in points {
        let (u, v) = ((at - change).min(0.0), value - origin);
        x += u;
        y += v;
        xx += u * u;
        xy += u * v;
        yy += v * v;
    }
    let (sxx, sxy, syy) = (xx - x * x / count, xy - x * y / count, yy - y * y / count);
    if sxx > 0.0 {
        LineAndLevel { squares: syy - sxy * sxy / sxx, slope: sxy / sxx }
    } else {
        LineAndLevel { squares: syy, slope: 0.0 }
    }
}

/// Joins runs that a blip or a gap in the data split; runs that overlap are cut in the middle.
fn joined(runs: Vec<StillRun>, fine: &WindowScale<'_>) -> Vec<StillRun> {
    let mut whole: Vec<StillRun> = Vec::new();
    for mut run in runs {
        if let Some(before) = whole.last_mut() {
            let (left, right) = (
                &fine.windows.blocks[before.to.min(run.from)],
                &fine.windows.blocks[run.from.max(before.to)],
            );
            let apart_s = right.t_s - left.t_s;
            let one_level = (run.level_mm - before.level_mm).abs() <= 2.0 * fine.quiet.scatter_sigma;
            if apart_s < MIN_MOVE_S && one_level && left.epoch == right.epoch {
                before.to = run.to.max(before.to);
                continue;
            }
            if run.from <= before.to {
                let middle = usize::midpoint(run.from, before.to);
                before.to = middle.max(before.from);
                run.from = (middle + 1).min(run.to);
            }
        }
        whole.push(run);
    }
    whole
}

/// Mean reading of a short interval.
struct ReadingBlock {
    t_s: f64,
    mean_mm: f64,
    /// Number of clock breaks before the block.
    epoch: usize,
}

/// Width of windows: at most `count` blocks of `block_s` seconds.
#[derive(Clone, Copy)]
struct WindowWidth {
    count: usize,
    block_s: f64,
    /// Longest window, as a share of the shortest dwell to be detected.
    share: f64,
}

/// Blocks, and the windows of several blocks around each.
struct ReadingWindows {
    blocks: Vec<ReadingBlock>,
    block_s: f64,
    count: usize,
    window_s: f64,
    /// Slope around each block, mm/s; infinite if the window is incomplete.
    slopes: Vec<f64>,
    /// Scatter of the block means about the line of the window, mm.
    scatters: Vec<f64>,
}

impl ReadingWindows {
    /// The windows for dwells of at least `min_s`, with at least four blocks each.
    fn of(stream: &SampleStream, width: WindowWidth, min_s: f64) -> Self {
        let block_s = width.block_s.max(1.001 * stream.period_s());
        let count = width.count.min((width.share * min_s / block_s) as usize).max(4);
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
    fn white_slope(&self, block_mm: f64) -> f64 {
        let count = self.count as f64;
        block_mm / (self.block_s * (count * (count * count - 1.0) / 12.0).sqrt())
    }
}

/// Trimmed means of the valid readings in blocks of `block_s`; blocks without a valid reading are left out.
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
    for (at, (&t_s, reading_mm)) in stream.t_s.iter().zip(stream.reading_mm.iter()).enumerate() {
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

/// Smallest change of the reading within a window that counts, mm.
const MIN_CHANGE_MM: f64 = 0.0002;
/// The ends of a dwell are not used, s: there the motion is rounded off.
const INSET_S: f64 = 0.1;
/// Ratio of the lower quartile of the slopes' RMS to the true one, in dwells of a second or two.
const QUARTILE: f64 = 0.75;
/// Noise at rest for windows of one width.
#[derive(Clone, Copy, Debug)]
struct RestNoise {
    /// Standard deviation of a window's slope, mm/s.
    slope_sigma: f64,
    /// Median scatter of the block means about the line of a window, mm.
    scatter_sigma: f64,
    /// Slope that cannot be distinguished from zero, mm/s.
    slope_floor: f64,
}

impl RestNoise {
    /// Noise for the first pass, from the bulk of the whole run, which contains slow moves.
    fn of_bulk(windows: &ReadingWindows, rests: f64, min_mm: f64) -> Self {
        let finite = windows.slopes.iter().filter(|slope| slope.is_finite());
        let slope_sigma = robust::bulk_scale(&mut finite.map(|slope| slope.abs()).collect::<Vec<_>>());
        let slope_floor = min_mm / windows.window_s;
        let mut scatters: Vec<f64> = windows
            .slopes
            .iter()
            .zip(&windows.scatters)
            .filter(|(slope, _)| slope.abs() <= rests * slope_sigma + slope_floor)
            .map(|(_, scatter)| *scatter)
            .collect();
        let scatter_sigma = robust::median(&mut scatters).unwrap_or(0.0).max(min_mm);
        Self { slope_sigma, scatter_sigma, slope_floor }
    }

    /// Noise from the dwells of the first pass; `None` if no window lies in a dwell. Slow moves are among them: the lower
    /// quartile of their slopes is that of a rest.
    fn at_rest(windows: &ReadingWindows, first_pass: &[Dwell], min_mm: f64) -> Option<Self> {
        let (mut slopes, mut scatters, mut whites) = (Vec::new(), Vec::new(), Vec::new());
        for dwell in first_pass {
            let Some([slope, scatter]) = within(windows, dwell) else { continue };
            slopes.push(slope);
            scatters.push(scatter);
            whites.push(windows.white_slope(block_noise(windows, dwell)));
        }
        slopes.sort_by(f64::total_cmp);
        let slope_sigma = (slopes.get(slopes.len() / 4)? / QUARTILE).max(robust::median(&mut whites)?);
        let scatter_sigma = robust::median(&mut scatters)?.max(min_mm);
        Some(Self { slope_sigma, scatter_sigma, slope_floor: min_mm / windows.window_s })
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

/// Standard deviation of a block mean, mm, from differences of neighbouring blocks in a dwell.
fn block_noise(windows: &ReadingWindows, dwell: &Dwell) -> f64 {
    let inside = |t_s: f64| t_s >= dwell.start_s + INSET_S && t_s <= dwell.end_s - INSET_S;
    let inside = windows.blocks.iter().filter(|block| inside(block.t_s));
    let means: Vec<f64> = inside.map(|block| block.mean_mm).collect();
    let mut steps: Vec<f64> = means.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
    robust::SIGMA_OF_MAD * robust::median(&mut steps).unwrap_or(0.0) / 2f64.sqrt()
}

/// Change of the reading that may be zero, mm: half a step of the scale if the noise does not carry the reading
/// across steps, so that averaging does not help.
fn least_change_mm(stream: &SampleStream) -> f64 {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::stream::StreamBuilder;
    use dbbd_model::base::units::HostNs;
    use dbbd_model::measurement::sample::Sample;

    /// Levels (mm, s) joined by ramps of `move_s`, at 100 Hz, with deterministic noise.
    fn stream(levels: &[(f64, f64)], move_s: f64) -> SampleStream {
        stream_after_rest(levels, move_s, 0.0005)
    }

    /// The same; at the first level the noise has another amplitude.
    fn stream_after_rest(levels: &[(f64, f64)], move_s: f64, first_noise_mm: f64) -> SampleStream {
        let first = (levels[0].1 * 100.0) as u32;
        let mut builder = StreamBuilder::new(None);
        let mut count = 0_u32;
        let mut push = |reading_mm: f64| {
            let amplitude_mm = if count < first { first_noise_mm } else { 0.0005 };
            let noise_mm = amplitude_mm * (f64::from(count) * 2.4).sin();
            let host = HostNs(u64::from(count) * 10_000_000);
            builder.push(host, &Sample::of(reading_mm + noise_mm));
            count += 1;
        };
        for (at, (level_mm, lasts_s)) in levels.iter().enumerate() {
            (0..(lasts_s * 100.0) as u32).for_each(|_| push(*level_mm));
            let Some((next_mm, _)) = levels.get(at + 1) else { break };
            let steps = (move_s * 100.0) as u32;
            (0..steps)
                .for_each(|step| push(level_mm + (next_mm - level_mm) * f64::from(step) / f64::from(steps)));
        }
        builder.build()
    }

    #[test]
    fn dwells_begin_and_end_at_the_change_points() {
        let dwells = still_dwells(&stream(&[(0.0, 3.0), (0.5, 1.5), (0.3, 1.5)], 1.0), 0.5);
        let times: Vec<[f64; 2]> = dwells.iter().map(|dwell| [dwell.start_s, dwell.end_s]).collect();
        assert_eq!(dwells.len(), 3, "{times:?}");
        for ([start_s, end_s], expected) in times.iter().zip([[0.0, 3.0], [4.0, 5.5], [6.5, 8.0]]) {
            let blocks = [start_s - expected[0], end_s - expected[1]].map(|off_s| off_s / SHORT.block_s);
            assert!(blocks.iter().all(|off| off.abs() < 3.5), "{times:?}");
        }
    }

    /// A bar that lies on a table or is held in a hand before it is mounted does not set the noise of the run.
    #[test]
    fn first_rest_may_be_quieter_or_louder_than_the_others() {
        let levels: Vec<(f64, f64)> =
            (0..20).map(|at| (0.3 * f64::from(at % 3), if at == 0 { 8.0 } else { 1.5 })).collect();
        for first_noise_mm in [0.0, 0.00005, 0.0005, 0.004] {
            let dwells = still_dwells(&stream_after_rest(&levels, 1.0, first_noise_mm), 0.7);
            let whole = dwells.iter().filter(|dwell| (dwell.duration_s() - 1.5).abs() < 0.2).count();
            assert_eq!(whole, 19, "{first_noise_mm}: {dwells:?}");
        }
    }

    #[test]
    fn slow_moves_and_short_rests_are_no_dwells() {
        let dwells = still_dwells(&stream(&[(0.0, 3.0), (0.5, 0.2), (0.0, 3.0)], 4.0), 0.5);
        assert_eq!(dwells.len(), 2, "{dwells:?}");
    }

    /// A line of slope 2 up to 0 and a level from there fits without a residual; a change elsewhere does not.
    #[test]
    fn change_point_fits_a_line_and_a_level() {
        let points: Vec<(f64, f64)> = (-5..=5).map(f64::from).map(|x| (x, 7.0 + 2.0 * x.min(0.0))).collect();
        let fit = fit_change(&points, 0.0);
        assert!(fit.squares.abs() < 1e-9 && (fit.slope - 2.0).abs() < 1e-12);
        assert!(fit_change(&points, 1.0).squares > 0.1 && fit_change(&points, -1.0).squares > 0.1);
        let level = fit_change(&[(1.0, 3.0), (2.0, 5.0)], 0.0);
        assert_eq!((level.squares, level.slope), (2.0, 0.0));
    }

    /// The slope of n points a block apart has the standard deviation s / (b sqrt(n (n^2 - 1) / 12)).
    #[test]
    fn white_noise_of_a_slope() {
        let windows = ReadingWindows::of(&stream(&[(0.0, 1.0)], 1.0), SHORT, 1.0);
        assert_eq!((windows.count, windows.block_s), (12, 0.02));
        let expected = 0.001 / (0.02 * 143f64.sqrt());
        assert!((windows.white_slope(0.001) - expected).abs() < 1e-12);
    }

    /// Seven of ten slopes are at most 2.5 x 0.1 + 0.05.
    #[test]
    fn a_run_is_still_if_most_of_it_does_not_slope() {
        let mut windows = ReadingWindows::of(&stream(&[(0.0, 1.0)], 1.0), SHORT, 1.0);
        windows.slopes = [-0.31, 0.31, 0.31, 0.29, -0.29, 0.29, 0.0, 0.0, 0.0, 0.0].into();
        let quiet = RestNoise { slope_sigma: 0.1, scatter_sigma: 1.0, slope_floor: 0.05 };
        let scale = WindowScale { windows: &windows, quiet };
        assert!(scale.is_still(&(0..=9)) && !scale.is_still(&(0..=8)));
    }

    #[test]
    fn windows_show_the_slope_of_a_ramp() {
        let windows = ReadingWindows::of(&stream(&[(0.0, 0.0), (2.0, 0.0)], 4.0), LONG, 1.0);
        let middle = windows.slopes[windows.slopes.len() / 2];
        assert!((middle - 0.5).abs() < 0.01, "{middle}");
        assert!(windows.slopes[0].is_infinite() && windows.scatters[0].is_infinite());
    }

    /// Half a step of a coarse scale counts; fine readings have the least change.
    #[test]
    fn step_of_a_coarse_scale_is_its_noise() {
        assert_eq!(least_change_mm(&stream(&[(0.0, 1.0)], 1.0)), MIN_CHANGE_MM);
        let mut builder = StreamBuilder::new(None);
        for at in 0..100_u32 {
            let reading_mm = 0.01 * f64::from(at / 10);
            builder.push(HostNs(u64::from(at) * 10_000_000), &Sample::of(reading_mm));
        }
        assert!((least_change_mm(&builder.build()) - 0.005).abs() < 1e-12);
    }
}
