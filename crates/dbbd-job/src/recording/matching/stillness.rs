//! Detects dwells by stillness: intervals of the stream without slope.
//!
//! On a circle the length of the bar changes only by the error of the robot, some 10 um per move. The detector
//! therefore uses slopes of block means over two windows, a short one for fast moves and a long one for faint
//! ones, with thresholds from the noise of the bar at rest. A first pass, with thresholds from the bulk of the
//! run, finds the rests.

use std::ops::RangeInclusive;

use super::noise::{self, RestNoise};
use super::windows::{ReadingBlock, ReadingWindows, WindowWidth};
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

pub fn still_dwells(stream: &SampleStream, least_s: f64) -> Vec<Dwell> {
    let short = ReadingWindows::of(stream, SHORT, least_s);
    let long = ReadingWindows::of(stream, LONG, least_s);
    let least_mm = noise::least_change_mm(stream);
    let bulk = |windows| WindowScale { windows, quiet: RestNoise::of_bulk(windows, RESTS, least_mm) };
    let first_pass = detect_still_dwells(&bulk(&short), &bulk(&long), least_s);
    let at_rest = |windows| {
        let quiet = RestNoise::at_rest(windows, &first_pass, least_mm)?;
        Some(WindowScale { windows, quiet })
    };
    match at_rest(&short).zip(at_rest(&long)) {
        Some((fine, coarse)) => detect_still_dwells(&fine, &coarse, least_s),
        None => first_pass,
    }
}

/// The dwells by these thresholds.
fn detect_still_dwells(fine: &WindowScale<'_>, coarse: &WindowScale<'_>, least_s: f64) -> Vec<Dwell> {
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
        .filter(|dwell| dwell.duration_s() >= least_s)
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

/// A still run of fine blocks, both ends included, with its level.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::stream::StreamBuilder;
    use dbbd_model::base::units::HostNs;
    use dbbd_model::measurement::sample::Sample;

    /// Levels (mm, s) joined by ramps of `move_s`, at 100 Hz, with deterministic noise.
    fn stream(levels: &[(f64, f64)], move_s: f64) -> SampleStream {
        let mut builder = StreamBuilder::new(None);
        let mut count = 0_u32;
        let mut push = |reading_mm: f64| {
            let noise_mm = 0.0005 * (f64::from(count) * 2.4).sin();
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

    #[test]
    fn slow_moves_and_short_rests_are_no_dwells() {
        let dwells = still_dwells(&stream(&[(0.0, 3.0), (0.5, 0.2), (0.0, 3.0)], 4.0), 0.5);
        assert_eq!(dwells.len(), 2, "{dwells:?}");
    }
}
