//! Monitors the readings of one bar.

use std::collections::VecDeque;

use super::still::{DEVIATE, StillStatistics, regression};
use super::{DetectedFault, ExpectedMounting, MountedReading, MountingFault, MountingState, RestCondition};
use dbbd_model::math::robust;

/// Readings are averaged over this time, s.
const GRAIN_S: f64 = 0.005;
/// Length of the lines on both sides of a jump, s.
const SIDE_S: f64 = 0.04;
/// Least and largest number of grains on each side of a jump.
const SIDE_GRAINS: [usize; 2] = [3, 8];
/// Longest duration of a jump, s.
const JUMP_S: f64 = 0.01;
/// A sudden change of speed looks like a jump by this share of the distance travelled in the time of a side. It is
/// computed as the largest mismatch of two lines through a bend.
const BEND: f64 = 0.25;
/// Vibration of a bar on a robot that moves or has just stopped, mm: 1 mm/s, stopped at once, at 12 Hz.
const VIBRATION_MM: f64 = 0.013;
/// Length of the means that are compared while the robot rests, s.
const BLOCK_S: f64 = 0.05;
/// Least and largest number of blocks compared. The least fits into a dwell of half a second.
const BLOCKS: [usize; 2] = [8, 24];
/// Hands hold a bar within this distance, mm, but only for less than this time, s.
const HANDS_MM: f64 = 0.3;
const HANDS_S: f64 = 0.4;
/// Changes below this number of standard deviations of a reading do not matter.
const MATTERS: f64 = 2.0;
/// Roughness (half the mean squared step over the variance of the block means) of a rocking bar: white noise has 1, a
/// slow pull of one second 0.05.
const ROUGH: f64 = 0.25;
/// Comparisons until a pull has started.
const BEGIN: u32 = 6;
/// A slipping magnet returns within this time, s, and is quiet for this time afterwards.
const RETURN_S: f64 = 1.0;
const QUIET_S: f64 = 0.4;
/// Number of jumps of a rocking bar, and the time in which they come, s.
const ROCKING: usize = 3;
const ROCKING_S: f64 = 1.5;
/// A fault is reported again after this time, s.
const AGAIN_S: f64 = 10.0;
/// Longest time of an invalid reading, s: a bar that is off for longer was taken off.
const TAKEN_OFF_S: f64 = 2.0;
/// Longest gap between samples, s and in samples: a longer one restarts the comparison.
const GAP_S: f64 = 0.25;
const GAP_SAMPLES: f64 = 3.0;

#[derive(Clone, Copy, Debug)]
struct AveragedReading {
    t_s: f64,
    mean_mm: f64,
    readings: u32,
    rests: bool,
}

#[derive(Clone, Copy, Debug)]
struct ReadingJump {
    t_s: f64,
    height_mm: f64,
}

/// Sum of an incomplete grain.
#[derive(Clone, Copy, Debug)]
struct PartialAverage {
    since_s: f64,
    sum_mm: f64,
    readings: u32,
    rests: bool,
}

#[derive(Clone, Debug)]
pub struct MountingMonitor {
    expected: ExpectedMounting,
    partial: Option<PartialAverage>,
    last_s: Option<f64>,
    /// Latest grains, the oldest first.
    grains: VecDeque<AveragedReading>,
    since_block: usize,
    /// Time since which only magnets hold the bar, s.
    settled_s: Option<f64>,
    strobe_seen: bool,
    /// Time since which the bar is off, s.
    off_s: Option<f64>,
    /// Whether the strobe was high at the last reading, and the number of dwells that began without a valid reading.
    was_strobe: bool,
    out_of_stroke: u32,
    /// Grains before this time are not compared, s.
    compare_from_s: f64,
    /// Largest mismatch of the jump in progress.
    passing: Option<ReadingJump>,
    jumps: Vec<ReadingJump>,
    /// The latest report of each fault.
    named: Vec<DetectedFault>,
    /// Standard deviation of a grain, mm.
    noise_mm: f64,
    still: Option<StillStatistics>,
    /// Consecutive comparisons with scatter.
    scattered: u32,
}

impl MountingMonitor {
    pub fn new(expected: ExpectedMounting) -> Self {
        Self {
            expected,
            partial: None,
            last_s: None,
            grains: VecDeque::new(),
            since_block: 0,
            settled_s: None,
            strobe_seen: expected.rest == RestCondition::UnderWay,
            off_s: None,
            was_strobe: false,
            out_of_stroke: 0,
            compare_from_s: f64::NEG_INFINITY,
            passing: None,
            jumps: Vec::new(),
            named: Vec::new(),
            noise_mm: expected.noise_mm,
            still: None,
            scattered: 0,
        }
    }

