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

/// Disturbances of one kind: the present one, and the time at which the next may begin, s.
#[derive(Clone, Copy, Debug, Default)]
struct RecurringDisturbance {
    present: Option<Disturbance>,
    next_s: f64,
}

/// The side on which an unseated bar is, until a time in s.
#[derive(Clone, Copy, Debug, Default)]
struct Rocking {
    is_tilted: bool,
    until_s: f64,
}

/// A mounted bar with the mounting faults among [`InjectedFaults`].
#[derive(Clone, Debug)]
pub struct SimulatedMounting {
    faults: InjectedFaults,
    random: Pcg64,
    /// The time at which the bar was mounted, s.
    mounted_s: Option<f64>,
    onset_s: Option<f64>,
    rocking: Rocking,
    slip: RecurringDisturbance,
    pull: RecurringDisturbance,
    strobe: bool,
    /// Whether the strobe was high since the bar was mounted.
    strobe_seen: bool,
}

impl SimulatedMounting {
    pub fn new(faults: InjectedFaults, seed: u64) -> Self {
        Self {
            faults,
            // A separate random stream, so that the stream of the line is unchanged.
            random: Pcg64::seed_from_u64(seed ^ 0x6c6f_6f73_6500_0000),
            mounted_s: None,
            onset_s: None,
            rocking: Rocking::default(),
            slip: RecurringDisturbance::default(),
            pull: RecurringDisturbance::default(),
            strobe: false,
            strobe_seen: false,
        }
    }

