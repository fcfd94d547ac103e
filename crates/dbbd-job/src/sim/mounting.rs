//! The errors of a badly mounted bar: the ball is not seated, creeps or slips, or the cable pulls.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64;

use super::fault::InjectedFaults;

/// Mean time for which an unseated bar stays on one side, s.
const ROCKING_S: f64 = 0.08;
/// Time constant of creep, s.
const CREEP_S: f64 = 20.0;
/// Time to the next slip or pull, s.
const INTERVAL_S: [f64; 2] = [10.0, 20.0];
/// Duration of the motion of a slip in each direction and of the time between them, s.
const SLIPPING_S: f64 = 0.005;
const SLIPPED_S: [f64; 2] = [0.1, 0.5];
/// Number of swings of a pulling cable, and their period, s.
const SWINGS: f64 = 3.0;
const PERIOD_S: [f64; 2] = [0.8, 2.4];

/// A temporary disturbance.
#[derive(Clone, Copy, Debug)]
struct Disturbance {
    since_s: f64,
    lasts_s: f64,
}

/// A mounted bar with the mounting faults among [`InjectedFaults`].
#[derive(Clone, Debug)]
pub struct SimulatedMounting {
    faults: InjectedFaults,
    random: Pcg64,
    /// When the bar was mounted, s.
    mounted_s: Option<f64>,
    onset_s: Option<f64>,
    tilted: bool,
    tilts_s: f64,
    next_slip_s: f64,
    next_pull_s: f64,
    slip: Option<Disturbance>,
    pull: Option<Disturbance>,
    strobe: bool,
    strobe_seen: bool,
}

impl SimulatedMounting {
    pub fn new(faults: InjectedFaults, seed: u64) -> Self {
        Self {
            faults,
            // A random stream of its own, which leaves that of the line unchanged.
            random: Pcg64::seed_from_u64(seed ^ 0x6c6f_6f73_6500_0000),
            mounted_s: None,
            onset_s: None,
            tilted: false,
            tilts_s: 0.0,
            next_slip_s: 0.0,
            next_pull_s: 0.0,
            slip: None,
            pull: None,
            strobe: false,
            strobe_seen: false,
        }
    }

    /// When the last disturbance (mounting, slip or pull) began, s.
    pub fn onset_s(&self) -> Option<f64> {
        self.onset_s
    }

    fn between(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.random.random_range(low..high)
    }

    /// The error of a reading at `t_s`, mm. The cable pulls while the robot is at rest: before the first strobe, or from the
    /// beginning of a dwell.
    pub fn offset_mm(&mut self, t_s: f64, mounted: bool, strobe: bool) -> f64 {
        let before = std::mem::replace(&mut self.strobe, strobe);
        let is_dwell_start = strobe && !before;
        self.strobe_seen |= strobe;
        if !mounted {
            (self.mounted_s, self.slip, self.pull) = (None, None, None);
            return 0.0;
        }
        if self.mounted_s.is_none() {
            (self.mounted_s, self.onset_s) = (Some(t_s), Some(t_s));
            (self.next_slip_s, self.next_pull_s) =
                (t_s + self.between(INTERVAL_S), t_s + self.between(INTERVAL_S));
            self.strobe_seen = strobe;
        }
        let mounted_for_s = t_s - self.mounted_s.unwrap_or(t_s);
        let um = self.rocking_um(t_s)
            + self.faults.creep_um * (1.0 - (-mounted_for_s / CREEP_S).exp())
            + self.slip_um(t_s)
            + self.pull_um(t_s, is_dwell_start || !self.strobe_seen);
        um * 1e-3
    }

    fn rocking_um(&mut self, t_s: f64) -> f64 {
        if self.faults.unseated_um == 0.0 {
            return 0.0;
        }
        while self.tilts_s <= t_s {
            let time: f64 = Exp1.sample(&mut self.random);
            self.tilts_s = self.tilts_s.max(t_s) + ROCKING_S * time;
            self.tilted = !self.tilted;
        }
        if self.tilted { self.faults.unseated_um } else { 0.0 }
    }

    fn slip_um(&mut self, t_s: f64) -> f64 {
        if self.faults.slip_um == 0.0 {
            return 0.0;
        }
        if self.slip.is_none() && t_s >= self.next_slip_s {
            let lasts_s = self.between(SLIPPED_S);
            (self.slip, self.onset_s) = (Some(Disturbance { since_s: t_s, lasts_s }), Some(t_s));
        }
        let Some(Disturbance { since_s, lasts_s }) = self.slip else { return 0.0 };
        let elapsed_s = t_s - since_s;
        if elapsed_s > lasts_s + 2.0 * SLIPPING_S {
            self.slip = None;
            self.next_slip_s = t_s + self.between(INTERVAL_S);
        }
        let share = (elapsed_s / SLIPPING_S).min((lasts_s + 2.0 * SLIPPING_S - elapsed_s) / SLIPPING_S);
        self.faults.slip_um * share.clamp(0.0, 1.0)
    }

    fn pull_um(&mut self, t_s: f64, may_begin: bool) -> f64 {
        if self.faults.cable_um == 0.0 {
            return 0.0;
        }
        if self.pull.is_none() && t_s >= self.next_pull_s && may_begin {
            let lasts_s = SWINGS * self.between(PERIOD_S);
            (self.pull, self.onset_s) = (Some(Disturbance { since_s: t_s, lasts_s }), Some(t_s));
        }
        let Some(Disturbance { since_s, lasts_s }) = self.pull else { return 0.0 };
        let elapsed_s = t_s - since_s;
        if elapsed_s > lasts_s {
            self.pull = None;
            self.next_pull_s = t_s + self.between(INTERVAL_S);
            return 0.0;
        }
        0.5 * self.faults.cable_um * (1.0 - (TAU * SWINGS * elapsed_s / lasts_s).cos())
    }
}
