//! Correction of the targets of a program. With the corrected targets, the identified robot under a controller that
//! knows the nominal robot moves to where the nominal robot would move with the original targets.
//!
//! For each target: P is the nominal pose of the flange, moved with the base ball if the program holds the bar; q are the axis angles at which the flange of the identified robot is
//! at P; the corrected target is the nominal pose of the flange at q. Each robot is taken in its own base frame.
//!
//! A longer last link and a tool ball further out have the same effect on the lengths. The priors of both decide in the
//! identification which part is flange and which is ball. Here the flange is the identified flange, as in a URDF, and
//! the tools of the program are not changed.

use nalgebra::Vector3;

use super::{Frames, MountedBalls, Target};
use crate::program::CompensationFinding;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::{ApproachedPose, ToolPoint};
use dbbd_model::plausibility::Quantity;
use dbbd_model::robot::inverse::{self, FanucConfiguration, Unsolved};
use dbbd_model::robot::{AXES, Approach, AxisAngles, Geometry, Pose, Robot};

/// Largest change of an axis by a correction, degrees: a larger one shows that a singularity is near.
const LARGEST_TURN_DEG: f64 = 5.0;
/// Rounding a pose to its digits moves an axis by less than this, degrees.
const ROUNDED_DEG: f64 = 0.005;

/// The way in which the controller selects the solution branch of a pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Branch {
    /// Selected by the status and turn of the target.
    ByStatusAndTurn,
    /// Selected by ABB's configuration: see [`inverse::quadrants`].
    ByQuadrants([i32; 4]),
    /// Selected by FANUC's configuration with its turns.
    ByFanuc(FanucConfiguration),
    /// Selected on a line or an arc of a FANUC: by its configuration, with the turns nearest to the position before.
    OnLine(FanucConfiguration),
    /// The branch nearest to the position before.
    Nearest,
    /// The branch nearest to the position before; for a first motion, that of ABB's configuration.
    NearestElse([i32; 4]),
    /// The branch nearest to these axis angles, rad.
    NearestTo([f64; AXES]),
}

/// A target with the data on which its axis angles depend.
#[derive(Clone, Copy, Debug)]
pub struct Commanded<'a> {
    pub target: &'a Target,
    /// Frames of the target; a pose needs them.
    pub frames: Option<&'a Frames>,
    pub branch: Branch,
}

#[derive(Clone, Debug)]
pub struct Corrected {
    /// A1 to A6, or X, Y, Z, A, B, C.
    pub numbers: [f64; 6],
    /// Shift of the commanded tool point, mm; for axis angles, of the flange.
    pub shift_mm: f64,
    /// Rotation of the commanded orientation, degrees.
    pub turn_deg: f64,
    /// The axis angles of the nominal and of the identified robot at the taught target, rad.
    taught: [f64; AXES],
    axes: [f64; AXES],
    /// The tool at a pose with the sense of approach; `None` for axis angles.
    tool_point: Option<ToolPoint>,
}

/// How the points of a program are corrected.
#[derive(Clone, Copy)]
pub struct Correction<'a> {
    /// An identified robot with its nominal one.
    robot: &'a Robot,
    /// No commanded point may move by more, mm.
    limit_mm: f64,
    /// The base balls about which the program moves the bar, if it holds one.
    mounted: Option<&'a MountedBalls>,
    /// The axis angles at which the program begins, if they are known, rad.
    start: Option<[f64; AXES]>,
}

impl<'a> Correction<'a> {
    /// The correction of a program that holds no bar, for an identified robot with its nominal one.
    pub fn of(robot: &'a Robot, limit_mm: f64) -> Self {
        Self { robot, limit_mm, mounted: None, start: None }
    }

    /// The correction of a program that begins at these axis angles, degrees: they select the branch of its first pose.
    #[must_use]
    pub fn from_start(self, axes_deg: Option<[f64; AXES]>) -> Self {
        Self { start: axes_deg.map(|axes_deg| axes_deg.map(f64::to_radians)), ..self }
    }

    /// The correction of a program that holds the bar.
    #[must_use]
    pub fn about(self, mounted: Option<&'a MountedBalls>) -> Self {
        Self { mounted, ..self }
    }
}

/// Corrects targets one after the other, in the order in which the robot moves to them.
pub struct Corrector<'a> {
    /// The robot as the controller knows it, with the tool point at the flange.
    nominal: Robot,
    /// The true robot, with the tool point at the flange as well.
    identified: Geometry,
    limit_mm: f64,
    mounted: Option<&'a MountedBalls>,
    /// The nominal axis angles at the last target, rad, and the sense in which each axis approached it. Before the first
    /// target it is the start, without which the robot may be anywhere.
    last: Option<[f64; AXES]>,
    approach: Approach,
}