    /// The time at which the last disturbance (mounting, slip or pull) began, s.
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
            (self.mounted_s, self.slip.present, self.pull.present) = (None, None, None);
            return 0.0;
        }
        if self.mounted_s.is_none() {
            (self.mounted_s, self.onset_s) = (Some(t_s), Some(t_s));
            (self.slip.next_s, self.pull.next_s) =
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
        while self.rocking.until_s <= t_s {
            let time: f64 = Exp1.sample(&mut self.random);
            self.rocking.until_s = self.rocking.until_s.max(t_s) + ROCKING_S * time;
            self.rocking.is_tilted = !self.rocking.is_tilted;
        }
        if self.rocking.is_tilted { self.faults.unseated_um } else { 0.0 }
    }

    fn slip_um(&mut self, t_s: f64) -> f64 {
        if self.faults.slip_um == 0.0 {
            return 0.0;
        }
        if self.slip.present.is_none() && t_s >= self.slip.next_s {
            let lasts_s = self.between(SLIPPED_S);
            (self.slip.present, self.onset_s) = (Some(Disturbance { since_s: t_s, lasts_s }), Some(t_s));
        }
        let Some(Disturbance { since_s, lasts_s }) = self.slip.present else { return 0.0 };
        let elapsed_s = t_s - since_s;
        if elapsed_s > lasts_s + 2.0 * SLIPPING_S {
            self.slip.present = None;
            self.slip.next_s = t_s + self.between(INTERVAL_S);
        }
        let share = (elapsed_s / SLIPPING_S).min((lasts_s + 2.0 * SLIPPING_S - elapsed_s) / SLIPPING_S);
        self.faults.slip_um * share.clamp(0.0, 1.0)
    }

    fn pull_um(&mut self, t_s: f64, may_begin: bool) -> f64 {
        if self.faults.cable_um == 0.0 {
            return 0.0;
        }
        if self.pull.present.is_none() && t_s >= self.pull.next_s && may_begin {
            let lasts_s = SWINGS * self.between(PERIOD_S);
            (self.pull.present, self.onset_s) = (Some(Disturbance { since_s: t_s, lasts_s }), Some(t_s));
        }
        let Some(Disturbance { since_s, lasts_s }) = self.pull.present else { return 0.0 };
        let elapsed_s = t_s - since_s;
        if elapsed_s > lasts_s {
            self.pull.present = None;
            self.pull.next_s = t_s + self.between(INTERVAL_S);
            return 0.0;
        }
        0.5 * self.faults.cable_um * (1.0 - (TAU * SWINGS * elapsed_s / lasts_s).cos())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mounting(faults: InjectedFaults) -> SimulatedMounting {
        SimulatedMounting::new(faults, 5)
    }

    #[test]
    fn bar_creeps_with_a_time_constant_of_twenty_seconds_from_its_mounting() {
        let mut creeping = mounting(InjectedFaults { creep_um: 40.0, ..InjectedFaults::default() });
        assert_eq!(creeping.offset_mm(3.0, false, false), 0.0);
        assert_eq!(creeping.offset_mm(5.0, true, false), 0.0);
        assert_eq!(creeping.onset_s(), Some(5.0));
        for (elapsed_s, share) in [(20.0, 1.0 - (-1.0_f64).exp()), (10.0, 1.0 - (-0.5_f64).exp())] {
            assert!((creeping.offset_mm(5.0 + elapsed_s, true, false) - 0.04 * share).abs() < 1e-12);
        }
        // After the bar was taken off and mounted, the creep begins again.
        creeping.offset_mm(40.0, false, false);
        assert_eq!(creeping.offset_mm(41.0, true, false), 0.0);
        assert_eq!(creeping.onset_s(), Some(41.0));
    }

    #[test]
    fn unseated_bar_rocks_between_two_lengths() {
        let mut rocking = mounting(InjectedFaults { unseated_um: 30.0, ..InjectedFaults::default() });
        let offsets: Vec<f64> =
            (0..200_000).map(|step| rocking.offset_mm(f64::from(step) * 1e-3, true, false)).collect();
        assert!(offsets.iter().all(|mm| *mm == 0.0 || *mm == 0.03));
        // A mean of 0.08 s on each side: 2500 changes in 200 s, with a standard deviation of 50.
        let changes = offsets.windows(2).filter(|pair| pair[0] != pair[1]).count();
        assert!((2250..=2750).contains(&changes), "{changes}");
    }

    /// Times at which the offset is not 0, as intervals, s.
    fn disturbed(mounting: &mut SimulatedMounting, strobe: impl Fn(f64) -> bool) -> Vec<[f64; 2]> {
        let mut found: Vec<[f64; 2]> = Vec::new();
        for step in 0..100_000 {
            let t_s = f64::from(step) * 1e-3;
            if mounting.offset_mm(t_s, true, strobe(t_s)) != 0.0 {
                match found.last_mut() {
                    Some(last) if t_s - last[1] < 0.01 => last[1] = t_s,
                    _ => found.push([t_s, t_s]),
                }
            }
        }
        found
    }

    #[test]
    fn magnet_slips_for_a_moment_every_ten_to_twenty_seconds() {
        let mut slipping = mounting(InjectedFaults { slip_um: -20.0, ..InjectedFaults::default() });
        let found = disturbed(&mut slipping, |_| false);
        assert!((5..=9).contains(&found.len()), "{found:?}");
        for [from_s, to_s] in &found {
            assert!((0.1..0.52).contains(&(to_s - from_s)), "{from_s} {to_s}");
        }
        for pair in found.windows(2) {
            assert!((9.9..20.1).contains(&(pair[1][0] - pair[0][1])), "{pair:?}");
        }
        // 5 ms out, then the whole slip, then 5 ms back: half of it after 2.5 ms.
        let mut slipping = mounting(InjectedFaults { slip_um: -20.0, ..InjectedFaults::default() });
        slipping.slip.present = Some(Disturbance { since_s: 1.0, lasts_s: 0.2 });
        for (t_s, um) in [(1.0025, -10.0), (1.005, -20.0), (1.1, -20.0), (1.2075, -10.0), (1.21, 0.0)] {
            assert!((slipping.slip_um(t_s) - um).abs() < 1e-9, "{t_s}");
        }
    }

    #[test]
    fn cable_swings_three_times_while_the_robot_is_at_rest() {
        let faults = InjectedFaults { cable_um: 10.0, ..InjectedFaults::default() };
        let mut pulled = mounting(faults);
        pulled.pull.present = Some(Disturbance { since_s: 2.0, lasts_s: 6.0 });
        // A swing of 2 s: (1 - cos) / 2 of the pull.
        for (t_s, um) in [(2.0, 0.0), (2.5, 5.0), (3.0, 10.0), (4.0, 0.0), (7.0, 10.0)] {
            assert!((pulled.pull_um(t_s, false) - um).abs() < 1e-9, "{t_s}");
        }
        // With dwells of 1 s every 5 s a pull begins with a dwell, and lasts 2.4 to 7.2 s.
        let mut pulled = mounting(faults);
        let found = disturbed(&mut pulled, |t_s| t_s % 5.0 >= 4.0);
        assert!(found.len() >= 3, "{found:?}");
        for [from_s, _] in &found {
            let into_dwell_s = from_s % 5.0 - 4.0;
            // A swing returns to 0 in between.
            assert!(into_dwell_s.abs() < 0.02 || from_s - found[0][0] > 0.0, "{from_s}");
        }
        let began = pulled.onset_s().expect("the cable pulled");
        assert!((began % 5.0 - 4.0).abs() < 0.02, "{began}");
    }
}
