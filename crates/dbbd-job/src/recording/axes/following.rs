//! Compares the measured axes with the commanded axes.

use serde::Serialize;

use super::track::{AxisTrack, RestInterval};
use dbbd_model::robot::AXES;

/// An axis counts as moving above this speed, degrees/s.
const MOVES_DEG_S: f64 = 0.1;
/// An axis has settled within this distance of its rest position, degrees.
pub const SETTLED_DEG: f64 = 0.005;
/// Length of the search for settling before a rest, s.
const SETTLING_S: f64 = 2.0;

#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct FollowingError {
    /// Number of the axis, from 1.
    pub axis: usize,
    /// Delay of the measured behind the commanded axis in motion, s.
    pub lag_s: f64,
    /// RMS of commanded less measured angle in motion, degrees.
    pub moving_rms_deg: f64,
    /// Largest difference in motion, degrees.
    pub moving_max_deg: f64,
    /// Largest mean difference over a rest, degrees.
    pub rest_max_deg: f64,
    /// Mean time from the end of the command until the axis stays within [`SETTLED_DEG`], s; `None` if no
    /// rest shows it.
    pub settling_s: Option<f64>,
}

impl AxisTrack {
    /// The following error of each axis; `None` if the commanded axes are unknown.
    pub fn following(&self, rests: &[RestInterval]) -> Option<[FollowingError; AXES]> {
        (!self.commanded_deg.is_empty()).then(|| std::array::from_fn(|axis| self.follow(axis, rests)))
    }

    fn follow(&self, axis: usize, rests: &[RestInterval]) -> FollowingError {
        let error = |at: usize| self.commanded_deg[at][axis] - self.measured_deg[at][axis];
        let (mut moving, mut squares, mut products, mut speeds, mut most) = (0_u64, 0.0, 0.0, 0.0, 0.0_f64);
        for at in 1..self.len().saturating_sub(1) {
            let span_s = self.t_s[at + 1] - self.t_s[at - 1];
            let speed = (self.commanded_deg[at + 1][axis] - self.commanded_deg[at - 1][axis]) / span_s;
            // Across lost packets the difference gives only a mean speed.
            if span_s > 3.0 * self.period_of_cycle_s() || speed.abs() < MOVES_DEG_S {
                continue;
            }
            moving += 1;
            squares += error(at) * error(at);
            products += error(at) * speed;
            speeds += speed * speed;
            most = most.max(error(at).abs());
        }
        let at_rest = rests.iter().map(|rest| {
            let [commanded, measured] = [&self.commanded_deg, &self.measured_deg]
                .map(|column| self.mean_deg(&rest.samples, column)[axis]);
            (commanded - measured).abs()
        });
        let settling: Vec<f64> = rests.iter().filter_map(|rest| self.settling_s(axis, rest)).collect();
        FollowingError {
            axis: axis + 1,
            lag_s: if speeds > 0.0 { products / speeds } else { 0.0 },
            moving_rms_deg: if moving > 0 { (squares / moving as f64).sqrt() } else { 0.0 },
            moving_max_deg: most,
            rest_max_deg: at_rest.fold(0.0, f64::max),
            settling_s: (!settling.is_empty()).then(|| settling.iter().sum::<f64>() / settling.len() as f64),
        }
    }

    fn period_of_cycle_s(&self) -> f64 {
        self.counts.cycle_us as f64 * 1e-6
    }

    /// Time for which the axis moves on after its command stopped before a rest, s; `None` if it did not move.
    fn settling_s(&self, axis: usize, rest: &RestInterval) -> Option<f64> {
        let (first, last) = (self.at(rest.start_s - SETTLING_S), rest.samples.end.min(self.len()));
        let (commanded, measured) = (&self.commanded_deg, &self.measured_deg);
        let middle = rest.samples.start + (rest.samples.end - rest.samples.start) / 2;
        let goal = commanded.get(middle)?[axis];
        let stopped = (first..middle).rev().find(|at| (commanded[*at][axis] - goal).abs() > 1e-4)? + 1;
        let rests_at =
            measured.get(middle..last)?.iter().map(|row| row[axis]).sum::<f64>() / (last - middle) as f64;
        let off = |at: &usize| (measured[*at][axis] - rests_at).abs() > SETTLED_DEG;
        let settled = (stopped..middle).rev().find(off).map_or(stopped, |at| at + 1);
        Some(self.t_s[settled] - self.t_s[stopped])
    }
}
