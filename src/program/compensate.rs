//! Corrects the targets of a program so that the identified robot, driven by a controller that knows the nominal one,
//! comes where the nominal robot would.
//!
//! For each target: the flange's nominal pose P; the axis angles q at which the identified robot's flange is at P; the
//! command is the nominal flange's pose at q. Both robots are taken in their own base frame.
//!
//! A longer last link and a ball that is further out have the same lengths. The identified flange is therefore taken to
//! be where the ball is at its nominal place on it; the tools of the program stay what they are.

use nalgebra::Vector3;

use super::{Frames, Language, Target};
use crate::catalogue::CompensationFinding;
use crate::robot::inverse::{self, Unsolved};
use crate::robot::{AXES, Approach, Geometry, Pose, Robot};

/// An axis that a correction turns further, degrees, is near a singularity.
const LARGEST_TURN_DEG: f64 = 5.0;
/// The digits of a pose move an axis by less than this, degrees.
const ROUNDED_DEG: f64 = 0.005;

/// How the controller chooses among the axis angles of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Branch {
    /// As the target's status and turn say.
    ByStatusAndTurn,
    /// By ABB's configuration: see [`inverse::quadrants`].
    ByQuadrants([i32; 4]),
    Nearest,
}

/// A target and what its axis angles depend on.
#[derive(Clone, Copy, Debug)]
pub struct Commanded<'a> {
    pub target: &'a Target,
    /// Needed for a pose.
    pub frames: Option<&'a Frames>,
    pub branch: Branch,
}

#[derive(Clone, Debug)]
pub struct Corrected {
    /// A1 to A6, or X, Y, Z, A, B, C.
    pub numbers: [f64; 6],
    /// How far the commanded tool point moved (of an axis position: the flange).
    pub shift_mm: f64,
    /// How far the commanded orientation turned.
    pub turn_deg: f64,
    /// The nominal robot's axis angles at the taught target, and the identified robot's there, rad.
    taught: [f64; AXES],
    axes: [f64; AXES],
}

/// Goes through the targets as the robot would.
pub struct Corrector {
    /// The controller's robot, its tool point at the flange.
    nominal: Robot,
    /// The true robot, its tool point at the flange too.
    identified: Geometry,
    limit_mm: f64,
    /// Nominal axis angles at the last target, rad, and how the axes came there.
    last: [f64; AXES],
    approach: Approach,
}

/// A tool or a base that is so near to the flange or the robot's base, and not there, or so far, that it is in another
/// unit.
fn other_unit(frames: &Frames) -> Option<CompensationFinding> {
    const NEAR_MM: f64 = 3.0;
    const FAR_MM: f64 = 1e4;
    let frames = [("the tool", &frames.tool), ("the base", &frames.base)];
    frames.into_iter().find_map(|(frame, pose)| {
        let size_mm = pose.position.norm();
        let is_other = (size_mm > 0.0 && size_mm < NEAR_MM) || size_mm > FAR_MM;
        is_other.then_some(CompensationFinding::FrameInOtherUnit { frame, size_mm })
    })
}

impl Corrector {
    /// For `robot`, an identified one that carries its nominal robot; no tool point may move by more than `limit_mm`.
    pub fn new(robot: &Robot, limit_mm: f64) -> Self {
        let controller = robot.controller();
        let flange = |geometry: &Geometry, tool| Geometry { tool, ..geometry.clone() };
        let off = robot.geometry.tool - controller.geometry.tool;
        Self {
            nominal: Robot { geometry: flange(&controller.geometry, Vector3::zeros()), ..controller.clone() },
            identified: flange(&robot.geometry, off),
            limit_mm,
            last: Language::of_robot(robot).home_deg().map(f64::to_radians),
            approach: Approach::default(),
        }
    }

    pub fn correct(&mut self, commanded: Commanded<'_>) -> Result<Corrected, CompensationFinding> {
        let null = Frames { tool: Pose::identity(), base: Pose::identity() };
        let frames = commanded.frames.unwrap_or(&null);
        if let Some(wrong) = other_unit(frames) {
            return Err(wrong);
        }
        let (flange, taught) = self.taught(commanded, frames)?;
        let axes = self.solve(&flange, &taught)?;
        let (before, after) = (frames.tool(&flange), frames.tool(&self.nominal.geometry.ball(&axes)));
        let numbers = match commanded.target {
            Target::Axes(_) => axes.map(f64::to_degrees),
            Target::Pose { .. } => {
                let ([x, y, z], [a, b, c]) = (<[f64; 3]>::from(after.position), after.abc_deg());
                [x, y, z, a, b, c]
            }
        };
        let shift_mm = (after.position - before.position).norm();
        if shift_mm > self.limit_mm {
            return Err(CompensationFinding::TooFar { shift_mm, limit_mm: self.limit_mm });
        }
        Ok(Corrected { numbers, shift_mm, turn_deg: after.angle_to(&before).to_degrees(), taught, axes })
    }

