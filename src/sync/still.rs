//! Where the robot stood still: stretches of the stream without slope.
//!
//! On a circle the bar's length hardly changes, and what changes it is only the robot's error, some
//! 10 um a move. So the gate looks at slopes of block means over two windows, a short one for fast
//! moves and a long one for faint ones, with thresholds from the bar's noise at rest. Where it rested a first
//! look tells, with thresholds from the bulk of the run.

use super::rest::{self, Quiet};
use super::robust;
use super::seen::Stretch;
use super::stream::Stream;
use super::windows::Windows;

/// The short and the long window, as number of blocks and seconds a block, and how long each may be in terms of the
/// shortest stretch that is looked for: half a dwell, so that the long one fits into a whole dwell.
const SHORT: (usize, f64) = (12, 0.02);
const LONG: (usize, f64) = (10, 0.06);
const SHORT_SHARE: f64 = 0.6;
const LONG_SHARE: f64 = 1.2;
/// Slope beyond which the robot moves, and below which it surely stands, in standard deviations.
const MOVES: f64 = 4.0;
const STANDS: f64 = 2.5;
/// Standard deviation of a begin that is clearly seen, s: acceleration rounds it off. And of one that is not.
const LEAST_BEGIN_SD_S: f64 = 0.04;
const UNSEEN_BEGIN_S: f64 = 0.4;
/// No move of a plan is shorter, s: two stretches nearer than this at one level are one.
const LEAST_MOVE_S: f64 = 0.3;

/// The still stretches that last at least `least_s`.
pub fn find(stream: &Stream, least_s: f64) -> Vec<Stretch> {
    let period_s = stream.period_s();
    let short = Windows::of(stream, SHORT, period_s, SHORT_SHARE * least_s);
    let long = Windows::of(stream, LONG, period_s, LONG_SHARE * least_s);
    let least_mm = rest::least_change_mm(stream);
    let bulk = |windows| Scale { windows, quiet: Quiet::of_bulk(windows, STANDS, least_mm) };
    let looked = look(&bulk(&short), &bulk(&long), least_s);
    let at_rest = |windows| {
        let quiet = Quiet::at_rest(windows, &looked, least_mm)?;
        Some(Scale { windows, quiet })
    };
    match at_rest(&short).zip(at_rest(&long)) {
        Some((fine, coarse)) => look(&fine, &coarse, least_s),
        None => looked,
    }
}

/// The still stretches by these thresholds.
fn look(fine: &Scale<'_>, coarse: &Scale<'_>, least_s: f64) -> Vec<Stretch> {
    let (blocks, around) = (&fine.windows.blocks, &coarse.windows.blocks);
    let mut runs = Vec::new();
    let mut open: Option<(usize, usize)> = None;
    let mut over = 0; // the coarse block at or after the fine one
    for (at, block) in blocks.iter().enumerate() {
        while over + 1 < around.len() && around[over].t_s < block.t_s {
            over += 1;
        }
        let quiet = fine.quiet(at) && coarse.quiet(over);
        open = match (open, quiet) {
            (None, true) => Some((at, at)),
            (Some((from, _)), true) => Some((from, at)),
            (Some(run), false) => {
                runs.push(run);
                None
            }
            (None, false) => None,
        };
    }
    runs.extend(open);
    let block_s = fine.windows.block_s;
    let reach = (0.5 * coarse.windows.window_s / block_s).ceil() as usize + 2;
    let settled: Vec<Run> = runs
        .into_iter()
        .filter(|&(from, to)| fine.stands(from, to))
        .map(|(from, to)| fine.edges(from, to, reach))
        .collect();
    let half = 0.5 * block_s;
    joined(settled, fine)
        .into_iter()
        .map(|run| {
            let (start_s, start_sd_s) = fine.hinge(run.from, run.to, reach, false);
            let (end_s, _) = fine.hinge(run.from, run.to, reach, true);
            Stretch { start_s: start_s - half, end_s: end_s.max(start_s) + half, start_sd_s }
        })
        .filter(|stretch| stretch.end_s - stretch.start_s >= least_s)
        .collect()
}

/// A still run of fine blocks, both ends included, with its level.
#[derive(Clone, Copy)]
struct Run {
    from: usize,
    to: usize,
    level_mm: f64,
}

/// Windows with the thresholds for them.
struct Scale<'a> {
    windows: &'a Windows,
    quiet: Quiet,
}

