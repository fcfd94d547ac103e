//! Where the robot stood still: stretches of the stream without slope.
//!
//! On a circle the bar's length hardly changes, and what changes it is only the robot's error, some
//! 10 um a move. So the gate looks at slopes of block means over two windows, a short one for fast
//! moves and a long one for faint ones, with thresholds from the run's own noise.

use super::robust;
use super::stream::Stream;

/// A stretch in which the length did not change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stretch {
    /// Its begin, s of the stream.
    pub start_s: f64,
    /// Its end, s of the stream.
    pub end_s: f64,
    /// Standard deviation of the begin, s.
    pub start_sd_s: f64,
}

/// The short and the long window, as number of blocks and seconds a block.
const SHORT: (usize, f64) = (12, 0.02);
const LONG: (usize, f64) = (10, 0.06);
/// Slope beyond which the robot moves, and below which it surely stands, in standard deviations.
const MOVES: f64 = 4.0;
const STANDS: f64 = 2.5;
/// No bar is trusted to tell a change below this within a window, mm.
const LEAST_CHANGE_MM: f64 = 0.0002;
/// Standard deviation of a begin that is clearly seen, s: acceleration rounds it off. And of one that is not.
const LEAST_BEGIN_SD_S: f64 = 0.04;
const UNSEEN_BEGIN_S: f64 = 0.4;
/// No move of a plan is shorter, s: two stretches nearer than this at one level are one.
const LEAST_MOVE_S: f64 = 0.3;

