//! A bar that is mounted badly: what its readings have besides the length.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64;

/// Mean time that a bar that is not seated stays on one side, s.
const ROCKS_S: f64 = 0.08;
/// Time constant of a creep, s.
const CREEPS_S: f64 = 20.0;
/// Time to the next slip or pull, s.
const NEXT_S: [f64; 2] = [10.0, 20.0];
/// A slip takes so long each way, and stays away for so long, s.
const SLIPS_S: f64 = 0.005;
const AWAY_S: [f64; 2] = [0.1, 0.5];
/// The cable swings so often, with such a period, s.
const SWINGS: f64 = 3.0;
const PERIOD_S: [f64; 2] = [0.8, 2.4];

/// How badly a bar is mounted; 0 is well.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Looseness {
    /// The bar rocks by so much, micrometres.
    pub unseated_um: f64,
    /// A ball creeps by so much in all after mounting, micrometres.
    pub creep_um: f64,
    /// A magnet slips by so much every now and then, micrometres.
    pub slip_um: f64,
    /// The cable pulls by so much every now and then, micrometres.
    pub cable_um: f64,
}

/// A disturbance that comes and goes.
#[derive(Clone, Copy, Debug)]
struct Passing {
    since_s: f64,
    lasts_s: f64,
}

/// A badly mounted bar with its dice.
#[derive(Clone, Debug)]
pub struct Loose {
    looseness: Looseness,
    dice: Pcg64,
    /// Since when the bar is between its balls, s.
    mounted_s: Option<f64>,
    onset_s: Option<f64>,
    tilted: bool,
    tilts_s: f64,
    next_slip_s: f64,
    next_pull_s: f64,
    slip: Option<Passing>,
    pull: Option<Passing>,
    strobe: bool,
    strobe_seen: bool,
}

impl Loose {
    pub fn new(looseness: Looseness, seed: u64) -> Self {
        Self {
            looseness,
            // A stream of its own: the line's dice stay as they are.
            dice: Pcg64::seed_from_u64(seed ^ 0x6c6f_6f73_6500_0000),
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

    /// When the last disturbance began, s: the mounting, a slip or a pull.
    pub fn onset_s(&self) -> Option<f64> {
        self.onset_s
    }

    fn between(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.dice.random_range(low..high)
    }

    /// What a reading at `t_s` has besides the length, mm. The cable pulls where the robot rests: before the first
    /// strobe, and from the begin of a dwell.
    pub fn offset_mm(&mut self, t_s: f64, mounted: bool, strobe: bool) -> f64 {
        let before = std::mem::replace(&mut self.strobe, strobe);
        let risen = strobe && !before;
        self.strobe_seen |= strobe;
        if !mounted {
            (self.mounted_s, self.slip, self.pull) = (None, None, None);
            return 0.0;
        }
        if self.mounted_s.is_none() {
            (self.mounted_s, self.onset_s) = (Some(t_s), Some(t_s));
            (self.next_slip_s, self.next_pull_s) = (t_s + self.between(NEXT_S), t_s + self.between(NEXT_S));
            self.strobe_seen = strobe;
        }
        let since_s = t_s - self.mounted_s.unwrap_or(t_s);
        let um = self.rocking_um(t_s)
            + self.looseness.creep_um * (1.0 - (-since_s / CREEPS_S).exp())
            + self.slip_um(t_s)
            + self.pull_um(t_s, risen || !self.strobe_seen);
        um * 1e-3
    }

    fn rocking_um(&mut self, t_s: f64) -> f64 {
        if self.looseness.unseated_um == 0.0 {
            return 0.0;
        }
        while self.tilts_s <= t_s {
            let stays: f64 = Exp1.sample(&mut self.dice);
            self.tilts_s = self.tilts_s.max(t_s) + ROCKS_S * stays;
            self.tilted = !self.tilted;
        }
        if self.tilted { self.looseness.unseated_um } else { 0.0 }
    }

    fn slip_um(&mut self, t_s: f64) -> f64 {
        if self.looseness.slip_um == 0.0 {
            return 0.0;
        }
        if self.slip.is_none() && t_s >= self.next_slip_s {
            let lasts_s = self.between(AWAY_S);
            (self.slip, self.onset_s) = (Some(Passing { since_s: t_s, lasts_s }), Some(t_s));
        }
        let Some(Passing { since_s, lasts_s }) = self.slip else { return 0.0 };
        let into_s = t_s - since_s;
        if into_s > lasts_s + 2.0 * SLIPS_S {
            self.slip = None;
            self.next_slip_s = t_s + self.between(NEXT_S);
        }
        let share = (into_s / SLIPS_S).min((lasts_s + 2.0 * SLIPS_S - into_s) / SLIPS_S);
        self.looseness.slip_um * share.clamp(0.0, 1.0)
    }

    fn pull_um(&mut self, t_s: f64, may_begin: bool) -> f64 {
        if self.looseness.cable_um == 0.0 {
            return 0.0;
        }
        if self.pull.is_none() && t_s >= self.next_pull_s && may_begin {
            let lasts_s = SWINGS * self.between(PERIOD_S);
            (self.pull, self.onset_s) = (Some(Passing { since_s: t_s, lasts_s }), Some(t_s));
        }
        let Some(Passing { since_s, lasts_s }) = self.pull else { return 0.0 };
        let into_s = t_s - since_s;
        if into_s > lasts_s {
            self.pull = None;
            self.next_pull_s = t_s + self.between(NEXT_S);
            return 0.0;
        }
        0.5 * self.looseness.cable_um * (1.0 - (TAU * SWINGS * into_s / lasts_s).cos())
    }
}