    /// Takes a reading; times must not decrease. Returns a fault that it completes.
    pub fn push(&mut self, now: MountedReading) -> Option<DetectedFault> {
        let gap_s = self.last_s.replace(now.t_s).map_or(0.0, |last| now.t_s - last);
        let is_high = now.strobe == Some(true);
        let was_high = std::mem::replace(&mut self.was_strobe, is_high);
        let begins = is_high && !was_high;
        if !now.mounted || gap_s > GAP_S.max(GAP_SAMPLES * self.grain_s()) || gap_s < 0.0 {
            self.interrupt(now);
            if !now.mounted {
                return begins.then(|| self.dwell_without_reading(now.t_s)).flatten();
            }
        }
        self.off_s = None;
        self.strobe_seen |= now.strobe == Some(true);
        let rests = match now.strobe {
            Some(high) => high || !self.strobe_seen,
            None => self.expected.rest == RestCondition::Standing,
        };
        let partial =
            self.partial.get_or_insert(PartialAverage { since_s: now.t_s, sum_mm: 0.0, readings: 0, rests });
        partial.sum_mm += now.reading_mm;
        partial.readings += 1;
        partial.rests &= rests;
        let PartialAverage { since_s, sum_mm, readings, rests } = *partial;
        // A grain has whole samples, and as many as the one before.
        let step_s = if readings > 1 { (now.t_s - since_s) / f64::from(readings - 1) } else { gap_s };
        if now.t_s - since_s + step_s < 0.75 * GRAIN_S && readings < 10_000 {
            return None;
        }
        self.partial = None;
        let t_s = 0.5 * (since_s + now.t_s);
        self.grain(AveragedReading { t_s, mean_mm: sum_mm / f64::from(readings), readings, rests })
    }

    /// The number of dwells that began without a valid reading: the program goes on, but the bar is out of its stroke.
    pub fn out_of_stroke(&self) -> u32 {
        self.out_of_stroke
    }

    fn dwell_without_reading(&mut self, t_s: f64) -> Option<DetectedFault> {
        self.out_of_stroke += 1;
        self.name(DetectedFault {
            fault: MountingFault::OutOfStroke,
            t_s,
            size: f64::from(self.out_of_stroke),
        })
    }

    /// Discards all grains. A bar that was off for a long time, in which no dwell began, was taken off, and its robot rests.
    fn interrupt(&mut self, now: MountedReading) {
        let since_s = self.off_s.filter(|_| now.strobe != Some(true));
        let off_s = (!now.mounted).then(|| since_s.unwrap_or(now.t_s));
        let taken_off = off_s.is_some_and(|since_s| now.t_s - since_s >= TAKEN_OFF_S);
        let mut expected = self.expected;
        if taken_off && expected.rest == RestCondition::UnderWay {
            expected.rest = RestCondition::Standing;
        }
        let strobe_seen = self.strobe_seen && !taken_off;
        let named = std::mem::take(&mut self.named);
        *self = Self {
            named,
            off_s,
            strobe_seen,
            was_strobe: self.was_strobe,
            out_of_stroke: self.out_of_stroke,
            last_s: Some(now.t_s),
            ..Self::new(expected)
        };
    }

    pub fn state(&self) -> MountingState {
        match (self.grains.back(), self.settled_s) {
            (None, _) => MountingState::Off,
            (Some(last), _) if !last.rests => MountingState::Moving,
            (Some(_), None) => MountingState::Handled,
            (Some(_), Some(_)) if self.still.is_some_and(|still| still.is_quiet()) => MountingState::Stable,
            (Some(_), Some(_)) => MountingState::Settling,
        }
    }

    /// Standard deviation and drift of a bar at rest, mm and mm/s.
    pub fn scatter(&self) -> Option<[f64; 2]> {
        self.still.map(|still| [still.scatter_mm, still.slope_mm_s])
    }

    /// Time between grains, s; before there are grains, the time for 200 readings per second.
    fn grain_s(&self) -> f64 {
        let span = self.grains.back().zip(self.grains.front()).map(|(last, first)| last.t_s - first.t_s);
        let steps = self.grains.len().saturating_sub(1);
        span.filter(|_| steps > 0).map_or(GRAIN_S, |span| span / steps as f64)
    }

