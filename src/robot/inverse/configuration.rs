//! KUKA's status and turn, which tell the branches and turns of one pose apart.

use std::f64::consts::TAU;

use super::{Unsolved, branches, closed};
use crate::robot::pose::Pose;
use crate::robot::{AXES, Geometry, Robot};

/// An axis nearer to zero than this (1e-6 degrees) counts as zero.
const ZERO_RAD: f64 = 1e-6 * std::f64::consts::PI / 180.0;

/// KUKA's status bits of the branch at axis angles in rad: bit 0 wrist centre behind axis 1 (x < 0 in
/// axis 1's frame), bit 1 elbow (A3 at or above the angle at which the arm is stretched), bit 2 A5 < 0.
pub fn status(geometry: &Geometry, axes: &[f64; AXES]) -> u8 {
    let frames = geometry.frames(&geometry.joint_angles(axes));
    let (shoulder, wrist) = (&frames[0], &frames[4]);
    let behind = shoulder.rotation.column(0).dot(&(wrist.position - shoulder.position)) < 0.0;
    let elbow = match closed::Arm::near(geometry) {
        Some(arm) => arm.elbow(axes[2]) >= 0.0,
        None => axes[2] >= 0.0,
    };
    u8::from(behind) | u8::from(elbow) << 1 | u8::from(axes[4] < -ZERO_RAD) << 2
}

/// How far an arm is from its singular positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clearance {
    /// Of the wrist: |A5| from straight or folded back, rad.
    pub wrist: f64,
    /// Of the elbow: angle between upper arm and forearm from stretched or folded, rad.
    pub elbow: f64,
    /// Of the shoulder: distance of the wrist centre from axis 1, mm.
    pub overhead: f64,
}

/// How far an arm is from its singular positions at axis angles in rad; `None` for an arm that is not
/// near one with a spherical wrist, whose singular positions are others.
pub fn clearance(geometry: &Geometry, axes: &[f64; AXES]) -> Option<Clearance> {
    let arm = closed::Arm::near(geometry)?;
    let frames = geometry.frames(&geometry.joint_angles(axes));
    let (shoulder, wrist) = (&frames[0], &frames[4]);
    let out = wrist.position - shoulder.position;
    let upright = shoulder.rotation.column(2);
    // Distance of an angle from the nearest multiple of half a turn.
    let from_straight = |angle: f64| angle.sin().abs().asin();
    Some(Clearance {
        wrist: from_straight(arm.wrist(axes[4])),
        elbow: from_straight(arm.elbow(axes[2])),
        overhead: (out - upright * upright.dot(&out)).norm(),
    })
}

/// KUKA's turn bits: bit i is set when axis i + 1 is negative (an axis within 1e-6 deg of 0 is 0).
pub fn turn(axes: &[f64; AXES]) -> u8 {
    axes.iter().enumerate().fold(0, |bits, (i, angle)| bits | u8::from(*angle < -ZERO_RAD) << i)
}

/// The same pose with every axis turned fully as often as the limits (degrees) allow; empty when an
/// axis has no turn within them.
pub fn turns_within(axes: &[f64; AXES], limits_deg: &[[f64; 2]; AXES]) -> Vec<[f64; AXES]> {
    let mut variants = vec![*axes];
    for (i, limits) in limits_deg.iter().enumerate() {
        let [low, high] = limits.map(f64::to_radians);
        let turned = |angle: f64| {
            let first = ((low - ZERO_RAD - angle) / TAU).ceil();
            // Limits are a few turns at most: more would be a mistake in the file, not a robot.
            (0..8)
                .map(move |more| angle + TAU * (first + f64::from(more)))
                .filter(move |a| *a <= high + ZERO_RAD)
        };
        variants = variants
            .iter()
            .flat_map(|axes| {
                turned(axes[i]).map(move |angle| {
                    let mut variant = *axes;
                    variant[i] = angle;
                    variant
                })
            })
            .collect();
    }
    variants
}

/// The axis angles (rad) that a controller takes for a pose with status and turn (S and T of an E6POS;
/// bits of S above 2 say nothing about the branch).
///
/// # Errors
/// Out of reach, or no axis angles within the limits have them.
pub fn from_status_turn(
    robot: &Robot,
    ball: &Pose,
    wanted_status: u8,
    wanted_turn: u8,
) -> Result<[f64; AXES], Unsolved> {
    let wanted_status = wanted_status & 7;
    branches(&robot.geometry, ball)?
        .iter()
        .filter(|axes| status(&robot.geometry, axes) == wanted_status)
        .flat_map(|axes| turns_within(axes, &robot.limits_deg))
        .find(|axes| turn(axes) == wanted_turn)
        .ok_or(Unsolved::NoSuchConfiguration { status: wanted_status, turn: wanted_turn })
}