/// The still stretches that last at least `least_s`.
pub fn find(stream: &Stream, least_s: f64) -> Vec<Stretch> {
    let period_s = stream.period_s();
    let fine = Scale::of(stream, SHORT, period_s, least_s);
    let coarse = Scale::of(stream, LONG, period_s, least_s);
    let mut runs = Vec::new();
    let mut open: Option<(usize, usize)> = None;
    let mut over = 0; // the coarse block at or after the fine one
    for (at, block) in fine.blocks.iter().enumerate() {
        while over + 1 < coarse.blocks.len() && coarse.blocks[over].t_s < block.t_s {
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
    let reach = (0.5 * coarse.window_s / fine.block_s).ceil() as usize + 2;
    let settled: Vec<Run> = runs
        .into_iter()
        .filter(|&(from, to)| fine.stands(from, to))
        .map(|(from, to)| fine.edges(from, to, reach))
        .collect();
    let half = 0.5 * fine.block_s;
    joined(settled, &fine)
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

struct Block {
    t_s: f64,
    mean_mm: f64,
    /// Number of clock breaks before it.
    epoch: usize,
}

/// The stream in blocks of one width, with the slope around each.
struct Scale {
    blocks: Vec<Block>,
    block_s: f64,
    window_s: f64,
    /// Slope around each block, mm/s; infinite where the window is not whole.
    slopes: Vec<f64>,
    /// Scatter of the block means about the window's line, mm.
    scatters: Vec<f64>,
    slope_sigma: f64,
    scatter_sigma: f64,
    slope_floor: f64,
}

impl Scale {
    fn of(stream: &Stream, (count, block_s): (usize, f64), period_s: f64, least_s: f64) -> Self {
        let block_s = block_s.max(1.001 * period_s);
        // A window must fit well into the shortest stretch that is looked for.
        let count = count.min((0.6 * least_s / block_s) as usize).max(4);
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
        let mut magnitudes: Vec<f64> =
            slopes.iter().filter(|slope| slope.is_finite()).map(|slope| slope.abs()).collect();
        let slope_sigma = robust::bulk_scale(&mut magnitudes);
        let slope_floor = LEAST_CHANGE_MM / window_s;
        let mut quiet: Vec<f64> = slopes
            .iter()
            .zip(&scatters)
            .filter(|(slope, _)| slope.abs() <= STANDS * slope_sigma + slope_floor)
            .map(|(_, scatter)| *scatter)
            .collect();
        let scatter_sigma = robust::median(&mut quiet).unwrap_or(0.0).max(LEAST_CHANGE_MM);
        Self { blocks, block_s, window_s, slopes, scatters, slope_sigma, scatter_sigma, slope_floor }
    }

    /// Neither slope nor scatter of a robot that moves.
    fn quiet(&self, at: usize) -> bool {
        let (Some(slope), Some(scatter)) = (self.slopes.get(at), self.scatters.get(at)) else { return false };
        slope.abs() <= MOVES * self.slope_sigma + self.slope_floor && *scatter <= 4.0 * self.scatter_sigma
    }

    /// Whether a quiet run is still for the most part: a slow move is quiet but slopes all along.
    fn stands(&self, from: usize, to: usize) -> bool {
        let limit = STANDS * self.slope_sigma + self.slope_floor;
        let low = self.slopes[from..=to].iter().filter(|slope| slope.abs() <= limit).count();
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
            (to - inside, (to + reach).min(self.blocks.len() - 1))
        } else {
            (from.saturating_sub(reach), from + inside)
        };
        let sign = if at_end { -1.0 } else { 1.0 };
        let edge_s = self.blocks[edge].t_s;
        // Time counts from the edge into the stretch; what a gap or a broken clock divides stays out.
        let points: Vec<(f64, f64)> = self.blocks[first..=last]
            .iter()
            .filter(|block| block.epoch == self.blocks[edge].epoch)
            .map(|block| (sign * (block.t_s - edge_s), block.mean_mm))
            .filter(|(x, _)| x.abs() <= (reach + 1) as f64 * self.block_s)
            .collect();
        let mut best = (f64::INFINITY, 0.0, 0.0);
        for &(knee, _) in &points {
            let (squares, slope) = fit_knee(&points, knee);
            if squares < best.0 {
                best = (squares, knee, slope);
            }
        }
        let (_, knee, slope) = best;
        let sd_s =
            (1.5 * self.scatter_sigma / slope.abs().max(1e-9)).min(UNSEEN_BEGIN_S).hypot(LEAST_BEGIN_SD_S);
        (edge_s + sign * knee, sd_s)
    }

    /// The run with its ends where the level is left: the windows blur them by half their width.
    fn edges(&self, from: usize, to: usize, reach: usize) -> Run {
        const NEAR: usize = 15;
        let level = |first: usize, last: usize| {
            let mut values: Vec<f64> = self.blocks[first..=last].iter().map(|block| block.mean_mm).collect();
            robust::median(&mut values).unwrap_or(0.0)
        };
        let tolerance = 4.0 * self.scatter_sigma;
        let head_mm = level(from, to.min(from + NEAR));
        let tail_mm = level(from.max(to.saturating_sub(NEAR)), to);
        let on = |at: usize, level_mm: f64| (self.blocks[at].mean_mm - level_mm).abs() <= tolerance;
        let adjoins = |a: usize, b: usize| {
            self.blocks[a].epoch == self.blocks[b].epoch
                && self.blocks[b].t_s - self.blocks[a].t_s < LEAST_MOVE_S
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
            if last + 1 < self.blocks.len() && adjoins(last, last + 1) && on(last + 1, tail_mm) {
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
fn joined(runs: Vec<Run>, fine: &Scale) -> Vec<Run> {
    let mut whole: Vec<Run> = Vec::new();
    for mut run in runs {
        if let Some(before) = whole.last_mut() {
            let (left, right) =
                (&fine.blocks[before.to.min(run.from)], &fine.blocks[run.from.max(before.to)]);
            let apart_s = right.t_s - left.t_s;
            let one_level = (run.level_mm - before.level_mm).abs() <= 2.0 * fine.scatter_sigma;
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

/// Trimmed means of the valid readings in blocks of `block_s`; a block without a valid reading is left out.
fn blocks(stream: &Stream, block_s: f64) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut values: Vec<f64> = Vec::new();
    let mut breaks = stream.breaks.iter().peekable();
    let (mut begin_s, mut epoch) = (0.0, 0);
    let mut close = |values: &mut Vec<f64>, begin_s: f64, epoch: usize| {
        if let Some(mean_mm) = robust::trimmed_mean(values) {
            blocks.push(Block { t_s: begin_s + 0.5 * block_s, mean_mm, epoch });
        }
        values.clear();
    };
    for (at, (&t_s, &reading_mm)) in stream.t_s.iter().zip(&stream.reading_mm).enumerate() {
        let broke = breaks.next_if(|&&broken| broken <= at).is_some();
        if broke || t_s >= begin_s + block_s {
            close(&mut values, begin_s, epoch);
            epoch += usize::from(broke);
            begin_s = if broke { t_s } else { (t_s / block_s).floor() * block_s };
            // Rounding must not open the block before the one that was closed.
            begin_s = begin_s.max(t_s - block_s);
        }
        if stream.valid(at) {
            values.push(reading_mm);
        }
    }
    close(&mut values, begin_s, epoch);
    blocks
}
