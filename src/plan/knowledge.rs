//! What is known of robot and set-up when a plan is made.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::Job;
use super::datasheet::{datasheet, length_sigma_mm};
use crate::identifiability::Belief;
use crate::model::inverse::nearest;
use crate::model::{AXES, Pose, Reading, Robot};

/// A taught ball may be off by this much from where its axis angles say, mm: more is a mistake in one of the two.
const TAUGHT_MM: f64 = 1.0;
/// The program's tool may be off by this much from the tool ball, mm: what KRL prints.
const TOOL_MM: f64 = 1e-3;

/// What is known of robot and set-up when a plan is made.
#[derive(Clone, Debug)]
pub struct Knowledge {
    /// The model and its covariance.
    pub belief: Belief,
    /// Lengths that stand behind it.
    pub lengths: usize,
    /// For each base ball whether it has been measured or taught. One that has not will be taught before its first
    /// run: put where the tool ball is, it is wrong as the robot is wrong there.
    told: Vec<bool>,
}

/// How a base ball is to be taught.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Taught {
    /// The ball, from 1.
    pub centre: u32,
    /// The controller's axis angles at which the tool ball is to stand on it, degrees.
    pub axes_deg: [f64; AXES],
}

impl Knowledge {
    /// Before anything is measured: the robot's tolerance, the bar's certificate, the balls that were taught.
    pub fn datasheet(job: &Job, robot: &Robot) -> Self {
        let mut belief = datasheet(job, robot);
        let sd_mm = length_sigma_mm(job, robot.controller());
        for (at, table) in job.centres.iter().enumerate() {
            if let Some(taught) = table.taught_deg {
                belief = belief.touched(at, &taught.map(f64::to_radians), sd_mm);
            }
        }
        Self {
            belief,
            lengths: 0,
            told: job.centres.iter().map(|table| table.taught_deg.is_some()).collect(),
        }
    }

    /// After lengths: the likeliest robot (with the given one as its nominal) and base balls, and what
    /// is known of them. `None` when a number is not finite.
    pub fn learned(job: &Job, robot: &Robot, readings: &[Reading]) -> Option<Self> {
        let nominal = robot.controller();
        let before = Self::datasheet(job, nominal);
        let belief = before.belief.learn(readings, length_sigma_mm(job, nominal))?;
        let mut told = before.told;
        for reading in readings {
            *told.get_mut(reading.centre)? = true;
        }
        Some(Self { belief, lengths: readings.len(), told })
    }

    /// The job and the robot as they are now known: base balls and geometry moved to the likeliest.
    pub fn applied(&self, job: &Job, robot: &Robot) -> (Job, Robot) {
        let (mut job, nominal) = (job.clone(), robot.controller());
        for (table, centre) in job.centres.iter_mut().zip(&self.belief.model.centres) {
            table.xyz_mm = (*centre).into();
        }
        let robot = Robot {
            geometry: self.belief.model.geometry.clone(),
            nominal: Some(Box::new(nominal.clone())),
            ..nominal.clone()
        };
        (job, robot)
    }

    /// What is known when a run about base ball `centre` (from 1) starts at axis angles in rad: where the ball was
    /// neither measured nor taught, it is touched before with the tool held as there.
    pub(crate) fn at_start(
        &self,
        job: &Job,
        controller: &Robot,
        centre: u32,
        start: &[f64; AXES],
    ) -> (Belief, Option<Taught>) {
        let at = centre.saturating_sub(1) as usize;
        if self.told.get(at).is_none_or(|told| *told) {
            return (self.belief.clone(), None);
        }
        let axes = touching(job, controller, centre, start).unwrap_or(*start);
        let axes_deg = axes.map(|angle| (angle.to_degrees() * 1e4).round() / 1e4);
        let sd_mm = length_sigma_mm(job, controller);
        (self.belief.touched(at, &axes_deg.map(f64::to_radians), sd_mm), Some(Taught { centre, axes_deg }))
    }

    /// Goes on from what is known at such a start.
    pub(crate) fn teach(&mut self, belief: Belief, taught: Taught) {
        self.belief = belief;
        if let Some(told) = self.told.get_mut(taught.centre.saturating_sub(1) as usize) {
            *told = true;
        }
    }
}

/// The controller's axis angles, rad, at which the tool ball is where it believes base ball `centre` to be, the
/// tool held as at `start`; `None` where it cannot be reached.
pub(crate) fn touching(
    job: &Job,
    controller: &Robot,
    centre: u32,
    start: &[f64; AXES],
) -> Option<[f64; AXES]> {
    let table = job.centres.get(centre.saturating_sub(1) as usize)?;
    let rotation = controller.geometry.ball(start).rotation;
    let pose = Pose { rotation, position: Vector3::from(table.xyz_mm) };
    nearest(&controller.geometry, &pose, start).ok()
}

impl Job {
    /// Whether each ball's `taught_deg` brings the tool ball of the controller's robot to its `xyz_mm`, and the program's
    /// tool is at that ball.
    ///
    /// # Errors
    /// What does not fit, with both values.
    pub fn check_against(&self, controller: &Robot) -> Result<(), String> {
        for table in &self.centres {
            let Some(taught) = table.taught_deg else { continue };
            let ball = controller.geometry.ball(&taught.map(f64::to_radians)).position;
            let off = (ball - Vector3::from(table.xyz_mm)).norm();
            if off > TAUGHT_MM {
                return Err(format!(
                    "[[centre]] {}: taught_deg brings the tool ball to ({:.2}, {:.2}, {:.2}) mm, {off:.2} mm from \
                     xyz_mm: take both from the controller at one pose, with the tool ball as its tool",
                    table.id, ball.x, ball.y, ball.z
                ));
            }
        }
        let Some([x, y, z, ..]) = self.motion.tool else { return Ok(()) };
        let ball = controller.geometry.tool;
        if (ball - Vector3::new(x, y, z)).norm() > TOOL_MM {
            return Err(format!(
                "[motion] tool: ({x}, {y}, {z}) mm is not the robot file's tool ball ({}, {}, {}): its origin must be",
                ball.x, ball.y, ball.z
            ));
        }
        Ok(())
    }
}