/// A tool or base that is so small, without being zero, or so large that it is probably in another unit.
fn other_unit(frames: &Frames) -> Option<CompensationFinding> {
    let frames = [("the tool", &frames.tool), ("the base", &frames.base)];
    frames.into_iter().find_map(|(frame, pose)| {
        let size_mm = pose.position.norm();
        let is_other = size_mm > 0.0 && Quantity::FrameDistance.check(frame, size_mm).is_err();
        is_other.then_some(CompensationFinding::FrameInOtherUnit { frame, size_mm })
    })
}

impl<'a> Corrector<'a> {
    pub fn new(correction: Correction<'a>) -> Self {
        let Correction { robot, limit_mm, mounted, start } = correction;
        let controller = robot.controller();
        let flange = |geometry: &Geometry, tool| Geometry { tool, ..geometry.clone() };
        Self {
            nominal: Robot { geometry: flange(&controller.geometry, Vector3::zeros()), ..controller.clone() },
            identified: flange(&robot.geometry, Vector3::zeros()),
            limit_mm,
            mounted,
            last: start,
            approach: Approach::default(),
        }
    }

    pub fn correct(&mut self, commanded: Commanded<'_>) -> Result<Corrected, CompensationFinding> {
        let no_frames = Frames { tool: Pose::identity(), base: Pose::identity() };
        let frames = commanded.frames.unwrap_or(&no_frames);
        if let Some(wrong) = other_unit(frames) {
            return Err(wrong);
        }
        let frames = &frames.for_table(&self.nominal.frames);
        let (flange, taught) = self.taught(commanded, frames)?;
        let shift = self.mounted.map(|mounted| mounted.shift(&flange)).transpose()?.unwrap_or_default();
        let wanted = Pose { position: flange.position + shift, ..flange };
        let axes = self.solve(&wanted, &taught)?;
        let (before, after) = (frames.tool(&flange), frames.tool(&self.nominal.geometry.ball(&axes)));
        let numbers = match commanded.target {
            Target::Axes(_) => axes.map(f64::to_degrees),
            Target::Pose { .. } => after.xyzabc(),
        };
        let shift_mm = (after.position - before.position).norm();
        if shift_mm > self.limit_mm {
            return Err(CompensationFinding::TooFar { shift_mm, limit_mm: self.limit_mm });
        }
        let turn_deg = after.angle_to(&before).to_degrees();
        let pose = ApproachedPose {
            axes: AxisAngles::from_degrees(taught.map(f64::to_degrees)),
            approach: self.approach,
        };
        let tool_point = commanded.frames.map(|_| ToolPoint { tool: frames.tool.position, pose });
        Ok(Corrected { numbers, shift_mm, turn_deg, taught, axes, tool_point })
    }