    fn grain(&mut self, grain: AveragedReading) -> Option<DetectedFault> {
        self.grains.push_back(grain);
        let dt = self.grain_s();
        let in_block = ((BLOCK_S / dt).round() as usize).max(1);
        let excess = self.grains.len().saturating_sub(in_block * BLOCKS[1]);
        self.grains.drain(..excess);
        self.settle(dt);
        let settled_s = self.settled_s?;
        self.jump(dt, settled_s);
        self.since_block += 1;
        let jumped = self.fault_of_jumps(grain.t_s);
        if jumped.is_some() || self.since_block < in_block {
            return jumped;
        }
        self.since_block = 0;
        self.noise_mm = self.noise_mm();
        self.fault_at_rest(in_block, dt)
    }

    /// Detects whether hands are on the bar.
    fn settle(&mut self, dt: f64) {
        // Once the program runs, the robot moves the reading, not hands.
        let moves = self.strobe_seen || self.grains.back().is_some_and(|grain| !grain.rests);
        if self.settled_s.is_some() && moves {
            return;
        }
        let wanted = (HANDS_S / dt).ceil() as usize;
        if self.grains.len() < wanted.max(2) {
            return;
        }
        let newest = self.grains.iter().rev().take(wanted.max(2));
        let (low, high) = newest.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), grain| {
            (low.min(grain.mean_mm), high.max(grain.mean_mm))
        });
        let still = high - low <= HANDS_MM;
        if still && self.settled_s.is_none() {
            let now_s = self.last_s.unwrap_or_default();
            (self.settled_s, self.compare_from_s) = (Some(now_s), now_s);
        } else if !still {
            (self.settled_s, self.still, self.passing) = (None, None, None);
            self.jumps.clear();
        }
    }

    /// Standard deviation of a grain, mm: as expected, or up to three times as much for a noisier bar.
    fn noise_mm(&self) -> f64 {
        let readings = self.grains.back().map_or(1, |grain| grain.readings.max(1));
        let expected = self.expected.noise_mm / f64::from(readings).sqrt();
        let means: Vec<f64> = self.grains.iter().map(|grain| grain.mean_mm).collect();
        let mut bends: Vec<f64> = means.windows(3).map(|w| (w[0] - 2.0 * w[1] + w[2]).abs()).collect();
        // A second difference of white noise has the variance 1 + 4 + 1.
        let measured = robust::median(&mut bends).unwrap_or(0.0) * robust::SIGMA_OF_MAD / 6.0_f64.sqrt();
        measured.clamp(expected, 3.0 * expected)
    }

    /// Follows a jump as it passes the middle of the latest grains.
    fn jump(&mut self, dt: f64, settled_s: f64) {
        let side = ((SIDE_S / dt).round() as usize).clamp(SIDE_GRAINS[0], SIDE_GRAINS[1]);
        let gap = ((JUMP_S / dt).round() as usize).max(1);
        let wanted = 2 * side + gap;
        if self.grains.len() < wanted {
            return;
        }
        let newest: Vec<AveragedReading> = self.grains.range(self.grains.len() - wanted..).copied().collect();
        if let (Some(passing), Some(last)) = (self.passing, newest.last())
            && last.t_s - passing.t_s > (wanted + side) as f64 * dt
        {
            self.jumps.push(passing);
            self.passing = None;
        }
        if newest[0].t_s < settled_s {
            return;
        }
        let reach = 0.5 * (side + gap) as f64;
        let line = |grains: &[AveragedReading]| regression(grains.iter().map(|grain| grain.mean_mm));
        let (Some(before), Some(after)) = (line(&newest[..side]), line(&newest[side + gap..])) else {
            return;
        };
        let height_mm = (after.centre[1] - after.slope * reach) - (before.centre[1] + before.slope * reach);
        let n = side as f64;
        let leverage = 1.0 / n + reach * reach * 12.0 / (n * (n * n - 1.0));
        let noise_mm = self.noise_mm;
        let rests = newest.iter().all(|grain| grain.rests);
        let moved_mm = if rests { 0.0 } else { self.expected.speed_mm_s * BEND * n * dt };
        let threshold_mm = (DEVIATE * noise_mm * (2.0 * leverage).sqrt()).max(2.0 * MATTERS * noise_mm)
            + moved_mm
            + VIBRATION_MM;
        let larger = self.passing.is_none_or(|passing| height_mm.abs() > passing.height_mm.abs());
        if height_mm.abs() > threshold_mm && larger {
            let t_s = 0.5 * (newest[side - 1].t_s + newest[side + gap].t_s);
            self.passing = Some(ReadingJump { t_s, height_mm });
        }
    }

    /// The fault that the jumps so far show.
    fn fault_of_jumps(&mut self, now_s: f64) -> Option<DetectedFault> {
        let last = self.jumps.last()?;
        self.compare_from_s = self.compare_from_s.max(last.t_s + 2.0 * SIDE_S);
        self.still = None;
        let quiet_s = if self.passing.is_some() { 0.0 } else { now_s - last.t_s };
        let recent = self.jumps.iter().filter(|jump| now_s - jump.t_s <= ROCKING_S).count();
        let height_mm = self.jumps.iter().map(|jump| jump.height_mm.abs()).fold(0.0, f64::max);
        let returned = |away: &ReadingJump, back: &ReadingJump| {
            let left_mm = (away.height_mm + back.height_mm).abs();
            back.t_s - away.t_s <= RETURN_S && left_mm < 0.5 * height_mm
        };
        let (fault, wait_s) = match &self.jumps[..] {
            _ if recent >= ROCKING => (MountingFault::NotSeated, 0.0),
            [away, back] if returned(away, back) => (MountingFault::Slip, QUIET_S),
            _ => (MountingFault::Moved, ROCKING_S),
        };
        if quiet_s < wait_s {
            return None;
        }
        self.jumps.clear();
        self.name(DetectedFault { fault, t_s: now_s, size: height_mm })
    }

    /// The fault that a bar at rest shows.
    fn fault_at_rest(&mut self, in_block: usize, dt: f64) -> Option<DetectedFault> {
        let comparable = |grain: &&AveragedReading| grain.rests && grain.t_s >= self.compare_from_s;
        let mut means: Vec<f64> =
            self.grains.iter().rev().take_while(comparable).map(|g| g.mean_mm).collect();
        means.reverse();
        let newest = means.rchunks_exact(in_block).take(BLOCKS[1]);
        let mut blocks: Vec<f64> = newest.map(|block| block.iter().sum::<f64>() / in_block as f64).collect();
        blocks.reverse();
        self.still = None;
        if blocks.len() < BLOCKS[0] || self.passing.is_some() || !self.jumps.is_empty() {
            return None;
        }
        let noise_mm = self.noise_mm / (in_block as f64).sqrt();
        let still = StillStatistics::of(&blocks, in_block as f64 * dt, noise_mm)?;
        self.still = Some(still);
        let t_s = self.last_s.unwrap_or_default();
        let matters_mm = MATTERS * self.expected.noise_mm;
        let curved_mm = still.scatter_mm * 8.0_f64.sqrt();
        let drift_mm = (still.slope_mm_s * still.span_s).abs();
        self.scattered = if still.is_scattered() { self.scattered + 1 } else { 0 };
        // The start of a pull is as rough as rocking.
        if !self.strobe_seen && (1..BEGIN).contains(&self.scattered) {
            return None;
        }
        if still.is_scattered() && still.roughness > ROUGH {
            return (curved_mm > matters_mm)
                .then_some(DetectedFault {
                    fault: MountingFault::NotSeated,
                    t_s,
                    size: 2.0 * still.scatter_mm,
                })
                .and_then(|named| self.name(named));
        }
        // The start of a pull looks like a creep; a dwell is too short to show more.
        let whole = still.blocks == BLOCKS[1];
        let crept = self.named.iter().any(|named| named.fault == MountingFault::Creep);
        if !whole && !self.strobe_seen {
            return None;
        }
        let (fault, size) = if still.is_scattered() && curved_mm.max(drift_mm) > matters_mm {
            (MountingFault::CablePull, curved_mm.max(drift_mm))
        } else if !still.is_drifting() || drift_mm <= matters_mm {
            return None;
        } else if whole || crept {
            (MountingFault::Creep, still.slope_mm_s)
        } else {
            (MountingFault::CablePull, drift_mm)
        };
        self.name(DetectedFault { fault, t_s, size })
    }

    /// Reports a fault unless it was reported a moment ago.
    fn name(&mut self, named: DetectedFault) -> Option<DetectedFault> {
        self.compare_from_s = named.t_s;
        // A bar that leaves its stroke explains whatever else it seems to do.
        if self.out_of_stroke > 0 && named.fault != MountingFault::OutOfStroke {
            return None;
        }
        let before = self.named.iter_mut().find(|before| before.fault == named.fault);
        match before {
            Some(before) if named.t_s - before.t_s < AGAIN_S => return None,
            Some(before) => *before = named,
            None => self.named.push(named),
        }
        Some(named)
    }
}