    /// The nominal flange's pose at a target, and the nominal axis angles there.
    fn taught(
        &self,
        commanded: Commanded<'_>,
        frames: &Frames,
    ) -> Result<(Pose, [f64; AXES]), CompensationFinding> {
        match *commanded.target {
            Target::Axes(axes_deg) => {
                let axes = axes_deg.map(f64::to_radians);
                Ok((self.nominal.geometry.ball(&axes), axes))
            }
            Target::Pose { xyz_mm, abc_deg, status, turn } => {
                let flange = frames.flange(&Pose::from_kuka(xyz_mm, abc_deg));
                let axes = match (commanded.branch, status.zip(turn)) {
                    (Branch::ByQuadrants(wanted), _) => {
                        inverse::from_quadrants(&self.nominal, &flange, wanted)
                    }
                    (Branch::ByStatusAndTurn, Some((status, turn))) => {
                        let bits = (u8::try_from(status & 7), u8::try_from(turn));
                        let (Ok(status), Ok(turn)) = bits else {
                            return Err(CompensationFinding::StatusOutOfRange);
                        };
                        self.branch(&flange, status, turn)
                    }
                    _ => inverse::nearest(&self.nominal.geometry, &flange, &self.last),
                };
                let unreached =
                    |why: Unsolved| CompensationFinding::NominalDoesNotReach { why: why.to_string() };
                Ok((flange, axes.map_err(unreached)?))
            }
        }
    }

    /// The nominal robot's axis angles by status and turn. The digits of a pose may put an axis that was taught at zero
    /// on its other side: its bit then counts for nothing.
    fn branch(&self, flange: &Pose, status: u8, turn: u8) -> Result<[f64; AXES], Unsolved> {
        let as_written = inverse::from_status_turn(&self.nominal, flange, status, turn);
        if !matches!(as_written, Err(Unsolved::NoSuchConfiguration { .. })) {
            return as_written;
        }
        let mut others = (1..1_u8 << AXES).filter_map(|flipped| {
            let axes = inverse::from_status_turn(&self.nominal, flange, status, turn ^ flipped).ok()?;
            let at_zero = |axis: usize| axes[axis].to_degrees().abs() < ROUNDED_DEG;
            (0..AXES).all(|axis| (flipped >> axis) & 1 == 0 || at_zero(axis)).then_some(axes)
        });
        others.next().map_or(as_written, Ok)
    }

    /// The identified robot's axis angles at a pose of its flange, in the branch of `start`.
    fn solve(&mut self, flange: &Pose, start: &[f64; AXES]) -> Result<[f64; AXES], CompensationFinding> {
        self.approach = self.approach.after(&self.last, start);
        self.last = *start;
        let axes = inverse::numeric(&self.identified.approached(self.approach), flange, start)
            .map_err(|unsolved| CompensationFinding::IdentifiedDoesNotReach { why: unsolved.to_string() })?;
        let limits_deg = self.nominal.limits_at_deg(&axes.map(f64::to_degrees));
        for (i, (to, from)) in axes.iter().zip(start).enumerate() {
            let ([low_deg, high_deg], angle_deg, axis) = (limits_deg[i], to.to_degrees(), i + 1);
            if !(low_deg..=high_deg).contains(&angle_deg) {
                return Err(CompensationFinding::BeyondLimit { axis, angle_deg, low_deg, high_deg });
            }
            let turn_deg = (to - from).abs().to_degrees();
            if turn_deg > LARGEST_TURN_DEG {
                return Err(CompensationFinding::LargeTurn { axis, turn_deg });
            }
        }
        Ok(axes)
    }

    /// KUKA's turn bits of a corrected target, as its printed pose has them. An axis that the correction carries through
    /// zero has another one than was taught: with the old bit a controller would look for the same pose a full turn away.
    pub fn turn(
        &self,
        corrected: &Corrected,
        printed: &Pose,
        frames: &Frames,
    ) -> Result<u8, CompensationFinding> {
        Ok(inverse::turn(&self.there(corrected, printed, frames)?))
    }

    /// ABB's configuration of a corrected target, likewise.
    pub fn quadrants(
        &self,
        corrected: &Corrected,
        printed: &Pose,
        frames: &Frames,
    ) -> Result<[i32; 4], CompensationFinding> {
        let there = self.there(corrected, printed, frames)?;
        Ok(inverse::quadrants(&self.nominal.geometry, &there))
    }

    /// The nominal robot's axis angles at a corrected pose as it is printed, in the branch in which it was taught.
    fn there(
        &self,
        corrected: &Corrected,
        printed: &Pose,
        frames: &Frames,
    ) -> Result<[f64; AXES], CompensationFinding> {
        let geometry = &self.nominal.geometry;
        let there = inverse::nearest(geometry, &frames.flange(printed), &corrected.axes)
            .map_err(|unsolved| CompensationFinding::NominalDoesNotReach { why: unsolved.to_string() })?;
        let [taught, corrected] = [&corrected.taught, &there].map(|axes| inverse::status(geometry, axes));
        if taught != corrected {
            return Err(CompensationFinding::OtherStatus { taught, corrected });
        }
        Ok(there)
    }
}