    /// The nominal pose of the flange at a target, and the nominal axis angles there.
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
                let axes = match commanded.branch {
                    Branch::ByQuadrants(wanted) => inverse::from_quadrants(&self.nominal, &flange, wanted),
                    Branch::NearestElse(wanted) => match self.last {
                        Some(last) => self.nearest(&flange, &last),
                        None => inverse::from_quadrants(&self.nominal, &flange, wanted),
                    },
                    Branch::ByFanuc(wanted) if self.knows_fanuc() => {
                        inverse::from_fanuc(&self.nominal, &flange, wanted, None)
                    }
                    Branch::ByFanuc(_) => return Err(CompensationFinding::NoFanucRule),
                    Branch::OnLine(wanted) if self.knows_fanuc() => {
                        inverse::from_fanuc(&self.nominal, &flange, wanted, self.last.as_ref())
                    }
                    Branch::NearestTo(near) => self.nearest(&flange, &near),
                    Branch::ByStatusAndTurn | Branch::Nearest | Branch::OnLine(_) => {
                        // On a line the controller keeps the branch that it has. A taught point has its own in S and T.
                        let taught = status.zip(turn);
                        let keeps = commanded.branch != Branch::ByStatusAndTurn || taught.is_none();
                        match (self.last.filter(|_| keeps), taught) {
                            (Some(last), _) => self.nearest(&flange, &last),
                            (None, Some((status, turn))) => {
                                match (u8::try_from(status & 7), u8::try_from(turn)) {
                                    (Ok(status), Ok(turn)) => self.branch(&flange, status, turn),
                                    _ => return Err(CompensationFinding::StatusOutOfRange),
                                }
                            }
                            (None, None) => return Err(CompensationFinding::NoBranchBefore),
                        }
                    }
                };
                let unreached =
                    |why: Unsolved| CompensationFinding::NominalDoesNotReach { why: why.to_string() };
                Ok((flange, axes.map_err(unreached)?))
            }
        }
    }

    /// The nominal axis angles that lie nearest to `near` and within the limits; without such angles, the nearest
    /// beyond the limits.
    fn nearest(&self, flange: &Pose, near: &[f64; AXES]) -> Result<[f64; AXES], Unsolved> {
        let Robot { geometry, .. } = &self.nominal;
        let nearest = inverse::nearest(geometry, flange, near)?;
        let limits_deg = self.nominal.limits_at_deg(&nearest.map(f64::to_degrees));
        let is_within = |(axis, [low, high]): (&f64, [f64; 2])| (low..=high).contains(&axis.to_degrees());
        if nearest.iter().zip(limits_deg).all(is_within) {
            return Ok(nearest);
        }
        let turn = |axes: &[f64; AXES]| {
            axes.iter().zip(near).map(|(axis, near)| (axis - near).abs()).fold(0.0, f64::max)
        };
        let branches = inverse::branches(geometry, flange).unwrap_or_default();
        let within = branches.iter().flat_map(|axes| inverse::turns_within(axes, &self.nominal));
        Ok(within.min_by(|a, b| turn(a).total_cmp(&turn(b))).unwrap_or(nearest))
    }

    /// The nominal axis angles by status and turn. If rounding the pose to its digits moves an axis that was taught at zero
    /// to the other side of zero, its turn bit is ignored.
    fn branch(&self, flange: &Pose, status: u8, turn: u8) -> Result<[f64; AXES], Unsolved> {
        let as_written = inverse::from_status_turn(&self.nominal, flange, status, turn);
        if !matches!(as_written, Err(Unsolved::NoSuchConfiguration { .. })) {
            return as_written;
        }
        let mut ignoring = (1..1_u8 << AXES).filter_map(|flipped| {
            let axes = inverse::from_status_turn(&self.nominal, flange, status, turn ^ flipped).ok()?;
            let at_zero = |axis: usize| axes[axis].to_degrees().abs() < ROUNDED_DEG;
            (0..AXES).all(|axis| (flipped >> axis) & 1 == 0 || at_zero(axis)).then_some(axes)
        });
        ignoring.next().map_or(as_written, Ok)
    }

    /// The axis angles of the identified robot at a pose of its flange, in the branch of `start`.
    fn solve(&mut self, flange: &Pose, start: &[f64; AXES]) -> Result<[f64; AXES], CompensationFinding> {
        if let Some(last) = self.last.replace(*start) {
            self.approach = self.approach.after(&last, start);
        }
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

    /// KUKA's turn bits of a corrected target at its printed pose. If the correction moves an axis through zero, its bit
    /// changes: with the old bit a controller would move the axis a full turn away.
    pub fn turn(
        &self,
        corrected: &Corrected,
        printed: &Pose,
        frames: &Frames,
    ) -> Result<u8, CompensationFinding> {
        Ok(inverse::turn(&self.printed_axes(corrected, printed, frames)?))
    }

    /// ABB's configuration of a corrected target at its printed pose.
    pub fn quadrants(
        &self,
        corrected: &Corrected,
        printed: &Pose,
        frames: &Frames,
    ) -> Result<[i32; 4], CompensationFinding> {
        let axes = self.printed_axes(corrected, printed, frames)?;
        Ok(inverse::quadrants(&self.nominal.geometry, &axes))
    }

    /// Whether the rule is known by which FANUC's configuration selects a branch of this arm.
    fn knows_fanuc(&self) -> bool {
        FanucConfiguration::at(&self.nominal.geometry, &[0.0; AXES]).is_some()
    }

    /// FANUC's configuration of a target before its correction, and the configuration of the corrected target at its
    /// printed pose; `None` for an arm for which the rule is not known.
    pub fn fanuc(
        &self,
        corrected: &Corrected,
        printed: &Pose,
        frames: &Frames,
    ) -> Result<Option<[FanucConfiguration; 2]>, CompensationFinding> {
        let axes = self.printed_axes(corrected, printed, frames)?;
        let of = |axes: &[f64; AXES]| FanucConfiguration::at(&self.nominal.geometry, axes);
        Ok(of(&corrected.taught).zip(of(&axes)).map(|(taught, new)| [taught, new]))
    }

    /// ABB's configuration of a target before its correction.
    pub fn taught_quadrants(&self, corrected: &Corrected) -> [i32; 4] {
        inverse::quadrants(&self.nominal.geometry, &corrected.taught)
    }

    /// The nominal axis angles at a corrected pose as it is printed, in the branch in which it was taught.
    fn printed_axes(
        &self,
        corrected: &Corrected,
        printed: &Pose,
        frames: &Frames,
    ) -> Result<[f64; AXES], CompensationFinding> {
        let geometry = &self.nominal.geometry;
        let flange = frames.for_table(&self.nominal.frames).flange(printed);
        let axes = inverse::nearest(geometry, &flange, &corrected.axes)
            .map_err(|unsolved| CompensationFinding::NominalDoesNotReach { why: unsolved.to_string() })?;
        let [taught, corrected] = [&corrected.taught, &axes].map(|axes| inverse::status(geometry, axes));
        if taught != corrected {
            return Err(CompensationFinding::OtherStatus { taught, corrected });
        }
        Ok(axes)
    }
}