impl Scale<'_> {
    /// Neither slope nor scatter of a robot that moves.
    fn quiet(&self, at: usize) -> bool {
        let Windows { slopes, scatters, .. } = self.windows;
        let (Some(slope), Some(scatter)) = (slopes.get(at), scatters.get(at)) else { return false };
        let Quiet { slope_sigma, scatter_sigma, slope_floor } = self.quiet;
        slope.abs() <= MOVES * slope_sigma + slope_floor && *scatter <= 4.0 * scatter_sigma
    }

    /// Whether a quiet run is still for the most part: a slow move is quiet but slopes all along.
    fn stands(&self, from: usize, to: usize) -> bool {
        let limit = STANDS * self.quiet.slope_sigma + self.quiet.slope_floor;
        let low = self.windows.slopes[from..=to].iter().filter(|slope| slope.abs() <= limit).count();
        10 * low >= 7 * (to - from + 1)
    }

    /// Where the run begins (or, `at_end`, ends), and that time's standard deviation, s: of a level with
    /// a slope adjoining, fitted to the blocks on both sides.
    ///
    /// The level's tolerance alone would be left late by a slow move.
    fn hinge(&self, from: usize, to: usize, reach: usize, at_end: bool) -> (f64, f64) {
        let edge = if at_end { to } else { from };
        let inside = reach.min(to - from);
        let (first, last) = if at_end {
            (to - inside, (to + reach).min(self.windows.blocks.len() - 1))
        } else {
            (from.saturating_sub(reach), from + inside)
        };
        let sign = if at_end { -1.0 } else { 1.0 };
        let edge_s = self.windows.blocks[edge].t_s;
        // Time counts from the edge into the stretch; what a gap or a broken clock divides stays out.
        let points: Vec<(f64, f64)> = self.windows.blocks[first..=last]
            .iter()
            .filter(|block| block.epoch == self.windows.blocks[edge].epoch)
            .map(|block| (sign * (block.t_s - edge_s), block.mean_mm))
            .filter(|(x, _)| x.abs() <= (reach + 1) as f64 * self.windows.block_s)
            .collect();
        let mut best = (f64::INFINITY, 0.0, 0.0);
        for &(knee, _) in &points {
            let (squares, slope) = fit_knee(&points, knee);
            if squares < best.0 {
                best = (squares, knee, slope);
            }
        }
        let (_, knee, slope) = best;
        let sd_s = (1.5 * self.quiet.scatter_sigma / slope.abs().max(1e-9))
            .min(UNSEEN_BEGIN_S)
            .hypot(LEAST_BEGIN_SD_S);
        (edge_s + sign * knee, sd_s)
    }

    /// The run with its ends where the level is left: the windows blur them by half their width.
    fn edges(&self, from: usize, to: usize, reach: usize) -> Run {
        const NEAR: usize = 15;
        let level = |first: usize, last: usize| {
            let mut values: Vec<f64> =
                self.windows.blocks[first..=last].iter().map(|block| block.mean_mm).collect();
            robust::median(&mut values).unwrap_or(0.0)
        };
        let tolerance = 4.0 * self.quiet.scatter_sigma;
        let head_mm = level(from, to.min(from + NEAR));
        let tail_mm = level(from.max(to.saturating_sub(NEAR)), to);
        let on = |at: usize, level_mm: f64| (self.windows.blocks[at].mean_mm - level_mm).abs() <= tolerance;
        let adjoins = |a: usize, b: usize| {
            self.windows.blocks[a].epoch == self.windows.blocks[b].epoch
                && self.windows.blocks[b].t_s - self.windows.blocks[a].t_s < LEAST_MOVE_S
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
        Run { from: first, to: last, level_mm: level(first, last) }
    }
}

/// Sum of squares about a line up to `knee` and a level from there, and the line's slope.
fn fit_knee(points: &[(f64, f64)], knee: f64) -> (f64, f64) {
    let count = points.len() as f64;
    let (mut x, mut y, mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let origin = points.first().map_or(0.0, |point| point.1);
    for (at, value) in points {
        let (u, v) = ((at - knee).min(0.0), value - origin);
        x += u;
        y += v;
        xx += u * u;
        xy += u * v;
        yy += v * v;
    }
    let (sxx, sxy, syy) = (xx - x * x / count, xy - x * y / count, yy - y * y / count);
    if sxx > 0.0 { (syy - sxy * sxy / sxx, sxy / sxx) } else { (syy, 0.0) }
}

/// One stretch of runs that a blip or a gap in the data tore apart; runs that touch are cut in the middle.
fn joined(runs: Vec<Run>, fine: &Scale<'_>) -> Vec<Run> {
    let mut whole: Vec<Run> = Vec::new();
    for mut run in runs {
        if let Some(before) = whole.last_mut() {
            let (left, right) = (
                &fine.windows.blocks[before.to.min(run.from)],
                &fine.windows.blocks[run.from.max(before.to)],
            );
            let apart_s = right.t_s - left.t_s;
            let one_level = (run.level_mm - before.level_mm).abs() <= 2.0 * fine.quiet.scatter_sigma;
            if apart_s < LEAST_MOVE_S && one_level && left.epoch == right.epoch {
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
