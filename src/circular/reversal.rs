//! Where the robot's joints reverse along the circle: there backlash shows. On a robot that is not at
//! 0, 90, 180 and 270 degrees but wherever the axis angles turn.

use super::{Sense, Trace};

/// A joint reverses.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Reversal {
    pub run: String,
    pub sense: Sense,
    /// Number of the joint, from 1.
    pub joint: usize,
    /// Angle of the pose at which it turns, degrees, 0..360.
    pub angle_deg: f64,
}

/// A joint that moves less between two poses does not move, degrees.
const STILL_DEG: f64 = 1e-3;

/// The reversals of all traces that carry axis angles, in the order driven.
pub(super) fn of(traces: &[Trace]) -> Vec<Reversal> {
    let mut reversals = Vec::new();
    for Trace { run, sense, points } in traces {
        let mut going = [0.0_f64; 6];
        for pair in points.windows(2) {
            let (Some(from), Some(to)) = (pair[0].axes_deg, pair[1].axes_deg) else { continue };
            for (joint, going) in going.iter_mut().enumerate() {
                let step = to[joint] - from[joint];
                if step.abs() < STILL_DEG {
                    continue;
                }
                if *going * step < 0.0 {
                    let angle_deg = pair[0].angle_deg.rem_euclid(360.0);
                    reversals.push(Reversal { run: run.clone(), sense: *sense, joint: joint + 1, angle_deg });
                }
                *going = step;
            }
        }
    }
    reversals
}