/// The finding about a frame that differs between the ways to a motion; the frame is set in these lines (0: before the
/// program).
pub(crate) fn mixed(frame: &'static str, lines: [usize; 2]) -> CompensationFinding {
    let set_in = |line| if line == 0 { "before the program".into() } else { format!("of line {line}") };
    let [first, second] = lines.map(set_in);
    CompensationFinding::FrameMixed { frame, first, second }
}

/// A point that was corrected.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Moved {
    /// Name of the point; `inline` if it has no name.
    pub name: String,
    /// The first line that moves to the point; in KRL, a line of the `.src`.
    pub line: usize,
    /// Shift of the point as in [`Corrected`], mm.
    pub shift_mm: f64,
    /// Rotation of the point as in [`Corrected`], degrees.
    pub turn_deg: f64,
    /// KUKA's turn bits before and after, if an axis moved through zero.
    pub turn_bits: Option<[u8; 2]>,
    /// The tool at the point; `None` if the point is written as axis angles.
    #[serde(skip)]
    pub tool_point: Option<ToolPoint>,
}

impl Moved {
    /// The correction of a point to which this line moves.
    pub(super) fn new(name: String, line: usize, corrected: &Corrected, turn_bits: Option<[u8; 2]>) -> Self {
        let Corrected { shift_mm, turn_deg, tool_point, .. } = *corrected;
        Self { name, line, shift_mm, turn_deg, turn_bits, tool_point }
    }
}

/// A finding if most places are so near the origin of their frame that they must be in metres.
pub fn in_metres<'a>(targets: impl IntoIterator<Item = &'a Target>) -> Option<CompensationFinding> {
    /// Farther than any robot reaches, m.
    const REACH_M: f64 = 5.0;
    let sizes = targets.into_iter().filter_map(|target| match target {
        Target::Pose { xyz_mm: [x, y, z], .. } => Some(x.hypot(*y).hypot(*z)),
        Target::Axes(_) => None,
    });
    let (near, far): (Vec<f64>, Vec<f64>) = sizes.partition(|size| *size < REACH_M);
    let size_mm = near.iter().copied().fold(0.0, f64::max);
    (near.len() > far.len().max(2) && size_mm > 0.0)
        .then_some(CompensationFinding::PointsInMetres { points: near.len(), size_mm })
}

/// Positions of external axes; `None` for an axis that the robot does not have.
pub(crate) type External = [Option<f64>; 6];

/// The first point, by its index, at which an external axis is not at 0.
pub(crate) fn external_axis_away<'a>(
    points: impl IntoIterator<Item = (&'a str, External)>,
) -> Option<(usize, CompensationFinding)> {
    let away = |(place, (name, external)): (usize, (&str, External))| {
        let mut axes = (1..).zip(external);
        let (axis, at) = axes.find_map(|(axis, at)| Some((axis, at.filter(|at| *at != 0.0)?)))?;
        Some((place, CompensationFinding::ExternalAxis { axis, name: name.to_owned(), at }))
    };
    points.into_iter().enumerate().find_map(away)
}

/// Corrects all points, in the order of their first use; `rewrite` writes the new numbers of a point.
///
/// # Errors
/// One finding for each point that cannot be corrected.
pub(super) fn correct_points<P>(
    correction: Correction<'_>,
    points: &[P],
    mut rewrite: impl FnMut(&mut Corrector<'_>, &P) -> Result<Moved, Diagnostic>,
) -> Result<Vec<Moved>, Vec<Diagnostic>> {
    let mut corrector = Corrector::new(correction);
    let (mut moved, mut refused) = (Vec::with_capacity(points.len()), Vec::new());
    for point in points {
        match rewrite(&mut corrector, point) {
            Ok(point) => moved.push(point),
            Err(why) => refused.push(why),
        }
    }
    if refused.is_empty() { Ok(moved) } else { Err(refused) }
}
